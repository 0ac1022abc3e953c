"""The tube: tissue between two nested cylinders around the x axis (paper, Definition 3)."""

import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray
from numpy.typing import DTypeLike

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.backbones import Backbones

THIN = 0.01  # of the wall, by which rounding of the radii may change it


def _plain(size: Any) -> Any:
    """Numbers as Python floats, which take the precision of the arrays they meet; arrays of whole numbers as
    floats."""
    if isinstance(size, jax.Array) or np.asarray(size).dtype.kind not in "iuf":
        return size
    return float(size) if np.ndim(size) == 0 else np.asarray(size, float)


class Tube(eqx.Module):
    """Tissue between cylinders of radii `apical_radius` < `basal_radius`, for axial positions 0 to `length`.

    The three sizes are pytree leaves: they are traced, so radii and length change without recompiling and
    `vmap` runs over them. A backbone's *position* is (axial, angle): it stands radially at x = axial.
    The frame is x along the axis, y = r cos(angle), z = r sin(angle). Raises `ValueError` for sizes that
    are known before tracing and no numbers, not positive, not finite, or not nested, and for those that the
    precision JAX works in can't measure: too small, too large, or with a wall that rounding changes.

    >>> tube = Tube(length=100, apical_radius=1, basal_radius=10)
    >>> round(tube.volume)
    31102
    >>> Tube(length=100, apical_radius=10, basal_radius=1)
    Traceback (most recent call last):
    ValueError: apical_radius=10.0 is not below basal_radius=1.0; swap or change them
    """

    length: float | Array = eqx.field(converter=_plain)
    apical_radius: float | Array = eqx.field(converter=_plain)
    basal_radius: float | Array = eqx.field(converter=_plain)

    def __check_init__(self) -> None:
        sizes = {name: getattr(self, name) for name in ("length", "apical_radius", "basal_radius")}
        known = {name: size for name, size in sizes.items() if not isinstance(size, Tracer)}
        for name, size in known.items():
            _check_size(name, size)
        if {"apical_radius", "basal_radius"} <= known.keys():
            _check_nested(np.asarray(self.apical_radius, float), np.asarray(self.basal_radius, float))

    @property
    def volume(self) -> float | Array:
        """Volume of the tissue, pi (R_b^2 - R_a^2) L."""
        wall = self.basal_radius - self.apical_radius
        return math.pi * wall * (self.basal_radius + self.apical_radius) * self.length

    @property
    def apical_area(self) -> float | Array:
        """Area of the apical surface, 2 pi R_a L."""
        return 2 * math.pi * self.apical_radius * self.length

    @property
    def basal_area(self) -> float | Array:
        """Area of the basal surface, 2 pi R_b L."""
        return 2 * math.pi * self.basal_radius * self.length

    @usual_modes()
    def embed(self, positions: Float[Array, "n 2"]) -> Backbones:
        """The backbones, as segments, of the given (axial, angle) positions.

        >>> backbones = Tube(10, 1, 2).embed(jnp.array([[5.0, 0.0]]))
        >>> backbones.apical.tolist(), backbones.basal.tolist()
        ([[5.0, 1.0, 0.0]], [[5.0, 2.0, 0.0]])
        """
        axial, angle = positions[:, 0], positions[:, 1]
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        apical = jnp.stack([axial, self.apical_radius * cosine, self.apical_radius * sine], axis=-1)
        basal = jnp.stack([axial, self.basal_radius * cosine, self.basal_radius * sine], axis=-1)
        return Backbones(apical, basal)

    @usual_modes()
    def reflect(self, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """The positions brought back to 0 <= axial <= L by reflection at the ends, and 0 <= angle < 2 pi.

        Positions already inside come back unchanged, to the last bit. Reflection, unlike clipping, keeps the
        proposals of a Metropolis chain symmetric.

        >>> Tube(10, 1, 2).reflect(jnp.array([[-1.0, 0.5], [23.0, 1.0]])).tolist()
        [[1.0, 0.5], [3.0, 1.0]]
        """
        return _reflect(self.length, positions)

    @usual_modes()
    def random_positions(self, key: PRNGKeyArray, count: int) -> Float[Array, "n 2"]:
        """`count` positions, uniform in the axial position and in the angle (paper, Section 4.2).

        They are numbered along the tube: cells near each other are then kept near each other in memory, which
        makes sweeps of 50,000 cells a seventh faster. Raises `ValueError` for a count below 1.
        """
        if count < 1:
            raise ValueError(f"count={count} backbones fill no tissue; give at least 1")
        return _random_positions(self, key, count)


@functools.partial(jax.jit, inline=True)
def _reflect(length: float | Array, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    folded = jnp.mod(jnp.abs(positions[:, 0]), 2 * length)
    axial = jnp.where(folded > length, 2 * length - folded, folded)
    turned = jnp.mod(positions[:, 1], 2 * math.pi)
    # A tiny negative angle rounds up to a full turn.
    angle = jnp.where(turned >= 2 * math.pi, 0, turned)
    return jnp.stack([axial, angle], axis=-1)


def _check_size(name: str, size: float | Array | np.ndarray) -> None:
    """Raise `ValueError` for a size that is no length, or none that the precision of JAX can measure."""
    value = np.asarray(size)
    if value.dtype.kind not in "iuf":
        raise ValueError(f"{name}={size!r} is not a number; give a length above 0")
    if not (np.isfinite(value).all() and (value > 0).all()):
        raise ValueError(f"{name}={size} is not a positive finite number; give a length above 0")
    # products of four lengths neither under- nor overflow
    low, high = _bounds(jnp.result_type(float))
    if not ((low <= value) & (value <= high)).all():
        least, most = _bounds(np.float64)
        helps = ((least <= value) & (value <= most)).all()
        remedy = "change the unit of length" + " or use 64 bits (--x64, jax_enable_x64)" * bool(helps)
        within = f"the range of {np.dtype(jnp.result_type(float))}, {low:.1g} to {high:.1g}"
        raise ValueError(f"{name}={size} is out of {within}; {remedy}")


def _bounds(dtype: DTypeLike) -> tuple[float, float]:
    limits = np.finfo(dtype)
    return float(limits.tiny) ** 0.25, float(limits.max) ** 0.25


def _check_nested(inner: np.ndarray, outer: np.ndarray) -> None:
    """Raise `ValueError` for radii that leave no tissue between them, exactly or in the precision of JAX."""
    if not np.all(inner < outer):
        raise ValueError(f"apical_radius={inner} is not below basal_radius={outer}; swap or change them")
    dtype = np.dtype(jnp.result_type(float))
    wall = outer.astype(dtype) - inner.astype(dtype)
    if not np.all(np.abs(wall - (outer - inner)) <= THIN * (outer - inner)):
        told = f"apical_radius={inner} and basal_radius={outer} are too near to tell apart in {dtype}"
        raise ValueError(f"{told}; use 64 bits (--x64, jax_enable_x64) or a thicker wall")


@functools.partial(jax.jit, static_argnames="count")
def _random_positions(tube: Tube, key: PRNGKeyArray, count: int) -> Float[Array, "n 2"]:
    dtype = jnp.result_type(tube.length, tube.apical_radius, tube.basal_radius, 0.0)
    axial, angle = jax.random.uniform(key, (2, count), dtype)
    axial = jnp.sort(axial)
    return tube.reflect(jnp.stack([tube.length * axial, 2 * math.pi * angle], axis=-1))


def cells_for_unit_volume(tube: Tube) -> int:
    """The number of cells whose mean volume is nearest to 1 (paper, Section 4.2), at least 1.

    >>> cells_for_unit_volume(Tube(length=10, apical_radius=1, basal_radius=2))
    94
    """
    return max(1, round(float(tube.volume)))
