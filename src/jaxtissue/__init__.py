"""jaxtissue: simulate and measure 3D epithelial tubes from their cells' backbones.

>>> import jax, jaxtissue as jt
>>> tube = jt.Tube(length=20, apical_radius=1, basal_radius=10)
>>> positions = tube.random_positions(jax.random.key(0), 100)
>>> cells = jt.measure_tissue(positions, tube)
>>> bool(abs(cells.volume.sum() / tube.volume - 1) < 1e-3)
True
"""

import jaxtissue.system.signals  # noqa: F401  Ctrl-C is answered from here on: the other imports take seconds

# isort: split
from jaxtissue.compilation.devices import use_cores
from jaxtissue.diagram.exact import ExactDiagram, exact_cells
from jaxtissue.diagram.labels import label_image, label_volumes, nearest_backbones
from jaxtissue.diagram.point_location import label_points
from jaxtissue.diagram.spread import (
    covering_radius,
    neighbor_bound,
    separation,
    tightness,
    tube_neighbor_bound,
)
from jaxtissue.diagram.voxels import cartesian_voxels, cylindrical_voxels
from jaxtissue.dynamics.annealer import Annealer, AnnealState, advance_together, record_together
from jaxtissue.dynamics.local_updates import TissueState, tissue_state
from jaxtissue.dynamics.metropolis import Order, SweepInfo, sweep
from jaxtissue.dynamics.schedules import constant_schedule, geometric_schedule, has_stalled
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.energy import Model, epithelial_energy, lateral_tension, tube_model, volume_elasticity
from jaxtissue.geometry.backbones import Backbones, distance_between_segments, distance_to_segment
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube, cells_for_unit_volume
from jaxtissue.measurement.cells import CellGeometry, measure_cells
from jaxtissue.measurement.quadrature import PRESETS, Lines, Resolution, as_resolution, plan_lines
from jaxtissue.neighbors.search import check_angles, find_candidates, split_by_side, tiling_defect
from jaxtissue.tissue.measurer import CellMeasurer, measure_tissue
from jaxtissue.topology.contacts import Contacts, find_contacts
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.neighbor_law import NeighborLaw, bound_ratios, fit_neighbor_law
from jaxtissue.topology.statistics import (
    Connectivity,
    find_connectivity,
    polygon_classes,
    summarize_connectivity,
    tabulate_connectivity,
    tissue_graph,
)
from jaxtissue.topology.transitions import CellForms, Transitions, find_forms, find_transitions

__all__ = [
    "PRESETS",
    "AnnealState",
    "Annealer",
    "Backbones",
    "CellForms",
    "CellGeometry",
    "CellMeasurer",
    "Connectivity",
    "Contacts",
    "ExactDiagram",
    "Lines",
    "Model",
    "NeighborLaw",
    "Order",
    "Resolution",
    "SweepInfo",
    "SweepRecord",
    "TissueState",
    "Transitions",
    "Tube",
    "advance_together",
    "as_positions",
    "as_resolution",
    "bound_ratios",
    "cartesian_voxels",
    "cells_for_unit_volume",
    "check_angles",
    "constant_schedule",
    "covering_radius",
    "cylindrical_voxels",
    "distance_between_segments",
    "distance_to_segment",
    "epithelial_energy",
    "exact_cells",
    "find_candidates",
    "find_connectivity",
    "find_contacts",
    "find_forms",
    "find_transitions",
    "fit_neighbor_law",
    "geometric_schedule",
    "has_stalled",
    "label_image",
    "label_points",
    "label_volumes",
    "lateral_tension",
    "measure_cells",
    "measure_tissue",
    "nearest_backbones",
    "neighbor_bound",
    "plan_lines",
    "polygon_classes",
    "record_together",
    "separation",
    "split_by_side",
    "summarize_connectivity",
    "sweep",
    "tabulate_connectivity",
    "tightness",
    "tiling_defect",
    "tissue_graph",
    "tissue_state",
    "trace_edges",
    "tube_model",
    "tube_neighbor_bound",
    "use_cores",
    "volume_elasticity",
]
