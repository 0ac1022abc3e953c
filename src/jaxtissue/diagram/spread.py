"""Spread of the backbones: separation, covering radius, tightness, and the bounds on neighbors that follow from them.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025; definitions are those of its section 2.1.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.diagram.point_location import Lists, batches, hand_down, narrow, stand
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube


@usual_modes()
def separation(positions: PositionsLike, tube: Tube) -> Float[Array, ""]:
    """Compute the smallest distance between two backbones (paper, Definition 1).

    Radial segments at an angle D to each other are nearest at their apical ends: distance^2 = dx^2 + (2 R_a
    sin(D/2))^2. Jittable.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`. May be traced.
        tube: The tube.

    Returns:
        The distance, in length units, a scalar. Infinite if there is only one backbone.

    Raises:
        ValueError: If a position is not finite, lies outside the tube, or coincides with another.

    >>> round(float(separation(jnp.array([[0.0, 0.0], [3.0, 0.0], [4.0, jnp.pi]]), Tube(9, 1, 2))), 4)
    2.2361
    """
    return _separation(as_positions(positions, tube, sizes=False), tube)


@jax.jit
def _separation(positions: Float[Array, "n 2"], tube: Tube) -> Float[Array, ""]:
    count = positions.shape[0]
    axial, angle = positions[jnp.argsort(positions[:, 0])].T
    # The padding stands infinitely far along the axis: it is never nearest.
    padded_axial = jnp.concatenate([axial, jnp.full_like(axial, jnp.inf)])
    padded_angle = jnp.concatenate([angle, jnp.zeros_like(angle)])

    def unfinished(state):
        shift, best, gap = state
        return (shift < count) & (gap < best)

    def compare(state):
        shift, best, _ = state
        along = lax.dynamic_slice_in_dim(padded_axial, shift, count) - axial
        turn = lax.dynamic_slice_in_dim(padded_angle, shift, count) - angle
        apart = jnp.hypot(along, 2 * tube.apical_radius * jnp.sin(turn / 2))
        return shift + 1, jnp.minimum(best, jnp.min(apart)), jnp.min(along)

    start = 1, jnp.asarray(jnp.inf, positions.dtype), jnp.zeros((), positions.dtype)
    return lax.while_loop(unfinished, compare, start)[1]


@usual_modes()
def covering_radius(positions: PositionsLike, tube: Tube, tolerance: float = 4e-4) -> Float[np.ndarray, ""]:
    """Compute the largest distance from a point of the tissue to its nearest backbone (paper, Definition 1).

    The maximum lies on the basal surface, as the distance to a radial backbone does not decrease outward. It is found
    by branch and bound: patches of the basal surface that may contain a larger distance are subdivided. Not jittable.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        tube: The tube.
        tolerance: Largest acceptable relative error, greater than 0. Defaults to 4e-4.

    Returns:
        The distance, in length units, a scalar. It is a lower bound of the true value, too small by at most the
        relative error `tolerance`.

    Raises:
        ValueError: If `tolerance` is not positive, or if a position is not finite, lies outside the tube or coincides
            with another.

    >>> round(float(covering_radius(jnp.array([[5.0, 0.0]]), Tube(10, 1, 2))), 2)
    5.83
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance={tolerance} is not positive; give the maximum relative error, such as 4e-4")
    cells = stand(positions, tube)
    everyone = Lists(np.arange(len(cells.axial)), np.array([len(cells.axial)]))
    half = np.array([[float(tube.length) / 2], [math.pi * cells.outer]])  # along the axis, and around
    found, left = 0.0, [(half, half, everyone)]
    while left:
        patches, half, lists = left.pop(0)
        axial, angle = patches[0], patches[1] / cells.outer
        center = np.stack([axial, cells.outer * np.cos(angle), cells.outer * np.sin(angle)])
        radius = np.full(len(axial), float(np.linalg.norm(half)) * (1 + 1e-9))  # for rounding
        lists, distance = narrow(center, radius, lists, cells)
        found = max(found, float(distance.max()))
        larger = distance + radius > found * (1 + tolerance)
        half, offset = _halved(half)
        parts = (patches[:, larger, None] + offset[:, None]).reshape(2, -1)
        parent = np.repeat(np.flatnonzero(larger), offset.shape[1])
        left += [(parts[:, some], half, own) for some, own in batches(hand_down(lists, parent))]
    return np.asarray(found, jnp.result_type(float))


@usual_modes()
def tightness(positions: PositionsLike, tube: Tube) -> np.floating | Float[np.ndarray, ""]:
    """Compute the tightness phi = covering radius / separation of a backbone spread (paper, Definition 1).

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        tube: The tube.

    Returns:
        phi, dimensionless, a scalar. 0 if there is only one backbone.

    Raises:
        ValueError: If a position is not finite, lies outside the tube, or coincides with another.

    >>> round(float(tightness(jnp.array([[5.0, 0.0], [5.0, jnp.pi]]), Tube(10, 1, 2))), 2)
    2.74
    """
    return covering_radius(positions, tube) / np.asarray(separation(positions, tube))


def neighbor_bound(tightness: float, backbone_length: float) -> float:
    """Compute the bound of Lemma 1 on the number of neighbors, 8 (2 phi + 1/2)^3 + 6 (2 phi + 1/2)^2 l (paper).

    Args:
        tightness: phi, dimensionless.
        backbone_length: l, length of the backbones in units of the separation.

    Returns:
        The bound.

    >>> neighbor_bound(1.0, 2.0)
    200.0
    """
    reach = 2 * tightness + 0.5
    return 8 * reach**3 + 6 * reach**2 * backbone_length


def tube_neighbor_bound(tightness: float, hops: int = 1) -> float:
    """Compute the bound on the number of cells within `hops` contacts of a cell in a tube, 4 (2 h phi + 1/2)^2.

    With one hop this is the bound of Lemma 2 on the number of neighbors. For more hops the constant of Lemma 2 is used,
    as Corollary 1 gives only the order O(phi^2 h^2) (paper).

    Args:
        tightness: phi, dimensionless.
        hops: Number of contacts h. Defaults to 1.

    Returns:
        The bound.

    >>> tube_neighbor_bound(1.0), tube_neighbor_bound(1.0, hops=2)
    (25.0, 81.0)
    """
    return 4 * (2 * hops * tightness + 0.5) ** 2


def _halved(
    half: Float[np.ndarray, "2 1"],
) -> tuple[Float[np.ndarray, "2 1"], Float[np.ndarray, "2 parts"]]:
    """A patch cut in two where it is long: half the sides of its parts, and their centers relative to its center."""
    smaller = np.where(2 * half > half.max(), half / 2, half)
    steps = [np.unique([small - large, large - small]) for small, large in zip(smaller[:, 0], half[:, 0], strict=True)]
    return smaller, np.stack(np.meshgrid(*steps, indexing="ij")).reshape(2, -1)
