"""Backbones: one straight segment per cell, from the apical to the basal surface.

Definition 2 is that of Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via
Backbone Spreads", GRAPP 2025 ("the paper").
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.compilation.modes import usual_modes

Point = Float[Array | np.ndarray, "3"]


class Backbones(eqx.Module):
    """End points of the backbones of a tissue in Cartesian coordinates (paper, Definition 2).

    Attributes:
        apical: End points on the apical surface, in length units, shape [n, 3].
        basal: End points on the basal surface, in length units, shape [n, 3].
    """

    apical: Float[Array, "n 3"]
    basal: Float[Array, "n 3"]


@usual_modes()
def distance_to_segment(point: Point, start: Point, end: Point) -> Float[Array, ""]:
    """The distance from a point to a segment, min over 0 <= u <= 1 of |point - start - u (end - start)|.

    A segment of length zero is a point. Lift the function with `jax.vmap` for many points or segments.

    >>> import jax.numpy as jnp
    >>> start, end = jnp.array([0.0, 0.0, 0.0]), jnp.array([2.0, 0.0, 0.0])
    >>> float(distance_to_segment(jnp.array([1.0, 3.0, 0.0]), start, end))
    3.0
    >>> float(distance_to_segment(jnp.array([5.0, 4.0, 0.0]), start, end))
    5.0
    """
    along = end - start
    share = jnp.clip(_ratio(jnp.dot(point - start, along), jnp.dot(along, along)), 0, 1)
    return jnp.linalg.norm(point - start - share * along)


@usual_modes()
def distance_between_segments(start_a: Point, end_a: Point, start_b: Point, end_b: Point) -> Float[Array, ""]:
    """The smallest distance between two segments, also where they are parallel, cross or are single points.

    It is found between an end of one segment and the other segment, or between the feet of the common perpendicular of
    the two lines where both feet lie inside. Every candidate joins points of the segments, so none is too small.

    >>> import jax.numpy as jnp
    >>> a = jnp.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> b = jnp.array([[0.0, -1.0, 2.0], [0.0, 1.0, 2.0]])
    >>> float(distance_between_segments(*a, *b))
    2.0
    """
    along_a, along_b, offset = end_a - start_a, end_b - start_b, start_b - start_a
    normal = jnp.cross(along_a, along_b)
    scale = jnp.dot(normal, normal)
    share_a = jnp.clip(_ratio(jnp.dot(jnp.cross(offset, along_b), normal), scale), 0, 1)
    share_b = jnp.clip(_ratio(jnp.dot(jnp.cross(offset, along_a), normal), scale), 0, 1)
    candidates = jnp.stack(
        [
            jnp.linalg.norm(offset + share_b * along_b - share_a * along_a),
            distance_to_segment(start_a, start_b, end_b),
            distance_to_segment(end_a, start_b, end_b),
            distance_to_segment(start_b, start_a, end_a),
            distance_to_segment(end_b, start_a, end_a),
        ]
    )
    return jnp.min(candidates)


def _ratio(numerator: Float[Array, ""], denominator: Float[Array, ""]) -> Float[Array, ""]:
    """The quotient, or 0 for a denominator of 0."""
    nonzero = denominator > 0
    return jnp.where(nonzero, numerator, 0) / jnp.where(nonzero, denominator, 1)
