"""Measurement of whole tissues on any domain, by sections with complete neighbor lists."""

import warnings
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxtissue.compilation.modes import double_precision
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import bends_of
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Resolution, section_layers
from jaxtissue.neighbors.section_lists import Measured, crowd_of, find_sections
from jaxtissue.sections.cells import RULE, corner_points, plan_layers
from jaxtissue.sections.crowd import overlaps
from jaxtissue.tissue.refinement import LIMITS, over_limits

# Told errors cover the true ones in 97 % of the cells and more of 16 tissues of 300 and 500 cells with these
LAYERS = 0.6  # of the difference of two rules
EDGES = (0.05, 0.5)  # of what edges may add to volumes and lateral areas, as `sections.rims.beyond` gives it
OTHERS = 0.5  # medians over the cells, since what a cell shows of its own error is small by chance in some
FLOOR = (2e-5, 4e-5)  # of the mean cell: corners after a step of Newton's method, and rounding
THOROUGH = RULE._replace(passes=5)
DEFECT = 2e-3  # of a layer, by which the sections of all cells may miss it without a warning


def measure_domain_tissue(
    positions: PositionsLike, domain: Domain, resolution: Resolution | str, surfaces: bool, refine: bool
) -> CellGeometry:
    """Measure every cell of a tissue on any domain, as `measure_tissue` says."""
    place = as_domain_positions(positions, domain, bent=True)
    if len(place) == 1 and len(domain.base.images()) == 1:
        return _whole(domain, surfaces, refine)
    layers = plan_layers(section_layers(resolution), bends=bends_of(place, domain))
    found = find_sections(domain, place, layers, THOROUGH)
    sizes, defect = jax.tree.map(jnp.asarray, found.sizes), tiling_defect(domain, found)
    errors = told_errors(domain, found, defect) if refine else [None, None]
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


def _whole(domain: Domain, surfaces: bool, refine: bool) -> CellGeometry:
    """The one cell of a tissue that is not repeated, wherever its backbone is: all of the domain, without walls."""

    def one(size: float | Array) -> Array:
        return jnp.asarray([size], float)

    volume, none = one(domain.volume), one(0)
    return CellGeometry(
        volume,
        none,
        *((one(domain.apical_area), one(domain.basal_area), none, none) if surfaces else [None] * 4),
        touches_end=jnp.asarray([domain.base.is_end().any()]),
        volume_error=FLOOR[0] * volume if refine else None,
        lateral_area_error=none if refine else None,
        tiling_defect=none[0],
    )


def told_errors(domain: Domain, found: Measured, defect: float) -> list[Array]:
    """The errors of volumes and lateral areas that are told: of layers, edges, corners, and as large as the median.

    Of cells that are cut the error is all of the cell, as it is where one rule alone shows nothing.
    """
    sizes, told, off, kinks = found.sizes, [], misplaced(domain, found), near_surfaces(found)
    unknown = np.asarray(sizes.is_cut) | (len(sizes.volume) == 1)
    for which, rules in enumerate((sizes.volume, sizes.lateral_area)):
        size, coarser = (np.asarray(rules[k], float) for k in (0, -1))
        edges = EDGES[which] * np.asarray(sizes.doubt[which], float)
        own = LAYERS * np.abs(size - coarser) + edges + off[which] + kinks[which]
        some = own[~unknown] if not unknown.all() else np.zeros(1)
        own += OTHERS * np.median(some) + FLOOR[which] * size.mean() + (defect > DEFECT) * defect * size
        told.append(jnp.asarray(np.where(unknown, own + size, own), rules.dtype))
    return told


def near_surfaces(found: Measured) -> tuple[np.ndarray, np.ndarray]:
    """What volumes and lateral areas may have beside a surface that none of the layers shows.

    Where backbones slant, the point of a neighbor's that is nearest is its end, up to some height: there sizes per
    height have a kink. What the surface has more than a parabola through the nearest layers is taken to fall off
    linearly to the first layer.
    """
    heights, weights = np.asarray(found.layers.heights, float), np.asarray(found.layers.weights[0])
    layers, missed = np.flatnonzero(weights), [np.zeros(len(found.positions))] * 2
    tables = found.sections.volume, found.sections.wall.sum(axis=0)
    for surface, end in ((-2, 0.0), (-1, 1.0)):
        near = layers[np.argsort(np.abs(heights[layers] - end))[:3]]
        powers = np.vander(heights[near] - end, increasing=True)
        share = np.linalg.inv(powers)[0]  # of each layer in the parabola's value at the surface
        reach = abs(heights[near[0]] - end) / 2
        for which, table in enumerate(np.asarray(part, float) for part in tables):
            missed[which] = missed[which] + reach * np.abs(table[surface] - share @ table[near])
    return missed[0], missed[1]


def misplaced(domain: Domain, found: Measured) -> tuple[np.ndarray, np.ndarray]:
    """How much of each cell's volume and lateral area is beyond its walls, as its corners and middles of edges show.

    They are on a wall if they are not nearer to a rival. What a point is beyond counts for the part of its edge round
    it, and what a corner is beyond for the length of its edge.
    """
    sections, weight = found.sections, np.asarray(found.layers.weights, float)[0][:, None]
    points, is_point = corner_points(sections)
    there = np.asarray(is_point)
    rim = np.stack([np.asarray(part)[there] for part in points], axis=1).astype(float)
    cells = np.broadcast_to(np.arange(len(found.positions)), there.shape)[there]
    beyond = np.zeros(there.shape)
    beyond[there] = overlaps(crowd_of(domain, found.positions), found.lists, rim, cells)
    wall, length = (np.asarray(size, float) for size in (sections.wall, sections.length))
    volume = wall * (beyond[0] / 3 + beyond[1] * 2 / 3)
    area = np.where(length > 0, wall / np.where(length > 0, length, 1), 0) * beyond[0]
    return (weight * volume.sum(axis=0)).sum(axis=0), (weight * area.sum(axis=0)).sum(axis=0)


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
    for _, told in over_limits(cells, LIMITS):
        yield f"{told}; use a finer resolution or more cells"
