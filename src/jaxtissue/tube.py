"""The tube: tissue between two nested cylinders around the x axis (paper, Definition 3)."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray
from numpy.typing import ArrayLike

from jaxtissue.backbones import Backbones

ROUNDING = 1e-6  # relative, of single precision


def _plain(size: float | Array) -> float | Array:
    """NumPy scalars as Python floats, which take the precision of the arrays they meet."""
    return float(size) if isinstance(size, int | np.ndarray | np.generic) and np.ndim(size) == 0 else size


class Tube(eqx.Module):
    """Tissue between cylinders of radii `apical_radius` < `basal_radius`, for axial positions 0 to `length`.

    The three sizes are pytree leaves: they are traced, so radii and length change without recompiling and
    `vmap` runs over them. A backbone's *position* is (axial, angle): it stands radially at x = axial.
    The frame is x along the axis, y = r cos(angle), z = r sin(angle). Raises `ValueError` for sizes that
    are known before tracing and not positive, not finite, or not nested.

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
        known = {name: size for name, size in sizes.items() if isinstance(size, float | np.ndarray)}
        for name, size in known.items():
            if not (np.all(np.isfinite(size)) and np.all(size > 0)):
                raise ValueError(f"{name}={size} is not a positive finite number; give a length above 0")
        inner, outer = known.get("apical_radius"), known.get("basal_radius")
        if inner is not None and outer is not None and not np.all(inner < outer):
            raise ValueError(f"apical_radius={inner} is not below basal_radius={outer}; swap or change them")

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

    def require_inside(self, positions: ArrayLike) -> None:
        """Raises `ValueError` for positions that are not (axial, angle) rows, finite and within the tube.

        By a rounding of single precision they may stand outside.

        >>> Tube(10, 1, 2).require_inside([[5.0, 0.0], [10.5, 0.0]])
        Traceback (most recent call last):
        ValueError: backbone 1 at [10.5  0. ]: give 0 <= axial <= 10.0, a finite angle
        """
        place = np.asarray(positions, float)
        if place.ndim != 2 or place.shape[1] != 2 or not len(place):
            raise ValueError(f"positions of shape {place.shape}: give (axial, angle) rows, [n, 2], n >= 1")
        half, (axial, angle) = float(self.length) / 2, place.T
        inside = np.isfinite(angle) & (np.abs(axial - half) <= half * (1 + ROUNDING))
        for i in np.flatnonzero(~inside):
            raise ValueError(f"backbone {i} at {place[i]}: give 0 <= axial <= {2 * half}, a finite angle")

    def reflect(self, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """The positions brought back to 0 <= axial <= L by reflection at the ends, and 0 <= angle < 2 pi.

        Positions already inside come back unchanged, to the last bit. Reflection, unlike clipping, keeps the
        proposals of a Metropolis chain symmetric.

        >>> Tube(10, 1, 2).reflect(jnp.array([[-1.0, 0.5], [23.0, 1.0]])).tolist()
        [[1.0, 0.5], [3.0, 1.0]]
        """
        folded = jnp.mod(jnp.abs(positions[:, 0]), 2 * self.length)
        axial = jnp.where(folded > self.length, 2 * self.length - folded, folded)
        turned = jnp.mod(positions[:, 1], 2 * math.pi)
        # A tiny negative angle rounds up to a full turn.
        angle = jnp.where(turned >= 2 * math.pi, 0, turned)
        return jnp.stack([axial, angle], axis=-1)

    def random_positions(self, key: PRNGKeyArray, count: int) -> Float[Array, "n 2"]:
        """`count` positions, uniform in the axial position and in the angle (paper, Section 4.2).

        They are numbered along the tube: cells near each other are then kept near each other in memory, which
        makes sweeps of 50,000 cells a seventh faster. Raises `ValueError` for a count below 1.
        """
        if count < 1:
            raise ValueError(f"count={count} backbones fill no tissue; give at least 1")
        return _random_positions(self, key, count)


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
