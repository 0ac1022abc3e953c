"""A tissue measured between sweeps, on complete neighbor lists, with the clearance of each candidate."""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.compilation.batching import Ahead, Asker, Request, Task
from jaxtissue.dynamics.metropolis import move_bound
from jaxtissue.dynamics.spans import survey_state
from jaxtissue.dynamics.sweep_log import Measured
from jaxtissue.energy import Model
from jaxtissue.measurement.quadrature import Lines, Resolution, plan_lines
from jaxtissue.neighbors.search import TILES, candidate_lists, check_angles, tiling_defect
from jaxtissue.neighbors.shortlists import from_both, mutual_entries, sight_lines

MARGIN = 8  # longest moves along the axis by which a candidate may get to the other side of a cell
Positions = Float[np.ndarray, "n 2"]
Sides = Int[np.ndarray, "n 2 candidates"]
Expected = Callable[[Sides], Iterable[Ahead]]


class TissueSurvey:
    """Measures the tissue of one replica; the last result is kept."""

    def __init__(self, model: Model, resolution: Resolution, asker: Asker) -> None:
        self._model, self._resolution, self._asker = model, resolution, asker
        self._last: tuple[Positions, Measured] | None = None
        self._lines: dict[int, tuple[Lines, Lines]] = {}  # for each number of cells

    def lines(self, cells: int) -> tuple[Lines, Lines]:
        """The lines on which cells are measured, and the lines on which clearances are measured."""
        if cells not in self._lines:
            tube = self._model.tube
            self._lines[cells] = (
                plan_lines(tube, cells, self._resolution),
                sight_lines(tube, cells, self._resolution),
            )
        return self._lines[cells]

    def measure(self, positions: Positions, expected: Expected) -> Task[Measured]:
        """Measure the whole tissue.

        The first time, the programs that are `expected` to be asked for on its lists are compiled meanwhile.
        """
        if self._last and self._last[0] is positions:
            return self._last[1]
        sides = yield from self._find(positions, expected)
        # lists are not padded to those of other replicas: their width sets how finely `bounding_neighbor` compares
        call = self._looked_at(positions, sides)
        answer = yield from self._asker.ask(
            Request(survey_state, call, seldom=True, meanwhile=partial(mutual_entries, sides))
        )
        tissue, clear, far = answer.result
        measured = Measured(tissue, sides, from_both(clear, answer.meanwhile), far)
        self.keep(positions, measured)
        return measured

    def keep(self, positions: Positions, measured: Measured) -> None:
        """Keep a result known from before as the last."""
        self._last = positions, measured

    def _find(self, positions: Positions, expected: Expected) -> Task[Sides]:
        """Complete candidate lists."""
        tube, n, ask = self._model.tube, len(positions), self._asker.ask
        margin, angles = MARGIN * float(move_bound(self._model, n)), check_angles(tube, n)
        for sides, has_all in candidate_lists(positions, tube, margin):
            call = positions, tube, sides, angles
            if self._last is None:
                if not has_all:  # first, as it is the first that is asked for
                    yield from ask(Ahead(tiling_defect, call, seldom=True))
                for ahead in expected(sides):
                    yield from ask(ahead)
                yield from ask(Ahead(survey_state, self._looked_at(positions, sides), seldom=True))
            if has_all:
                return sides
            check = yield from ask(Request(tiling_defect, call, seldom=True))
            if check.result < TILES:
                return sides
        raise AssertionError("lists that have all are complete")

    def _looked_at(self, positions: Positions, sides: Sides) -> tuple:
        """The arguments of `survey_state`."""
        return positions, self._model, self.lines(len(positions)), sides
