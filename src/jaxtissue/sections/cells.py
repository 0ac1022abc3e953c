"""Cells from their sections: volume, walls, areas and perimeters, for all cells or some, as one pure function."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import take_rows
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import as_nodes, on_layers
from jaxtissue.geometry.vectors import Vector, components
from jaxtissue.sections.crowd import gather_bent, gather_crowd
from jaxtissue.sections.polygons import Rule
from jaxtissue.sections.sizes import Sections, measure_sections
from jaxtissue.sections.views import View, look

RULE = Rule(slots=14, passes=3, steps=1, rays=2)
QUICK = RULE._replace(passes=2)  # a fifth less time for a sweep
MANY_SLOTS = 31  # as many edges as five bits can number


class Layers(eqx.Module):
    """The layers on which cells are measured, and the weights of rules for integrals over the height.

    The last two layers are the apical and the basal surface, of weight 0.
    """

    heights: Float[Array | np.ndarray, " layers"]
    weights: Float[Array | np.ndarray, "rules layers"]


class CellSizes(NamedTuple):
    """The sizes of cells by each rule, and their walls.

    Attributes:
        volume: [rules, cells].
        lateral_area: [rules, cells].
        areas: Of the sections on the apical and the basal surface, [2, cells].
        perimeters: Of the edges with other cells there, [2, cells].
        touches_end: Whether a section reaches a free end, [cells].
        is_ring: Whether a section reaches round to where it meets itself, [cells].
        is_cut: Whether a section has more edges than slots, or reaches the limit of its chart, [cells].
        section_volume: The volume per height of all cells together, [layers].
        doubt: By how much the sections may make volume and lateral area be off, [cells] each.
    """

    volume: Array
    lateral_area: Array
    areas: Array
    perimeters: Array
    touches_end: Bool[Array, " cells"]
    is_ring: Bool[Array, " cells"]
    is_cut: Bool[Array, " cells"]
    section_volume: Array
    doubt: tuple[Array, Array]


def plan_layers(count: int, check: bool = True, bends: Float[Array | np.ndarray, " k"] | None = None) -> Layers:
    """Gauss-Legendre layers, and then, for the error estimate, those of one layer less.

    At the heights of bends, sizes per height have kinks: so each part between two of them has layers of its own, one
    more than its share of the count.
    """
    bends = np.zeros(0) if bends is None else bends
    xp, parts = (jnp if isinstance(bends, jax.Array) else np), len(bends) + 1
    low, high = xp.append(0.0, bends), xp.append(bends, 1.0)
    each, heights, weights = -(-count // parts) + (parts > 1), [], []
    for layers in (each, each - 1) if check and each > 1 else (each,):
        place, weight = np.polynomial.legendre.leggauss(layers)
        heights.append((low[:, None] + (high - low)[:, None] * (place + 1) / 2).ravel())
        weights.append(((high - low)[:, None] * weight / 2).ravel())
    none = [xp.zeros_like(weight) for weight in weights]
    rows = [xp.concatenate([*none[:k], weight, *none[k + 1 :], np.zeros(2)]) for k, weight in enumerate(weights)]
    return Layers(xp.concatenate([*heights, np.array([0.0, 1.0])]), xp.stack(rows))


def cell_view(
    domain: Domain,
    positions: Float[Array, "n d"] | Float[Array, "n k d"],
    lists: Int[Array, "q cells"],
    heights: Float[Array | np.ndarray, " layers"],
    cells: Int[Array, " cells"] | None = None,
) -> View:
    """All cells, or some, as seen on layers.

    Args:
        domain: The tissue.
        positions: The positions of all backbones, [n, d], or of their nodes, as `geometry.nodes` has them.
        lists: The candidates of each cell that is measured, as numbers in the crowd, -1 for none.
        heights: The heights of the layers.
        cells: The numbers of the cells that are measured; all if None.
    """
    positions = jnp.asarray(positions)
    heights = jnp.asarray(heights, positions.dtype)

    def some(table: Array) -> Array:
        return table[: len(positions)] if cells is None else take_rows(table, cells)

    if positions.ndim == 2:
        place = components(positions)
        crowd, centers = gather_crowd(domain, place), jax.tree.map(some, place)
    else:
        nodes = as_nodes(positions, domain)
        crowd, centers = gather_bent(domain, nodes), on_layers(jax.tree.map(some, nodes), domain, heights)
    own = jax.tree.map(some, crowd.segments)
    rivals = jax.tree.map(lambda table: take_rows(table, lists), crowd.segments)
    # a candidate that is not there stands apart, lest it be the cell itself
    return look(domain, centers, heights, own, rivals, lists >= 0)


def cell_sections(
    domain: Domain,
    positions: Float[Array, "n d"] | Float[Array, "n k d"],
    lists: Int[Array, "q cells"],
    heights: Float[Array, " layers"],
    rule: Rule,
    cells: Int[Array, " cells"] | None = None,
) -> Sections:
    """The sections of all cells, or of some, as seen by `cell_view`; the rule says how they are measured."""
    return measure_sections(domain, cell_view(domain, positions, lists, heights, cells), rule)


def cell_sizes(domain: Domain, sections: Sections, layers: Layers, candidates: int) -> CellSizes:
    """The sizes of cells from their sections on these layers, of lists with so many candidates."""
    weights = jnp.asarray(layers.weights, sections.volume.dtype)
    limit = sections.line - candidates
    is_long = sections.is_edge & (limit >= 0)
    ends, seams = (_any_limit(limit, is_long, which) for which in (domain.base.is_end(), domain.base.is_seam()))
    others = _any_limit(limit, is_long, ~(domain.base.is_end() | domain.base.is_seam()))
    return CellSizes(
        weights @ sections.volume,
        weights @ sections.wall.sum(axis=0),
        sections.area[-2:],
        sections.length.sum(axis=0)[-2:],
        ends,
        seams,
        others | (sections.spare > 0).any(axis=0),
        sections.volume.sum(axis=-1),
        (weights[0] @ sections.doubt[0], weights[0] @ sections.doubt[1]),
    )


def _any_limit(limit: Array, is_edge: Array, which: np.ndarray) -> Array:
    reached = jnp.zeros(limit.shape[-1], bool)
    for k in np.flatnonzero(which).tolist():
        reached |= (is_edge & (limit == k)).any(axis=(0, 1))
    return reached


def corner_points(sections: Sections) -> tuple[Vector, Array]:
    """The corners and middles of edges, components [2, slots, *T], and which there are."""
    points = tuple(jnp.stack(pair) for pair in zip(sections.corner, sections.middle, strict=True))
    return points, jnp.stack([sections.is_edge] * 2)
