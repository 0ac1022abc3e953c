"""Pictures of single cells in three dimensions; each function returns (figure, axes)."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxtissue.geometry.tube import Tube
from jaxtissue.reproduction.shapes import (
    APICAL,
    BASAL,
    CellShape,
    cell_edges,
    label_section,
    shape_cell,
    to_cell_frame,
)
from jaxtissue.topology.edges import EdgeGraph

# Okabe and Ito's colors, which color-blind readers tell apart.
KIND_COLORS = {"apical_basal": "#56B4E9", "apical": "#E69F00", "basal": "#009E73", "internal": "#D55E00"}
KIND_LABELS = {
    "apical_basal": "apical and basal",
    "apical": "only apical",
    "basal": "only basal",
    "internal": "internal",
}
_CAP, _END, _EDGE, _PAIR = "#F2F2F2", "#999999", "#202020", ("#56B4E9", "#E69F00")


class View(NamedTuple):
    """From where a cell is seen, in degrees."""

    elevation: float = 16
    azimuth: float = -58

    @property
    def toward(self) -> Float[np.ndarray, "3"]:
        """The unit vector to the viewer."""
        elevation, azimuth = np.radians(self)
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def plot_cell_in_tissues(
    tube: Tube, cell: int, tissues: Sequence[tuple[str, Float[np.ndarray, "n 2"], EdgeGraph]]
) -> tuple[Figure, np.ndarray]:
    """One cell in several tissues, each with its title, positions and edges, at one scale (paper, Fig. 5)."""
    figure = Figure(figsize=(4.6 * len(tissues), 5.6), layout="constrained")
    axes = figure.subplots(1, len(tissues), subplot_kw={"projection": "3d"}, squeeze=False)[0]
    shapes, heights = [], [float(tube.apical_radius), float(tube.basal_radius)]
    for panel, (title, positions, edges) in zip(axes, tissues, strict=True):
        place = np.asarray(positions, float)
        shapes.append(shape_cell(place, tube, cell))
        _draw(panel, [(shapes[-1], {}, _PAIR[0])], cell_edges(edges, place, cell))
        panel.plot([0, 0], [0, 0], heights, "--", color="#D55E00", lw=2, zorder=10)
        panel.set_title(title, y=1.03)
    for panel in axes:
        _frame(panel, np.concatenate([shape.corners for shape in shapes]))
    backbone = Line2D([], [], color="#D55E00", lw=2, ls="--", label="backbone, within the cell")
    marks = [backbone, Line2D([], [], color=_EDGE, label="edge of the cell")]
    figure.legend(handles=[*marks, Patch(fc=_CAP, ec=_EDGE, label="basal surface")],
                  loc="outside lower center", ncols=3)  # fmt: skip
    return figure, axes


def plot_scutoid(
    tube: Tube,
    positions: Float[np.ndarray, "n 2"],
    cell: int,
    kinds: Mapping[int, str],
    corners: tuple[EdgeGraph, Float[np.ndarray, "k 3"]],
) -> tuple[Figure, list[Axes]]:
    """A cell from two sides and its wall unrolled, colored by the `kinds` of its neighbors (paper, Fig. 14).

    `corners` are the edges of the tissue and the transition points of the cell.
    """
    place, (edges, points) = np.asarray(positions, float), corners
    figure = Figure(figsize=(12.5, 5.6), layout="constrained")
    figure.set_layout_engine("constrained", w_pad=0.15)
    grid = figure.add_gridspec(1, 3, width_ratios=[1, 1, 1.15])
    solids = [figure.add_subplot(grid[0, i], projection="3d") for i in (0, 1)]
    shape, lines = shape_cell(place, tube, cell), cell_edges(edges, place, cell)
    local = to_cell_frame(points, place[cell])
    colors = {other: KIND_COLORS[kind] for other, kind in kinds.items()}
    for panel, azimuth, side in zip(solids, (-58, 122), ("one", "the other"), strict=True):
        view = View(azimuth=azimuth)
        _draw(panel, [(shape, colors, _END)], lines, view)
        _frame(panel, shape.corners)
        panel.set_title(f"seen from {side} side")
    unrolled = figure.add_subplot(grid[0, 2])
    _draw_unrolled(unrolled, shape, colors, lines, local)
    shown = [kind for kind in KIND_COLORS if kind in kinds.values()]
    marks: list[Any] = [Patch(color=KIND_COLORS[kind], label=f"{KIND_LABELS[kind]} neighbor") for kind in shown]
    marks += [Patch(fc=_CAP, ec=_EDGE, label="basal surface")]
    dot = Line2D([], [], ls="", marker="o", color="black", markerfacecolor="white", label="transition point")
    figure.legend(handles=[*marks, dot], loc="outside lower center", ncols=3)
    figure.suptitle(f"A scutoid with {len(points)} transition points")
    return figure, [*solids, unrolled]


def plot_internal_pair(
    tube: Tube, positions: Float[np.ndarray, "n 2"], pair: tuple[int, int], radius: float, edges: EdgeGraph
) -> tuple[Figure, list[Axes]]:
    """Two cells that touch at `radius` but on neither surface: sections and the cells (paper, Fig. 16)."""
    place = np.asarray(positions, float)
    figure = Figure(figsize=(9.6, 9), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    places = {"basal surface": float(tube.basal_radius), "where they touch": radius}
    places["apical surface"] = float(tube.apical_radius)
    panels = [figure.add_subplot(grid[number // 2, number % 2]) for number in range(3)]
    for panel, (title, at) in zip(panels, places.items(), strict=True):
        _draw_section(panel, tube, place, pair, at)
        panel.set_title(f"{title}, {at:.3g} from the axis")
    solid = figure.add_subplot(grid[1, 1], projection="3d")
    shapes = [shape_cell(place, tube, cell, frame=pair[0]) for cell in pair]
    lines = np.concatenate([cell_edges(edges, place, cell, frame=pair[0]) for cell in pair])
    middle = [shape.corners.reshape(-1, 3).mean(axis=0) for shape in shapes]
    apart = np.subtract(*middle)
    view = View(azimuth=float(np.degrees(np.arctan2(apart[1], apart[0]))) - 75)
    _draw(solid, [(shape, {}, color) for shape, color in zip(shapes, _PAIR, strict=True)], lines, view)
    _frame(solid, np.concatenate([shape.corners for shape in shapes]))
    solid.set_title("the two cells", y=0.97)
    marks = [Patch(fc=color, ec=_EDGE, label=f"cell {cell}") for cell, color in zip(pair, _PAIR, strict=True)]
    figure.legend(handles=marks, loc="outside lower center", ncols=2)
    figure.suptitle("Internal neighbors: they touch between the surfaces only")
    return figure, [*panels, solid]


def _draw(
    axes: Axes3D,
    cells: Sequence[tuple[CellShape, Mapping[int, Any], Any]],
    lines: Float[np.ndarray, "lines points 3"],
    view: View = View(),  # noqa: B008
) -> None:
    """Shaded cells, each with the colors of what lies behind its walls and one for the rest.

    The lines are ribbons among the faces, put a little nearer to the viewer: so cells hide those behind them.
    """
    painted = [_paint(shape, colors, rest, view) for shape, colors, rest in cells]
    corners = np.concatenate([shape.corners for shape, *_ in cells])
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    first, last = lines[:, :-1].reshape(-1, 3), lines[:, 1:].reshape(-1, 3)
    aside = np.cross(last - first, view.toward)
    aside *= 0.0035 * size / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-30)
    ribbons = np.stack([first - aside, first + aside, last + aside, last - aside], axis=1)
    ribbons += 0.02 * size * view.toward
    colors = np.concatenate([*painted, np.tile(to_rgba(_EDGE), (len(ribbons), 1))])
    axes.add_collection3d(Poly3DCollection(np.concatenate([corners, ribbons]), fc=colors, ec=colors, linewidths=0.3))
    axes.view_init(elev=view.elevation, azim=view.azimuth)


def _paint(shape: CellShape, colors: Mapping[int, Any], rest: Any, view: View) -> np.ndarray:
    faces = np.array([to_rgba(colors.get(int(label), rest if label >= 0 else _CAP)) for label in shape.behind])
    corner = np.moveaxis(shape.corners, 1, 0)
    normal = np.cross(corner[2] - corner[0], corner[3] - corner[1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    sun = View(view.elevation + 25, view.azimuth - 35).toward
    faces[:, :3] *= 0.87 + 0.13 * (normal @ sun)[:, None]
    return faces


def _draw_unrolled(
    axes: Axes, shape: CellShape, colors: Mapping[int, Any], lines: np.ndarray, points: np.ndarray
) -> None:
    """The wall of a cell by the direction round its backbone; what lies over the cut is drawn twice."""

    def unrolled(place: np.ndarray) -> np.ndarray:
        turn = np.degrees(np.arctan2(place[..., 1], place[..., 0]))
        return np.stack([turn, np.hypot(place[..., 1], place[..., 2])], axis=-1)

    def both(pieces: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        over = np.ptp(pieces[..., 0], axis=1) > 180
        right = pieces[over] + np.where(pieces[over][..., :1] < 0, [360, 0], 0)
        return np.concatenate([pieces[~over], right, right - [360, 0]]), np.concatenate(
            [parts[~over], parts[over], parts[over]]
        )

    wall = ~np.isin(shape.behind, (APICAL, BASAL))
    flat, behind = both(unrolled(shape.corners[wall]), shape.behind[wall])
    strokes, _ = both(unrolled(lines), np.arange(len(lines)))
    shades = [to_rgba(colors.get(int(label), _END)) for label in behind]
    axes.add_collection(PolyCollection(list(flat), fc=shades, ec=shades, linewidths=0.4))
    axes.add_collection(LineCollection(list(strokes), colors=_EDGE, linewidths=1.2))
    axes.plot(*unrolled(points).T, "o", color="black", markerfacecolor="white", zorder=5)
    radii = np.linalg.norm(shape.corners[..., 1:], axis=-1)
    spare = 0.03 * np.ptp(radii)
    axes.set(xlim=(-180, 180), ylim=(radii.min() - spare, radii.max() + spare), title="its wall, unrolled")
    axes.set(xlabel="direction round the backbone (degrees)", ylabel="distance from the axis (length units)")
    axes.set_xticks(range(-180, 181, 90))


def _draw_section(axes: Axes, tube: Tube, place: np.ndarray, pair: tuple[int, int], radius: float) -> None:
    """The cells around a pair at one radius, seen from outside, the pair in color."""
    (first, turn), (second, other) = place[pair[0]], place[pair[1]]
    apart = (other - turn + np.pi) % (2 * np.pi) - np.pi
    width = 2.2 * np.sqrt(2 * np.pi * float(tube.length) * float(tube.basal_radius) / len(place))
    center, middle = (first + second) / 2, turn + apart / 2
    axial = np.linspace(max(center - 1.2 * width, 0), min(center + 1.2 * width, float(tube.length)), 480)
    half = min(width, np.pi * radius)
    around = np.linspace(-half, half, 400)
    labels = label_section(place, tube, radius, axial, middle + around / radius)
    image = np.full((*labels.shape, 4), to_rgba("#E8E8E8"))
    for cell, color in zip(pair, _PAIR, strict=True):
        image[labels == cell] = to_rgba(color)
    axes.imshow(image, origin="lower", extent=(axial[0], axial[-1], -half, half), aspect="equal")
    for cell in np.unique(labels):
        row, column = (slice(max(at.min() - 1, 0), at.max() + 2) for at in np.nonzero(labels == cell))
        inside = labels[row, column] == cell
        if min(inside.shape) > 1:
            axes.contour(axial[column], around[row], inside, levels=[0.5], colors=_EDGE, linewidths=0.8)
    axes.set(xlim=(axial[0], axial[-1]), ylim=(-width, width))
    axes.set(xlabel="along the axis (length units)", ylabel="around the tube (length units)")


def _frame(axes: Axes3D, corners: Float[np.ndarray, "... 3"]) -> None:
    """Equal scales round all corners, and the names of the directions."""
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    spare = 0.04 * (high - low).max()
    for name, first, last in zip("xyz", low - spare, high + spare, strict=True):
        getattr(axes, f"set_{name}lim")(first, last)
    look: dict[str, Any] = {"aspect": high - low + 2 * spare, "zoom": 0.96}
    axes.set_box_aspect(**look)
    directions: list[Any] = [axes.xaxis, axes.yaxis, axes.zaxis]
    labels = ("along the axis", "around", "from the axis (all in length units)")
    for axis, label in zip(directions, labels, strict=True):
        axis.set_label_text(label, fontsize=9)
        axis.set_major_locator(MaxNLocator(4))
        axis.set_pane_color((1, 1, 1, 0))
    axes.tick_params(labelsize=8, pad=0)
