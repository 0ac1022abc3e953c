"""Energy, gradient and centroids of a tissue that is placed in lengths, with neighbor lists renewed on request."""

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxtissue.energy import Model
from jaxtissue.measurement.centroids import measure_moments
from jaxtissue.measurement.quadrature import Resolution, plan_lines
from jaxtissue.minimization.lbfgs import Point
from jaxtissue.minimization.tissue_energy import energy_on_lines
from jaxtissue.neighbors.neighbor_list import NeighborList, list_neighbors

MARGIN = 0.25  # mean cell widths along the axis by which lists reach to the other side of a cell
REACH = 0.5  # mean cell widths that a backbone may move between two checks of the lists
ITERATIONS = 15  # between two checks
RELAXED = "relaxed"


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
    """The tissue at a check: its record, (axial, angle) of the backbones, and why this is the last, if it is."""

    record: RelaxRecord
    positions: Float[np.ndarray, "n 2"]
    ended: str = ""


@functools.cache
def _differentiating() -> Callable[..., tuple[Any, Any]]:
    return jax.jit(jax.value_and_grad(energy_on_lines))


@functools.cache
def _seeking_centroids() -> Callable[..., Any]:
    return jax.jit(measure_moments)


class PlacedEnergy:
    """Energy and gradient of a tissue whose backbones are placed in lengths, with lists that are renewed on request.

    Lengths are along the axis, and round it at the mean of both radii; places may go on beyond the tube's ends, where
    the backbones are those reflected.
    """

    def __init__(self, model: Model, cells: int, resolution: Resolution) -> None:
        tube = model.tube
        self.units = np.array([1.0, (float(tube.apical_radius) + float(tube.basal_radius)) / 2])
        self.width = (2 * np.pi * self.units[1] * float(tube.length) / cells) ** 0.5  # of a mean cell
        self.model, self.evaluations, self.compiling = model, 0, 0.0
        self._lines = plan_lines(tube, cells, resolution, surfaces=model.has_surfaces)
        self._neighbors: NeighborList | None = None
        self._known: set[tuple[Callable, tuple[int, ...]]] = set()
        self._begin = time.perf_counter()

    def positions(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """(axial, angle) of the backbones."""
        return np.asarray(self.model.tube.reflect(jnp.asarray(place / self.units)))

    def renewed(self, place: Float[np.ndarray, "n 2"]) -> Point:
        """Energy and gradient by lists that are complete here."""
        self.renew(place)
        return self(place)

    def renew(self, place: Float[np.ndarray, "n 2"]) -> None:
        """Renew the lists unless they are complete here."""
        positions = self.positions(place)
        if self._neighbors is None or not self._neighbors.covers(positions):
            self._neighbors = list_neighbors(positions, self.model.tube, MARGIN * self.width)

    def __call__(self, place: Float[np.ndarray, "n 2"]) -> Point:
        """Energy and gradient by the lists renewed last; the energy is infinite where it can't be measured."""
        energy, gradient = self._timed(_differentiating(), place, self.model)
        slope = np.asarray(gradient, float) / self.units
        if not (np.isfinite(energy) and np.isfinite(slope).all()):
            return Point(place, np.inf, np.zeros_like(slope))
        slope[self._is_reflected(place), 0] *= -1
        return Point(place, float(energy), slope)

    def centroids(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """The centroids of the cells by the lists renewed last: mean axial position, and mean direction from the axis.

        A cell that no line meets is taken to be at its backbone.
        """
        found = self._timed(_seeking_centroids(), place, self.model.tube)
        volume, axial, along, across = (np.asarray(moment, float) for moment in found)
        shift = axial / np.where(volume > 0, volume, 1)
        shift[self._is_reflected(place)] *= -1
        return place + np.stack([shift, np.arctan2(across, along)], axis=-1) * self.units

    def record(self, step: int, here: Point) -> RelaxRecord:
        """The record of a place."""
        seconds = time.perf_counter() - self._begin - self.compiling
        return RelaxRecord(step, self.evaluations, here.energy, float(np.linalg.norm(here.gradient)), seconds)

    def _timed(self, measure: Callable[..., Any], place: Float[np.ndarray, "n 2"], what: Any) -> Any:
        """What a compiled function finds at a place by the lists renewed last; what it takes to compile is noted."""
        assert self._neighbors is not None
        begin, lists = time.perf_counter(), self._neighbors.candidates
        found: Any = measure(jnp.asarray(self.positions(place)), what, self._lines, lists)
        jax.block_until_ready(found)
        if (measure, lists.shape) not in self._known:
            self._known.add((measure, lists.shape))
            self.compiling += time.perf_counter() - begin
        self.evaluations += 1
        return found

    def _is_reflected(self, place: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Which backbones point the other way along the axis, since their places are beyond an end of the tube."""
        return np.floor(place[:, 0] / float(self.model.tube.length)) % 2 != 0
