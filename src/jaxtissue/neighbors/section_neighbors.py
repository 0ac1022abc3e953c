"""Neighbor lists on any domain but a tube: the backbones that can bound a cell's sections."""

import warnings

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import bends_of
from jaxtissue.geometry.positions import as_rows
from jaxtissue.neighbors.section_lists import find_sections, look_through
from jaxtissue.sections.cells import RULE, Layers, plan_layers

LAYERS = plan_layers(2, check=False)  # on which lists are proved; the surfaces are among them
MANY = 8  # layers for bent backbones: those near each other on some layer need not be on others


def _layers(positions: np.ndarray, domain: Domain) -> Layers:
    return LAYERS if positions.ndim == 2 else plan_layers(MANY, False, bends_of(positions, domain))


class SectionNeighbors(eqx.Module):
    """Neighbor list of a domain other than `Tube`, as returned by `NeighborList.allocate`.

    The list is complete if no corner of a section of a cell is nearer to a backbone that is not listed.

    Attributes:
        candidates: Indices of the candidates of each cell, padded with -1, shape [n, k]. Index e denotes backbone e mod
            n; indices of n and above denote its periodic images.
        domain: The domain.
        unproved: Number of corners for which the search was too short to rule out a missing neighbor. Static.
        slots: Maximum number of edges per section. Static.

    >>> import jax
    >>> from jaxtissue.geometry.shapes import Slab
    >>> slab = Slab(6, 5, 2)
    >>> positions = slab.random_positions(jax.random.key(0), 20)
    >>> neighbors = SectionNeighbors.allocate(positions, slab)
    >>> neighbors.covers(positions), neighbors.update(positions) is neighbors
    (True, True)
    """

    candidates: Int[Array | np.ndarray, "n k"]
    domain: Domain
    unproved: int = eqx.field(static=True)
    slots: int = eqx.field(static=True)

    @staticmethod
    @usual_modes()
    def allocate(positions: PositionsLike, domain: Domain) -> "SectionNeighbors":
        """Build the complete neighbor list of a tissue. Runs on the host; not jittable.

        Args:
            positions: Coordinates of the backbones, array-like of shape [n, 2], or unit vectors of shape [n, 3]; for
                tilted and bent backbones those of their nodes, as in `measure_tissue`.
            domain: The domain.

        Returns:
            The list. A warning is issued if a neighbor may be missing.

        Raises:
            ValueError: If a position is not finite, lies outside the domain, or coincides with another.
        """
        place = as_domain_positions(positions, domain, bent=True)
        found = find_sections(domain, place, _layers(place, domain))
        if found.unproved:
            told = f"neighbors may be missing at {found.unproved} corners of cells, so energies may be wrong"
            warnings.warn(f"{told}; use more cells", stacklevel=5)
        return SectionNeighbors(found.lists.T, domain, found.unproved, found.rule.slots)

    @usual_modes()
    def covers(self, positions: Float[Array | np.ndarray, "n d"]) -> bool:
        """Test whether the list is still complete after backbones have moved. Runs on the host; not jittable.

        Args:
            positions: Coordinates of the backbones, shape [n, 2], or unit vectors of shape [n, 3].

        Returns:
            True if the list is complete.

        Raises:
            TypeError: If the positions are traced.
            ValueError: If the number of backbones differs from the number of cells of the list.
        """
        if isinstance(positions, Tracer):
            raise TypeError(
                f"neighbor lists on a {type(self.domain).__name__} are checked on the host; call covers outside of jit"
            )
        place = np.asarray(as_rows(positions, self.domain.columns, len(self), bent=True))
        layers, rule = _layers(place, self.domain), RULE._replace(slots=self.slots)
        found, pairs = look_through(self.domain, place, np.asarray(self.candidates).T, layers, rule)
        return not len(pairs) and found.rule == rule

    @usual_modes()
    def update(self, positions: PositionsLike) -> "SectionNeighbors":
        """Return this list if it is complete for the given positions, or else a new list. On the host; not jittable.

        Args:
            positions: Coordinates of the backbones, array-like of shape [n, 2], or unit vectors of shape [n, 3].

        Returns:
            A list that is complete for `positions`; the same object if it still was.

        Raises:
            ValueError: If a position is not finite, lies outside the domain, or coincides with another.
        """
        place = as_domain_positions(positions, self.domain, bent=True)
        return self if len(place) == len(self) and self.covers(place) else SectionNeighbors.allocate(place, self.domain)

    def __len__(self) -> int:
        return len(self.candidates)

    def __repr__(self) -> str:
        if not isinstance(self.candidates, np.ndarray):
            return eqx.tree_pformat(self)
        cells, most = self.candidates.shape
        return f"SectionNeighbors({cells} cells, up to {most} candidates, unproved at {self.unproved} corners)"
