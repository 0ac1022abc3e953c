"""Sections of cells: sizes of their polygons, whose edges are walls that are bent a little."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxtissue.compilation.fusion import fusion_barrier
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, add, area, dot, scale, subtract, turned
from jaxtissue.sections.half_planes import take
from jaxtissue.sections.polygons import STRIDE, Edges, Polygon, Rule, distance_to_wall, final_polygon, within
from jaxtissue.sections.rims import beyond, fill, joined, mean, parts
from jaxtissue.sections.views import LEAST_SLOPE, View, gap

STEEP = 0.3  # the least cosine between an edge and its chord


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


def measure_sections(domain: Domain, view: View, rule: Rule) -> Sections:
    """Measure the section of each cell on each layer."""
    return measure_polygons(domain, view, rule, final_polygon(domain, view, rule))


def measure_polygons(domain: Domain, view: View, rule: Rule, polygon: Polygon) -> Sections:
    """Measure the sections that the last pass has found."""
    anchor = view.anchor
    ring, edge, start, end, _, spare, *_ = polygon
    chord, middle = subtract(end, start), scale(0.5, add(start, end))
    for _ in range(rule.steps):
        middle = fusion_barrier(lambda z=middle: add(z, to_wall(domain, view, z, edge, chord)), anchor)
    span = dot(chord, turned(edge.plane.normal))
    is_edge = ring.is_edge & (span > 0)
    curve = joined(start, middle, end)
    found = fusion_barrier(lambda: integrands(domain, view, curve, joined(edge, edge, edge)), anchor)
    wall, length = (jnp.where(is_edge & edge.is_wall, span * mean(size), 0) for size in found[:2])
    filled = fusion_barrier(lambda: fill(domain, view, curve, is_edge, found[2], rule.rays), anchor)
    _, at_middle, at_end = parts(found[3], 3)
    wide = jnp.where(is_edge, jnp.abs(area(start, end)) / 2, 0)
    long = jnp.where(is_edge & edge.is_wall, span, 0)
    doubt = ((wide * beyond(found[2][0])).sum(axis=0), (long * beyond(found[0])).sum(axis=0))
    after = take(ring.line, ring.after)
    return Sections(ring.line, after, is_edge, wall, length, *filled, at_end, at_middle, spare, doubt)


def to_wall(domain: Domain, view: View, z: Vector, edge: Edges, chord: Vector) -> Vector:
    """One step along the edge's normal to its wall."""
    normal, inside = distance_to_wall(view.frame(domain, z), view, z, edge)
    cosine = dot(normal, edge.plane.normal)
    step = scale(jnp.where(edge.is_wall, inside / jnp.maximum(cosine, STEEP), 0), edge.plane.normal)
    return within(step, scale(STRIDE, chord))


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
