"""Which backbones can bound which cell: candidate lists, kept complete by an exact sum.

A list must hold every rival that stops a cell on some line; more only cost time. Complete lists are found among
the backbones nearest along the axis. Of these a few sweeps need only those that can come to stop the cell.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int
from scipy import sparse

from jaxtissue.cells import (
    BLOCK,
    FAR,
    LEVEL,
    CellGeometry,
    Grid,
    Posts,
    measure_cells,
    larger,
    meeting,
    posts,
    see_angles,
    see_lines,
    see_others,
    see_rivals,
    settled,
    stop,
    walls,
)
from jaxtissue.lines import PRESETS, Lines, Resolution, plan_lines
from jaxtissue.tube import Tube

REACH = 2.5  # mean cell widths on either side of a backbone that a first window of lines covers
NEAREST = 96  # backbones that are candidates of each cell, unless it needs more
TINY = 1e-30
TILES = 1e-4  # relative defect of the lengths along a line above which lists are taken as incomplete

_measure = jax.jit(measure_cells)


def measure_tissue(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, resolution: Resolution = PRESETS["standard"]
) -> tuple[CellGeometry, float]:
    """Sizes of every cell of a tissue, with its surfaces, and the defect of an exact sum over all cells.

    The defect is the largest relative error of the cells' lengths summed along a line, `tiling_defect`: 0 to
    rounding unless a candidate list overflowed. Lists are grown until nothing overflows, so this takes
    concrete arrays; inside `jit` call `measure_cells`. Positions as (axial, angle), [n, 2].
    """
    sides = find_candidates(positions, tube)
    lines = plan_lines(tube, len(positions), resolution, REACH, surfaces=True)
    sizes, _ = _measure(positions, tube, lines, jnp.asarray(sides))
    return sizes, float(tiling_defect(positions, tube, jnp.asarray(sides)))


def find_candidates(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, margin: float = 0.0
) -> Int[np.ndarray, "n 2 side_candidates"]:
    """Complete candidate lists, behind and ahead of each cell, padded with the cell itself.

    As many nearest backbones are taken as it needs for the cells to tile every line; those within `margin`
    along the axis stand on both sides.
    """
    count = NEAREST
    while True:
        sides = sided(nearest(positions, tube, count), positions, tube, margin)
        if count >= len(positions) - 1 or tiling_defect(positions, tube, sides) < TILES:
            return sides
        count *= 2


def nearest(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, count: int
) -> Int[np.ndarray, "n count"]:
    """The `count` backbones nearest to each by `spacing`, among those next to it along the axis."""
    place, n = np.asarray(positions, float), len(positions)
    count = min(count, n - 1)
    density, width = (
        n / float(tube.length),
        math.sqrt(2 * math.pi * float(tube.basal_radius * tube.length) / n),
    )
    # on either side; 6 mean cell widths at the basal surface, where NEAREST are as many as usual
    window = min(n - 1, max(count, math.ceil(6 * density * width * count / NEAREST)))
    order = np.argsort(place[:, 0], kind="stable")
    step = np.r_[-window:0, 1 : window + 1]
    lists = np.empty((n, count), np.int32)
    for start in range(0, n, 1024):
        rank = np.arange(start, min(start + 1024, n))[:, None] + step
        some, others = order[start : start + 1024, None], order[np.clip(rank, 0, n - 1)]
        score = np.where((rank >= 0) & (rank < n), spacing(place, some, others, tube), np.inf)
        kept = np.argpartition(score, max(count - 1, 0), axis=1)[:, :count]
        lists[some[:, 0]] = np.take_along_axis(others, kept, axis=1)
    return lists


def spacing(place: np.ndarray, first: np.ndarray, second: np.ndarray, tube: Tube) -> np.ndarray:
    """Distance of backbones `first` and `second`, the least over radii in units of the square root of these.

    Squared, up to a constant factor: so it is measured in mean cell widths.
    """
    inner, outer = float(tube.apical_radius), float(tube.basal_radius)
    along = (place[first, 0] - place[second, 0]) ** 2
    cosine = np.cos(place[first, 1] - place[second, 1])
    score = np.inf
    for radius in np.geomspace(inner, outer, 3):
        foot = np.maximum(radius * cosine, inner)
        score = np.minimum(score, (along + radius**2 - 2 * radius * foot * cosine + foot**2) / radius)
    return np.asarray(score)


def contact_graph(
    sides: Int[np.ndarray, "n 2 candidates"], touched: Bool[ArrayLike, "n 2 candidates"]
) -> sparse.csr_array:
    """Who stops whom, as a symmetric [n, n] matrix."""
    touched, n = np.asarray(touched), len(sides)
    cells, others = np.nonzero(touched)[0], sides[touched]
    graph = sparse.coo_array((np.ones(len(cells), bool), (cells, others)), shape=(n, n)).tocsr()
    return (graph + graph.T).tocsr()


def sided(
    lists: Int[np.ndarray, "n candidates"],
    positions: Float[Array | np.ndarray, "n 2"],
    tube: Tube,
    margin: float = 0.0,
) -> Int[np.ndarray, "n 2 side_candidates"]:
    """Candidates split into those behind and those ahead along the axis; within `margin`, both."""
    axial, own = np.asarray(positions, float)[:, 0], np.arange(len(lists), dtype=np.int32)[:, None]
    gap = np.where(lists == own, np.nan, axial[lists] - axial[:, None])
    margin = max(margin, 2 * LEVEL * float(tube.apical_radius))
    sides = [np.where(sign * gap >= -margin, lists, own) for sign in (-1, 1)]
    width = max(1, *(int((side != own).sum(axis=1).max(initial=0)) for side in sides))
    front = [np.argsort(side == own, axis=1, kind="stable")[:, :width] for side in sides]
    packed = [np.take_along_axis(side, at, axis=1) for side, at in zip(sides, front, strict=True)]
    return padded(np.stack(packed, axis=1), -(-width // 24) * 24)  # few shapes, so few compilations


def padded(lists: Int[np.ndarray, "n ... candidates"], width: int) -> Int[np.ndarray, "n ... width"]:
    """Lists lengthened to `width` with the cell itself."""
    own = np.arange(len(lists), dtype=np.int32).reshape(-1, *[1] * (lists.ndim - 1))
    more = np.broadcast_to(own, (*lists.shape[:-1], max(0, width - lists.shape[-1])))
    return np.concatenate([lists, more], axis=-1)


def clearance(
    positions: Float[Array, "n 2"], tube: Tube, lines: Lines, sides: Int[Array, "n 2 candidates"]
) -> Float[Array, "n 2 candidates"]:
    """How far each candidate would have to move, on the apical surface, to stop the cell on some of the lines
    if it were not for the one who does.

    To first order: d_j^2 - d_i^2 where the second in line would stop the cell, over its derivative,
    2 sqrt((x - x_j)^2 + (r s sin(t - t_j) / R_a)^2). Squared, and infinite where there is none. Those listed on
    the side where they are not yet are taken at the mirrored place. Who is far from stopping a cell now will be
    for a while.
    """
    n, dtype = len(positions), positions.dtype
    width = min(n, BLOCK)
    blocks = -(-n // width)
    place, lists = posts(positions), jnp.pad(sides, ((0, blocks * width - n), (0, 0), (0, 0)))
    grid = jax.tree.map(lambda column: column[:, 0], see_lines(lines, tube, dtype))

    def block(start: Array) -> Array:
        which = start + jnp.arange(width)
        those = lists[which].transpose(2, 1, 0)
        own, others = (Posts(*(column[at] for column in place)) for at in (which, those))
        ends, truth = jnp.stack([own.axial, tube.length - own.axial]), own.axial[0] > -1
        rivals, is_ahead = settled(lambda: see_others(own, others, those < which, tube), truth)
        on_side = is_ahead == jnp.array([False, True])[:, None]

        def nearer(least: Array, at: Grid) -> tuple[Array, None]:
            meets = settled(lambda: meeting(at, rivals, tube), truth)
            here = jnp.where(on_side, meets, FAR)
            first = jnp.minimum(here.min(axis=0), ends)
            second = jnp.minimum(jnp.where(here > first, here, FAR).min(axis=0), ends)
            z, y = at.z * rivals.cosine + at.y * rivals.sine, at.y * rivals.cosine - at.z * rivals.sine
            around = larger(z, tube.apical_radius) * y / tube.apical_radius
            speed = (second - 2 * rivals.half) ** 2 + around**2
            way = (larger(meets - second, 0.0) * 2 * rivals.half) ** 2 / larger(speed, TINY)
            return jnp.where((first.sum(axis=0) > 0) & (way < least), way, least), None

        least, _ = jax.lax.scan(nearer, jnp.full(rivals.half.shape, jnp.inf, dtype), grid)
        return jnp.where(rivals.half < FAR, least, jnp.inf).transpose(2, 1, 0)

    least = jax.lax.map(block, width * jnp.arange(blocks))
    return least.reshape(blocks * width, *sides.shape[1:])[:n]


def nearest_sides(
    sides: Int[np.ndarray, "n 2 candidates"], clear: Float[np.ndarray, "n 2 candidates"], count: int
) -> Int[np.ndarray, "n 2 count"]:
    """The `count` candidates on each side whose walls are nearest to the cell."""
    if sides.shape[2] > count:
        kept = np.argpartition(clear, count - 1, axis=2)[..., :count]
        sides, clear = (np.take_along_axis(table, kept, axis=2) for table in (sides, clear))
    own = np.arange(len(sides), dtype=sides.dtype)[:, None, None]
    return padded(np.where(np.isfinite(clear), sides, own), count)


def around(sides: Int[np.ndarray, "n 2 candidates"]) -> Int[np.ndarray, "n around"]:
    """Of each cell all who have it among their candidates, and its own; padded with itself."""
    n = len(sides)
    one = np.repeat(np.arange(n), sides[0].size), sides.reshape(-1)
    graph = sparse.coo_array((np.ones(len(one[0]), bool), one), shape=(n, n)).tocsr()
    graph = (graph + graph.T).tocsr()
    graph.setdiag(False)
    graph.eliminate_zeros()
    return packed_rows(graph)


def packed_rows(graph: sparse.csr_array) -> Int[np.ndarray, "n width"]:
    """The columns of each row as a list, padded with the row's own number."""
    sizes = np.diff(graph.indptr)
    lists = np.repeat(np.arange(len(sizes), dtype=np.int32)[:, None], max(sizes.max(initial=0), 2), axis=1)
    rows = np.repeat(np.arange(len(sizes)), sizes)
    lists[rows, np.arange(len(rows)) - np.repeat(graph.indptr[:-1], sizes)] = graph.indices
    return lists


@jax.jit
def tiling_defect(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, sides: Int[Array | np.ndarray, "n 2 candidates"]
) -> Float[Array, ""]:
    """Largest relative error of the cells' lengths summed along a line, |sum_i (hi_i - lo_i)+ - L| / L.

    The lines, 16 in each of 5 layers from surface to surface, are the same for all cells, so the intervals
    tile each of them exactly unless a list lacks a rival: an alarm that no estimator's error can hide.
    """
    dtype = positions.dtype
    share, angle = jnp.linspace(0, 1, 5, dtype=dtype), jnp.arange(16, dtype=dtype) * (2 * np.pi / 16) + 0.123
    radius = jnp.repeat(tube.apical_radius + share * (tube.basal_radius - tube.apical_radius), 16)[:, None]
    place, lists = posts(positions), sides.transpose(2, 1, 0)
    own, others = place, Posts(*(column[lists] for column in place))
    offset = jnp.mod(jnp.tile(angle, 5)[:, None] - own.angle + np.pi, 2 * np.pi) - np.pi
    ends, truth = jnp.stack([own.axial, tube.length - own.axial]), own.axial[0] > -1
    rivals = settled(lambda: see_rivals(own, others, lists < jnp.arange(len(positions)), tube), truth)
    grid = see_angles(radius, offset, tube)
    by = stop(grid, rivals, ends, tube, truth)
    length = walls(by, rivals, ends, grid, tube, truth).reach.sum(axis=1)
    return jnp.abs(jnp.maximum(length, 0).sum(axis=1) / tube.length - 1).max()
