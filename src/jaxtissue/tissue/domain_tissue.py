"""Measurement of whole tissues on any domain, by sections with complete neighbor lists."""

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxtissue.compilation.modes import double_precision
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Resolution, section_layers
from jaxtissue.neighbors.section_lists import Measured, crowd_of, find_sections
from jaxtissue.sections.cells import corner_points, plan_layers
from jaxtissue.sections.crowd import Crowd, overlaps

SAFETY = 2.0  # errors are this many times the difference of two rules
OVERLAP = 0.25  # of a cell's walls that may be off, by as much as its rim is nearer to another backbone
DEFECT = 2e-3  # of a layer, by which the sections of all cells may miss it without a warning


def measure_domain_tissue(
    positions: Any, domain: Domain, resolution: Resolution | str, surfaces: bool, refine: bool
) -> CellGeometry:
    """Measure every cell of a tissue on any domain, as `measure_tissue` says."""
    place = as_domain_positions(positions, domain, bent=True)
    layers = plan_layers(section_layers(resolution))
    found = find_sections(domain, place, layers)
    sizes, defect = found.sizes, tiling_defect(domain, found)
    errors = [None, None]
    if refine:
        # of the cell itself; one rule alone does not show its error
        unknown = jnp.where(sizes.is_cut | (len(sizes.volume) == 1), 1.0, defect)
        overlap = OVERLAP * jnp.asarray(overlaps(*rims(domain, found)), sizes.volume.dtype)
        # a wall that is off by so much, and as much of its area as of its length
        off = overlap * sizes.lateral_area[0], overlap * jnp.sqrt(sizes.lateral_area[0])
        errors = [
            SAFETY * jnp.abs(rules[0] - rules[-1]) + unknown * jnp.abs(rules[0]) + more
            for rules, more in zip((sizes.volume, sizes.lateral_area), off, strict=True)
        ]
    on_surfaces = [sizes.areas[0], sizes.areas[1], sizes.perimeters[0], sizes.perimeters[1]]
    cells = CellGeometry(
        sizes.volume[0],
        sizes.lateral_area[0],
        *(on_surfaces if surfaces else [None] * 4),
        touches_end=sizes.touches_end,
        volume_error=errors[0],
        lateral_area_error=errors[1],
        tiling_defect=jnp.asarray(defect, sizes.volume.dtype),
    )
    for message in section_doubts(cells, found) if refine else ():
        warnings.warn(message, stacklevel=4)
    return cells


def rims(domain: Domain, found: Measured) -> tuple[Crowd, np.ndarray, np.ndarray, np.ndarray]:
    """The backbones, the lists, the corners and middles of all edges in space, and the cells that they are of."""
    points, is_point = corner_points(found.sections)
    there = np.asarray(is_point)
    rim = np.stack([np.asarray(part)[there] for part in points], axis=1).astype(float)
    cells = np.broadcast_to(np.arange(len(found.positions)), there.shape)[there]
    return crowd_of(domain, found.positions), found.lists, rim, cells


def tiling_defect(domain: Domain, found: Measured) -> float:
    """The largest relative error, over the layers, of the sum of all cells' sections."""
    with double_precision():
        whole = np.asarray(_layer_volumes(domain, jnp.asarray(np.asarray(found.layers.heights, float))), float)
    measured = np.asarray(found.sizes.section_volume, float)
    return float(np.abs(measured / whole - 1).max())


_layer_volumes: Callable[[Domain, Array], Array] = jax.jit(lambda domain, heights: domain.layer_volume(heights))


def section_doubts(cells: CellGeometry, found: Measured) -> Iterator[str]:
    """The warnings about sections that cannot be trusted."""
    n, defect = len(found.positions), float(np.asarray(cells.tiling_defect))
    cut = np.flatnonzero(np.asarray(found.sizes.is_cut))
    if len(cut):
        told = ", ".join(map(str, cut[:5].tolist()))
        yield f"{len(cut)} of {n} cells are too wide to be measured completely: cells {told}; use more cells"
    if found.unproved:
        yield f"neighbors may be missing at {found.unproved} corners; sizes there may be too large: use more cells"
    if not defect <= DEFECT:
        told = f"the sections of the {n} cells add up to {100 * defect:.2g} % more or less than a layer of the tissue"
        yield f"{told}: cells are incomplete or overlap; use more cells"
