"""Annealing: spans of sweeps, lists and rounds renewed between them, at a schedule of temperatures."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse

from jaxtissue.candidates import contact_graph, find_candidates, padded
from jaxtissue.cells import CellGeometry, Survey
from jaxtissue.changes import Neighborhoods, tissue_state
from jaxtissue.coloring import CONFLICTS, color, distance_conflicts, hop_conflicts
from jaxtissue.energy import Model
from jaxtissue.lines import Lines, Resolution, plan_lines
from jaxtissue.metropolis import SweepInfo, move_bound
from jaxtissue.shortlists import TOUCHES, around, find_unlisted, list_first, nearest_sides
from jaxtissue.spans import Trail, energy_terms, look, play
from jaxtissue.spread import covering_radius

ALGORITHMS = ("is-mh", "mh")
SPAN = 5  # the most sweeps between renewals of lists and rounds
CANDIDATES = 24  # on each side of a cell during a sweep: three times as many as bound a cell
MARGIN = 4  # longest moves by which a candidate may lie on the other side of a cell
WINDOW = (
    1.5  # mean cell widths on either side of a backbone that the first window of lines covers: most cells
)
ROUNDS = 32  # sets that the cells are spread over at least: coloring takes 36 to 45
CAPACITY = 64  # rounds are padded to a multiple of it
SPARSE = Resolution(4, 2)  # lines on which it is seen how clear of a cell its candidates are
PROGRAMS: dict[Any, Callable] = {}  # compiled, for all runs alike in shapes
EXACT = 1000  # rounding errors of the mean volume that a cell may be off by before its lists are doubted


def renews_at(sweep: int) -> bool:
    """Whether lists and rounds are renewed after a sweep: after each of the first, when cells move most."""
    return sweep <= 8 or sweep % SPAN == 0


class Measured(NamedTuple):
    """A state measured: its cells, and what was seen on the way."""

    seen: Survey
    sides: Int[np.ndarray, "n 2 candidates"]
    clear: Float[np.ndarray, "n 2 candidates"]

    def contacts(self, within: float = 0.0) -> sparse.csr_array:
        """Who stops whom, or could if one of them were moved by at most `within`: [n, n], symmetric."""
        return contact_graph(self.sides, self.clear < (within**2 if within else TOUCHES + 1))

    @property
    def sizes(self) -> Float[np.ndarray, "2 1 n"]:
        """Volumes and lateral areas of the cells."""
        return np.stack([self.seen.sizes.volume, self.seen.sizes.lateral_area])[:, None]


class AnnealState(NamedTuple):
    """All that a run needs to go on to the bit: sweeps done, backbones, and how wide its lists have grown."""

    sweep: int
    positions: Float[np.ndarray, "n 2"]
    widths: tuple[int, int] = (0, 0)  # of the candidates on each side, and of all who are around a cell


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


class Annealer:
    """Runs a tissue through a schedule of temperatures, one sweep at a time.

    `model` is what the energy depends on, `resolution` how finely cells are measured, `algorithm` "is-mh" or
    "mh". `conflicts` is the rule of move independence: "near", two moves conflict if one cell touches both
    movers, or could if they were moved as far as may be; 2, 3 or 4 hops of contact; or the paper's 8 phi.
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
        dtype = jnp.result_type(float)
        self.model = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), model)
        self.resolution, self.algorithm, self.conflicts = resolution, algorithm, conflicts
        self.seed, self.temperatures = seed, temperatures
        self._exactness = EXACT * float(jnp.finfo(dtype).eps) * float(self.model.mean_volume)
        self.compile_seconds = 0.0
        self._last: tuple[AnnealState, Measured] | None = None

    def start(self, positions: Float[Array | np.ndarray, "n 2"]) -> AnnealState:
        """The state before the first sweep."""
        return AnnealState(0, np.asarray(positions, jnp.result_type(float)))

    def record(self, state: AnnealState) -> SweepRecord:
        """The row of a state as it is, such as the initial one."""
        return self._rows(state.sweep, self._measure(state).sizes, None, 0.0)[0]

    def advance(
        self, state: AnnealState
    ) -> tuple[AnnealState, list[SweepRecord], Float[np.ndarray, "sweeps n 2"]]:
        """The sweeps up to the next at which lists are renewed, or to the schedule's last.

        The new state, a row for each sweep, and the backbones after each.
        """
        begin, compiled = time.perf_counter(), self.compile_seconds
        ahead = range(state.sweep + 1, len(self.temperatures))
        sweeps = next(filter(renews_at, ahead), len(self.temperatures)) - state.sweep
        after, trail, drift = self._play(state, self._rounds(state), sweeps)
        seconds = (time.perf_counter() - begin - (self.compile_seconds - compiled)) / sweeps
        sizes = np.stack([trail.volume, trail.lateral_area])
        rows = self._rows(state.sweep + 1, sizes, trail.info, seconds)
        rows[-1] = rows[-1]._replace(drift=drift)
        return after, rows, np.asarray(trail.positions)

    def _play(
        self, state: AnnealState, plan: list[Int[np.ndarray, "rounds width"]], sweeps: int
    ) -> tuple[AnnealState, Trail, float]:
        """Play the plan's rounds, sweep by sweep, on one set of candidate lists.

        Where a cell turns out to have lacked a candidate, it is listed and all is played again; in two
        halves, with lists renewed between them, where it was not even among those looked at before.
        """
        measured = self._measure(state)
        clear = measured.clear.copy()
        while True:
            near = _shortlists(measured.sides, clear, state.widths[1])
            after, trail = self._play_on(near, state, plan, sweeps)
            fresh = self._measure(after)
            missing = self._missing(fresh, near, trail)
            if not len(missing):
                break
            if not list_first(missing, measured.sides, clear):
                if sweeps == 1 and len(plan[0]) == 1:
                    break
                self._last = state, measured
                return self._play_halves(state, plan, sweeps)
        carried = np.stack([trail.volume[-1:], trail.lateral_area[-1:]])
        energies = [float(self._energies(sizes)[0, 0]) for sizes in (fresh.sizes, carried)]
        return after, trail, abs(energies[0] - energies[1]) / max(*map(abs, energies), 1e-300)

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
        widths = self._measure(state).sides.shape[2], near.around.shape[1]
        return AnnealState(state.sweep + sweeps, trail.positions[-1], widths), trail

    def _missing(self, fresh: Measured, near: Neighborhoods, trail: Trail) -> Int[np.ndarray, "pairs 2"]:
        """Cells not as they were carried along, and those who stop them without having been listed."""
        off = np.abs(fresh.sizes[:, 0] - [trail.volume[-1], trail.lateral_area[-1]]).max(axis=0)
        pairs = find_unlisted(np.asarray(fresh.seen.touched), fresh.sides, np.asarray(near.sides))
        return pairs[off[pairs[:, 0]] > self._exactness]

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

    def _plan(self, cells: int) -> Lines:
        return plan_lines(self.model.tube, cells, self.resolution, WINDOW)

    def _measure(self, state: AnnealState) -> "Measured":
        """Measure the whole tissue on complete lists; the last result is kept."""
        if self._last and self._last[0].positions is state.positions:
            return self._last[1]
        place, tube = jnp.asarray(state.positions), self.model.tube
        sides = self._find(place, state.widths[0])
        lines = self._plan(len(place)), plan_lines(tube, len(place), SPARSE)
        seen, clear = self._run(look, place, self.model, lines, sides)
        self._last = state, Measured(seen, sides, np.asarray(clear))
        return self._last[1]

    def _find(self, place: Float[Array, "n 2"], width: int) -> Int[np.ndarray, "n 2 candidates"]:
        """Complete candidate lists, at least of a width."""
        begin, first = time.perf_counter(), self._last is None
        margin = MARGIN * float(move_bound(self.model, len(place)))
        sides = find_candidates(place, self.model.tube, margin)
        self.compile_seconds += (time.perf_counter() - begin) * first
        return padded(sides, max(width, -(-sides.shape[2] // 24) * 24))

    def _rounds(self, state: AnnealState) -> list[Int[np.ndarray, "rounds width"]]:
        """For each sweep of a span the order of its moves: one by one, or in independent sets."""
        n = len(state.positions)
        if self.algorithm == "mh":
            orders = (np.random.default_rng([self.seed, state.sweep + k]).permutation(n) for k in range(SPAN))
            return [order.astype(np.int32)[:, None] for order in orders]
        if self.conflicts == "8-phi":
            apical = np.asarray(self.model.tube.embed(jnp.asarray(state.positions)).apical)
            radius = float(covering_radius(jnp.asarray(state.positions), self.model.tube))
            graph = distance_conflicts(apical, 8 * radius)
        elif self.conflicts == "near":
            graph = hop_conflicts(self._measure(state).contacts(float(move_bound(self.model, n))), 2)
        else:
            graph = hop_conflicts(self._measure(state).contacts(), int(self.conflicts[0]))
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

    def _energies(self, sizes: Float[np.ndarray, "2 sweeps n"]) -> Float[np.ndarray, "3 sweeps"]:
        """Energy and the paper's two terms of it after each sweep, summed in double precision."""
        terms = self._run(energy_terms, CellGeometry(*jnp.asarray(sizes)), self.model)
        return np.array([np.sum(term, axis=1, dtype=float) for term in terms])

    def _rows(
        self, first: int, sizes: Float[np.ndarray, "2 sweeps n"], info: SweepInfo | None, seconds: float
    ) -> list[SweepRecord]:
        """The rows of sweeps `first`, `first` + 1, ...; of a state as it is where nothing was done."""
        count, cells = sizes.shape[1:]
        spare = SPAN - count if info else 0
        energies = self._energies(np.pad(sizes, ((0, 0), (0, spare), (0, 0)), mode="edge"))
        rows = []
        for k in range(count):
            index = min(max(first + k - 1, 0), len(self.temperatures) - 1)
            accepted, collisions, left_cell, rounds, _ = (
                (leaf[k].item() for leaf in info) if info else 5 * [0]
            )
            rows.append(
                SweepRecord(
                    first + k,
                    *energies[:, k].tolist(),
                    temperature=float(self.temperatures[index]) if len(self.temperatures) else 0.0,
                    acceptance=accepted / cells,
                    rounds=rounds,
                    collisions=collisions,
                    seconds=seconds,
                    left_cell=left_cell,
                    drift=0.0,
                )
            )
        return rows


def _shortlists(
    sides: Int[np.ndarray, "n 2 candidates"], clear: Float[np.ndarray, "n 2 candidates"], width: int
) -> Neighborhoods:
    """The candidates of a few sweeps, and who is around each cell, at least of a width with room to grow."""
    few = nearest_sides(sides, clear, min(CANDIDATES, sides.shape[2]))
    lists = around(few)
    if lists.shape[1] > width:
        width = -(-int(1.1 * lists.shape[1]) // 16) * 16
    return Neighborhoods(padded(lists, width), few)
