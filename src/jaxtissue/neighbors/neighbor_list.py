"""Neighbor lists: for each cell the backbones that can bound it, allocated once and used while they hold."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.neighbors.search import TILES, check_angles, check_lists, complete_lists, find_check
from jaxtissue.neighbors.section_neighbors import SectionNeighbors


class NeighborList(eqx.Module):
    """The candidates that can bound each cell, behind it and ahead of it along the axis.

    A list is complete when the cells measured on it tile every line parallel to the axis: the relative error of the
    lengths summed along a line, the `tiling_defect`, is then 0 to rounding. Lists stay complete while backbones move a
    little, so they are allocated on the host, kept, and checked with `covers`, which may be jitted.

    Attributes:
        candidates: Numbers of the candidates behind ([:, 0]) and ahead ([:, 1]) of each cell, padded with the cell
            itself, [n, 2, k].
        domain: The tube that the backbones stand in.
        tiling_defect: The defect at the positions that the list was allocated for.
        is_far: Whether a cell has a part farther round the axis than its first window of lines reaches, [n].
        angles: Where the lines of the check stand, [layers, lines], in radians.
        margin: The distance along the axis within which backbones are listed on both sides.

    >>> import jax
    >>> tube = Tube(length=40, apical_radius=2, basal_radius=6)
    >>> positions = tube.random_positions(jax.random.key(0), 100)
    >>> neighbors = NeighborList.allocate(positions, tube)
    >>> bool(neighbors.covers(positions)), neighbors.update(positions) is neighbors
    (True, True)
    """

    candidates: Int[Array | np.ndarray, "n 2 k"]
    domain: Tube
    tiling_defect: Float[Array | np.ndarray, ""]
    is_far: Bool[Array | np.ndarray, "n"]
    angles: Float[Array | np.ndarray, "layers lines"]
    margin: float = 0.0

    @staticmethod
    @usual_modes()
    def allocate(positions: Any, domain: Any, margin: float = 0.0) -> Any:
        """The complete list of a tissue: as many nearest backbones as it takes for the cells to tile every line.

        On domains other than a `Tube` lists are of another kind, `SectionNeighbors`, with the same methods.

        Args:
            positions: (axial, angle) of each backbone, [n, 2], in any form that `as_positions` takes.
            domain: The tube or other domain that they stand in.
            margin: Backbones within this distance along a tube's axis, a length, are listed both behind and ahead, so
                that the list holds while a backbone passes another. Other domains need none.

        Returns:
            The list, with its defect.

        Raises:
            ValueError: If `as_positions` refuses the positions.
        """
        if isinstance(domain, Domain):
            return SectionNeighbors.allocate(positions, domain)
        return list_neighbors(as_positions(positions, domain), domain, margin)

    @usual_modes()
    def covers(self, positions: Float[Array | np.ndarray, "n 2"]) -> Bool[Array | np.ndarray, ""]:
        """Whether the list is still complete for a tissue that moved.

        The check looks along a number of lines only: a small part of a cell that is lacking between them is not seen.

        Args:
            positions: (axial, angle) of each backbone, [n, 2]; may be traced.

        Returns:
            One truth value.

        Raises:
            ValueError: If the number of backbones is not that of the list.
        """
        if len(positions) != len(self):
            raise ValueError(f"{len(positions)} positions for a list of {len(self)} cells; allocate another")
        if any(isinstance(leaf, Tracer) for leaf in (positions, *jax.tree.leaves(self))):
            place = jnp.asarray(positions, jnp.result_type(float))
            return check_lists(place, self.domain, self.candidates, self.angles).defect < TILES
        place = np.asarray(positions, jnp.result_type(float))
        return np.asarray(find_check(place, self.domain, np.asarray(self.candidates)).defect < TILES)

    @usual_modes()
    def update(self, positions: Any) -> "NeighborList":
        """This list where it covers the positions, else one allocated anew; on the host.

        Args:
            positions: (axial, angle) of each backbone, [n, 2].

        Returns:
            A list that is complete for them.

        Raises:
            ValueError: If `as_positions` refuses the positions.
        """
        place = as_positions(positions, self.domain)
        if len(place) == len(self) and self.covers(place):
            return self
        return list_neighbors(place, self.domain, self.margin)

    def __len__(self) -> int:
        return len(self.candidates)

    def __repr__(self) -> str:
        if not isinstance(self.tiling_defect, np.ndarray | np.floating | float):
            return eqx.tree_pformat(self)
        cells, _, most = self.candidates.shape
        return f"NeighborList({cells} cells, up to {most} candidates a side, tiling defect {self.tiling_defect:.1e})"


def list_neighbors(positions: Float[Array | np.ndarray, "n 2"], domain: Tube, margin: float = 0.0) -> NeighborList:
    """`NeighborList.allocate` for positions that passed their gate."""
    candidates, check = complete_lists(positions, domain, margin)
    return NeighborList(candidates, domain, check.defect, check.is_far, check_angles(domain, len(positions)), margin)
