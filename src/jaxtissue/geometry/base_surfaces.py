"""Base surfaces: where backbones are placed. A rectangle whose directions are free, closed or periodic, or a sphere."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.geometry.vectors import Vector, dot, scale

DIRECTIONS = ("free", "closed", "periodic")
BOX = 4.0  # to either side, in the gnomonic chart of a sphere: 76 degrees; no section may reach as far
PERIODS = 1.0  # to either side, that a section in a periodic direction may reach


class Limits(NamedTuple):
    """How far a section may reach from a point in its local chart, to either side of both directions."""

    low: Vector
    high: Vector


class Rectangle(eqx.Module):
    """A rectangle of coordinates (u, v), each direction free, closed or periodic.

    The local chart is m + y. In a closed direction the surface comes back to itself, as the angle round a tube; in a
    periodic one it goes on as a shifted copy of itself.

    Attributes:
        extent: The lengths of both directions, which begin at 0.
        directions: One of `DIRECTIONS` for each.
    """

    extent: tuple[float | Array, float | Array]
    directions: tuple[str, str] = eqx.field(static=True)

    def chart(self, m: Vector, y: Vector) -> Vector:
        """The point with the local coordinates y round m."""
        return (m[0] + y[0], m[1] + y[1])

    def steps(self, m: Vector) -> tuple[Vector, Vector]:
        """The derivatives of the point by the local coordinates, at m."""
        one, none = jnp.ones_like(m[0]), jnp.zeros_like(m[0])
        return (one, none), (none, one)

    def difference(self, m: Vector, other: Vector) -> Vector:
        """The local coordinates of another point round m, the nearest ones where it has several."""
        apart = []
        for a, b, extent, direction in zip(m, other, self.extent, self.directions, strict=True):
            apart.append(b - a if direction == "free" else b - a - extent * jnp.round((b - a) / extent))
        return tuple(apart)

    def wrap(self, m: Vector) -> Vector:
        """The point brought back: reflected at free ends, wrapped in closed and periodic directions."""
        place = []
        for a, extent, direction in zip(self.reflect(m), self.extent, self.directions, strict=True):
            turned = a if direction == "free" else jnp.mod(a, extent)
            place.append(a if direction == "free" else jnp.where(turned >= extent, 0, turned))  # tiny ones round up
        return tuple(place)

    def reflect(self, m: Vector) -> Vector:
        """The point reflected at free ends, with its turns and periods as they are."""
        place = []
        for a, extent, direction in zip(m, self.extent, self.directions, strict=True):
            folded = jnp.mod(jnp.abs(a), 2 * extent)
            place.append(jnp.where(folded > extent, 2 * extent - folded, folded) if direction == "free" else a)
        return tuple(place)

    def way_back(self, m: Vector, y: Vector) -> Vector:
        """The local coordinates that lead back to m from the point that y leads to: -y, as seen in the mirror of ends.

        Every way has one way back, also where a point is reached on several.
        """
        way = []
        for a, b, extent, direction in zip(m, y, self.extent, self.directions, strict=True):
            mirrored = jnp.mod(jnp.floor((a + b) / extent), 2) == 1
            way.append(jnp.where(mirrored, b, -b) if direction == "free" else -b)
        return tuple(way)

    def limits(self, m: Vector) -> Limits:
        """How far sections round the point may reach: to free ends, once round, or a period to either side."""
        low, high = [], []
        for a, extent, direction in zip(m, self.extent, self.directions, strict=True):
            reach = extent * {"free": 0.0, "closed": 0.5, "periodic": PERIODS}[direction] + 0 * a
            low.append(-a if direction == "free" else -reach)
            high.append(extent - a if direction == "free" else reach)
        return Limits(tuple(low), tuple(high))

    def place(self, share: Vector) -> Vector:
        """The point for two numbers from 0 to 1; where these are uniform, so are the points by area."""
        return (share[0] * self.extent[0], share[1] * self.extent[1])

    def nodes(self, count: int) -> tuple[Vector, Any]:
        """Points and weights of a quadrature over the rectangle, `count` in each direction."""
        sides = []
        for direction in self.directions:
            place, weight = np.polynomial.legendre.leggauss(count)
            if direction != "free":  # the trapezoidal rule: no rule is better for what is periodic
                place, weight = (2 * np.arange(count) + 1) / count - 1, np.full(count, 2 / count)
            sides.append(((place + 1) / 2, weight / 2))
        (u, weight_u), (v, weight_v) = sides
        first, second = np.meshgrid(u, v, indexing="ij")
        points = (self.extent[0] * jnp.asarray(first.ravel()), self.extent[1] * jnp.asarray(second.ravel()))
        return points, np.outer(weight_u, weight_v).ravel() * self.extent[0] * self.extent[1]

    def images(self) -> Float[np.ndarray, "images 2"]:
        """The shifts, in periods, of the copies in periodic directions; the first is no shift."""
        steps = [(0, -1, 1) if direction == "periodic" else (0,) for direction in self.directions]
        return np.array([(u, v) for u in steps[0] for v in steps[1]], float)

    def is_end(self) -> np.ndarray:
        """Which of the limits (low u, low v, high u, high v) are ends of the tissue."""
        return np.tile([direction == "free" for direction in self.directions], 2)

    def is_seam(self) -> np.ndarray:
        """Which of the limits are where a cell that goes all the way round meets itself."""
        return np.tile([direction == "closed" for direction in self.directions], 2)


class UnitSphere(eqx.Module):
    """The unit vectors n. The local chart is the gnomonic one, normalize(n + y_1 e_1 + y_2 e_2)."""

    def chart(self, m: Vector, y: Vector) -> Vector:
        """The point with the local coordinates y round m."""
        first, second = tangents(m)
        point = tuple(a + y[0] * b + y[1] * c for a, b, c in zip(m, first, second, strict=True))
        return scale(1 / jnp.sqrt(dot(point, point)), point)

    def steps(self, m: Vector) -> tuple[Vector, Vector]:
        """The derivatives of the point by the local coordinates, at m: unit vectors at right angles to it."""
        return tangents(m)

    def difference(self, m: Vector, other: Vector) -> Vector:
        """The local coordinates of another point round m; what lies beyond the chart is put at its rim."""
        first, second = tangents(m)
        height = dot(m, other)
        share = 1 / jnp.where(height > 0.05, height, 0.05)
        return (share * dot(first, other), share * dot(second, other))

    def wrap(self, m: Vector) -> Vector:
        """The unit vector in the same direction."""
        return scale(1 / jnp.sqrt(dot(m, m)), m)

    def reflect(self, m: Vector) -> Vector:
        """The point as it is: there are no ends."""
        return m

    def way_back(self, m: Vector, y: Vector) -> Vector:
        """The local coordinates of m round the point that y leads to."""
        return self.difference(self.chart(m, y), m)

    def limits(self, m: Vector) -> Limits:
        """How far sections round the point may reach: all but round the sphere."""
        reach = BOX + 0 * m[0]
        return Limits((-reach, -reach), (reach, reach))

    def place(self, share: Vector) -> Vector:
        """The point for two numbers from 0 to 1; where these are uniform, so are the points by area."""
        height, turn = 2 * share[0] - 1, 2 * math.pi * share[1]
        width = jnp.sqrt(jnp.maximum(1 - height**2, 0))
        return (width * jnp.cos(turn), width * jnp.sin(turn), height)

    def nodes(self, count: int) -> tuple[Vector, np.ndarray]:
        """Points and weights of a quadrature over the sphere, `count` from pole to pole."""
        height, weight = np.polynomial.legendre.leggauss(count)
        turn = 2 * math.pi * (np.arange(2 * count) + 0.5) / (2 * count)
        z, t = (table.ravel() for table in np.meshgrid(height, turn, indexing="ij"))
        width = np.sqrt(1 - z**2)
        points = tuple(jnp.asarray(part, float) for part in (width * np.cos(t), width * np.sin(t), z))
        return points, np.repeat(weight, 2 * count) * math.pi / count

    def images(self) -> Float[np.ndarray, "images 2"]:
        """The one shift, by nothing: a sphere has no periods."""
        return np.zeros((1, 2))

    def is_end(self) -> np.ndarray:
        """None of the limits is an end of the tissue."""
        return np.zeros(4, bool)

    def is_seam(self) -> np.ndarray:
        """None of the limits is a seam."""
        return np.zeros(4, bool)


def tangents(normal: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors square to a unit vector and to each other, by a formula without branches (Duff et al. 2017)."""
    x, y, z = normal
    sign = jnp.where(z >= 0, 1.0, -1.0).astype(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
