"""Annealing: sweep after sweep, lists and rounds renewed between them, at a schedule of temperatures."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse

from jaxtissue.candidates import REACH, contact_graph, find_candidates, hop_lists, padded, sided
from jaxtissue.cells import CellGeometry
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
ROUNDS = 42  # sets that the cells are spread over at least: coloring 3 hops takes 33 to 46
CAPACITY = 64  # rounds are padded to a multiple of it
EXACT = 1000  # rounding errors of the mean volume that a cell may be off by before its lists are doubted


class Measured(NamedTuple):
    """A state measured: its cells, the lists used, and who touches whom."""

    tissue: TissueState
    near: Neighborhoods
    contacts: sparse.csr_array
    overflow: bool


class AnnealState(NamedTuple):
    """All that a run needs to go on to the bit: sweeps done, backbones, their candidates, the lines."""

    sweep: int
    positions: Float[np.ndarray, "n 2"]
    neighbors: Int[np.ndarray, "n candidates"]
    circle: tuple[int, ...]
    half: tuple[int, ...]


class SweepRecord(NamedTuple):
    """One row of a run: the tissue after a sweep, and what the sweep did.

    `drift` is the relative difference of the energy carried along by local differences to one measured afresh
    with new candidate lists; `left_cell` counts the moves proposed out of their own cell.
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


def numbered_sweep(
    seed: Array, number: Array, *arguments: Any, lines: Lines
) -> tuple[TissueState, SweepInfo]:
    """Sweep `number` of the run with this seed: its key is the seed's, folded with the number."""
    return sweep(jax.random.fold_in(jax.random.key(seed), number), *arguments, lines=lines)


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
        self._compiled: dict[Any, Callable] = {}
        self._last: tuple[AnnealState, Measured] | None = None

    def start(self, positions: Float[Array | np.ndarray, "n 2"]) -> AnnealState:
        """The state before the first sweep."""
        begin = time.perf_counter()
        tube, place = self.model.tube, jnp.asarray(positions, jnp.result_type(float))
        lists = self._fit(find_candidates(place, tube), place)
        lines = plan_lines(tube, len(place), self.resolution, REACH)
        self.compile_seconds += time.perf_counter() - begin
        state = AnnealState(0, np.asarray(place), lists, lines.circle, lines.half)
        while self._measure(state).overflow:
            state = self._widen(state)
        return state

    def record(self, state: AnnealState) -> SweepRecord:
        """The row of a state as it is, such as the initial one."""
        return self._row(state.sweep, self._measure(state).tissue, None, 0.0, 0.0)

    def advance(self, state: AnnealState) -> tuple[AnnealState, SweepRecord]:
        """One sweep: a move for every cell; the new state and its row."""
        begin, compiled = time.perf_counter(), self.compile_seconds
        rounds = self._rounds(state)
        after, info, drift = self._play(state, rounds)
        after = after._replace(sweep=state.sweep + 1)
        measured = self._measure(after)
        seconds = time.perf_counter() - begin - (self.compile_seconds - compiled)
        return after, self._row(after.sweep, measured.tissue, info, seconds, drift)

    def _play(
        self, state: AnnealState, rounds: Int[np.ndarray, "rounds width"]
    ) -> tuple[AnnealState, SweepInfo, float]:
        """Play the rounds on one set of candidate lists; in two halves where the lists turn out too short."""
        measured = self._measure(state)
        capacity = -(-len(rounds) // CAPACITY) * CAPACITY
        plan = np.pad(rounds, ((0, capacity - len(rounds)), (0, 0)), constant_values=-1)
        temperature = np.asarray(self.temperatures[state.sweep], measured.tissue.volume.dtype)
        draw, order = (np.uint32(self.seed), np.int32(state.sweep)), (plan, np.int32(len(rounds)))
        tissue, info = self._run(
            numbered_sweep,
            *draw,
            measured.tissue,
            self.model,
            temperature,
            measured.near,
            *order,
            lines=_lines(state),
        )
        positions = np.stack([tissue.place.axial, tissue.place.angle], axis=-1)
        after = self._renew(state._replace(positions=positions))
        if info.overflow or self._measure(after).overflow:
            return self._play(self._widen(state), rounds)
        fresh = self._measure(after).tissue
        stale = max(np.abs(np.subtract(a, b)).max() for a, b in zip(fresh[1:3], tissue[1:3], strict=True))
        if stale > self._exactness and len(rounds) > 1:
            half = len(rounds) // 2
            middle, first, drift = self._play(state, rounds[:half])
            after, second, more = self._play(middle, rounds[half:])
            return after, jax.tree.map(lambda a, b: a + b, first, second), max(drift, more)
        energy, carried = (self._energies(cells)[0] for cells in (fresh, tissue))
        return after, jax.device_get(info), abs(energy - carried) / max(abs(energy), abs(carried), 1e-300)

    def _renew(self, state: AnnealState) -> AnnealState:
        """New candidate lists for backbones that have moved."""
        measured = self._measure(state)
        lists = hop_lists(measured.contacts, state.positions, self.model.tube)
        width = state.neighbors.shape[1]
        if lists.shape[1] > width:
            lists = self._fit(lists, state.positions)
        return state._replace(neighbors=padded(lists, width))

    def _widen(self, state: AnnealState) -> AnnealState:
        """Wider windows of lines, for a tissue whose cells have outgrown them."""
        half = [min((c + 1) // 2, -(-3 * h // 2)) for c, h in zip(state.circle, state.half, strict=True)]
        return state._replace(half=tuple(half))

    def _measure(self, state: AnnealState) -> "Measured":
        """Measure the whole tissue on the state's lists and lines; the last result is kept."""
        if self._last and all(a is b for a, b in zip(self._last[0][1:], state[1:], strict=True)):
            return self._last[1]
        lists = state.neighbors
        sides = sided(lists, state.positions, self.model.tube, 2 * float(move_bound(self.model, len(lists))))
        near = Neighborhoods(lists, padded(sides, _side_width(lists.shape[1])))
        tissue, survey = self._run(tissue_state, state.positions, self.model, near, lines=_lines(state))
        contacts = contact_graph(state.positions, self.model.tube, np.asarray(near.sides), survey)
        self._last = state, Measured(tissue, near, contacts, bool(np.any(survey.overflow)))
        return self._last[1]

    def _fit(
        self, lists: Int[np.ndarray, "n candidates"], positions: Float[Array | np.ndarray, "n 2"]
    ) -> Int[np.ndarray, "n candidates"]:
        """Candidate lists padded with room to grow, in both their forms: shapes then last for the run."""
        margin = 2 * float(move_bound(self.model, len(lists)))
        width = -(-int(1.15 * lists.shape[1]) // 8) * 8
        while _side_width(width) < 1.1 * sided(lists, positions, self.model.tube, margin).shape[2]:
            width += 8
        return padded(lists, width)

    def _rounds(self, state: AnnealState) -> Int[np.ndarray, "rounds width"]:
        """The cells in the order they are visited: one by one, or in independent sets."""
        n = len(state.positions)
        if self.algorithm == "mh":
            return np.random.default_rng([self.seed, state.sweep]).permutation(n).astype(np.int32)[:, None]
        if self.conflicts == "8-phi":
            apical = np.asarray(self.model.tube.embed(jnp.asarray(state.positions)).apical)
            radius = float(covering_radius(jnp.asarray(state.positions), self.model.tube))
            graph = distance_conflicts(apical, 8 * radius)
        else:
            graph = hop_conflicts(self._measure(state).contacts, int(self.conflicts[0]))
        return color(graph, max(1, round(n / ROUNDS)))

    def _run(self, function: Callable, *arguments: Any, **static: Lines) -> Any:
        """Call a jitted function, compiled beforehand so that its compile time is known."""
        arguments = jax.tree.map(jnp.asarray, arguments)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(arguments))
        known = (function, *static.values(), shapes)
        if known not in self._compiled:
            begin = time.perf_counter()
            jitted = jax.jit(function, static_argnames=tuple(static))
            self._compiled[known] = jitted.lower(*arguments, **static).compile()
            self.compile_seconds += time.perf_counter() - begin
        return jax.block_until_ready(self._compiled[known](*arguments))

    def _energies(self, tissue: TissueState) -> list[float]:
        """The energy, and the paper's two terms of it, each summed in double precision."""
        cells = CellGeometry(tissue.volume, tissue.lateral_area)
        return [float(np.sum(term, dtype=float)) for term in self._run(energy_terms, cells, self.model)]

    def _row(
        self, number: int, tissue: TissueState, info: SweepInfo | None, seconds: float, drift: float
    ) -> SweepRecord:
        energy, volume_energy, area_energy = self._energies(tissue)
        index = min(max(number - 1, 0), len(self.temperatures) - 1)
        return SweepRecord(
            sweep=number,
            energy=energy,
            volume_energy=volume_energy,
            area_energy=area_energy,
            temperature=float(self.temperatures[index]) if len(self.temperatures) else 0.0,
            acceptance=int(info.accepted) / len(tissue.volume) if info else 0.0,
            rounds=int(info.rounds) if info else 0,
            collisions=int(info.collisions) if info else 0,
            seconds=seconds,
            left_cell=int(info.left_cell) if info else 0,
            drift=drift,
        )


def _lines(state: AnnealState) -> Lines:
    return Lines(state.circle, state.half)


def _side_width(width: int) -> int:
    """Room for candidates on one side of a cell, given that for all."""
    return -(-7 * width // 80) * 8
