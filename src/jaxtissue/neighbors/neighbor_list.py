"""Neighbor lists: for each cell, the backbones whose cells may share a wall with it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.positions import AXES, as_positions, as_rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.neighbors.search import TILES, check_angles, check_lists, complete_lists, find_check
from jaxtissue.neighbors.section_neighbors import SectionNeighbors


class NeighborList(eqx.Module):
    """Neighbor list of a tube: for each cell, the candidates (backbones) whose cells may share a wall with it.

    `tissue_energy` needs one. Allocate it outside of `jax.jit` with `NeighborList.allocate`, reuse it while backbones
    move by small steps, test it with `covers`, and renew it with `update`. The list is complete if the cells measured
    with it tile every line parallel to the axis.

    Attributes:
        candidates: Indices of the candidates of each cell behind it ([:, 0], smaller axial position) and ahead of it
            ([:, 1], larger axial position), padded with the index of the cell itself, shape [n, 2, k].
        domain: The tube.
        tiling_defect: Largest relative deviation, at the positions of allocation, of the summed segment lengths of the
            cells on a line from its full length. Zero up to round-off for a complete list.
        is_far: Whether part of a cell lies at an angle beyond the first window of quadrature lines around its backbone,
            booleans, shape [n].
        angles: Angles of the lines on which completeness is tested, in radians, shape [layers, lines].
        margin: Axial distance within which a backbone is listed both behind and ahead. Defaults to 0.

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
    def allocate(positions: PositionsLike, domain: Any, margin: float = 0.0) -> Any:
        """Build the neighbor list of a tissue: for each cell, every backbone that its cell may share a wall with.

        A list holds more backbones than the walls need, so that it can be kept while backbones move a little; `covers`
        tells whether it still lacks none, and `update` renews it if it does. Runs on the host; not jittable.

        Args:
            positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2]; on other
                domains coordinates of shape [n, 2] or unit vectors of shape [n, 3].
            domain: The tube or other domain.
            margin: Used for `Tube` only, where each cell has one list of backbones behind it (smaller axial position)
                and one of those ahead. A backbone within this axial distance is put on both, so that the lists stay
                valid when the two backbones pass each other. In length units; a good value is the sum of the longest
                moves of both. Defaults to 0: any such passing may make the list incomplete.

        Returns:
            A `NeighborList` for a `Tube`. For other domains, a `SectionNeighbors` with the same methods, of which
            `covers` is not jittable.

        Raises:
            ValueError: If a position is not finite, lies outside the domain, or coincides with another.
        """
        if isinstance(domain, Domain):
            return SectionNeighbors.allocate(positions, domain)
        return list_neighbors(as_positions(positions, domain), domain, margin)

    @usual_modes()
    def covers(self, positions: Float[Array | np.ndarray, "n 2"]) -> Bool[Array | np.ndarray, ""]:
        """Test whether the list is still complete after backbones have moved. Jittable.

        Completeness is tested on a finite number of lines, so a missing neighbor that affects only a small part of a
        cell between these lines can go undetected.

        Args:
            positions: Axial position and angle in radians of each backbone, shape [n, 2].

        Returns:
            Boolean scalar: True if the list is complete.

        Raises:
            ValueError: If the number of backbones differs from the number of cells of the list.
        """
        positions = as_rows(positions, AXES, len(self))
        if any(isinstance(leaf, Tracer) for leaf in (positions, *jax.tree.leaves(self))):
            place = jnp.asarray(positions, jnp.result_type(float))
            return check_lists(place, self.domain, self.candidates, self.angles).defect < TILES
        place = np.asarray(positions, jnp.result_type(float))
        return np.asarray(find_check(place, self.domain, np.asarray(self.candidates)).defect < TILES)

    @usual_modes()
    def update(self, positions: PositionsLike) -> "NeighborList":
        """Return this list if it is complete for the given positions, or else a new list. On the host; not jittable.

        Args:
            positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2]. The number of
                backbones may differ from the number of cells of the list.

        Returns:
            A list that is complete for `positions`; the same object if it still was.

        Raises:
            ValueError: If a position is not finite, lies outside the tube, or coincides with another.
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
