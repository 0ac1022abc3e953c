"""Pictures of whole tubes in three dimensions; each function returns (figure, axes)."""

from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxtissue.geometry.tube import Tube
from jaxtissue.reproduction.shapes import label_section

_VIEW: dict[str, Any] = {"elev": 24, "azim": -52}
_CUT = np.radians([80.0, 200.0])  # the angles between which the tube is cut open, towards the viewer
_WALL = to_rgba("#202020")
_GRID = (720, 320, 32)  # fineness along the axis, around and outwards


def plot_backbones(tube: Tube, positions: Float[np.ndarray, "n 2"]) -> tuple[Figure, Axes3D]:
    """All backbones of a tube, darker where they are nearer to the viewer (paper, Fig. 7)."""
    axial, angle = np.asarray(positions, float).T
    figure = Figure(figsize=(10, 5.6))
    axes = figure.add_subplot(projection="3d")
    radii = [float(tube.apical_radius), float(tube.basal_radius)]
    ends = [np.stack([axial, r * np.cos(angle), r * np.sin(angle)], axis=-1) for r in radii]
    elevation, azimuth = np.radians([_VIEW["elev"], _VIEW["azim"]])
    near = np.cos(elevation) * np.sin(azimuth) * np.cos(angle) + np.sin(elevation) * np.sin(angle)
    colors = mpl.colormaps["Blues"](0.65 + 0.35 * near)
    segments = np.stack(ends, axis=1)[np.argsort(near)]
    bundle = Line3DCollection(list(segments), colors=colors[np.argsort(near)], linewidths=1.1, clip_on=False)
    axes.add_collection3d(bundle)
    turn = np.linspace(0, 2 * np.pi, 121)
    for radius, dashes in zip(radii, ("--", "-"), strict=True):
        for x in (0.0, float(tube.length)):
            circle = _polar(x, radius, turn)
            axes.plot(*circle.T, dashes, color="#D55E00", clip_on=False)
    _frame(axes, tube)
    lines = [Line2D([], [], color="#D55E00", ls=ls, label=f"{name} surface")
             for name, ls in (("basal", "-"), ("apical", "--"))]  # fmt: skip
    lines.append(Line2D([], [], color="#2171B5", label="backbone, darker towards the viewer"))
    figure.legend(handles=lines, loc="lower center", ncols=3)
    axes.set_title(f"{len(axial)} backbones", y=1.08)
    return figure, axes


def plot_tube(tube: Tube, positions: Float[np.ndarray, "n 2"]) -> tuple[Figure, Axes3D]:
    """The cells of a tube that is cut open, so that their height shows (paper, Fig. 8).

    Each cell has one color on the basal surface outside, on the apical one within, and on the cuts.
    """
    place = np.asarray(positions, float)
    figure = Figure(figsize=(11, 6.2))
    axes = figure.add_subplot(projection="3d")
    inner, outer, length = (float(v) for v in (tube.apical_radius, tube.basal_radius, tube.length))
    x, heights = np.linspace(0, length, _GRID[0] + 1), np.linspace(inner, outer, _GRID[2] + 1)
    kept = np.linspace(_CUT[1], _CUT[0] + 2 * np.pi, _GRID[1] + 1)
    quads, colors = [], []

    def add(labels: Int[np.ndarray, "rows columns"], corner: Callable, shade: float) -> None:
        shown, label = _quilt(labels, corner)
        paint = np.where((label < 0)[:, None], _WALL, _cell_colors(len(place))[label])
        quads.append(shown)
        colors.append(paint * [shade, shade, shade, 1])

    for radius, shade in ((outer, 1.0), (inner, 0.8)):
        labels = label_section(place, tube, radius, _middles(x), _middles(kept))
        add(labels, lambda row, column, r=radius: _polar(x[column], r, kept[row]), shade)
    for turn in _CUT:
        rows = [label_section(place, tube, r, _middles(x), np.array([turn]))[0] for r in _middles(heights)]
        cut = np.stack(rows)
        add(cut, lambda row, column, t=turn: _polar(x[column], heights[row], t), 0.92)
    rows = [label_section(place, tube, r, np.array([length]), _middles(kept))[:, 0] for r in _middles(heights)]
    end = np.stack(rows, axis=1)
    add(end, lambda row, column: _polar(length, heights[column], kept[row]), 0.92)
    paint = np.concatenate(colors)
    sheets = Poly3DCollection(np.concatenate(quads), fc=paint, ec=paint, linewidths=0.25, clip_on=False)
    axes.add_collection3d(sheets)
    _frame(axes, tube)
    axes.set_title(f"{len(place)} cells; the tube is cut open: basal surface outside, apical surface within", y=1.08)
    return figure, axes


def _cell_colors(count: int) -> Float[np.ndarray, "n 4"]:
    """Light colors, shuffled, so that neighbors mostly differ; the walls tell them apart in any case."""
    shades = mpl.colormaps["YlGnBu"](np.linspace(0.08, 0.62, 9))
    return shades[np.random.default_rng(0).integers(len(shades), size=count)]


def _quilt(labels: Int[np.ndarray, "rows columns"], corner: Callable) -> tuple[np.ndarray, np.ndarray]:
    """Quadrilaterals of equal label along each row, and their labels, -1 for walls, in front of the others.

    `corner` gives the places of grid points from arrays of their rows and columns.
    """
    shown = np.where(_is_wall(labels), -1, labels)
    change = np.ones(shown.shape, bool)
    change[:, 1:] = (shown[:, 1:] != shown[:, :-1]) | (np.arange(1, shown.shape[1]) % 12 == 0)
    row, first = np.nonzero(change)
    last = np.append(first[1:], 0)
    last[last == 0] = shown.shape[1]
    corners = (corner(row, first), corner(row, last), corner(row + 1, last), corner(row + 1, first))
    return np.stack(corners, axis=1), shown[row, first]


def _is_wall(labels: Int[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    wall = np.zeros(labels.shape, bool)
    wall[:, :-1] |= labels[:, 1:] != labels[:, :-1]
    wall[:-1] |= labels[1:] != labels[:-1]
    return wall


def _polar(axial: np.ndarray | float, radius: np.ndarray | float, turn: np.ndarray | float) -> np.ndarray:
    x, r, t = np.broadcast_arrays(axial, radius, turn)
    return np.stack([x, r * np.cos(t), r * np.sin(t)], axis=-1)


def _middles(edges: Float[np.ndarray, " k+1"]) -> Float[np.ndarray, " k"]:
    return (edges[1:] + edges[:-1]) / 2


def _frame(axes: Axes3D, tube: Tube) -> None:
    length, radius = float(tube.length), float(tube.basal_radius)
    axes.set(xlim=(0, length), ylim=(-radius, radius), zlim=(-radius, radius))
    look: dict[str, Any] = {
        "aspect": (length, 2 * radius, 2 * radius),
        "zoom": min(1.25, 0.7 + 0.14 * length / radius),
    }
    axes.set_box_aspect(**look)
    directions: list[Any] = [axes.xaxis, axes.yaxis, axes.zaxis]
    axes.set(xlabel="x, along the axis (length units)", ylabel="y (length units)", zlabel="z (length units)")
    for axis in directions:
        axis.set_pane_color((1, 1, 1, 0))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.zaxis.set_major_locator(MaxNLocator(4))
    axes.xaxis.labelpad = 14
    axes.view_init(**_VIEW)
