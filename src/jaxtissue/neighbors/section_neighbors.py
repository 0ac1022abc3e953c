"""Neighbor lists on any domain but a tube: the backbones that can bound a cell's sections."""

import warnings
from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.neighbors.section_lists import find_sections, look_through
from jaxtissue.sections.cells import RULE, plan_layers

LAYERS = plan_layers(2, check=False)  # on which lists are proved; the surfaces are among them


class SectionNeighbors(eqx.Module):
    """The candidates that can bound each cell on a domain: `NeighborList.allocate` gives these where it is no `Tube`.

    A list is complete where no corner of a cell's section is nearer to a backbone that is not listed.

    Attributes:
        candidates: Numbers of the candidates of each cell, padded with -1, [n, k]. Number e is a copy of backbone
            e mod n beyond a period; the first n are the backbones themselves.
        domain: The domain that the backbones stand in.
        unproved: At how many corners a neighbor may be missing, since more backbones are near than were looked at.
        slots: How many edges a section has room for.

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
    def allocate(positions: Any, domain: Domain) -> "SectionNeighbors":
        """The complete list of a tissue, on the host.

        Args:
            positions: The positions of the backbones, [n, d], in any form that NumPy reads as numbers.
            domain: The domain that they stand in.

        Returns:
            The list. A warning tells where a neighbor may be missing from it.

        Raises:
            ValueError: If positions are refused: not finite, outside the domain, or two of them one.
        """
        found = find_sections(domain, as_domain_positions(positions, domain), LAYERS)
        if found.unproved:
            told = f"a neighbor may be missing at {found.unproved} corners of cells: energies may be off"
            warnings.warn(f"{told}; take more cells", stacklevel=5)
        return SectionNeighbors(found.lists.T, domain, found.unproved, found.rule.slots)

    @usual_modes()
    def covers(self, positions: Float[Array | np.ndarray, "n d"]) -> bool:
        """Whether the list is still complete for a tissue that moved; on the host.

        Args:
            positions: The positions of the backbones, [n, d].

        Returns:
            One truth value.

        Raises:
            TypeError: If the positions are traced: the proof looks for the nearest backbones by a tree.
            ValueError: If the number of backbones is not that of the list.
        """
        if isinstance(positions, Tracer):
            raise TypeError(f"lists on a {type(self.domain).__name__} are checked on the host; do so outside of jit")
        if len(positions) != len(self):
            raise ValueError(f"{len(positions)} positions for a list of {len(self)} cells; allocate another")
        place, rule = np.asarray(positions), RULE._replace(slots=self.slots)
        found, pairs = look_through(self.domain, place, np.asarray(self.candidates).T, LAYERS, rule)
        return not len(pairs) and found.rule == rule

    @usual_modes()
    def update(self, positions: Any) -> "SectionNeighbors":
        """This list where it covers the positions, else one allocated anew; on the host.

        Args:
            positions: The positions of the backbones, [n, d].

        Returns:
            A list that is complete for them.

        Raises:
            ValueError: If positions are refused.
        """
        place = as_domain_positions(positions, self.domain)
        return self if len(place) == len(self) and self.covers(place) else SectionNeighbors.allocate(place, self.domain)

    def __len__(self) -> int:
        return len(self.candidates)

    def __repr__(self) -> str:
        if not isinstance(self.candidates, np.ndarray):
            return eqx.tree_pformat(self)
        cells, most = self.candidates.shape
        return f"SectionNeighbors({cells} cells, up to {most} candidates, unproved at {self.unproved} corners)"
