"""Voxels of the tissue, on cylindrical and Cartesian grids, and their volumes."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.tube import Tube


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


@usual_modes()
def cartesian_voxels(
    tube: Tube, spacing: float | Sequence[float]
) -> tuple[Float[Array, "voxels 3"], Float[Array, "voxels"]]:
    """Return centers and volumes of the voxels of a Cartesian grid whose centers lie in the tissue.

    `label_image` uses the same grid. Voxels do not follow the surfaces, so the sum of the volumes differs from
    `tube.volume`. Not jittable.

    Args:
        tube: The tube.
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
    mask = image_mask(tube, spacing)
    dtype = jnp.result_type(tube.length, tube.apical_radius, tube.basal_radius, 0.0)
    sides = np.broadcast_to(np.asarray(spacing, float), 3)
    z, y, x = (jnp.asarray(c, dtype) for c in ((np.argwhere(mask) + _corner(mask)) * sides).T)
    return jnp.stack([x, y, z], axis=-1), jnp.full(x.shape, sides.prod(), dtype)


def image_mask(tube: Tube, spacing: float | Sequence[float]) -> Bool[np.ndarray, "z y x"]:
    """Mark the voxels of the smallest image round the tube that have their centers in the tissue; order (z, y, x).

    Voxel (k, j, i) is centered at x = (i + 1/2) spacing, y = (j + 1/2 - ny/2) spacing and likewise z: the image begins
    at the tube's end x = 0 and is centered on the axis. The spacing is one number or three, in the order (z, y, x).

    Raises:
        ValueError: If the spacing is not positive, or so wide that no center lies in the tissue.

    >>> image_mask(Tube(2, 0.5, 2), 1.0)[:, :, 0].astype(int)
    array([[0, 1, 1, 0],
           [1, 1, 1, 1],
           [1, 1, 1, 1],
           [0, 1, 1, 0]])
    """
    sides = np.asarray(spacing, float)
    if sides.shape not in ((), (3,)) or not (np.isfinite(sides).all() and (sides > 0).all()):
        numbers = "not a positive finite number" if sides.ndim == 0 else "not three positive finite numbers"
        raise ValueError(f"spacing={spacing} is {numbers}; give the side length of the voxels")
    dz, dy, dx = np.broadcast_to(sides, 3).tolist()
    deep, high = (2 * math.ceil(tube.basal_radius / side) for side in (dz, dy))
    across = [(np.arange(count) + 0.5 - count / 2) * side for count, side in ((deep, dz), (high, dy))]
    radius = np.hypot(across[0][:, None, None], across[1][None, :, None])
    axial = (np.arange(math.ceil(tube.length / dx)) + 0.5) * dx
    mask = (radius >= tube.apical_radius) & (radius <= tube.basal_radius) & (axial <= tube.length)
    if not mask.any():
        raise ValueError(f"spacing={spacing} is too large: no voxel center lies in the tissue; give a smaller spacing")
    return mask


def _corner(mask: Bool[np.ndarray, "z y x"]) -> Float[np.ndarray, "3"]:
    """Center of voxel (0, 0, 0) in units of the spacing, as (z, y, x)."""
    return np.array([0.5 - mask.shape[0] / 2, 0.5 - mask.shape[1] / 2, 0.5])
