"""The inverse problem: the backbones whose Voronoi walls run where an image shows walls."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse
from scipy.sparse.linalg import spsolve

from jaxtissue.compilation.modes import usual_modes

OUTLIER = 0.5  # voxels off the wall from which on a point counts less and less
STEPS = 40  # of least squares at most
DAMPING, LEAST, MOST, TINY = 1e-3, 1e-8, 1e3, 1e-12  # of the diagonal; the last one where a cell has no walls
TOLERANCE = 1e-3  # voxels by which the last step moves backbones


class WallPoints(NamedTuple):
    """Points on the walls between two cells, in the domain's coordinates, each by the area of its voxel face."""

    points: Float[np.ndarray, "m 3"]
    pairs: Int[np.ndarray, "m 2"]
    areas: Float[np.ndarray, " m"]


class _Feet(NamedTuple):
    """The points of the backbones nearest to wall points, where on the backbone they are, and squared distances."""

    place: Float[np.ndarray, "m 3"]
    share: Float[np.ndarray, " m"]
    square: Float[np.ndarray, " m"]


def fit_backbones(
    domain: Any,
    start: Float[np.ndarray, "n k"],
    walls: WallPoints,
    step: float,
    settle: Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]],
) -> Float[np.ndarray, "n k"]:
    """The positions of backbones that have wall points as nearly as possible at equal distances.

    The distance of a point p from the wall of the cells i and j is, to first order, (d_i(p)^2 - d_j(p)^2) / 2 |q_i -
    q_j|, with the feet q on the two backbones. The sum of its squares over all points, each by its area, is made small
    by sparse least squares, with less weight for outliers. Cells without walls stay where they start.

    Args:
        domain: What the backbones stand in; its `embed` places them in space.
        start: First positions, [n, k].
        walls: The points.
        step: The side of a voxel; distances are in this unit.
        settle: Brings positions back into the domain.

    Returns:
        The positions, [n, k].
    """
    cells, width = start.shape
    scale, row = _scales(domain, start), np.repeat(np.arange(len(walls.areas)), 2 * width)
    column = (walls.pairs[:, :, None] * width + np.arange(width)).ravel()
    positions, root, damping = start, np.sqrt(walls.areas / walls.areas.mean()), DAMPING
    found = _look(domain, positions, walls, step, root)
    for _ in range(STEPS):
        slopes = _all_slopes(domain, positions, walls, found) * scale * (found.weight * root)[:, None, None]
        table = sparse.csr_array((slopes.ravel(), (row, column)), (len(root), start.size))
        weighed = table.T * (1 / np.sqrt(1 + (found.miss / OUTLIER) ** 2))
        normal, fall = (weighed @ table).tocsc(), weighed @ (found.miss * root)
        while True:
            stiff = sparse.diags_array(damping * normal.diagonal() + TINY * normal.diagonal().mean())
            change = -np.asarray(spsolve(normal + stiff, fall)).reshape(cells, width) * scale
            tried = settle(positions + change)
            after = _look(domain, tried, walls, step, root)
            if after.loss <= found.loss or damping > MOST:
                break
            damping *= 10
        moved = np.abs(tried - positions) / scale
        if after.loss > found.loss:
            break
        positions, found, damping = tried, after, max(damping / 10, LEAST)
        if moved.max() < TOLERANCE * step:
            break
    return positions


class _Look(NamedTuple):
    """The feet of wall points, their distances from the walls and 1 / 2 |q_i - q_j|, in voxels, and the loss."""

    feet: tuple[_Feet, _Feet]
    miss: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, " m"]
    loss: float


def _look(domain: Any, positions: np.ndarray, walls: WallPoints, step: float, root: np.ndarray) -> _Look:
    first, second = _find_feet(domain, positions, walls)
    apart = np.linalg.norm(first.place - second.place, axis=1)
    weight = 1 / (2 * step * np.maximum(apart, 1e-3 * step))
    miss = (first.square - second.square) * weight
    return _Look((first, second), miss, weight, float((root**2 * (np.sqrt(1 + (miss / OUTLIER) ** 2) - 1)).sum()))


def _all_slopes(
    domain: Any, positions: Float[np.ndarray, "n k"], walls: WallPoints, found: _Look
) -> Float[np.ndarray, "m 2 k"]:
    """The derivatives of the differences of squared distances by the positions of both cells."""
    first, second = _embed_slopes(domain, positions)
    one, other = (_slope(walls, found.feet[side], first, second, side) for side in (0, 1))
    return np.stack([one, -other], axis=1)


def _scales(domain: Any, positions: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k"]:
    """The change of each coordinate that moves a backbone by about one unit of length."""
    first, second = _embed_slopes(domain, positions)
    moved = np.linalg.norm((first + second) / 2, axis=1).mean(axis=0)
    return 1 / moved


def _find_feet(domain: Any, positions: Float[np.ndarray, "n k"], walls: WallPoints) -> tuple[_Feet, _Feet]:
    """The feet of each wall point on the backbones of both cells."""
    start, end = (np.asarray(ends, float) for ends in _embed(domain, jnp.asarray(positions, float)))
    feet = []
    for cell in walls.pairs.T:
        along, offset = end[cell] - start[cell], walls.points - start[cell]
        share = np.clip((offset * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
        away = offset - share[:, None] * along
        feet.append(_Feet(walls.points - away, share, (away**2).sum(axis=1)))
    return feet[0], feet[1]


@usual_modes()
@jax.jit
def _embed(domain: Any, positions: Float[Array, "n k"]) -> Any:
    """Both ends of each backbone, [n, 3]; of unit vectors the direction alone counts."""
    if positions.shape[1] == 3:
        positions = positions / jnp.linalg.norm(positions, axis=1, keepdims=True)
    backbones = domain.embed(positions)
    return backbones.apical, backbones.basal


@usual_modes()
@jax.jit
def _differentiate(domain: Any, positions: Float[Array, "n k"]) -> Any:
    """The derivatives of both ends of each backbone by its position, [n, 3, k]."""
    return jax.vmap(jax.jacfwd(lambda place: tuple(end[0] for end in _embed(domain, place[None]))))(positions)


def _embed_slopes(
    domain: Any, positions: Float[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, "n 3 k"], Float[np.ndarray, "n 3 k"]]:
    first, second = _differentiate(domain, jnp.asarray(positions, float))
    return np.asarray(first, float), np.asarray(second, float)


def _slope(
    walls: WallPoints,
    feet: _Feet,
    first: Float[np.ndarray, "n 3 k"],
    second: Float[np.ndarray, "n 3 k"],
    side: int,
) -> Float[np.ndarray, "m k"]:
    """The derivatives of squared distances by the position of one of the two cells.

    Where the foot lies does not count, as the distance is smallest there.
    """
    cell, share = walls.pairs[:, side], feet.share[:, None, None]
    moved = (1 - share) * first[cell] + share * second[cell]
    return -2 * np.einsum("mi,mik->mk", walls.points - feet.place, moved)
