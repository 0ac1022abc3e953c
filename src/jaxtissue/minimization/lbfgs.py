"""L-BFGS with a line search for functions with kinks (Lewis and Overton, Math. Program. 141, 135, 2013).

A tissue's energy has kinks and small steps, where walls open and close and where two cells pass each other along the
axis. At these the strong Wolfe condition of the usual line searches cannot be met, and L-BFGS-B of SciPy stops early.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MEMORY = 20  # pairs of steps and changes of the gradient
DECREASE, CURVATURE = 1e-4, 0.9  # of the slope, in the weak Wolfe conditions
TRIALS = 8  # of the length of one step
LEAP = 0.01  # of the longest step
LEAST = 1e-12  # cosine of a step and the change of the gradient, below which the pair is left out


class Point(NamedTuple):
    """A place with the energy and its gradient there, and up to which part of the energy changes mean nothing."""

    place: Float[np.ndarray, "n d"]
    energy: float
    gradient: Float[np.ndarray, "n d"]
    noise: float = 0.0

    def is_level_with(self, other: "Point") -> bool:
        """Whether the energies are the same but for the noise."""
        return abs(self.energy - other.energy) <= self.noise * abs(self.energy)

    def is_below(self, other: "Point") -> bool:
        """Whether the energy is less or, of the same energy, the gradient."""
        if self.is_level_with(other):
            return bool(np.linalg.norm(self.gradient) < np.linalg.norm(other.gradient))
        return self.energy < other.energy


Function = Callable[[Float[np.ndarray, "n d"]], Point]


class LBFGS:
    """Goes down a function; what it learned of its curvature is kept from call to call."""

    def __init__(self) -> None:
        self._pairs: deque[tuple[np.ndarray, np.ndarray, float]] = deque(maxlen=MEMORY)

    def forget(self) -> None:
        """Forget the curvature, since the function is another one from here on."""
        self._pairs.clear()

    def step(self, function: Function, here: Point, longest: float) -> Point:
        """One step, in which no coordinate moves by more than `longest`.

        Where none leads down it is a short leap against the gradient: beyond a small rise the way may lead down again.
        """
        direction = -self._scaled(here.gradient)
        if not (direction * here.gradient).sum() < 0:
            self.forget()
            direction = -here.gradient
        size = np.abs(direction).max()
        if size == 0:
            return here
        # the first step of all is a guess
        first, most = (1.0 if self._pairs else 0.1 * longest / size), longest / size
        found = _weak_wolfe(function, here, direction, min(first, most), most)
        if found is None:
            if not self._pairs:
                return function(here.place + LEAP * longest / size * direction)
            self.forget()
            return self.step(function, here, longest)
        moved, change = found.place - here.place, found.gradient - here.gradient
        product = float((moved * change).sum())
        if product > LEAST * np.linalg.norm(moved) * np.linalg.norm(change):
            self._pairs.append((moved, change, product))
        return found

    def _scaled(self, gradient: np.ndarray) -> np.ndarray:
        """The gradient times the inverse Hessian as far as it is known, by the two loops of Nocedal."""
        rest, shares = gradient.copy(), []
        for moved, change, product in reversed(self._pairs):
            shares.append((moved * rest).sum() / product)
            rest -= shares[-1] * change
        if self._pairs:
            _, change, product = self._pairs[-1]
            rest *= product / (change * change).sum()
        for (moved, change, product), share in zip(self._pairs, reversed(shares), strict=True):
            rest += moved * (share - (change * rest).sum() / product)
        return rest


def _weak_wolfe(function: Function, here: Point, direction: np.ndarray, first: float, most: float) -> Point | None:
    """A point on a line with enough less energy and, unless it is as far as may be, enough less slope.

    Where the energy's changes are noise, the slope alone tells (Hager and Zhang, SIAM J. Optim. 16, 170, 2005).
    """
    slope = float((direction * here.gradient).sum())
    low, high, share, best = 0.0, np.inf, first, None
    for _ in range(TRIALS):
        there = function(here.place + share * direction)
        there_slope = float((there.gradient * direction).sum())
        is_level = there.is_level_with(here) and there_slope <= (2 * DECREASE - 1) * slope
        if not (is_level or there.energy <= here.energy + DECREASE * share * slope):
            high = share
        else:
            best = there
            if share >= most or there_slope >= CURVATURE * slope:
                return best
            low = share
        share = min(2 * low, most) if np.isinf(high) else (low + high) / 2
    return best
