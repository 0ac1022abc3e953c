"""Tilted and bent backbones: polylines through nodes F(m_k, h_k), of which the first is apical and the last basal.

Positions of straight backbones are [n, d], one point m of the base surface each. With an axis more, [n, k, d], they
are those of k nodes at equally spaced heights, and with a coordinate more, [n, k, d + 1], the last is its height.
So one array holds any backbones, and goes through `jit`, `vmap` and files as that of straight ones does.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.geometry.base_surfaces import Rectangle, UnitSphere
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.shapes import RoundTube
from jaxtissue.geometry.tube import Tube
from jaxtissue.geometry.vectors import Vector, add, cross, dot, scale, subtract

ENDS = ("apical", "basal")  # what tilted backbones have before the names of coordinates
FLAT = 1e-3  # the sine of the angle of a backbone and a layer below which it is not followed to where they meet


class Nodes(NamedTuple):
    """The nodes of backbones, [..., k]: points of the base surface, each nearest to the one before, and heights."""

    place: Vector
    height: Array


def has_nodes(positions: Any) -> bool:
    """Whether positions are those of nodes, by the number of their axes."""
    try:
        return np.ndim(positions) == 3
    except ValueError:  # rows of several lengths
        return False


def domain_of(domain: Tube | Domain, positions: Any) -> Tube | Domain:
    """The domain on which backbones stand: for nodes, a tube is one like any other."""
    return as_domain(domain) if has_nodes(positions) else domain


def as_domain(domain: Tube | Domain) -> Domain:
    """The domain, a tube as one like any other."""
    if isinstance(domain, Tube):
        return RoundTube(domain.length, domain.apical_radius, domain.basal_radius)
    return domain


def heights_of(positions: np.ndarray, domain: Domain) -> Float[np.ndarray, "n k"]:
    """The heights of nodes, as given or equally spaced."""
    n, k, size = positions.shape
    if size > len(domain.columns):
        return positions[..., -1]
    return np.broadcast_to(np.linspace(0, 1, k), (n, k))


def bends_of(
    positions: Float[Array | np.ndarray, "n *k d"], domain: Domain
) -> Float[Array | np.ndarray, " k-2"] | None:
    """The heights at which backbones bend, in the mean over the backbones; none of straight and tilted ones."""
    if positions.ndim == 2 or positions.shape[1] == 2:
        return None
    if positions.shape[-1] == len(domain.columns):
        return np.linspace(0, 1, positions.shape[1])[1:-1]
    heights = positions[:, 1:-1, -1]
    return jax.lax.stop_gradient(heights.mean(axis=0)) if isinstance(heights, jax.Array) else heights.mean(axis=0)


def as_nodes(positions: Float[Array, "n k d"], domain: Domain) -> Nodes:
    """The nodes of positions, those beyond a seam or a period put beside the node before."""
    size = len(domain.columns)
    place = tuple(positions[..., axis] for axis in range(size))
    if positions.shape[-1] > size:
        height = positions[..., -1]
    else:
        steps = jnp.linspace(0, 1, positions.shape[1], dtype=positions.dtype)
        height = jnp.broadcast_to(steps, place[0].shape)
    return Nodes(unrolled(domain.base, place), height)


def unrolled(base: Rectangle | UnitSphere, place: Vector) -> Vector:
    """The places of nodes [n, k], each put nearest to the one before."""
    if not isinstance(base, Rectangle):
        return place
    parts = []
    for part, extent, direction in zip(place, base.extent, base.directions, strict=True):
        if direction != "free":
            turns = jnp.cumsum(jnp.round(jnp.diff(part) / extent), axis=1)
            part = part - extent * jnp.concatenate([jnp.zeros_like(part[:, :1]), turns], axis=1)
        parts.append(part)
    return tuple(parts)


def with_copies(nodes: Nodes, domain: Domain) -> Nodes:
    """The nodes of all backbones and then those of their copies beyond periodic directions, [copies n, k]."""
    copies, (_, k) = domain.base.images(), nodes.height.shape
    if not isinstance(domain.base, Rectangle) or len(copies) == 1:
        return nodes
    place = tuple(
        (part + copies[:, axis, None, None] * jnp.asarray(extent)).reshape(-1, k).astype(part.dtype)
        for axis, (part, extent) in enumerate(zip(nodes.place, domain.base.extent, strict=True))
    )
    return Nodes(place, jnp.tile(nodes.height, (len(copies), 1)))


def node_points(nodes: Nodes, domain: Domain) -> Vector:
    """The nodes in space."""
    apical, basal = domain.surfaces(nodes.place)
    return add(scale(1 - nodes.height, apical), scale(nodes.height, basal))


def on_layers(nodes: Nodes, domain: Domain, heights: Float[Array, " layers"]) -> Vector:
    """Where backbones cross layers: points of the base surface, [layers, n].

    On the way from node to node in the base surface, and from there by a step of Newton's method to where the straight
    line between them meets the layer.
    """
    level = jnp.broadcast_to(heights[:, None], (heights.shape[0], nodes.height.shape[0]))
    first = (nodes.height[:, 1:-1] <= level[..., None]).sum(axis=-1)
    cell = jnp.arange(nodes.height.shape[0])
    ends = [
        jax.tree.map(lambda table, at=at: table[cell, first + at],
                     (nodes.place, nodes.height, node_points(nodes, domain)))
        for at in (0, 1)
    ]  # fmt: skip
    (place, low, start), (other, high, end) = ends
    share = jnp.clip((level - low) / (high - low), 0, 1)
    guess = domain.base.chart(place, scale(share, domain.base.difference(place, other)))
    frame = domain.frame(guess, (jnp.zeros_like(level),) * 2, level)
    along = subtract(end, start)
    miss = subtract(add(start, scale(share, along)), frame.point)
    across = cross(frame.first, frame.second)
    steep = dot(across, along)
    crosses = jnp.abs(steep) > FLAT * jnp.sqrt(dot(across, across) * dot(along, along))
    back = dot(across, miss) / jnp.where(crosses, steep, 1)
    miss = subtract(miss, scale(back, along))  # now within the layer's tangent plane
    square = jnp.where(crosses, dot(across, across), jnp.inf)
    step = (dot(cross(miss, frame.second), across) / square, dot(cross(frame.first, miss), across) / square)
    return domain.base.chart(guess, step)


def ends_on(positions: np.ndarray, surface: str, domain: Tube | Domain) -> Float[np.ndarray, "n d"]:
    """The points of the base surface where backbones end on the `apical` or `basal` surface."""
    if positions.ndim == 2 or isinstance(domain, Tube):
        return positions
    return positions[:, -1 if surface == "basal" else 0, : len(domain.columns)]
