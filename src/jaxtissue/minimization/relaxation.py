"""Relaxation: a tissue goes down the gradient of its energy to a minimum, with neighbor lists renewed on the way."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, check_energy, check_parameters, in_precision
from jaxtissue.geometry.positions import as_positions, check_count, require_tube
from jaxtissue.measurement.adhesion import check_adhesion
from jaxtissue.measurement.quadrature import Resolution, as_resolution
from jaxtissue.minimization.fire import FIRE
from jaxtissue.minimization.lbfgs import LBFGS, Point
from jaxtissue.minimization.lloyd import move_to_centroids
from jaxtissue.minimization.placed_energy import ITERATIONS, REACH, RELAXED, PlacedEnergy, RelaxRecord, Stage
from jaxtissue.system.frames import as_frame

MINIMIZERS = {"lbfgs": LBFGS, "fire": FIRE}
METHODS = (*MINIMIZERS, "lloyd")
STALLED = 1e-7  # relative decrease of the energy between two checks that is none
ROUNDING = 1e-6  # relative difference of the energy by old and new lists that is none
SHORTEST = 1e-3  # of REACH, the least to which steps are shortened where lists do not hold


@dataclass(frozen=True, eq=False)
class RelaxResult:
    """The result of a relaxation.

    Attributes:
        positions: (axial, angle) of each backbone, [n, 2].
        energy: The energy there, at the resolution of the relaxation.
        history: A record of each check of the neighbor lists.
        converged: Whether the gradient, or by "lloyd" the moves, fell below the tolerance. If not, either the steps
            were used up, or no step led down any more: the energy has kinks where walls open or close.
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
            "fire", which follows the gradient with inertia (Bitzek et al. 2006), or "lloyd", which moves every backbone
            to the centroid of its cell, whatever the energy: a quick start that makes cells compact and alike (Lloyd
            1982). The centroid is the mean axial position of the cell and its mean direction from the axis.
        steps: The most checks, each after 15 iterations at most.
        tolerance: The norm of the gradient, as a fraction of that at the start, at which the tissue is relaxed; by
            "lloyd" the root mean square of the moves, as a fraction of that of the first.
        resolution: How finely cells are measured: a preset or layers and lines.
        callback: Called as `callback(record, positions)` after each check; ends the relaxation if it returns a true
            value.

    Returns:
        The relaxed positions, the energy, and the history.

    Raises:
        ValueError: If the positions, the energy, the method or the numbers are refused; the message names the value and
            the remedy.

    >>> import jax
    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(length=12.0, apical_radius=1.0, basal_radius=3.0)
    >>> positions = tube.random_positions(jax.random.key(0), 40)
    >>> result = relax(positions, tube_model(tube, 40), steps=1)
    >>> bool(result.energy < result.history[0].energy)
    True
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; use one of {', '.join(METHODS)}")
    if steps < 0 or not tolerance > 0:
        raise ValueError(f"steps={steps}, tolerance={tolerance}: give a number of steps and a positive fraction")
    require_tube(model.domain)
    start = np.asarray(as_positions(positions, model.tube))
    check_count(len(start), model.tube, float(model.mean_volume))
    check_parameters(model.parameters, len(start))
    check_adhesion(model.adhesion, len(start))
    check_energy(model)
    model = in_precision(model, start.dtype)
    energy = PlacedEnergy(model, len(start), as_resolution(resolution))
    if method == "lloyd":
        stages = move_to_centroids(start, energy, steps, tolerance)
    else:
        stages = _descend(start, energy, MINIMIZERS[method](), steps, tolerance)
    place, history, ended = start, [], ""
    with tqdm(total=steps, desc="relaxing", unit="step", disable=None) as bar:
        for record, place, ended in stages:
            history.append(record)
            bar.update(int(record.step > 0))
            bar.set_postfix(energy=f"{record.energy:.5g}", gradient=f"{record.gradient:.2g}")
            asked = callback is not None and bool(callback(record, place))
            ended = ended or ("ended by the callback" if asked else "")
            if ended:
                break
    return RelaxResult(place, history[-1].energy, history, ended == RELAXED, ended or f"{steps} steps played")


def _descend(
    positions: Float[np.ndarray, "n 2"], energy: PlacedEnergy, minimizer: LBFGS | FIRE, steps: int, tolerance: float
) -> Iterator[Stage]:
    """The tissue at each check of the lists, down the gradient."""
    longest = REACH * energy.width
    here = energy.renewed(positions * energy.units)
    if not np.isfinite(here.energy):
        cure = "move apart backbones that coincide, or anneal a few sweeps first"
        raise ValueError(f"the energy or its gradient is not finite at the start; {cure}")
    least, before = tolerance * float(np.linalg.norm(here.gradient)), np.inf
    for step in range(steps + 1):
        record, ended = energy.record(step, here), ""
        if record.gradient <= least:
            ended = RELAXED
        elif before - here.energy <= STALLED * abs(here.energy):
            ended = "no step leads down any more"
        yield Stage(record, energy.positions(here.place), ended)
        before, reach = here.energy, longest
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


def _lowest(energy: PlacedEnergy, here: Point, minimizer: LBFGS | FIRE, reach: float) -> Point:
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
