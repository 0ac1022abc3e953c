"""Whole diagrams: the sizes of all cells, once, or again and again while the tissue moves."""

import functools
import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from jaxtissue.candidates import TILES, complete_lists, find_defect
from jaxtissue.cells import CellGeometry, measure_cells
from jaxtissue.inputs import as_positions
from jaxtissue.lines import Lines, Resolution, as_resolution, plan_lines
from jaxtissue.lowering import options
from jaxtissue.modes import usual_modes
from jaxtissue.shortlists import (
    CANDIDATES,
    STOPS,
    both_views,
    from_both,
    nearest_sides,
    see,
    shortlist_length,
    sight_lines,
)
from jaxtissue.tube import Tube

Positions = Float[Array | np.ndarray, "n 2"]
CELLS = "cells"
UNFILLED = 0.02  # of the tube, by which volumes may differ in sum: of lattices by `draft` 0.012 was seen


@usual_modes()
def measure_tissue(
    positions: Positions,
    tube: Tube,
    resolution: Resolution | str = "standard",
    surfaces: bool = True,
) -> tuple[CellGeometry, float]:
    """Sizes of every cell of a tissue, and the defect of an exact sum over all cells.

    The defect is the largest relative error of the cells' lengths summed along a line, `tiling_defect`: 0 to
    rounding unless a candidate list overflowed. Lists are grown until nothing overflows, so this takes
    concrete arrays; inside `jit` call `measure_cells`. Positions as (axial, angle), [n, 2], in any form that
    `as_positions` takes; a resolution as `as_resolution` does. Without `surfaces`, areas and perimeters on
    them are left out.

    Raises `ValueError` for positions that `as_positions` refuses. Warns where the volumes do not
    add up to the tube's: then some cells are narrower than lines are apart, as those of many backbones that
    stand almost level.
    """
    positions, resolution = as_positions(positions, tube), as_resolution(resolution)
    sides, defect = complete_lists(positions, tube)
    lines = plan_lines(tube, len(positions), resolution, surfaces=surfaces)
    cells = _measure(positions, jax.tree.map(np.asarray, (tube, lines, sides)))
    filled = float(np.asarray(cells.volume, float).sum()) / float(tube.volume)
    if abs(filled - 1) > UNFILLED:
        message = (
            f"the cells' volumes add up to {filled:.3f} of the tube's: some cells are narrower than lines are"
            f" apart at {resolution.layers}x{resolution.density:g}; measure more finely"
        )
        warnings.warn(message, stacklevel=3)
    return cells, defect


class Kept(NamedTuple):
    """What a `Gauge` keeps: few candidates of each cell, and all but the positions on every device."""

    sides: Int[np.ndarray, "n 2 few"]
    placed: tuple[Tube, Lines, Array]


class Gauge:
    """Measures a tissue that moves, on short candidate lists, kept as long as they lack nobody.

    Every cell is compared with the 22 candidates a side (more of more than 500 cells) that could soonest stop
    it, and lengths are summed along lines as by `measure_tissue`. Where the sum shows that somebody is
    lacking, lists are found anew, which `renewals` counts, and the cells are measured on these. Without
    `check` there is no sum: then it is for the caller to know that the lists hold, as after small moves.

    >>> tube = Tube(length=40, apical_radius=2, basal_radius=6)
    >>> positions = tube.random_positions(jax.random.key(0), 100)
    >>> gauge = Gauge(tube, "draft")
    >>> first = gauge.measure(positions)
    >>> turned = gauge.measure(positions + jnp.array([0, 0.01]))
    >>> gauge.renewals, bool(abs(turned.volume - first.volume).max() < 1e-3)
    (1, True)
    """

    def __init__(self, tube: Tube, resolution: Resolution | str = "standard", surfaces: bool = False) -> None:
        self.tube, self.resolution, self.surfaces = tube, as_resolution(resolution), surfaces
        self.renewals = 0
        self._kept: Kept | None = None

    @usual_modes()
    def measure(self, positions: Positions, check: bool = True) -> CellGeometry:
        """Sizes of all cells of the tissue where it is now.

        Raises `ValueError` for positions that `as_positions` refuses.
        """
        positions = as_positions(positions, self.tube)
        kept, lacks = self._kept, True
        if kept and len(kept.sides) == len(positions):
            lacks = check and find_defect(positions, self.tube, kept.sides) >= TILES
        if lacks or not kept:
            kept = self._renew(positions)
        return _measure(positions, kept.placed)

    @property
    def sides(self) -> Int[np.ndarray, "n 2 few"] | None:
        """The candidates kept, behind and ahead of each cell, padded with the cell itself; None before."""
        return self._kept.sides if self._kept else None

    def _renew(self, positions: Positions) -> Kept:
        """Find complete lists, see how clear of each cell candidates are, and keep the few that are least."""
        n, tube = len(positions), self.tube
        # as wide on both sides as the mean cell at the apical surface: who is that level may change sides
        margin = math.sqrt(2 * float(tube.apical_radius) * float(tube.length) / n)
        sides, _ = complete_lists(positions, tube, margin)
        lines = plan_lines(tube, n, self.resolution, surfaces=self.surfaces)
        looked_at = lines, sight_lines(tube, n, self.resolution)
        _, clear = _seeing()(positions, tube, looked_at, sides)
        views = both_views(sides)  # while the device looks
        clear = from_both(np.asarray(clear), views)
        # all who stop a cell, as the check's lines might not see some; in steps, so that shapes are few
        bounding = int((clear <= STOPS).sum(axis=2).max())
        count = min(max(shortlist_length(n), -(-bounding // CANDIDATES) * CANDIDATES), sides.shape[2])
        few = nearest_sides(sides, clear, count)
        while count < sides.shape[2] and find_defect(positions, tube, few) >= TILES:  # some may need more
            count = min(2 * count, sides.shape[2])
            few = nearest_sides(sides, clear, count)
        self.renewals += 1
        everywhere = NamedSharding(_mesh(tuple(jax.local_devices())), PartitionSpec())
        self._kept = Kept(few, jax.device_put((tube, lines, few), everywhere))
        return self._kept


def _measure(positions: Positions, rest: tuple[Tube, Lines, Array | np.ndarray]) -> CellGeometry:
    """Sizes of all cells, these shared out among the devices of this process."""
    return _measuring(tuple(jax.local_devices()))(np.asarray(positions), *rest)


@functools.cache
def _measuring(devices: tuple[Any, ...]) -> Callable[..., CellGeometry]:
    """The program that measures all cells on some devices, an equal share on each."""

    def share(
        cells: Int[Array, "share"], positions: Array, tube: Tube, lines: Lines, sides: Array
    ) -> CellGeometry:
        return measure_cells(positions, tube, lines, sides, cells)[0]

    def measure_shares(positions: Array, tube: Tube, lines: Lines, sides: Array) -> CellGeometry:
        n, count = len(positions), len(devices)
        cells = jnp.minimum(jnp.arange(-(-n // count) * count), n - 1)  # the last ones may be one cell
        one, all_of = PartitionSpec(CELLS), PartitionSpec()
        specs = (one, *4 * [all_of])
        shared = jax.shard_map(share, mesh=_mesh(devices), in_specs=specs, out_specs=one, check_vma=False)
        return jax.tree.map(lambda column: column[:n], shared(cells, positions, tube, lines, sides))

    def measure_all(*arguments: Any) -> CellGeometry:
        return measure_cells(*arguments)[0]

    return jax.jit(measure_shares if len(devices) > 1 else measure_all, compiler_options=options())


@functools.cache
def _mesh(devices: tuple[Any, ...]) -> Mesh:
    return jax.make_mesh((len(devices),), (CELLS,), (AxisType.Auto,), devices=devices)


@functools.cache
def _seeing() -> Callable[..., tuple[Any, Array]]:
    return jax.jit(see, compiler_options=options(light=True))
