"""FIRE, the fast inertial relaxation engine (Bitzek et al., Phys. Rev. Lett. 97, 170201, 2006)."""

import numpy as np

from jaxtissue.minimization.lbfgs import Function, Point

LATENT = 5  # steps downhill before time steps grow
GROWS, SHRINKS = 1.1, 0.5  # factors of the time step
MIXING, FADES = 0.1, 0.99  # how much velocities turn towards the force, and the factor of it at each step
FIRST = 0.04  # of the longest step, that the first one moves the fastest coordinate by
MOST = 0.2  # of the longest step, in each


class FIRE:
    """Follows the gradient with inertia; velocities are kept from call to call."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin at rest."""
        self._velocity: np.ndarray | None = None
        self._time_step, self._most, self._mixing, self._downhill = 0.0, 0.0, MIXING, 0

    def step(self, function: Function, here: Point, longest: float) -> Point:
        """One step, in which no coordinate moves by more than a part of `longest`; it may lead up."""
        force = -here.gradient
        if self._velocity is None:
            self._velocity = np.zeros_like(force)
            self._time_step = (FIRST * longest / max(np.abs(force).max(), 1e-300)) ** 0.5
            self._most = 10 * self._time_step
        power = float((force * self._velocity).sum())
        if power > 0:
            speed = np.linalg.norm(self._velocity) / max(float(np.linalg.norm(force)), 1e-300)
            self._velocity = (1 - self._mixing) * self._velocity + self._mixing * speed * force
            self._downhill += 1
            if self._downhill > LATENT:
                self._time_step, self._mixing = min(GROWS * self._time_step, self._most), FADES * self._mixing
        elif self._velocity.any():
            self._velocity, self._mixing, self._downhill = np.zeros_like(force), MIXING, 0
            self._time_step *= SHRINKS
        velocity = self._velocity = self._velocity + self._time_step * force
        move = self._time_step * velocity
        move *= min(1.0, MOST * longest / max(np.abs(move).max(), 1e-300))
        return function(here.place + move)
