"""Integrals along the edges of sections, from their starts, middles and ends, and over the sections within."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, area, scale, subtract
from jaxtissue.sections.views import View

SIMPSON = (1 / 6, 4 / 6, 1 / 6)
# Rules for the integral of r f(r) from 0 to 1: nodes, weights, and the weight of r = 1; exact to the second degree, and
# Gauss-Radau, to the fourth
RAYS = {
    1: ((0.5,), (1 / 3,), 1 / 6),
    2: ((0.27639320225002106, 0.7236067977499789), (0.11509828350069877, 0.30156838316596796), 1 / 12),
}


def joined(*tables: Any) -> Any:
    """Tables put one after the other along the slots: what is done to them is compiled once."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *tables)


def parts(tables: Any, count: int) -> list[Any]:
    """What `joined` has joined."""
    return [jax.tree.map(lambda table, k=k: jnp.split(table, count)[k], tables) for k in range(count)]


def mean(size: Array) -> Array:
    """The mean over an edge, by Simpson's rule."""
    first, middle, last = parts(size, 3)
    return SIMPSON[0] * first + SIMPSON[1] * middle + SIMPSON[2] * last


def beyond(size: Array) -> Array:
    """What Simpson's rule may miss of a mean over an edge.

    Its difference from the trapezoidal rule is of the second order in the edge's length, and its own error of the
    fourth: so that is taken to be the square of the relative difference, of which it is a third for f = 1 / (1 + x^2).
    """
    first, _, last = parts(size, 3)
    whole = mean(size)
    return (whole - (first + last) / 2) ** 2 / jnp.maximum(jnp.abs(whole), 1e-30)


def fill(
    domain: Domain, view: View, curve: Vector, is_edge: Array, rim: tuple[Array, Array], rays: int
) -> tuple[Array, Array]:
    """The integrals of the volume and area elements over the sections, each a sum over cones from the backbone."""
    start, middle, end = parts(curve, 3)
    whole = area(start, end)
    swept = (4 * area(start, middle) - whole, area(middle, subtract(end, start)), 4 * area(middle, end) - whole)
    sweep = jnp.concatenate([jnp.where(is_edge, s * part, 0) for s, part in zip(SIMPSON, swept, strict=True)])
    nodes, weights, last = RAYS[rays]
    inner = joined(*(scale(node, curve) for node in nodes))
    factor = jnp.repeat(jnp.asarray(weights, sweep.dtype), sweep.shape[0]).reshape(-1, 1, 1)
    sizes = zip(view.frame(domain, inner).elements(), rim, strict=True)
    volume, level = (
        jnp.sum(sweep * last * outer, axis=0)
        + jnp.sum(jnp.concatenate([sweep] * len(nodes)) * factor * jnp.abs(element), axis=0)
        for element, outer in sizes
    )
    return volume, level
