"""Nearest backbones of points by exhaustive search, label images, and volumes from labels.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, UInt16

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.diagram.point_location import label_points
from jaxtissue.diagram.voxels import image_box, image_mask
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.backbones import Backbones
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube

_UNROLL = 8  # backbones tried per turn of the innermost loop: one per turn takes 4 times as long on a CPU


@usual_modes()
@partial(jax.jit, static_argnames=("count", "block"))
def nearest_backbones(
    points: Float[Array, "p 3"], backbones: Backbones, count: int = 1, block: int = 16384
) -> tuple[Int[Array, "p {count}"], Float[Array, "p {count}"]]:
    """Find the nearest backbones of each point, and their distances, by exhaustive search (paper, section 2.1).

    To find only the cell of each point, `label_points` is faster for many points. The distance is the exact Euclidean
    distance to the segment, also across the lumen. Ties go to the lower index. Points are processed in blocks, so
    memory does not grow with points x backbones; time grows with points x backbones x `count`. Jittable; `count` and
    `block` are static.

    Args:
        points: Cartesian coordinates, in length units, shape [p, 3].
        backbones: Backbones, from `Tube.embed`.
        count: Number of backbones to find for each point, 1 to the number of backbones. Defaults to 1.
        block: Number of points per block. Defaults to 16384.

    Returns:
        Indices of the nearest backbones, nearest first, shape [p, count], and their distances, shape [p, count].

    Raises:
        ValueError: If `count` is less than 1 or greater than the number of backbones.

    >>> tube = Tube(length=10, apical_radius=1, basal_radius=2)
    >>> backbones = tube.embed(jnp.array([[2.0, 0.0], [5.0, 0.0], [9.0, 0.0]]))
    >>> labels, distances = nearest_backbones(jnp.array([[6.0, 1.5, 0.0]]), backbones, count=2)
    >>> labels.tolist(), distances.tolist()
    ([[1, 2]], [[1.0, 3.0]])
    """
    cells = backbones.apical.shape[0]
    if not 1 <= count <= cells:
        raise ValueError(f"count={count} is not between 1 and the number of backbones, {cells}; change count")
    total = points.shape[0]
    block = max(1, min(block, total))
    blocks = -(-total // block)
    padded = jnp.pad(points, ((0, blocks * block - total), (0, 0)))
    coordinates = padded.reshape(blocks, block, 3).transpose(0, 2, 1)
    labels, squares = lax.map(partial(_search, backbones=backbones, count=count), coordinates)
    flat = [found.transpose(0, 2, 1).reshape(-1, count)[:total] for found in (labels, squares)]
    return flat[0], jnp.sqrt(flat[1])


@usual_modes()
def label_volumes(
    labels: Int[Array | np.ndarray, "p"], weights: Float[Array | np.ndarray, "p"], count_cells: int
) -> Float[Array, "{count_cells}"]:
    """Estimate the volume of each cell from labeled samples: V_i = sum of the weights of the samples with label i.

    With `cylindrical_voxels` and `label_points` this measures cells by counting voxels, less accurately than
    `measure_tissue`.

    Args:
        labels: Index of the cell that contains each sample, shape [p].
        weights: Volume that each sample represents, shape [p].
        count_cells: Number of cells, a Python integer (static under `jax.jit`).

    Returns:
        Volume of each cell, in the unit of `weights`, shape [count_cells].

    >>> label_volumes(jnp.array([0, 2, 0]), jnp.array([1.0, 2.0, 3.0]), 3).tolist()
    [4.0, 0.0, 2.0]
    """
    # In 64 parts: one long sum in float32 would lose 6e-4 at 100,000 samples a cell.
    part = jnp.arange(labels.shape[0]) % 64
    return jnp.zeros((64, count_cells), weights.dtype).at[part, labels].add(weights).sum(axis=0)


@usual_modes()
def label_image(
    positions: PositionsLike, domain: Tube | Domain, spacing: float | Sequence[float]
) -> UInt16[np.ndarray, "z y x"]:
    """Render a tissue as a 3D label image with axes (z, y, x): 0 outside the tissue, cell index + 1 inside.

    Each voxel has the label of the cell that contains its center (paper, section 2.1). The faces of voxels lie at
    multiples of their sides, and the image is the smallest that contains the tissue: with its least z, y and x, voxel
    [k, j, i] has its center at x = (floor(x_min / dx) + i + 1/2) dx, and likewise y and z. The image of a tube starts
    at its end x = 0 and is centered on its axis. In periodic directions the image shows one period, with the cells
    that reach into it from the next.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3];
            of tilted and bent backbones those of their nodes, shape [n, k, d].
        domain: The tube or other domain.
        spacing: Side of a cubic voxel, or the three sides (dz, dy, dx), in length units.

    Returns:
        Image of unsigned 16-bit integers, shape [z, y, x].

    Raises:
        ValueError: If there are more than 65,535 cells, if a position is not finite, lies outside the domain or
            coincides with another, or if `spacing` is not positive or so large that no voxel center lies in the tissue.

    >>> label_image(jnp.array([[1.0, 0.0], [3.0, 0.0]]), Tube(4, 0.5, 2), 1.0)[2, 2].tolist()
    [1, 1, 2, 2]
    """
    positions = as_positions_on(positions, domain, np.float64, sizes=False, bent=True)
    cells = positions.shape[0]
    if cells >= 2**16:
        raise ValueError(f"{cells} cells are too many for 16-bit labels; use at most {2**16 - 1} cells")
    box, mask = image_box(domain, spacing), image_mask(domain, spacing)
    image = np.zeros(mask.shape, np.uint16)
    for some, points in box.planes():
        inside = mask[some]
        image[some][inside] = label_points(points[inside.ravel()], positions, domain) + 1
    return image


def _search(
    points: Float[Array, "3 block"], backbones: Backbones, count: int
) -> tuple[Int[Array, "{count} block"], Float[Array, "{count} block"]]:
    """Labels and squared distances of the `count` nearest: one pass over all backbones per rank.

    A pass looks for the nearest one that comes after the last one found, in the order (distance, index).
    Counted per pair, that is faster than keeping a sorted list, and than `argmin` or `top_k` of a table.
    """
    start, along = backbones.apical, backbones.basal - backbones.apical
    length2 = jnp.sum(along**2, axis=1, keepdims=True)
    share = along / jnp.where(length2 > 0, length2, 1)
    last = start.shape[0] - 1

    def scan_all(found, _):
        def visit(turn, best):
            for step in range(_UNROLL):
                # Beyond the end the last backbone is tried again: it is never nearer than itself.
                cell = jnp.minimum(turn * _UNROLL + step, last)
                square = _squared_distance(points, start[cell], along[cell], share[cell])
                after = (square > found[1]) | ((square == found[1]) & (cell > found[0]))
                nearer = after & (square < best[1])
                best = jnp.where(nearer, cell, best[0]), jnp.where(nearer, square, best[1])
            return best

        nothing = jnp.full_like(found[0], -1), jnp.full_like(found[1], jnp.inf)
        best = lax.fori_loop(0, last // _UNROLL + 1, visit, nothing)
        return best, best

    size = points.shape[1]
    nothing = jnp.full(size, -1, jnp.int32), jnp.full(size, -jnp.inf, jnp.result_type(points, start))
    return lax.scan(scan_all, nothing, length=count)[1]


def _squared_distance(
    points: Float[Array, "3 block"],
    start: Float[Array, "3"],
    along: Float[Array, "3"],
    share: Float[Array, "3"],
) -> Float[Array, "block"]:
    """`distance_to_segment` squared, laid out by hand: lifted by vmap it takes 4 times as long on a CPU."""
    x, y, z = points[0] - start[0], points[1] - start[1], points[2] - start[2]
    foot = jnp.clip(x * share[0] + y * share[1] + z * share[2], 0, 1)
    x, y, z = x - foot * along[0], y - foot * along[1], z - foot * along[2]
    return x * x + y * y + z * z
