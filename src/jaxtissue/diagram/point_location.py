"""The cell that holds each point: points in ever smaller boxes, each with the backbones that can be nearest.

A box whose list has come down to one backbone lies in one cell. Time grows as points + backbones, whatever
the shape of the domain and however the backbones crowd (host, float64).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.system.cores import in_threads

_DEPTH = 20  # times that a cube is halved
_HALF = 2 ** (_DEPTH // 2) - 1
_TRIPLED = np.sum([(np.arange(_HALF + 1) >> bit & 1) << 3 * bit for bit in range(_DEPTH // 2)], axis=0)
_FEW = 4  # points that are no longer taken together
_CHUNK = 2**17  # points sorted together
_BATCH = 2**18  # pairs of boxes and backbones worked on together: threads that take turns more often wait longer


class Stand(NamedTuple):
    """The backbones of a tube: from the inner to the outer radius, in the direction (cosine, sine)."""

    axial: Float64[np.ndarray, " n"]
    cosine: Float64[np.ndarray, " n"]
    sine: Float64[np.ndarray, " n"]
    inner: float
    outer: float
    parts: int = 1

    def feet(self, cell: np.ndarray, points: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The point nearest to each point, as x, y and z, on the backbone of this number."""
        _, y, z = points
        axis_y, axis_z = self.cosine[cell], self.sine[cell]
        out = np.clip(y * axis_y + z * axis_z, self.inner, self.outer)
        return self.axial[cell], out * axis_y, out * axis_z


class Sticks(NamedTuple):
    """Segments in space, `parts` of them one after the other for each cell: pieces and copies of its backbone."""

    start: Float64[np.ndarray, "3 e"]
    along: Float64[np.ndarray, "3 e"]
    square: Float64[np.ndarray, " e"]
    parts: int

    def feet(self, cell: np.ndarray, points: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The point nearest to each point, as x, y and z, on the segment of this number."""
        start, along = self.start[:, cell], self.along[:, cell]
        share = sum((p - a) * b for p, a, b in zip(points, start, along, strict=True))
        x, y, z = start + np.clip(share / self.square[cell], 0, 1) * along
        return x, y, z


class Lists(NamedTuple):
    """The backbones of several places, `number` for each, one place after the other, ascending."""

    cell: Int64[np.ndarray, " pairs"]
    number: Int64[np.ndarray, " places"]


class _Chunk(NamedTuple):
    """Points in the order of an octree of cubes, the first of side `side`."""

    order: Int64[np.ndarray, " p"]
    place: Float64[np.ndarray, "3 p"]
    apart: Int64[np.ndarray, " p"]  # bits in which a point's code differs from that of the point before
    origin: Float64[np.ndarray, "3 1"]
    side: float


class _Boxes(NamedTuple):
    """Points of a chunk in one cube each, or single ones, and the backbones that can be nearest to them."""

    start: Int64[np.ndarray, " boxes"]
    size: Int64[np.ndarray, " boxes"]
    lists: Lists


def label_points(points: ArrayLike, positions: PositionsLike, domain: Tube | Domain) -> Int32[np.ndarray, " p"]:
    """Find the cell that contains each point, that is, the cell of the nearest backbone (paper, section 2.1).

    The distance is the exact Euclidean distance to the backbone, also across the lumen; beyond a periodic direction
    those of the copies count. Ties go to the lower index. Time grows with points + backbones. Runs on the host in
    float64; not jittable (see `nearest_backbones`).

    Args:
        points: Cartesian coordinates, in length units, shape [p, 3].
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3];
            of tilted and bent backbones those of their nodes, shape [n, k, d].
        domain: The tube or other domain.

    Returns:
        Index of the cell that contains each point, shape [p]. Points outside the tissue also get the nearest backbone.

    Raises:
        ValueError: If a point is not finite, or if a position is not finite, lies outside the domain or coincides with
            another.

    >>> two, tube = np.array([[2.0, 0.0], [5.0, 0.0]]), Tube(length=10, apical_radius=1, basal_radius=2)
    >>> label_points([[3.0, 1.5, 0.0], [4.0, 0.0, 1.5]], two, tube).tolist()
    [0, 1]
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    for i in np.flatnonzero(~np.isfinite(points).all(axis=1)):
        raise ValueError(f"point {i}, {points[i]}, is not finite; give finite x, y and z")
    tube = domain_of(domain, positions)
    cells = stand(positions, tube) if isinstance(tube, Tube) else _sticks(positions, tube)
    labels = np.empty(len(points), np.int32)

    def label_chunk(start: int) -> None:
        chunk = _in_order(points[start : start + _CHUNK])
        labels[start + chunk.order] = _label(chunk, cells)

    in_threads(label_chunk, range(0, len(points), _CHUNK))
    return labels


def stand(positions: PositionsLike, tube: Tube) -> Stand:
    """The backbones at (axial, angle) positions. Raises `ValueError` for what `as_positions` refuses."""
    axial, angle = as_positions(positions, tube, np.float64, sizes=False).T
    return Stand(axial, np.cos(angle), np.sin(angle), float(tube.apical_radius), float(tube.basal_radius))


def _sticks(positions: PositionsLike, domain: Domain) -> Sticks:
    """The pieces of backbones and of their copies on any other domain."""
    crowd = Crowd(as_positions_on(positions, domain, np.float64, bent=True), domain)
    pieces, n = len(crowd.start), crowd.cells
    start, along = (
        part.reshape(pieces, -1, n, 3).transpose(3, 2, 0, 1).reshape(3, -1) for part in (crowd.start, crowd.along)
    )
    return Sticks(start, along, (along**2).sum(axis=0), start.shape[1] // n)


def narrow(
    center: Float64[np.ndarray, "3 places"],
    radius: Float64[np.ndarray, " places"],
    lists: Lists,
    cells: Stand | Sticks,
) -> tuple[Lists, Float64[np.ndarray, " places"]]:
    """Keep, of the backbones listed for each ball, those that can be nearest in it; and the distances of the centers.

    With q the feet and j nearest to the center, backbone i is nowhere nearer than j in a ball of radius r if
    d_i^2 - d_j^2 > 2 r (|q_i - q_j| + r): the gradient of that difference is 2 (q_j - q_i), and a foot moves no
    farther than its point. In a ball of radius 0 only j is left, and of several the one with the lowest index.
    """
    cell, count = lists
    x, y, z = (np.repeat(part, count) for part in center)
    foot_x, foot_y, foot_z = cells.feet(cell, (x, y, z))
    square = (foot_x - x) ** 2 + (y - foot_y) ** 2 + (z - foot_z) ** 2
    best = np.minimum.reduceat(square, np.cumsum(count) - count)

    # first by d_i - d_j <= 2 r, which is cheaper
    bound = np.maximum((np.sqrt(best) + 2 * radius) ** 2, best)
    kept = np.flatnonzero(square <= np.repeat(bound, count))
    place = np.repeat(np.arange(len(count)), count)[kept]
    excess, reach = square[kept] - best[place], radius[place]
    nearest = np.flatnonzero(excess == 0)
    nearest = nearest[np.diff(place[nearest], prepend=-1) > 0]
    foot = np.stack([foot_x[kept], foot_y[kept], foot_z[kept]])
    apart = foot - foot[:, nearest[place]]
    apart *= apart
    excess -= 2 * reach * reach
    possible = (excess <= 0) | (excess * excess <= 4 * reach * reach * apart.sum(axis=0))
    possible &= reach > 0
    possible[nearest] = True
    return Lists(cell[kept[possible]], np.bincount(place[possible], minlength=len(count))), np.sqrt(best)


def hand_down(lists: Lists, parent: Int64[np.ndarray, " parts"]) -> Lists:
    """For each part the list of its parent."""
    first, count = np.cumsum(lists.number) - lists.number, lists.number[parent]
    return Lists(lists.cell[_ranges(first[parent], count)], count)


def take(lists: Lists, chosen: Bool[np.ndarray, " places"]) -> Lists:
    """The lists of the chosen places."""
    return Lists(lists.cell[np.repeat(chosen, lists.number)], lists.number[chosen])


def batches(lists: Lists) -> Iterator[tuple[slice, Lists]]:
    """The places in groups, with their lists, so that all about one group fits the cache."""
    ends = np.cumsum(lists.number)
    stops = np.flatnonzero(np.diff(ends // _BATCH, append=-1)) + 1
    ends = np.append(0, ends)
    for start, stop in zip(np.append(0, stops)[:-1], stops, strict=True):
        yield slice(start, stop), Lists(lists.cell[ends[start] : ends[stop]], lists.number[start:stop])


def _in_order(points: Float64[np.ndarray, "p 3"]) -> _Chunk:
    """The points, sorted by the interleaved bits of their places."""
    low = points.min(axis=0)
    side = float((points.max(axis=0) - low).max()) * (1 + 1e-9) or 1.0
    step = ((points - low) * (2.0**_DEPTH / side)).astype(np.int64).T
    code = _spread(step[0]) << 2 | _spread(step[1]) << 1 | _spread(step[2])
    index = np.argsort(code)
    code = code[index]
    return _Chunk(index, points[index].T.copy(), np.append(0, code[1:] ^ code[:-1]), low[:, None], side)


def _spread(number: Int64[np.ndarray, " p"]) -> Int64[np.ndarray, " p"]:
    """Every bit moved to three times its place."""
    low, high = _TRIPLED[number & _HALF], _TRIPLED[number >> (_DEPTH // 2)]
    return high << (3 * _DEPTH // 2) | low


def _label(chunk: _Chunk, cells: Stand | Sticks) -> Int64[np.ndarray, " p"]:
    """The cells of the points of a chunk, in its order."""
    n, p = cells[0].shape[-1], len(chunk.order)
    labels = np.empty(p, np.int64)
    left = [(0, _Boxes(np.array([0]), np.array([p]), Lists(np.arange(n), np.array([n]))))]
    while left:
        level, boxes = left.pop()
        side = chunk.side / 2**level
        center = chunk.place[:, boxes.start]
        single = boxes.size == 1
        # the very products that gave the codes
        middle = chunk.origin + (np.floor((center - chunk.origin) * (2.0**level / chunk.side)) + 0.5) * side
        # a little more, for rounding
        radius = np.where(single, 0, side * (np.sqrt(0.75) + 1e-6))
        lists, _ = narrow(np.where(single, center, middle), radius, boxes.lists, cells)
        first = np.cumsum(lists.number) - lists.number
        least = lists.cell[first] // cells.parts
        done = (lists.number == 1) | (least == lists.cell[first + lists.number - 1] // cells.parts)
        size = boxes.size[done]
        labels[_ranges(boxes.start[done], size)] = np.repeat(least[done], size)
        if not done.all():
            rest = _Boxes(boxes.start[~done], boxes.size[~done], take(lists, ~done))
            parts = _split(rest, chunk, level + 1)
            left += [(level + 1, _Boxes(parts.start[k], parts.size[k], own)) for k, own in batches(parts.lists)]
    return labels


def _split(boxes: _Boxes, chunk: _Chunk, level: int) -> _Boxes:
    """The parts of each cube that hold points, of its eight; a small number of points become single ones."""
    point = _ranges(boxes.start, boxes.size)
    box = np.repeat(np.arange(len(boxes.size)), boxes.size)
    begins = chunk.apart[point] >= 1 << 3 * max(_DEPTH - level, 0)
    begins |= (boxes.size <= _FEW)[box] | (level > _DEPTH)
    begins[np.cumsum(boxes.size) - boxes.size] = True
    first = np.flatnonzero(begins)
    size = np.diff(first, append=len(point))
    return _Boxes(point[first], size, hand_down(boxes.lists, box[first]))


def _ranges(first: Int64[np.ndarray, " m"], count: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, " sum"]:
    """first, first + 1, ... of each range, `count` numbers."""
    stop = np.cumsum(count)
    return np.arange(count.sum()) + np.repeat(first - stop + count, count)
