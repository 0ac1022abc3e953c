"""Sections as differentiable functions of positions and of the domain, and their centroids."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero, zero_from_primal
from jaxtyping import Array, Float, Int

from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, add, area, components, dot, scale, subtract, turned
from jaxtissue.sections.cells import Layers, cell_view
from jaxtissue.sections.polygons import Rule, final_polygon
from jaxtissue.sections.rims import joined
from jaxtissue.sections.sizes import Sections, measure_polygons, measure_sections
from jaxtissue.sections.views import View
from jaxtissue.sections.wall_speeds import Slopes, wall_speeds


class Moments(NamedTuple):
    """The volume per height of sections, and the integrals of the local coordinates over it, all [*T]."""

    volume: Array
    first: Array
    second: Array


@partial(jax.custom_jvp, nondiff_argnums=(4,))
def smooth_sections(
    positions: Float[Array, "n *k d"],
    domain: Domain,
    lists: Int[Array, "q n"],
    layers: Layers,
    rule: Rule,
) -> Sections:
    """The sections of all cells, as `cell_sections` has them; derivatives are those of their true walls.

    Sizes and volumes have derivatives, corners and middles have none. Heights of nodes and lengths of unit vectors
    count for nothing. Derivatives of wall areas hold for the sum over the layers by the first row of weights: in them
    corners count for as long as their edges exist.
    """
    return measure_sections(domain, cell_view(domain, positions, lists, layers.heights), rule)


@partial(smooth_sections.defjvp, symbolic_zeros=True)
def _with_speeds(rule: Rule, primals: tuple, tangents: tuple) -> tuple[Sections, Sections]:
    positions, domain, lists, layers = primals
    view = cell_view(domain, positions, lists, layers.heights)
    polygon = final_polygon(domain, view, rule)
    sections = measure_polygons(domain, view, rule, polygon)
    sizes = (sections.wall, sections.length, sections.volume, sections.area)
    changes = [jnp.zeros_like(size) for size in sizes]
    if not isinstance(tangents[0], SymbolicZero):
        found = wall_speeds(domain, view, polygon, lists, positions, layers)
        place, way = (components(table[..., : len(domain.columns)]) for table in (positions, tangents[0]))
        way = jnp.stack([dot(step, way) for step in domain.base.steps(place)], axis=-1).reshape(len(positions), -1)
        ways = [way.T[:, None, None], *(jnp.moveaxis(way[number], -1, 0) for number in found[4:])]

        def change(speeds: tuple[Slopes, ...]) -> Array:
            pairs = [zip(by, parts, strict=True) for by, parts in zip(speeds, ways, strict=False)]
            return sum((slope * part for pair in pairs for slope, part in pair), start=jnp.zeros(()))

        changes = [change(found.wall), change(found.length), change(found.volume).sum(0), change(found.area).sum(0)]
    if not all(map(_is_zero, jax.tree.leaves(tangents[1], is_leaf=_is_zero))):
        by_domain = partial(_sizes, positions, lists, layers.heights, rule)
        more = jax.jvp(by_domain, (domain,), (_filled(domain, tangents[1]),))[1]
        changes = [one + other for one, other in zip(changes, more, strict=True)]
    still = jax.tree.map(lambda table: zero_from_primal(table, symbolic_zeros=True), sections)
    wall, length, volume, surface = changes
    return sections, still._replace(wall=wall, length=length, volume=volume, area=surface)


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _filled(tree: Any, tangents: Any) -> Any:
    """Tangents with numbers for what has none."""
    return jax.tree.map(
        lambda tangent, leaf: jnp.zeros_like(leaf) if _is_zero(tangent) else tangent, tangents, tree, is_leaf=_is_zero
    )


def _sizes(positions: Array, lists: Array, heights: Array, rule: Rule, domain: Domain) -> tuple[Array, ...]:
    """What has derivatives by sizes of the domain: plainly, through all passes."""
    found = measure_sections(domain, cell_view(domain, positions, lists, heights), rule)
    return found.wall, found.length, found.volume, found.area


def section_moments(domain: Domain, view: View, rule: Rule) -> Moments:
    """The moments of each section: those of the triangles from the backbone to its straight edges."""
    polygon = final_polygon(domain, view, rule)
    start, end = polygon.start, polygon.end
    span = dot(subtract(end, start), turned(polygon.edge.plane.normal))
    sweep = jnp.where(polygon.ring.is_edge & (span > 0), area(start, end), 0)
    # the middles of the three sides of a triangle: a rule of the second degree
    points: Vector = joined(scale(0.5, start), scale(0.5, end), scale(0.5, add(start, end)))
    volume = jnp.abs(view.frame(domain, points).elements()[0]) * jnp.concatenate([sweep] * 3) / 6
    local = (dot(view.basis[0], points), dot(view.basis[1], points))
    return Moments(volume.sum(axis=0), *((volume * part).sum(axis=0) for part in local))
