"""Which backbones can bound which cell: candidate lists, kept complete by an exact sum.

A list must hold every rival that stops a cell on some line; more only cost time. Lists come from measured
contacts: whoever can come to touch a cell when one backbone moves is within two hops of it, and when all move
by a fraction of a cell, within three hops and not far.
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
    Survey,
    measure_cells,
    meeting,
    posts,
    see_angles,
    see_lines,
    see_rivals,
    settled,
    stop,
    walls,
)
from jaxtissue.lines import PRESETS, Lines, Resolution, plan_lines
from jaxtissue.tube import Tube

REACH = 2.5  # mean cell widths on either side of a backbone that a first window of lines covers
SKIN = 2.5  # mean cell widths within which cells three hops apart are candidates too
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
    sides = sided(find_candidates(positions, tube), positions, tube)
    lines = plan_lines(tube, len(positions), resolution, REACH, surfaces=True)
    sizes, _ = _measure(positions, tube, lines, jnp.asarray(sides))
    return sizes, float(tiling_defect(positions, tube, jnp.asarray(sides)))


def find_candidates(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube
) -> Int[np.ndarray, "n candidates"]:
    """Complete candidate lists: as many nearest backbones as it needs for the cells to tile every line."""
    count = 64
    while True:
        lists = nearest(positions, tube, count)
        sides = padded(sided(lists, positions, tube), min(count, 64))  # few shapes, so few compilations
        if count >= len(positions) - 1 or tiling_defect(positions, tube, sides) < TILES:
            return lists
        count *= 2


def spacing(place: np.ndarray, first: np.ndarray, second: np.ndarray, tube: Tube) -> np.ndarray:
    """Distance of backbones `first` and `second` in mean cell widths, the least over radii."""
    inner, outer = float(tube.apical_radius), float(tube.basal_radius)
    along, turn = place[first, 0] - place[second, 0], place[first, 1] - place[second, 1]
    score = np.full(along.shape, np.inf)
    for radius in np.geomspace(inner, outer, 3):
        foot = np.maximum(radius * np.cos(turn), inner)
        square = along**2 + radius**2 - 2 * radius * foot * np.cos(turn) + foot**2
        score = np.minimum(score, square / radius)
    return np.sqrt(score * len(place) / (2 * math.pi * float(tube.length)))


def nearest(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, count: int
) -> Int[np.ndarray, "n count"]:
    """The `count` backbones nearest to each by `spacing`."""
    place, n = np.asarray(positions, float), len(positions)
    count = min(count, n - 1)
    lists = np.empty((n, count), np.int32)
    for start in range(0, n, 1024):
        some = np.arange(start, min(start + 1024, n))
        score = spacing(place, some[:, None], np.arange(n)[None], tube)
        score[np.arange(len(some)), some] = np.inf
        lists[some] = np.argpartition(score, max(count - 1, 0), axis=1)[:, :count]
    return lists


def contact_graph(
    sides: Int[np.ndarray, "n 2 candidates"], touched: Bool[ArrayLike, "n 2 candidates"]
) -> sparse.csr_array:
    """Who stops whom, as a symmetric [n, n] matrix."""
    touched, n = np.asarray(touched), len(sides)
    cells, others = np.nonzero(touched)[0], sides[touched]
    graph = sparse.coo_array((np.ones(len(cells), bool), (cells, others)), shape=(n, n)).tocsr()
    return (graph + graph.T).tocsr()


def within_hops(graph: sparse.csr_array, hops: int) -> sparse.csr_array:
    """Who is within `hops` contacts of whom, oneself included."""
    one = (graph + sparse.eye_array(len(graph.indptr) - 1, dtype=bool)).astype(np.int32).tocsr()
    reached = one
    for _ in range(hops - 1):
        reached = reached @ one
        reached.data[:] = 1
    return reached


def hop_lists(
    graph: sparse.csr_array, positions: Float[Array | np.ndarray, "n 2"], tube: Tube
) -> Int[np.ndarray, "n candidates"]:
    """Everyone within two contacts of each cell, and within three where `spacing` is below SKIN; padded."""
    two = within_hops(graph, 2)
    three = within_hops(graph, 3) - two
    three.eliminate_zeros()
    cell, other = three.nonzero()
    near = spacing(np.asarray(positions, float), cell, other, tube) < SKIN
    rows = np.r_[np.repeat(np.arange(len(two.indptr) - 1), np.diff(two.indptr)), cell[near]]
    columns = np.r_[two.indices, other[near]]
    order = np.lexsort((columns, rows))
    rows, columns = rows[order], columns[order]
    sizes = np.bincount(rows, minlength=len(two.indptr) - 1)
    lists = np.repeat(np.arange(len(sizes), dtype=np.int32)[:, None], max(sizes.max(), 2), axis=1)
    lists[rows, np.arange(len(rows)) - np.repeat(np.cumsum(sizes) - sizes, sizes)] = columns
    return lists


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
    return padded(np.stack(packed, axis=1), -(-width // 16) * 16)  # few shapes, so few compilations


def padded(lists: Int[np.ndarray, "n ... candidates"], width: int) -> Int[np.ndarray, "n ... width"]:
    """Lists lengthened to `width` with the cell itself."""
    own = np.arange(len(lists), dtype=np.int32).reshape(-1, *[1] * (lists.ndim - 1))
    more = np.broadcast_to(own, (*lists.shape[:-1], max(0, width - lists.shape[-1])))
    return np.concatenate([lists, more], axis=-1)


def clearance(
    positions: Float[Array, "n 2"],
    tube: Tube,
    lines: Lines,
    sides: Int[Array, "n 2 candidates"],
    seen: Survey,
) -> Float[Array, "n 2 candidates"]:
    """How far each candidate's wall stays clear of the cell: the least distance, to first order, over lines.

    Squared; infinite where there is no wall to face. Who is far from bounding a cell now will be for a while.
    """

    n, dtype = len(positions), positions.dtype
    blocks = -(-n // BLOCK)
    width = -(-n // blocks)
    spare = ((0, blocks * width - n), (0, 0), (0, 0))
    place, lists, reaches = posts(positions), jnp.pad(sides, spare), jnp.pad(seen.reach, spare)
    grid = jax.tree.map(lambda column: column[:, 0], see_lines(lines, tube, dtype))

    def block(start: Array) -> Array:
        which = start + jnp.arange(width)
        those = lists[which].transpose(2, 1, 0)
        own, others = (Posts(*(column[at] for column in place)) for at in (which, those))
        rivals = see_rivals(own, others, those < which, tube)

        def nearer(least: Array, line: tuple[Grid, Array]) -> tuple[Array, None]:
            at, reach = line
            away = jnp.maximum(meeting(at, rivals, tube) - reach, 0) * 2 * rivals.half
            foot = jnp.maximum(at.z * rivals.cosine + at.y * rivals.sine, tube.apical_radius)
            feet = 4 * rivals.half**2 + foot**2 + at.foot**2 - 2 * foot * at.foot * rivals.cosine
            return jnp.where(reach > -jnp.inf, jnp.minimum(least, away**2 / feet), least), None

        far = jnp.full(rivals.half.shape, jnp.inf, dtype)
        least, _ = jax.lax.scan(nearer, far, (grid, reaches[which].transpose(2, 1, 0)))
        return jnp.where(rivals.half < FAR, least, jnp.inf).transpose(2, 1, 0)

    least = jax.lax.map(block, width * jnp.arange(blocks)).reshape(blocks * width, *sides.shape[1:])
    return jnp.where(seen.touched, -1, least[:n])


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
