"""Table 1: seconds of a sweep by each algorithm, taken in turns, and rounds under each rule."""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import sparse

from jaxtissue.compilation.batching import Batch
from jaxtissue.diagram.spread import covering_radius, separation
from jaxtissue.dynamics.annealer import Annealer, AnnealState
from jaxtissue.dynamics.coloring import CONFLICTS, color, distance_conflicts, hop_conflicts
from jaxtissue.dynamics.independent_sets import MEAN_MOVE, one_by_one
from jaxtissue.dynamics.metropolis import draw, move_bound, propose
from jaxtissue.dynamics.replays import SPAN
from jaxtissue.dynamics.schedules import constant_schedule
from jaxtissue.dynamics.survey import Tissue, lines_of, survey_together
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.energy import Model, tube_model
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import backbone_coords
from jaxtissue.measurement.quadrature import PRESETS
from jaxtissue.reproduction.experiments import BASAL_RADIUS, Plan, Store, Table, tabulate
from jaxtissue.reproduction.tissues import TEMPERATURE, Annealing
from jaxtissue.tissue.measurer import CellMeasurer
from jaxtissue.topology.contacts import find_contacts

WARM_UP = 2 * SPAN  # sweeps before the timed ones; from then on lists are renewed every SPAN sweeps
SAMPLED = 25  # moves of MH with whole diagrams that are timed in a turn
SPARE = 10  # spans more than turns, to be played where programs are compiled
RADII = (1.0, 5.0)
RULES = {rule.replace("-", "_"): rule for rule in CONFLICTS}  # by their names in the columns of tables


def measure_table(plan: Plan, store: Store) -> tuple[Table, Table]:
    """Table 1, a row for each R_a and n, and the seconds of a sweep in every turn that its medians are of.

    In a turn each algorithm plays one span of 10 sweeps on every tissue, one after the other, so that a load
    on the machine that lasts slows all of them; on a CPU processor time is taken, which loads change little.
    `mh_seconds` and `near_seconds`, `2_hop_seconds`, ... (IS-MH
    under each rule) are measured with what is renewed between sweeps, but without compilation.
    `whole_seconds` is extrapolated: n times the median time of a sample of moves of MH with whole diagrams.
    `near_rounds`, ... are the rounds played, `near_put_off` the share of the moves that were put off to later
    rounds because they collided. `near_sets`, ... are the sets that coloring alone finds, in rounds of any
    width, on the tissue before the turns, and `random_near_sets`, ... on the random tissue it came from; so
    are `covering_radius` and `tightness`.
    """
    annealings = [
        Annealing(Tube(100.0, radius, BASAL_RADIUS), cells, WARM_UP) for radius in RADII for cells in plan.table_cells
    ]
    runs = store.anneal([(annealing, 0) for annealing in annealings])
    contests: list[Contest] = []

    def play_turn() -> dict[str, Any]:
        if not contests:
            for annealing, run in zip(annealings, runs, strict=True):
                contests.append(Contest(annealing, run.positions[-1], plan.turns))
                contests[-1].play()  # compiles, and is not timed
        return {"rows": [contest.play() for contest in contests]}

    turns = []
    for turn in range(1, plan.turns + 1):
        rows = store.row(f"table1_turn{turn}", play_turn)["rows"]
        turns += [{"turn": turn} | row for row in rows]
    table = []
    for annealing, run in zip(annealings, runs, strict=True):
        row = {"apical_radius": float(annealing.tube.apical_radius), "cells": annealing.cells}
        own = [turn for turn in turns if all(turn[name] == value for name, value in row.items())]
        row |= {name: float(np.median([turn[name] for turn in own])) for name in own[0] if name not in row}
        del row["turn"]
        table.append(row | store.row(f"table1_sets_{annealing.name}", lambda at=(annealing, run): _sets(*at)))
    return tabulate(table), tabulate(turns)


class Contest:
    """One tissue, which each algorithm and rule takes on from the same state, span by span."""

    def __init__(self, annealing: Annealing, positions: Float[np.ndarray, "n 2"], turns: int) -> None:
        self.annealing = annealing
        model = tube_model(annealing.tube, annealing.cells)
        schedule = constant_schedule(TEMPERATURE, WARM_UP + SPAN * (SPARE + turns))
        rules = {"mh": ("mh", "near")} | {name: ("is-mh", rule) for name, rule in RULES.items()}
        self.annealers = {
            name: Annealer(model, PRESETS["draft"], algorithm, 0, schedule, rule)
            for name, (algorithm, rule) in rules.items()
        }
        self.states = dict.fromkeys(rules, AnnealState(WARM_UP, positions))
        self.measurer = CellMeasurer(annealing.tube, PRESETS["draft"])

    def play(self) -> dict[str, float]:
        """One span of each: seconds of a sweep, rounds, and the share of the moves put off."""
        cells = self.annealing.cells
        row: dict[str, float] = {"apical_radius": float(self.annealing.tube.apical_radius), "cells": cells}
        _, spent = play_whole(self.annealers["mh"], self.states["mh"], self.measurer, min(SAMPLED, cells))
        row["whole_seconds"] = cells * float(np.median(spent))
        for name in self.annealers:
            records, row[f"{name}_seconds"] = self._advance(name)
            if name in RULES:
                row[f"{name}_rounds"] = float(np.mean([record.rounds for record in records]))
                collisions = [record.collisions for record in records]
                row[f"{name}_put_off"] = float(np.mean(collisions)) / cells
        return row

    def _advance(self, name: str) -> tuple[list[SweepRecord], float]:
        """A span of one of them and its seconds a sweep; if something is compiled the next span is taken."""
        annealer = self.annealers[name]
        while True:
            begin, compiled = clock(), annealer.compile_seconds
            self.states[name], records, _ = annealer.advance(self.states[name])
            spent, left = clock() - begin, len(annealer.temperatures) - self.states[name].sweep
            if annealer.compile_seconds == compiled or left < SPAN:
                return records, spent / len(records)


def clock() -> float:
    """Seconds of processor time of this process where it computes on a CPU, else of the clock on the wall."""
    return time.process_time() if jax.default_backend() == "cpu" else time.perf_counter()


def play_whole(
    annealer: Annealer, state: AnnealState, measurer: CellMeasurer, moves: int
) -> tuple[Float[np.ndarray, "n 2"], list[float]]:
    """The first moves of a sweep of MH that measures the whole tissue for each of them, as the paper's does.

    Proposals, their order and what decides are those of `annealer`, whose algorithm is "mh"; only the energy
    difference comes from all cells, not from those that change. The backbones after the moves, and the
    seconds of each move.
    """
    model, n, dtype = annealer.model, len(state.positions), state.positions.dtype
    draws = draw(annealer.seed, state.sweep, n, dtype)
    proposed = propose(jnp.asarray(draws[:2]), backbone_coords(jnp.asarray(state.positions)), model)
    targets = np.stack([proposed.axial, proposed.angle], axis=-1)
    place, energy = state.positions, _energy(state.positions, model, measurer)
    temperature, spent = max(annealer.temperatures[state.sweep], 1e-300), []
    for cell in one_by_one(annealer.seed, state.sweep, n)[:moves, 0]:
        begin = clock()
        moved = place.copy()
        moved[cell] = targets[cell]
        changed = _energy(moved, model, measurer)
        if draws[2, cell] < np.exp(-max(changed - energy, 0) / temperature):
            place, energy = moved, changed
        spent.append(clock() - begin)
    return place, spent


def _energy(positions: Float[np.ndarray, "n 2"], model: Model, measurer: CellMeasurer) -> float:
    cells = measurer.measure(positions)
    return float(np.sum(np.asarray(model.cell_energy(cells, model), float)))


def _sets(annealing: Annealing, run: Any) -> dict[str, float]:
    row: dict[str, float] = {}
    for prefix, place in (("", run.positions[-1]), ("random_", run.positions[0])):
        sets = count_sets(place, tube_model(annealing.tube, annealing.cells))
        row |= {f"{prefix}{rule.replace('-', '_')}_sets": count for rule, count in sets.items()}
        covering = float(covering_radius(jnp.asarray(place), annealing.tube))
        apart = float(separation(jnp.asarray(place), annealing.tube))
        row |= {f"{prefix}covering_radius": covering, f"{prefix}tightness": covering / apart}
    return row


def count_sets(positions: Float[np.ndarray, "n 2"], model: Model) -> dict[str, int]:
    """The number of independent sets that coloring finds under each rule, where a set may be of any size.

    >>> from jaxtissue.energy import tube_model
    >>> tube = Tube(10, 1, 3)
    >>> count_sets(np.array([[2.0, 0.0], [5.0, 0.0], [8.0, 0.0]]), tube_model(tube, 3))
    {'near': 3, '2-hop': 3, '3-hop': 3, '4-hop': 3, '8-phi': 3}
    """
    n, tube = len(positions), model.tube
    place = np.asarray(positions, jnp.result_type(float))
    pairs = find_contacts(place, tube).pairs
    ends = np.concatenate([pairs, pairs[:, ::-1]]).T
    contacts = sparse.coo_array((np.ones(ends.shape[1], np.int32), tuple(ends)), shape=(n, n)).tocsr()
    tissue = Tissue(place, model, lines_of(model, n, PRESETS["draft"]))
    (measured,) = survey_together([tissue], Batch())
    apical = np.asarray(tube.embed(jnp.asarray(place)).apical)
    reach = 8 * float(covering_radius(jnp.asarray(place), tube))
    counts, along = {}, np.argsort(place[:, 0], kind="stable")
    for rule in CONFLICTS:
        if rule == "near":
            graph = hop_conflicts(measured.contacts(float(MEAN_MOVE * move_bound(model, n))), 2)
        elif rule == "8-phi":
            graph = distance_conflicts(apical, reach)
        else:
            graph = hop_conflicts(contacts, int(rule[0]))
        counts[rule] = len(color(graph, n, along))
    return counts
