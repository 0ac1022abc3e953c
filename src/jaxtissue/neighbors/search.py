"""The backbones that can bound each cell: neighbor lists, complete by an exact sum.

A list must hold every rival that stops a cell on a line; more only cost time. They are found among the
backbones nearest along the axis.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy import sparse

from jaxtissue.compilation.fusion import fusion_barrier, options
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import LEVEL, backbone_coords, coords_by_side, pick, turned_in_frame
from jaxtissue.measurement.cells import BLOCK
from jaxtissue.measurement.quadrature import REACH
from jaxtissue.measurement.walls import least_reach

T = TypeVar("T", np.ndarray, Array)
NEAREST = 112  # backbones that are candidates of each cell, unless it needs more
A_SIDE = 56  # of them at most on one side, where cells at the ends of the tube have all
ROWS = 128  # cells compared at once: tables that fit the cache
TILES = 1e-5  # relative defect of the lengths along a line above which lists are taken as incomplete


@usual_modes()
def find_candidates(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, margin: float = 0.0
) -> Int[np.ndarray, "n 2 side_candidates"]:
    """Complete neighbor lists, behind and ahead of each cell, padded with the cell itself.

    As many nearest backbones are taken as it takes for the cells to tile every line; those within `margin`
    along the axis stand on both sides.
    """
    return complete_lists(positions, tube, margin)[0]


class Check(NamedTuple):
    """The defect of neighbor lists on the lines of `check_angles`, and the cells that reach far."""

    defect: Any  # the lists' `tiling_defect`
    is_far: Any  # [n], it has a part farther round than `far_angle`


def complete_lists(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, margin: float = 0.0
) -> tuple[Int[np.ndarray, "n 2 side_candidates"], Check]:
    """As `find_candidates`, with the `check_lists` of the lists."""
    for sides, has_all in candidate_lists(positions, tube, margin):
        check = find_check(positions, tube, sides)
        if has_all or check.defect < TILES:
            return sides, check
    raise AssertionError("lists that have all are complete")


def find_defect(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, sides: Int[Array | np.ndarray, "n 2 candidates"]
) -> float:
    """`tiling_defect` of arrays at hand, by a program that is compiled soon."""
    return float(find_check(positions, tube, sides).defect)


def find_check(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, sides: Int[Array | np.ndarray, "n 2 candidates"]
) -> Check:
    """`check_lists` of arrays at hand, by a program that is compiled soon."""
    found = _checking()(positions, tube, sides, check_angles(tube, len(positions)))
    return Check(*map(np.asarray, found))


@functools.cache
def _checking() -> Callable[..., Check]:
    return jax.jit(check_lists, compiler_options=options(light=True))


class Attempt(NamedTuple):
    """Neighbor lists: complete if they have all cells, or if their `tiling_defect` is below TILES."""

    sides: Int[np.ndarray, "n 2 side_candidates"]
    has_all: bool


def candidate_lists(positions: Float[Array | np.ndarray, "n 2"], tube: Tube, margin: float = 0.0) -> Iterator[Attempt]:
    """Longer and longer lists, from NEAREST candidates up to all cells."""
    count = NEAREST
    while True:
        most = A_SIDE * count // NEAREST
        sides = split_by_side(nearest_along_axis(positions, tube, count), positions, tube, margin, most=most)
        yield Attempt(sides, most >= len(positions) - 1)
        count += count // 2


def nearest_along_axis(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, count: int
) -> Int[np.ndarray, "n count"]:
    """The `count` backbones nearest to each by `spacing`, among those next to it along the axis, in order."""
    place, n = np.asarray(positions, float), len(positions)
    count = min(count, n - 1)
    density, radii = n / float(tube.length), (float(tube.apical_radius), float(tube.basal_radius))
    width = math.sqrt(2 * math.pi * radii[1] / density)
    # on either side; 6 mean cell widths at the basal surface, where NEAREST are as many as usual
    window = min(n - 1, max(count, math.ceil(6 * density * width * count / NEAREST)))
    order = np.argsort(place[:, 0], kind="stable").astype(np.int32)
    axial, angle = place[order].T
    row = np.zeros((3, n + 2 * window), np.float32)
    row[0] = np.inf  # past the ends
    row[:, window : window + n] = axial, np.cos(angle), np.sin(angle)
    beside = sliding_window_view(row, 2 * window + 1, axis=-1)  # no copy
    lists = np.empty((n, count), np.int32)
    for start in range(0, n, ROWS):
        some = beside[:, start : start + ROWS]
        own = some[:, :, window, None]
        cosine, sine = some[1:] * own[1:]
        cosine += sine
        score = spacing_at(some[0] - own[0], cosine, *radii)
        score[:, window] = np.inf
        rank = lowest_columns(score, count) + np.arange(start - window, start - window + len(score))[:, None]
        lists[order[start : start + ROWS]] = order[rank]
    return lists


def lowest_columns(scores: Float[np.ndarray, "... columns"], count: int) -> Int[np.ndarray, "... count"]:
    """Columns of about the `count` lowest scores of each row, in order; scores are at least 0.

    Score and column are coded as one integer, since a partition of those is fast. So scores are compared to
    as many bits less than single precision has as number the columns; of equals the first is the lower.

    >>> lowest_columns(np.array([[3.0, 1.0, np.inf, 0.0, 3.0]]), 3)
    array([[3, 1, 0]], dtype=int32)
    """
    count = min(count, scores.shape[-1])
    columns = (1 << (scores.shape[-1] - 1).bit_length()) - 1
    coded = np.asarray(scores, np.float32).view(np.int32) & ~columns
    coded |= np.arange(scores.shape[-1], dtype=np.int32)
    coded.partition(max(count - 1, 0), axis=-1)
    return np.sort(coded[..., :count], axis=-1) & columns


def spacing(place: np.ndarray, first: np.ndarray, second: np.ndarray, tube: Tube) -> np.ndarray:
    """Distance of backbones `first` and `second`, the least over radii in units of the square root of these.

    Squared, up to a constant factor: so it is measured in mean cell widths.
    """
    gap = place[first, 0] - place[second, 0]
    radii = float(tube.apical_radius), float(tube.basal_radius)
    return spacing_at(gap, np.cos(place[first, 1] - place[second, 1]), *radii)


def spacing_at(gap: T, cosine: T, inner: Any, outer: Any, xp: Any = np) -> T:
    """The same for backbones `gap` apart along the axis, and at an angle of that cosine: arrays of `xp`."""
    square, flat = gap * gap, 1 - cosine * cosine
    score = square * (1 / inner) + 2 * inner * (1 - cosine)  # at the apical surface
    for radius in ((inner * outer) ** 0.5, outer):
        apart = xp.maximum(inner - radius * cosine, 0)  # where the foot is the apical end
        apart *= apart
        apart += square
        apart *= 1 / radius
        apart += radius * flat
        score = xp.minimum(score, apart)
    return score


def contact_graph(
    sides: Int[np.ndarray, "n 2 candidates"], touched: Bool[Array | np.ndarray, "n 2 candidates"]
) -> sparse.csr_array:
    """The pairs of cells that bound each other, as a symmetric [n, n] matrix."""
    at = np.flatnonzero(touched)
    return symmetric_graph(at // sides[0].size, sides.reshape(-1)[at], len(sides))


def symmetric_graph(first: Int[np.ndarray, "pairs"], second: Int[np.ndarray, "pairs"], n: int) -> sparse.csr_array:
    """Pairs of `n` cells as a symmetric matrix of bools, [n, n], without diagonal.

    >>> symmetric_graph(np.array([0, 2, 2]), np.array([1, 0, 2]), 3).toarray().astype(int)
    array([[0, 1, 1],
           [1, 0, 0],
           [1, 0, 0]])
    """
    first, second = first.astype(np.int64), second.astype(np.int64)
    pairs = np.concatenate([first * n + second, second * n + first])
    pairs.sort()
    cell, other = np.divmod(pairs[np.diff(pairs, prepend=-1) > 0], n)
    cell, other = cell[cell != other], other[cell != other]
    start = np.searchsorted(cell, np.arange(n + 1)).astype(np.int32)
    return sparse.csr_array((np.ones(len(cell), bool), other.astype(np.int32), start), shape=(n, n))


def split_by_side(
    lists: Int[np.ndarray, "n candidates"],
    positions: Float[Array | np.ndarray, "n 2"],
    tube: Tube,
    margin: float = 0.0,
    most: int | None = None,
) -> Int[np.ndarray, "n 2 side_candidates"]:
    """Candidates split into those behind and those ahead along the axis; within `margin`, both.

    Of each side the first `most`, in order of their numbers: of reaches that its codes cannot tell apart
    `bounding_neighbor` takes the first, and short lists must take the same as long ones.
    """
    axial, own = np.asarray(positions, float)[:, 0], np.arange(len(lists), dtype=np.int32)[:, None]
    gap, none = axial[lists] - axial[:, None], lists.shape[1]
    margin = max(margin, 2 * LEVEL * float(tube.apical_radius))
    chosen = np.stack([gap <= margin, gap >= -margin], axis=1) & (lists != own)[:, None]
    width = max(1, int(chosen.sum(axis=2, dtype=np.int32).max(initial=0)))
    width = -(-width // 24) * 24  # few shapes, so few compilations
    width = width if most is None else min(width, most)
    # place in the list and number as one integer, since sorting those is fast; the cell itself is taken last
    bits = len(lists).bit_length()
    kind = np.int32 if (none + 1) << bits < 2**31 else np.int64
    coded, last = lists | np.arange(none, dtype=kind) << bits, own | kind(none << bits)
    ordered = (coded - last)[:, None] * chosen + last[:, None]  # `where` takes four times as long
    ordered.sort(axis=2)
    few = (ordered[..., :width] & (1 << bits) - 1).astype(np.int32)
    few.sort(axis=2)
    return pad_lists(few, width)


def pad_lists(lists: Int[np.ndarray, "n ... candidates"], width: int) -> Int[np.ndarray, "n ... width"]:
    """Lists lengthened to `width` with the cell itself."""
    own = np.arange(len(lists), dtype=np.int32).reshape(-1, *[1] * (lists.ndim - 1))
    more = np.broadcast_to(own, (*lists.shape[:-1], max(0, width - lists.shape[-1])))
    return np.concatenate([lists, more], axis=-1)


def check_angles(tube: Tube, cells: int) -> Float[np.ndarray, "layers lines"]:
    """The angles of the lines of `tiling_defect`: 64 in each of 5 layers, more where more cells are around.

    Layers stand between each other, so that together there are eight lines or more for each basal cell width.
    """
    around = math.sqrt(2 * math.pi * float(tube.basal_radius) * cells / float(tube.length))
    lines = 64 * math.ceil(2 * around / (5 * 16))
    between = np.array([0.0, 0.4, 0.8, 0.2, 0.6])
    return (0.123 + 2 * math.pi / lines * (np.arange(lines) + between[:, None])).astype(np.float32)


@usual_modes()
@jax.jit
def tiling_defect(
    positions: Float[Array | np.ndarray, "n 2"],
    tube: Tube,
    sides: Int[Array | np.ndarray, "n 2 candidates"],
    angles: Float[Array | np.ndarray, "layers lines"],
) -> Float[Array, ""]:
    """Largest relative error of the cells' lengths summed along a line, |sum_i (hi_i - lo_i)+ - L| / L.

    The lines, at `check_angles` in layers from surface to surface, are the same for all cells, so the
    intervals tile each of them exactly unless a list lacks a rival there. What is lacking only between them
    stays unseen: a small part of a cell.
    """
    return check_lists(positions, tube, sides, angles).defect


def check_lists(
    positions: Float[Array | np.ndarray, "n 2"],
    tube: Tube,
    sides: Int[Array | np.ndarray, "n 2 candidates"],
    angles: Float[Array | np.ndarray, "layers lines"],
) -> Check:
    """The `tiling_defect` of lists, and which cells have parts far from their own backbones."""
    n, dtype = len(positions), positions.dtype
    layers, count = angles.shape
    share, angle = jnp.linspace(0, 1, layers, dtype=dtype), jnp.asarray(angles, dtype).ravel()[:, None]
    radius = jnp.repeat(tube.apical_radius + share * (tube.basal_radius - tube.apical_radius), count)[:, None]
    turn = jax.lax.complex(jnp.cos(angle), jnp.sin(angle))
    place, lists = backbone_coords(positions), jnp.asarray(sides)
    width = min(n, BLOCK)
    near = radius * jnp.cos(jnp.minimum(far_angle(tube, n, radius), math.pi))

    def fill(start: Array) -> tuple[Float[Array, "lines"], Bool[Array, "width"]]:
        """The part of each line that a block of cells fills beyond its share of the cells: sums that stay small."""
        which = start + jnp.arange(width)
        cells = jnp.minimum(which, n - 1)
        numbers = lists[cells].transpose(2, 1, 0)
        own, others = pick(place, cells), pick(place, numbers)
        ends, truth = jnp.stack([own.axial, tube.length - own.axial]), own.axial[0] > -1
        rivals = fusion_barrier(lambda: coords_by_side(own, others, numbers < cells, tube), truth)
        grid = fusion_barrier(lambda: turned_in_frame(radius, turn, own), truth)
        length = least_reach(grid, rivals, ends, tube, truth).sum(axis=1)
        is_far = ((length > 0) & (grid.z < near)).any(axis=0)
        spare = jnp.where(which < n, jnp.maximum(length, 0) - tube.length / n, 0)
        return spare.sum(axis=1), is_far

    blocks, is_far = jax.lax.map(fill, width * jnp.arange(-(-n // width)))
    return Check(jnp.abs(blocks.sum(axis=0)).max() / tube.length, is_far.ravel()[:n])


def far_angle(tube: Tube, cells: int, radius: Array) -> Array:
    """The angle from a backbone that the first window of lines is sure to cover at a radius."""
    return 0.95 * REACH * jnp.sqrt(2 * math.pi * tube.length / (cells * radius))
