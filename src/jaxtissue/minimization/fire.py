"""FIRE, the fast inertial relaxation engine (Bitzek et al., Phys. Rev. Lett. 97, 170201, 2006)."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

LATENT = 5  # steps downhill before time steps grow
GROWS, SHRINKS = 1.1, 0.5  # factors of the time step
MIXING, FADES = 0.1, 0.99  # how much velocities turn towards the force, and the factor of it at each step
FIRST = 0.02  # of the bounds' width that the first step moves the fastest backbone by


def fire(
    function: Callable[[np.ndarray], tuple[float, np.ndarray]],
    start: Float[np.ndarray, "n 2"],
    low: Float[np.ndarray, "n 2"],
    high: Float[np.ndarray, "n 2"],
    iterations: int,
) -> Float[np.ndarray, "n 2"]:
    """The lowest place found within so many iterations, within bounds."""
    place, velocity = start, np.zeros_like(start)
    energy, gradient = function(place)
    best = energy, place
    most = np.abs(high - low).max()
    time_step = (FIRST * most / max(np.abs(gradient).max(), 1e-300)) ** 0.5
    longest, mixing, downhill = 10 * time_step, MIXING, 0
    for _ in range(iterations):
        force = -gradient
        power = float((force * velocity).sum())
        if power > 0:
            size = np.linalg.norm(velocity) / max(float(np.linalg.norm(force)), 1e-300)
            velocity = (1 - mixing) * velocity + mixing * size * force
            downhill += 1
            if downhill > LATENT:
                time_step, mixing = min(GROWS * time_step, longest), FADES * mixing
        else:
            velocity, mixing, downhill = np.zeros_like(velocity), MIXING, 0
            time_step *= SHRINKS if np.any(place != start) else 1
        velocity = velocity + time_step * force
        move = time_step * velocity
        move *= min(1.0, 0.1 * most / max(np.abs(move).max(), 1e-300))
        place = np.clip(place + move, low, high)
        energy, gradient = function(place)
        if energy < best[0]:
            best = energy, place
    return best[1]
