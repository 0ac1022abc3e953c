"""Measurement of whole tissues between sweeps, on complete neighbor lists, with the clearance of each candidate."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.metropolis import move_bound
from jaxtissue.dynamics.spans import survey_state
from jaxtissue.dynamics.sweep_log import Measured
from jaxtissue.energy import Model
from jaxtissue.measurement.quadrature import Lines, Resolution, plan_lines
from jaxtissue.neighbors.search import TILES, Attempt, candidate_lists, check_angles, tiling_defect
from jaxtissue.neighbors.shortlists import from_both, mutual_entries, sight_lines

MARGIN = 8  # longest moves along the axis by which a candidate may get to the other side of a cell
Sides = Int[np.ndarray, "n 2 candidates"]


class Tissue(NamedTuple):
    """The tissue of one replica, with the lines on which cells and on which clearances are measured."""

    positions: Float[np.ndarray, "n 2"]
    model: Model
    lines: tuple[Lines, Lines]

    def check_call(self, sides: Sides) -> tuple[Any, ...]:
        """The arguments of `tiling_defect`."""
        return self.positions, self.model.tube, sides, check_angles(self.model.tube, len(self.positions))

    def survey_call(self, sides: Sides) -> tuple[Any, ...]:
        """The arguments of `survey_state`."""
        return self.positions, self.model, self.lines, sides


def lines_of(model: Model, cells: int, resolution: Resolution) -> tuple[Lines, Lines]:
    """The lines of a `Tissue` of so many cells."""
    lines = plan_lines(model.tube, cells, resolution, surfaces=model.has_surfaces)
    return lines, sight_lines(model.tube, cells, resolution)


def survey_together(
    tissues: Sequence[Tissue], batch: Batch, foresee: Callable[[int, Attempt], None] = lambda *_: None
) -> list[Measured]:
    """Measure whole tissues, one for each replica.

    `foresee` is called with the number and the first attempt at lists of each tissue, before anything is computed: it
    may prepare programs.
    """
    lists = _complete_lists(tissues, batch, foresee)
    # lists are not padded to those of other replicas: their width sets how finely `bounding_neighbor` compares
    calls = [tissue.survey_call(sides) for tissue, sides in zip(tissues, lists, strict=True)]
    results = batch.start(survey_state, calls, light=True)
    views = [mutual_entries(sides) for sides in lists]  # while the device computes
    return [
        Measured(state, sides, from_both(clear, seen), distance)
        for (state, clear, distance), sides, seen in zip(results(), lists, views, strict=True)
    ]


def _complete_lists(tissues: Sequence[Tissue], batch: Batch, foresee: Callable[[int, Attempt], None]) -> list[Sides]:
    """The complete candidate lists of each tissue: longer ones where the check shows that one lacks a neighbor."""
    searches = []
    for tissue in tissues:
        margin = MARGIN * float(move_bound(tissue.model, len(tissue.positions)))
        searches.append(candidate_lists(tissue.positions, tissue.model.tube, margin))
    tried, complete = {k: next(search) for k, search in enumerate(searches)}, {}
    for k, attempt in tried.items():
        foresee(k, attempt)
    while tried:
        doubtful = [k for k, attempt in tried.items() if not attempt.has_all]
        calls = [tissues[k].check_call(tried[k].sides) for k in doubtful]
        defects = dict(zip(doubtful, batch.run(tiling_defect, calls, light=True), strict=True))
        complete |= {k: attempt.sides for k, attempt in tried.items() if attempt.has_all or defects[k] < TILES}
        tried = {k: next(searches[k]) for k in tried if k not in complete}
    return [complete[k] for k in range(len(tissues))]
