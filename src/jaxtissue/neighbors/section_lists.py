"""Complete lists for sections: they grow until no corner of a cell is nearer to a backbone that is not listed."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxtissue.compilation.batching import Batch
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import as_nodes
from jaxtissue.geometry.vectors import components
from jaxtissue.sections.cells import MANY_SLOTS, RULE, CellSizes, Layers, cell_sections, cell_sizes, corner_points
from jaxtissue.sections.crowd import Crowd, extended, first_lists, gather_bent, gather_crowd, missing, padded
from jaxtissue.sections.polygons import Rule
from jaxtissue.sections.sizes import Sections

ROUNDS = 8  # of looking for missing neighbors


class Measured(NamedTuple):
    """Cells as measured on complete lists."""

    positions: np.ndarray
    lists: Int[np.ndarray, "q n"]
    layers: Layers
    sections: Sections
    sizes: CellSizes
    unproved: int  # corners of which no one knows whether a neighbor is missing
    rule: Rule  # with slots for all edges


class _Plan(eqx.Module):
    """On which layers cells are measured, and how."""

    layers: Layers
    rule: Rule = eqx.field(static=True)


def _measure(
    domain: Domain, positions: Array, lists: Array, plan: _Plan
) -> tuple[Sections, CellSizes, tuple[Array, Array]]:
    sections = cell_sections(domain, positions, lists, jnp.asarray(plan.layers.heights), plan.rule)
    points, is_point = corner_points(sections)
    return sections, cell_sizes(domain, sections, plan.layers, lists.shape[0]), (jnp.stack(points, axis=-1), is_point)


def crowd_of(domain: Domain, positions: np.ndarray) -> Crowd:
    """All backbones and their copies."""
    return Crowd(_segments(domain, positions), len(positions))


@jax.jit
def _segments(domain: Domain, positions: Array) -> Any:
    if positions.ndim == 2:
        return gather_crowd(domain, components(positions)).segments
    return gather_bent(domain, as_nodes(positions, domain)).segments


def find_sections(
    domain: Domain,
    positions: np.ndarray,
    layers: Layers,
    rule: Rule = RULE,
    also: Int[np.ndarray, "q n"] | None = None,
) -> Measured:
    """Measure sections on lists that grow until no corner of a cell is nearer to a backbone that is not listed.

    Other candidates may be listed `also`, which saves rounds.
    """
    lists, rounds = first_lists(crowd_of(domain, positions)), 0
    if also is not None:
        slot, cell = np.nonzero(also >= 0)
        lists = extended(lists, np.stack([cell, also[slot, cell]], axis=1))
    while True:
        rounds += 1
        found, pairs = look_through(domain, positions, lists, layers, rule)
        rule = found.rule
        if not len(pairs):
            return found
        if rounds == ROUNDS:
            return found._replace(unproved=found.unproved + len(pairs))
        lists = extended(lists, pairs)


def look_through(
    domain: Domain, positions: np.ndarray, lists: Int[np.ndarray, "q n"], layers: Layers, rule: Rule
) -> tuple[Measured, Int[np.ndarray, "m 2"]]:
    """Measure sections on lists as they are, and the pairs of a cell and a backbone that its list lacks."""
    n, lists = len(positions), padded(lists, domain)
    call = domain, positions, lists.astype(np.int32), _Plan(layers, rule)
    ((sections, sizes, (points, is_point)),) = Batch().run(_measure, [call], light=True)
    if (sections.spare > 0).any() and rule.slots < MANY_SLOTS:
        return look_through(domain, positions, lists, layers, rule._replace(slots=MANY_SLOTS))
    count = len(layers.heights)
    # straight backbones near each other on these layers are near in between; bent ones need not be
    shown = sorted({0, count // 3, count - 2, count - 1}) if positions.ndim == 2 else list(range(count))
    is_point = is_point[:, :, shown]
    cells = np.broadcast_to(np.arange(n), is_point.shape)[is_point]
    crowd = crowd_of(domain, positions)
    pairs, unproved = missing(crowd, lists, points.astype(float)[:, :, shown][is_point], cells)
    return Measured(positions, lists, layers, sections, sizes, unproved, rule), pairs
