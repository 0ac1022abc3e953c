"""The map of a layer from the nearest backbones of many of its points.

Slower than by polygons, but no matter how much walls bend. The points are the corners of triangles. Where the corners
of one have three labels, cells meet; from there triangles with two labels lead along each wall to its other end. Walls
shorter than a triangle may be missed or made up: the junctions are put right afterwards, by flips.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from jaxtissue.topology.junctions import Junctions, joined
from jaxtissue.topology.layer_gaps import LayerGaps

APART = 0.02  # of a cell: a part of it that is larger is a piece of it
POINTS = 300, 600, 1200  # of each cell: the more the smaller the parts of cells that are seen apart


class _Mesh(NamedTuple):
    """Triangles over a base surface: their corners, counterclockwise from outside, and their middles.

    The corners beyond free ends have the number of their limit, all others -1.
    """

    place: Float[np.ndarray, "p d"]
    limit: Int[np.ndarray, " p"]
    corner: Int[np.ndarray, "t 3"]
    middle: Float[np.ndarray, "t d"]


def sampled_map(gaps: LayerGaps, height: float) -> Junctions:
    """The junctions of a layer, near to where they are.

    Raises `ValueError`, naming a cell, unless each cell is a disk.
    """
    wrong = ""
    for count in POINTS:
        mesh = _ball(count * gaps.count) if gaps.extent is None else _sheet(gaps, count * gaps.count, height)
        point = gaps.look(mesh.place, np.zeros((len(mesh.place), 2)), np.full(len(mesh.place), height)).point
        label = np.where(mesh.limit < 0, gaps.crowd.nearest(point) % gaps.count, gaps.count + mesh.limit)
        label, part = _parts(label, mesh.corner)
        wrong = _no_disk(gaps.count, label, part, mesh.corner)
        if not wrong and not _is_meeting(label[mesh.corner]).any():
            wrong = f"no three of the {gaps.count} cells meet"
        if not wrong:
            return _junctions(label, mesh)
    told = f"contacts can't be found: at height {height:g} {wrong}"
    raise ValueError(f"{told}; use more cells, or a Tube, where cells may wrap around the lumen")


def _ball(count: int) -> _Mesh:
    """Triangles between points spread evenly over the sphere, on a spiral by the golden angle."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, math.pi * (3 - math.sqrt(5)) * number
    width = np.sqrt(1 - z**2)
    place = np.stack([width * np.cos(turn), width * np.sin(turn), z], axis=1)
    corner = ConvexHull(place).simplices.copy()
    inward = np.linalg.det(place[corner]) < 0
    corner[inward] = corner[inward][:, [0, 2, 1]]
    middle = place[corner].mean(axis=1)
    return _Mesh(place, np.full(count, -1), corner, middle / np.linalg.norm(middle, axis=1, keepdims=True))


def _sheet(gaps: LayerGaps, count: int, height: float) -> _Mesh:
    """Triangles of a grid over the rectangle, whose steps are about as long in both directions, and one step more."""
    assert gaps.extent is not None
    spots = gaps.look(gaps.apical, np.zeros((gaps.count, 2)), np.full(gaps.count, height))
    size = gaps.extent * np.linalg.norm(spots.columns[..., :2], axis=1).mean(axis=0)
    steps = np.maximum(np.ceil(size / math.sqrt(size.prod() / count)).astype(int), 3)
    free = gaps.is_free.astype(int)
    number = np.stack(np.meshgrid(*map(np.arange, steps + 2 * free), indexing="ij"), axis=-1)
    place = (number + 0.5 - free) / steps * gaps.extent
    limit = np.full(number.shape[:2], -1)
    for way in np.flatnonzero(free):
        limit = np.where(number[..., way] == 0, way, np.where(number[..., way] > steps[way], 2 + way, limit))
    low = number[: len(number) - free[0], : number.shape[1] - free[1]]
    at = [np.ravel_multi_index(tuple(np.moveaxis(low + way, -1, 0)), number.shape[:2], mode="wrap").ravel()
          for way in ([0, 0], [1, 0], [1, 1], [0, 1])]  # fmt: skip
    corner = np.concatenate([np.stack([at[0], at[1], at[2]], axis=1), np.stack([at[0], at[2], at[3]], axis=1)])
    first = place.reshape(-1, 2)[at[0]]
    middle = np.concatenate([first + np.array(way) / steps * gaps.extent for way in ([2 / 3, 1 / 3], [1 / 3, 2 / 3])])
    inside = np.where(gaps.is_free, np.clip(middle, 0, gaps.extent), middle)
    return _Mesh(np.clip(place.reshape(-1, 2), 0, gaps.extent), limit.ravel(), corner, gaps.wrapped(inside))


def _is_meeting(labels: Int[np.ndarray, "t 3"]) -> Bool[np.ndarray, " t"]:
    """Which triangles have three labels."""
    return (labels != np.roll(labels, -1, axis=1)).all(axis=1)


def _beside(corner: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "t 3"]:
    """The triangle beyond the side opposite each corner; -1 where there is none."""
    ends = np.sort(np.stack([corner[:, [1, 2]], corner[:, [2, 0]], corner[:, [0, 1]]], axis=1), axis=2).reshape(-1, 2)
    key = ends @ [corner.max() + 1, 1]
    order = np.argsort(key)
    same = np.flatnonzero(np.diff(key[order]) == 0)
    first, second = order[same], order[same + 1]
    beside = np.full(corner.size, -1)
    beside[first], beside[second] = second // 3, first // 3
    return beside.reshape(-1, 3)


def _parts(label: Int[np.ndarray, " p"], triangles: Int[np.ndarray, "t 3"]) -> tuple[np.ndarray, np.ndarray]:
    """The labels without small parts apart, which sharp corners seem to have, and the number of each point's part."""
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    inner = ends[label[ends[:, 0]] == label[ends[:, 1]]]
    shape = (len(label), len(label))
    part = connected_components(sparse.coo_array((np.ones(len(inner), bool), tuple(inner.T)), shape=shape), False)[1]
    size, owner = np.bincount(part), np.zeros(part.max() + 1, int)
    owner[part] = label
    largest = np.zeros(label.max() + 1, int)
    np.maximum.at(largest, owner, size)
    label, stray = label.copy(), (size <= APART * largest[owner])[part]
    ends = np.concatenate([ends, ends[:, ::-1]])
    while stray.any():
        some = ends[stray[ends[:, 0]] & ~stray[ends[:, 1]]]
        label[some[:, 0]], part[some[:, 0]], stray[some[:, 0]] = label[some[:, 1]], part[some[:, 1]], False
    return label, np.unique(part, return_inverse=True)[1]


def _no_disk(
    n: int, label: Int[np.ndarray, " p"], part: Int[np.ndarray, " p"], triangles: Int[np.ndarray, "t 3"]
) -> str:
    """What is wrong with a part that is no disk, as points - sides + triangles of one are 1; nothing where all are."""
    corners, owner = part[triangles], np.zeros(part.max() + 1, int)
    owner[part] = label
    lost = np.setdiff1d(np.arange(n), owner)
    if len(lost):
        return f"cell {lost[0]} is not found"
    same = corners == np.roll(corners, -1, axis=1)
    points, sides, whole = (np.bincount(found, minlength=len(owner)) for found in
                            (part, corners[same], corners[same.all(axis=1), 0]))  # fmt: skip
    wrong = owner[(points - sides // 2 + whole != 1) & (owner < n)]
    if len(wrong):
        return f"cell {wrong[0]} wraps around the tissue, around other cells or to its own image, or nearly so"
    return ""


def _junctions(label: Int[np.ndarray, " p"], mesh: _Mesh) -> Junctions:
    """The junctions of cells that all are disks."""
    labels = label[mesh.corner]
    rows = np.flatnonzero(_is_meeting(labels))
    number = {row: k for k, row in enumerate(rows.tolist())}
    neighbors, names, twins = _beside(mesh.corner).tolist(), labels.tolist(), {}
    for first, row in enumerate(rows.tolist()):
        for side in range(3):
            at, out = row, side
            while neighbors[at][out] >= 0:  # nothing lies beyond the corner of a sheet
                at, before = neighbors[at][out], at
                back = neighbors[at].index(before)
                if at in number:
                    twins[3 * first + side] = 3 * number[at] + back
                    break
                # out between the corner that lies ahead and the other one that has not its label
                out = next(k for k in range(3) if k != back and names[at][k] == names[at][back])
    ways = 3 * np.arange(len(rows))[:, None] + [2, 0, 1]
    junctions = joined(labels[rows], ways, twins)
    junctions.place = mesh.middle[rows]
    return junctions
