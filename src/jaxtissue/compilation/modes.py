"""The settings of JAX that affect results, fixed to the values for which this library is written."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib import import_module
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

# A session may have set these, by its environment or by `jax.config`, to look for faults in code of its own.
USUAL: dict[str, Any] = {
    "numpy_dtype_promotion": "standard",
    "numpy_rank_promotion": "allow",
    "transfer_guard_host_to_device": "allow",
    "transfer_guard_device_to_host": "allow",
    "transfer_guard_device_to_device": "allow",
    "debug_nans": False,  # what is not a number is computed beside, and left out
    "debug_infs": False,
    "disable_jit": False,
    "threefry_partitionable": True,  # another one draws other numbers
}


@contextmanager
def usual_modes() -> Iterator[None]:
    """Compute by JAX's usual settings within, whatever the session's are; also a decorator of functions.

    The precision is the session's.

    >>> with jax.numpy_rank_promotion("raise"), usual_modes():
    ...     print(jnp.ones((2, 2)) + jnp.ones(2))
    [[2. 2.]
     [2. 2.]]
    """
    with ExitStack() as stack:
        for name, value in USUAL.items():
            if getattr(jax.config, f"jax_{name}") not in (value, None):
                stack.enter_context(getattr(jax, name)(value))
        yield


def double_precision() -> AbstractContextManager[None]:
    """Compute in 64 bits within, whatever the session's precision is."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    return import_module("jax.experimental").enable_x64(True)  # as JAX 0.7 has it


def keep_usual_modes() -> None:
    """The same for all of a process, one that computes nothing but for this library."""
    for name, value in USUAL.items():
        jax.config.update(f"jax_{name}", value)


@usual_modes()
def random_key(seed: int) -> PRNGKeyArray:
    """The key that `jax.random.key(seed)` is as a rule, whatever generator and offset the session has set.

    >>> bool((random_key(7) == jax.random.key(7)).all())
    True
    """
    return jax.random.wrap_key_data(jnp.array([0, seed], jnp.uint32), impl="threefry2x32")
