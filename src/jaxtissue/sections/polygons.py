"""The polygon of each cell on a layer: which walls bound it, in their order, and where they meet.

On a layer a cell is nearly a polygon, since walls between neighbors are nearly flat. At first each rival's wall is one
line, taken at half the way to it, and lines cut each other. Then corners move onto the true walls; edges that have
turned round go, and rivals that are nearer to a corner come in there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxtissue.compilation.fusion import fusion_barrier
from jaxtissue.geometry.domains import Domain, Frame
from jaxtissue.geometry.vectors import Vector, add, dot, each, scale, subtract, turned
from jaxtissue.sections.half_planes import (
    FAR,
    HalfPlanes,
    crossing,
    cut,
    nearer_corners,
    number_in,
    pack,
    take,
    with_number,
)
from jaxtissue.sections.rims import joined
from jaxtissue.sections.rings import Insertion, Ring, inserted, numbered, ordered, pairs_at_most, without
from jaxtissue.sections.views import LEAST_SLOPE, Backbones, View, as_half_planes, first_places, gap, limit_planes

SHARP = 0.003  # the sine of the angle of two walls below which their corner stays that of the lines
STRIDE = 0.3  # of the way from the backbone to a corner, or of a chord: points move no farther
INSERTED = 2  # edges in one pass, at most


class Rule(NamedTuple):
    """How a section is measured.

    Attributes:
        slots: The largest number of edges of a section.
        passes: How often the edges are looked for.
        steps: How many steps of Newton's method corners and middles take to the walls.
        rays: How many points between the backbone and the rim are looked at, 1 or 2.
    """

    slots: int = 14
    passes: int = 3
    steps: int = 1
    rays: int = 2


class Edges(NamedTuple):
    """The edges in slots: lines along them, and the walls that they are of."""

    plane: HalfPlanes
    rivals: Backbones
    is_wall: Bool[Array, "slots *T"]

    def take(self, number: Int[Array, "slots *T"]) -> "Edges":
        """Those in other slots."""
        return Edges(take(self.plane, number), self.rivals.take(number), take(self.is_wall, number))


class Polygon(NamedTuple):
    """The polygon of each cell as one pass gives it: its edges in slots, from corner to corner.

    Attributes:
        ring: The edges in their order.
        edge: Their chords, and their walls.
        start: Where they start.
        end: Where they end.
        is_turned: Whether an edge ends before it starts: then it is none.
        spare: How many edges found no slot; 0 or less where all did.
        point: `end` in space.
        away: The square of its distance to the own backbone.
    """

    ring: Ring
    edge: Edges
    start: Vector
    end: Vector
    is_turned: Bool[Array, "slots *T"]
    spare: Int[Array, "*T"]
    point: Vector
    away: Array


class Polygons(NamedTuple):
    """The polygons of all passes, [passes, ...], and the first lines and where these cut each other."""

    passes: Polygon
    planes: HalfPlanes  # [lines, *T]
    rough: Vector  # [slots, *T]


def final_polygon(domain: Domain, view: View, rule: Rule) -> Polygon:
    """The polygon of each section that is measured."""
    return jax.tree.map(lambda table: table[-1], find_polygons(domain, view, rule).passes)


def find_polygons(domain: Domain, view: View, rule: Rule) -> Polygons:
    """The polygon of each section, by a fixed number of passes.

    In the first one each rival's wall is a line, and lines cut each other. In the others the order of edges stays:
    those that have turned round go, and rivals that are nearer to a corner come in there. So it does not matter that
    chords of bent walls may turn the wrong way, where lines would cut each other off.
    """
    anchor, limits = view.anchor, limit_planes(domain, view)
    flat = view.frame(domain, (jnp.zeros((1, *view.height.shape), view.height.dtype),) * 2)
    places = fusion_barrier(lambda: first_places(view, flat), anchor)
    planes = joined(fusion_barrier(lambda: lines_at(domain, view, places), anchor), *limits)
    exists = cut(planes, anchor)
    packed = fusion_barrier(lambda: pack(exists, rule.slots), anchor)
    plane = take(planes, packed.line)
    ring = fusion_barrier(lambda: ordered(packed, plane.normal), anchor)
    rough = fusion_barrier(lambda: crossing(plane, take(plane, ring.after), 1e-5), anchor)
    first = _placed(domain, view, rule, planes, (ring, rough, exists.sum(axis=0) - rule.slots))

    def more(polygon: Polygon, _: None) -> tuple[Polygon, Polygon]:
        polygon = _placed(domain, view, rule, planes, mended(view, polygon))
        return polygon, polygon

    _, others = jax.lax.scan(more, first, None, length=rule.passes - 1)
    passes = jax.tree.map(lambda table, rest: jnp.concatenate([table[None], rest]), first, others)
    return Polygons(passes, planes, rough)


Draft = tuple[Ring, Vector, Array]  # the edges, about where they end, and how many more there are than slots


def _placed(domain: Domain, view: View, rule: Rule, planes: HalfPlanes, draft: Draft) -> Polygon:
    """The polygon with its corners moved onto the walls."""
    anchor, (ring, end, spare) = view.anchor, draft
    edge = edges_of(planes, view, ring.line, anchor)
    other = fusion_barrier(lambda: edge.take(ring.after), anchor)
    normal = edge.plane.normal
    for _ in range(rule.steps):
        step, normal = fusion_barrier(lambda z=end: _to_corner(domain, view, z, edge, other), anchor)
        end = add(end, step)

    def chords() -> tuple[Vector, HalfPlanes, Array]:
        start = take(end, ring.before)
        chord = subtract(end, start)
        size, ahead = jnp.sqrt(dot(chord, chord)), dot(chord, turned(normal))
        fits = (ahead > 0.5 * size) & (size > 0)
        size = jnp.where(fits, size, 1)
        across = each(lambda a, b: jnp.where(fits, a, b), (chord[1] / size, -chord[0] / size), normal)
        return start, HalfPlanes(across, dot(across, end)), ring.is_edge & (ahead <= 0)

    start, chord, is_turned = fusion_barrier(chords, anchor)
    plane = jax.tree.map(lambda line, limit: jnp.where(edge.is_wall, line, limit), chord, edge.plane)
    point = fusion_barrier(lambda: view.frame(domain, end).point, anchor)
    mine = view.own.offset(point)
    return Polygon(ring, edge._replace(plane=plane), start, end, is_turned, spare, point, dot(mine, mine))


def mended(view: View, polygon: Polygon) -> Draft:
    """The edges without those that have turned round, and with those of rivals that are nearer to a corner.

    Of these the deepest comes in, and then another one, which is nearer to other corners; more in the next pass.
    """
    old = polygon.ring
    ring = kept = without(old, pairs_at_most(polygon.is_turned, old))
    ends = zip(polygon.end, take(polygon.start, ring.after), strict=True)
    end = middle = tuple(jnp.where(ring.after == old.after, a, (a + b) / 2) for a, b in ends)
    depth, outside = _nearer(view, polygon)
    spare, used = polygon.spare, jnp.zeros_like(outside[:1])
    for _ in range(INSERTED):
        left = with_number(jnp.where((outside & used) == 0, depth, FAR), numbered(depth), len(depth))
        deepest = left.min(axis=0, keepdims=True)
        line, is_nearer = number_in(deepest, len(depth)), deepest < 0
        corners, corner = take(outside, line), number_in(take(depth, line), len(old.line))
        ring, found = inserted(ring, line, corners, corner, is_nearer)
        spare = jnp.maximum(spare, jnp.where(is_nearer & ~found.is_new, 1, spare)[0])
        end = _with_crossings(view, polygon, (kept, middle), found, end)
        used |= jnp.where(is_nearer, corners, 0)
    return ring, end, spare


def _nearer(view: View, polygon: Polygon) -> tuple[Array, Int[Array, "q *T"]]:
    """How much nearer the own backbone is than each rival that is no edge, and in bits the corners where it is not."""
    ring, turned_round = polygon.ring, polygon.is_turned
    is_corner = ring.is_edge & ~turned_round & ~take(turned_round, ring.after)
    depth, outside = nearer_corners(is_corner, polygon.point, polygon.away, view.rivals.offset, view.anchor)
    may_come = view.is_there
    for k in range(len(ring.line)):
        may_come &= ~(ring.is_edge[k] & (ring.line[k] == numbered(depth)))
    return jnp.where(may_come, depth, FAR), outside


def _with_crossings(view: View, polygon: Polygon, kept: tuple[Ring, Vector], found: Insertion, end: Vector) -> Vector:
    """The ends of edges, with those where a wall that is put in crosses two others, by its depths at their ends."""
    ring, before = kept
    corners = jnp.concatenate([take(ring.before, found.first), found.first, found.last, take(ring.before, found.last)])
    theirs = view.rivals.take(found.line).offset(take(polygon.point, corners))
    depth, z = dot(theirs, theirs) - take(polygon.away, corners), take(before, corners)
    places = []
    for k in (0, 2):
        inside, beyond = jnp.maximum(depth[k], 0), jnp.minimum(depth[k + 1], -1e-30)
        share = inside / (inside - beyond)
        places.append(tuple(part[k] + share * (part[k + 1] - part[k]) for part in z))
    slot = numbered(ring.line)
    for number, place in zip((found.first, found.slot), places, strict=True):
        here = found.is_new & (slot == number)
        end = each(lambda a, b, here=here: jnp.where(here, b, a), end, place)
    return end


def lines_at(domain: Domain, view: View, z: Vector) -> HalfPlanes:
    """The walls of the rivals as lines, each to first order round its place."""
    return as_half_planes(gap(view.frame(domain, z), view.own, view.rivals), z, view.is_there)


def edges_of(planes: HalfPlanes, view: View, number: Int[Array, "slots *T"], anchor: Array) -> Edges:
    """The edges that lie on lines of the given numbers."""
    candidates = view.is_there.shape[0]

    def gather() -> tuple[HalfPlanes, Backbones]:
        return take(planes, number), view.rivals.take(jnp.minimum(number, candidates - 1))

    return Edges(*fusion_barrier(gather, anchor), number < candidates)


def distance_to_wall(flat: Frame, view: View, z: Vector, edge: Edges) -> tuple[Vector, Array]:
    """The unit normal of the wall, and how far the point is inside of it, to first order."""
    found = gap(flat, view.own, edge.rivals)
    square = dot(found.slope, found.slope)
    fit = edge.is_wall & (square > LEAST_SLOPE**2 * dot(found.pull, found.pull))
    steep = jnp.sqrt(jnp.where(fit, square, 1))
    x, y = (jnp.where(fit, -slope / steep, flat) for slope, flat in zip(found.slope, edge.plane.normal, strict=True))
    return (x, y), jnp.where(fit, found.value / steep, edge.plane.offset - dot(edge.plane.normal, z))


def _to_corner(domain: Domain, view: View, z: Vector, edge: Edges, other: Edges) -> tuple[Vector, Vector]:
    """One step of Newton's method to the corner of two walls, and the normal of the first.

    None where they are nearly parallel, and none too far.
    """
    flat = view.frame(domain, z)
    (a, b), inside = distance_to_wall(flat, view, z, edge)
    (c, d), other_inside = distance_to_wall(flat, view, z, other)
    sine = a * d - b * c
    sharp = jnp.abs(sine) > SHARP
    share = jnp.where(sharp, 1 / jnp.where(sharp, sine, 1), 0)
    step = (share * (inside * d - other_inside * b), share * (other_inside * a - inside * c))
    return within(step, scale(STRIDE, z)), (a, b)


def within(step: Vector, bound: Vector) -> Vector:
    """The step, or the part of it that is no longer than the bound."""
    length2, most2 = dot(step, step), dot(bound, bound)
    long = length2 > most2
    share = jnp.sqrt(jnp.where(long, jnp.maximum(most2, 1e-30), 1) / jnp.where(long, length2, 1))
    return scale(jnp.where(long, share, 1), step)
