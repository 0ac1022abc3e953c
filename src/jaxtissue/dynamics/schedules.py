"""Temperatures of the sweeps, and when to stop."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def constant_schedule(temperature: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """The same temperature at every sweep."""
    return np.full(sweeps, float(temperature))


def geometric_schedule(first: float, last: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """Temperatures from `first` to `last` by a constant factor; `ValueError` unless both are positive."""
    if not (first > 0 and last > 0):
        raise ValueError(f"temperatures {first} and {last}: a geometric schedule needs both above 0")
    return np.geomspace(first, last, sweeps) if sweeps > 1 else np.full(sweeps, float(first))


def has_stalled(energies: Sequence[float], patience: int) -> bool:
    """Whether the last `patience` energies hold no new minimum; never for a patience of 0."""
    return bool(0 < patience < len(energies) and min(energies[-patience:]) >= min(energies[:-patience]))
