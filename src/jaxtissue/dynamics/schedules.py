"""Temperatures of the sweeps, and the end of a run that has stalled."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def constant_schedule(temperature: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """The same temperature for every sweep (paper, section 4.3: T = 2).

    Args:
        temperature: T, in the unit of the energy.
        sweeps: The number of sweeps.

    Returns:
        The temperature of each sweep, [sweeps].

    >>> constant_schedule(2.0, 3).tolist()
    [2.0, 2.0, 2.0]
    """
    return np.full(sweeps, float(temperature))


def geometric_schedule(first: float, last: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """Temperatures that change by a constant factor from sweep to sweep, T_k = first (last / first)^(k / (sweeps - 1)).

    Simulated annealing lowers them (paper, section 3.2).

    Args:
        first: The temperature of the first sweep, in the unit of the energy.
        last: The temperature of the last sweep.
        sweeps: The number of sweeps; a single sweep has the first temperature.

    Returns:
        The temperature of each sweep, [sweeps].

    Raises:
        ValueError: If a temperature is not positive.

    >>> geometric_schedule(8.0, 2.0, 3).tolist()
    [8.0, 4.0, 2.0]
    """
    if not (first > 0 and last > 0):
        raise ValueError(f"temperatures {first} and {last}: a geometric schedule needs both above 0")
    return np.geomspace(first, last, sweeps) if sweeps > 1 else np.full(sweeps, float(first))


def has_stalled(energies: Sequence[float], patience: int) -> bool:
    """Whether the last `patience` energies hold no new minimum; never true for a patience of 0."""
    return bool(0 < patience < len(energies) and min(energies[-patience:]) >= min(energies[:-patience]))
