"""Shapes of domains: slab, round, elliptic and bent tube, sphere, ellipsoid and fold."""

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
    """Flat sheet with apical surface z = 0 and basal surface z = thickness, for 0 <= x <= width and 0 <= y <= depth.

    The position of a backbone is (x, y).

    Attributes:
        width: Extent along x. Its unit is the unit of all lengths.
        depth: Extent along y.
        thickness: Distance between the two surfaces.
        periodic: Whether the tissue repeats periodically in x and in y, or ends there, two booleans. Defaults to
            (False, False).

    >>> Slab(width=4, depth=3, thickness=2, periodic=(True, True)).volume
    24.0
    """

    width: float | Array = eqx.field(converter=as_size)
    depth: float | Array = eqx.field(converter=as_size)
    thickness: float | Array = eqx.field(converter=as_size)
    periodic: tuple[bool, bool] = eqx.field(static=True, converter=_two, default=(False, False))

    @property
    def base(self) -> Rectangle:
        """Base surface on which the backbones are placed."""
        return Rectangle((self.width, self.depth), tuple(map(_direction, self.periodic)))  # type: ignore[arg-type]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates of a position, used as column names in tables of backbones."""
        return ("x", "y")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        level = jnp.zeros_like(m[0])
        return (m[0], m[1], level), (m[0], m[1], level + self.thickness)


class RoundTube(Shape):
    """Straight round tube that may be periodic along its axis.

    For a tube with two ends use `Tube`, which describes the same tissue, is faster and more accurate, and supports
    meshes and exports. Use `RoundTube` for a periodic tube, or to compare a round tube with other domains: `RoundTube`
    measures cells by the method of the other domains. The position of a backbone is (axial, angle), with axial from 0
    to `length` and the angle in radians.

    Attributes:
        length: Length of the tube, or its period if `periodic`. Its unit is the unit of all lengths.
        apical_radius: Radius of the apical surface.
        basal_radius: Radius of the basal surface.
        periodic: Whether the axial direction is periodic. Defaults to False.

    >>> round(RoundTube(length=10, apical_radius=1, basal_radius=2, periodic=True).volume / math.pi, 6)
    30.0
    """

    length: float | Array = eqx.field(converter=as_size)
    apical_radius: float | Array = eqx.field(converter=as_size)
    basal_radius: float | Array = eqx.field(converter=as_size)
    periodic: bool = eqx.field(static=True, default=False)

    @property
    def base(self) -> Rectangle:
        """Base surface on which the backbones are placed."""
        return Rectangle((self.length, 2 * math.pi), (_direction(self.periodic), "closed"))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates of a position, used as column names in tables of backbones."""
        return ("axial", "angle")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        y, z = jnp.cos(m[1]), jnp.sin(m[1])
        inner, outer = self.apical_radius, self.basal_radius
        return (m[0], inner * y, inner * z), (m[0], outer * y, outer * z)


class EllipticTube(Shape):
    """Straight tube between two elliptic cylinders, y = a_1 cos(angle) and z = a_2 sin(angle).

    The position of a backbone is (axial, angle). The angle, in radians, is the parameter of both ellipses, and the
    backbone joins the two points with the same parameter.

    Attributes:
        length: Length of the tube. Its unit is the unit of all lengths.
        apical_axes: Semi-axes of the apical surface along y and z, shape [2].
        basal_axes: Semi-axes of the basal surface along y and z, shape [2].

    >>> round(EllipticTube(length=10, apical_axes=[1, 2], basal_axes=[2, 3]).volume / math.pi, 6)
    40.0
    """

    length: float | Array = eqx.field(converter=as_size)
    apical_axes: Float[Array, "2"] = eqx.field(converter=_axes)
    basal_axes: Float[Array, "2"] = eqx.field(converter=_axes)

    @property
    def base(self) -> Rectangle:
        """Base surface on which the backbones are placed."""
        return Rectangle((self.length, 2 * math.pi), ("free", "closed"))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates of a position, used as column names in tables of backbones."""
        return ("axial", "angle")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        y, z = jnp.cos(m[1]), jnp.sin(m[1])
        inner, outer = ((m[0], axes[0] * y, axes[1] * z) for axes in (self.apical_axes, self.basal_axes))
        return inner, outer


class BentTube(Shape):
    """Tube whose center line is a circular arc around the origin in the plane z = 0; a torus if the arc is 2 pi.

    The position of a backbone is (axial, angle): the arc length along the center line, from 0 on the x-axis to
    R * arc toward the y-axis, and the angle around it in radians, 0 on the outer side of the bend and pi / 2 toward z.

    Attributes:
        bend_radius: R, radius of the center line. Its unit is the unit of all lengths.
        arc: Angle in radians that the center line spans, greater than 0 and at most 2 pi. Static under `jax.jit`.
        apical_radius: Radius of the apical surface around the center line.
        basal_radius: Radius of the basal surface around the center line, less than R.

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
        """Whether the arc is a full turn, to within 1e-6 radians."""
        return abs(self.arc - 2 * math.pi) < 1e-6

    @property
    def base(self) -> Rectangle:
        """Base surface on which the backbones are placed."""
        return Rectangle((self.bend_radius * self.arc, 2 * math.pi), ("closed" if self.is_torus else "free", "closed"))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates of a position, used as column names in tables of backbones."""
        return ("axial", "angle")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        turn = m[0] / self.bend_radius
        across, up = jnp.cos(m[1]), jnp.sin(m[1])
        ahead, aside = jnp.cos(turn), jnp.sin(turn)

        def at(radius: Array | float) -> Vector:
            out = self.bend_radius + radius * across
            return (out * ahead, out * aside, radius * up)

        return at(self.apical_radius), at(self.basal_radius)


class Sphere(Shape):
    """Hollow sphere with radial backbones, such as a cyst or a spheroid.

    The position of a backbone is a unit vector, shape [3].

    Attributes:
        apical_radius: Radius of the apical (inner) surface. Its unit is the unit of all lengths.
        basal_radius: Radius of the basal (outer) surface.

    >>> round(Sphere(apical_radius=1, basal_radius=2).volume / math.pi, 6)
    9.333333
    """

    apical_radius: float | Array = eqx.field(converter=as_size)
    basal_radius: float | Array = eqx.field(converter=as_size)

    @property
    def base(self) -> UnitSphere:
        """Base surface on which the backbones are placed."""
        return UnitSphere()

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        return scale(self.apical_radius, m), scale(self.basal_radius, m)


class Ellipsoid(Shape):
    """Hollow ellipsoid.

    The position of a backbone is a unit vector m, shape [3]; the backbone joins the points `apical_axes * m` and
    `basal_axes * m`.

    Attributes:
        apical_axes: Semi-axes of the apical surface along x, y and z, shape [3]. Their unit is the unit of all lengths.
        basal_axes: Semi-axes of the basal surface along x, y and z, shape [3].

    >>> round(Ellipsoid(apical_axes=[2, 1, 1], basal_axes=[3, 2, 2]).volume / (4 * math.pi / 3), 5)
    10.0
    """

    apical_axes: Float[Array, "3"] = eqx.field(converter=_axes)
    basal_axes: Float[Array, "3"] = eqx.field(converter=_axes)

    @property
    def base(self) -> UnitSphere:
        """Base surface on which the backbones are placed."""
        return UnitSphere()

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        inner, outer = (tuple(axes[k] * m[k] for k in range(3)) for axes in (self.apical_axes, self.basal_axes))
        return inner, outer


class Fold(Shape):
    """Sinusoidally folded sheet of constant thickness.

    The apical surface is z = amplitude sin(2 pi x / wavelength), and the basal surface lies at distance `thickness`
    along its normal, on the side of positive z. The position of a backbone is (x, y) of its apical end.

    Attributes:
        width: Extent along x, perpendicular to the folds. Its unit is the unit of all lengths.
        depth: Extent along y.
        amplitude: Half the height of the folds; may be 0 or negative.
        wavelength: Period of the folds along x.
        thickness: Distance between the two surfaces, less than the smallest radius of curvature of the apical surface.

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
        """Base surface on which the backbones are placed."""
        return Rectangle((self.width, self.depth), ("free", "free"))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates of a position, used as column names in tables of backbones."""
        return ("x", "y")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points of the apical and the basal surface, as tuples of components."""
        wave = 2 * math.pi / self.wavelength
        height, slope = self.amplitude * jnp.sin(wave * m[0]), self.amplitude * wave * jnp.cos(wave * m[0])
        share = self.thickness / jnp.sqrt(1 + slope**2)
        return (m[0], m[1], height), (m[0] - slope * share, m[1], height + share)
