"""How evenly the backbones are spread: separation, covering radius and what they bound (paper, Section 2)."""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from jaxtissue.inputs import as_positions
from jaxtissue.tube import Tube
from jaxtissue.voronoi import nearest_backbones

_REFINEMENTS = 5  # each makes the patches of the covering search three times smaller


def separation(positions: Float[ArrayLike, "n 2"], tube: Tube) -> Float[Array, ""]:
    """Smallest distance between two backbones, infinite for a single one (paper, Definition 1).

    Two radial segments are nearest at their apical ends, whatever the angle D between them:
    distance^2 = dx^2 + (2 R_a sin(D/2))^2. Each backbone is compared with the next, second next, ... along
    the axis, until that is too far along the axis alone; memory is O(n).

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


def covering_radius(
    positions: Float[ArrayLike, "n 2"], tube: Tube, shape: tuple[int, int] | None = None
) -> Float[Array, ""]:
    """Largest distance from a point of the tissue to its nearest backbone (paper, Definition 1).

    The distance to a radial backbone never falls on the way outwards, so the maximum is on the basal surface.
    There an (axial, angular) grid of patches is searched, then the patches with the largest values are
    split 3 x 3, five times over. The result is the value at a point of the tissue, so never too large.
    Distance changes by no more than the way gone, so it is too small by at most half the diagonal of the
    last patches, as long as the patch with the maximum was kept. Measured: at most 0.04 % too small.

    `shape` is the first grid, by default square patches, 32 per cell; give it where the tube is traced.
    Raises `ValueError` for a shape without patches.

    >>> round(float(covering_radius(jnp.array([[5.0, 0.0]]), Tube(10, 1, 2))), 2)
    5.83
    """
    positions = as_positions(positions, tube, sizes=False)
    if shape is None:
        shape = _square_patches(tube, max(4096, 32 * positions.shape[0]))
    if min(shape) < 1:
        raise ValueError(f"shape={shape} holds no patch; give (axial, angular) counts of at least 1")
    return _search_covering(positions, tube, shape)


def tightness(
    positions: Float[ArrayLike, "n 2"], tube: Tube, shape: tuple[int, int] | None = None
) -> Float[Array, ""]:
    """The phi of a tight phi-backbone spread, covering radius / separation (paper, Definition 1).

    It has no unit; 0 for a single backbone. `shape` as in `covering_radius`.
    """
    return covering_radius(positions, tube, shape) / separation(positions, tube)


def neighbor_bound(tightness: float, backbone_length: float) -> float:
    """Most neighbors a cell can have in any tissue, 8 (2 phi + 1/2)^3 + 6 (2 phi + 1/2)^2 l (paper, Lemma 1).

    `tightness` is phi; `backbone_length` is l in units of the separation.

    >>> neighbor_bound(1.0, 2.0)
    200.0
    """
    reach = 2 * tightness + 0.5
    return 8 * reach**3 + 6 * reach**2 * backbone_length


def tube_neighbor_bound(tightness: float, hops: int = 1) -> float:
    """Most cells within `hops` contacts of a cell of a tube, 4 (2 h phi + 1/2)^2.

    One hop bounds the neighbors (paper, Lemma 2); more hops keep its constant, where the paper gives the
    order O(phi^2 h^2) (Corollary 1). `tightness` is phi.

    >>> tube_neighbor_bound(1.0), tube_neighbor_bound(1.0, hops=2)
    (25.0, 81.0)
    """
    return 4 * (2 * hops * tightness + 0.5) ** 2


def _square_patches(tube: Tube, count: int) -> tuple[int, int]:
    """Counts along the axis and around that cut the basal surface into some `count` square patches."""
    length, around = float(tube.length), 2 * math.pi * float(tube.basal_radius)
    size = math.sqrt(length * around / count)
    return math.ceil(length / size), math.ceil(around / size)


@partial(jax.jit, static_argnames=("shape",))
def _search_covering(positions: Float[Array, "n 2"], tube: Tube, shape: tuple[int, int]) -> Float[Array, ""]:
    """The largest distance over the basal surface, by splitting the patches with the largest values."""
    backbones = tube.embed(positions)
    kept = min(shape[0] * shape[1], max(256, positions.shape[0]))

    def distances(patches):
        return nearest_backbones(tube.embed(patches).basal, backbones)[1][:, 0]

    def split(level, state):
        patches, best = state
        offsets = ninth * size / 3.0 ** (level + 1)
        parts = (patches[:, None] + offsets).reshape(-1, 2)
        values = distances(parts)
        return parts[lax.top_k(values, kept)[1]], jnp.maximum(best, jnp.max(values))

    dtype = positions.dtype
    size = jnp.stack([jnp.asarray(tube.length, dtype), jnp.asarray(2 * math.pi, dtype)]) / jnp.array(shape)
    ninth = jnp.stack(jnp.meshgrid(*2 * [jnp.arange(-1, 2, dtype=dtype)]), axis=-1).reshape(-1, 2)
    grid = jnp.stack(jnp.meshgrid(*map(jnp.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2)
    patches = ((grid + 0.5) * size).astype(dtype)
    values = distances(patches)
    start = patches[lax.top_k(values, kept)[1]], jnp.max(values)
    return lax.fori_loop(0, _REFINEMENTS, split, start)[1]
