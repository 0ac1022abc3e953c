"""Half planes of one layer: the lines that bound a cell's section, and where they cut each other.

All tables have the lines first and then the axes of layers and cells, *T, which are treated alike.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxtissue.compilation.fusion import fusion_barrier, take_rows
from jaxtissue.geometry.vectors import Vector, add, dot, scale, turned

FAR = 1e6  # sections are in lengths; nothing is as far as that many of them
PARALLEL = 1e-6  # the sine of an angle below which two lines never meet
CHUNK = 24  # lines in one turn of the loop


class HalfPlanes(NamedTuple):
    """The points z with n . z <= c, for unit normals n and offsets c, [lines, *T]."""

    normal: Vector
    offset: Array


def cut(planes: HalfPlanes, anchor: Array) -> Bool[Array, "lines *T"]:
    """Cut each line by all others, no order, no branch: of which something is left, these are edges of the polygon.

    Line j is the points c_j n_j + s t_j, and s (n_k . t_j) <= c_k - c_j n_k . n_j for all k. Only the numbers of lines
    go on from here into sizes, so derivatives stop. Start and end are one complex number: two results would each
    repeat the loop.
    """
    planes = jax.tree.map(jax.lax.stop_gradient, planes)
    c, along = planes.offset, turned(planes.normal)
    lines = c.shape[0]

    def narrow(start: Array, end: Array, other: HalfPlanes) -> tuple[Array, Array]:
        slope = dot(other.normal, along)
        room = other.offset - c * dot(other.normal, planes.normal)
        crossed = jnp.abs(slope) > PARALLEL
        at = room / jnp.where(crossed, slope, 1)
        never = ~crossed & (room < -10 * PARALLEL * jnp.abs(c))  # a line does not end itself, by rounding
        upper = jnp.where(crossed & (slope > 0), at, jnp.where(never, -FAR, FAR))
        lower = jnp.where(crossed & (slope < 0), at, -FAR)
        return jnp.where(lower > start, lower, start), jnp.where(upper < end, upper, end)

    def several(found: Array, some: HalfPlanes) -> Array:
        start, end = found.real, found.imag
        for k in range(some.offset.shape[0]):
            start, end = narrow(start, end, jax.tree.map(lambda table, at=k: table[at], some))
        return jax.lax.complex(start, end)

    found = jax.lax.complex(jnp.full_like(c, -FAR), jnp.full_like(c, FAR))
    at_once = max(k for k in range(1, min(lines, CHUNK) + 1) if lines % k == 0)  # no rest, which is compiled apart
    chunks = jax.tree.map(lambda table: table.reshape(-1, at_once, *table.shape[1:]), planes)

    def turn(found: Array, chunk: HalfPlanes) -> tuple[Array, None]:
        return fusion_barrier(lambda: several(found, chunk), anchor), None

    found, _ = jax.lax.scan(turn, found, chunks)
    return found.real < found.imag


def nearer_corners(
    is_corner: Bool[Array, "slots *T"], points: Vector, away: Array, offset: Callable[[Vector], Vector], anchor: Array
) -> tuple[Array, Int[Array, "q *T"]]:
    """How much nearer the own backbone is than each rival at the corner where that is nearest, as squares.

    `away` are the squares for the own backbone, `offset` leads from all rivals to a point. The number of the corner
    rides in the lowest bits. Also returns, in bits, the corners to which each rival is nearer; both are one complex
    number, since two results would each repeat the loop.
    """
    slots, recast = is_corner.shape[0], jax.lax.bitcast_convert_type
    integer = jnp.int64 if away.dtype == jnp.float64 else jnp.int32

    def search() -> Array:
        best, bits = jnp.asarray(FAR, away.dtype), jnp.zeros((), integer)
        for k in range(slots):
            theirs = offset(tuple(part[k] for part in points))
            coded = with_number(dot(theirs, theirs) - away[k], k, slots)
            best = jnp.where(is_corner[k] & (coded < best), coded, best)
            bits = jnp.where(is_corner[k] & (coded < 0), bits | (1 << k), bits)
        return jax.lax.complex(best, recast(bits, away.dtype))

    found = fusion_barrier(search, anchor)
    return found.real, recast(found.imag, integer).astype(jnp.int32)


def with_number(size: Array, number: Array | int, count: int) -> Array:
    """A size whose lowest bits hold a number below a count: the least or largest of several tells which it is."""
    integer, least = _lowest_bits(size, count)
    recast = jax.lax.bitcast_convert_type
    return recast((recast(size, integer) & least) | jnp.asarray(number, integer), size.dtype)


def number_in(size: Array, count: int) -> Int[Array, "..."]:
    """The number that a size holds."""
    integer, least = _lowest_bits(size, count)
    number = jax.lax.bitcast_convert_type(size, integer) & ~least
    return jnp.minimum(number.astype(jnp.int32), count - 1)


def _lowest_bits(size: Array, count: int) -> tuple[Any, Array]:
    integer = jnp.int64 if size.dtype == jnp.float64 else jnp.int32
    return integer, jnp.asarray(-1 << max(5, (count - 1).bit_length()), integer)


def crossing(one: HalfPlanes, other: HalfPlanes, least: float) -> Vector:
    """Where two lines cross each other; on the first, at its foot, where the sine of their angle is below `least`."""
    along = turned(one.normal)
    slope = dot(other.normal, along)
    room = other.offset - one.offset * dot(other.normal, one.normal)
    crossed = jnp.abs(slope) > least
    share = jnp.where(crossed, room / jnp.where(crossed, slope, 1), 0)
    return add(scale(one.offset, one.normal), scale(share, along))


class Packed(NamedTuple):
    """The lines that exist, in the first slots.

    Attributes:
        line: Their numbers, [slots, *T].
        is_edge: Which slots are filled.
        slot: The slot of each line that exists, [lines, *T].
    """

    line: Int[Array, "slots *T"]
    is_edge: Bool[Array, "slots *T"]
    slot: Int[Array, "lines *T"]


def pack(exists: Bool[Array, "lines *T"], slots: int) -> Packed:
    """Put the lines that exist into slots."""
    lines, extra = exists.shape[0], (1,) * (exists.ndim - 1)
    before = jnp.tril(jnp.ones((lines, lines), jnp.float32))
    count = jnp.tensordot(before, exists.astype(jnp.float32), 1).astype(jnp.int32)
    slot = jnp.arange(slots, dtype=jnp.int32).reshape(slots, *extra)
    is_edge, line = slot < count[-1:], jnp.zeros((slots, *exists.shape[1:]), jnp.int32)
    for k in range(lines):  # a reduction along an axis that is not the last takes ten times as long
        line += count[k] <= slot
    return Packed(jnp.where(is_edge, line, 0), is_edge, jnp.clip(count - 1, 0, slots - 1))


def take(tables: Any, number: Int[Array, "slots *T"]) -> Any:
    """The rows of tables [lines, *T] for numbers [slots, *T]; a table without layers is that of all layers."""

    def rows(table: Array) -> Array:
        # by one index: with one for each axis a gather takes several times as long
        width = math.prod(table.shape[1:])
        column = jnp.arange(width, dtype=number.dtype).reshape(table.shape[1:])
        return take_rows(table.reshape(-1), number * width + column)

    return jax.tree.map(rows, tables)
