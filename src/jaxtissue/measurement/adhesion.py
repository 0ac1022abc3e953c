"""Differential adhesion: how walls count by the types of the two cells that they part."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import take_rows


class Adhesion(eqx.Module):
    """How walls count by the types of the two cells that they part: lateral areas are sums of weighted walls.

    Attributes:
        types: The type of each cell, 0 to k - 1, [n].
        weights: The weight of a wall between two types, symmetric, [k, k].
    """

    types: Int[Array | np.ndarray, "n"]
    weights: Float[Array | np.ndarray, "k k"]

    def between(self, cells: Int[Array, "cells"], others: Int[Array, "..."]) -> Float[Array, "..."]:
        """The weight of the walls between cells and others."""
        types = jnp.asarray(self.types)
        count = self.weights.shape[0]
        pair = take_rows(types, cells) * count + take_rows(types, others)
        return take_rows(jnp.asarray(self.weights).ravel(), pair)
