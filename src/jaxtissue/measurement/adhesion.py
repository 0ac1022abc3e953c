"""Differential adhesion: weights of walls that depend on the types of the two adjacent cells."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import take_rows


def _as_array(given: Any) -> Any:
    """Lists as arrays; arrays, traced ones and other leaves as they are."""
    return np.asarray(given) if isinstance(given, list | tuple) else given


class Adhesion(eqx.Module):
    """Differential adhesion: the tension of a wall depends on the types of the two cells that share it.

    Pass an `Adhesion` to `tube_model`. The wall between cells i and j then contributes its area times
    `weights[types[i], types[j]]` to the lateral areas A_i and A_j that enter the energy. If walls between unlike types
    have larger weights than walls between like types, cells sort by type.

    Attributes:
        types: Type of each cell, integers 0 to k - 1, shape [n].
        weights: Dimensionless weight of walls between each pair of types, a symmetric matrix of finite numbers, shape
            [k, k]. A weight of 1 leaves the area unchanged.
    """

    types: Int[Array | np.ndarray, "n"] = eqx.field(converter=_as_array)
    weights: Float[Array | np.ndarray, "k k"] = eqx.field(converter=_as_array)

    def between(self, cells: Int[Array, "cells"], others: Int[Array, "..."]) -> Float[Array, "..."]:
        """Return the weight of the wall between cells and other cells.

        Args:
            cells: Indices of cells, shape [cells].
            others: Indices of the cells on the other side of the walls, of any shape that broadcasts with `cells`.

        Returns:
            Weights, of the broadcast shape.
        """
        types = jnp.asarray(self.types, jnp.int32)  # products of small types leave their range
        count = self.weights.shape[0]
        pair = take_rows(types, cells) * count + take_rows(types, others)
        return take_rows(jnp.asarray(self.weights).ravel(), pair)


def check_adhesion(adhesion: Adhesion | None, cells: int) -> None:
    """Raise `ValueError` for types that are not one whole number for each cell, or weights that are no weights."""
    if adhesion is None or isinstance(adhesion.types, Tracer) or isinstance(adhesion.weights, Tracer):
        return
    types, weights = np.asarray(adhesion.types), np.asarray(adhesion.weights)
    if types.shape != (cells,) or types.dtype.kind not in "iu":
        raise ValueError(
            f"types are {types.dtype} of shape {types.shape}; give one whole number for each of the {cells} cells"
        )
    if weights.ndim != 2 or weights.shape[0] != weights.shape[1] or not np.isfinite(weights).all():
        raise ValueError(
            f"weights have shape {weights.shape}; give one finite number for each pair of types, shape [k, k]"
        )
    if not np.array_equal(weights, weights.T):
        raise ValueError("weights are not symmetric; give weights[a, b] = weights[b, a] for all types a and b")
    if not (types.min(initial=0) >= 0 and types.max(initial=0) < len(weights)):
        told = f"types range from {types.min()} to {types.max()}, but weights have {len(weights)} rows"
        raise ValueError(f"{told}; give types from 0 to {len(weights) - 1}, or one row per type")
