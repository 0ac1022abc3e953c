"""Voxels of the tissue, on cylindrical and Cartesian grids, and their volumes."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.diagram.insides import bounding_box, contains
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube

_TOGETHER = 2**22  # centers of voxels that are made together
_ROUNDING = 1e-9  # of its distance from 0, that a tissue may reach into a voxel without needing it


@usual_modes()
def cylindrical_voxels(
    tube: Tube, shape: tuple[int, int, int]
) -> tuple[Float[Array, "voxels 3"], Float[Array, "voxels"]]:
    """Return centers and exact volumes r dx dr dtheta of the voxels of a cylindrical grid that fills the tissue.

    The volumes sum to `tube.volume`. With `label_points` and `label_volumes` they measure cells by counting voxels.

    Args:
        tube: The tube; its dimensions may be traced.
        shape: Numbers of voxels along the axis, in radius and in angle, three integers of at least 1. Static under
            `jax.jit`.

    Returns:
        Cartesian coordinates of the centers, shape [voxels, 3], with the angle varying fastest, and volumes, shape
        [voxels].

    Raises:
        ValueError: If `shape` does not have three entries of at least 1.

    >>> points, volumes = cylindrical_voxels(Tube(1, 1, 3), (1, 2, 4))
    >>> points.shape, round(float(volumes.sum()), 3), round(Tube(1, 1, 3).volume, 3)
    ((8, 3), 25.133, 25.133)
    """
    if len(shape) != 3 or min(shape) < 1:
        raise ValueError(
            f"shape={shape} is not three numbers of voxels; give (axial, radial, angular), each at least 1"
        )
    dtype = jnp.result_type(tube.length, tube.apical_radius, tube.basal_radius, 0.0)
    middles = [(jnp.arange(count, dtype=dtype) + 0.5) / count for count in shape]
    share_x, share_r, share_t = (m.ravel() for m in jnp.meshgrid(*middles, indexing="ij"))
    wall = tube.basal_radius - tube.apical_radius
    radius, angle = tube.apical_radius + wall * share_r, 2 * math.pi * share_t
    points = jnp.stack([tube.length * share_x, radius * jnp.cos(angle), radius * jnp.sin(angle)], axis=-1)
    return points, radius * (2 * math.pi * wall * tube.length / math.prod(shape))


def cartesian_voxels(
    domain: Tube | Domain, spacing: float | Sequence[float]
) -> tuple[Float[Array, "voxels 3"], Float[Array, "voxels"]]:
    """Return centers and volumes of the voxels of a Cartesian grid whose centers lie in the tissue.

    `label_image` uses the same grid: the faces of the voxels lie at multiples of their sides. Voxels do not follow the
    surfaces, so the sum of the volumes differs from `domain.volume`. In periodic directions the voxels fill one period.
    Not jittable.

    Args:
        domain: The tube or other domain.
        spacing: Side of a cubic voxel, or the three sides (dz, dy, dx), in length units.

    Returns:
        Cartesian coordinates (x, y, z) of the centers, shape [voxels, 3], with x varying fastest, and volumes, shape
        [voxels].

    Raises:
        ValueError: If `spacing` is not positive, or so large that no voxel center lies in the tissue.

    >>> points, volumes = cartesian_voxels(Tube(2, 0.5, 2), 1.0)
    >>> points.shape, float(volumes.sum()), round(Tube(2, 0.5, 2).volume, 2)
    ((24, 3), 24.0, 23.56)
    """
    box = image_box(domain, spacing)
    mask = image_mask(domain, spacing)
    dtype = jnp.result_type(*jax.tree.leaves(domain), 0.0)
    z, y, x = (jnp.asarray(c, dtype) for c in ((np.argwhere(mask) + box.first + 0.5) * box.sides).T)
    return jnp.stack([x, y, z], axis=-1), jnp.full(x.shape, box.sides.prod(), dtype)


class Box(NamedTuple):
    """The smallest image round a domain, in the order (z, y, x).

    Voxel (k, j, i) has its center at (first + (k, j, i) + 1/2) sides.
    """

    first: Int[np.ndarray, "3"]
    counts: Int[np.ndarray, "3"]
    sides: Float[np.ndarray, "3"]

    def planes(self) -> Iterator[tuple[slice, Float[np.ndarray, "p 3"]]]:
        """The planes of voxels, a few at a time, and the centers (x, y, z) of the voxels in them."""
        z, y, x = (
            (np.arange(count) + first + 0.5) * side
            for first, count, side in zip(self.first.tolist(), self.counts.tolist(), self.sides.tolist(), strict=True)
        )
        step = max(1, _TOGETHER // (len(x) * len(y)))
        for low in range(0, len(z), step):
            some = slice(low, low + step)
            deep, high, long = np.meshgrid(z[some], y, x, indexing="ij")
            yield some, np.stack([long.ravel(), high.ravel(), deep.ravel()], axis=1)


def image_box(domain: Tube | Domain, spacing: float | Sequence[float]) -> Box:
    """The smallest image round a domain whose voxels begin at multiples of their sides.

    That of a tube begins at its end x = 0 and is centered on its axis. The spacing is one number or three, (z, y, x).

    Raises:
        ValueError: If the spacing is not positive.

    >>> image_box(Tube(2, 0.5, 2), 1.0).counts.tolist(), image_box(Tube(2, 0.5, 2), 1.0).first.tolist()
    ([4, 4, 2], [-2, -2, 0])
    """
    sides = np.asarray(spacing, float)
    if sides.shape not in ((), (3,)) or not (np.isfinite(sides).all() and (sides > 0).all()):
        numbers = "not a positive finite number" if sides.ndim == 0 else "not three positive finite numbers"
        raise ValueError(f"spacing={spacing} is {numbers}; give the side length of the voxels")
    sides = np.broadcast_to(sides, 3)
    low, high = (end[::-1] / sides for end in bounding_box(domain))
    first = np.floor(low + _ROUNDING * np.abs(low))
    counts = np.ceil(high - _ROUNDING * np.abs(high)) - first
    return Box(first.astype(int), counts.astype(int), sides)


def image_mask(domain: Tube | Domain, spacing: float | Sequence[float]) -> Bool[np.ndarray, "z y x"]:
    """Mark the voxels of the smallest image round a domain that have their centers in the tissue; order (z, y, x).

    Raises:
        ValueError: If the spacing is not positive, or so wide that no center lies in the tissue.

    >>> image_mask(Tube(2, 0.5, 2), 1.0)[:, :, 0].astype(int)
    array([[0, 1, 1, 0],
           [1, 1, 1, 1],
           [1, 1, 1, 1],
           [0, 1, 1, 0]])
    """
    box = image_box(domain, spacing)
    mask = np.zeros(box.counts, bool)
    for some, points in box.planes():
        mask[some] = contains(points, domain).reshape(mask[some].shape)
    if not mask.any():
        raise ValueError(f"spacing={spacing} is too large: no voxel center lies in the tissue; give a smaller spacing")
    return mask
