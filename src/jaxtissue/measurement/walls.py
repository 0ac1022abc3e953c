"""The ends of cells: on each line parallel to the axis the walls against the nearest rivals behind and ahead.

With (x - x_j)^2 + f_j the squared distance to backbone j, as in `axial_lines`, a cell is one interval on each line;
seen from x_i it ends where the nearest rival takes over, at a *reach* of
h = |x_j - x_i| / 2 + (f_j - f_i) / (2 |x_j - x_i|) ahead (x_j > x_i) and behind, two mirrored sides. Between
two lines each side is taken as the two tangents of the walls h(t), whose slope and tilt are closed forms.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Int

from jaxtissue.compilation.fusion import arctan, fusion_barrier, larger, smaller, take_rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import FAR, LEVEL, LineFrame, RelativeCoords, crossing

BOUNDARY = -1
CHUNK = 24  # most candidates in one unrolled loop: of 8 it compiles 2 s sooner, and takes twice as long
PARALLEL = 1e-6  # of a reach: tangents that part by less between two lines are parallel
UNROLLED = 48  # most candidates whose loops follow each other without a loop around them

Pair = tuple[Array, Array]  # of a line and the next


class Walls(NamedTuple):
    """The walls that end each cell on each line, behind and ahead, [lines, 2, cells]."""

    tangent: Array  # reach + i dh/dt: again one table
    area: Array  # wall area per r dr dt; 0 at the tube's end
    edge: Array  # wall length on the layer per r dt

    @property
    def reach(self) -> Array:
        """The reach h."""
        return self.tangent.real

    @property
    def slope(self) -> Array:
        """Its derivative dh/dt."""
        return self.tangent.imag


def bounding_neighbor(
    grid: LineFrame, rivals: RelativeCoords, ends: Array, tube: Tube, truth: Array
) -> Int[Array, "lines 2 cells"]:
    """The candidate that stops each cell on each line, behind and ahead, or END for the tube.

    The candidate's number rides in the lowest bits of its reach, so that one value is carried along (two
    would each repeat the loop). That blurs the choice, not the reach, by 1.5e-5 of it; of more than 128
    candidates a side, as only crowded tissue needs, by 1e-4.
    """
    candidates, _, cells = rivals.half.shape
    # as many for short lists as for long ones, and lists are in order of numbers, so that both choose alike
    # where two reaches are so close
    bits = next(bits for bits in (7, 10, 16) if candidates <= 1 << bits)
    integer = jnp.int64 if ends.dtype == jnp.float64 else jnp.int32
    recast = jax.lax.bitcast_convert_type
    line = jax.tree.map(lambda table: table[:, None], grid)

    def nearer(least: Array, among: RelativeCoords, first: Array | int) -> Array:
        for number in range(len(among.half)):
            reach = crossing(line, jax.tree.map(lambda table, at=number: table[at], among), tube)
            coded = recast((recast(reach, integer) & (-1 << bits)) | (first + number), ends.dtype)
            least = jnp.where(coded < least, coded, least)
        return least

    least = jnp.broadcast_to(ends, (len(grid.z), 2, cells))
    if candidates <= UNROLLED:
        chunks = -(-candidates // CHUNK)
        for part in np.array_split(np.arange(candidates), chunks):
            some = jax.tree.map(lambda table, at=slice(part[0], part[-1] + 1): table[at], rivals)
            least = fusion_barrier(lambda least=least, some=some, at=part[0]: nearer(least, some, at), truth)
    else:
        tables = in_chunks(rivals)
        chunks, length = tables.half.shape[:2]
        first = length * jnp.arange(chunks, dtype=integer)

        def more(least: Array, some: tuple[RelativeCoords, Array]) -> tuple[Array, None]:
            return fusion_barrier(lambda: nearer(least, *some), truth), None

        least, _ = jax.lax.scan(more, least, (tables, first))
    winner = (recast(least, integer) & ((1 << bits) - 1)).astype(jnp.int32)
    return jnp.where(least < ends, winner, BOUNDARY)


def in_chunks(rivals: RelativeCoords) -> RelativeCoords:
    """Rivals in tables of CHUNK at most, [chunks, length, 2, cells], the last one padded with none."""
    candidates, *shape = rivals.half.shape
    chunks = -(-candidates // CHUNK)
    length = -(-candidates // chunks)
    spare = ((0, chunks * length - candidates), (0, 0), (0, 0))
    padded = (
        jnp.pad(table, spare, constant_values=nobody).reshape(chunks, length, *shape)
        for table, nobody in zip(rivals, (FAR, 0.0, 0.0, 0.0), strict=True)
    )
    return RelativeCoords(*padded)


def least_reach(grid: LineFrame, rivals: RelativeCoords, ends: Array, tube: Tube, truth: Array) -> Array:
    """The reach of each cell on each line, behind and ahead, [lines, 2, cells], as in its `walls`."""
    line = jax.tree.map(lambda table: table[:, None], grid)

    def nearer(least: Array, some: RelativeCoords) -> tuple[Array, None]:
        def compare() -> Array:
            nearest = least
            for number in range(len(some.half)):
                rival = jax.tree.map(lambda table, at=number: table[at], some)
                nearest = smaller(crossing(line, rival, tube), nearest)
            return nearest

        return fusion_barrier(compare, truth), None

    start = jnp.broadcast_to(ends, (len(grid.z), *ends.shape))
    return jax.lax.scan(nearer, start, in_chunks(rivals))[0]


def walls(by: Array, rivals: RelativeCoords, ends: Array, grid: LineFrame, tube: Tube, truth: Array) -> Walls:
    """Reach, slope and tilt of the walls that end each cell, against the rival there.

    A rival's turn is one complex number, versine + i sine: gathering two real ones takes twice as long. Walls
    that are level are seldom there, and only then looked for.
    """
    end, at = by == BOUNDARY, facing(by)

    def there(table: Array) -> Array:
        return fusion_barrier(lambda: take_rows(table.ravel(), at), truth)

    turn, half = there(jax.lax.complex(rivals.versine, rivals.sine)), there(rivals.half)
    level = is_level(rivals, tube).any()

    def forms(some_level: bool) -> Walls:
        return wall_forms(end, half, turn, ends, grid, tube, some_level)

    return jax.lax.cond(level, lambda: forms(True), lambda: forms(False))


def wall_forms(
    end: Bool[Array, "lines 2 cells"],
    half: Array,
    turn: Complex[Array, "lines 2 cells"],
    ends: Array,
    grid: LineFrame,
    tube: Tube,
    some_level: bool = True,
    smooth: bool = False,
) -> Walls:
    """The walls against rivals [lines, 2, cells], or against the tube's ends.

    Rivals are given by half their distance along the axis, and versine + i sine of their angle. If `some_level`, walls
    that are level are looked for; if `smooth`, so that derivatives stay finite.
    """
    line = jax.tree.map(lambda table: table[:, None], grid)
    per_gap = 0.5 / half
    rival = RelativeCoords(half, per_gap / 2, turn.real, turn.imag)
    reach, sagitta = crossing(line, rival, tube), line.sagitta_from(rival)
    foot_depth, own_sunk = smaller(sagitta, line.radius - tube.apical_radius), line.foot_depth(tube)
    slope = ((line.radius - foot_depth) * line.across(rival) - (line.radius - own_sunk) * line.y) * per_gap
    # the feet's s z = (r - m) (r - g), less the common r^2
    lower = line.radius * (own_sunk + line.sagitta - foot_depth - sagitta)
    tilt = (lower + foot_depth * sagitta - own_sunk * line.sagitta) * per_gap
    if some_level:
        slope, tilt = towards_plane(rival, line, reach, (slope, tilt), tube, smooth)
    slope = jnp.where(end, 0, slope)
    per_square = 1 / line.radius**2
    area = jnp.sqrt(1 + (slope**2 + tilt**2) * per_square)
    edge = jnp.sqrt(1 + slope**2 * per_square)
    tangent = jax.lax.complex(jnp.where(end, ends, reach), slope)
    return Walls(tangent, *(jnp.where(end, 0, size) for size in (area, edge)))


def facing(by: Int[Array, "lines 2 cells"]) -> Int[Array, "lines 2 cells"]:
    """Where a flat table of the candidates, [candidates, 2, cells], has the one that ends each cell on each line."""
    cells = by.shape[-1]
    return jnp.maximum(by, 0) * (2 * cells) + jnp.arange(2 * cells, dtype=by.dtype).reshape(2, cells)


def is_level(rivals: RelativeCoords, tube: Tube) -> Array:
    """Whether walls are as close to parallel to the axis as `relative_coords` lets them, but for rounding."""
    return rivals.half**2 <= (0.5005 * LEVEL * tube.apical_radius) ** 2 * 2 * rivals.versine


def towards_plane(
    rival: RelativeCoords, line: LineFrame, reach: Array, slopes: tuple[Array, Array], tube: Tube, smooth: bool
) -> tuple[Array, Array]:
    """Slope and tilt, of walls that are level: all but the radial plane half way between two backbones.

    There the reach is `half`, so the slope is that of the secant to it, and the tilt 0.
    """
    slope, tilt = slopes
    z, y = line.radius - line.sagitta_from(rival), line.across(rival)
    level = is_level(rival, tube)
    tangent = (line.y * z + line.z * y) / larger(line.radius**2 + line.z * z - line.y * y, 1e-12)
    aside = arctan(jnp.where(level, tangent, 0) if smooth else tangent)
    is_aside = jnp.abs(aside) > 1e-3
    secant = (reach - rival.half) / (jnp.where(is_aside, aside, 1) if smooth else aside)
    slope = jnp.where(level & is_aside, secant, slope)
    return slope, jnp.where(level, 0, tilt)


def strips(wall: Walls, tilt: Array, step: Array) -> Complex[Array, "strips cells"]:
    """Between each line and the next, per cell: layer area / r + i x the integral of the walls' `tilt` / r.

    Each side is the two walls' tangents up to where they meet. So three pieces, from 0 over the two meeting
    points to 1, each with a width linear from end to end: its positive part is integrated. Two lines outside
    the cell could only show a phantom of it and count nothing. One complex number, as two results would each
    repeat the work.
    """
    return _between(_pair(wall.reach), _pair(wall.slope), _pair(tilt), step[:-1])


def smooth_strips(wall: Walls, tilt: Array, step: Array, truth: Array) -> Complex[Array, "strips cells"]:
    """The same where parallel tangents meet nowhere, so that derivatives stay finite.

    Derivatives go back to the two lines behind a barrier: else those by a line are found again in each of its strips.
    """

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def between(tangent: Pair, tilt: Pair, step: Array) -> Array:
        first, last = tangent
        return _between((first.real, last.real), (first.imag, last.imag), tilt, step, smooth=True)

    pairs = _pair(wall.tangent), _pair(tilt)
    return fusion_barrier(lambda: between(*pairs, step[:-1]), truth)


def _pair(table: Array) -> Pair:
    return table[:-1], table[1:]


def _between(reach: Pair, slope: Pair, tilt: Pair, step: Array, smooth: bool = False) -> Array:
    rise = (slope[0] * step[:, None], slope[1] * step[:, None])
    turn = rise[0] - rise[1]
    if smooth:
        apart, meets = reach[1] - rise[1] - reach[0], jnp.abs(turn) > PARALLEL * (jnp.abs(reach[0]) + jnp.abs(reach[1]))
        bend = jnp.clip(jnp.where(meets, apart / jnp.where(meets, turn, 1), 0.5), 0, 1)
    else:
        bend = jnp.clip((reach[1] - rise[1] - reach[0]) / jnp.where(turn == 0, 1e-30, turn), 0, 1)
    early = bend[:, 0] <= bend[:, 1]

    def tangents(pair: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Sums over both sides before any meeting point, between the two, and after both."""
        (behind, ahead), (next_behind, next_ahead) = ((side[:, 0], side[:, 1]) for side in pair)
        between = jnp.where(early, next_behind + ahead, behind + next_ahead)
        return behind + ahead, between, next_behind + next_ahead

    cuts = (0.0, jnp.minimum(bend[:, 0], bend[:, 1]), jnp.maximum(bend[:, 0], bend[:, 1]), 1.0)
    bases, rises, tilts = (
        tangents((reach[0], reach[1] - rise[1])),
        tangents(rise),
        tangents(tilt),
    )
    inside = (reach[0][:, 0] + reach[0][:, 1] > 0) | (reach[1][:, 0] + reach[1][:, 1] > 0)
    layer_area = wall_size = jnp.zeros(())
    for start, end, base, climb, leaning in zip(cuts, cuts[1:], bases, rises, tilts, strict=False):
        first, last = base + climb * start, base + climb * end
        spread = jnp.abs(first) + jnp.abs(last)
        filled = (first + last + spread) / 2
        share = (end - start) * filled / jnp.where(spread > 0, spread, 1)
        layer_area += share * filled / 2
        wall_size += share * leaning
    live = jnp.where(inside, step, 0)
    return jax.lax.complex(layer_area * live, wall_size * live)
