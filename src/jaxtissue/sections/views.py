"""Coordinates of a cell in its tangent plane on a layer, and the bisectors to its candidates there."""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxtissue.geometry.domains import Domain, Frame
from jaxtissue.geometry.vectors import Vector, add, dot, scale, subtract
from jaxtissue.sections.half_planes import FAR, HalfPlanes, take

Tables = TypeVar("Tables")
LEAST_SLOPE = 1e-6  # of a bisector along the layer, as a part of its slope, below which it is no line


class Segments(NamedTuple):
    """Backbones: where they start, and where they go to from there."""

    start: Vector
    along: Vector

    @property
    def apical(self) -> Vector:
        """The apical ends."""
        return self.start

    def offset(self, point: Vector) -> Vector:
        """From the nearest point of each backbone to a point."""
        way = subtract(point, self.start)
        share = jnp.clip(dot(way, self.along) / dot(self.along, self.along), 0, 1)
        return subtract(way, scale(share, self.along))

    def on_layers(self) -> "Segments":
        """Tables [..., n] with an axis for the layers before the last one."""
        return jax.tree.map(lambda table: table[..., None, :], self)

    def take(self, number: Int[Array, "slots *T"]) -> "Segments":
        """The backbones of numbers, of tables [q, 1, n]."""
        return take(self, number)


class Polylines(NamedTuple):
    """Bent backbones: the segments from node to node, with an axis for these before that of the layers."""

    start: Vector
    along: Vector

    @property
    def apical(self) -> Vector:
        """The apical ends, of tables `on_layers`."""
        return tuple(part[..., 0, :, :] for part in self.start)

    def offset(self, point: Vector) -> Vector:
        """From the nearest point of each backbone to a point."""
        away = Segments(*self).offset(tuple(part[..., None, :, :] for part in point))
        square = dot(away, away)
        is_nearest = square == square.min(axis=-3, keepdims=True)
        count = is_nearest.sum(axis=-3).astype(square.dtype)  # two at a node, which both have as their nearest point
        return tuple(jnp.where(is_nearest, part, 0).sum(axis=-3) / count for part in away)

    def on_layers(self) -> "Polylines":
        """Tables [..., n, segments] as [..., segments, 1, n]."""
        return jax.tree.map(lambda table: jnp.moveaxis(table, -1, -2)[..., None, :], self)

    def take(self, number: Int[Array, "slots *T"]) -> "Polylines":
        """The backbones of numbers, of tables [q, segments, 1, n]."""
        return jax.tree.map(jax.vmap(lambda table: take(table, number), 1, 1), self)


Backbones = Segments | Polylines


def through(nodes: Vector) -> Backbones:
    """The backbones through nodes in space, [..., k]."""
    start, along = tuple(part[..., :-1] for part in nodes), tuple(jnp.diff(part) for part in nodes)
    if start[0].shape[-1] > 1:
        return Polylines(start, along)
    return jax.tree.map(lambda part: part[..., 0], Segments(start, along))


class View(NamedTuple):
    """The cells of a tissue as seen on layers; tables end with the axes of layers and cells, *T = (K, n).

    Attributes:
        place: The point of the base surface below each backbone, [*T].
        height: The height of each layer, [*T].
        basis: The rows of the derivative of the local coordinates y by coordinates z in which the layer's metric is
            the unit matrix at the backbone.
        own: The backbones, [1, 1, n]; bent ones have an axis for their segments after the first.
        rivals: The candidates, [q, 1, n], likewise.
        is_there: Which candidates there are, [q, 1, n].
    """

    place: Vector
    height: Array
    basis: tuple[Vector, Vector]
    own: Backbones
    rivals: Backbones
    is_there: Bool[Array, "q 1 n"]

    @property
    def anchor(self) -> Array:
        """An input, which fusion barriers ask for."""
        return self.height

    def frame(self, domain: Domain, z: Vector) -> Frame:
        """Points and derivatives by z at places [..., *T]."""
        shape = z[0].shape
        place = tuple(jnp.broadcast_to(part, shape) for part in self.place)
        point, first, second, upward = domain.frame(place, (dot(self.basis[0], z), dot(self.basis[1], z)), self.height)
        columns = [add(scale(self.basis[0][k], first), scale(self.basis[1][k], second)) for k in range(2)]
        return Frame(point, columns[0], columns[1], upward)


class Gap(NamedTuple):
    """How much nearer points are to the own backbone than to a rival, g = d_j^2 - d_i^2, and its derivatives."""

    value: Array
    slope: Vector  # by z
    pull: Vector  # by the point, 2 (q_i - q_j)


def look(domain: Domain, place: Vector, heights: Array, own: Backbones, rivals: Backbones, is_there: Array) -> View:
    """The view of cells at places [n] or [K, n] on layers [K], with own backbones [n] and candidates [q, n]."""
    shape = (heights.shape[0], place[0].shape[-1])
    height = jnp.broadcast_to(heights[:, None], shape)
    centers = tuple(jnp.broadcast_to(part, shape) for part in place)
    flat = domain.frame(centers, (jnp.zeros_like(height),) * 2, height)
    own = jax.tree.map(lambda table: table[None], own).on_layers()
    return View(centers, height, metric_basis(flat), own, rivals.on_layers(), is_there[:, None])


def metric_basis(flat: Frame) -> tuple[Vector, Vector]:
    """Local coordinates y of unit steps z, y = B z: B = L^-T for the metric L L^T, so that z has the unit matrix."""
    across = jnp.sqrt(dot(flat.first, flat.first))
    mixed = dot(flat.first, flat.second) / across
    rest = jnp.sqrt(dot(flat.second, flat.second) - mixed**2)
    return (1 / across, -mixed / (across * rest)), (jnp.zeros_like(rest), 1 / rest)


def gap(flat: Frame, own: Backbones, rivals: Backbones) -> Gap:
    """The gap between the own backbone and rivals at given points."""
    mine, theirs = own.offset(flat.point), rivals.offset(flat.point)
    apart = subtract(theirs, mine)
    pull = scale(2, apart)
    return Gap(dot(apart, add(theirs, mine)), (dot(pull, flat.first), dot(pull, flat.second)), pull)


def as_half_planes(found: Gap, z: Vector, is_there: Array) -> HalfPlanes:
    """The gaps' zeros as lines, to first order round z; what is not there, or has no slope, bounds nothing."""
    square, whole = dot(found.slope, found.slope), dot(found.pull, found.pull)
    fit = is_there & (square > LEAST_SLOPE**2 * whole) & (whole > 0)
    steep = jnp.sqrt(jnp.where(fit, square, 1))
    normal = (jnp.where(fit, -found.slope[0] / steep, 1), jnp.where(fit, -found.slope[1] / steep, 0))
    return HalfPlanes(normal, jnp.where(fit, found.value / steep + dot(normal, z), FAR))


def limit_planes(domain: Domain, view: View) -> list[HalfPlanes]:
    """The limits of sections, low and then high in both local coordinates, as lines, [1, *T]: they are straight."""
    limits, planes = domain.base.limits(view.place), []
    for sign, side in ((-1, limits.low), (1, limits.high)):
        for row, offset in zip(view.basis, side, strict=True):
            size = sign / jnp.sqrt(dot(row, row))
            planes.append(HalfPlanes((row[0] * size, row[1] * size), offset * size))
    return jax.tree.map(lambda table: table[None], planes)


def first_places(view: View, flat: Frame) -> Vector:
    """Half of the tangent part of the way from the backbone to each rival, [q, *T]."""
    away = view.rivals.offset(flat.point)
    return (-dot(away, flat.first) / 2, -dot(away, flat.second) / 2)


def between_surfaces(tables: Tables, layers: int) -> Tables:
    """Tables of so many layers without the last two, which are the surfaces; other tables as they are."""
    return jax.tree.map(lambda part: part[..., :-2, :] if part.shape[-2:-1] == (layers,) else part, tables)
