"""Annealing: spans of sweeps, with neighbor lists and rounds renewed between them, by a schedule of temperatures."""

import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.batching import Ahead, Asker, Request, Task, run_together
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.dynamics.coloring import CONFLICTS
from jaxtissue.dynamics.independent_sets import independent_rounds, one_by_one, padded_orders, round_width
from jaxtissue.dynamics.local_updates import Neighborhoods, Scene, TissueState
from jaxtissue.dynamics.metropolis import draw, warn_of_coarse_places
from jaxtissue.dynamics.spans import Trail, energy_terms, fit_play, play
from jaxtissue.dynamics.survey import TissueSurvey
from jaxtissue.dynamics.sweep_log import Measured, SweepRecord, least_around, shortlist_neighbors, sweep_record
from jaxtissue.energy import Model, check_adhesion, check_energy, check_parameters, in_precision, require_finite
from jaxtissue.geometry.positions import as_positions, check_count
from jaxtissue.measurement.axial_lines import BackboneCoords
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution
from jaxtissue.neighbors.shortlists import find_unlisted, list_first, shortlist_length

ALGORITHMS = ("is-mh", "mh")
SPAN = 10  # the most sweeps between num_rebuilds of lists and rounds
EXACT = 1000  # rounding errors of the mean volume that a cell may be off by before its lists are doubted
Plan = Sequence[Int[np.ndarray, "rounds width"]]  # the rounds of some sweeps
Span = tuple["AnnealState", list[SweepRecord], Float[np.ndarray, "sweeps n 2"]]


def renews_at(sweep: int) -> bool:
    """Whether lists and rounds are renewed after a sweep: more often at first, when cells move most."""
    return sweep <= 8 or sweep % (SPAN // 2 if sweep < 2 * SPAN else SPAN) == 0


class AnnealState(NamedTuple):
    """The state of a run, from which it goes on to the same bits.

    Attributes:
        sweep: The number of sweeps done.
        positions: (axial, angle) of each backbone, [n, 2].
        around: The room for the cells around each cell, as far as it has grown.
    """

    sweep: int
    positions: Float[np.ndarray, "n 2"]
    around: int = 0


class Annealer:
    """Anneals a tissue by Metropolis-Hastings sweeps (paper, sections 3.2 and 3.3).

    A run depends on the seed, the state it starts from and the kind of device alone.

    Args:
        model: The energy; see `tube_model`.
        resolution: How finely cells are measured: a preset or layers and lines.
        algorithm: "is-mh", whose rounds are independent sets of moves, or "mh", with one move a round.
        seed: The seed of the moves, 0 to 2^32 - 1.
        temperatures: T of each sweep, [sweeps], in the unit of the energy.
        conflicts: The rule of move independence. By "near" two moves conflict if one cell touches both movers, or could
            if one moved by the mean length of a move; by "2-hop", "3-hop" and "4-hop" if their cells are within so many
            contacts; by "8-phi" if their apical ends are closer than 8 covering radii, the paper's rule.

    Raises:
        ValueError: If an argument cannot be run, such as an energy that overflows; `advance` raises it too.

    >>> import jaxtissue as jt
    >>> tube = jt.Tube(length=12, apical_radius=1, basal_radius=3)
    >>> annealer = Annealer(jt.tube_model(tube, 40), "draft", "is-mh", seed=0, temperatures=np.array([2.0, 1.0]))
    >>> state, records, trail = annealer.advance(annealer.start(tube.random_positions(jax.random.key(0), 40)))
    >>> state.sweep, len(records), trail.shape
    (1, 1, (1, 40, 2))
    """

    def __init__(
        self,
        model: Model,
        resolution: Resolution | str,
        algorithm: str,
        seed: int,
        temperatures: Float[np.ndarray, "sweeps"],
        conflicts: str = "near",
    ) -> None:
        if algorithm not in ALGORITHMS:
            raise ValueError(f"unknown algorithm {algorithm!r}; use {' or '.join(ALGORITHMS)}")
        if conflicts not in CONFLICTS:
            raise ValueError(f"unknown conflict rule {conflicts!r}; use one of {', '.join(CONFLICTS)}")
        if not 0 <= seed < 2**32:
            raise ValueError(f"seed={seed} is not within 0 and 2^32 - 1; give one that is")
        temperatures = np.asarray(temperatures, float)
        if not (np.isfinite(temperatures).all() and (temperatures >= 0).all()):
            raise ValueError("temperatures must be finite and at least 0; change the schedule")
        check_energy(model)
        dtype = jnp.result_type(float)
        self.model = in_precision(model, dtype)
        self.resolution, self.algorithm, self.conflicts = as_resolution(resolution), algorithm, conflicts
        self.seed, self.temperatures = seed, temperatures
        self._exactness = EXACT * float(jnp.finfo(dtype).eps) * float(self.model.mean_volume)
        self._asker = Asker()
        self._surveyor = TissueSurvey(self.model, self.resolution, self._asker)

    @property
    def compile_seconds(self) -> float:
        """The seconds that this annealer traced or waited for programs."""
        return self._asker.compile_seconds

    @usual_modes()
    def start(self, positions: Float[Array | np.ndarray, "n 2"]) -> AnnealState:
        """The state before the first sweep; warns where axial positions are too coarse for moves in this precision.

        Args:
            positions: (axial, angle) of each backbone, [n, 2], in any form that `as_positions` takes.

        Raises:
            ValueError: If `as_positions` refuses the positions, or if their number is not that of the model.
        """
        own = np.asarray(as_positions(positions, self.model.tube))
        check_count(len(own), self.model.tube, float(self.model.mean_volume))
        check_parameters(self.model.parameters, len(own))
        check_adhesion(self.model.adhesion, len(own))
        warn_of_coarse_places(self.model, len(own), own.dtype)
        return AnnealState(0, own)

    def record(self, state: AnnealState) -> SweepRecord:
        """Energy and settings of a state for which no sweep was run, as of the initial state: a `SweepRecord`."""
        return record_together([self], [state])[0]

    def measure(self, positions: Float[np.ndarray, "n 2"]) -> CellGeometry:
        """Volumes and lateral areas at positions [n, 2], with the resolution and adhesion of the annealing."""
        last = AnnealState(len(self.temperatures), positions)  # no sweep after it is compiled ahead
        (measured,) = run_together([self._measure(last)])
        return CellGeometry(measured.tissue.volume, measured.tissue.lateral_area)

    def advance(self, state: AnnealState) -> Span:
        """Play the sweeps up to the next renewal of the neighbor lists, or up to the last of the schedule.

        Returns:
            The new state, a record of each sweep, and the positions after each, [sweeps, n, 2].
        """
        return advance_together([self], [state])[0]

    def _record(self, state: AnnealState) -> Task[SweepRecord]:
        measured = yield from self._measure(state)
        energies = yield from self._energies(measured.sizes)
        return sweep_record(state.sweep, energies[:, 0], len(state.positions), self.temperatures)

    def _advance(self, state: AnnealState, replicas: int) -> Task[Span]:
        begin, compiled = time.perf_counter(), self.compile_seconds
        ahead = range(state.sweep + 1, len(self.temperatures))
        sweeps = next(filter(renews_at, ahead), len(self.temperatures)) - state.sweep
        plan = yield from self._rounds(state)
        after, trail, drift = yield from self._play(state, plan, sweeps)
        seconds = time.perf_counter() - begin - (self.compile_seconds - compiled)
        sizes = np.stack([trail.volume, trail.lateral_area])
        energies = yield from self._energies(sizes)
        rows = []
        for k in range(sweeps):
            info = jax.tree.map(lambda leaf, k=k: leaf[k], trail.info)
            number, cells = state.sweep + 1 + k, len(state.positions)
            row = sweep_record(number, energies[:, k], cells, self.temperatures, info)
            rows.append(row._replace(seconds=seconds / sweeps / replicas))
        rows[-1] = rows[-1]._replace(drift=drift)
        return after, rows, np.asarray(trail.positions)

    def _play(self, state: AnnealState, plan: Plan, sweeps: int) -> Task[tuple[AnnealState, Trail, float]]:
        """Play the plan's rounds, sweep by sweep, on one set of neighbor lists.

        Where a cell turns out to have lacked a candidate, it is listed and all is played again; in two halves, with
        lists renewed between them, where there was no room for it.
        """
        measured = yield from self._measure(state)
        sides, clear = measured.sides.copy(), measured.urgency()
        while True:
            near = shortlist_neighbors(sides, clear, state.around)
            after, trail = yield from self._play_on(near, state, measured, plan[:sweeps])
            fresh = yield from self._measure(after)
            missing = self._missing(fresh, near, trail)
            if not len(missing):
                break
            if not list_first(missing, sides, clear):
                if sweeps == 1 and len(plan[0]) == 1:
                    break
                self._surveyor.keep(state.positions, measured)
                return (yield from self._play_halves(state, plan, sweeps))
        carried = np.stack([trail.volume[-1:], trail.lateral_area[-1:]])
        if np.abs(fresh.sizes - carried).max() <= self._exactness / 100:
            return after, trail, 0.0  # nor is it, where the energy itself is but a rounding error
        energies = []
        for sizes in (fresh.sizes, carried):
            energies.append((yield from self._energies(sizes))[0, 0].item())
        return after, trail, abs(energies[0] - energies[1]) / max(*map(abs, energies), 1e-300)

    def _play_on(
        self, near: Neighborhoods, state: AnnealState, measured: Measured, plan: Plan
    ) -> Task[tuple[AnnealState, Trail]]:
        """Play the plan on given lists."""
        orders, sweeps = padded_orders(plan, SPAN, near), len(plan)
        n, dtype = len(state.positions), state.positions.dtype
        temperatures, draws = np.zeros(SPAN, dtype), np.zeros((SPAN, 3, n), dtype)
        temperatures[:sweeps] = self.temperatures[state.sweep : state.sweep + sweeps]
        for k in range(sweeps):
            draws[k] = draw(self.seed, state.sweep + k, n, dtype)
        scene = Scene(self.model, near, self._lines(state))
        arguments = (draws, measured.tissue, scene, temperatures, orders)
        needs = near.around.shape[1], orders.rounds.shape[1]
        answer = yield from self._asker.ask(Request(play, arguments, needs, fit_play))
        trail = jax.tree.map(lambda leaf: leaf[:sweeps], answer.result[1])
        return AnnealState(state.sweep + sweeps, trail.positions[-1], near.around.shape[1]), trail

    def _missing(self, fresh: Measured, near: Neighborhoods, trail: Trail) -> Int[np.ndarray, "pairs 2"]:
        """Pairs of a cell that differs from the one carried along and a neighbor that was not on its list."""
        off = np.abs(fresh.sizes[:, 0] - [trail.volume[-1], trail.lateral_area[-1]]).max(axis=0)
        cells = np.flatnonzero(off > self._exactness)
        return find_unlisted(cells, fresh.clear, fresh.sides, np.asarray(near.sides))

    def _play_halves(self, state: AnnealState, plan: Plan, sweeps: int) -> Task[tuple[AnnealState, Trail, float]]:
        """Half of the sweeps, or of the one sweep's rounds, and the other half on new lists."""
        if sweeps > 1:
            half = sweeps // 2
            middle, first, drift = yield from self._play(state, plan[:half], half)
            after, second, more = yield from self._play(middle, plan[half:], sweeps - half)
            trail = jax.tree.map(lambda a, b: np.concatenate([a, b]), first, second)
            return after, trail, max(drift, more)
        half = len(plan[0]) // 2
        middle, first, drift = yield from self._play(state, [plan[0][:half]], 1)
        middle = middle._replace(sweep=state.sweep)
        after, second, more = yield from self._play(middle, [plan[0][half:]], 1)
        info = jax.tree.map(lambda a, b: a + b, first.info, second.info)
        return after, second._replace(info=info), max(drift, more)

    def _measure(self, state: AnnealState) -> Task[Measured]:
        """Measure the whole tissue on complete lists."""
        return self._surveyor.measure(state.positions, partial(self._expected, state))

    def _expected(self, state: AnnealState, sides: Int[np.ndarray, "n 2 candidates"]) -> Iterator[Ahead]:
        """The programs that will be asked for: sweeps with lists and rounds of the likely widths, and energies."""
        n, dtype, lines = len(state.positions), state.positions.dtype, self._lines(state)
        if state.sweep == len(self.temperatures):
            return
        if self.algorithm == "mh" or self.conflicts in ("near", "2-hop"):  # rounds are few
            blank: Any = np.zeros(n, dtype)
            reach: Any = np.zeros((n, 2, lines.row), dtype)
            tissue = TissueState(BackboneCoords(blank, blank, blank, blank), blank, blank, reach, blank > 0)
            few = np.zeros((n, 2, min(shortlist_length(n), sides.shape[2])), np.int32)
            near = Neighborhoods(np.zeros((n, max(least_around(n), state.around)), np.int32), few)
            rounds = np.zeros((n, 1) if self.algorithm == "mh" else (1, round_width(n)), np.int32)
            orders, temperatures = padded_orders([rounds], SPAN, near), np.zeros(SPAN, dtype)
            draws = np.zeros((SPAN, 3, n), dtype)
            yield Ahead(play, (draws, tissue, Scene(self.model, near, lines), temperatures, orders))
        table: Any = np.zeros((SPAN, n), dtype)
        yield Ahead(energy_terms, (CellGeometry(table, table), self.model), seldom=True)

    def _lines(self, state: AnnealState) -> Lines:
        """The lines on which cells are measured."""
        return self._surveyor.lines(len(state.positions))[0]

    def _rounds(self, state: AnnealState) -> Task[Plan]:
        """For each sweep of a span the order of its moves: one by one, or in independent sets."""
        if self.algorithm == "mh":
            return [one_by_one(self.seed, state.sweep + k, len(state.positions)) for k in range(SPAN)]
        measured = yield from self._measure(state)
        return SPAN * [independent_rounds(self.conflicts, state.positions, self.model, measured.contacts)]

    def _energies(self, sizes: Float[np.ndarray, "2 sweeps n"]) -> Task[Float[np.ndarray, "3 sweeps"]]:
        """Energy and the paper's two terms of it after each sweep, summed in double precision."""
        count = sizes.shape[1]
        padded_sizes = np.pad(sizes, ((0, 0), (0, SPAN - count), (0, 0)), mode="edge")  # one program for all
        request = Request(energy_terms, (CellGeometry(*padded_sizes), self.model), seldom=True)
        answer = yield from self._asker.ask(request)
        require_finite(answer.result[0], self.model)
        return np.array([np.sum(term[:count], axis=1, dtype=float) for term in answer.result])


@usual_modes()
def advance_together(annealers: Sequence[Annealer], states: Sequence[AnnealState], slots: int = 0) -> list[Span]:
    """`Annealer.advance` for several replicas at once, each its own annealer, to the same bits as alone.

    Replicas alike in resolution, number of cells and energy function run in one compiled program, [replicas, n], spread
    over the devices of this process; seeds, tubes, constants and temperatures are free. The program is compiled for
    `slots` replicas, or for as many as there are.
    """
    count = len(annealers)
    tasks = [annealer._advance(state, count) for annealer, state in zip(annealers, states, strict=True)]
    return run_together(tasks, slots)


@usual_modes()
def record_together(annealers: Sequence[Annealer], states: Sequence[AnnealState], slots: int = 0) -> list[SweepRecord]:
    """`Annealer.record` for several replicas at once, as `advance_together`."""
    tasks = [annealer._record(state) for annealer, state in zip(annealers, states, strict=True)]
    return run_together(tasks, slots)
