"""Vectors as tuples of their components, each an array of any shape.

The CPU compiler makes one fast loop of what is written by components, and slow ones of arrays with an axis of three.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array

Vector = tuple[Array, ...]


def each(function: Callable[..., Array], *vectors: Vector) -> Vector:
    """A function of each component."""
    return tuple(function(*parts) for parts in zip(*vectors, strict=True))


def add(a: Vector, b: Vector) -> Vector:
    """The sum a + b."""
    return each(lambda x, y: x + y, a, b)


def subtract(a: Vector, b: Vector) -> Vector:
    """The difference a - b."""
    return each(lambda x, y: x - y, a, b)


def scale(factor: Array | float, a: Vector) -> Vector:
    """A vector times a number."""
    return tuple(factor * x for x in a)


def dot(a: Vector, b: Vector) -> Array:
    """The product a . b."""
    first, *rest = (x * y for x, y in zip(a, b, strict=True))
    for part in rest:
        first = first + part
    return first


def cross(a: Vector, b: Vector) -> Vector:
    """The product a x b in space."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def area(a: Vector, b: Vector) -> Array:
    """The product a x b in the plane, a number."""
    return a[0] * b[1] - a[1] * b[0]


def turned(a: Vector) -> Vector:
    """A vector of the plane turned by a right angle, counterclockwise."""
    return (-a[1], a[0])


def components(table: Array) -> Vector:
    """The components of vectors along the last axis of a table."""
    return tuple(table[..., k] for k in range(table.shape[-1]))


def rows(vector: Vector) -> Array:
    """The table of which `components` gives the vector, its components along a last axis."""
    return jnp.stack(vector, axis=-1)
