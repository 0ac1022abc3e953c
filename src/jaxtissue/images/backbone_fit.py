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
from jaxtissue.geometry.nodes import has_nodes

OUTLIER = 0.5  # voxels off the wall from which on a point counts less and less
STEPS = 40  # of least squares at most
STIFFNESS = 3e-5  # of tilted and bent backbones, in parts of what their walls hold: for what hardly any wall tells
LEAN = 4.0  # a lean counts as a bow half as deep
DAMPING, LEAST, MOST, TINY = 1e-3, 1e-8, 1e3, 1e-12  # of the diagonal; the last one where a cell has no walls
TOLERANCE = 1e-3  # voxels by which the last step moves backbones

Positions = Float[np.ndarray, "n d"] | Float[np.ndarray, "n k d"]


class WallPoints(NamedTuple):
    """Points on the walls between two cells, in the domain's coordinates, each by the area of its voxel face."""

    points: Float[np.ndarray, "m 3"]
    pairs: Int[np.ndarray, "m 2"]
    areas: Float[np.ndarray, " m"]


class _Feet(NamedTuple):
    """The points of backbones nearest to wall points, the piece and where on it they are, and squared distances."""

    place: Float[np.ndarray, "m 3"]
    piece: Int[np.ndarray, " m"]
    share: Float[np.ndarray, " m"]
    square: Float[np.ndarray, " m"]


def fit_backbones(
    domain: Any,
    start: Positions,
    walls: WallPoints,
    step: float,
    settle: Callable[[Positions], Positions],
) -> Positions:
    """The positions of backbones that have wall points as nearly as possible at equal distances.

    The distance of a point p from the wall of the cells i and j is, to first order, (d_i(p)^2 - d_j(p)^2) / 2 |q_i -
    q_j|, with the feet q on the two backbones. The sum of its squares over all points, each by its area, is made small
    by sparse least squares, with less weight for outliers. Cells without walls stay where they start. Tilted and bent
    backbones are a little stiff, which places the nodes that no walls tell.

    Args:
        domain: What the backbones stand in; its `embed` places them in space.
        start: First positions, [n, d], or those of nodes at equally spaced heights, [n, k, d].
        walls: The points.
        step: The side of a voxel; distances are in this unit.
        settle: Brings positions back into the domain.

    Returns:
        The positions, in the shape of the first ones.
    """
    task, scale = _Task(domain, walls, step, np.sqrt(walls.areas / walls.areas.mean())), _scales(domain, start)
    task = task._replace(stiffness=_choose_stiffness(task, start, scale))
    positions, found, damping = start, _look(task, start), DAMPING
    for _ in range(STEPS):
        table = _differences(task, positions, found, scale)
        weighed = table.T * (1 / np.sqrt(1 + (found.miss / OUTLIER) ** 2))
        normal, fall = weighed @ table, weighed @ (found.miss * task.root)
        if task.stiffness:
            more, pull = _stiffen(task, positions, scale)
            normal, fall = normal + more, fall + pull
        while True:
            stiff = sparse.diags_array(damping * normal.diagonal() + TINY * normal.diagonal().mean())
            change = -np.asarray(spsolve((normal + stiff).tocsc(), fall)).reshape(start.shape) * scale
            tried = settle(positions + change)
            after = _look(task, tried)
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


class _Task(NamedTuple):
    """What the fit is to reach: the domain, the points and the roots of their areas, and how stiff backbones are."""

    domain: Any
    walls: WallPoints
    step: float
    root: Float[np.ndarray, " m"]
    stiffness: float = 0.0


class _Look(NamedTuple):
    """The feet of wall points, their distances from the walls and 1 / 2 |q_i - q_j|, in voxels, and the loss."""

    feet: tuple[_Feet, _Feet]
    miss: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, " m"]
    loss: float


def _look(task: _Task, positions: Positions) -> _Look:
    nodes, walls, step = _at_nodes(_embed, task.domain, positions), task.walls, task.step
    first, second = (_find_feet(nodes, walls.points, cell) for cell in walls.pairs.T)
    apart = np.linalg.norm(first.place - second.place, axis=1)
    weight = 1 / (2 * step * np.maximum(apart, 1e-3 * step))
    miss = (first.square - second.square) * weight
    loss = (task.root**2 * (np.sqrt(1 + (miss / OUTLIER) ** 2) - 1)).sum()
    strain = ((_strains(nodes.shape[1]) @ nodes) ** 2).sum() / (2 * OUTLIER**2)  # as small misses count
    return _Look((first, second), miss, weight, float(loss + task.stiffness * strain))


def _find_feet(
    nodes: Float[np.ndarray, "n q 3"], points: Float[np.ndarray, "m 3"], cell: Int[np.ndarray, " m"]
) -> _Feet:
    """The foot of each point on the backbone of a cell: the nearest of those on its straight pieces."""
    best = _Feet(points, np.zeros(len(points), int), np.zeros(len(points)), np.full(len(points), np.inf))
    for piece in range(nodes.shape[1] - 1):
        start = nodes[cell, piece]
        along, offset = nodes[cell, piece + 1] - start, points - start
        share = np.clip((offset * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
        away = offset - share[:, None] * along
        square = (away**2).sum(axis=1)
        nearer = square < best.square
        best = _Feet(
            np.where(nearer[:, None], points - away, best.place),
            np.where(nearer, piece, best.piece),
            np.where(nearer, share, best.share),
            np.where(nearer, square, best.square),
        )
    return best


def _differences(
    task: _Task, positions: Positions, found: _Look, scale: Float[np.ndarray, "... d"]
) -> sparse.csr_array:
    """The derivatives of the distances from walls by all positions, in units of `scale`, [m, unknowns].

    Where the foot lies does not count, as the distance is smallest there.
    """
    slopes, width = _at_nodes(_differentiate, task.domain, positions), positions.shape[-1]
    count = positions.shape[1] if has_nodes(positions) else 1
    scale, values, columns = np.broadcast_to(scale, (count, width)), [], []
    for feet, cell, sign in zip(found.feet, task.walls.pairs.T, (-2, 2), strict=True):
        pull = sign * (found.weight * task.root)[:, None] * (task.walls.points - feet.place)
        for end, share in enumerate((1 - feet.share, feet.share)):
            node = np.minimum(feet.piece + end, count - 1)  # both ends of straight backbones have one place
            moved = np.einsum("mi,mid->md", pull, slopes[cell, feet.piece + end])
            values.append(share[:, None] * moved * scale[node])
            columns.append(((cell * count + node) * width)[:, None] + np.arange(width))
    value, column = (np.stack(parts, axis=1).ravel() for parts in (values, columns))
    row = np.repeat(np.arange(len(task.root)), len(values) * width)
    return sparse.csr_array((value, (row, column)), (len(task.root), positions.size))


def _choose_stiffness(task: _Task, start: Positions, scale: Float[np.ndarray, "... d"]) -> float:
    """The weight of the strains of backbones."""
    if not has_nodes(start):
        return 0.0
    table = _differences(task, start, _look(task, start), scale)
    return STIFFNESS * float(table.power(2).sum()) / start.size


def _strains(count: int) -> Float[np.ndarray, "strains k"]:
    """The strains of nodes in space: second differences, so that curves of one shape count alike, and the lean."""
    bend = (count - 1) ** 2 * np.diff(np.eye(count), 2, axis=0)
    return np.concatenate([bend, LEAN * (np.eye(count)[-1:] - np.eye(count)[:1])])


def _stiffen(
    task: _Task, positions: Positions, scale: Float[np.ndarray, "k d"]
) -> tuple[sparse.sparray, Float[np.ndarray, " unknowns"]]:
    """The second and first derivatives of half the squares of the strains of backbones, by their weight."""
    n, k, _ = positions.shape
    strains = _strains(k)
    slopes = _at_nodes(_differentiate, task.domain, positions) * scale[:, None]
    slopes = np.einsum("ij,njcd->nicjd", strains, slopes).reshape(n, 3 * len(strains), -1)
    strain = (strains @ _at_nodes(_embed, task.domain, positions)).reshape(n, -1)
    squares = sparse.block_diag(list(slopes.transpose(0, 2, 1) @ slopes))
    return task.stiffness * squares, task.stiffness * np.einsum("nru,nr->nu", slopes, strain).ravel()


def _scales(domain: Any, positions: Positions) -> Float[np.ndarray, "... d"]:
    """The change of each coordinate that moves a backbone, or its node, by about one unit of length."""
    slopes = _at_nodes(_differentiate, domain, positions)
    moved = slopes if has_nodes(positions) else slopes.mean(axis=1)
    return 1 / np.linalg.norm(moved, axis=-2).mean(axis=0)


def _at_nodes(function: Callable[..., Any], domain: Any, positions: Positions) -> Float[np.ndarray, "n q ..."]:
    """What a function gives at every node; both ends of straight backbones are at one place."""
    place = positions if has_nodes(positions) else np.stack([positions] * 2, axis=1)
    n, q, d = place.shape
    height = jnp.asarray(np.tile(np.linspace(0, 1, q), n), float)
    found = np.asarray(function(domain, jnp.asarray(place.reshape(n * q, d), float), height), float)
    return found.reshape(n, q, *found.shape[1:])


def _point(domain: Any, place: Float[Array, "d"], height: Float[Array, ""]) -> Float[Array, "3"]:
    """F(m, h) of one place; of vectors the direction alone counts."""
    if len(place) == 3:
        place = place / jnp.linalg.norm(place)
    backbone = domain.embed(place[None])
    return (1 - height) * backbone.apical[0] + height * backbone.basal[0]


_embed = usual_modes()(jax.jit(jax.vmap(_point, (None, 0, 0))))
_differentiate = usual_modes()(jax.jit(jax.vmap(jax.jacfwd(_point, 1), (None, 0, 0))))
