"""Sections of cells: polygons on layers whose edges are the walls, refined by Newton's method and integrated.

On a layer a cell is nearly a polygon, since walls between neighbors are nearly flat. Each rival's wall is one line,
taken at half the way to it and again at the middle of its edge; lines cut each other, and the two corners and the
middle of each edge move onto the true walls.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxtissue.compilation.fusion import fusion_barrier
from jaxtissue.geometry.domains import Domain, Frame
from jaxtissue.geometry.vectors import Vector, add, area, dot, each, scale, subtract, turned
from jaxtissue.sections.half_planes import FAR, HalfPlanes, Packed, crossing, cut, deepest, pack, take
from jaxtissue.sections.rims import beyond, fill, joined, mean, parts
from jaxtissue.sections.views import Backbones, View, as_half_planes, first_places, gap, limit_planes

SHARP = 0.03  # the sine of the angle of two walls below which their corner stays that of the lines
STEEP = 0.3  # the least cosine between an edge and its chord
STRIDE = 0.3  # of the way from the backbone to a corner, or of a chord: points move no farther
LEAST_SLOPE = 1e-6
ASTRAY = 1e-3  # of squares of distances, by which corners may be off their walls


class Rule(NamedTuple):
    """How a section is measured.

    Attributes:
        slots: The largest number of edges of a section.
        passes: How often the walls are taken as lines, each time nearer to their edges.
        steps: How many steps of Newton's method corners and middles take to the walls.
        rays: How many points between the backbone and the rim are looked at, 1 or 2.
        best: Whether an earlier pass is taken where the last one has gone astray.
    """

    slots: int = 14
    passes: int = 2
    steps: int = 1
    rays: int = 2
    best: bool = False


class Sections(NamedTuple):
    """The sections of cells on layers; tables end with the axes of layers and cells, *T.

    Attributes:
        line: The line of each edge, [slots, *T]: a candidate's number, or, from q on, one of the four limits.
        after: The line that follows it counterclockwise.
        is_edge: Which slots hold an edge.
        wall: The area of each wall per height, 0 at limits.
        length: The length of each edge, 0 at limits.
        volume: The volume per height, [*T].
        area: The area of the section, [*T].
        corner: The point where each edge ends, components [slots, *T].
        middle: The middle of each edge.
        spare: How many edges found no slot, [*T]; 0 or less where all did.
        doubt: By how much the volume and the area of all walls may be off, per height, [*T] each.
    """

    line: Int[Array, "slots *T"]
    after: Int[Array, "slots *T"]
    is_edge: Bool[Array, "slots *T"]
    wall: Array
    length: Array
    volume: Array
    area: Array
    corner: Vector
    middle: Vector
    spare: Int[Array, "*T"]
    doubt: tuple[Array, Array]


class Edges(NamedTuple):
    """The edges in slots: their lines as taken last, and the walls that they are of."""

    plane: HalfPlanes
    rivals: Backbones
    is_wall: Bool[Array, "slots *T"]


class Polygon(NamedTuple):
    """The polygon of each cell as one pass gives it: its edges in slots, from corner to corner."""

    packed: Packed
    edge: Edges
    start: Vector
    end: Vector
    after: Int[Array, "slots *T"]
    spare: Int[Array, "*T"]
    rough: Vector  # `end`, before it was moved onto the walls
    planes: HalfPlanes  # all lines, [lines, *T]
    exists: Bool[Array, "lines *T"]
    before: Int[Array, "slots *T"]
    point: Vector  # `end` in space
    away: Array  # its distance to the own backbone, squared


def measure_sections(domain: Domain, view: View, rule: Rule) -> Sections:
    """Measure the section of each cell on each layer."""
    return measure_polygons(domain, view, rule, final_polygon(domain, view, rule))


def final_polygon(domain: Domain, view: View, rule: Rule) -> Polygon:
    """The polygon of each section that is measured."""
    polygons = find_polygons(domain, view, rule)
    return _best(view, polygons) if rule.best else jax.tree.map(lambda table: table[-1], polygons)


def _best(view: View, polygons: Polygon) -> Polygon:
    """The last polygon of each section, or an earlier one whose corners are much nearer to its walls.

    Chords of bent and nearly parallel walls may cut each other in the wrong order: then the next pass may be worse.
    """

    def off(corner: tuple[Array, Vector, Array]) -> Array:
        """How much nearer or farther than the own backbone the nearest rival is, as squares, in parts."""
        is_edge, point, away = corner
        theirs = view.rivals.offset(point)
        nearest = jnp.where(view.is_there, dot(theirs, theirs), FAR).min(axis=0)
        return jnp.where(is_edge, jnp.abs(nearest / jnp.where(is_edge, away, 1) - 1), 0)

    corners = polygons.packed.is_edge, polygons.point, polygons.away
    astray = jax.lax.map(lambda these: jax.lax.map(off, these).sum(axis=0), corners)
    last = astray.shape[0] - 1
    which = jnp.where(astray.min(axis=0) < astray[-1] - ASTRAY, astray.argmin(axis=0), last)
    return jax.tree.map(
        lambda table: jnp.select([which == k for k in range(last)], list(table[:last]), table[-1]), polygons
    )


def measure_polygons(domain: Domain, view: View, rule: Rule, polygon: Polygon) -> Sections:
    """Measure the sections that the last pass has found."""
    anchor = view.anchor
    packed, edge, start, end, after, spare, *_ = polygon
    chord, middle = subtract(end, start), scale(0.5, add(start, end))
    for _ in range(rule.steps):
        middle = fusion_barrier(lambda z=middle: add(z, to_wall(domain, view, z, edge, chord)), anchor)
    span = dot(chord, turned(edge.plane.normal))
    is_edge = packed.is_edge & (span > 0)
    curve = joined(start, middle, end)
    found = fusion_barrier(lambda: integrands(domain, view, curve, joined(edge, edge, edge)), anchor)
    wall, length = (jnp.where(is_edge & edge.is_wall, span * mean(size), 0) for size in found[:2])
    filled = fusion_barrier(lambda: fill(domain, view, curve, is_edge, found[2], rule.rays), anchor)
    _, at_middle, at_end = parts(found[3], 3)
    wide = jnp.where(is_edge, jnp.abs(area(start, end)) / 2, 0)
    long = jnp.where(is_edge & edge.is_wall, span, 0)
    doubt = ((wide * beyond(found[2][0])).sum(axis=0), (long * beyond(found[0])).sum(axis=0))
    return Sections(packed.line, after, is_edge, wall, length, *filled, at_end, at_middle, spare, doubt)


def find_polygons(domain: Domain, view: View, rule: Rule) -> Polygon:
    """The polygon of each section, by a fixed number of passes from lines to corners and back to lines, [passes, ...].

    Corners are brought onto the walls. Then a wall with an edge is the line through the edge's corners, and that of a
    rival that is nearer to a corner is a line there: so what cuts off a corner is found in the next pass. All others
    cut nothing: far from the place where they are taken, their lines may miss the walls by much.
    """
    anchor, limits = view.anchor, limit_planes(domain, view)
    flat = view.frame(domain, (jnp.zeros((1, *view.height.shape), view.height.dtype),) * 2)
    first = fusion_barrier(lambda: first_places(view, flat), anchor)
    planes = fusion_barrier(lambda: lines_at(domain, view, first), anchor)
    planes = joined(planes, *limits)

    def more(carry: tuple[HalfPlanes, Polygon], is_first: Array) -> tuple[tuple[HalfPlanes, Polygon], Polygon]:
        planes = jax.lax.cond(is_first, lambda: carry[0], lambda: _refined(domain, view, *carry))
        polygon = _cut_out(domain, view, planes, rule)
        return (planes, polygon), polygon

    none = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(lambda: _cut_out(domain, view, planes, rule))
    )
    return jax.lax.scan(more, (planes, none), jnp.arange(rule.passes) == 0)[1]


def _cut_out(domain: Domain, view: View, planes: HalfPlanes, rule: Rule) -> Polygon:
    """The polygon that the lines leave, with its corners moved onto the walls."""
    anchor = view.anchor
    cuts = cut(planes, anchor)
    packed = fusion_barrier(lambda: pack(cuts.exists, rule.slots), anchor)
    before, after = fusion_barrier(lambda: take((cuts.before, cuts.after), packed.line), anchor)
    edge, other = edges_of(planes, view, packed.line, anchor), edges_of(planes, view, after, anchor)
    rough = end = fusion_barrier(lambda: crossing(edge.plane, other.plane, 1e-5), anchor)
    for _ in range(rule.steps):
        end = fusion_barrier(lambda z=end: add(z, _to_corner(domain, view, z, edge, other)), anchor)

    def starts() -> Vector:
        slot, exists = take((packed.slot, cuts.exists), before)
        follows = exists & (take(after, slot) == packed.line)
        apart = crossing(edge.plane, take(planes, before), 1e-5)  # from an edge too short to be found
        return each(lambda a, b: jnp.where(follows, a, b), take(end, slot), apart)

    start = fusion_barrier(starts, anchor)
    point = fusion_barrier(lambda: view.frame(domain, end).point, anchor)
    mine = view.own.offset(point)
    last = rough, planes, cuts.exists, before, point, dot(mine, mine)
    return Polygon(packed, edge, start, end, after, cuts.exists.sum(axis=0) - rule.slots, *last)


def _refined(domain: Domain, view: View, planes: HalfPlanes, polygon: Polygon) -> HalfPlanes:
    """The lines, nearer to the walls where these bound the polygon or may do so."""
    anchor, candidates = view.anchor, view.is_there.shape[0]
    old, limits = (jax.tree.map(lambda table, some=some: table[some], planes)
                   for some in (slice(candidates), slice(candidates, None)))  # fmt: skip
    slot = polygon.packed.slot[:candidates]
    number = jnp.arange(candidates, dtype=slot.dtype).reshape(-1, 1, 1)
    line, is_edge, start, end = fusion_barrier(
        lambda: take((polygon.packed.line, polygon.packed.is_edge, polygon.start, polygon.end), slot), anchor
    )
    chord = subtract(end, start)
    is_edge = is_edge & (line == number)
    ahead = dot(chord, turned(old.normal))
    is_chord = is_edge & (ahead > 0.5 * jnp.sqrt(dot(chord, chord))) & (dot(chord, chord) > 0)
    depth, which = deepest(polygon.packed.is_edge, polygon.point, polygon.away, view.rivals.offset, anchor)
    z = each(lambda a, b, c: jnp.where(is_edge, (a + b) / 2, c), start, end, take(polygon.end, which))
    fresh = fusion_barrier(lambda: lines_at(domain, view, z), anchor)
    fresh = fresh._replace(offset=jnp.where(is_edge | (depth < 0), fresh.offset, FAR))

    def with_chords() -> HalfPlanes:
        size = jnp.sqrt(jnp.where(is_chord, dot(chord, chord), 1))
        normal = (chord[1] / size, -chord[0] / size)
        lines = HalfPlanes(normal, dot(normal, start))
        return jax.tree.map(lambda line, plain: jnp.where(is_chord, line, plain), lines, fresh)

    return joined(fusion_barrier(with_chords, anchor), limits)


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


def _to_corner(domain: Domain, view: View, z: Vector, edge: Edges, other: Edges) -> Vector:
    """One step of Newton's method to the corner of two walls; none where they are nearly parallel, and none too far."""
    flat = view.frame(domain, z)
    (a, b), inside = distance_to_wall(flat, view, z, edge)
    (c, d), other_inside = distance_to_wall(flat, view, z, other)
    sine = a * d - b * c
    sharp = jnp.abs(sine) > SHARP
    share = jnp.where(sharp, 1 / jnp.where(sharp, sine, 1), 0)
    step = (share * (inside * d - other_inside * b), share * (other_inside * a - inside * c))
    return _within(step, scale(STRIDE, z))


def to_wall(domain: Domain, view: View, z: Vector, edge: Edges, chord: Vector) -> Vector:
    """One step along the edge's normal to its wall."""
    normal, inside = distance_to_wall(view.frame(domain, z), view, z, edge)
    cosine = dot(normal, edge.plane.normal)
    step = scale(jnp.where(edge.is_wall, inside / jnp.maximum(cosine, STEEP), 0), edge.plane.normal)
    return _within(step, scale(STRIDE, chord))


def _within(step: Vector, bound: Vector) -> Vector:
    """The step, or the part of it that is no longer than the bound."""
    length2, most2 = dot(step, step), dot(bound, bound)
    long = length2 > most2
    share = jnp.sqrt(jnp.where(long, jnp.maximum(most2, 1e-30), 1) / jnp.where(long, length2, 1))
    return scale(jnp.where(long, share, 1), step)


def integrands(domain: Domain, view: View, z: Vector, edge: Edges) -> tuple[Array, Array, tuple[Array, Array], Vector]:
    """Per step along the edge's line, wall area per height and length; volume and area elements; the point.

    The wall is a level set of g: its area is |grad g| |det dF| / |dg/dz| per length in z and per height.
    """
    flat = view.frame(domain, z)
    volume, level = flat.elements()
    found = gap(flat, view.own, edge.rivals)
    square, whole = dot(found.slope, found.slope), dot(found.pull, found.pull)
    fit = edge.is_wall & (square > LEAST_SLOPE**2 * whole)
    steep = jnp.sqrt(jnp.where(fit, square, 1))
    cosine = jnp.maximum(-dot(found.slope, edge.plane.normal) / steep, STEEP)
    pull = jnp.sqrt(jnp.where(fit, whole, 1))
    along = scale(1 / steep, turned(found.slope))
    tangent = add(scale(along[0], flat.first), scale(along[1], flat.second))
    speed = jnp.sqrt(jnp.where(fit, dot(tangent, tangent), 1))
    volume = jnp.abs(volume)
    return pull * volume / (steep * cosine), speed / cosine, (volume, level), flat.point
