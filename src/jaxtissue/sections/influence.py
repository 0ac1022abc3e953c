"""Which rivals have a say in the section of a cell: those that are a side of its polygon in any pass.

Any other rival could be left out, or moved without becoming such a side, and the section would stay as it is, to
rounding. So what a move changes is known before anything is measured.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, dot
from jaxtissue.sections.half_planes import FAR, farthest
from jaxtissue.sections.polygons import Polygon, lines_at
from jaxtissue.sections.views import View, first_places

SLACK = 1e-5  # of the way to a corner, by which a line may miss it and counts as cutting it off


class Trace(NamedTuple):
    """The polygons of cells pass by pass; tables are [passes, slots, *T]."""

    rough: Vector  # corners of the lines
    corner: Vector  # the same, moved onto the walls
    is_edge: Bool[Array, "passes slots *T"]


def trace_of(polygons: Polygon) -> Trace:
    """The trace of polygons, [passes, ...]."""
    return Trace(polygons.rough, polygons.end, polygons.packed.is_edge)


def sides(polygons: Polygon, candidates: int) -> Bool[Array, "q cells"]:
    """Which candidates are a side of the polygon of a cell in any pass and on any layer."""
    return polygons.exists[:, :candidates].any(axis=(0, 2))


def clearances(polygons: Polygon, candidates: int, unit: Float[Array, "layers 1"]) -> Float[Array, "q cells"]:
    """By how much each candidate's line misses all corners, in any pass: at most 0 for sides; in the layers' units."""
    normal, offset = (polygons.planes.normal, polygons.planes.offset)
    x, y, offset = (table[:, :candidates, None] for table in (*normal, offset))
    corners = tuple(part[:, None] for part in polygons.rough)
    room = (offset - x * corners[0] - y * corners[1]) / unit
    return jnp.where(polygons.packed.is_edge[:, None], room, FAR).min(axis=(0, 2, 3))


def would_be_side(domain: Domain, view: View, trace: Trace) -> Bool[Array, " cells"]:
    """Whether the one rival that is looked at would be a side of the polygon if it were a candidate too.

    Its line is followed through the passes as it would be taken if it cut nothing.
    """
    none = (jnp.zeros((1, *view.height.shape), view.height.dtype),) * 2

    def follow(z: Vector, one: Trace) -> tuple[Vector, Array]:
        line, slack = lines_at(domain, view, z), SLACK * jnp.sqrt(dot(one.rough, one.rough))
        cuts = one.is_edge & (dot(line.normal, one.rough) > line.offset - slack)
        return farthest(one.corner, one.is_edge, line.normal, view.anchor), cuts.any(axis=(0, 1))

    return jax.lax.scan(follow, first_places(view, view.frame(domain, none)), trace)[1].any(axis=0)
