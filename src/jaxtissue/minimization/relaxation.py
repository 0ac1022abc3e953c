"""Relaxation: a tissue goes down the gradient of its energy to a minimum, with neighbor lists renewed on the way."""

import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, check_energy, check_parameters, in_precision
from jaxtissue.geometry.positions import as_positions, check_count, require_tube
from jaxtissue.measurement.adhesion import check_adhesion
from jaxtissue.measurement.quadrature import Resolution, as_resolution, plan_lines
from jaxtissue.minimization.fire import FIRE
from jaxtissue.minimization.lbfgs import LBFGS, Point
from jaxtissue.minimization.tissue_energy import energy_on_lines
from jaxtissue.neighbors.neighbor_list import NeighborList, list_neighbors
from jaxtissue.system.frames import as_frame

METHODS = {"lbfgs": LBFGS, "fire": FIRE}
ITERATIONS = 15  # between two checks of the neighbor lists
MARGIN = 0.25  # mean cell widths along the axis by which lists reach to the other side of a cell
REACH = 0.5  # mean cell widths that a backbone may move between two checks
STALLED = 1e-7  # relative decrease of the energy between two checks that is none
ROUNDING = 1e-6  # relative difference of the energy by old and new lists that is none
SHORTEST = 1e-3  # of REACH, the least to which steps are shortened where lists do not hold


class RelaxRecord(NamedTuple):
    """The tissue at a check of the neighbor lists.

    Attributes:
        step: The number of the check, 0 for the initial state.
        evaluations: How often energy and gradient were computed by then.
        energy: The energy.
        gradient: The norm of its gradient, in the unit of energy per length on the mean surface.
        seconds: The time since the start, without compiling.
    """

    step: int
    evaluations: int
    energy: float
    gradient: float
    seconds: float


@dataclass(frozen=True, eq=False)
class RelaxResult:
    """The result of a relaxation.

    Attributes:
        positions: (axial, angle) of each backbone, [n, 2].
        energy: The energy there, at the resolution of the relaxation.
        history: A record of each check of the neighbor lists.
        converged: Whether the gradient fell below the tolerance. If not, either the steps were used up, or no step led
            down any more: the energy has kinks where walls open or close.
        message: Why it ended.
    """

    positions: Float[np.ndarray, "n 2"]
    energy: float
    history: list[RelaxRecord]
    converged: bool
    message: str

    def to_pandas(self) -> Any:
        """The history as a pandas `DataFrame`; raises `ImportError` without pandas."""
        return as_frame({name: [getattr(record, name) for record in self.history] for name in RelaxRecord._fields})

    def __repr__(self) -> str:
        first, last = self.history[0], self.history[-1]
        told = f"E {first.energy:.6g} -> {last.energy:.6g}, {last.evaluations} evaluations"
        return f"RelaxResult({len(self.positions)} cells, {told}, {self.message})"


@functools.cache
def _differentiating() -> Callable[..., tuple[Any, Any]]:
    return jax.jit(jax.value_and_grad(energy_on_lines))


class _Energy:
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
        self._known: set[tuple[int, ...]] = set()

    def positions(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """(axial, angle) of the backbones."""
        return np.asarray(self.model.tube.reflect(jnp.asarray(place / self.units)))

    def renewed(self, place: Float[np.ndarray, "n 2"]) -> Point:
        """Energy and gradient by lists that are complete here."""
        positions = self.positions(place)
        if self._neighbors is None or not self._neighbors.covers(positions):
            self._neighbors = list_neighbors(positions, self.model.tube, MARGIN * self.width)
        return self(place)

    def __call__(self, place: Float[np.ndarray, "n 2"]) -> Point:
        """Energy and gradient by the lists renewed last; the energy is infinite where it can't be measured."""
        assert self._neighbors is not None
        lists = self._neighbors.candidates
        begin = time.perf_counter()
        energy, gradient = _differentiating()(jnp.asarray(self.positions(place)), self.model, self._lines, lists)
        slope = np.asarray(gradient, float) / self.units
        if lists.shape not in self._known:
            self._known.add(lists.shape)
            self.compiling += time.perf_counter() - begin
        self.evaluations += 1
        if not (np.isfinite(energy) and np.isfinite(slope).all()):
            return Point(place, np.inf, np.zeros_like(slope))
        is_reflected = np.floor(place[:, 0] / float(self.model.tube.length)) % 2 != 0
        slope[is_reflected, 0] *= -1
        return Point(place, float(energy), slope)


@usual_modes()
def relax(
    positions: Any,
    model: Model,
    method: str = "lbfgs",
    steps: int = 50,
    tolerance: float = 1e-6,
    resolution: Resolution | str = "draft",
    callback: Callable[[RelaxRecord, Float[np.ndarray, "n 2"]], Any] | None = None,
) -> RelaxResult:
    """Relax a tissue to a minimum of its energy by the gradient, which gets there much sooner than Metropolis.

    Every 15 iterations the neighbor lists are checked and, where one lacks a neighbor, renewed; between two checks no
    backbone moves by more than half a mean cell width. Shows a progress bar on a terminal.

    Args:
        positions: (axial, angle) of each backbone, [n, 2], in any form that `as_positions` takes.
        model: The energy; see `tube_model`.
        method: "lbfgs", the quasi-Newton method with a line search for functions with kinks (Lewis and Overton 2013),
            or "fire", which follows the gradient with inertia (Bitzek et al. 2006).
        steps: The most checks, each after 15 iterations at most.
        tolerance: The norm of the gradient, as a fraction of that at the start, at which the tissue is relaxed.
        resolution: How finely cells are measured: a preset or layers and lines.
        callback: Called as `callback(record, positions)` after each check; ends the relaxation if it returns a true
            value.

    Returns:
        The relaxed positions, the energy, and the history.

    Raises:
        ValueError: If the positions, the energy, the method or the numbers are refused; the message names the value and
            the remedy.

    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(length=12.0, apical_radius=1.0, basal_radius=3.0)
    >>> positions = tube.random_positions(jax.random.key(0), 40)
    >>> result = relax(positions, tube_model(tube, 40), steps=1)
    >>> bool(result.energy < result.history[0].energy)
    True
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; use {' or '.join(METHODS)}")
    if steps < 0 or not tolerance > 0:
        raise ValueError(f"steps={steps}, tolerance={tolerance}: give a number of steps and a positive fraction")
    require_tube(model.domain)
    start = np.asarray(as_positions(positions, model.tube))
    check_count(len(start), model.tube, float(model.mean_volume))
    check_parameters(model.parameters, len(start))
    check_adhesion(model.adhesion, len(start))
    check_energy(model)
    model = in_precision(model, start.dtype)
    energy = _Energy(model, len(start), as_resolution(resolution))
    place, history = start, []
    message, converged = f"{steps} steps played", False
    with tqdm(total=steps, desc="relaxing", unit="step", disable=None) as bar:
        for record, here in _descend(start, energy, METHODS[method](), steps):
            place = here
            history.append(record)
            bar.update(int(record.step > 0))
            bar.set_postfix(energy=f"{record.energy:.5g}", gradient=f"{record.gradient:.2g}")
            converged = record.gradient <= tolerance * history[0].gradient
            if converged:
                message = "relaxed"
                break
            if callback is not None and callback(record, place):
                message = "ended by the callback"
                break
            if len(history) > 1 and history[-2].energy - record.energy <= STALLED * abs(record.energy):
                message = "no step leads down any more"
                break
    return RelaxResult(place, history[-1].energy, history, converged, message)


def _descend(
    positions: Float[np.ndarray, "n 2"], energy: _Energy, minimizer: LBFGS | FIRE, steps: int
) -> Iterator[tuple[RelaxRecord, Float[np.ndarray, "n 2"]]]:
    """The tissue at each check of the lists; the same record twice says that nothing leads down."""
    begin, longest = time.perf_counter(), REACH * energy.width
    here = energy.renewed(positions * energy.units)
    if not np.isfinite(here.energy):
        cure = "move apart backbones that coincide, or anneal a few sweeps first"
        raise ValueError(f"the energy or its gradient is not finite at the start; {cure}")
    for step in range(steps + 1):
        seconds = time.perf_counter() - begin - energy.compiling
        slope = float(np.linalg.norm(here.gradient))
        yield RelaxRecord(step, energy.evaluations, here.energy, slope, seconds), energy.positions(here.place)
        reach = longest
        while step < steps and reach > SHORTEST * longest:
            low = _lowest(energy, here, minimizer, reach)
            there = energy.renewed(low.place) if low is not here else here
            if abs(there.energy - low.energy) > ROUNDING * abs(low.energy):
                minimizer.forget()  # lists lacked a neighbor: it was another energy
            if there.energy <= here.energy:
                here = there
                break
            reach /= 4
            energy.renewed(here.place)


def _lowest(energy: _Energy, here: Point, minimizer: LBFGS | FIRE, reach: float) -> Point:
    """The lowest point within some iterations, in which no backbone moves by much more than `reach`."""
    best = there = here
    for _ in range(ITERATIONS):
        moved = np.abs(there.place - here.place).max()
        if moved >= reach:
            break
        before, there = there, minimizer.step(energy, there, max(reach - moved, reach / 4))
        if there is before or not np.isfinite(there.energy):
            break
        if there.energy < best.energy:
            best = there
    if best is not there:
        minimizer.forget()
    return best
