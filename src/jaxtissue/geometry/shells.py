"""Shells: the tissue between any two surfaces, or between one and another at a distance along its normal."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxtissue.geometry.base_surfaces import DIRECTIONS, Rectangle, UnitSphere
from jaxtissue.geometry.shapes import Shape, as_size
from jaxtissue.geometry.vectors import Vector

Surface = Callable[[Float[Array, "d"]], Float[Array, "3"]]


class Shell(Shape):
    """The tissue between any two surfaces, given as JAX functions over one base surface (paper, Definition 2).

    Attributes:
        apical: The function m -> S_a(m), from a point of the base surface, [2] or a unit vector [3], to space, [3].
        basal: The function m -> S_b(m); or a thickness, for the surface at this distance along the normal
            dS_a/dm_1 x dS_a/dm_2, negative for the other side.
        extent: The lengths of the two coordinates, which begin at 0; None for unit vectors.
        directions: "free", "closed" or "periodic" for each coordinate. In a closed direction the functions return to
            the same point, in a periodic one to a shifted one.

    >>> cone = Shell(lambda m: jnp.stack([m[0], m[1], 0 * m[0]]), 2.0, extent=(3, 4))
    >>> round(cone.volume, 6)
    24.0
    """

    apical: Surface = eqx.field(static=True)
    basal: Surface | float | Array
    extent: tuple[Any, Any] | None = eqx.field(default=None)
    directions: tuple[str, str] = eqx.field(static=True, converter=tuple, default=("free", "free"))

    def __init__(
        self,
        apical: Surface,
        basal: Surface | float | Array,
        extent: tuple[Any, Any] | None = None,
        directions: tuple[str, str] = ("free", "free"),
    ) -> None:
        if not set(directions) <= set(DIRECTIONS):
            raise ValueError(f"directions={directions!r}; each is one of {', '.join(DIRECTIONS)}")
        self.apical = apical
        self.basal = jax.tree_util.Partial(basal) if callable(basal) else as_size(basal)
        self.extent = None if extent is None else (as_size(extent[0]), as_size(extent[1]))
        self.directions = directions

    @property
    def base(self) -> Rectangle | UnitSphere:
        """The base surface."""
        return UnitSphere() if self.extent is None else Rectangle(self.extent, self.directions)

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """The points of the apical and the basal surface."""
        together = jnp.stack(m)
        both = self._both
        for _ in range(together.ndim - 1):  # the functions are those of one point
            both = jax.vmap(both, in_axes=-1, out_axes=-1)
        apical, basal = both(together)
        return tuple(apical), tuple(basal)

    def _both(self, m: Float[Array, "d"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        apical = self.apical(m)
        if callable(self.basal):
            return apical, self.basal(m)

        def nearby(y: Array) -> Array:
            return self.apical(jnp.stack(self.base.chart(tuple(m), (y[0], y[1]))))

        first, second = jax.jacfwd(nearby)(jnp.zeros(2, m.dtype)).T
        normal = jnp.cross(first, second)
        return apical, apical + self.basal * normal / jnp.sqrt(jnp.sum(normal**2))
