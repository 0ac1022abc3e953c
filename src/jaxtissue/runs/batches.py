"""Runs annealed together in batches, as replicas in one program."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxtissue.compilation.modes import random_key
from jaxtissue.dynamics.annealer import Annealer, AnnealState, advance_together, record_together
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.runs.reports import contacts_of_run
from jaxtissue.runs.settings import Settings
from jaxtissue.topology.statistics import summarize_connectivity


class Outcome(NamedTuple):
    """A finished run: the rows of its sweeps, the first of the state before any, and the last backbones."""

    records: list[SweepRecord]
    positions: Float[np.ndarray, "n 2"]


def usual_batch() -> int:
    """The number of rows annealed together: several for each processor; for a GPU enough to fill it."""
    devices = jax.local_devices()
    return len(devices) * (4 if devices[0].platform == "cpu" else 64)


def batches(rows: Sequence[tuple[int, Settings]], size: int) -> Iterator[list[tuple[int, Settings]]]:
    """Numbered rows in batches of at most `size`, alike in the number of cells."""
    for cells in dict.fromkeys(row.cells for _, row in rows):
        alike = [(number, row) for number, row in rows if row.cells == cells]
        yield from (alike[start : start + size] for start in range(0, len(alike), size))


def anneal_batch(
    rows: Sequence[Settings], slots: int, go_on: Callable[[list[SweepRecord]], bool]
) -> list[Outcome] | None:
    """Anneal runs of equal numbers of cells and sweeps together, from the backbones of their seeds.

    `slots` is the number of replicas that the program is compiled for. `go_on` is told the last rows after
    every span of sweeps; where it says no, there is no outcome.
    """
    annealers = [row.annealer(row.sweeps) for row in rows]
    states = [_start(annealer, row) for annealer, row in zip(annealers, rows, strict=True)]
    records = [[record] for record in record_together(annealers, states, slots)]
    while states[0].sweep < rows[0].sweeps:
        if not go_on([some[-1] for some in records]):
            return None
        spans = advance_together(annealers, states, slots)
        states = [state for state, _, _ in spans]
        for known, (_, news, _) in zip(records, spans, strict=True):
            known += news
    return [Outcome(some, state.positions) for some, state in zip(records, states, strict=True)]


def _start(annealer: Annealer, row: Settings) -> AnnealState:
    """The state before the first sweep, as in a run of its own."""
    domain = row.place
    return annealer.start(domain.reflect(domain.random_positions(random_key(row.seed), row.cells)))


def summarize(row: Settings, outcome: Outcome) -> dict[str, Any]:
    """The results of a run, as columns of the table: energies by its own resolution, means over its sweeps.

    `drift` is the largest of any sweep. Unless contacts are left out, the means of `summarize_connectivity`
    over all cells follow, and those over cells that touch no end of the tube, with names that begin `inner_`. On other
    domains they are left out, with a warning, where contacts can't be found.
    """
    first, last, sweeps = outcome.records[0], outcome.records[-1], outcome.records[1:]

    def mean(name: str) -> float:
        return float(np.mean([getattr(record, name) for record in sweeps])) if sweeps else 0.0

    columns: dict[str, Any] = {"initial_energy": first.energy, "energy": last.energy}
    columns |= {"volume_energy": last.volume_energy, "area_energy": last.area_energy}
    columns |= {name: mean(name) for name in ("acceptance", "rounds")}
    columns |= {"collisions": sum(record.collisions for record in sweeps)}
    columns |= {"drift": max((record.drift for record in sweeps), default=0.0)}
    columns |= {"seconds": sum(record.seconds for record in sweeps)}
    connectivity = None if row.no_contacts else contacts_of_run(outcome.positions, row.place, row.minimum_contact)
    if connectivity is not None:
        columns |= summarize_connectivity(connectivity)
        inner = summarize_connectivity(connectivity, inner_only=True)
        columns |= {f"inner_{name}": value for name, value in inner.items()}
        columns |= {"open_ends": connectivity.transitions.open_ends}
    return columns
