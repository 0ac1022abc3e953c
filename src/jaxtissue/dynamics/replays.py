"""Spans of sweeps, run on short neighbor lists and repeated if a neighbor was missing on a list."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.independent_sets import padded_orders
from jaxtissue.dynamics.local_updates import Neighborhoods, Scene
from jaxtissue.dynamics.metropolis import SweepInfo, draw
from jaxtissue.dynamics.spans import Trail, energy_terms, fit_play, play
from jaxtissue.dynamics.survey import Tissue, survey_together
from jaxtissue.dynamics.sweep_log import Measured, shortlist_neighbors
from jaxtissue.energy import Model, require_finite
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.neighbors.shortlists import find_unlisted, list_first

SPAN = 10  # the most sweeps between rebuilds of lists and rounds
EXACT = 1000  # rounding errors of the mean volume that a cell may be off by before its lists are doubted
Plan = Sequence[Int[np.ndarray, "rounds width"]]  # the rounds of some sweeps


class Segment(NamedTuple):
    """Sweeps that are played on the same lists; `is_whole` unless the rest of its one sweep follows it."""

    plan: Plan
    is_whole: bool = True

    def halves(self) -> "list[Segment]":
        """The first and second half of the sweeps, or of the rounds of the one sweep; none of a single round."""
        if len(self.plan) > 1:
            half = len(self.plan) // 2
            return [Segment(self.plan[:half]), Segment(self.plan[half:], self.is_whole)]
        (rounds,) = self.plan
        if len(rounds) == 1:
            return []
        half = len(rounds) // 2
        return [Segment([rounds[:half]], False), Segment([rounds[half:]], self.is_whole)]


@dataclass
class Span:
    """The sweeps of one replica between two rebuilds, while they are played.

    Attributes:
        tissue: The tissue after the segments played so far.
        measured: The same, measured on complete lists.
        seed: The seed of the run.
        sweep: The number of sweeps done.
        temperatures: T of each sweep of the run.
        around: The room for the cells around each cell.
        segments: What is still to be played.
        trails: What has been played.
        drift: The largest relative difference of the energy carried along and the energy measured anew.
    """

    tissue: Tissue
    measured: Measured
    seed: int
    sweep: int
    temperatures: Float[np.ndarray, "sweeps"]
    around: int
    segments: list[Segment]
    trails: list[Trail] = field(default_factory=list)
    drift: float = 0.0
    drifted: list[tuple[CellGeometry, CellGeometry]] = field(default_factory=list)  # measured anew, and carried along
    _unfinished: SweepInfo | None = None  # the counts of a sweep of which a part was played

    def __post_init__(self) -> None:
        self._relist()

    @property
    def trail(self) -> Trail:
        """All sweeps that were played."""
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *self.trails)

    def shortlist(self) -> Neighborhoods:
        """The lists on which the next segment is played."""
        return shortlist_neighbors(self._sides, self._clear, self.around)

    def call(self, near: Neighborhoods) -> tuple[Any, ...]:
        """The arguments of `play` for the next segment."""
        plan, n, dtype = self.segments[0].plan, len(self.tissue.positions), self.tissue.positions.dtype
        temperatures, draws = np.zeros(SPAN, dtype), np.zeros((SPAN, 3, n), dtype)
        temperatures[: len(plan)] = self.temperatures[self.sweep : self.sweep + len(plan)]
        for k in range(len(plan)):
            draws[k] = draw(self.seed, self.sweep + k, n, dtype)
        scene = Scene(self.tissue.model, near, self.tissue.lines[0])
        return draws, self.measured.tissue, scene, temperatures, padded_orders(plan, SPAN, near)

    def accepts(self, near: Neighborhoods, trail: Trail, measured: Measured) -> bool:
        """Whether the lists lacked no neighbor; if they did, the next call plays it on others, or half of it."""
        off = largest_difference(measured.sizes, last_sizes(trail))[0]
        cells = np.flatnonzero(off > self._exactness)
        lacking = find_unlisted(cells, measured.clear, measured.sides, np.asarray(near.sides))
        if not len(lacking):
            return True
        if list_first(lacking, self._sides, self._clear):
            return False
        halves = self.segments[0].halves()
        if halves:
            self.segments[:1] = halves
            self._relist()
        return not halves

    def proceed(self, near: Neighborhoods, trail: Trail, measured: Measured) -> None:
        """Take the next segment as played."""
        segment = self.segments.pop(0)
        if self._unfinished is not None:
            trail = trail._replace(info=jax.tree.map(np.add, self._unfinished, trail.info))
        self._unfinished = None if segment.is_whole else trail.info
        if segment.is_whole:
            self.trails.append(trail)
            self.sweep += len(segment.plan)
        carried = last_sizes(trail)
        if largest_difference(measured.sizes, carried).max() > self._exactness / 100:  # else it is but a rounding error
            self.drifted.append((measured.sizes, carried))
        self.around = near.around.shape[1]
        self.tissue = self.tissue._replace(positions=trail.positions[-1])
        self.measured = measured
        self._relist()

    @property
    def _exactness(self) -> float:
        return EXACT * float(np.finfo(self.tissue.positions.dtype).eps) * float(self.tissue.model.mean_volume)

    def _relist(self) -> None:
        """Begin from the candidates and the urgency as measured."""
        self._sides, self._clear = self.measured.sides.copy(), self.measured.urgency()


def play_spans(spans: Sequence[Span], batch: Batch) -> None:
    """Play all segments of all spans, those of several replicas together."""
    widths = (0, 0)
    while playing := [span for span in spans if span.segments]:
        lists = [span.shortlist() for span in playing]
        calls = [span.call(near) for span, near in zip(playing, lists, strict=True)]
        calls, widths = fit_play(calls, widths)
        trails = []
        for span, (_, trail) in zip(playing, batch.run(play, calls), strict=True):
            sweeps = len(span.segments[0].plan)
            trails.append(jax.tree.map(lambda leaf, sweeps=sweeps: leaf[:sweeps], trail))
        after = [s.tissue._replace(positions=t.positions[-1]) for s, t in zip(playing, trails, strict=True)]
        surveys = survey_together(after, batch)
        for span, near, trail, measured in zip(playing, lists, trails, surveys, strict=True):
            if span.accepts(near, trail, measured):
                span.proceed(near, trail, measured)
    checks = [(span, *sizes) for span in spans for sizes in span.drifted]
    models = [span.tissue.model for span, _, _ in checks]
    anew = energies_together(models, [sizes for _, sizes, _ in checks], batch)
    carried = energies_together(models, [sizes for _, _, sizes in checks], batch)
    for (span, _, _), *energies in zip(checks, anew, carried, strict=True):
        first, second = (table[0, 0].item() for table in energies)
        span.drift = max(span.drift, abs(first - second) / max(abs(first), abs(second), 1e-300))


def last_sizes(trail: Trail) -> CellGeometry:
    """The sizes of the cells after the last sweep, [1, n], as carried along by local updates."""
    return jax.tree.map(lambda column: column[-1:], trail.sizes)


def largest_difference(first: CellGeometry, second: CellGeometry) -> Float[np.ndarray, "sweeps n"]:
    """The largest difference of any size of each cell."""
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return np.max([np.abs(one - other) for one, other in pairs], axis=0)


def energies_together(
    models: Sequence[Model], sizes: Sequence[CellGeometry], batch: Batch
) -> list[Float[np.ndarray, "3 sweeps"]]:
    """Energy and the paper's two terms of it after each sweep, of each replica, summed in double precision."""
    calls = []
    for model, table in zip(models, sizes, strict=True):
        spare = ((0, SPAN - len(table.volume)), (0, 0))  # one program for all
        calls.append((jax.tree.map(lambda column, spare=spare: np.pad(column, spare, mode="edge"), table), model))
    sums = []
    for model, table, terms in zip(models, sizes, batch.run(energy_terms, calls, light=True), strict=True):
        require_finite(terms[0], model)
        sums.append(np.array([np.sum(term[: len(table.volume)], axis=1, dtype=float) for term in terms]))
    return sums
