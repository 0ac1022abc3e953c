"""The shape of one cell, and of sections through all of them, for pictures."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.edges import EdgeGraph

APICAL, BASAL, LEFT, RIGHT = -1, -2, -3, -4  # what is behind a wall that is none between cells


class Section(NamedTuple):
    """A cell on lines parallel to the axis at one radius: where each is entered and left, and the cells beyond."""

    lower: Float[np.ndarray, " lines"]  # not below `upper` where the line misses the cell
    upper: Float[np.ndarray, " lines"]
    below: Int[np.ndarray, " lines"]  # the neighbor, or LEFT or RIGHT at the tube's ends
    above: Int[np.ndarray, " lines"]


class CellShape(NamedTuple):
    """The surface of a cell as quadrilaterals, and what lies behind each: a cell, APICAL, BASAL, LEFT, RIGHT.

    The frame has its origin on the axis under a backbone: x along the axis, y around, z outwards. With
    corners a, b, c, d the vector (c - a) x (d - b) points out of the cell.
    """

    corners: Float[np.ndarray, "quads 4 3"]
    behind: Int[np.ndarray, " quads"]


def cut_cell(positions: Float[np.ndarray, "n 2"], tube: Tube, cell: int, radius: float, offsets: np.ndarray) -> Section:
    """A cell on the lines at one radius and at angular offsets from its backbone.

    With h = r cos(t - t_j) and s = max(h, R_a), d_j^2 = (x - x_j)^2 + g_j, g_j = r^2 - s (2 h - s), so that
    d_i <= d_j bounds x on one side: every line holds one interval of the cell.

    >>> section = cut_cell(np.array([[2.0, 0.0], [6.0, 0.0]]), Tube(8, 1, 2), 0, 1.5, np.zeros(1))
    >>> section.lower.tolist(), section.upper.tolist(), section.above.tolist()
    ([0.0], [4.0], [1])
    """
    axial, angle = np.asarray(positions, float).T
    length = float(tube.length)
    height = radius * np.cos(angle[cell] + offsets[:, None] - angle)
    foot = np.maximum(height, float(tube.apical_radius))
    square = radius**2 - foot * (2 * height - foot)
    gap, excess = axial - axial[cell], square - square[:, [cell]]
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = (axial + axial[cell]) / 2 + excess / (2 * gap)
    beaten = ((gap == 0) & (excess < 0)).any(axis=1)
    over = np.where(gap > 0, meets, np.inf)
    under = np.where(gap < 0, meets, -np.inf)
    above, below = over.argmin(axis=1), under.argmax(axis=1)
    upper, lower = over.min(axis=1), under.max(axis=1)
    above, below = np.where(upper > length, RIGHT, above), np.where(lower < 0, LEFT, below)
    upper, lower = np.minimum(upper, length), np.maximum(lower, 0)
    return Section(lower, np.where(beaten, lower - 1, upper), below, above)


def shape_cell(
    positions: Float[np.ndarray, "n 2"],
    tube: Tube,
    cell: int,
    frame: int | None = None,
    layers: int = 80,
    across: int = 100,
) -> CellShape:
    """The surface of a cell, from sections at `layers` radii of `across` lines each.

    It is given in the frame of its backbone, or of that of the cell `frame`. Detached pieces are left out; a
    cell that wraps round the lumen is cut open on its far side.
    """
    radii = np.linspace(float(tube.apical_radius), float(tube.basal_radius), layers)
    share = (1 - np.cos(np.linspace(0, np.pi, across))) / 2
    axial, turn = np.asarray(positions[cell], float) - positions[cell if frame is None else frame]
    rims, seen = [], []
    for radius in radii:
        first, last = _angular_reach(positions, tube, cell, radius)
        offsets = first + (last - first) * share
        section = cut_cell(positions, tube, cell, radius, offsets)
        middle = (section.lower + section.upper) / 2
        rim = np.minimum(section.lower, middle), np.maximum(section.upper, middle)
        around = radius * np.sin(turn + offsets), radius * np.cos(turn + offsets)
        rims.append([np.stack([x - positions[cell, 0] + axial, *around], axis=-1) for x in rim])
        tips = [_beside(positions, tube, cell, radius, (middle[i], offsets[i])) for i in (0, -1)]
        seen.append((section.below, section.above, tips))
    rim = np.array(rims)
    below, above, tips = (np.array(part) for part in zip(*seen, strict=True))
    outer = np.arange(across - 1) + (np.arange(across - 1) >= across // 2)  # the end that is nearer to a tip
    corners, labels = [_quads(rim[:, 0])[:, ::-1], _quads(rim[:, 1])], [below[:-1, outer], above[:-1, outer]]
    for tip, way in ((0, 1), (-1, -1)):  # a wall nearly along the axis closes the section between two lines
        corners.append(_quads(rim[:, :, tip])[:, ::way])
        labels.append(tips[:-1, tip])
    labels = [part.ravel() for part in labels]
    for layer, surface, way in ((0, APICAL, 1), (-1, BASAL, -1)):
        strip = _quads(rim[layer, 0] + np.linspace(0, 1, 9)[:, None, None] * np.subtract(*rim[layer, ::-1]))
        corners.append(strip[:, ::way])
        labels.append(np.full(len(strip), surface))
    return CellShape(np.concatenate(corners), np.concatenate(labels))


def cell_edges(
    edges: EdgeGraph,
    positions: Float[np.ndarray, "n 2"],
    cell: int,
    frame: int | None = None,
    steps: int = 5,
) -> Float[np.ndarray, "lines steps+1 3"]:
    """The edges of a cell as short curves, in the frame of its backbone, or of that of the cell `frame`."""
    own = (edges.edge_labels[edges.segment_edge] == cell).any(axis=1)
    first, last = edges.points[own, 0], edges.points[own, 1]
    chord = last - first
    slopes = []
    for tangent in (edges.tangents[own, 0], edges.tangents[own, 1]):
        along = np.sign((tangent * chord).sum(axis=1, keepdims=True))
        slopes.append(tangent * along * np.linalg.norm(chord, axis=1, keepdims=True))
    s = np.linspace(0, 1, steps + 1)[:, None]
    curve = (2 * s**3 - 3 * s**2 + 1) * first[:, None] + (3 * s**2 - 2 * s**3) * last[:, None]
    curve += (s**3 - 2 * s**2 + s) * slopes[0][:, None] + (s**3 - s**2) * slopes[1][:, None]
    return to_cell_frame(curve, positions[cell if frame is None else frame])


def to_cell_frame(points: Float[np.ndarray, "... 3"], position: np.ndarray) -> Float[np.ndarray, "... 3"]:
    """Points of the tube's frame in the frame of a backbone: x along the axis, y around, z outwards."""
    axial, angle = (float(value) for value in position)
    x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([x - axial, z * cosine - y * sine, y * cosine + z * sine], axis=-1)


def _angular_reach(positions: Float[np.ndarray, "n 2"], tube: Tube, cell: int, radius: float) -> tuple[float, float]:
    """The offsets from which to which a cell reaches around its backbone, at most half a turn each way."""
    reach, grid = [], np.linspace(0, np.pi, 241)
    for side in (-1, 1):
        section = cut_cell(positions, tube, cell, radius, side * grid)
        missed = np.flatnonzero(section.lower >= section.upper)
        if not len(missed) or missed[0] == 0:
            reach.append(0.0 if len(missed) else side * np.pi)
            continue
        inside, outside = grid[missed[0] - 1], grid[missed[0]]
        for _ in range(4):
            finer = np.linspace(inside, outside, 17)
            section = cut_cell(positions, tube, cell, radius, side * finer)
            out = max(1, int(np.argmax(section.lower >= section.upper)))
            inside, outside = finer[out - 1], finer[out]
        reach.append(side * inside)
    return reach[0], reach[1]


def _beside(
    positions: Float[np.ndarray, "n 2"], tube: Tube, cell: int, radius: float, place: tuple[float, float]
) -> int:
    """The nearest other cell at an axial place and an offset from a cell's backbone."""
    axial, angle = np.asarray(positions, float).T
    height = radius * np.cos(angle[cell] + place[1] - angle)
    foot = np.maximum(height, float(tube.apical_radius))
    square = (place[0] - axial) ** 2 - foot * (2 * height - foot)
    square[cell] = np.inf
    return int(square.argmin())


def _quads(grid: Float[np.ndarray, "rows columns 3"]) -> Float[np.ndarray, "quads 4 3"]:
    corners = (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def label_section(
    positions: Float[np.ndarray, "n 2"],
    tube: Tube,
    radius: float,
    axial: Float[np.ndarray, " columns"],
    angle: Float[np.ndarray, " rows"],
) -> Int[np.ndarray, "rows columns"]:
    """The cells at one radius, on a grid of axial places and angles.

    >>> two, axial = np.array([[1.0, 0.0], [3.0, 0.0]]), np.arange(4) + 0.5
    >>> label_section(two, Tube(4, 1, 2), 1.5, axial, np.zeros(1)).tolist()
    [[0, 0, 1, 1]]
    """
    x, turn = np.meshgrid(axial, angle)
    points = np.stack([x, radius * np.cos(turn), radius * np.sin(turn)], axis=-1)
    return label_points(points, positions, tube).reshape(x.shape)
