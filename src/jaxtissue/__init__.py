"""jaxtissue: simulate and measure 3D epithelial tubes from their cells' backbones.

>>> import jax, jaxtissue as jt
>>> tube = jt.Tube(length=12, apical_radius=1, basal_radius=3)
>>> positions = tube.random_positions(jax.random.key(0), 40)
>>> cells = jt.measure_tissue(positions, tube)
>>> bool(abs(cells.volume.sum() / tube.volume - 1) < 1e-3)
True
"""

import jaxtissue.compilation.flags
import jaxtissue.system.signals  # noqa: F401  Ctrl-C is answered from here on: the other imports take seconds

# isort: split
from importlib.metadata import version

from jaxtissue.compilation.devices import use_cores
from jaxtissue.diagram.exact import ExactDiagram, exact_cells
from jaxtissue.diagram.labels import label_image, label_volumes, nearest_backbones
from jaxtissue.diagram.point_location import label_points
from jaxtissue.diagram.spread import covering_radius, separation, tightness
from jaxtissue.diagram.voxels import cartesian_voxels, cylindrical_voxels
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.dynamics.schedules import constant_schedule, geometric_schedule
from jaxtissue.dynamics.steps import init, step
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.dynamics.tempering import temper
from jaxtissue.energy import Model, epithelial_energy, lateral_tension, tube_model, volume_elasticity
from jaxtissue.geometry.domain_files import load_domain
from jaxtissue.geometry.shapes import BentTube, Ellipsoid, EllipticTube, Fold, RoundTube, Slab, Sphere
from jaxtissue.geometry.shells import Shell
from jaxtissue.geometry.tube import Tube, cells_for_unit_volume
from jaxtissue.images.label_cells import LabelCells, measure_labels
from jaxtissue.images.tissue_fit import TissueFit, fit_tissue
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import PRESETS, Resolution
from jaxtissue.minimization.inference import infer_parameters
from jaxtissue.minimization.relaxation import relax
from jaxtissue.minimization.tissue_energy import tissue_energy
from jaxtissue.neighbors.neighbor_list import NeighborList
from jaxtissue.simulation import AnnealResult, anneal
from jaxtissue.tissue.measurer import CellMeasurer, measure_tissue
from jaxtissue.topology.contacts import Contacts, find_contacts
from jaxtissue.topology.neighbor_law import bound_ratios, fit_neighbor_law
from jaxtissue.topology.statistics import (
    Connectivity,
    find_connectivity,
    polygon_classes,
    summarize_connectivity,
    tabulate_connectivity,
    tissue_graph,
)
from jaxtissue.topology.transitions import find_transitions

__version__ = version("jaxtissue")

__all__ = [
    "PRESETS",
    "Adhesion",
    "AnnealResult",
    "Annealer",
    "BentTube",
    "CellGeometry",
    "CellMeasurer",
    "Connectivity",
    "Contacts",
    "Ellipsoid",
    "EllipticTube",
    "ExactDiagram",
    "Fold",
    "LabelCells",
    "Model",
    "NeighborList",
    "Resolution",
    "RoundTube",
    "Shell",
    "Slab",
    "Sphere",
    "SweepRecord",
    "TissueFit",
    "Tube",
    "anneal",
    "bound_ratios",
    "cartesian_voxels",
    "cells_for_unit_volume",
    "constant_schedule",
    "covering_radius",
    "cylindrical_voxels",
    "epithelial_energy",
    "exact_cells",
    "find_connectivity",
    "find_contacts",
    "find_transitions",
    "fit_neighbor_law",
    "fit_tissue",
    "geometric_schedule",
    "infer_parameters",
    "init",
    "label_image",
    "label_points",
    "label_volumes",
    "lateral_tension",
    "load_domain",
    "measure_labels",
    "measure_tissue",
    "nearest_backbones",
    "polygon_classes",
    "relax",
    "separation",
    "step",
    "summarize_connectivity",
    "tabulate_connectivity",
    "temper",
    "tightness",
    "tissue_energy",
    "tissue_graph",
    "tube_model",
    "use_cores",
    "volume_elasticity",
]


def __dir__() -> list[str]:
    """The public names alone; rooms and modules are internal."""
    return [*__all__, "__version__"]
