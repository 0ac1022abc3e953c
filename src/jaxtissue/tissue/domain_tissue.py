"""Measuring whole tissues on any domain, by sections, on lists that are proved to be complete."""

import functools
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxtissue.compilation.modes import double_precision
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import components
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Resolution
from jaxtissue.sections.cells import (
    MANY_SLOTS,
    RULE,
    CellSizes,
    Layers,
    cell_sections,
    cell_sizes,
    corner_points,
    plan_layers,
    section_layers,
)
from jaxtissue.sections.crowd import Crowd, as_array, extended, first_lists, gather_crowd, missing
from jaxtissue.sections.polygons import Rule, Sections

ROUNDS = 8  # of looking for missing neighbors
SAFETY = 2.0  # errors are this many times the difference of two rules
DEFECT = 2e-3  # of a layer, by which the sections of all cells may miss it without a warning


class Measured(NamedTuple):
    """Cells as measured on complete lists."""

    positions: np.ndarray
    lists: Int[np.ndarray, "q n"]
    layers: Layers
    sections: Sections
    sizes: CellSizes
    unproved: int  # corners of which no one knows whether a neighbor is missing


@functools.partial(jax.jit, static_argnames="rule")
def _measure(
    domain: Domain, positions: Array | np.ndarray, lists: Array, layers: Layers, rule: Rule
) -> tuple[Sections, CellSizes, tuple[Array, Array]]:
    sections = cell_sections(domain, jnp.asarray(positions), lists, jnp.asarray(layers.heights), rule)
    points, is_point = corner_points(sections)
    return sections, cell_sizes(domain, sections, layers, lists.shape[0]), (jnp.stack(points, axis=-1), is_point)


@jax.jit
def _crowd(domain: Domain, positions: Array) -> Any:
    return gather_crowd(domain, components(positions)).segments


def find_sections(domain: Domain, positions: np.ndarray, layers: Layers, rule: Rule = RULE) -> Measured:
    """Measure sections on lists that grow until no corner of a cell is nearer to a backbone that is not listed."""
    n = len(positions)
    crowd = Crowd(_crowd(domain, positions), n)
    lists, rounds = first_lists(crowd), 0
    layers = jax.tree.map(jnp.asarray, layers)
    shown = sorted({0, layers.heights.shape[0] // 3, layers.heights.shape[0] - 2, layers.heights.shape[0] - 1})
    while True:
        rounds += 1
        sections, sizes, (points, is_point) = _measure(domain, positions, as_array(lists), layers, rule)
        if (np.asarray(sections.spare) > 0).any() and rule.slots < MANY_SLOTS:
            rule = rule._replace(slots=MANY_SLOTS)
            continue
        is_point = np.asarray(is_point)[:, :, shown]
        cells = np.broadcast_to(np.arange(n), is_point.shape)[is_point]
        pairs, unproved = missing(crowd, lists, np.asarray(points, float)[:, :, shown][is_point], cells)
        if not len(pairs) or rounds == ROUNDS:
            return Measured(positions, lists, layers, sections, sizes, unproved + len(pairs))
        lists = extended(lists, pairs)


def measure_domain_tissue(
    positions: Any, domain: Domain, resolution: Resolution | str, surfaces: bool, refine: bool
) -> CellGeometry:
    """Measure every cell of a tissue on any domain, as `measure_tissue` says."""
    place = as_domain_positions(positions, domain)
    layers = plan_layers(section_layers(resolution))
    found = find_sections(domain, place, layers)
    sizes, defect = found.sizes, tiling_defect(domain, found)
    errors = [None, None]
    if refine:
        # of the cell itself; one rule alone does not show its error
        unknown = jnp.where(sizes.is_cut | (len(sizes.volume) == 1), 1.0, defect)
        errors = [
            SAFETY * jnp.abs(rules[0] - rules[-1]) + unknown * jnp.abs(rules[0])
            for rules in (sizes.volume, sizes.lateral_area)
        ]
        for message in section_doubts(domain, found, defect):
            warnings.warn(message, stacklevel=4)
    on_surfaces = [sizes.areas[0], sizes.areas[1], sizes.perimeters[0], sizes.perimeters[1]]
    return CellGeometry(
        sizes.volume[0],
        sizes.lateral_area[0],
        *(on_surfaces if surfaces else [None] * 4),
        touches_end=sizes.touches_end,
        volume_error=errors[0],
        lateral_area_error=errors[1],
        tiling_defect=jnp.asarray(defect, sizes.volume.dtype),
    )


def tiling_defect(domain: Domain, found: Measured) -> float:
    """The largest relative error, over the layers, of the sum of all cells' sections."""
    with double_precision():
        whole = np.asarray(_layer_volumes(domain, jnp.asarray(np.asarray(found.layers.heights, float))), float)
    measured = np.asarray(found.sizes.section_volume, float)
    return float(np.abs(measured / whole - 1).max())


_layer_volumes: Callable[[Domain, Array], Array] = jax.jit(lambda domain, heights: domain.layer_volume(heights))


def section_doubts(domain: Domain, found: Measured, defect: float) -> Iterator[str]:
    """The warnings about sections that cannot be trusted."""
    n = len(found.positions)
    cut = np.flatnonzero(np.asarray(found.sizes.is_cut))
    if len(cut):
        told = ", ".join(map(str, cut[:5].tolist()))
        yield f"{len(cut)} of {n} cells reach beyond what one of their sections can show: cells {told}; take more cells"
    if found.unproved:
        yield f"a neighbor may be missing at {found.unproved} corners of cells; sizes there may be too large"
    if not defect <= DEFECT:
        told = f"the sections of the {n} cells miss a layer of the tissue by {100 * defect:.2g} %"
        yield f"{told}: some lack a part, or overlap"
