"""Relaxation: a tissue goes down the gradient of its energy to a minimum, with neighbor lists renewed on the way."""

import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, check_energy, check_parameters, in_precision
from jaxtissue.geometry.positions import as_positions, check_count
from jaxtissue.measurement.adhesion import check_adhesion
from jaxtissue.measurement.quadrature import Resolution, as_resolution, plan_lines
from jaxtissue.minimization.fire import fire
from jaxtissue.minimization.tissue_energy import energy_on_lines
from jaxtissue.system.frames import as_frame
from jaxtissue.tissue.measurer import CellMeasurer

METHODS = ("lbfgs", "fire")
ITERATIONS = 15  # between two checks of the neighbor lists
REACH = 0.5  # mean cell widths that a backbone may move between two checks
STALLED = 1e-7  # relative decrease of the energy between two checks that is none
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


class _Slope:
    """Energy and gradient in lengths: along the axis, and round it at the mean of both radii."""

    def __init__(self, model: Model, cells: int, resolution: Resolution) -> None:
        tube = model.tube
        self.units = np.array([1.0, (float(tube.apical_radius) + float(tube.basal_radius)) / 2])
        self.model, self.evaluations, self.compiling = model, 0, 0.0
        self._lines = plan_lines(tube, cells, resolution, surfaces=model.has_surfaces)
        self._measurer = CellMeasurer(tube, resolution)
        self._known: set[tuple[int, ...]] = set()

    def renew(self, positions: Float[np.ndarray, "n 2"]) -> bool:
        """Renew the lists where they lack a neighbor; whether they did."""
        before = self._measurer.num_rebuilds
        self._measurer.measure(positions)
        return self._measurer.num_rebuilds > before

    def at(self, positions: Float[np.ndarray, "n 2"]) -> tuple[float, Float[np.ndarray, "n 2"]]:
        """Energy and gradient by the lists renewed last."""
        assert self._measurer.neighbors is not None
        lists = self._measurer.neighbors.candidates
        begin = time.perf_counter()
        energy, gradient = _differentiating()(jnp.asarray(positions), self.model, self._lines, lists)
        found = float(energy), np.asarray(gradient, float) / self.units
        if lists.shape not in self._known:
            self._known.add(lists.shape)
            self.compiling += time.perf_counter() - begin
        self.evaluations += 1
        if not (np.isfinite(found[0]) and np.isfinite(found[1]).all()):
            raise ValueError("the energy or its gradient is not finite here; move backbones that coincide apart")
        return found


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
        method: "lbfgs", the quasi-Newton method of scipy with bounds, or "fire", which follows the gradient with
            inertia (Bitzek et al. 2006).
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
    start = np.asarray(as_positions(positions, model.tube))
    check_count(len(start), model.tube, float(model.mean_volume))
    check_parameters(model.parameters, len(start))
    check_adhesion(model.adhesion, len(start))
    check_energy(model)
    model = in_precision(model, start.dtype)
    slope = _Slope(model, len(start), as_resolution(resolution))
    place, history = start, []
    message, converged = f"{steps} steps played", False
    with tqdm(total=steps, desc="relaxing", unit="step", disable=None) as bar:
        for record, here in _descend(start, slope, method, steps):
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
    place: Float[np.ndarray, "n 2"], slope: _Slope, method: str, steps: int
) -> Iterator[tuple[RelaxRecord, Float[np.ndarray, "n 2"]]]:
    """The tissue at each check; one that would be higher than before is not taken, and steps are shortened."""
    begin, tube, reach = time.perf_counter(), slope.model.tube, REACH
    width = (2 * np.pi * slope.units[1] * float(tube.length) / len(place)) ** 0.5
    minimize = {"lbfgs": _lbfgs, "fire": fire}[method]
    slope.renew(place)
    energy, gradient = slope.at(place)
    for step in range(steps + 1):
        seconds = time.perf_counter() - begin - slope.compiling
        yield RelaxRecord(step, slope.evaluations, energy, float(np.linalg.norm(gradient)), seconds), place
        if step == steps:
            return
        while True:
            low, high = (place * slope.units + side * reach * width for side in (-1, 1))
            low[:, 0], high[:, 0] = np.maximum(low[:, 0], 0), np.minimum(high[:, 0], float(tube.length))
            moved = minimize(partial(_in_lengths, slope, place.dtype), place * slope.units, low, high, ITERATIONS)
            new = np.asarray(tube.reflect(jnp.asarray((moved / slope.units).astype(place.dtype))))
            slope.renew(new)
            found = slope.at(new)
            if found[0] <= energy or reach < SHORTEST * REACH:
                break
            reach /= 4
            slope.renew(place)
        if found[0] > energy:
            continue  # the same record again, by which the caller sees that nothing leads down
        place, (energy, gradient), reach = new, found, min(2 * reach, REACH)


def _in_lengths(
    slope: _Slope, dtype: np.dtype, moved: Float[np.ndarray, "n 2"]
) -> tuple[float, Float[np.ndarray, "n 2"]]:
    return slope.at((moved / slope.units).astype(dtype))


def _lbfgs(
    function: Callable[[np.ndarray], tuple[float, np.ndarray]],
    start: Float[np.ndarray, "n 2"],
    low: Float[np.ndarray, "n 2"],
    high: Float[np.ndarray, "n 2"],
    iterations: int,
) -> Float[np.ndarray, "n 2"]:
    """Where L-BFGS-B of scipy comes to within so many iterations and these bounds."""
    from scipy.optimize import minimize

    def flat(place: np.ndarray) -> tuple[float, np.ndarray]:
        energy, gradient = function(place.reshape(start.shape))
        return energy, gradient.ravel()

    bounds = np.stack([low.ravel(), high.ravel()], axis=1)
    options = {"maxiter": iterations, "maxcor": 20}
    found = minimize(flat, start.ravel(), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return found.x.reshape(start.shape)
