"""How to write what XLA's CPU compiler then compiles well, as measured.

Numbers of rows are taken as they are. None counts from the end, as those of `table[numbers]` may: to look for
these takes half as long again.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

T = TypeVar("T")
SCATTER: dict[str, Any] = {
    "mode": "drop",
    "wrap_negative_indices": False,
}  # `table.at[numbers].set(rows, **SCATTER)`


def take_rows(table: Array | np.ndarray, numbers: Int[Array, "..."]) -> Array:
    """The rows of the given numbers; of those beyond the table the first or last."""
    return jnp.asarray(table).at[numbers].get(mode="clip", wrap_negative_indices=False)


def fusion_barrier(compute: Callable[[], T], truth: Array) -> T:
    """Compute, behind a branch that is always taken, which XLA's fusion can't cross.

    Else the CPU compiler repeats a stage inside every consumer of the next: 2.5 times slower as measured.
    `truth` is true, but not known to the compiler; or it is any array of numbers above -1e38, of which that is asked.
    What is measured to the same bits alone and with more must share one `truth`.
    """
    if truth.dtype != bool or truth.ndim:
        truth = truth[(0,) * truth.ndim].astype(float) > -1e38
    truth = jax.lax.optimization_barrier(truth)  # of a constant the compiler would know it
    compute = jax.jit(compute, inline=True)  # traced once
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(compute))
    return jax.lax.cond(truth, compute, lambda: empty)


def options(light: bool = False) -> dict[str, str | bool]:
    """Options for a CPU's compiler: the widest vectors that the processor has; if `light`, less optimized.

    Vectors of 512 bits instead of XLA's 256 save a quarter of a sweep where there are some, and change
    nothing elsewhere. What runs seldom, as what is seen and checked of a tissue, is compiled in half of the
    time if `light`, and takes up to 4 % longer; sweeps would take a fifth longer.

    An option that this jaxlib does not have is left out: 0.11.1 dropped one, and refuses to compile with it.
    """
    if jax.default_backend() != "cpu":
        return {}
    wanted: dict[str, str | bool] = {"xla_cpu_prefer_vector_width": "512"}
    if light:
        wanted |= {"xla_backend_optimization_level": "1", "xla_cpu_use_fusion_emitters": False}
    return {name: value for name, value in wanted.items() if is_option(name, value)}


@functools.cache
def is_option(name: str, value: str | bool) -> bool:
    """Whether the compiler takes an option, as it says when it compiles next to nothing with it."""
    nothing = jax.jit(lambda: 0.0).lower()
    try:
        nothing.compile({name: value})
    except RuntimeError as error:
        if "No such compile option" not in str(error):
            raise
        return False
    return True


def larger(first: Array, second: Array | float) -> Array:
    """The larger of two, in one instruction: `jnp.maximum` takes more to treat what is not a number."""
    return jnp.where(first > second, first, second)


def smaller(first: Array, second: Array | float) -> Array:
    """The smaller of two, as `larger`."""
    return jnp.where(first < second, first, second)


def arctan(tangent: Array) -> Array:
    """The angle, right to the last digits of float32: by its series, on an eighth of it.

    Not `jnp.arctan`, which jaxlib 0.10.2 gets wrong on CPUs by up to 1, where vectors are 512 bits wide
    (jax issue 39352).
    """
    for _ in range(3):
        tangent = tangent / (1 + jnp.sqrt(1 + tangent**2))
    square = tangent**2
    series = 1 - square * (1 / 3 - square * (1 / 5 - square * (1 / 7 - square * (1 / 9 - square / 11))))
    return 8 * tangent * series
