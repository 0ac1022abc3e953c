"""A tissue with everything that can be exported or drawn, computed on first access."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.geometry.domain_positions import nodes_in_space, place_columns
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import SIZES
from jaxtissue.meshes.cell_meshes import TOLERANCE, CellMeshes, mesh_cells
from jaxtissue.meshes.shapes import ratio, tabulate_shapes
from jaxtissue.topology.contacts import Contacts
from jaxtissue.topology.statistics import Connectivity, find_connectivity, tabulate_connectivity

DOUBTED = 0.03  # of the mean volume: measured volumes that are farther from those of the meshes are warned of


@dataclass(frozen=True)
class TissueRecord:
    """Tissue with its contacts, meshes and table of cells, each computed on first access.

    Attributes:
        positions: Positions of the backbones, shape [n, d]; in a tube axial position and angle in radians. For tilted
            and bent backbones positions of nodes, shape [n, k, d].
        domain: The tube or other domain.
        names: Names of the cells, or None.
        unit: Unit of length, such as "um"; empty if unknown.
        history: Positions after some sweeps of a run, by number of the sweep.
        tolerance: Tolerance of the meshes; see `mesh_cells`.
        traced: Result of an earlier `find_connectivity`, or None.
        measure: Function that measures the cells of a domain other than `Tube` for `columns`, such as `measure_tissue`.
            Defaults to None: `columns` then has the volumes of the meshes, without areas and perimeters.
    """

    positions: Float[np.ndarray, "n *k d"]
    domain: Tube | Domain
    names: Sequence[str] | None = None
    unit: str = ""
    history: Mapping[int, Float[np.ndarray, "n *k d"]] = field(default_factory=dict)
    tolerance: float = TOLERANCE
    traced: Connectivity | None = None
    measure: Callable[..., Any] | None = None

    @cached_property
    def connectivity(self) -> Connectivity:
        """Contacts, transition points, topology and geometry of the cells."""
        return self.traced or find_connectivity(self.positions, self.domain)

    @cached_property
    def followed(self) -> Connectivity | None:
        """The same, or None, with a warning, where contacts can't be followed."""
        try:
            return self.connectivity
        except ValueError as error:
            if isinstance(self.domain, Tube):
                raise
            warnings.warn(f"contacts are not computed: {error}", stacklevel=3)
            return None

    @cached_property
    def pairs(self) -> Int[np.ndarray, "m 2"]:
        """Pairs of cells that touch: by their contacts or, where these can't be followed, by their meshes."""
        if self.followed:
            return self.followed.contacts.pairs
        return np.unique(self.meshes.sides[self.meshes.sides[:, 1] < self.meshes.cells], axis=0)

    @cached_property
    def meshes(self) -> CellMeshes:
        """Triangle meshes of the surfaces of the cells."""
        return mesh_cells(self.positions, self.domain, self.tolerance)

    @cached_property
    def nodes(self) -> Float[np.ndarray, "n k 3"]:
        """The points in space that the backbones join, from the apical to the basal end."""
        return nodes_in_space(self.positions, self.domain)

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Table of the cells: positions, geometry, neighbors, shape descriptors, and names if there are any."""
        columns = {"cell": np.arange(len(self.nodes))}
        columns |= place_columns(np.asarray(self.positions, float), self.domain)
        columns |= dict(zip("xyz", middles(self.nodes).T, strict=True))
        sizes: Any = self.followed and self.followed.sizes
        if self.measure and isinstance(self.domain, Domain):
            sizes = self.measure(self.positions, self.domain)
        if sizes is not None:
            columns |= {name: np.asarray(getattr(sizes, name), float) for name in SIZES}
            _warn_of_volumes(columns["volume"], self.meshes.volumes())
        else:
            columns |= {"volume": self.meshes.volumes()}
        if self.followed:
            columns |= {"is_end": self.followed.is_end} | tabulate_connectivity(self.followed)
        columns |= tabulate_shapes(self.meshes, self.nodes[:, -1] - self.nodes[:, 0])
        columns |= tabulate_walls(self.followed.contacts) if self.followed else {}
        if sizes is not None:
            columns["surface_ratio"] = ratio(columns["basal_area"], columns["apical_area"])
        return columns | ({"name": np.array(self.names, dtype=object)} if self.names else {})


def middles(nodes: Float[np.ndarray, "n k 3"]) -> Float[np.ndarray, "n 3"]:
    """The points halfway along backbones.

    >>> middles(np.array([[[0.0, 0, 0], [0, 0, 3], [1, 0, 3]]])).tolist()
    [[0.0, 0.0, 2.0]]
    """
    steps, row = np.diff(nodes, axis=1), np.arange(len(nodes))
    size = np.linalg.norm(steps, axis=2)
    end = np.cumsum(size, axis=1)
    piece = (end < end[:, -1:] / 2).sum(axis=1)
    share = 1 - (end[row, piece] - end[:, -1] / 2) / size[row, piece]
    return nodes[row, piece] + share[:, None] * steps[row, piece]


def _warn_of_volumes(measured: Float[np.ndarray, " n"], meshed: Float[np.ndarray, " n"]) -> None:
    """Warn of cells whose measured volumes are not those of their meshes."""
    off = np.abs(measured - meshed) / meshed.mean()
    over = np.argsort(-off)[: int((off > DOUBTED).sum())].tolist()
    if over:
        named = ", ".join(f"{cell} ({measured[cell]:.3g}, not {meshed[cell]:.3g})" for cell in over[:5])
        told = f"the measured volumes of {len(over)} of {len(off)} cells are not those of their meshes: cells {named}"
        warnings.warn(f"{told}; backbones that nearly cross are measured by exact_cells", stacklevel=3)


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
