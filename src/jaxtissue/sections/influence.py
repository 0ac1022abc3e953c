"""Which rivals have a say in the section of a cell: those that are a side of its polygon in any pass.

Any other rival could be left out, or moved without becoming such a side, and the section would stay as it is, to
rounding. So what a move changes is known before anything is measured.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxtissue.compilation.fusion import fusion_barrier
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, dot, subtract
from jaxtissue.sections.half_planes import FAR, nearer_corners
from jaxtissue.sections.polygons import Polygons, lines_at
from jaxtissue.sections.views import View, first_places

SLACK = 1e-5  # of the way to a corner, by which a line may miss it and counts as cutting it off


class Trace(NamedTuple):
    """What a further rival of a cell would have to cut off, in the first pass, or be nearer to, before the next ones.

    Attributes:
        rough: The corners of the lines in the first pass, [slots, *T].
        is_edge: Which there are.
        point: The corners in space, moved onto the walls, of all passes but the last, [passes - 1, slots, *T].
        away: The squares of their distances to the own backbone, negative where there is none.
    """

    rough: Vector
    is_edge: Bool[Array, "slots *T"]
    point: Vector
    away: Array


def trace_of(polygons: Polygons) -> Trace:
    """The trace of polygons."""
    is_edge, passes = polygons.passes.ring.is_edge, polygons.passes
    point = jax.tree.map(lambda table: table[:-1], passes.point)
    return Trace(polygons.rough, is_edge[0], point, jnp.where(is_edge[:-1], passes.away[:-1], -1))


def sides(polygons: Polygons, candidates: int) -> Bool[Array, "q cells"]:
    """Which candidates are a side of the polygon of a cell in any pass and on any layer."""
    ring = polygons.passes.ring
    number, found = jnp.arange(candidates).reshape(-1, 1, 1, 1), False
    for k in range(ring.line.shape[1]):
        found |= ring.is_edge[:, k] & (ring.line[:, k] == number)
    return jnp.asarray(found).any(axis=(1, 2))


def clearances(view: View, polygons: Polygons, unit: Float[Array, "layers 1"]) -> Float[Array, "q cells"]:
    """By how much each candidate's wall misses all corners, in any pass: at most 0 for sides; in the layers' units."""
    candidates, passes = view.is_there.shape[0], polygons.passes
    is_edge, rough = passes.ring.is_edge, polygons.rough
    x, y, offset = (table[:candidates, None] for table in (*polygons.planes.normal, polygons.planes.offset))
    room = (offset - x * rough[0] - y * rough[1]) / unit
    room = jnp.where(is_edge[0], room, FAR).min(axis=(1, 2))
    apart = subtract(view.rivals.apical, view.own.apical)
    half = 2 * jnp.sqrt(dot(apart, apart)) * unit
    for k in range(len(is_edge)):
        point = jax.tree.map(lambda table, k=k: table[k], passes.point)
        depth = nearer_corners(is_edge[k], point, passes.away[k], view.rivals.offset, view.anchor)[0]
        room = jnp.minimum(room, (depth / half).min(axis=1))
    return jnp.where(sides(polygons, candidates), jnp.minimum(room, 0), room)


def would_be_side(domain: Domain, view: View, trace: Trace) -> Bool[Array, " cells"]:
    """Whether the one rival that is looked at might be a side of the polygon if it were a candidate too.

    Its line cuts off a corner in the first pass, or it is nearer to a corner afterwards.
    """
    none = (jnp.zeros((1, *view.height.shape), view.height.dtype),) * 2

    def cuts() -> Array:
        line = lines_at(domain, view, first_places(view, view.frame(domain, none)))
        slack = SLACK * jnp.sqrt(dot(trace.rough, trace.rough))
        return (trace.is_edge & (dot(line.normal, trace.rough) > line.offset - slack)).any(axis=(0, 1))

    def is_nearer() -> Array:
        theirs = view.rivals.offset(trace.point)
        return (dot(theirs, theirs) < (1 + SLACK) * trace.away).any(axis=(0, 1, 2))

    return fusion_barrier(cuts, view.anchor) | fusion_barrier(is_nearer, view.anchor)
