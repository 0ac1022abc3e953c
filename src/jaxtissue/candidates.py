"""Which backbones can bound which cell: candidate lists, kept complete by an exact sum.

A list must hold every rival that stops a cell on some line; more only cost time. They are found among the
backbones nearest along the axis.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int
from scipy import sparse

from jaxtissue.cells import CellGeometry, measure_cells
from jaxtissue.lines import PRESETS, Resolution, plan_lines
from jaxtissue.tube import Tube
from jaxtissue.walls import LEVEL, Posts, posts, see_angles, see_rivals, settled, stop, walls

REACH = 2.5  # mean cell widths on either side of a backbone that a first window of lines covers
NEAREST = 96  # backbones that are candidates of each cell, unless it needs more
TILES = 1e-5  # relative defect of the lengths along a line above which lists are taken as incomplete

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
    first = jnp.asarray(lists < np.arange(len(positions)))
    rivals = settled(lambda: see_rivals(own, others, first, tube), truth)
    grid = see_angles(radius, offset)
    by = stop(grid, rivals, ends, tube, truth)
    length = walls(by, rivals, ends, grid, tube, truth).reach.sum(axis=1)
    return jnp.abs(jnp.maximum(length, 0).sum(axis=1) / tube.length - 1).max()
