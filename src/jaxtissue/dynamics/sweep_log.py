"""Record of each sweep of a run, and a tissue as measured between sweeps.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from jaxtissue.dynamics.local_updates import Neighborhoods, TissueState
from jaxtissue.dynamics.metropolis import SweepInfo
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.neighbors.search import contact_graph, pad_lists
from jaxtissue.neighbors.shortlists import CANDIDATES, TOUCHES, around, nearest_sides, shortlist_length

ENOUGH = 200  # moves by which acceptance is judged
ALL = 0.95  # of the moves, accepted: nearly all
AROUND = 56  # cells around a cell that has CANDIDATES on each side: room enough for most tissues


class Measured(NamedTuple):
    """A state measured: its cells, the candidates of each, and the clearance and distance of each candidate."""

    tissue: TissueState
    sides: Int[np.ndarray, "n 2 candidates"]
    clear: Float[np.ndarray, "n 2 candidates"]
    far: Float[np.ndarray, "n 2 candidates"]

    def contacts(self, within: float = 0.0) -> sparse.csr_array:
        """The pairs of cells that touch, or could if one moved by at most `within`: [n, n], symmetric."""
        return contact_graph(self.sides, self.clear <= (within**2 if within else TOUCHES))

    def urgency(self) -> Float[np.ndarray, "n 2 candidates"]:
        """The order of shortlists, the least first: the clearance of a farther candidate holds less long."""
        return self.clear * self.far

    @property
    def sizes(self) -> CellGeometry:
        """The sizes of the cells as after one sweep, [1, n]."""
        return jax.tree.map(lambda column: np.asarray(column)[None], self.tissue.sizes)


class SweepRecord(NamedTuple):
    """Record of one sweep: energy of the tissue after the sweep, and counts of its moves (paper, sections 3.2 and 3.3).

    Attributes:
        sweep: Index of the sweep, starting at 1; 0 for the initial state.
        energy: Energy of the tissue after the sweep.
        volume_energy: Volume term of the paper's energy, sum of K/2 (Vbar - V_i)^2; also reported if the model has
            another `cell_energy`.
        area_energy: Area term of the paper's energy, sum of Lambda A_i; also reported if the model has another
            `cell_energy`.
        temperature: Temperature T of the sweep, in energy units. For the initial state, the temperature of the first
            sweep.
        acceptance: Acceptance rate: fraction of the proposed moves that were accepted, 0 to 1.
        rounds: Number of rounds, each a set of moves that were decided together.
        collisions: Number of moves deferred because they affect a cell already affected by an earlier move in the same
            round. Deferred moves are tried in additional rounds at the end of the same sweep.
        seconds: Wall time of the sweep without compilation. For replicas that run together, the total divided equally
            among the replicas.
        left_cell: Number of proposals that would move the apical end of a backbone outside its current cell. The paper
            excludes them; here they are accepted or rejected like all others.
        drift: Relative difference between the incrementally updated energy and a full recomputation with rebuilt
            neighbor lists; 0 if nothing was recomputed after this sweep.
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


def sweep_record(
    sweep: int,
    energies: Float[np.ndarray, "3"],
    cells: int,
    temperatures: Float[np.ndarray, "sweeps"],
    info: SweepInfo | None = None,
) -> SweepRecord:
    """The record of a sweep, of which the first has the number 1; without `info` that of a state as it is."""
    index = min(max(sweep - 1, 0), len(temperatures) - 1)
    accepted, collisions, left_cell, rounds, _ = (np.asarray(leaf).item() for leaf in info or 5 * [0])
    return SweepRecord(
        sweep,
        *energies.tolist(),
        temperature=float(temperatures[index]) if len(temperatures) else 0.0,
        acceptance=accepted / cells,
        rounds=rounds,
        collisions=collisions,
        seconds=0.0,
        left_cell=left_cell,
        drift=0.0,
    )


class AcceptanceWatch:
    """Warns where the acceptance of a run's first moves shows that T does not fit the energy."""

    def __init__(self, cells: int) -> None:
        self._cells, self._moves, self._accepted, self._done = cells, 0, 0.0, False

    def doubt(self, records: Sequence[SweepRecord]) -> str:
        """A warning, once, after enough moves of which none, or nearly all, were accepted; otherwise nothing."""
        self._moves += self._cells * len(records)
        self._accepted += self._cells * sum(record.acceptance for record in records)
        if self._done or self._moves < ENOUGH:
            return ""
        share, self._done = self._accepted / self._moves, True
        if 0 < share <= ALL:
            return ""
        moves, wrong, change = (
            ("no move is", "low", "higher") if share == 0 else (f"{share:.0%} of the moves are", "high", "lower")
        )
        cause = f"T = {records[-1].temperature:g} is too {wrong} for the energies, which depend on the unit of length"
        return f"{moves} accepted: {cause}; give a {change} --temperature, or use --relative"


def least_around(cells: int) -> int:
    """Room for the cells around each cell that is enough for most tissues, so that it seldom has to grow."""
    most = AROUND * shortlist_length(cells) / CANDIDATES
    return -(-int(min(most, cells)) // 8) * 8


def shortlist_neighbors(
    sides: Int[np.ndarray, "n 2 candidates"],
    clear: Float[np.ndarray, "n 2 candidates"],
    width: int,
) -> Neighborhoods:
    """The shortlists of a span of sweeps, and the cells around each cell, in at least `width` columns.

    Where that is not enough, the width leaves room to grow.
    """
    width = max(width, least_around(len(sides)))
    few = nearest_sides(sides, clear, min(shortlist_length(len(sides)), sides.shape[2]))
    lists = around(few)
    if lists.shape[1] > width:
        width = -(-int(1.1 * lists.shape[1]) // 16) * 16
    return Neighborhoods(pad_lists(lists, width), few)
