"""Neighbor lists for sweeps on any domain: complete lists from a survey of all cells, and short lists for a span."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse

from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.domain_sweeps import survey_cells
from jaxtissue.dynamics.domain_updates import Scene, Surroundings, TissueState
from jaxtissue.dynamics.surface_moves import RADIUS
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.neighbors.section_lists import crowd_of
from jaxtissue.sections.cells import MANY_SLOTS
from jaxtissue.sections.crowd import STEP, extended, first_lists, missing, padded
from jaxtissue.sections.polygons import Rule

ROUNDS = 8  # of looking for missing neighbors
NEAREST = 40  # at each of three points of a backbone: with 16, most spans meet a neighbor that is not listed
FEW = 40  # candidates of a cell during a span, if more are not sides or near it
MARGIN = 0.25  # mean lengths of sections by which the line of such a candidate may miss the cell


class Measured(NamedTuple):
    """A tissue as measured on complete lists: its cells, the lists, and by how much each candidate misses its cell."""

    positions: Float[np.ndarray, "n *k d"]
    state: TissueState
    rivals: Int[np.ndarray, "n q"]
    clear: Float[np.ndarray, "n q"]
    is_cut: Bool[np.ndarray, " n"]
    unproved: int  # points of rims at which a neighbor may be missing
    rule: Rule  # with slots for all edges
    unit: float  # mean length of apical sections

    @property
    def sizes(self) -> CellGeometry:
        """The sizes of the cells as after one sweep, [1, n]."""
        return jax.tree.map(lambda column: np.asarray(column)[None], self.state.cells.sizes)

    def relisted(self, rivals: Int[np.ndarray, "n k"]) -> TissueState:
        """The state with sides as entries of other lists."""
        same = (self.rivals[:, None] == rivals[:, :, None]) & (rivals[:, :, None] >= 0)
        cells = self.state.cells
        return self.state._replace(cells=cells._replace(sides=(same & cells.sides[:, None]).any(axis=2)))

    def walls(self) -> tuple[Int[np.ndarray, " w"], Int[np.ndarray, " w"]]:
        """The cells and the candidates that are a side of them."""
        cell, slot = np.nonzero((self.clear <= 0) & (self.rivals >= 0))
        return cell, self.rivals[cell, slot]

    def contacts(self, within: float = 0.0) -> sparse.csr_array:
        """The pairs of cells that touch, or could if one moved by at most `within`: [n, n], symmetric."""
        n = len(self.rivals)
        row, slot = np.nonzero((self.clear <= within / self.unit) & (self.rivals >= 0))
        pairs = row, self.rivals[row, slot] % n
        graph = sparse.csr_array((np.ones(len(row), bool), pairs), shape=(n, n))
        return sparse.csr_array(graph + graph.T)


def survey(
    positions: Float[np.ndarray, "n *k d"], scene: Scene, batch: Batch, also: Int[np.ndarray, "n q"] | None = None
) -> Measured:
    """Measure all cells on lists that grow until no candidate is missing, with slots for all edges.

    Other candidates may be listed `also`: a far one that is a side in the first pass can change the last digits.
    """
    n = len(positions)
    crowd = crowd_of(scene.domain, positions)
    lists, rounds = first_lists(crowd, NEAREST), 0
    if also is not None:
        cell, slot = np.nonzero(also >= 0)
        lists = extended(lists, np.stack([cell, also[cell, slot]], axis=1))
    while True:
        rivals = padded(lists, scene.domain).T.astype(np.int32)
        near = Surroundings(rivals, *[np.zeros((n, 1), np.int32)] * 3)
        (found,) = batch.run(survey_cells, [(positions, replace(scene, near=near))], light=True)
        if (found.state.cells.spare > 0).any() and scene.rule.slots < MANY_SLOTS:
            scene = with_slots(scene)
            continue
        rounds += 1
        there = found.is_point
        pairs, unproved = missing(crowd, lists, found.points[there].astype(float), found.cells[there])
        if not len(pairs) or rounds == ROUNDS:
            unit, unproved = float(np.sqrt(np.pi) * scene.longest / RADIUS), unproved + len(pairs)
            return Measured(positions, found.state, rivals, found.clear, found.is_cut, unproved, scene.rule, unit)
        lists = extended(lists, pairs)


def with_slots(scene: Scene) -> Scene:
    """The scene with room for as many edges as a section can have."""
    return replace(scene, rule=scene.rule._replace(slots=MANY_SLOTS))


class Shortlists:
    """The candidates of each cell during a span: its sides, those that nearly are, and those that were missing.

    Args:
        measured: The tissue at the beginning.
    """

    def __init__(self, measured: Measured) -> None:
        clear = np.where(measured.rivals >= 0, measured.clear, np.inf)
        near = int((clear < MARGIN).sum(axis=1).max())
        width = min(-(-max(near, FEW) // 8) * 8, clear.shape[1])
        order = np.argsort(clear, axis=1, kind="stable")[:, :width]
        self.rivals = self._nearest = np.take_along_axis(measured.rivals, order, axis=1)
        self._further = np.full((1, len(order)), -1)

    def lacking(self, measured: Measured) -> Int[np.ndarray, "m 2"]:
        """The pairs of a cell and one of its sides, as measured, that the lists lack."""
        cell, slot = np.nonzero(np.asarray(measured.state.cells.sides) & (measured.rivals >= 0))
        rival = measured.rivals[cell, slot]
        return np.stack([cell, rival], axis=1)[~(self.rivals[cell] == rival[:, None]).any(axis=1)]

    def add(self, pairs: Int[np.ndarray, "m 2"]) -> None:
        """List further candidates, for which the least near ones give way: so the same program serves the lists."""
        self._further = extended(self._further, pairs)
        both = np.concatenate([self._further.T, self._nearest], axis=1)
        order = np.argsort(both < 0, axis=1, kind="stable")[:, : max(self._nearest.shape[1], 2 * len(self._further))]
        self.rivals = np.take_along_axis(both, order, axis=1).astype(np.int32)

    def surroundings(self) -> Surroundings:
        """The lists, and the cells around each cell."""
        n, q = self.rivals.shape
        entry = np.flatnonzero(self.rivals.ravel() >= 0)
        owner = self.rivals.ravel()[entry] % n
        entry = entry[np.argsort(owner, kind="stable")]  # by the cell that is listed, then by that which lists
        owner = np.sort(owner)
        column = np.arange(len(owner)) - np.searchsorted(owner, owner)
        width = -(-max(int(column.max(initial=0)) + 1, 2 * q) // STEP) * STEP
        around, slots = np.repeat(np.arange(n, dtype=np.int32)[:, None], width, axis=1), np.zeros((n, width), np.int32)
        around[owner, column], slots[owner, column] = entry // q, entry % q
        again = np.zeros((n, width), bool)
        again[:, 1:] = around[:, 1:] == around[:, :-1]
        first = np.maximum.accumulate(np.where(again, 0, np.arange(width, dtype=np.int32)), axis=1)
        return Surroundings(self.rivals, around, slots, first)
