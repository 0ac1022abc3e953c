"""A tissue with all that is exported or drawn of it, each part found when it is first asked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.cell_meshes import TOLERANCE, CellMeshes, mesh_cells
from jaxtissue.meshes.shapes import ratio, tabulate_shapes
from jaxtissue.topology.contacts import Contacts
from jaxtissue.topology.statistics import Connectivity, find_connectivity, tabulate_connectivity

_SIZES = ("volume", "lateral_area", "apical_area", "basal_area", "apical_perimeter", "basal_perimeter")


@dataclass(frozen=True)
class TissueRecord:
    """A tissue, its contacts, its meshes and its table of cells.

    Attributes:
        positions: (axial, angle) of each backbone, [n, 2].
        tube: The tube that the backbones stand in.
        names: The names of the cells, if they have any.
        unit: The unit of all lengths, such as "um"; empty if none was given.
        history: Positions after some sweeps of a run, by sweep.
        tolerance: That of the meshes.
        traced: Its connectivity, if it is known already.
    """

    positions: Float[np.ndarray, "n 2"]
    tube: Tube
    names: Sequence[str] | None = None
    unit: str = ""
    history: Mapping[int, Float[np.ndarray, "n 2"]] = field(default_factory=dict)
    tolerance: float = TOLERANCE
    traced: Connectivity | None = None

    @cached_property
    def connectivity(self) -> Connectivity:
        """Contacts, transition points, forms and sizes."""
        return self.traced or find_connectivity(self.positions, self.tube)

    @cached_property
    def meshes(self) -> CellMeshes:
        """The surfaces of the cells."""
        return mesh_cells(self.positions, self.tube, self.tolerance)

    @cached_property
    def ends(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """The apical and the basal ends of the backbones."""
        axial, angle = np.asarray(self.positions, float).T
        radii = float(self.tube.apical_radius), float(self.tube.basal_radius)
        first, second = (np.stack([axial, r * np.cos(angle), r * np.sin(angle)], axis=1) for r in radii)
        return first, second

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """The table of cells: positions, sizes, neighbors, shapes, and names if there are any."""
        axial, angle = np.asarray(self.positions, float).T
        apical, basal = self.ends
        columns = {"cell": np.arange(len(axial)), "axial": axial, "angle": angle}
        columns |= dict(zip("xyz", (apical + basal).T / 2, strict=True))
        sizes = self.connectivity.sizes
        if sizes is not None:
            columns |= {name: getattr(sizes, name) for name in _SIZES}
        else:
            columns |= {"volume": self.meshes.volumes()}
        columns |= {"is_end": self.connectivity.is_end} | tabulate_connectivity(self.connectivity)
        columns |= tabulate_shapes(self.meshes, basal - apical) | tabulate_walls(self.connectivity.contacts)
        if sizes is not None:
            columns["surface_ratio"] = ratio(sizes.basal_area, sizes.apical_area)
        return columns | ({"name": np.array(self.names, dtype=object)} if self.names else {})


def tabulate_walls(contacts: Contacts) -> dict[str, Float[np.ndarray, " n"]]:
    """Mean and standard deviation of the areas of each cell's walls, one for each neighbor.

    The mean is not a number for a cell without neighbors, the deviation for one with fewer than two.
    """
    cell, area = contacts.pairs.T.ravel(), np.tile(contacts.area, 2)
    count = contacts.degree()
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(cell, area, contacts.cells) / count
        square = np.bincount(cell, (area - mean[cell]) ** 2, contacts.cells) / (count - 1)
    return {"wall_area_mean": mean, "wall_area_sd": np.sqrt(np.where(count > 1, square, np.nan))}
