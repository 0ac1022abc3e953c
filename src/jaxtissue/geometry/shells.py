"""Shells: tissue between two arbitrary surfaces, or between one surface and its offset along the normal.

Definition 2 is that of the paper: Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics
via Backbone Spreads", GRAPP 2025.
"""

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
    """Tissue between two arbitrary surfaces, given as JAX functions on a common base surface (paper, Definition 2).

    Use `Shell` for shapes that have no class of their own. A position m is a point of the base surface, either the
    rectangle of coordinates 0 <= m_k <= extent[k] or the unit sphere, and the backbone at m is the segment from S_a(m)
    to S_b(m).

    Attributes:
        apical: Function m -> S_a(m) from one point of the base surface, shape [2] or a unit vector of shape [3], to a
            point in space, shape [3]. Must be differentiable by JAX; static under `jax.jit`.
        basal: Function m -> S_b(m) of the same kind, or a number: the distance of the basal surface from the apical one
            along the normal dS_a/dm_1 x dS_a/dm_2, negative for the opposite side.
        extent: Lengths of the two coordinate intervals, which start at 0. None, the default, if positions are unit
            vectors.
        directions: Boundary condition in each of the two coordinates. "free" (the default for both): the tissue ends
            there. "closed": the functions take the same values at both ends. "periodic": their values differ by a
            constant shift. Not used if `extent` is None.

    Raises:
        ValueError: If a direction is unknown, or if the surfaces are not finite, touch or intersect, or if the tissue
            folds over itself.

    >>> sheet = Shell(lambda m: jnp.stack([m[0], m[1], 0 * m[0]]), 2.0, extent=(3, 4))
    >>> round(sheet.volume, 6)
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
            raise ValueError(
                f"directions={directions!r} is invalid; each direction must be one of {', '.join(DIRECTIONS)}"
            )
        self.apical = apical
        self.basal = jax.tree_util.Partial(basal) if callable(basal) else as_size(basal)
        self.extent = None if extent is None else (as_size(extent[0]), as_size(extent[1]))
        self.directions = directions

    @property
    def base(self) -> Rectangle | UnitSphere:
        """Base surface on which the backbones are placed: a rectangle, or the unit sphere if `extent` is None."""
        return UnitSphere() if self.extent is None else Rectangle(self.extent, self.directions)

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points S_a(m) and S_b(m) of the apical and the basal surface, as tuples of components."""
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
