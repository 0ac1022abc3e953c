"""The edges of polygons in their order, each in a slot that knows the slots before and after it.

All tables have the slots first and then the axes of layers and cells, *T, which are treated alike.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxtissue.geometry.vectors import Vector
from jaxtissue.sections.half_planes import Packed, number_in, take, with_number

WALK = 3  # edges that are passed at most to find where a line that is put in crosses the polygon
NEVER = 8.0  # no angle


class Ring(NamedTuple):
    """Edges, counterclockwise, by the numbers of their lines; edge s ends in corner s, where the next one starts."""

    line: Int[Array, "slots *T"]
    is_edge: Bool[Array, "slots *T"]
    before: Int[Array, "slots *T"]  # slots
    after: Int[Array, "slots *T"]


class Insertion(NamedTuple):
    """An edge that is put in: on which line, and the slots of the edges that it crosses, all [1, *T]."""

    line: Int[Array, "1 *T"]
    first: Int[Array, "1 *T"]
    last: Int[Array, "1 *T"]
    slot: Int[Array, "1 *T"]
    is_new: Bool[Array, "1 *T"]


def numbered(table: Array) -> Array:
    """The numbers of the slots, to be compared with a table's."""
    return jnp.arange(table.shape[0], dtype=jnp.int32).reshape(-1, *(1,) * (table.ndim - 1))


def ordered(packed: Packed, normal: Vector) -> Ring:
    """The edges of a convex polygon, by the angles of their normals."""
    slots = len(packed.line)
    x, y = normal
    share = y / jnp.maximum(jnp.abs(x) + jnp.abs(y), 1e-30)
    angle = jnp.where(x < 0, 2 - share, share)  # grows with the angle, from -1 to 3
    ahead = behind = jnp.full_like(angle, NEVER)
    for k in range(slots):
        turn = angle[k] - angle
        apart = (packed.is_edge[k]) & (numbered(angle) != k)
        for sign in (1, -1):
            way = jnp.where(apart, jnp.where(sign * turn > 0, sign * turn, sign * turn + 4), NEVER)
            coded = with_number(way, k, slots)
            if sign > 0:
                ahead = jnp.where(coded < ahead, coded, ahead)
            else:
                behind = jnp.where(coded < behind, coded, behind)
    after, before = (number_in(jax.lax.stop_gradient(turn), slots) for turn in (ahead, behind))
    return Ring(packed.line, packed.is_edge, before, after)


def without(ring: Ring, goes: Bool[Array, "slots *T"]) -> Ring:
    """The ring without some edges, of which no more than two follow each other."""
    before, after = ring.before, ring.after
    for _ in range(2):
        before = jnp.where(take(goes, before), take(ring.before, before), before)
        after = jnp.where(take(goes, after), take(ring.after, after), after)
    return Ring(ring.line, ring.is_edge & ~goes, before, after)


def pairs_at_most(marked: Bool[Array, "slots *T"], ring: Ring) -> Bool[Array, "slots *T"]:
    """The marked edges but those that are the third or a later one in a row."""
    return marked & ~(take(marked, ring.before) & take(marked, take(ring.before, ring.before)))


def inserted(ring: Ring, line: Array, outside: Array, corner: Array, is_new: Array) -> tuple[Ring, Insertion]:
    """The ring with a further line, [1, *T], that cuts off the given corner and others outside, whose bits are set.

    Without a free slot it stays as it is.
    """
    slot = numbered(ring.line)

    def is_outside(number: Array) -> Array:
        return is_new & (((outside >> number) & 1) == 1)

    first, last, gone = corner, take(ring.after, corner), jnp.zeros_like(ring.is_edge)
    for _ in range(WALK):
        earlier = take(ring.before, first)
        moves = is_outside(earlier)
        gone |= moves & (slot == first)
        first = jnp.where(moves, earlier, first)
        moves = is_outside(last)
        gone |= moves & (slot == last)
        last = jnp.where(moves, take(ring.after, last), last)
    stays = ring.is_edge & ~gone
    free = jnp.where(stays, len(slot), slot).min(axis=0, keepdims=True)
    is_new &= free < len(slot)
    found = Insertion(line, first, last, jnp.minimum(free, len(slot) - 1), is_new)
    at = is_new & (slot == found.slot)
    fresh = Ring(
        jnp.where(at, line, ring.line),
        jnp.where(is_new, stays | at, ring.is_edge),
        jnp.where(at, first, jnp.where(is_new & (slot == last), found.slot, ring.before)),
        jnp.where(at, last, jnp.where(is_new & (slot == first), found.slot, ring.after)),
    )
    return fresh, found
