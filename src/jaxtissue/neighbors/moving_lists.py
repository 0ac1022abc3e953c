"""Short lists for a tissue that moves far on any domain: renewed where a neighbor is missing, across periods too."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain
from jaxtissue.neighbors.section_lists import Measured, crowd_of, find_sections
from jaxtissue.neighbors.section_neighbors import SectionNeighbors
from jaxtissue.sections.cells import Layers
from jaxtissue.sections.crowd import ROUND_UP, distances, turning_cells

FEW = 24  # candidates on each list, where no cell has more neighbors
NEAR = 0.05  # of the mean distance from backbones to corners, by which a candidate may miss a cell and is kept
DRIFT = 0.25  # periods by which a backbone may be outside of the first one


class MovingLists:
    """The candidates of each cell that are nearest to bounding it.

    Positions may go on beyond periods. `turns` whole ones of each backbone are taken off where cells are measured: then
    a backbone that crosses a period changes no list, until it has gone so far that copies are numbered anew. Bent
    backbones are where their first nodes are.

    Args:
        domain: The domain that the backbones stand in.
        positions: The positions at first, [n, d] or [n, k, d].
        heights: The heights of nodes, [n, k, 1], if they are not equally spaced.
        layers: The layers on which lists are proved.
    """

    def __init__(
        self, domain: Domain, positions: Float[np.ndarray, "n *k d"], heights: np.ndarray | None, layers: Layers
    ) -> None:
        base = domain.base
        self.domain, self._heights, self._layers = domain, heights, layers
        self._extent = np.array([float(size) for size in base.extent] if isinstance(base, Rectangle) else [1.0] * 3)
        directions = base.directions if isinstance(base, Rectangle) else ("free",) * 3
        self._turns_off, self._has_copies = (
            np.array([kind in kinds for kind in directions]) for kinds in (("closed", "periodic"), ("periodic",))
        )
        self.turns = np.zeros_like(positions)
        self.turns = self._turns_of(positions)
        self._found, self._width = find_sections(domain, self.within(positions), layers), FEW
        self._rule = self._found.rule
        self._shorten(self._found)

    @property
    def neighbors(self) -> SectionNeighbors:
        """The lists as `tissue_energy` takes them."""
        return SectionNeighbors(self._lists.T, self.domain, 0, self._rule.slots)

    @property
    def shift(self) -> Float[np.ndarray, "n d"]:
        """What is taken off of positions."""
        return self.turns * self._extent

    def within(self, positions: Float[np.ndarray, "n *k d"]) -> Float[np.ndarray, "n *k d"]:
        """The positions less the turns, as lists are for, with the heights of nodes."""
        place = positions - self.shift
        whole = place if self._heights is None else np.concatenate([place, self._heights], axis=-1)
        return whole.astype(jnp.result_type(float))

    def renew(self, positions: Float[np.ndarray, "n d"]) -> None:
        """Look for neighbors that the lists lack, until none does."""
        off = np.abs(positions / self._extent - self.turns - 0.5) > 0.5 + DRIFT
        off = off if off.ndim == 2 else off[:, 0]
        if (off & self._turns_off).any():
            self._number_copies(self._turns_of(positions))
        found = find_sections(self.domain, self.within(positions), self._layers, self._rule, self._lists)
        self._rule, self._found = found.rule, found
        cell, rival = walls_of(found)
        if not (self._lists[:, cell] == rival).any(axis=0).all():
            self._shorten(found)

    def turning_cells(self) -> Int[np.ndarray, " m"]:
        """The cells that cannot be measured, as found when lists were looked at last."""
        return turning_cells(crowd_of(self.domain, self._found.positions), *walls_of(self._found))

    def _turns_of(self, positions: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        first = positions[:, :1] if positions.ndim == 3 else positions
        return np.where(self._turns_off, np.floor(first / self._extent), 0.0) + 0 * positions

    def _number_copies(self, turns: Float[np.ndarray, "n d"]) -> None:
        """Take off other turns, and number each candidate's copy so that it is where it was."""
        n, images = len(turns), self.domain.base.images()
        copy, owner = np.divmod(np.maximum(self._lists, 0), n)
        moved = np.where(self._has_copies, turns - self.turns, 0).reshape(n, -1, turns.shape[-1])[:, 0]
        shift = images[copy] + moved[owner] - moved
        same = (shift[..., None, :] == images).all(axis=-1)
        number = np.where((self._lists >= 0) & same.any(axis=-1), same.argmax(axis=-1) * n + owner, -1)
        self._lists, self.turns = number.astype(np.int32), turns

    def _shorten(self, found: Measured) -> None:
        """Keep the candidates that are nearest to bounding the cells as they are measured."""
        lists = found.lists
        clear, unit = clearances(self.domain, found, lists)
        most = int((clear < NEAR * unit).sum(axis=0).max())
        self._width = max(self._width, -(-most // ROUND_UP) * ROUND_UP)
        order = np.argsort(clear, axis=0, kind="stable")[: self._width]
        self._lists = np.take_along_axis(lists, order, axis=0)
        spare = self._width - len(self._lists)
        self._lists = np.pad(self._lists, ((0, spare), (0, 0)), constant_values=-1).astype(np.int32)


def walls_of(found: Measured) -> tuple[Int[np.ndarray, " w"], Int[np.ndarray, " w"]]:
    """The cells and the backbones beyond each of their walls on each layer."""
    slot, layer, cell = np.nonzero(np.asarray(found.sections.is_edge))
    line = np.asarray(found.sections.line)[slot, layer, cell]
    walls = line < len(found.lists)
    return cell[walls], found.lists[line[walls], cell[walls]]


def clearances(domain: Domain, found: Measured, lists: Int[np.ndarray, "q n"]) -> tuple[np.ndarray, float]:
    """How much farther each candidate is from all corners of a cell than its backbone, [q, n]; and that in the mean."""
    start, along = crowd_of(domain, found.positions).pieces()
    corners = np.stack([np.asarray(part) for part in found.sections.corner], axis=-1)
    corners = corners.reshape(-1, *corners.shape[2:])  # [corners, n, 3]
    is_corner = np.asarray(found.sections.is_edge).reshape(corners.shape[:2])

    def distance(number: Int[np.ndarray, "n"]) -> Float[np.ndarray, "corners n"]:
        return distances(start[:, number], along[:, number], corners)

    own = distance(np.arange(lists.shape[1]))
    rows = (np.where(is_corner, distance(np.maximum(row, 0)) - own, np.inf).min(axis=0) for row in lists)
    return np.where(lists >= 0, np.stack(list(rows)), np.inf), float(own[is_corner].mean())
