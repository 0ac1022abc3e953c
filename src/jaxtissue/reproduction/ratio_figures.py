"""Curves against the surface ratio beside the paper's numbers; each function returns (figure, axes).

Tables are those of `ratios`. Bands are one standard deviation over the seeds.
"""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from jaxtissue.reproduction import published
from jaxtissue.reproduction.experiments import THRESHOLDS, Table
from jaxtissue.reproduction.figures import band, where
from jaxtissue.topology.neighbor_law import NeighborLaw

# Okabe and Ito's colors, which color-blind readers tell apart; line styles tell them apart too.
_BLUE, _ORANGE, _GREEN, _PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
TISSUES = {
    "random": ("random", "#777777", ":"),
    "lloyd": ("relaxed by Lloyd's method", _GREEN, "--"),
    "annealed": ("annealed by IS-MH", _BLUE, "-"),
}
WALLS = {
    "apical_basal": ("apical and basal", "#56B4E9", "-"),
    "apical": ("only apical", "#E69F00", "--"),
    "basal": ("only basal", _GREEN, "-."),
    "internal": ("internal", _ORANGE, ":"),
}
_PAPER: dict[str, Any] = {"linestyle": "", "markerfacecolor": "white", "markeredgecolor": "black"}
_RATIO = "surface ratio $R_b / R_a$"


def plot_neighbors(table: Table, law: NeighborLaw | None) -> tuple[Figure, np.ndarray]:
    """Mean number of neighbors against the surface ratio, and the threshold's effect (paper, Fig. 12)."""
    figure, axes = _ratio_panels(table, 2)
    for kind, style in TISSUES.items():
        rows = where(table, kind=kind)
        band(axes[0], rows["ratio"], rows["neighbors"], style[1], style[2], style[0])
    _draw_law(axes[0], table, law)
    _draw_gland(axes[0], published.GLAND.neighbors)
    _draw_thresholds(axes[1], table, "neighbors")
    for panel in axes:
        panel.plot(
            *zip(*published.NEIGHBORS.items(), strict=True),
            "D",
            label="paper, read off its Fig. 12",
            **_PAPER,
        )
        panel.plot(*published.NEIGHBORS_BELOW, "v", label="paper: below 11 at 1000", **_PAPER)
        panel.set_ylabel("mean number of neighbors in 3D")
        panel.legend(fontsize=8)
    axes[0].set_title("All contacts")
    axes[1].set_title("Annealed: which contacts are counted")
    return figure, axes


def plot_transitions(table: Table, law: NeighborLaw | None = None) -> tuple[Figure, np.ndarray]:
    """Mean and largest number of transition points, and scutoids, against the ratio (paper, Fig. 13)."""
    figure, axes = _ratio_panels(table, 3)
    columns = ("transitions", "transitions_max", "scutoid_fraction")
    for kind, (label, color, dashes) in TISSUES.items():
        rows = where(table, kind=kind)
        for panel, column in zip(axes, columns, strict=True):
            scale = 100 if column == "scutoid_fraction" else 1
            band(panel, rows["ratio"], scale * rows[column], color, dashes, label)
    _draw_law(axes[0], table, law)
    _draw_gland(axes[0], published.GLAND.transitions)
    _draw_gland(axes[2], 100 * published.GLAND.scutoid_fraction)
    ratio, fraction = published.SCUTOIDS_ABOVE
    axes[2].plot([ratio, table["ratio"].max()], 2 * [100 * fraction], "k--", lw=1, label="paper: over 90 % from 2 on")
    names = (
        "mean transition points of a cell",
        "largest number of transition points",
        "scutoids (% of the cells)",
    )
    titles = ("Transition points", "The cell with the most", "Scutoids")
    _label_panels(axes, titles, names)
    axes[2].yaxis.set_major_formatter(PercentFormatter())
    return figure, axes


def plot_kinds(table: Table) -> tuple[Figure, np.ndarray]:
    """Neighbors by kind against the ratio, in annealed tissue, and the internal ones (paper, Fig. 15)."""
    figure, axes = _ratio_panels(table, 3)
    rows = where(table, kind="annealed")
    for name, (label, color, dashes) in WALLS.items():
        band(axes[0], rows["ratio"], rows[f"{name}_neighbors"], color, dashes, label)
    _draw_thresholds(axes[1], table, "internal_neighbors")
    _draw_thresholds(axes[2], table, "internal_fraction", 100)
    axes[1].axhline(published.INTERNAL_NEIGHBORS, color="black", ls="--", lw=1, label="paper: about 1 at most")
    ratio, fraction = published.INTERNAL_FRACTION
    axes[2].plot(ratio, 100 * fraction, "D", label="paper: 65 % at 10", **_PAPER)
    titles = (
        "Annealed: neighbors by where they touch",
        "Internal neighbors",
        "Cells with an internal neighbor",
    )
    names = ("mean number of neighbors", "mean number of internal neighbors", "cells (%)")
    _label_panels(axes, titles, names)
    return figure, axes


def _ratio_panels(table: Table, count: int) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(1.5 + 5.2 * count, 5.2), layout="constrained")
    axes = figure.subplots(1, count)
    for panel in axes:
        panel.set(xlabel=_RATIO, xscale="log")
        panel.grid(color="0.92")
        panel.xaxis.set_major_locator(FixedLocator([1.25, 2, 5, 10, 20, 50, 100, 200, 1000]))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
    return figure, axes


def _label_panels(axes: np.ndarray, titles: Sequence[str], names: Sequence[str]) -> None:
    for panel, title, name in zip(axes, titles, names, strict=True):
        panel.set(title=title, ylabel=name, ylim=(0, None))
        panel.legend(fontsize=8)


def _draw_thresholds(axes: Axes, table: Table, name: str, scale: float = 1) -> None:
    """A column of annealed tissue, for each smallest wall that is a contact."""
    rows, colors = where(table, kind="annealed"), mpl.colormaps["viridis"](np.linspace(0, 0.85, 4))
    for threshold, color in zip(THRESHOLDS, colors, strict=True):
        label = f"walls of at least {100 * threshold:g} % of the mean" if threshold else "every wall"
        column = rows[name + (f"_above_{100 * threshold:g}" if threshold else "")]
        band(axes, rows["ratio"], scale * column, color, "-", label)


def _draw_law(axes: Axes, table: Table, law: NeighborLaw | None) -> None:
    if law:
        ratios = np.geomspace(table["ratio"].min(), table["ratio"].max(), 200)
        label = f"logistic law, annealed: {law.low:.2f} to {law.high:.2f}"
        axes.plot(ratios, law.predict(ratios), color="black", lw=1, ls=(0, (6, 2)), label=label)


def _draw_gland(axes: Axes, value: float) -> None:
    low, high = published.GLAND.ratios
    middle = np.sqrt(low * high)
    axes.errorbar(middle, value, xerr=[[middle - low], [high - middle]], fmt="*", ms=11, capsize=3,
                  color=_PURPLE, label="fly salivary gland (2018), range of ratios")  # fmt: skip
