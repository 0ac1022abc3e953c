"""The public names and where they are; each is imported when it is first used."""

from .compilation.devices import use_cores as use_cores
from .diagram.exact import ExactDiagram as ExactDiagram, exact_cells as exact_cells
from .diagram.labels import (
    label_image as label_image,
    label_volumes as label_volumes,
    nearest_backbones as nearest_backbones,
)
from .diagram.point_location import label_points as label_points
from .diagram.spread import covering_radius as covering_radius, separation as separation, tightness as tightness
from .diagram.voxels import cartesian_voxels as cartesian_voxels, cylindrical_voxels as cylindrical_voxels
from .dynamics.annealer import Annealer as Annealer
from .dynamics.schedules import constant_schedule as constant_schedule, geometric_schedule as geometric_schedule
from .dynamics.steps import init as init, step as step
from .dynamics.sweep_log import SweepRecord as SweepRecord
from .dynamics.tempering import temper as temper
from .energy import (
    Model as Model,
    epithelial_energy as epithelial_energy,
    lateral_tension as lateral_tension,
    tube_model as tube_model,
    volume_elasticity as volume_elasticity,
)
from .geometry.domain_files import load_domain as load_domain
from .geometry.shapes import (
    BentTube as BentTube,
    Ellipsoid as Ellipsoid,
    EllipticTube as EllipticTube,
    Fold as Fold,
    RoundTube as RoundTube,
    Slab as Slab,
    Sphere as Sphere,
)
from .geometry.shells import Shell as Shell
from .geometry.tube import Tube as Tube, cells_for_unit_volume as cells_for_unit_volume
from .images.label_cells import LabelCells as LabelCells, measure_labels as measure_labels
from .images.tissue_fit import TissueFit as TissueFit, fit_tissue as fit_tissue
from .measurement.adhesion import Adhesion as Adhesion
from .measurement.cell_geometry import CellGeometry as CellGeometry
from .measurement.quadrature import PRESETS as PRESETS, Resolution as Resolution
from .minimization.inference import infer_parameters as infer_parameters
from .minimization.langevin import sample_langevin as sample_langevin
from .minimization.relaxation import relax as relax
from .minimization.response import minimum_response as minimum_response
from .minimization.tissue_energy import tissue_energy as tissue_energy
from .neighbors.neighbor_list import NeighborList as NeighborList
from .simulation import AnnealResult as AnnealResult, anneal as anneal
from .tissue.measurer import CellMeasurer as CellMeasurer, measure_tissue as measure_tissue
from .topology.contacts import Contacts as Contacts, find_contacts as find_contacts
from .topology.neighbor_law import bound_ratios as bound_ratios, fit_neighbor_law as fit_neighbor_law
from .topology.statistics import (
    Connectivity as Connectivity,
    find_connectivity as find_connectivity,
    polygon_classes as polygon_classes,
    summarize_connectivity as summarize_connectivity,
    tabulate_connectivity as tabulate_connectivity,
    tissue_graph as tissue_graph,
)
from .topology.transitions import find_transitions as find_transitions

__all__: list[str]
__version__: str
