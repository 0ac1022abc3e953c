"""Which backbones can bound which cell: candidate lists, kept complete by an exact sum.

A list must hold every rival that stops a cell on some line; more only cost time. Lists come from measured
contacts: whoever can come to touch a cell when one backbone moves is within two hops of it, and when all move
by a fraction of a cell, within three hops and not far.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse

from jaxtissue.cells import (
    LEVEL,
    CellGeometry,
    Posts,
    Survey,
    measure_cells,
    posts,
    see_angles,
    see_rivals,
    stop,
    walls,
)
from jaxtissue.lines import PRESETS, Lines, Resolution, plan_lines
from jaxtissue.tube import Tube

REACH = 2.5  # mean cell widths on either side of a backbone that a first window of lines covers
SKIN = 2.5  # mean cell widths within which cells three hops apart are candidates too
TILES = 1e-4  # relative defect of the lengths along a line above which lists are taken as incomplete

_measure = jax.jit(measure_cells, static_argnames="lines")


def measure_tissue(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, resolution: Resolution = PRESETS["standard"]
) -> tuple[CellGeometry, float]:
    """Sizes of every cell of a tissue, with its surfaces, and the defect of an exact sum over all cells.

    The defect is the largest relative error of the cells' lengths summed along a line, `tiling_defect`: 0 to
    rounding unless a candidate list overflowed. Lists and windows are grown until nothing overflows, so this
    takes concrete arrays; inside `jit` call `measure_cells`. Positions as (axial, angle), [n, 2].
    """
    sides = sided(find_candidates(positions, tube), positions, tube)
    cells, _, _ = survey_tissue(positions, tube, sides, resolution, surfaces=True)
    return cells, float(tiling_defect(positions, tube, jnp.asarray(sides)))


def survey_tissue(
    positions: Float[Array | np.ndarray, "n 2"],
    tube: Tube,
    sides: Int[np.ndarray, "n 2 side_candidates"],
    resolution: Resolution,
    surfaces: bool = False,
) -> tuple[CellGeometry, Survey, Lines]:
    """Measure every cell, in windows of lines widened until they hold all of it."""
    for reach in (REACH, 2 * REACH, math.inf):
        lines = plan_lines(tube, len(positions), resolution, reach, surfaces)
        cells, survey = _measure(positions, tube, lines, jnp.asarray(sides))
        if not survey.overflow.any():
            break
    return cells, survey, lines


def find_candidates(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube
) -> Int[np.ndarray, "n candidates"]:
    """Complete candidate lists, padded with the cell itself, from the nearest backbones.

    As many nearest are taken as it needs for the cells' intervals to tile every line; contacts measured with
    them give the lists.
    """
    count = 64
    while True:
        everyone = count >= len(positions) - 1
        sides = sided(padded(nearest(positions, tube, count), 1), positions, tube)
        if everyone or tiling_defect(positions, tube, sides) < TILES:
            _, survey, _ = survey_tissue(positions, tube, sides, PRESETS["draft"], surfaces=True)
            lists = hop_lists(contact_graph(positions, tube, sides, survey), positions, tube)
            found = padded(sided(lists, positions, tube), sides.shape[2])  # the same shape compiles once
            if everyone or tiling_defect(positions, tube, found) < TILES:
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
    positions: Float[Array | np.ndarray, "n 2"],
    tube: Tube,
    sides: Int[np.ndarray, "n 2 side_candidates"],
    survey: Survey,
) -> sparse.csr_array:
    """Who stops whom, as a symmetric [n, n] matrix, on the lines where the cells were surveyed."""
    by, n = np.asarray(survey.by), len(positions)
    line, side, cell = np.nonzero(by >= 0)
    other = sides[cell, side, by[line, side, cell]]
    place = np.asarray(positions, float)
    gap, turn = place[sides, 0] - place[:, None, None, 0], place[sides, 1] - place[:, None, None, 1]
    level = (np.abs(gap) <= 2 * LEVEL * float(tube.apical_radius)) & (sides != np.arange(n)[:, None, None])
    beside = (
        np.abs(np.sin(turn / 2)) <= 1.01 * np.sin(np.asarray(survey.limit).max(axis=0))[:, None, None] + 1e-6
    )
    rows, _, columns = np.nonzero(level & beside)
    rows, columns = np.r_[cell, rows], np.r_[other, sides[level & beside]]
    graph = sparse.coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(n, n)).tocsr()
    return (graph + graph.T).astype(bool).tocsr()


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
    radius = jnp.repeat(tube.apical_radius + share * (tube.basal_radius - tube.apical_radius), 16)[
        :, None, None
    ]
    place = posts(positions)
    own, others = place, Posts(*(column[sides.transpose(2, 1, 0)] for column in place))
    offset = jnp.mod(jnp.tile(angle, 5)[:, None, None] - own.angle + np.pi, 2 * np.pi) - np.pi
    ends = jnp.stack([own.axial, tube.length - own.axial])
    rivals, limit = see_rivals(own, others, sides.transpose(2, 1, 0) != jnp.arange(len(positions)), tube)
    grid = see_angles(radius, offset, tube)
    by, rival = stop(grid, rivals, ends, tube, own.axial[0] > -1)
    length = walls(by, rival, ends, grid, tube).reach.sum(axis=1)
    inside = (offset[:, 0] >= -limit[0]) & (offset[:, 0] < limit[1])
    return jnp.abs(jnp.where(inside, jnp.maximum(length, 0), 0).sum(axis=1) / tube.length - 1).max()
