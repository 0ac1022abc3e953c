"""The map of a layer of a closed surface from the nearest backbones of many of its points.

Slower than by polygons, but no matter how much walls bend. The points are the corners of triangles. Where the corners
of one have three labels, cells meet; from there triangles with two labels lead along each wall to its other end. Walls
shorter than a triangle may be missed or made up: the junctions are put right afterwards, by flips.
"""

import math

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from jaxtissue.topology.junctions import Junctions, joined
from jaxtissue.topology.layer_gaps import LayerGaps

APART = 0.02  # of a cell: a part of it that is larger is a piece of it
FEWEST = 3  # cells of a closed surface, all disks, of which three meet somewhere
POINTS = 300, 600, 1200  # of each cell: the more the smaller the parts of cells that are seen apart


def sampled_map(gaps: LayerGaps, height: float) -> Junctions:
    """The junctions of a layer over a sphere, near to where they are.

    Raises `ValueError`, naming a cell, unless each cell is a disk.
    """
    wrong = ""
    for count in POINTS:
        place = _spread(count * gaps.count)
        hull = ConvexHull(place)
        point = gaps.look(place, np.zeros((len(place), 2)), np.full(len(place), height)).point
        label, wrong = _whole(gaps.crowd.nearest(point) % gaps.count, hull.simplices)
        wrong = wrong or _no_disk(gaps.count, label, hull.simplices)
        if not wrong and gaps.count < FEWEST:
            wrong = f"no three of the {gaps.count} cells meet"
        if not wrong:
            return _junctions(place, label, hull)
    raise ValueError(f"contacts can't be found: at height {height:g} {wrong}; use more cells")


def _spread(count: int) -> Float[np.ndarray, "p 3"]:
    """Points spread evenly over the sphere, on a spiral by the golden angle."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, math.pi * (3 - math.sqrt(5)) * number
    width = np.sqrt(1 - z**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), z], axis=1)


def _whole(label: Int[np.ndarray, " p"], triangles: Int[np.ndarray, "t 3"]) -> tuple[Int[np.ndarray, " p"], str]:
    """The cells without small parts apart, which sharp corners seem to have; also what is wrong with a larger part."""
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    inner = ends[label[ends[:, 0]] == label[ends[:, 1]]]
    shape = (len(label), len(label))
    part = connected_components(sparse.coo_array((np.ones(len(inner), bool), tuple(inner.T)), shape=shape), False)[1]
    size, owner = np.bincount(part), np.zeros(part.max() + 1, int)
    owner[part] = label
    largest = np.zeros(label.max() + 1, int)
    np.maximum.at(largest, owner, size)
    main = np.zeros(label.max() + 1, int)
    main[owner[size == largest[owner]]] = np.flatnonzero(size == largest[owner])
    apart = np.flatnonzero((main[owner] != np.arange(len(owner))) & (size > APART * largest[owner]))
    if len(apart):
        return label, f"cell {owner[apart[0]]} is in several pieces"
    label, stray = label.copy(), part != main[label]
    ends = np.concatenate([ends, ends[:, ::-1]])
    while stray.any():
        some = ends[stray[ends[:, 0]] & ~stray[ends[:, 1]]]
        label[some[:, 0]], stray[some[:, 0]] = label[some[:, 1]], False
    return label, ""


def _no_disk(n: int, label: Int[np.ndarray, " p"], triangles: Int[np.ndarray, "t 3"]) -> str:
    """What is wrong with a cell that is no disk, as points - sides + triangles of one are 1; nothing where all are."""
    corners = label[triangles]
    same = corners == np.roll(corners, -1, axis=1)
    points, sides = np.bincount(label, minlength=n), np.bincount(corners[same], minlength=n) // 2
    euler = points - sides + np.bincount(corners[same.all(axis=1), 0], minlength=n)
    for cell in np.flatnonzero(euler != 1):
        if not points[cell]:
            return f"cell {cell} is not found"
        return f"cell {cell} is {f'in {euler[cell]} pieces' if euler[cell] > 1 else 'a ring'}, or nearly so"
    return ""


def _junctions(place: Float[np.ndarray, "p 3"], label: Int[np.ndarray, " p"], hull: ConvexHull) -> Junctions:
    """The junctions of cells that all are disks."""
    corner, beside = hull.simplices.copy(), hull.neighbors.copy()
    inward = np.linalg.det(place[corner]) < 0  # all are to be counterclockwise, as seen from outside
    corner[inward], beside[inward] = corner[inward][:, [0, 2, 1]], beside[inward][:, [0, 2, 1]]
    labels = label[corner]
    is_meeting = (labels != np.roll(labels, -1, axis=1)).all(axis=1)
    rows = np.flatnonzero(is_meeting)
    number = {row: k for k, row in enumerate(rows.tolist())}
    neighbors, names, twins = beside.tolist(), labels.tolist(), {}
    for first, row in enumerate(rows.tolist()):
        for side in range(3):
            at, out = row, side
            while True:
                at, before = neighbors[at][out], at
                back = neighbors[at].index(before)
                if at in number:
                    twins[3 * first + side] = 3 * number[at] + back
                    break
                # out between the corner that lies ahead and the other one that has not its label
                out = next(k for k in range(3) if k != back and names[at][k] == names[at][back])
    ways = 3 * np.arange(len(rows))[:, None] + [2, 0, 1]
    junctions = joined(labels[rows], ways, twins)
    middle = place[corner[rows]].mean(axis=1)
    junctions.place = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    return junctions
