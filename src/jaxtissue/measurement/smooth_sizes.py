"""The sizes of cells as differentiable functions of the positions and of the tube's sizes.

What bounds each cell on each line is found first, without derivatives. Given that, sizes are closed forms of the cell
and the neighbors that bound it. Where one neighbor takes over from the next between two lines is part of these forms,
so that derivatives of areas are those of the true areas as edges move.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import SCATTER, take_rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.measurement.axial_lines import (
    LEVEL,
    BackboneCoords,
    LineFrame,
    RelativeCoords,
    backbone_coords,
    coords_by_side,
    pick,
    turn_between,
    window_in_frame,
)
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.cells import BLOCK, integrate, through_windows
from jaxtissue.measurement.quadrature import Lines
from jaxtissue.measurement.walls import BOUNDARY, Walls, bounding_neighbor, is_level, wall_forms, walls

SPARE = 2  # windows for which there is room, per cell
LEAST = 1e-12  # of squares, below which roots are not differentiated


class Windows(NamedTuple):
    """The windows of lines in which cells are measured, in blocks, and what bounds the cells there.

    Attributes:
        item: The cell of each window, the number of cells where there is none, [blocks, width].
        shift: How many windows onward from the middle one it is.
        rival: The cell that bounds it on each line, behind and ahead, or BOUNDARY, [blocks, lines, 2, width].
        block: The number of blocks in use.
    """

    item: Int[Array, "blocks width"]
    shift: Int[Array, "blocks width"]
    rival: Int[Array, "blocks lines 2 width"]
    block: Int[Array, ""]

    @property
    def overflows(self) -> Bool[Array, ""]:
        """Whether there was no room for all windows."""
        return self.block > len(self.item)


def find_windows(
    positions: Float[Array, "n 2"], tube: Tube, lines: Lines, candidates: Int[Array | np.ndarray, "n 2 k"]
) -> Windows:
    """What bounds each cell on each line, in as many windows as it reaches; it has no derivatives."""
    positions, tube, lines = jax.lax.stop_gradient((positions, tube, lines))
    table, lists, n = backbone_coords(positions), jnp.asarray(candidates), len(positions)
    width, dtype = min(n, BLOCK), positions.dtype
    blocks = -(-SPARE * n // width) + 8
    rows = len(lines.number)
    start = Windows(
        jnp.full((blocks, width), n, jnp.int32),
        jnp.zeros((blocks, width), jnp.int32),
        jnp.full((blocks, rows, 2, width), BOUNDARY, jnp.int32),
        jnp.zeros((), jnp.int32),
    )
    edges = jnp.stack([lines.number == sign * np.array(lines.half)[lines.layer] for sign in (-1, 1)]).astype(dtype)

    def measure(items: Array, shift: Array, done: Windows) -> tuple[Windows, Array]:
        others = take_rows(lists, items).transpose(2, 1, 0)
        own = pick(table, items)
        ends = jnp.stack([own.axial, tube.length - own.axial])
        truth = own.axial[0] > -1
        grid = window_in_frame(lines, dtype, shift, truth)
        rivals = coords_by_side(own, pick(table, others), others < items, tube)
        by = bounding_neighbor(grid, rivals, ends, tube, truth)
        reach = walls(by, rivals, ends, grid, tube, truth).reach
        inside, step = reach[:, 0] + reach[:, 1] > 0, lines.step(dtype, shift)
        strip = jnp.pad((inside[1:] | inside[:-1]) & (step[:-1] > 0), ((1, 1), (0, 0)))
        onward = edges @ (inside & (strip[1:] | strip[:-1])).astype(dtype) > 0
        rival = jnp.where(by == BOUNDARY, BOUNDARY, jnp.take_along_axis(others, jnp.maximum(by, 0), axis=0))
        at = done.block
        found = Windows(
            done.item.at[at].set(items, **SCATTER),
            done.shift.at[at].set(shift, **SCATTER),
            done.rival.at[at].set(rival, **SCATTER),
            at + 1,
        )
        return found, onward

    return through_windows(measure, n, n, width, start)


def smooth_sizes(
    positions: Float[Array, "n 2"], tube: Tube, lines: Lines, windows: Windows, adhesion: Adhesion | None = None
) -> CellGeometry:
    """The sizes of all cells, differentiable in the positions, the tube and the weights of adhesion."""
    table, n = backbone_coords(positions), len(positions)

    def block(items: Array, shift: Array, rival: Array) -> list[tuple[Array, Array]]:
        cells = jnp.minimum(items, n - 1)
        own, here = pick(table, cells), rival != BOUNDARY
        others = pick(table, jnp.where(here, rival, cells))
        ends = jnp.stack([own.axial, tube.length - own.axial])
        truth = own.axial[0] > -1
        grid = window_in_frame(lines, positions.dtype, shift, truth)
        half, turn = _facing_coords(own, others, here, tube)
        wall = _forms(~here, half, turn, ends, grid, tube)
        if adhesion is not None:
            wall = wall._replace(area=wall.area * adhesion.between(cells, jnp.where(here, rival, cells)))
        return integrate(wall, lines.step(positions.dtype, shift), lines, truth, smooth=True)

    def block_if_any(_: None, window: tuple[Array, Array, Array]) -> tuple[None, list[tuple[Array, Array]]]:
        none = jax.tree.map(lambda size: jnp.zeros(size.shape, size.dtype), jax.eval_shape(block, *window))
        return None, jax.lax.cond(window[0][0] < n, block, lambda *_: none, *window)

    _, found = jax.lax.scan(jax.checkpoint(block_if_any), None, (windows.item, windows.shift, windows.rival))
    cells = windows.item.ravel()
    totals = [jnp.zeros(n, positions.dtype).at[cells].add(size.ravel(), **SCATTER) for pair in found for size in pair]
    sizes, surfaces = totals[:2], totals[2:]
    sizes = [jnp.where(windows.overflows, jnp.nan, size) for size in sizes]
    return CellGeometry(*sizes, *surfaces[::2], *surfaces[1::2])


def _forms(end: Array, half: Array, turn: Array, ends: Array, grid: LineFrame, tube: Tube) -> Walls:
    """The walls, by forms whose derivatives begin from these arguments again: tables kept take longer to read."""
    given = end, half, turn, ends, grid, tube
    level = is_level(RelativeCoords(half, half, turn.real, turn.imag), tube).any()

    def forms(some_level: bool) -> Callable[..., Walls]:
        return jax.checkpoint(functools.partial(wall_forms, some_level=some_level, smooth=True), prevent_cse=False)

    return jax.lax.cond(level, forms(True), forms(False), *given)


def _facing_coords(own: BackboneCoords, others: BackboneCoords, here: Array, tube: Tube) -> tuple[Array, Array]:
    """Half the distance along the axis and the turn of the neighbors that bound cells, [lines, 2, cells].

    Where there is none, they are anything whose derivatives are finite.
    """
    gap, (versine, sine) = others.axial - own.axial, turn_between(own, others)
    root = jnp.sqrt(jnp.where(here & (versine > LEAST), 2 * versine, 1))
    level = jnp.where(here & (versine > LEAST), LEVEL * tube.apical_radius * root, 0)
    half = jnp.where(here, jnp.maximum(jnp.abs(gap), level), 1) / 2
    return half, jax.lax.complex(versine, sine)
