"""Types of what public functions accept in place of arrays: lists, data frames and tables of columns."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np


@runtime_checkable
class SupportsArray(Protocol):
    """Objects that NumPy converts to an array: arrays of NumPy and JAX, also traced ones, and data frames."""

    def __array__(self) -> np.ndarray:
        """Return the array."""
        raise NotImplementedError


# `numpy.typing.ArrayLike` accepts the same, but `help` prints its parts over several lines
ArrayLike = SupportsArray | Sequence[Any] | float
PositionsLike = SupportsArray | Sequence[Any] | Mapping[str, Any]
