"""A tissue with everything that can be exported or drawn, computed on first access."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.domain_positions import column_names, ends_in_space
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import SIZES
from jaxtissue.meshes.cell_meshes import TOLERANCE, CellMeshes, mesh_cells
from jaxtissue.meshes.shapes import ratio, tabulate_shapes
from jaxtissue.topology.contacts import Contacts
from jaxtissue.topology.statistics import Connectivity, find_connectivity, tabulate_connectivity


@dataclass(frozen=True)
class TissueRecord:
    """Tissue with its contacts, meshes and table of cells, each computed on first access.

    Attributes:
        positions: Positions of the backbones, shape [n, d]; in a tube axial position and angle in radians.
        domain: The tube or other domain.
        names: Names of the cells, or None.
        unit: Unit of length, such as "um"; empty if unknown.
        history: Positions after some sweeps of a run, shape [n, d], by number of the sweep.
        tolerance: Tolerance of the meshes; see `mesh_cells`.
        traced: Result of an earlier `find_connectivity`, or None.
        measure: Function that measures the cells of a domain other than `Tube` for `columns`, such as `measure_tissue`.
            Defaults to None: `columns` then has the volumes of the meshes, without areas and perimeters.
    """

    positions: Float[np.ndarray, "n d"]
    domain: Tube | Domain
    names: Sequence[str] | None = None
    unit: str = ""
    history: Mapping[int, Float[np.ndarray, "n d"]] = field(default_factory=dict)
    tolerance: float = TOLERANCE
    traced: Connectivity | None = None
    measure: Callable[..., Any] | None = None

    @cached_property
    def connectivity(self) -> Connectivity:
        """Contacts, transition points, topology and geometry of the cells."""
        return self.traced or find_connectivity(self.positions, self.domain)

    @cached_property
    def meshes(self) -> CellMeshes:
        """Triangle meshes of the surfaces of the cells."""
        return mesh_cells(self.positions, self.domain, self.tolerance)

    @cached_property
    def ends(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Apical and basal end points of the backbones, each of shape [n, 3]."""
        return ends_in_space(self.positions, self.domain)

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Table of the cells: positions, geometry, neighbors, shape descriptors, and names if there are any."""
        apical, basal = self.ends
        columns = {"cell": np.arange(len(apical))}
        columns |= dict(zip(column_names(self.domain), np.asarray(self.positions, float).T, strict=True))
        columns |= dict(zip("xyz", (apical + basal).T / 2, strict=True))
        sizes: Any = self.connectivity.sizes
        if self.measure and isinstance(self.domain, Domain):
            sizes = self.measure(self.positions, self.domain)
        if sizes is not None:
            columns |= {name: np.asarray(getattr(sizes, name), float) for name in SIZES}
        else:
            columns |= {"volume": self.meshes.volumes()}
        columns |= {"is_end": self.connectivity.is_end} | tabulate_connectivity(self.connectivity)
        columns |= tabulate_shapes(self.meshes, basal - apical) | tabulate_walls(self.connectivity.contacts)
        if sizes is not None:
            columns["surface_ratio"] = ratio(columns["basal_area"], columns["apical_area"])
        return columns | ({"name": np.array(self.names, dtype=object)} if self.names else {})


def tabulate_walls(contacts: Contacts) -> dict[str, Float[np.ndarray, " n"]]:
    """Compute mean and standard deviation of the wall areas of each cell, with one wall per neighbor.

    The mean is NaN for a cell without neighbors, the standard deviation for a cell with fewer than two.
    """
    cell, area = contacts.pairs.T.ravel(), np.tile(contacts.area, 2)
    count = contacts.degree()
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(cell, area, contacts.cells) / count
        square = np.bincount(cell, (area - mean[cell]) ** 2, contacts.cells) / (count - 1)
    return {"wall_area_mean": mean, "wall_area_sd": np.sqrt(np.where(count > 1, square, np.nan))}
