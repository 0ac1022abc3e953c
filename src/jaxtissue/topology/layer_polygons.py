"""Approximate sections of all cells on one layer as polygons: contacts there, except at very short walls."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxtissue.compilation.modes import double_precision
from jaxtissue.topology.layer_gaps import LayerGaps

ROUNDS, NEAREST, LOOKED_AT, ROUNDING = 12, 17, 40, 1e-6
FAR, PARALLEL = 1e6, 1e-9  # in mean widths; the sine of an angle


class Polygons(NamedTuple):
    """The lines that bound each cell's section, [n, l]: those of its candidates and then the four limits.

    Attributes:
        is_edge: Which of them have an edge.
        turn: The direction of the line's normal.
        length: The length of the edge.
        corner: Where the edge ends, counterclockwise, on the base surface, [n, l, d].
        point: And in space.
    """

    is_edge: Bool[np.ndarray, "n l"]
    turn: Float[np.ndarray, "n l"]
    length: Float[np.ndarray, "n l"]
    corner: Float[np.ndarray, "n l d"]
    point: Float[np.ndarray, "n l 3"]


class _Lines(NamedTuple):
    """The half planes n . z <= c of each cell."""

    normal: Float[np.ndarray, "n l 2"]
    offset: Float[np.ndarray, "n l"]


def complete_polygons(
    gaps: LayerGaps, positions: Float[np.ndarray, "n d"], height: float, passes: int
) -> tuple[Polygons, Int[np.ndarray, "n q"]]:
    """The polygons of a layer, on lists of candidates that grow until none lacks a neighbor; see `_polygons`."""
    lists, rounds = _nearest(gaps), 0
    while True:
        found = _polygons(gaps, positions, lists, height, passes)
        cells = np.broadcast_to(np.arange(gaps.count)[:, None], found.is_edge.shape)[found.is_edge]
        pairs = _lacking(gaps, lists, found.point[found.is_edge], cells)
        rounds += 1
        if not len(pairs) or rounds == ROUNDS:
            return found, lists
        cell, other = pairs.T
        slot = np.arange(len(cell)) - np.searchsorted(cell, cell)
        more = np.full((gaps.count, slot.max() + 1), -1)
        more[cell, slot] = other
        lists = np.concatenate([lists, more], axis=1)


def _nearest(gaps: LayerGaps) -> Int[np.ndarray, "n q"]:
    """The nearest backbones of each cell on three layers, copies included, each once; -1 in their place else."""
    start, along, found = gaps.crowd.start, gaps.crowd.along, []
    for piece, share in ((0, 0.0), (len(start) // 2, len(start) % 2 / 2), (-1, 1.0)):  # the ends and the middle
        points = start[piece] + share * along[piece]
        found.append(KDTree(points).query(points[: gaps.count], min(NEAREST, len(points)))[1].reshape(gaps.count, -1))
    listed = np.sort(np.concatenate(found, axis=1), axis=1)
    listed[:, 1:][listed[:, 1:] == listed[:, :-1]] = -1
    listed[listed == np.arange(gaps.count)[:, None]] = -1
    return listed


def _lacking(
    gaps: LayerGaps, lists: Int[np.ndarray, "n q"], points: Float[np.ndarray, "p 3"], cells: Int[np.ndarray, " p"]
) -> Int[np.ndarray, "m 2"]:
    """Pairs of a cell and a backbone that its list lacks, though it is nearer to a corner of the cell, in order."""
    found = gaps.nearby(points, LOOKED_AT)
    own = np.linalg.norm(gaps.crowd.offset(points, cells), axis=-1)
    others = np.linalg.norm(gaps.crowd.offset(points[:, None], found), axis=-1)
    listed = (lists[cells][:, None] == found[..., None]).any(axis=-1) | (found == cells[:, None])
    row, column = np.nonzero(~listed & (others < (1 - ROUNDING) * own[:, None]))
    return np.unique(np.stack([cells[row], found[row, column]], axis=1), axis=0)


def _polygons(
    gaps: LayerGaps, positions: Float[np.ndarray, "n d"], lists: Int[np.ndarray, "n q"], height: float, passes: int
) -> Polygons:
    """Polygons of the walls as lines, each taken so many times where it has its edge, or else nearest to one."""
    n, q = lists.shape
    flat = gaps.look(positions, np.zeros((n, 2)), np.full(n, height))
    across = flat.columns[..., :2]
    basis = np.linalg.inv(np.swapaxes(np.linalg.cholesky(np.swapaxes(across, 1, 2) @ across), 1, 2))
    limits = _limits(gaps, positions, basis)
    # along the layer, also where a straight way would lead through the lumen
    z = np.einsum("nqi,nji->nqj", _half_ways(gaps, positions, lists), np.linalg.inv(basis))
    before = None
    while True:
        normal, offset, there = _tangents(gaps, positions, lists, height, z, basis)
        if before is not None:
            normal, offset = np.where(there[..., None], normal, before[0]), np.where(there, offset, before[1])
            there |= before[2]
        before = normal, offset, there
        normal = np.where(there[..., None], normal, [1.0, 0.0])
        lines = _Lines(np.concatenate([normal, limits.normal], axis=1),
                       np.concatenate([np.where(there, offset, FAR * gaps.width), limits.offset], axis=1))  # fmt: skip
        low, high = _cut(lines, FAR * gaps.width)
        passes -= 1
        if not passes:
            break
        z = _nearer(lines, low, high)[:, :q]
    is_edge = low < high
    end = lines.offset[..., None] * lines.normal + np.where(is_edge, high, 0)[..., None] * _turned(lines.normal)
    where = np.where(is_edge[..., None], end, 0) @ np.swapaxes(basis, 1, 2)
    corner = gaps.look(np.repeat(positions, q + 4, axis=0), where.reshape(-1, 2), np.full(n * (q + 4), height))
    turn = np.arctan2(lines.normal[..., 1], lines.normal[..., 0])
    return Polygons(is_edge, turn, np.where(is_edge, high - low, 0), corner.place.reshape(n, q + 4, -1),
                    corner.point.reshape(n, q + 4, 3))  # fmt: skip


def _tangents(
    gaps: LayerGaps, positions: np.ndarray, lists: np.ndarray, height: float, z: np.ndarray, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The walls as lines where each is taken, [n, q]: normals, offsets, and which lines are good for anything."""
    n, q = lists.shape
    spots = gaps.look(np.repeat(positions, q, axis=0), (z @ np.swapaxes(basis, 1, 2)).reshape(-1, 2),
                      np.full(n * q, height))  # fmt: skip
    point = spots.point.reshape(n, q, 3)
    mine, theirs = (gaps.crowd.offset(point, number) for number in (np.arange(n)[:, None], lists))
    apart = theirs - mine
    slope = 2 * np.einsum("nqi,nqij->nqj", apart, spots.columns[..., :2].reshape(n, q, 3, 2) @ basis[:, None])
    steep = np.maximum(np.linalg.norm(slope, axis=-1), 1e-300)
    normal = -slope / steep[..., None]
    offset = ((apart * (theirs + mine)).sum(axis=-1)) / steep + (normal * z).sum(axis=-1)
    # a line that leaves out the backbone itself was taken too far from its wall
    return normal, offset, (lists >= 0) & (steep > 1e-9 * np.linalg.norm(apart, axis=-1)) & (offset > 0)


def _half_ways(gaps: LayerGaps, positions: Float[np.ndarray, "n d"], lists: Int[np.ndarray, "n q"]) -> np.ndarray:
    """The local coordinates halfway to each cell's candidates, [n, q, 2]."""
    n, q = lists.shape
    copy, other = np.divmod(np.maximum(lists, 0), n)
    here = np.repeat(positions, q, axis=0)
    way = gaps.look(here, np.zeros((n * q, 2)), np.zeros(n * q), positions[other.ravel()]).way.reshape(n, q, 2)
    if gaps.extent is None:  # the tangent of half of the angle
        return way / (1 + np.sqrt(1 + (way**2).sum(axis=-1, keepdims=True)))
    is_closed = np.asarray(gaps.base.is_seam()[:2])
    plain = positions[other] + (gaps.base.images() * gaps.extent)[copy] - positions[:, None]
    return np.where(is_closed, way, plain) / 2


def _limits(gaps: LayerGaps, positions: Float[np.ndarray, "n d"], basis: Float[np.ndarray, "n 2 2"]) -> _Lines:
    """The limits of sections, low and then high in both coordinates, as lines."""
    with double_precision():
        limits = gaps.base.limits(tuple(map(jnp.asarray, positions.T)))
    normal, offset = [], []
    for sign, side in ((-1, limits.low), (1, limits.high)):
        for k in range(2):
            row = sign * basis[:, k]
            size = np.linalg.norm(row, axis=1)
            normal.append(row / size[:, None])
            offset.append(sign * np.asarray(side[k]) / size)
    return _Lines(np.stack(normal, axis=1), np.stack(offset, axis=1))


def _cut(lines: _Lines, far: float) -> tuple[Float[np.ndarray, "n l"], Float[np.ndarray, "n l"]]:
    """From where to where along its direction each line bounds the polygon; nowhere if the first is not less."""
    low, high = np.full(lines.offset.shape, -far), np.full(lines.offset.shape, far)
    along = _turned(lines.normal)
    for k in range(lines.offset.shape[1]):
        normal, offset = lines.normal[:, k, None], lines.offset[:, k, None]
        slope, room = (normal * along).sum(axis=-1), offset - lines.offset * (normal * lines.normal).sum(axis=-1)
        crossed = np.abs(slope) > PARALLEL
        at = room / np.where(crossed, slope, 1)
        high = np.where(crossed & (slope > 0), np.minimum(high, at), high)
        low = np.where(crossed & (slope < 0), np.maximum(low, at), low)
        behind = ~crossed & (room < -1e-9 * far * 1e-6)
        behind[:, k] = False
        high = np.where(behind, -far, high)
    return low, high


def _nearer(lines: _Lines, low: np.ndarray, high: np.ndarray) -> Float[np.ndarray, "n l 2"]:
    """The middles of edges; for lines without one, the corner that lies farthest their way."""
    is_edge, foot, along = low < high, lines.offset[..., None] * lines.normal, _turned(lines.normal)
    middle = foot + np.where(is_edge, (low + high) / 2, 0)[..., None] * along
    end = foot + np.where(is_edge, high, 0)[..., None] * along
    reach = np.where(is_edge[:, None], np.einsum("nli,nki->nlk", lines.normal, end), -np.inf)
    corner = np.take_along_axis(end, reach.argmax(axis=-1)[..., None], axis=1)
    return np.where(is_edge[..., None], middle, corner)


def _turned(vector: np.ndarray) -> np.ndarray:
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
