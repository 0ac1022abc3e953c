"""How the sections of cells change as backbones move, from the speeds of their walls.

A section lies still in its chart, and its walls move: where g = d_j^2 - d_i^2 changes by g' at a point, the wall there
moves by g' / |grad g|. A cell gains the volume that its walls sweep. The area of a wall gains what its integrand gains
at points that move with the wall, and what corners that slide along it add at its ends.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import fusion_barrier, take_rows
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import Nodes, as_nodes, node_points
from jaxtissue.geometry.vectors import Vector, add, components, dot, scale, subtract, turned
from jaxtissue.sections.cells import Layers
from jaxtissue.sections.half_planes import take
from jaxtissue.sections.lifespans import corner_weights
from jaxtissue.sections.polygons import Edges, Polygon
from jaxtissue.sections.rims import joined, mean, parts
from jaxtissue.sections.sizes import STEEP, integrands, to_wall
from jaxtissue.sections.views import LEAST_SLOPE, Backbones, Polylines, Segments, View, between_surfaces, gap

BLUNT = 0.03  # the sine of the angle of two walls below which their corner slides less than it should

Slopes = tuple[Array, ...]  # by each coordinate of a backbone, [slots, *T]


class Speeds(NamedTuple):
    """How sections change with local coordinates of backbones that bound them: own, across, before and after an edge.

    Attributes:
        wall: Of the area of each wall per height; by all four.
        length: Of the length of each edge; by all four.
        volume: Of the volume per height, at each edge; by the first two.
        area: Of the area of the section, at each edge; by the first two.
        across: The numbers of the backbones across each edge, [slots, *T].
        before: Those across the edge before it.
        after: Those across the edge after it.
    """

    wall: tuple[Slopes, ...]
    length: tuple[Slopes, ...]
    volume: tuple[Slopes, ...]
    area: tuple[Slopes, ...]
    across: Int[Array, "slots *T"]
    before: Int[Array, "slots *T"]
    after: Int[Array, "slots *T"]


class Motion(NamedTuple):
    """How ends of backbones, or of the segments of bent ones, move with one local coordinate, [n] or [segments, n]."""

    start: Vector
    end: Vector

    def on_layers(self) -> "Motion":
        """The tables as those of backbones in a view."""
        return jax.tree.map(lambda part: part[None, ..., None, :], self)

    def of(self, number: Int[Array, "slots *T"]) -> "Motion":
        """Those of some backbones, [slots, *T] or [slots, segments, *T]."""

        def some(part: Array) -> Array:
            return (
                take_rows(part, number) if part.ndim == 1 else jax.vmap(lambda row: take_rows(row, number), 0, 1)(part)
            )

        return jax.tree.map(some, self)

    def as_change(self) -> Backbones:
        """The changes of backbones."""
        kind = Segments if self.start[0].ndim == 3 else Polylines
        return kind(self.start, subtract(self.end, self.start))


def wall_speeds(
    domain: Domain,
    view: View,
    polygon: Polygon,
    lists: Int[Array, "q n"],
    positions: Float[Array, "n *k d"],
    layers: Layers,
) -> Speeds:
    """The speeds of sections whose polygons are known, on the lists of the cells, with all backbones at `positions`.

    What the corners add to the area of a wall counts for the part of the height in which their edges exist.
    """
    anchor, edge, candidates = view.anchor, polygon.edge, view.is_there.shape[0]
    owners = (jnp.maximum(lists, 0) % len(positions))[:, None]
    ring = polygon.ring
    lines = (ring.line, take(ring.line, ring.before), take(ring.line, ring.after))
    across, before, after = (take(owners, jnp.minimum(line, candidates - 1)) for line in lines)
    motions = _motions(domain, positions)
    own = [motion.on_layers() for motion in motions]
    theirs, others = (
        [fusion_barrier(lambda motion=motion, number=number: motion.of(number), anchor) for motion in motions]
        for number in (across, jnp.concatenate([before, after]))
    )
    start, end = polygon.start, polygon.end
    chord, middle = subtract(end, start), scale(0.5, add(start, end))
    middle = fusion_barrier(lambda: add(middle, to_wall(domain, view, middle, edge, chord)), anchor)
    span = dot(chord, turned(edge.plane.normal))
    span = jnp.where(ring.is_edge & edge.is_wall & (span > 0), span, 0)
    curve, thrice = joined(start, middle, end), joined(edge, edge, edge)
    sides = fusion_barrier(
        lambda: _advances(domain, view, curve, thrice, own, [joined(*[m] * 3) for m in theirs]), anchor
    )
    sizes = fusion_barrier(lambda: integrands(domain, view, curve, thrice)[:3], anchor)
    grown = _growths(domain, view, curve, thrice, (own, theirs), sides)
    beside = fusion_barrier(lambda: edge.take(jnp.concatenate([ring.before, ring.after])), anchor)
    twice, twice_theirs = joined(edge, edge), [joined(m, m) for m in theirs]
    slides = fusion_barrier(
        lambda: _slides(domain, view, joined(start, end), (twice, beside), (own, twice_theirs, others)), anchor
    )

    weight = fusion_barrier(lambda: _both_ends(domain, view, polygon, parts(beside, 2)[1], layers), anchor)

    def swept(element: Array) -> tuple[Slopes, ...]:
        return tuple(tuple(span * mean(jnp.abs(element) * side) for side in by) for by in sides)

    wall, length = (
        _with_slides(span, size, grown[k], slides, (weight, (1.0, 1.0))[k]) for k, size in enumerate(sizes[:2])
    )
    return Speeds(wall, length, swept(sizes[2][0]), swept(sizes[2][1]), across, before, after)


def _with_slides(
    span: Array,
    size: Array,
    growth: list[list[Array]],
    slides: list[list[Array]],
    weight: tuple[Array | float, Array | float],
) -> tuple[Slopes, ...]:
    """What edges gain along them, and what the corners that slide along them add, which have weights."""
    first, _, last = parts(size, 3)
    first, last = first * weight[0], last * weight[1]
    ends = [[parts(slide, 2) for slide in by] for by in slides]
    full = [
        tuple(span * rate + jnp.where(span > 0, last * b - first * a, 0) for rate, (a, b) in zip(*by, strict=True))
        for by in zip(growth, ends[:2], strict=True)
    ]
    before = tuple(jnp.where(span > 0, -first * a, 0) for a, _ in ends[2])
    after = tuple(jnp.where(span > 0, last * b, 0) for _, b in ends[2])
    return (*full, before, after)


def _both_ends(domain: Domain, view: View, polygon: Polygon, after: Edges, layers: Layers) -> tuple[Array, Array]:
    """The weights of the corners where edges start and end."""
    end = corner_weights(domain, view, polygon, after, layers)
    return take(end, polygon.ring.before), end


def _motions(domain: Domain, positions: Float[Array, "n *k d"]) -> list[Motion]:
    """How backbones move with each local coordinate, of bent ones node by node."""
    if positions.ndim == 2:
        place, found = components(positions), []
        for way in domain.base.steps(place):
            found.append(Motion(*jax.jvp(domain.surfaces, (place,), (way,))[1]))
        return found
    nodes, found = as_nodes(positions, domain), []
    for node in range(positions.shape[1]):
        for step in domain.base.steps(nodes.place):
            way = tuple(jnp.zeros_like(part).at[:, node].set(part[:, node]) for part in step)
            moved = jax.jvp(lambda place: node_points(Nodes(place, nodes.height), domain), (nodes.place,), (way,))[1]
            found.append(Motion(*(tuple(part[:, some].T for part in moved) for some in (slice(-1), slice(1, None)))))
    is_segment = positions.shape[1] == 2  # tilted backbones are segments, as straight ones are
    return jax.tree.map(lambda part: part[0], found) if is_segment else found


def _closer(backbones: Backbones, motion: Motion, point: Vector) -> Array:
    """By how much the square of the distance to moving backbones falls."""
    bent = isinstance(backbones, Polylines)
    if bent:
        point = tuple(part[..., None, :, :] for part in point)
    way = subtract(point, backbones.start)
    share = jnp.clip(dot(way, backbones.along) / dot(backbones.along, backbones.along), 0, 1)
    offset = subtract(way, scale(share, backbones.along))
    closer = 2 * dot(offset, add(scale(1 - share, motion.start), scale(share, motion.end)))
    if not bent:
        return closer
    square = dot(offset, offset)
    is_nearest = square == square.min(axis=-3, keepdims=True)
    return jnp.where(is_nearest, closer, 0).sum(axis=-3) / is_nearest.sum(axis=-3)


class _Wall(NamedTuple):
    """A wall at a point: its outward normal, 1 / |grad g|, 0 where it is none, and the point."""

    normal: Vector
    share: Array
    point: Vector


def _wall_at(domain: Domain, view: View, z: Vector, edge: Edges) -> _Wall:
    flat = view.frame(domain, z)
    found = gap(flat, view.own, edge.rivals)
    square = dot(found.slope, found.slope)
    fit = edge.is_wall & (square > LEAST_SLOPE**2 * dot(found.pull, found.pull))
    steep = jnp.sqrt(jnp.where(fit, square, 1))
    x, y = (jnp.where(fit, -slope / steep, flat) for slope, flat in zip(found.slope, edge.plane.normal, strict=True))
    return _Wall((x, y), jnp.where(fit, 1 / steep, 0), flat.point)


def _advances(
    domain: Domain, view: View, z: Vector, edge: Edges, own: list[Motion], theirs: list[Motion]
) -> list[list[Array]]:
    """How far walls move along the normals of their lines, by own coordinates and by those across."""
    wall = _wall_at(domain, view, z, edge)
    share = wall.share / jnp.maximum(dot(wall.normal, edge.plane.normal), STEEP)
    return [
        [sign * share * _closer(backbones, motion, wall.point) for motion in by]
        for sign, backbones, by in ((1, view.own, own), (-1, edge.rivals, theirs))
    ]


def _growths(
    domain: Domain,
    view: View,
    z: Vector,
    edge: Edges,
    motions: tuple[list[Motion], list[Motion]],
    sides: list[list[Array]],
) -> list[list[list[Array]]]:
    """How the wall's area and the edge's length grow, in the mean over the edge, at points that move with the wall.

    One direction after the other, in a loop: so it is compiled once. The loop for lengths falls away if none are asked.
    On the two surfaces, which have no weight, areas of walls do not grow.
    """
    own, theirs = ([motion.as_change() for motion in by] for by in motions)
    none = tuple(jax.tree.map(jnp.zeros_like, by[0]) for by in (own, theirs))
    ways = [(change, none[1]) for change in own] + [(none[0], change) for change in theirs]
    stacked = jax.tree.map(lambda *tables: jnp.stack(tables), *ways), jnp.stack([*sides[0], *sides[1]])

    def loop(number: int, given: tuple[View, Edges, Vector, Any]) -> Array:
        view, edge, z, stacked = given

        def size(backbones: Backbones, rivals: Backbones, z: Vector) -> Array:
            sizes = integrands(domain, view._replace(own=backbones), z, edge._replace(rivals=rivals))
            return sizes[1] if number else sizes[0]

        def turn(way: tuple[tuple[Backbones, Backbones], Array]) -> Array:
            (mine, across), side = way
            tangents = (mine, joined(across, across, across), scale(side, edge.plane.normal))
            return mean(fusion_barrier(lambda: jax.jvp(size, (view.own, edge.rivals, z), tangents)[1], view.anchor))

        return jax.lax.map(turn, stacked)

    given = view, edge, z, stacked
    walls = jnp.pad(loop(0, between_surfaces(given, len(view.height))), ((0, 0), (0, 0), (0, 2), (0, 0)))
    return [[list(rates[: len(own)]), list(rates[len(own) :])] for rates in (walls, loop(1, given))]


def _slides(
    domain: Domain, view: View, z: Vector, edges: tuple[Edges, Edges], motions: tuple[list[Motion], ...]
) -> list[list[Array]]:
    """How far corners of two walls slide along the first, by own coordinates, those across, and those of the other."""
    wall, other = (_wall_at(domain, view, z, edge) for edge in edges)
    normal = edges[0].plane.normal
    sine, cosine = dot(other.normal, turned(wall.normal)), dot(other.normal, wall.normal)
    sharp = sine / jnp.maximum(sine**2, BLUNT**2)
    along, lean = dot(turned(wall.normal), turned(normal)), dot(wall.normal, turned(normal))

    def slide(advance: Array, others: Array) -> Array:
        """Of a corner whose walls move along their normals."""
        return sharp * along * (others - cosine * advance) + lean * advance

    own, theirs, others = motions
    mine = [_closer(view.own, motion, wall.point) for motion in own]
    across = [-_closer(edges[0].rivals, motion, wall.point) for motion in theirs]
    beside = [-_closer(edges[1].rivals, motion, wall.point) for motion in others]
    return [
        [slide(wall.share * rate, other.share * rate) for rate in mine],
        [slide(wall.share * rate, jnp.zeros_like(rate)) for rate in across],
        [slide(jnp.zeros_like(rate), other.share * rate) for rate in beside],
    ]
