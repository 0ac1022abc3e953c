"""Where backbones are during sweeps on any domain: at points of the base surface, or through nodes of several heights.

A move takes a straight backbone, or one node of a tilted or bent one, to another point of the base surface.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import take_rows
from jaxtissue.dynamics.surface_moves import propose_moves
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import Nodes, as_nodes, node_points, on_layers, unrolled
from jaxtissue.geometry.vectors import Vector, components, rows, subtract
from jaxtissue.sections.views import Backbones, Segments, through

Place = Vector | Nodes  # of arrays with an axis of backbones; those of nodes have one of these at the end


def as_place(positions: Float[Array, "n *k d"], domain: Domain) -> Place:
    """The places of positions."""
    return components(positions) if positions.ndim == 2 else as_nodes(positions, domain)


def as_rows(place: Place, domain: Domain) -> Float[Array, "n *k d"]:
    """The positions of places, within the domain; those of nodes with their heights."""
    if isinstance(place, Nodes):
        return rows((*domain.base.wrap(place.place), place.height))
    return rows(domain.base.wrap(place))


def at(place: Place, numbers: Array) -> Place:
    """The places of the given numbers."""
    return jax.tree.map(lambda part: take_rows(part, numbers), place)


def with_moved(place: Place, moved: Place, is_moved: Array) -> Place:
    """The places, other ones where these have moved."""

    def choose(old: Array, new: Array) -> Array:
        return jnp.where(is_moved.reshape(*is_moved.shape, *(old.ndim - is_moved.ndim) * [1]), new, old)

    return jax.tree.map(choose, place, moved)


def copied(domain: Domain, place: Place, copy: Int[Array, "..."]) -> Place:
    """The places of copies of backbones beyond periodic directions."""
    if isinstance(place, Nodes):
        return place._replace(place=copied(domain, place.place, copy[..., None]))
    shifts = domain.base.images()
    if not isinstance(domain.base, Rectangle) or len(shifts) == 1:
        return place
    pairs = zip(place, shifts.T, domain.base.extent, strict=True)
    return tuple(part + take_rows(jnp.asarray(shift, part.dtype), copy) * extent for part, shift, extent in pairs)


def segments(domain: Domain, place: Place) -> Backbones:
    """The backbones at places."""
    if isinstance(place, Nodes):
        return through(node_points(place, domain))
    apical, basal = domain.surfaces(place)
    return Segments(apical, subtract(basal, apical))


def centers(domain: Domain, place: Place, heights: Float[Array, " layers"]) -> Vector:
    """Where backbones cross layers: points of the base surface, [n], or [layers, n] of tilted and bent backbones."""
    return on_layers(place, domain, heights) if isinstance(place, Nodes) else place


def propose(
    draws: Float[Array, "rows n"], place: Place, domain: Domain, longest: Float[Array, ""]
) -> tuple[Place, Float[Array, "n"]]:
    """A move for every cell, and the logarithm of its Hastings ratio; of backbones with nodes, one that is drawn moves.

    Each is as likely, whatever the places are: so the ratio is that of a straight backbone at the node.
    """
    if not isinstance(place, Nodes):
        return propose_moves(draws[:2], place, domain, longest)
    count = place.height.shape[1]
    node = jnp.minimum((draws[3] * count).astype(jnp.int32), count - 1)[:, None]  # the product may be rounded up
    old = tuple(jnp.take_along_axis(part, node, axis=1)[:, 0] for part in place.place)
    new, log_ratio = propose_moves(draws[:2], old, domain, longest)
    is_moved = jnp.arange(count) == node
    moved = tuple(jnp.where(is_moved, to[:, None], part) for to, part in zip(new, place.place, strict=True))
    return place._replace(place=unrolled(domain.base, moved)), log_ratio
