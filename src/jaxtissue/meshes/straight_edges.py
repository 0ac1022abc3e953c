"""Vertices where walls meet, moved onto the lines on which they truly meet: meshes that are only looked at.

Where two walls of a cell meet at a flat angle, the edge between them strays by up to a tetrahedron from its true line,
with next to no volume in between. Moved vertices may fold a few of these flat triangles over, so that exports keep the
meshes as they are cut.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.meshes.cell_meshes import CellMeshes

STEPS = 5  # of Newton's method
TURNS = 3  # in each but the first, a vertex that came to lie in another cell is moved to its wall
FAR = 3.0  # of the longest side of its triangles, that a vertex moves at most
_FLAT = 1e-4  # square of the angle between two walls, below which where they meet is not told
_WRONG = 0.05  # of that side: deeper in another cell, a vertex goes back to where it was


def straighten(
    meshes: CellMeshes, backbones: Crowd, label: Callable[[Float[np.ndarray, "m 3"]], Int[np.ndarray, " m"]]
) -> CellMeshes:
    """Move vertices where three and more cells or surfaces meet to where the cells' backbones are equally far.

    So are vertices of a wall or a surface that lie in another cell. What lies on the surface of the tissue stays in the
    plane of the surface there.

    Args:
        meshes: The meshes.
        backbones: The backbones of all cells.
        label: Finds the cells of points.
    """
    used, labels, upright, count = _labels_of_vertices(meshes)
    start = meshes.points[used]
    nearest = label(start)
    strays = (count == 2) & (nearest[:, None] != labels).all(axis=1)
    labels[strays, 2] = nearest[strays]
    own = (count > 2) | strays
    used, labels, upright, start = used[own], labels[own], upright[own], start[own]
    longest, place = _longest_sides(meshes)[used], start.copy()
    wrong = np.zeros(len(used), bool)
    for _ in range(TURNS):
        for _ in range(STEPS):
            slope, lead = _equations(place, labels, upright, meshes.cells, backbones)
            square = np.einsum("mic,mjc->mij", slope, slope) + _FLAT * np.eye(3)
            step = np.einsum("mic,mi->mc", slope, np.linalg.solve(square, lead[..., None])[..., 0])
            moved = place - step - start
            size = np.linalg.norm(moved, axis=1)
            place = start + moved * np.minimum(1, FAR * longest / np.maximum(size, 1e-300))[:, None]
        nearest = label(place)
        wrong = _lies_elsewhere(place, labels, nearest, backbones, _WRONG * longest)
        labels[wrong, 2] = nearest[wrong]
    points = meshes.points.copy()
    points[used[~wrong]] = place[~wrong]
    return replace(meshes, points=points)


def _labels_of_vertices(
    meshes: CellMeshes,
) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, "v 4"], Float[np.ndarray, "v 4 3"], Int[np.ndarray, " v"]]:
    """The vertices; the first two and last two labels round each, cells before surfaces; normals; numbers of labels.

    A normal is that of the triangles that have the label on one side.
    """
    corners, sides = meshes.triangles.ravel(), np.repeat(meshes.sides, 3, axis=0)
    pairs = np.stack([np.tile(corners, 2), sides.T.ravel()], axis=1)
    pairs, row = np.unique(pairs, axis=0, return_inverse=True)
    normals = np.tile(np.repeat(meshes.normals(), 3, axis=0), (2, 1))
    upright = np.stack([np.bincount(row.ravel(), part, len(pairs)) for part in normals.T], axis=1)
    used, first, count = np.unique(pairs[:, 0], return_index=True, return_counts=True)
    chosen = first[:, None] + np.stack([0 * count, 0 * count + 1, count - 2, count - 1], axis=1)
    return used, pairs[chosen, 1], upright[chosen], count


def _lies_elsewhere(
    place: Float[np.ndarray, "m 3"],
    labels: Int[np.ndarray, "m 4"],
    nearest: Int[np.ndarray, " m"],
    backbones: Crowd,
    depth: Float[np.ndarray, " m"],
) -> Bool[np.ndarray, " m"]:
    """Whether points lie in a cell that is none of theirs, deeper than so much."""
    base, away = backbones.offset(place, labels[:, 0]), backbones.offset(place, nearest)
    apart = 2 * np.linalg.norm(away - base, axis=1)
    lead = (base**2).sum(axis=1) - (away**2).sum(axis=1)
    return (nearest[:, None] != labels).all(axis=1) & (lead > depth * apart)


def _equations(
    place: Float[np.ndarray, "m 3"],
    labels: Int[np.ndarray, "m 4"],
    upright: Float[np.ndarray, "m 4 3"],
    cells: int,
    backbones: Crowd,
) -> tuple[Float[np.ndarray, "m 3 3"], Float[np.ndarray, "m 3"]]:
    """The distances of points from three walls or surfaces each, to first order, and their derivatives.

    The walls are those between the first cell and each other; a surface is a plane through the point.
    """
    base = backbones.offset(place, labels[:, 0])
    slope, lead = np.zeros((len(place), 3, 3)), np.zeros((len(place), 3))
    for at in range(3):
        label = labels[:, at + 1]
        wall = label < cells
        away = backbones.offset(place, np.where(wall, label, labels[:, 0]))
        slope[:, at] = np.where(wall[:, None], 2 * (away - base), upright[:, at + 1])
        size = np.linalg.norm(slope[:, at], axis=1)
        size[size == 0] = 1
        slope[:, at] /= size[:, None]
        lead[:, at] = ((away**2).sum(axis=1) - (base**2).sum(axis=1)) / size
    return slope, lead


def _longest_sides(meshes: CellMeshes) -> Float[np.ndarray, " p"]:
    """The longest side of the triangles round each vertex."""
    corner = meshes.points[meshes.triangles]
    size = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    longest = np.zeros(len(meshes.points))
    np.maximum.at(longest, meshes.triangles.ravel(), np.repeat(size, 3))
    return longest
