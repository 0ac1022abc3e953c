"""A tissue that is placed in lengths: its energy and gradient there, on neighbor lists that are renewed on request."""

import time
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtissue.energy import Model
from jaxtissue.minimization.lbfgs import Point

REACH = 0.5  # mean cell widths that a backbone may move between two checks of the lists
ITERATIONS = 15  # between two checks
RELAXED = "converged"


class RelaxRecord(NamedTuple):
    """State of a relaxation after one step, that is, one block of up to 15 iterations.

    Attributes:
        step: Number of the step; 0 for the initial state.
        evaluations: Number of evaluations so far of energy and gradient (for "lloyd": also of the centroids).
        energy: Energy of the tissue.
        gradient: Euclidean norm of the gradient of the energy, in energy per length on the surface midway between
            apical and basal.
        seconds: Wall time since the start, without compilation.
    """

    step: int
    evaluations: int
    energy: float
    gradient: float
    seconds: float


class Stage(NamedTuple):
    """The tissue at a check: its record, positions of the backbones, and why this is the last, if it is."""

    record: RelaxRecord
    positions: Float[np.ndarray, "n d"]
    ended: str = ""


class PlacedEnergy:
    """Energy and gradient of a tissue whose backbones are placed in lengths, with lists that are renewed on request.

    Places are positions times `units`. They may go on beyond ends and periods, where the backbones are those brought
    back.

    Args:
        model: The energy.
        units: How long one unit of each coordinate of a position is, in the mean, [d].
        width: The width of a mean cell.

    Attributes:
        stalled: Relative decrease of the energy between two checks that is none.
        noise: Relative change of the energy that its gradient need not explain.
    """

    def __init__(self, model: Model, units: Float[np.ndarray, " d"], width: float) -> None:
        self.model, self.units, self.width = model, units, width
        single = jnp.result_type(float) == jnp.float32
        self.stalled, self.noise = (1e-7, 0.0) if single else (1e-12, 1e-9)
        self.evaluations, self.compiling = 0, 0.0
        self._known: set[Hashable] = set()
        self._begin = time.perf_counter()

    def placed(self, positions: Float[np.ndarray, "n *k d"]) -> Float[np.ndarray, "n *k d"]:
        """The places of positions."""
        return positions * self.units

    def positions(self, place: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Positions of the backbones, within the domain."""
        raise NotImplementedError

    def renew(self, place: Float[np.ndarray, "n d"]) -> None:
        """Renew the lists unless they are complete here."""
        raise NotImplementedError

    def measured(self, place: Float[np.ndarray, "n d"]) -> tuple[Any, Float[np.ndarray, "n d"]]:
        """Energy and gradient, by places, by the lists renewed last."""
        raise NotImplementedError

    def centroids(self, place: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """The places of the centroids of the cells by the lists renewed last."""
        raise NotImplementedError

    def doubts(self) -> str:
        """Why the energy by the lists renewed last may be wrong, if it may."""
        return ""

    def renewed(self, place: Float[np.ndarray, "n d"]) -> Point:
        """Energy and gradient by lists that are complete here."""
        self.renew(place)
        return self(place)

    def __call__(self, place: Float[np.ndarray, "n d"]) -> Point:
        """Energy and gradient by the lists renewed last; the energy is infinite where it can't be measured."""
        energy, slope = self.measured(place)
        if not (np.isfinite(energy) and np.isfinite(slope).all()):
            return Point(place, np.inf, np.zeros_like(slope))
        return Point(place, float(energy), slope, self.noise)

    def record(self, step: int, here: Point) -> RelaxRecord:
        """The record of a place."""
        seconds = time.perf_counter() - self._begin - self.compiling
        return RelaxRecord(step, self.evaluations, here.energy, float(np.linalg.norm(here.gradient)), seconds)

    def timed(self, program: Hashable, measure: Callable[[], Any]) -> Any:
        """What a measurement finds; what it takes to compile a program that was not run before is noted."""
        begin = time.perf_counter()
        found = jax.block_until_ready(measure())
        if program not in self._known:
            self._known.add(program)
            self.compiling += time.perf_counter() - begin
        self.evaluations += 1
        return found
