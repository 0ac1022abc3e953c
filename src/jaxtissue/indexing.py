"""Rows of tables by their numbers.

None counts from the end, as those of `table[numbers]` may: that takes half as long again.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

PUT: dict[str, Any] = {"mode": "drop", "wrap_negative_indices": False}  # `table.at[numbers].set(rows, **PUT)`


def taken(table: Array | np.ndarray, numbers: Int[Array, "..."]) -> Array:
    """The rows of the given numbers; of those beyond the table the first or last."""
    return jnp.asarray(table).at[numbers].get(mode="clip", wrap_negative_indices=False)
