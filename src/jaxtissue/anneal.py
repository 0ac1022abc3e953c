"""Annealing: chunks of sweeps, lists and rounds renewed between them, at a schedule of temperatures."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse

from jaxtissue.candidates import (
    around,
    clearance,
    contact_graph,
    find_candidates,
    nearest_sides,
    padded,
)
from jaxtissue.cells import CellGeometry, Survey, measure_cells
from jaxtissue.coloring import color, distance_conflicts, hop_conflicts
from jaxtissue.energy import Model, lateral_tension, volume_elasticity
from jaxtissue.lines import Lines, Resolution, plan_lines
from jaxtissue.metropolis import (
    Neighborhoods,
    SweepInfo,
    TissueState,
    move_bound,
    sweep,
    tissue_state,
)
from jaxtissue.spread import covering_radius

ALGORITHMS = ("is-mh", "mh")
CONFLICTS = ("2-hop", "3-hop", "4-hop", "8-phi")
SPAN = 5  # sweeps between renewals of lists and rounds, at the sweeps that it divides
CANDIDATES = 24  # on each side of a cell during a sweep: three times as many as bound a cell
MARGIN = 4  # longest moves by which a candidate may lie on the other side of a cell
WINDOW = (
    1.5  # mean cell widths on either side of a backbone that the first window of lines covers: most cells
)
ROUNDS = 42  # sets that the cells are spread over at least: coloring 3 hops takes 33 to 46
CAPACITY = 64  # rounds are padded to a multiple of it
SPARSE = Resolution(4, 2)  # lines on which it is seen how clear of a cell its candidates are
PROGRAMS: dict[Any, Callable] = {}  # compiled, for all runs alike in shapes
EXACT = 1000  # rounding errors of the mean volume that a cell may be off by before its lists are doubted


class Measured(NamedTuple):
    """A state measured: its cells, what was seen on the way, and who touches whom."""

    seen: Survey
    sides: Int[np.ndarray, "n 2 candidates"]
    clear: Float[np.ndarray, "n 2 candidates"]
    contacts: sparse.csr_array

    @property
    def cells(self) -> CellGeometry:
        """The sizes of the cells."""
        return self.seen.sizes


class AnnealState(NamedTuple):
    """All that a run needs to go on to the bit: sweeps done, backbones."""

    sweep: int
    positions: Float[np.ndarray, "n 2"]


class SweepRecord(NamedTuple):
    """One row of a run: the tissue after a sweep, and what the sweep did.

    `drift` is the relative difference of the energy carried along by local differences to one measured afresh
    with new candidate lists, where lists were renewed after the sweep, else 0; `left_cell` counts the moves
    proposed out of their own cell.
    """

    sweep: int
    energy: float
    volume_energy: float
    area_energy: float
    temperature: float
    acceptance: float
    rounds: int
    collisions: int
    seconds: float
    left_cell: int
    drift: float


class Trail(NamedTuple):
    """Sweep by sweep: sizes and backbones after each, and what it did, [sweeps, ...]."""

    volume: Float[np.ndarray, "sweeps n"]
    lateral_area: Float[np.ndarray, "sweeps n"]
    positions: Float[np.ndarray, "sweeps n 2"]
    info: SweepInfo


def constant_schedule(temperature: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """The same temperature at every sweep."""
    return np.full(sweeps, float(temperature))


def geometric_schedule(first: float, last: float, sweeps: int) -> Float[np.ndarray, "sweeps"]:
    """Temperatures from `first` to `last` by a constant factor; `ValueError` unless both are positive."""
    if not (first > 0 and last > 0):
        raise ValueError(f"temperatures {first} and {last}: a geometric schedule needs both above 0")
    return np.geomspace(first, last, sweeps) if sweeps > 1 else np.full(sweeps, float(first))


def has_stalled(energies: Sequence[float], patience: int) -> bool:
    """Whether the last `patience` energies hold no new minimum; never for a patience of 0."""
    return bool(0 < patience < len(energies) and min(energies[-patience:]) >= min(energies[:-patience]))


def look(
    positions: Float[Array, "n 2"],
    model: Model,
    lines: tuple[Lines, Lines],
    sides: Int[Array, "n 2 candidates"],
) -> tuple[Survey, Float[Array, "n 2 candidates"]]:
    """Measure a whole tissue, and on fewer lines how clear of each cell its candidates are."""
    _, seen = measure_cells(positions, model.tube, lines[0], sides)
    return seen, jnp.where(seen.touched, -1, clearance(positions, model.tube, lines[1], sides))


def play(
    seed: Int[Array, ""],
    first: Int[Array, ""],
    state: TissueState,
    model: Model,
    temperatures: Float[Array, "sweeps"],
    near: Neighborhoods,
    plan: tuple[Int[Array, "sweeps rounds width"], Int[Array, "sweeps"]],
    lines: Lines,
) -> tuple[TissueState, Trail]:
    """Sweeps `first`, `first` + 1, ... of the run with this seed: each has the seed's key, folded with its number.

    A sweep without rounds is none: so fewer sweeps than temperatures need no program of their own.
    """

    def one(state: TissueState, this: tuple) -> tuple[TissueState, Trail]:
        number, temperature, rounds, count = this
        key = jax.random.fold_in(jax.random.key(seed), number)
        state, info = sweep(key, state, model, temperature, near, rounds, count, lines)
        positions = jnp.stack([state.place.axial, state.place.angle], axis=-1)
        return state, Trail(state.volume, state.lateral_area, positions, info)

    numbers = first + jnp.arange(len(temperatures))
    return jax.lax.scan(one, state, (numbers, temperatures, *plan))


def energy_terms(cells: CellGeometry, model: Model) -> tuple[Array, Array, Array]:
    """Each cell's energy, and of it the paper's two terms."""
    return model.cell_energy(cells, model), volume_elasticity(cells, model), lateral_tension(cells, model)


class Annealer:
    """Runs a tissue through a schedule of temperatures, one sweep at a time.

    `model` is what the energy depends on, `resolution` how finely cells are measured, `algorithm` "is-mh" or
    "mh", `conflicts` the rule of move independence (2, 3 or 4 hops of contact, or the paper's 8 phi).
    A run is a function of `seed` and of the state it starts from alone. Raises `ValueError` for what it can't
    run.
    """

    def __init__(
        self,
        model: Model,
        resolution: Resolution,
        algorithm: str,
        seed: int,
        temperatures: Float[np.ndarray, "sweeps"],
        conflicts: str = "3-hop",
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
        dtype = jnp.result_type(float)
        self.model = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), model)
        self.resolution, self.algorithm, self.conflicts = resolution, algorithm, conflicts
        self.seed, self.temperatures = seed, temperatures
        self._exactness = EXACT * float(jnp.finfo(dtype).eps) * float(self.model.mean_volume)
        self.compile_seconds = 0.0
        self._last: tuple[AnnealState, Measured] | None = None
        self._around = 48

    def start(self, positions: Float[Array | np.ndarray, "n 2"]) -> AnnealState:
        """The state before the first sweep."""
        return AnnealState(0, np.asarray(positions, jnp.result_type(float)))

    def record(self, state: AnnealState) -> SweepRecord:
        """The row of a state as it is, such as the initial one."""
        cells = self._measure(state).cells
        return self._rows(state.sweep, (cells.volume[None], cells.lateral_area[None]), None, 0.0)[0]

    def advance(
        self, state: AnnealState
    ) -> tuple[AnnealState, list[SweepRecord], Float[np.ndarray, "sweeps n 2"]]:
        """The sweeps up to the next that `SPAN` divides, or the schedule's last: a move for every cell in each.

        The new state, a row for each sweep, and the backbones after each.
        """
        begin, compiled = time.perf_counter(), self.compile_seconds
        sweeps = min(SPAN - state.sweep % SPAN, len(self.temperatures) - state.sweep)
        after, trail, drift = self._play(state, self._rounds(state), sweeps)
        seconds = (time.perf_counter() - begin - (self.compile_seconds - compiled)) / sweeps
        rows = self._rows(state.sweep + 1, (trail.volume, trail.lateral_area), trail.info, seconds)
        rows[-1] = rows[-1]._replace(drift=drift)
        return after, rows, trail.positions

    def _play(
        self, state: AnnealState, plan: list[Int[np.ndarray, "rounds width"]], sweeps: int
    ) -> tuple[AnnealState, Trail, float]:
        """Play the plan's rounds, sweep by sweep, on one set of candidate lists.

        Where a cell turns out to have lacked a candidate, it is listed and all is played again; in two halves,
        with lists renewed between them, where it was not even among those looked at before.
        """
        measured = self._measure(state)
        clear = measured.clear.copy()
        while True:
            near = self._near(measured.sides, clear)
            after, trail = self._play_on(near, state, plan, sweeps)
            fresh = self._measure(after)
            missing = self._missing(fresh, near, trail)
            if not len(missing):
                break
            if not _list_first(missing, measured.sides, clear):
                if sweeps == 1 and len(plan[0]) == 1:
                    break
                self._last = state, measured
                return self._play_halves(state, plan, sweeps)
        sizes = (
            (fresh.cells.volume[None], fresh.cells.lateral_area[None]),
            (trail.volume[-1:], trail.lateral_area[-1:]),
        )
        energy, carried = (self._energies(*pair)[0, 0] for pair in sizes)
        return after, trail, abs(energy - carried) / max(abs(energy), abs(carried), 1e-300)

    def _play_on(
        self,
        near: Neighborhoods,
        state: AnnealState,
        plan: list[Int[np.ndarray, "rounds width"]],
        sweeps: int,
    ) -> tuple[AnnealState, Trail]:
        """Play the plan on given lists."""
        capacity = -(-max(map(len, plan)) // CAPACITY) * CAPACITY
        rounds = np.full((SPAN, capacity, plan[0].shape[1]), -1, np.int32)
        counts, temperatures = np.zeros(SPAN, np.int32), np.zeros(SPAN, state.positions.dtype)
        for k in range(sweeps):
            rounds[k, : len(plan[k])], counts[k] = plan[k], len(plan[k])
            temperatures[k] = self.temperatures[state.sweep + k]
        tissue = self._run(tissue_state, state.positions, self._measure(state).seen)
        draw, order = (np.uint32(self.seed), np.int32(state.sweep)), (rounds, counts)
        lines = self._plan(len(state.positions))
        _, trail = self._run(play, *draw, tissue, self.model, temperatures, near, order, lines)
        trail = jax.tree.map(lambda leaf: np.asarray(leaf[:sweeps]), trail)
        return AnnealState(state.sweep + sweeps, trail.positions[-1]), trail

    def _missing(self, fresh: Measured, near: Neighborhoods, trail: Trail) -> Int[np.ndarray, "missing 2"]:
        """Cells that are stopped by one that their few candidates lacked, and are not as they were carried along;
        and those who stop them."""
        cell, side, at = np.nonzero(np.asarray(fresh.seen.touched))
        rival = fresh.sides[cell, side, at]
        listed = (np.asarray(near.sides)[cell, side] == rival[:, None]).any(axis=1)
        off = [
            np.abs(np.subtract(measured, carried[-1]))[cell]
            for measured, carried in (
                (fresh.cells.volume, trail.volume),
                (fresh.cells.lateral_area, trail.lateral_area),
            )
        ]
        stale = ~listed & (np.max(off, axis=0) > self._exactness)
        return np.stack([cell, rival], axis=1)[stale]

    def _play_halves(self, state: AnnealState, plan: list, sweeps: int) -> tuple[AnnealState, Trail, float]:
        """Half of the sweeps, or of the one sweep's rounds, and the other half on new lists."""
        if sweeps > 1:
            half = sweeps // 2
            middle, first, drift = self._play(state, plan[:half], half)
            after, second, more = self._play(middle, plan[half:], sweeps - half)
            trail = jax.tree.map(lambda a, b: np.concatenate([a, b]), first, second)
            return after, trail, max(drift, more)
        half = len(plan[0]) // 2
        middle, first, drift = self._play(state, [plan[0][:half]], 1)
        after, second, more = self._play(middle._replace(sweep=state.sweep), [plan[0][half:]], 1)
        info = jax.tree.map(lambda a, b: a + b, first.info, second.info)
        return after, second._replace(info=info), max(drift, more)

    def _near(
        self, sides: Int[np.ndarray, "n 2 candidates"], clear: Float[np.ndarray, "n 2 candidates"]
    ) -> Neighborhoods:
        """The candidates of a few sweeps, of those measured."""
        few = nearest_sides(sides, clear, min(CANDIDATES, sides.shape[2]))
        lists = around(few)
        self._around = max(self._around, -(-lists.shape[1] // 16) * 16)  # only grows, and seldom
        return Neighborhoods(padded(lists, self._around), few)

    def _plan(self, cells: int) -> Lines:
        return plan_lines(self.model.tube, cells, self.resolution, WINDOW)

    def _measure(self, state: AnnealState) -> "Measured":
        """Measure the whole tissue on complete lists; the last result is kept."""
        if self._last and self._last[0].positions is state.positions:
            return self._last[1]
        place, tube = jnp.asarray(state.positions), self.model.tube
        sides = self._find(place)
        sparse_lines = plan_lines(tube, len(place), SPARSE)
        lines = self._plan(len(place)), sparse_lines
        seen, clear = self._run(look, place, self.model, lines, sides)
        self._last = state, Measured(seen, sides, np.asarray(clear), contact_graph(sides, seen.touched))
        return self._last[1]

    def _find(self, place: Float[Array, "n 2"]) -> Int[np.ndarray, "n 2 candidates"]:
        """Complete candidate lists, wide enough for a run to keep its shapes."""
        begin, first = time.perf_counter(), self._last is None
        margin = MARGIN * float(move_bound(self.model, len(place)))
        sides = find_candidates(place, self.model.tube, margin)
        self.compile_seconds += (time.perf_counter() - begin) * first
        return sides

    def _rounds(self, state: AnnealState) -> list[Int[np.ndarray, "rounds width"]]:
        """For each sweep of a chunk the cells in the order they are visited: one by one, or in independent sets."""
        n = len(state.positions)
        if self.algorithm == "mh":
            orders = (np.random.default_rng([self.seed, state.sweep + k]).permutation(n) for k in range(SPAN))
            return [order.astype(np.int32)[:, None] for order in orders]
        if self.conflicts == "8-phi":
            apical = np.asarray(self.model.tube.embed(jnp.asarray(state.positions)).apical)
            radius = float(covering_radius(jnp.asarray(state.positions), self.model.tube))
            graph = distance_conflicts(apical, 8 * radius)
        else:
            graph = hop_conflicts(self._measure(state).contacts, int(self.conflicts[0]))
        return SPAN * [color(graph, max(1, round(n / ROUNDS)))]

    def _run(self, function: Callable, *arguments: Any) -> Any:
        """Call a jitted function, compiled beforehand so that its compile time is known."""
        arguments = jax.tree.map(jnp.asarray, arguments)
        leaves, structure = jax.tree.flatten(arguments)
        known = (function, structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
        if known not in PROGRAMS:
            begin = time.perf_counter()
            PROGRAMS[known] = jax.jit(function).lower(*arguments).compile()
            self.compile_seconds += time.perf_counter() - begin
        return jax.block_until_ready(PROGRAMS[known](*arguments))

    def _energies(self, volume: np.ndarray, lateral_area: np.ndarray) -> np.ndarray:
        """The energy, and the paper's two terms of it, of each sweep, summed in double precision, [3, sweeps]."""
        cells = CellGeometry(volume, lateral_area)
        return np.array(
            [np.sum(term, axis=1, dtype=float) for term in self._run(energy_terms, cells, self.model)]
        )

    def _rows(
        self, first: int, sizes: tuple[np.ndarray, np.ndarray], info: SweepInfo | None, seconds: float
    ) -> list[SweepRecord]:
        count, cells = sizes[0].shape
        padding = ((0, SPAN - count), (0, 0)) if info else ((0, 0), (0, 0))
        terms = self._energies(*(np.pad(size, padding, mode="edge") for size in sizes))
        rows = []
        for k, (energy, volume_energy, area_energy) in enumerate(terms.T[:count].tolist()):
            index = min(max(first + k - 1, 0), len(self.temperatures) - 1)
            did = SweepInfo(*(leaf[k].item() for leaf in info)) if info else SweepInfo(0, 0, 0, 0, 0.0)
            rows.append(
                SweepRecord(
                    sweep=first + k,
                    energy=energy,
                    volume_energy=volume_energy,
                    area_energy=area_energy,
                    temperature=float(self.temperatures[index]) if len(self.temperatures) else 0.0,
                    acceptance=did.accepted / cells,
                    rounds=did.rounds,
                    collisions=did.collisions,
                    seconds=seconds,
                    left_cell=did.left_cell,
                    drift=0.0,
                )
            )
        return rows


def _list_first(
    missing: Int[np.ndarray, "missing 2"],
    sides: Int[np.ndarray, "n 2 candidates"],
    clear: Float[np.ndarray, "n 2 candidates"],
) -> bool:
    """Let pairs head each other's lists; whether any did not yet."""
    news = False
    for pair in missing:
        for cell, rival in (pair, pair[::-1]):
            here = sides[cell] == rival
            news |= bool((clear[cell][here] >= 0).any())
            clear[cell][here] = -1
    return news
