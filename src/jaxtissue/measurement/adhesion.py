"""Differential adhesion: weights of walls by the types of the two cells that share them."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import take_rows


def _as_array(given: Any) -> Any:
    """Lists as arrays; arrays, traced ones and other leaves as they are."""
    return np.asarray(given) if isinstance(given, list | tuple) else given


class Adhesion(eqx.Module):
    """Differential adhesion: the weight of a wall depends on the types of the two cells that share it.

    In the energy, the wall between cells i and j contributes its area times `weights[types[i], types[j]]` to the
    lateral areas of both cells. With larger weights between unlike types, the types sort.

    Attributes:
        types: The type of each cell, 0 to k - 1, [n].
        weights: The weight of a wall between cells of two types, symmetric, [k, k].
    """

    types: Int[Array | np.ndarray, "n"] = eqx.field(converter=_as_array)
    weights: Float[Array | np.ndarray, "k k"] = eqx.field(converter=_as_array)

    def between(self, cells: Int[Array, "cells"], others: Int[Array, "..."]) -> Float[Array, "..."]:
        """The weight of the wall between each cell and each of the other cells, by their numbers."""
        types = jnp.asarray(self.types, jnp.int32)  # products of small types leave their range
        count = self.weights.shape[0]
        pair = take_rows(types, cells) * count + take_rows(types, others)
        return take_rows(jnp.asarray(self.weights).ravel(), pair)
