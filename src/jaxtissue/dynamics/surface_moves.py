"""Moves on the apical surface of any domain, with the Hastings ratio where the metric varies."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, dot
from jaxtissue.sections.views import metric_basis

RADIUS = 0.25  # of the disc, in radii of a disc as large as the mean apical area of a cell


def longest_move(domain: Domain, cells: int) -> float:
    """Longest move in the tangent plane, 0.25 sqrt(A / pi), with A the mean apical area per cell."""
    return RADIUS * float(np.sqrt(float(domain.apical_area) / (np.pi * cells)))


def propose_moves(
    draws: Float[Array, "2 n"], place: Vector, domain: Domain, longest: Float[Array, ""]
) -> tuple[Vector, Float[Array, "n"]]:
    """A move for every cell, uniform in a disc of the apical tangent plane, and the logarithm of its Hastings ratio.

    The step z of the disc becomes local coordinates y = B z, with B B^T the inverse of the metric at m, and the chart
    takes these to the new point m'. By apical area the density of m' is q(m -> m') = e(m, 0) / (pi r^2 e(m, y)), where
    e(m, y) is the area element at the local coordinates y round m. The way back has the local coordinates y' round m'.
    It exists if its step is in the disc of m', and

        q(m' -> m) / q(m -> m') = e(m', 0) e(m, y) / (e(m', y') e(m, 0)),

    with which acceptance is multiplied; a move without a way back is refused. At free ends moves are reflected, and
    the way back is that of the mirror image: detailed balance holds for each way by itself. Where the apical surface
    is flat, or a sphere, the ratio is 1.
    """
    share, turn = draws
    distance, direction = longest * jnp.sqrt(share), 2 * np.pi * turn
    z = (distance * jnp.cos(direction), distance * jnp.sin(direction))
    base, none = domain.base, (jnp.zeros_like(share),) * 2
    here = domain.frame(place, none, none[0])
    basis = metric_basis(here)
    y = (dot(basis[0], z), dot(basis[1], z))
    after, back = base.reflect(base.chart(place, y)), base.way_back(place, y)
    there = domain.frame(after, none, none[0])

    def element(m: Vector, other: Vector) -> Array:
        return domain.frame(m, base.difference(m, other), none[0]).elements()[1]

    ratio = there.elements()[1] * element(place, after) / (element(after, place) * here.elements()[1])
    step = tuple(back[0] * first + back[1] * second for first, second in zip(there.first, there.second, strict=True))
    has_way_back = dot(step, step) < (longest * (1 + 1e-5)) ** 2  # rounding shall not refuse the longest of a sphere
    return after, jnp.where(has_way_back, jnp.log(ratio), -jnp.inf)
