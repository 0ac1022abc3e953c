"""Annealing: spans of sweeps with a temperature schedule; neighbor lists and rounds are rebuilt between spans.

"The paper" is Buceta, Funke, Storandt, GRAPP 2025: see docs/glossary.md.
"""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtissue.compilation.batching import Batch
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.dynamics.coloring import CONFLICTS
from jaxtissue.dynamics.domain_runs import DomainRun, Played, domain_run
from jaxtissue.dynamics.independent_sets import independent_rounds, one_by_one, padded_orders, round_width
from jaxtissue.dynamics.local_updates import Neighborhoods, Scene, TissueState
from jaxtissue.dynamics.metropolis import warn_of_coarse_places
from jaxtissue.dynamics.replays import SPAN, Plan, Segment, Span, energies_together, play_spans
from jaxtissue.dynamics.spans import energy_terms, play, survey_state
from jaxtissue.dynamics.survey import Tissue, lines_of, survey_together
from jaxtissue.dynamics.sweep_log import Measured, SweepRecord, least_around, sweep_record
from jaxtissue.energy import Model, check_energy, check_numbers, in_precision
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import BackboneCoords
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution
from jaxtissue.neighbors.search import Attempt, tiling_defect
from jaxtissue.neighbors.shortlists import shortlist_length

ALGORITHMS = ("is-mh", "mh")
Advance = tuple["AnnealState", list[SweepRecord], Float[np.ndarray, "sweeps n *k d"]]


def renews_at(sweep: int) -> bool:
    """Whether lists and rounds are renewed after a sweep: more often at first, when cells move most."""
    return sweep <= 8 or sweep % (SPAN // 2 if sweep < 2 * SPAN else SPAN) == 0


class AnnealState(NamedTuple):
    """State of a run between two sweeps, from which the run can be continued bit for bit.

    Attributes:
        sweep: Number of sweeps done.
        positions: Axial position and angle in radians of each backbone, shape [n, 2]; on other domains coordinates of
            shape [n, 2] or unit vectors of shape [n, 3], or those of nodes, with one axis more.
        around: Internal: current size of the lists of cells around each cell.
    """

    sweep: int
    positions: Float[np.ndarray, "n *k d"]
    around: int = 0


class Annealer:
    """Metropolis-Hastings sweeps that you call from your own loop (paper, sections 3.2 and 3.3).

    `anneal` runs all sweeps in one call. Use `Annealer` to stop, save and continue a run, or to choose the algorithm.
    `start(positions)` returns the initial state. `advance(state)` runs a span of sweeps and returns the new state, a
    list of `SweepRecord` and the positions after each sweep, shape [sweeps of the span, n, 2]. A span ends where
    neighbor lists are rebuilt: after each of the first eight sweeps, later after every fifth and then every tenth.
    Call `advance` while `state.sweep < len(temperatures)`.

    To save a run, save the three fields of its `AnnealState`, a tuple; to continue, pass them to `advance` of an
    `Annealer` with the same arguments. The trajectory depends only on the arguments, the initial state and the kind of
    device.

    Args:
        model: Energy model; see `tube_model`.
        resolution: "draft", "standard" or "fine", or a `Resolution`.
        algorithm: "is-mh" (independent-set Metropolis-Hastings), in which moves that do not affect each other are
            decided together, or "mh", one move at a time in random order.
        seed: Seed of the moves, 0 to 2^32 - 1.
        temperatures: Temperature T of each sweep, in energy units, at least 0, shape [sweeps].
        conflicts: Rule by which two moves are not independent in "is-mh". "near" (the default): a cell touches both
            moving cells, or would after a move of mean length. "2-hop", "3-hop", "4-hop": the cells are within 2, 3 or
            4 contacts. "8-phi": the apical ends are closer than 8 covering radii, the paper's rule; `Tube` only.

    Attributes:
        compile_seconds: Time spent so far on compilation, in seconds.

    Raises:
        ValueError: If an argument is invalid, or if the energy is not finite (also raised by `advance`).

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
            raise ValueError(f"seed={seed} is out of range; give a whole number from 0 to 2^32 - 1")
        temperatures = np.asarray(temperatures, float)
        if not (np.isfinite(temperatures).all() and (temperatures >= 0).all()):
            raise ValueError("temperatures must be finite and at least 0; correct the temperature or the schedule")
        if conflicts == "8-phi" and isinstance(model.domain, Domain):
            raise ValueError("conflicts='8-phi' is available for tubes only; use 'near'")
        check_energy(model)
        dtype = jnp.result_type(float)
        self.model = in_precision(model, dtype)
        self.resolution, self.algorithm, self.conflicts = as_resolution(resolution), algorithm, conflicts
        self.seed, self.temperatures = seed, temperatures
        self.compile_seconds = 0.0
        self._lines: dict[int, tuple[Lines, Lines]] = {}  # for each number of cells
        self._last: tuple[Float[np.ndarray, "n *k d"], Any] | None = None  # the tissue measured last
        self._on_domain: DomainRun | None = None
        if isinstance(model.domain, Domain):
            self._on_domain = domain_run(self.model, resolution, seed, temperatures)

    @usual_modes()
    def start(self, positions: PositionsLike) -> AnnealState:
        """Return the `AnnealState` before the first sweep. Warns if the precision is too low for the moves.

        Args:
            positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2]; on other
                domains coordinates or unit vectors [n, d], or nodes of shape [n, k, d] or [n, k, d + 1]; see `anneal`.

        Raises:
            ValueError: If a position is invalid, or if the number of positions does not match the model.
        """
        domain = self.model.domain
        own = np.asarray(as_positions_on(positions, domain, bent=isinstance(domain, Domain)))
        check_numbers(self.model, len(own))
        if isinstance(domain, Tube):
            warn_of_coarse_places(self.model, len(own), own.dtype)
        return AnnealState(0, own)

    def record(self, state: AnnealState) -> SweepRecord:
        """Return a `SweepRecord` with the energy of a state, without running a sweep, as for the initial state."""
        return record_together([self], [state])[0]

    @usual_modes()
    def measure(self, positions: Float[np.ndarray, "n *k d"]) -> CellGeometry:
        """Measure volumes and lateral areas at positions [n, 2], with the resolution and adhesion of the annealing."""
        if self._on_domain:
            return self._on_domain.survey(positions, Batch()).state.cells.sizes
        (measured,) = survey_together([self._tissue(positions)], Batch())
        return measured.tissue.sizes

    def advance(self, state: AnnealState) -> Advance:
        """Run sweeps until the neighbor lists are rebuilt (after at most ten) or until the schedule ends.

        Returns:
            The new state, a list with one `SweepRecord` per sweep, and the positions after each sweep, [sweeps, n, 2].
        """
        return advance_together([self], [state])[0]

    def _known(self, positions: Float[np.ndarray, "n *k d"]) -> Any:
        """The tissue as measured last, if these are its positions."""
        return self._last[1] if self._last and np.array_equal(self._last[0], positions) else None

    def _tissue(self, positions: Float[np.ndarray, "n 2"]) -> Tissue:
        n = len(positions)
        if n not in self._lines:
            self._lines[n] = lines_of(self.model, n, self.resolution)
        return Tissue(positions, self.model, self._lines[n])

    def _plan(self, state: AnnealState, measured: Any) -> Plan:
        """The order of the moves up to the next rebuild: one by one, or in independent sets."""
        ahead, n = range(state.sweep + 1, len(self.temperatures)), len(state.positions)
        sweeps = next(filter(renews_at, ahead), len(self.temperatures)) - state.sweep
        if self.algorithm == "mh":
            return [one_by_one(self.seed, state.sweep + k, n) for k in range(sweeps)]
        return sweeps * [independent_rounds(self.conflicts, state.positions, self.model, measured.contacts)]

    def _span(self, state: AnnealState, measured: Measured) -> Span:
        """The sweeps up to the next rebuild."""
        tissue, segments = self._tissue(state.positions), [Segment(self._plan(state, measured))]
        return Span(tissue, measured, self.seed, state.sweep, self.temperatures, state.around, segments)

    def _prepare(self, state: AnnealState, first: Attempt, batch: Batch) -> None:
        """Begin to compile what a run will need: sweeps with lists and rounds of the likely widths, and energies."""
        n, dtype, tissue = len(state.positions), state.positions.dtype, self._tissue(state.positions)
        sides = first.sides
        if not first.has_all:  # it comes first, as it is needed first
            batch.prepare(tiling_defect, tissue.check_call(sides), light=True)
        if state.sweep < len(self.temperatures):
            if self.algorithm == "mh" or self.conflicts in ("near", "2-hop"):  # rounds are few
                blank: Any = np.zeros(n, dtype)
                reach: Any = np.zeros((n, 2, tissue.lines[0].row), dtype)
                sizes = CellGeometry(*(6 if self.model.has_surfaces else 2) * [blank])
                cells = TissueState(BackboneCoords(blank, blank, blank, blank), sizes, reach, blank > 0)
                few = np.zeros((n, 2, min(shortlist_length(n), sides.shape[2])), np.int32)
                near = Neighborhoods(np.zeros((n, max(least_around(n), state.around)), np.int32), few)
                rounds = np.zeros((n, 1) if self.algorithm == "mh" else (1, round_width(n)), np.int32)
                orders, temperatures = padded_orders([rounds], SPAN, near), np.zeros(SPAN, dtype)
                scene, draws = Scene(self.model, near, tissue.lines[0]), np.zeros((SPAN, 3, n), dtype)
                batch.prepare(play, (draws, cells, scene, temperatures, orders))
            table: Any = np.zeros((SPAN, n), dtype)
            sizes = CellGeometry(*(6 if self.model.has_surfaces else 2) * [table])
            batch.prepare(energy_terms, (sizes, self.model), light=True)
        batch.prepare(survey_state, tissue.survey_call(sides), light=True)

    def _rows(self, span: Span | Played, energies: Float[np.ndarray, "3 sweeps"], seconds: float) -> list[SweepRecord]:
        """A record of each sweep of a span, which took so many seconds each."""
        trail, rows = span.trail, []
        sweeps, n = trail.sizes.volume.shape
        for k in range(sweeps):
            info = jax.tree.map(lambda leaf, k=k: leaf[k], trail.info)
            row = sweep_record(span.sweep - sweeps + 1 + k, energies[:, k], n, self.temperatures, info)
            rows.append(row._replace(seconds=seconds))
        rows[-1] = rows[-1]._replace(drift=span.drift)
        return rows


@usual_modes()
def advance_together(annealers: Sequence[Annealer], states: Sequence[AnnealState], slots: int = 0) -> list[Advance]:
    """Advance several replicas at once, each with its own annealer, with the same results bit for bit as one by one.

    Replicas of the same resolution, number of cells and energy function run in one compiled program, distributed over
    the devices of the process; their seeds, tubes, constants and temperatures may differ. The program is compiled for
    `slots` replicas, by default for the given number. On domains other than `Tube` replicas run one after another.
    """
    if any(run._on_domain for run in annealers):
        if len(annealers) > 1:
            return [advance_together([run], [state])[0] for run, state in zip(annealers, states, strict=True)]
        return [_advance_on_domain(annealers[0], states[0])]
    begin, batch = time.perf_counter(), Batch(max(slots, len(annealers)))
    surveys = _survey(annealers, states, batch)
    spans = [run._span(state, tissue) for run, state, tissue in zip(annealers, states, surveys, strict=True)]
    play_spans(spans, batch)
    seconds = (time.perf_counter() - begin - batch.compile_seconds) / len(annealers)
    models, sizes = [run.model for run in annealers], [span.trail.sizes for span in spans]
    energies = energies_together(models, sizes, batch)
    advances = []
    for run, span, table in zip(annealers, spans, energies, strict=True):
        places = np.asarray(span.trail.positions)
        state = AnnealState(span.sweep, places[-1], span.around)
        run._last = state.positions.copy(), span.measured
        run.compile_seconds += batch.compile_seconds
        advances.append((state, run._rows(span, table, seconds / len(places)), places))
    return advances


def _advance_on_domain(run: Annealer, state: AnnealState) -> Advance:
    """`Annealer.advance` on a domain other than a tube."""
    begin, batch, on_domain = time.perf_counter(), Batch(), run._on_domain
    assert on_domain is not None
    (measured,) = _survey([run], [state], batch)
    played = on_domain.play(measured, run._plan(state, measured), state.sweep, batch)
    places = np.asarray(played.trail.positions)
    seconds = (time.perf_counter() - begin - batch.compile_seconds) / len(places)
    (table,) = energies_together([run.model], [played.trail.sizes], batch)
    run._last = places[-1].copy(), played.measured
    run.compile_seconds += batch.compile_seconds
    return AnnealState(played.sweep, places[-1]), run._rows(played, table, seconds), places


@usual_modes()
def record_together(annealers: Sequence[Annealer], states: Sequence[AnnealState], slots: int = 0) -> list[SweepRecord]:
    """Return the records of several replicas at once; see `Annealer.record` and `advance_together`."""
    batch = Batch(max(slots, len(annealers)))
    sizes = [measured.sizes for measured in _survey(annealers, states, batch)]
    energies = energies_together([run.model for run in annealers], sizes, batch)
    records = []
    for run, state, table in zip(annealers, states, energies, strict=True):
        run.compile_seconds += batch.compile_seconds
        records.append(sweep_record(state.sweep, table[:, 0], len(state.positions), run.temperatures))
    return records


def _survey(annealers: Sequence[Annealer], states: Sequence[AnnealState], batch: Batch) -> list[Any]:
    """Measure the whole tissue of each replica, unless it was the last that its annealer measured."""
    found = [run._known(state.positions) for run, state in zip(annealers, states, strict=True)]
    for k, run in enumerate(annealers):
        if run._on_domain and found[k] is None:
            found[k] = run._on_domain.survey(states[k].positions, batch)
            run._last = states[k].positions.copy(), found[k]
    unknown = [k for k, measured in enumerate(found) if measured is None]

    def foresee(number: int, first: Attempt) -> None:
        run = annealers[unknown[number]]
        if run._last is None:
            run._prepare(states[unknown[number]], first, batch)

    tissues = [annealers[k]._tissue(states[k].positions) for k in unknown]
    for k, measured in zip(unknown, survey_together(tissues, batch, foresee), strict=True):
        found[k], annealers[k]._last = measured, (states[k].positions.copy(), measured)
    return [measured for measured in found if measured is not None]
