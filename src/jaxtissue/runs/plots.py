"""Figures of a run; each function returns (figure, axes) and leaves matplotlib's global state alone.

Those of one panel draw on the axes `ax` where they are given some, else in a figure of their own.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import UInt8
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jaxtissue.geometry.array_likes import ArrayLike
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.runs.surface_maps import DEGREES, SurfaceMap, axis_labels, map_surface, unrolls
from jaxtissue.system.files import replacing

# Okabe and Ito's colors, which color-blind readers tell apart.
_BLUE, _ORANGE, _GREEN = "#0072B2", "#D55E00", "#009E73"
_INK = "#262626"
_WALL, _NOTHING = (38, 38, 38, 255), (255, 255, 255, 255)  # the same in bytes
# Without the darkest ends, on which walls and dots would not show.
_SMALL_TO_LARGE = ListedColormap(mpl.colormaps["RdBu_r"](np.linspace(0.12, 0.88, 256)))
_PANEL, _SEEN = 4.6, (0.12, 3.0)  # inches that a tube is long; around / length of surfaces drawn to scale
_TALL = 8  # inches, both surfaces together at most
_PIXELS = (800, 420)  # of an unrolled surface, along the axis and around it: as many as are shown


class Tissue(NamedTuple):
    """A tissue to draw: what it is called, its positions, the volumes of its cells, and its maps if they are known."""

    title: str
    positions: ArrayLike
    volume: ArrayLike
    maps: Mapping[str, Sequence[SurfaceMap]] | None = None


def save_figure(path: Path, draw: Callable[[], tuple[Figure, Any]]) -> None:
    """Write what `draw` draws as PNG; where that fails leave it out with a warning, as results do without."""
    image = BytesIO()
    try:
        with style.context("default"):  # whatever the user's matplotlibrc says
            figure, _ = draw()
            figure.set_dpi(150)
            # `savefig` would lay out and draw everything twice
            if layout := figure.get_layout_engine():
                layout.execute(figure)
                figure.set_layout_engine("none")
            FigureCanvasAgg(figure).print_png(image, pil_kwargs={"compress_level": 1})  # a third of the time
    except Exception as error:
        path.unlink(missing_ok=True)
        warnings.warn(f"{path.name} could not be drawn ({error}) and is missing", stacklevel=2)
        return
    with replacing(path, "wb") as file:
        file.write(image.getvalue())


def read_fonts() -> None:
    """Draw a figure for nothing: the first one takes longer."""
    with style.context("default"):
        figure, axes = _panel(None)
        axes.set(title="Title", xlabel="sweep", yscale="log")
        FigureCanvasAgg(figure).draw()


def map_surfaces(positions: ArrayLike, domain: Tube | Domain) -> dict[str, list[SurfaceMap]]:
    """The maps of both surfaces of a tissue, as `plot_surfaces` shows them."""
    place = np.asarray(positions)
    return {surface: map_surface(place, domain, surface, _PIXELS) for surface in ("basal", "apical")}


def _panel(ax: Axes | None) -> tuple[Figure, Axes]:
    """The axes that were given and their figure, or a new figure with axes."""
    if ax is not None:
        return cast(Figure, ax.figure), ax
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    return figure, figure.subplots()


def plot_energy(
    sweeps: Mapping[str, ArrayLike],
    checked: tuple[Sequence[int], Sequence[float]] | None = None,
    checked_label: str = "total, measured finely",
    ax: Axes | None = None,
) -> tuple[Figure, Axes]:
    """Energy of the tissue and its two terms over the sweeps (paper, Fig. 10), on a logarithmic axis.

    `sweeps` has the columns of sweeps.csv; `checked` gives sweeps and energies measured in another way.
    """
    figure, axes = _panel(ax)
    number = np.asarray(sweeps["sweep"])
    styles = [
        ("energy", "total", _BLUE, "-"),
        ("volume_energy", "volume term", _ORANGE, "--"),
        ("area_energy", "area term", _GREEN, "-."),
    ]
    for column, label, color, dashes in styles:
        axes.plot(number, np.asarray(sweeps[column]), dashes, color=color, label=label)
    if checked is not None:
        axes.plot(*checked, "o", color="black", markerfacecolor="white", label=checked_label)
    if np.asarray(sweeps["energy"]).min() > 0:
        axes.set_yscale("log", nonpositive="mask")
    axes.set(xlabel="sweep", ylabel="energy (model units)", title="Energy of the tissue")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.grid(which="both", color="0.9")
    axes.legend()
    return figure, axes


def plot_relaxation(history: Sequence[Any], ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Energy of a tissue, and the norm of its gradient on the right, over the evaluations of a relaxation."""
    figure, axes = _panel(ax)
    number = [record.evaluations for record in history]
    (energy,) = axes.plot(number, [record.energy for record in history], ".-", color=_BLUE, label="energy")
    right = axes.twinx()
    (slope,) = right.plot(number, [record.gradient for record in history], ".--", color=_ORANGE, label="gradient")
    axes.set(xlabel="evaluations of the energy and its gradient", ylabel="energy (model units)", title="Relaxation")
    right.set_ylabel("norm of the gradient (energy per length)")
    for panel, values in ((axes, energy.get_ydata()), (right, slope.get_ydata())):
        if np.min(values) > 0:
            panel.set_yscale("log", nonpositive="mask")
    axes.grid(which="both", color="0.9")
    axes.legend(handles=[energy, slope])
    return figure, axes


def plot_volumes(
    sweeps: Sequence[int | str], volumes: Sequence[ArrayLike], mean_volume: float, ax: Axes | None = None
) -> tuple[Figure, Axes]:
    """The cells' volumes after the given sweeps, or as named, each sorted, against the mean (paper, Fig. 11)."""
    figure, axes = _panel(ax)
    colors = mpl.colormaps["viridis"](np.linspace(0, 0.9, len(sweeps)))
    for sweep, volume, color in zip(sweeps, volumes, colors, strict=True):
        ordered = np.sort(np.asarray(volume))
        marker = "o" if len(ordered) < 2 else ""
        label = sweep if isinstance(sweep, str) else f"sweep {sweep}"
        axes.plot(np.arange(1, len(ordered) + 1), ordered, marker=marker, color=color, label=label)
    axes.axhline(mean_volume, color="black", linestyle=":", label=f"mean {mean_volume:.3g}")
    axes.set(xlabel="cells, from the smallest to the largest", ylabel="cell volume (length units³)")
    axes.set_title("Volumes of the cells")
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.grid(color="0.9")
    axes.legend()
    return figure, axes


def plot_grid(table: Mapping[str, ArrayLike], axes: Sequence[str], ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Energy per cell of the runs of a grid over the first of its `axes`, a line for each of the second.

    `table` has the columns of table.csv. Dots are runs; a line goes through their means. Runs that differ in
    further axes, such as the seed, are taken together.
    """
    figure, panel = _panel(ax)
    varied = [name for name in axes if name != "seed"] or ["seed"]
    across, energy = np.asarray(table[varied[0]]), np.asarray(table["energy"]) / np.asarray(table["cells"])
    kinds = np.asarray(table[varied[1]]) if len(varied) > 1 else np.zeros(len(across))
    colors = mpl.colormaps["viridis"](np.linspace(0, 0.9, len(np.unique(kinds))))
    for kind, color in zip(np.unique(kinds), colors, strict=True):
        own = kinds == kind
        label = f"{varied[1].replace('_', ' ')} {kind:g}" if len(varied) > 1 else None
        places = np.unique(across[own])
        means = [energy[own & (across == place)].mean() for place in places]
        panel.plot(places, means, color=color, label=label)
        panel.plot(across[own], energy[own], ".", color=color)
    panel.set(xlabel=varied[0].replace("_", " "), ylabel="energy per cell (model units)")
    panel.set_title("Energy after the last sweep")
    panel.grid(color="0.9")
    if len(varied) > 1:
        panel.legend()
    return figure, panel


def plot_surfaces(domain: Tube | Domain, tissues: Sequence[Tissue]) -> tuple[Figure, np.ndarray]:
    """The basal (top) and apical (bottom) surface of tissues, unrolled in one column each (paper, Fig. 9).

    Closed surfaces are seen from two sides, in two columns. A cell's color is its volume / the tissue's mean volume;
    lines are the walls, dots the backbones' ends. Both surfaces of a tube are to scale, unless one would be hardly
    seen. The axes come as an array [2, columns].
    """
    per_tissue = 1 if unrolls(domain) else 2
    width = 6 if unrolls(domain) else 3.6
    heights, together = _heights(domain), unrolls(domain)
    tall = 2 + min(_PANEL * sum(heights), _TALL) if heights else 7
    figure = Figure(figsize=(1 + width * per_tissue * len(tissues), tall), layout="constrained")
    axes = figure.subplots(2, per_tissue * len(tissues), sharex=together, sharey=together, squeeze=False,
                           height_ratios=heights)  # fmt: skip
    shades = ScalarMappable(Normalize(0, 2), _SMALL_TO_LARGE)
    for tissue, columns in zip(tissues, np.split(axes, len(tissues), axis=1), strict=True):
        relative = np.asarray(tissue.volume) / np.mean(np.asarray(tissue.volume))
        maps = tissue.maps or map_surfaces(tissue.positions, domain)
        for (surface, views), row in zip(maps.items(), columns, strict=True):
            for panel, shown in zip(row, views, strict=True):
                _draw_map(panel, shown, shades.to_rgba(relative, bytes=True))
                if heights:  # a degree is as long on the surface as it is drawn
                    radius = float(getattr(domain, f"{surface}_radius"))
                    panel.set_aspect(math.radians(radius))
                told = filter(None, (f"{surface} surface", tissue.title, shown.view))
                panel.set_title(", ".join(told), fontsize=None if together else "medium")
    across, up = axis_labels(domain)
    for panel in axes[:, 0]:
        panel.set_ylabel(up)
        if up == DEGREES:
            panel.set_yticks(range(0, 361, 180 if heights and _PANEL * heights[1] < 1.2 else 60))
    for panel in axes[1]:
        panel.set_xlabel(across)
    dot = Line2D([], [], linestyle="", marker=".", color="black", label="end of a backbone")
    wall = Line2D([], [], color=_INK, label="wall")
    figure.legend(handles=[dot, wall], loc="outside lower center", ncols=2)
    figure.colorbar(shades, ax=axes, label="cell volume / mean volume", extend="max", shrink=0.8)
    return figure, axes


def _heights(domain: Tube | Domain) -> tuple[float, float] | None:
    """How high the unrolled basal and apical surface of a tube are, as parts of its length, if both are well seen."""
    if not isinstance(domain, Tube):
        return None
    radii = domain.basal_radius, domain.apical_radius
    basal, apical = (2 * math.pi * float(radius) / float(domain.length) for radius in radii)
    return (basal, apical) if _SEEN[0] <= apical and basal <= _SEEN[1] else None


def _draw_map(panel: Axes, shown: SurfaceMap, colors: UInt8[np.ndarray, "n 4"]) -> None:
    labels = shown.labels
    image = np.concatenate([colors, np.array([_NOTHING], np.uint8)])[labels]
    wall = labels != np.roll(labels, -1, axis=1)
    wall[:, -1] &= shown.goes_on[1]
    beside = labels != np.roll(labels, -1, axis=0)
    beside[-1] &= shown.goes_on[0]
    image[wall | beside] = _WALL
    aspect = "auto" if shown.is_stretched else "equal"
    panel.imshow(image.swapaxes(0, 1), origin="lower", extent=shown.extent, aspect=aspect)
    panel.plot(*shown.ends.T, ".", color="black", markersize=2)
