"""First moments of cells on the lines, which give their centroids relative to their backbones."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import SCATTER, take_rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import backbone_coords, coords_by_side, pick, window_in_frame
from jaxtissue.measurement.cells import BLOCK, through_windows
from jaxtissue.measurement.quadrature import Lines
from jaxtissue.measurement.walls import least_reach


class Moments(NamedTuple):
    """Integrals over each cell, as seen from its backbone.

    Attributes:
        volume: The integral of 1, [n].
        axial: The integral of the axial distance from the backbone, [n].
        along: The integral of the cosine of the angle from the backbone, [n].
        across: The integral of its sine, [n].
    """

    volume: Float[Array, "n"]
    axial: Float[Array, "n"]
    along: Float[Array, "n"]
    across: Float[Array, "n"]


def measure_moments(
    positions: Float[Array, "n 2"], tube: Tube, lines: Lines, candidates: Int[Array | np.ndarray, "n 2 k"]
) -> Moments:
    """The moments of all cells among their candidates: on each line a cell is one interval, between lines trapezia."""
    table, lists, n = backbone_coords(positions), jnp.asarray(candidates), len(positions)
    dtype, number = positions.dtype, lines.number
    weight = (jnp.asarray(lines.weight, dtype) * jnp.asarray(lines.radius, dtype))[lines.layer]
    edges = jnp.stack([number == sign * np.array(lines.half)[lines.layer] for sign in (-1, 1)]).astype(dtype)

    def measure(items: Array, shift: Array, done: Moments) -> tuple[Moments, Array]:
        others = take_rows(lists, items).transpose(2, 1, 0)
        own = pick(table, items)
        ends = jnp.stack([own.axial, tube.length - own.axial])
        truth = own.axial[0] > -1
        grid = window_in_frame(lines, dtype, shift, truth)
        rivals = coords_by_side(own, pick(table, others), others < items, tube)
        reach, step = least_reach(grid, rivals, ends, tube, truth), lines.step(dtype, shift)
        behind, ahead = reach[:, 0], reach[:, 1]
        share = jnp.maximum(behind + ahead, 0) * (step + jnp.roll(step, 1, axis=0)) / 2
        factors = jnp.stack([jnp.ones_like(share), (ahead - behind) / 2, grid.z / grid.radius, grid.y / grid.radius])
        found = jnp.einsum("l,mlc->mc", weight, factors * share, precision=jax.lax.Precision.HIGHEST)
        onward = edges @ (share > 0).astype(dtype) > 0
        return jax.tree.map(lambda total, more: total.at[items].add(more, **SCATTER), done, Moments(*found)), onward

    start: Any = Moments(*4 * [jnp.zeros(n, dtype)])
    return through_windows(measure, n, n, min(n, BLOCK), start)
