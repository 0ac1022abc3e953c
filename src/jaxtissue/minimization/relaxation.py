"""Relaxation: minimization of the energy of a tissue by its gradient, with neighbor lists updated on the way."""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, check_energy, check_numbers, in_precision
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import Resolution
from jaxtissue.minimization.domain_energy import DomainEnergy
from jaxtissue.minimization.fire import FIRE
from jaxtissue.minimization.lbfgs import LBFGS, Point
from jaxtissue.minimization.lloyd import move_to_centroids
from jaxtissue.minimization.merging import told_of_merging
from jaxtissue.minimization.placed_energy import ITERATIONS, REACH, RELAXED, PlacedEnergy, RelaxRecord, Stage
from jaxtissue.minimization.traced_energy import TRACED, TracedEnergy
from jaxtissue.minimization.tube_energy import TubeEnergy
from jaxtissue.system.frames import as_frame

MINIMIZERS = {"lbfgs": LBFGS, "fire": FIRE}
METHODS = (*MINIMIZERS, "lloyd")
ROUNDING = 1e-6  # relative difference of the energy by old and new lists that is none
SHORTER = 0.9  # of the gradient, as which it must be for a step that leaves the energy as it is
SHORTEST = 1e-3  # of REACH, the least to which steps are shortened where lists do not hold


@dataclass(frozen=True, eq=False)
class RelaxResult:
    """Result of a relaxation.

    Attributes:
        positions: Relaxed positions of the backbones, of the shape given; in a `Tube` axial position and angle.
        energy: Energy at `positions`, at the resolution of the relaxation.
        history: One `RelaxRecord` for the initial state and one after each step, with fields `step`, `evaluations`,
            `energy`, `gradient` (norm of the gradient) and `seconds`.
        converged: Whether the norm of the gradient (for "lloyd" the displacement) fell below the tolerance. If not,
            `steps` were used up, or the energy could not be lowered further, which is common, as the discretized energy
            has kinks where walls appear or vanish, or two cells collapsed, so that their backbones would merge.
        message: Reason for which the relaxation ended.
    """

    positions: Float[np.ndarray, "n d"]
    energy: float
    history: list[RelaxRecord]
    converged: bool
    message: str

    def to_pandas(self) -> Any:
        """Convert the history to a pandas `DataFrame` with one row per record. Raises ImportError without pandas."""
        return as_frame({name: [getattr(record, name) for record in self.history] for name in RelaxRecord._fields})

    def __repr__(self) -> str:
        first, last = self.history[0], self.history[-1]
        told = f"E {first.energy:.6g} -> {last.energy:.6g}, {last.evaluations} evaluations"
        return f"RelaxResult({len(self.positions)} cells, {told}, {self.message})"


@usual_modes()
def relax(
    positions: PositionsLike,
    model: Model,
    method: str = "lbfgs",
    steps: int = 50,
    tolerance: float = 1e-6,
    resolution: Resolution | str = "draft",
    callback: Callable[[RelaxRecord, Float[np.ndarray, "n d"]], Any] | None = None,
) -> RelaxResult:
    """Minimize the energy of a tissue by its gradient.

    `relax` descends to a nearby local minimum, much faster than Metropolis sweeps; use `anneal` or `temper` to sample
    at a finite temperature. Neighbor lists are checked after each step, a block of up to 15 iterations in which no
    backbone moves by much more than half a mean cell width. A progress bar is shown on a terminal.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3].
            On domains other than `Tube` backbones may be tilted or bent: [n, k, 2] or [n, k, 3] for k nodes, as in
            `measure_tissue`. Their nodes move and keep their heights; a warning names cells at the end whose backbones
            nearly cross, as their energies may be wrong.
        model: Energy model of a `Tube` or any other domain; see `tube_model`.
        method: "lbfgs" (the default), a quasi-Newton method with a line search for nonsmooth functions (Lewis and
            Overton 2013); "fire", gradient descent with inertia (Bitzek et al. 2006); or "lloyd", which moves every
            backbone to the centroid of its cell and ignores the energy (Lloyd 1982). A few steps of "lloyd" are a good
            start for "lbfgs". The centroid is the mean axial position of the cell and its mean direction from the axis;
            on other domains the mean of its local coordinates around the backbone.
        steps: Maximum number of steps, each a block of up to 15 iterations. Defaults to 50. With 0 the energy is only
            evaluated.
        tolerance: Converged if the norm of the gradient falls to this fraction of its initial value; for "lloyd", if
            the root-mean-square displacement per iteration falls to this fraction of its value in the first iteration.
            Greater than 0; defaults to 1e-6.
        resolution: "draft" (the default), "standard" or "fine", or a `Resolution`; in a `Tube` also "traced", with the
            sizes and derivatives of the traced edges in 64 bits. This takes some milliseconds per cell and evaluation,
            and comes much closer to a minimum; start from a tissue relaxed with "draft".
        callback: Function `callback(record, positions)` called for the initial state and after each step, with a
            `RelaxRecord` and the positions of shape [n, d]. A true return value ends the relaxation. Defaults to None.

    Returns:
        A record with fields `positions` (shape [n, d]), `energy`, `history` (a list of records with `step`,
        `evaluations`, `energy`, `gradient` and `seconds`), `converged` and `message`, and a method `to_pandas`.

    Raises:
        ValueError: If a position is invalid or the number of positions does not match the model, if `method` is
            unknown, if `steps` is negative or `tolerance` not positive, if `resolution` is "traced" and the domain is
            not a `Tube`, or if the energy or its gradient is not finite at the start.

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
        raise ValueError(f"steps={steps}, tolerance={tolerance}: give at least 0 steps and a tolerance above 0")
    start = np.asarray(as_positions_on(positions, model.domain, bent=isinstance(model.domain, Domain)))
    if method == "lloyd" and start.ndim == 3:
        raise ValueError("'lloyd' moves straight backbones only; relax tilted and bent ones by 'lbfgs' or 'fire'")
    if resolution == TRACED and method == "lloyd":
        raise ValueError("'lloyd' moves to centroids, which are not traced; give a preset as the resolution")
    check_numbers(model, len(start))
    check_energy(model)
    energy = _placed(model, start, resolution)
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
            ended = ended or ("stopped by the callback" if asked else "")
            if ended:
                break
    if told := energy.doubts():
        warnings.warn(told, stacklevel=3)
    return RelaxResult(
        place, history[-1].energy, history, ended == RELAXED, ended or f"reached the maximum of {steps} steps"
    )


def _placed(model: Model, start: Float[np.ndarray, "n d"], resolution: Resolution | str) -> PlacedEnergy:
    if resolution == TRACED:
        return TracedEnergy(model, len(start))
    model = in_precision(model, start.dtype)
    if isinstance(model.domain, Tube):
        return TubeEnergy(model, len(start), resolution)
    return DomainEnergy(model, start, resolution)


def _descend(
    positions: Float[np.ndarray, "n d"], energy: PlacedEnergy, minimizer: LBFGS | FIRE, steps: int, tolerance: float
) -> Iterator[Stage]:
    """The tissue at each check of the lists, down the gradient."""
    longest = REACH * energy.width
    here = energy.renewed(energy.placed(positions))
    if not np.isfinite(here.energy):
        cure = "separate backbones that coincide, or anneal a few sweeps first"
        cure = cure if len(positions) > 1 else "one cell alone has no walls that could move, so give more cells"
        raise ValueError(f"the energy or its gradient is not finite at the start; {cure}")
    least, before, merging = tolerance * float(np.linalg.norm(here.gradient)), None, ""
    for step in range(steps + 1):
        record, ended = energy.record(step, here), merging
        if record.gradient <= least:
            ended = RELAXED
        elif not merging and before is not None and not _goes_down(before, here, energy.stalled):
            ended = "no step lowers the energy further"
        yield Stage(record, energy.positions(here.place), ended)
        before, reach = here, longest
        while step < steps and reach > SHORTEST * longest:
            low = _lowest(energy, here, minimizer, reach)
            there = energy.renewed(low.place) if low is not here else here
            if abs(there.energy - low.energy) > ROUNDING * abs(low.energy):
                minimizer.forget()  # lists lacked a neighbor: it was another energy
            if there.energy <= here.energy or there.is_below(here):
                merging = told_of_merging(*(energy.positions(point.place) for point in (here, there)), energy.model)
                here = here if merging else there
                break
            reach /= 4
            energy.renewed(here.place)


def _goes_down(before: Point, here: Point, stalled: float) -> bool:
    """Whether a step was worth it: by the energy or, where its changes are noise, by the gradient."""
    shorter = np.linalg.norm(here.gradient) <= SHORTER * np.linalg.norm(before.gradient)
    gain = before.energy - here.energy
    return bool(gain > stalled * abs(here.energy) or (here.is_level_with(before) and shorter))


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
        if there.is_below(best):
            best = there
    if not there.is_level_with(best):
        minimizer.forget()
    return best
