"""How to write what XLA's CPU compiler then compiles well, as measured.

Numbers of rows are taken as they are. None counts from the end, as those of `table[numbers]` may: to look for
these takes half as long again.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

T = TypeVar("T")
PUT: dict[str, Any] = {"mode": "drop", "wrap_negative_indices": False}  # `table.at[numbers].set(rows, **PUT)`


def taken(table: Array | np.ndarray, numbers: Int[Array, "..."]) -> Array:
    """The rows of the given numbers; of those beyond the table the first or last."""
    return jnp.asarray(table).at[numbers].get(mode="clip", wrap_negative_indices=False)


def settled(compute: Callable[[], T], truth: Array) -> T:
    """Compute, behind a branch that is always taken, which XLA's fusion can't cross.

    Else the CPU compiler repeats a stage inside every consumer of the next: 2.5 times slower as measured.
    `truth` is true, but not known to the compiler.
    """
    compute = jax.jit(compute, inline=True)  # traced once
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(compute))
    return jax.lax.cond(truth, compute, lambda: empty)


def light_options() -> dict[str, str | bool]:
    """Options with which a CPU's compiler optimizes less, for what runs seldom.

    What is seen and checked of a tissue is compiled in half of the time and takes up to 4 % longer; sweeps
    would take a fifth longer.
    """
    light: dict[str, str | bool] = {
        "xla_backend_optimization_level": "1",
        "xla_cpu_use_fusion_emitters": False,
    }
    return light if jax.default_backend() == "cpu" else {}


def larger(first: Array, second: Array | float) -> Array:
    """The larger of two, in one instruction: `jnp.maximum` takes more to treat what is not a number."""
    return jnp.where(first > second, first, second)


def smaller(first: Array, second: Array | float) -> Array:
    """The smaller of two, as `larger`."""
    return jnp.where(first < second, first, second)
