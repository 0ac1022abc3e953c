"""Temperature schedules, and a stopping rule for runs that have stalled.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def constant_schedule(temperature: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """Return a schedule with the same temperature for every sweep (the paper uses T = 2, section 4.3).

    Args:
        temperature: Temperature T, in energy units.
        sweeps: Number of sweeps.

    Returns:
        Temperature of each sweep, shape [sweeps].

    >>> constant_schedule(2.0, 3).tolist()
    [2.0, 2.0, 2.0]
    """
    return np.full(sweeps, float(temperature))


def geometric_schedule(first: float, last: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """Return the geometric schedule T_k = first (last / first)^(k / (sweeps - 1)) of simulated annealing.

    Args:
        first: Temperature of the first sweep, in energy units, greater than 0.
        last: Temperature of the last sweep, in energy units, greater than 0.
        sweeps: Number of sweeps. With 1, the temperature is `first`.

    Returns:
        Temperature of each sweep, shape [sweeps].

    Raises:
        ValueError: If a temperature is not positive.

    >>> geometric_schedule(8.0, 2.0, 3).tolist()
    [8.0, 4.0, 2.0]
    """
    if not (first > 0 and last > 0):
        raise ValueError(f"temperatures {first} and {last} are invalid: a geometric schedule needs both above 0")
    return np.geomspace(first, last, sweeps) if sweeps > 1 else np.full(sweeps, float(first))


def has_stalled(energies: Sequence[float], patience: int) -> bool:
    """Whether the last `patience` energies hold no new minimum; never true for a patience of 0."""
    return bool(0 < patience < len(energies) and min(energies[-patience:]) >= min(energies[:-patience]))
