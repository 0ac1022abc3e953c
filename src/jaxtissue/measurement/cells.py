"""Measurement of cells: volume, lateral area, surfaces and perimeters, in windows of lines around each backbone."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import SCATTER, fusion_barrier, take_rows
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.measurement.axial_lines import (
    BackboneCoords,
    backbone_coords,
    coords_by_side,
    pick,
    window_in_frame,
)
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines
from jaxtissue.measurement.walls import BOUNDARY, Walls, bounding_neighbor, facing, smooth_strips, strips, walls

BLOCK = 48  # cells measured at once, whole vectors of 16; of 64 or 128 rows evict each other from the cache


class Window(NamedTuple):
    """Cells measured within one window of lines."""

    sizes: CellGeometry
    reach: Float[Array, "lines 2 cells"]  # behind and ahead; -inf on lines that do not bear on the cell
    by: Int[Array, "lines 2 cells"]  # the candidate that stops the cell there, END the tube
    onward: Bool[Array, "2 cells"]  # the cell goes on before the first lines, or after the last

    def reaches(self, row: int) -> Float[Array, "cells 2 row"]:
        """The reaches of each cell in rows, padded with -inf."""
        spare = ((0, 0), (0, 0), (0, row - len(self.reach)))
        return jnp.pad(self.reach.transpose(2, 1, 0), spare, constant_values=-jnp.inf)


def measure_window(
    own: BackboneCoords,
    others: BackboneCoords,
    first: Array,
    tube: Tube,
    lines: Lines,
    shift: Int[Array, "cells"],
    weights: Float[Array, "candidates 2 cells"] | None = None,
) -> Window:
    """Measure the cells of the backbones `own`, [cells], among their candidates, [candidates, 2, cells].

    Each in the window `shift` windows onward. `first` tells the candidates with lower numbers than the cell:
    at equal heights these are behind. Walls with a candidate count by its `weights`, or all by 1.
    """
    dtype, truth = own.axial.dtype, own.axial[0] > -1
    ends = jnp.stack([own.axial, tube.length - own.axial])
    grid = window_in_frame(lines, dtype, shift, truth)
    rivals = fusion_barrier(lambda: coords_by_side(own, others, first, tube), truth)
    by = bounding_neighbor(grid, rivals, ends, tube, truth)
    wall = walls(by, rivals, ends, grid, tube, truth)
    if weights is not None:
        wall = wall._replace(area=wall.area * take_rows(weights.ravel(), facing(by)))
    inside, step = wall.reach[:, 0] + wall.reach[:, 1] > 0, lines.step(dtype, shift)
    strip = jnp.pad((inside[1:] | inside[:-1]) & (step[:-1] > 0), ((1, 1), (0, 0)))
    bears = strip[1:] | strip[:-1]
    edges = np.stack([lines.number == sign * np.array(lines.half)[lines.layer] for sign in (-1, 1)])
    at_end = ((by == BOUNDARY) & (inside & bears)[:, None]).any(axis=(0, 1))
    (volume, area), *on_surfaces = integrate(wall, step, lines, truth)
    areas, perimeters = zip(*on_surfaces, strict=True) if on_surfaces else 2 * [(None, None)]
    sizes = CellGeometry(volume, area, *areas, *perimeters, touches_end=at_end)
    # a product, since a reduction would run one number at a time
    onward = jnp.asarray(edges, dtype) @ (inside & bears).astype(dtype) > 0
    return Window(sizes, jnp.where(bears[:, None], wall.reach, -jnp.inf), by, onward)


def integrate(wall: Walls, step: Array, lines: Lines, truth: Array, smooth: bool = False) -> list[tuple[Array, Array]]:
    """Volume and lateral area, and area and perimeter on each surface among the lines: sums over strips.

    Sums are products with the weights of the lines: as reductions they would run one number at a time.
    """
    radius, weight = (jnp.asarray(table, step.dtype)[lines.layer] for table in (lines.radius, lines.weight))

    def summed(rows: slice, weights: Array, tilt: Array) -> tuple[Array, Array]:
        part = jax.tree.map(lambda table: table[rows], wall)
        if smooth:
            sizes = smooth_strips(part, tilt[rows], step[rows], truth)
        else:
            sizes = fusion_barrier(lambda: strips(part, tilt[rows], step[rows]), truth)
        weights = (weights * radius)[rows][:-1].astype(sizes.dtype)
        total = jnp.matmul(weights, sizes, precision=jax.lax.Precision.HIGHEST)
        return total.real, total.imag

    inner = int(np.sum(lines.layer < lines.inner_layers))
    found = [summed(slice(0, inner), weight, wall.area)]
    for k in range(2 if lines.surfaces else 0):
        (rows,) = np.nonzero(lines.layer == lines.inner_layers + k)
        found.append(summed(slice(rows[0], rows[-1] + 1), jnp.ones_like(weight), wall.edge))
    return found


class Queue(NamedTuple):
    """Windows to be measured: a ring of items, each with how many windows onward, and from where to where."""

    item: Int[Array, "capacity"]
    shift: Int[Array, "capacity"]
    begin: Int[Array, ""]
    end: Int[Array, ""]


def through_windows(
    measure: Callable[[Array, Array, Any], tuple[Any, Array]],
    count: Array | int,
    size: int,
    width: int,
    done: Any,
) -> Any:
    """Measure `count` of at most `size` cells in the middle window, then those that go on beyond it.

    `measure(items, shift, done)` adds to `done` what `width` items (those from `size` on are none) show, each
    in the window `shift` windows onward, and tells which go on, [2, width], before the window and after.
    A cell that goes on joins the end of the queue, so blocks stay full whatever windows they hold.
    """
    # a cell is in the queue once for each direction at most
    capacity = 2 * size + width

    def block(state: tuple[Queue, Any]) -> tuple[Queue, Any]:
        queue, done = state
        place = queue.begin + jnp.arange(width, dtype=jnp.int32)
        at = place % capacity
        items, shift = jnp.where(place < queue.end, queue.item[at], size), queue.shift[at]
        done, onward = measure(items, shift, done)
        onward &= jnp.stack([shift <= 0, shift >= 0]) & (items < size)

        def append() -> tuple[Array, Array, Array]:
            rank = jnp.cumsum(onward.ravel(), dtype=jnp.int32).reshape(onward.shape)
            to = jnp.where(onward, (queue.end + rank - 1) % capacity, capacity)
            item, onto = jnp.broadcast_to(items, onward.shape), shift + jnp.array([[-1], [1]], jnp.int32)
            return (
                queue.item.at[to].set(item, **SCATTER),
                queue.shift.at[to].set(onto, **SCATTER),
                queue.end + rank[-1, -1],
            )

        # most cells end in their middle window
        item, shift, end = jax.lax.cond(onward.any(), append, lambda: (queue.item, queue.shift, queue.end))
        return Queue(item, shift, jnp.minimum(queue.begin + width, queue.end), end), done

    start = Queue(
        jnp.arange(capacity, dtype=jnp.int32),
        jnp.zeros(capacity, jnp.int32),
        jnp.zeros((), jnp.int32),
        jnp.asarray(count, jnp.int32),
    )
    _, done = jax.lax.while_loop(lambda state: state[0].begin < state[0].end, block, (start, done))
    return done


class Survey(NamedTuple):
    """The results of measuring cells: their sizes, and what the lines show of their neighbors."""

    sizes: CellGeometry
    wide: Bool[Array, "cells"]  # the cell goes on beyond the middle window
    reach: Float[Array, "cells 2 row"]  # of the middle window
    touched: Bool[Array, "cells 2 candidates"]  # the candidate stops the cell on some line that bears on it
    stops: Bool[Array, "cells 2 candidates"]  # or on another of the middle window, which else might bear on it


@usual_modes()
def measure_cells(
    positions: Float[Array, "n 2"],
    tube: Tube,
    lines: Lines,
    neighbors: Int[Array | np.ndarray, "n 2 candidates"],
    cells: Int[Array, "cells"] | None = None,
    all_round: Bool[Array, "n"] | None = None,
    adhesion: Adhesion | None = None,
) -> tuple[CellGeometry, Survey]:
    """Measure all cells of a tube, or the given ones, on neighbor lists known to be valid (paper, section 3.1).

    V_i is the integral of the segment length over r dr dtheta, and A_i the integral of the wall's inclination. A pure
    function of its array arguments, for use inside `jax.jit` or `jax.vmap` (over replicas, each with its own lines);
    outside of them use `measure_tissue`.

    Args:
        positions: Axial position and angle in radians of each backbone, shape [n, 2].
        tube: The tube.
        lines: Quadrature lines for this tube and number of cells, from `plan_lines`.
        neighbors: Candidates of each cell behind and ahead, padded with the index of the cell itself, shape [n, 2, k];
            the attribute `candidates` of a `NeighborList`.
        cells: Indices of the cells to measure, shape [cells]. Defaults to None: all cells.
        all_round: Whether to search for each cell on all lines around the tube, booleans, shape [n]. Defaults to None:
            lines are added at either side as long as they contain part of the cell.
        adhesion: An `Adhesion`, which weights wall areas. Defaults to None.

    Returns:
        The `CellGeometry` of the cells, and internal data of the measurement.
    """
    which = jnp.arange(len(positions), dtype=jnp.int32) if cells is None else jnp.asarray(cells)
    neighbors, table, size = jnp.asarray(neighbors), backbone_coords(positions), len(which)
    width = min(size, BLOCK)
    dtype = positions.dtype
    blank = jnp.zeros(size, dtype)
    surfaces = [blank if lines.surfaces else None] * 4
    sizes = CellGeometry(blank, blank, *surfaces, touches_end=blank > 0)
    start = Survey(
        sizes,
        blank > 0,
        jnp.zeros((size, 2, lines.row), dtype),
        *2 * [jnp.zeros((size, *neighbors.shape[1:]), bool)],
    )

    def measure(items: Array, shift: Array, done: Survey) -> tuple[Survey, Array]:
        members = take_rows(which, items)
        rivals = take_rows(neighbors, members).transpose(2, 1, 0)
        own, others = pick(table, members), pick(table, rivals)
        weights = adhesion.between(members, rivals) if adhesion is not None else None
        window = measure_window(own, others, rivals < members, tube, lines, shift, weights)
        onward = window.onward
        if all_round is not None:
            further = (lines.step(dtype, shift + side).any(axis=0) for side in (-1, 1))
            onward |= take_rows(all_round, members) & jnp.stack(list(further))
        return add_window(items, shift, window, done), onward

    found = through_windows(measure, size, size, width, start)
    return found.sizes, found


def add_window(items: Array, shift: Array, window: Window, done: Survey) -> Survey:
    """The results of cells with those of one more window added."""

    def add(known: Array, more: Array) -> Array:
        if known.dtype == bool:
            return known.at[items].max(more, **SCATTER)
        return known.at[items].add(more, **SCATTER)

    at = jnp.where(shift == 0, items, len(done.wide))
    side, none = jnp.arange(2)[:, None], done.touched.shape[2]
    stopper = jnp.where(window.by == BOUNDARY, none, window.by).transpose(2, 1, 0)
    toucher = jnp.where(window.reach.transpose(2, 1, 0) > -jnp.inf, stopper, none)
    return Survey(
        jax.tree.map(add, done.sizes, window.sizes),
        done.wide.at[at].set(window.onward.any(axis=0), **SCATTER),
        done.reach.at[at].set(window.reaches(done.reach.shape[2]), **SCATTER),
        done.touched.at[items[:, None, None], side, toucher].set(True, **SCATTER),
        done.stops.at[at[:, None, None], side, stopper].set(True, **SCATTER),
    )
