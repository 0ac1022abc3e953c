"""The shapes: slab, round, elliptic and bent tube, sphere, ellipsoid and fold."""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.geometry.base_surfaces import Rectangle, UnitSphere
from jaxtissue.geometry.domain_checks import check_domain, check_sizes
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, scale


def as_size(given: Any) -> Any:
    """Whole numbers as floats; arrays and traced values stay as they are."""
    return float(given) if isinstance(given, int | float | np.number) and not isinstance(given, bool) else given


def _axes(given: Any) -> Any:
    return given if isinstance(given, jax.Array) else jnp.stack([jnp.asarray(as_size(axis), float) for axis in given])


def _two(given: Sequence[bool]) -> tuple[bool, bool]:
    first, second = given
    return bool(first), bool(second)


def _direction(is_periodic: bool) -> str:
    return "periodic" if is_periodic else "free"


class Shape(Domain):
    """A domain that is checked when it is made."""

    def __check_init__(self) -> None:
        check_sizes(self)
        check_domain(self)


class Slab(Shape):
    """A flat sheet: apical surface z = 0, basal surface z = thickness, 0 <= x <= width, 0 <= y <= depth.

    Attributes:
        width: The extent along x; its unit is the unit of all lengths.
        depth: The extent along y.
        thickness: The distance of the two surfaces.
        periodic: Whether the sheet goes on as a copy of itself in x and in y.

    >>> Slab(width=4, depth=3, thickness=2, periodic=(True, True)).volume
    24.0
    """

    width: float | Array = eqx.field(converter=as_size)
    depth: float | Array = eqx.field(converter=as_size)
    thickness: float | Array = eqx.field(converter=as_size)
    periodic: tuple[bool, bool] = eqx.field(static=True, converter=_two, default=(False, False))

    @property
    def base(self) -> Rectangle:
        """The base surface."""
        return Rectangle((self.width, self.depth), tuple(map(_direction, self.periodic)))  # type: ignore[arg-type]

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the coordinates of a position, as in tables of backbones."""
        return ("x", "y")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        level = jnp.zeros_like(m[0])
        return (m[0], m[1], level), (m[0], m[1], level + self.thickness)


class RoundTube(Shape):
    """The tube of `Tube` as a domain like any other, which may be periodic along its axis.

    Attributes:
        length: The length of the tube.
        apical_radius: The radius of the apical surface.
        basal_radius: The radius of the basal surface.
        periodic: Whether the tube goes on as a copy of itself beyond its ends.

    >>> round(RoundTube(length=10, apical_radius=1, basal_radius=2, periodic=True).volume / math.pi, 6)
    30.0
    """

    length: float | Array = eqx.field(converter=as_size)
    apical_radius: float | Array = eqx.field(converter=as_size)
    basal_radius: float | Array = eqx.field(converter=as_size)
    periodic: bool = eqx.field(static=True, default=False)

    @property
    def base(self) -> Rectangle:
        """The base surface."""
        return Rectangle((self.length, 2 * math.pi), (_direction(self.periodic), "closed"))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the coordinates of a position, as in tables of backbones."""
        return ("axial", "angle")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        y, z = jnp.cos(m[1]), jnp.sin(m[1])
        inner, outer = self.apical_radius, self.basal_radius
        return (m[0], inner * y, inner * z), (m[0], outer * y, outer * z)


class EllipticTube(Shape):
    """A straight tube between two elliptic cylinders, y = a_1 cos(angle), z = a_2 sin(angle).

    The angle is the parameter of the ellipses; a backbone joins the two points of one parameter.

    Attributes:
        length: The length of the tube.
        apical_axes: The semi-axes of the apical surface along y and z, [2].
        basal_axes: The semi-axes of the basal surface, [2].

    >>> round(EllipticTube(length=10, apical_axes=[1, 2], basal_axes=[2, 3]).volume / math.pi, 6)
    40.0
    """

    length: float | Array = eqx.field(converter=as_size)
    apical_axes: Float[Array, "2"] = eqx.field(converter=_axes)
    basal_axes: Float[Array, "2"] = eqx.field(converter=_axes)

    @property
    def base(self) -> Rectangle:
        """The base surface."""
        return Rectangle((self.length, 2 * math.pi), ("free", "closed"))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the coordinates of a position, as in tables of backbones."""
        return ("axial", "angle")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        y, z = jnp.cos(m[1]), jnp.sin(m[1])
        inner, outer = ((m[0], axes[0] * y, axes[1] * z) for axes in (self.apical_axes, self.basal_axes))
        return inner, outer


class BentTube(Shape):
    """A tube whose center line is an arc in the plane z = 0 round the origin; a torus where the arc is 2 pi.

    Attributes:
        bend_radius: R, the radius of the center line.
        arc: The angle that the center line spans, at most 2 pi; it is static, not traced.
        apical_radius: The radius of the apical surface round the center line.
        basal_radius: The radius of the basal surface, below R.

    >>> torus = BentTube(bend_radius=5, arc=2 * math.pi, apical_radius=1, basal_radius=2)
    >>> round(torus.volume / (2 * math.pi**2 * 5 * 3), 6)
    1.0
    """

    bend_radius: float | Array = eqx.field(converter=as_size)
    arc: float = eqx.field(static=True, converter=float)
    apical_radius: float | Array = eqx.field(converter=as_size)
    basal_radius: float | Array = eqx.field(converter=as_size)

    @property
    def is_torus(self) -> bool:
        """Whether the arc is a full turn, to 1e-6."""
        return abs(self.arc - 2 * math.pi) < 1e-6

    @property
    def base(self) -> Rectangle:
        """The base surface."""
        return Rectangle((self.bend_radius * self.arc, 2 * math.pi), ("closed" if self.is_torus else "free", "closed"))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the coordinates of a position, as in tables of backbones."""
        return ("axial", "angle")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        turn = m[0] / self.bend_radius
        across, up = jnp.cos(m[1]), jnp.sin(m[1])
        ahead, aside = jnp.cos(turn), jnp.sin(turn)

        def at(radius: Array | float) -> Vector:
            out = self.bend_radius + radius * across
            return (out * ahead, out * aside, radius * up)

        return at(self.apical_radius), at(self.basal_radius)


class Sphere(Shape):
    """A hollow sphere, as a cyst or spheroid, with radial backbones.

    Attributes:
        apical_radius: The radius of the apical surface.
        basal_radius: The radius of the basal surface.

    >>> round(Sphere(apical_radius=1, basal_radius=2).volume / math.pi, 6)
    9.333333
    """

    apical_radius: float | Array = eqx.field(converter=as_size)
    basal_radius: float | Array = eqx.field(converter=as_size)

    @property
    def base(self) -> UnitSphere:
        """The base surface."""
        return UnitSphere()

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        return scale(self.apical_radius, m), scale(self.basal_radius, m)


class Ellipsoid(Shape):
    """A hollow ellipsoid; the ends of the backbone of a unit vector n are axes * n.

    Attributes:
        apical_axes: The semi-axes of the apical surface along x, y and z, [3].
        basal_axes: The semi-axes of the basal surface, [3].

    >>> round(Ellipsoid(apical_axes=[2, 1, 1], basal_axes=[3, 2, 2]).volume / (4 * math.pi / 3), 5)
    10.0
    """

    apical_axes: Float[Array, "3"] = eqx.field(converter=_axes)
    basal_axes: Float[Array, "3"] = eqx.field(converter=_axes)

    @property
    def base(self) -> UnitSphere:
        """The base surface."""
        return UnitSphere()

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        inner, outer = (tuple(axes[k] * m[k] for k in range(3)) for axes in (self.apical_axes, self.basal_axes))
        return inner, outer


class Fold(Shape):
    """A folded sheet: apical surface z = a sin(2 pi x / wavelength), basal surface at a distance along its normal.

    Attributes:
        width: The extent along x, at a right angle to the folds.
        depth: The extent along y.
        amplitude: a, half of the height of the folds.
        wavelength: The distance from fold to fold.
        thickness: The distance of the two surfaces; it must be below the least radius of curvature.

    >>> round(Fold(width=8, depth=4, amplitude=0, wavelength=4, thickness=1).volume, 6)
    32.0
    """

    width: float | Array = eqx.field(converter=as_size)
    depth: float | Array = eqx.field(converter=as_size)
    amplitude: float | Array = eqx.field(converter=as_size)
    wavelength: float | Array = eqx.field(converter=as_size)
    thickness: float | Array = eqx.field(converter=as_size)

    @property
    def base(self) -> Rectangle:
        """The base surface."""
        return Rectangle((self.width, self.depth), ("free", "free"))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the coordinates of a position, as in tables of backbones."""
        return ("x", "y")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        wave = 2 * math.pi / self.wavelength
        height, slope = self.amplitude * jnp.sin(wave * m[0]), self.amplitude * wave * jnp.cos(wave * m[0])
        share = self.thickness / jnp.sqrt(1 + slope**2)
        return (m[0], m[1], height), (m[0] - slope * share, m[1], height + share)
