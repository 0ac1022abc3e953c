"""Sizes of cells with error estimates: two resolutions are compared, and cells in which they differ are traced."""

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from jaxtissue.compilation.fusion import options
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import Lines, Resolution, plan_lines
from jaxtissue.neighbors.neighbor_list import NeighborList
from jaxtissue.topology.traced_sizes import trace_sizes

CELLS = "cells"
LIMITS = 0.01, 0.05  # of the mean volume and lateral area: cells whose error may be larger are measured anew
ON_SURFACES = "apical_area", "basal_area", "apical_perimeter", "basal_perimeter"
FINER = 1.7, 2.0  # factors of layers and density from one rule to the next
SAFETY = 2.0  # of the difference of two rules, so that it bounds the error of the coarser one
NARROW = 4.0  # times its longest line by which a cell may end before the next line and counts as narrow
CARE = 4.0  # more safety for narrow cells, on which two rules may err alike
SMALL = 0.01  # of the mean volume: lines may miss such cells twice, and what those around lose to them
FEW_CELLS = 64  # of a tissue that is traced as a whole
SUMS = 1e-3  # of the mean cell by which volumes may miss the tube's beyond their errors
COARSE = 3000  # rounding errors of a coordinate by which backbones differ that lines can measure


class Tissue(NamedTuple):
    """The input of all rules: backbones, in the precision of the rules and as given, and their neighbor list."""

    positions: Float[np.ndarray, "n 2"]
    given: Float[np.ndarray, "n 2"]  # float64
    neighbors: NeighborList


def measure_refined(
    tissue: Tissue, resolution: Resolution, surfaces: bool, limits: tuple[float, float]
) -> CellGeometry:
    """Sizes of all cells, with bounds of the errors of volume and lateral area.

    All are measured by the rule of the `resolution` and by a finer one. Cells with errors beyond a limit are traced
    among their candidates; cells that cannot be traced keep the sizes of the finer rule.
    """
    sizes, open_ = measure_by_rules(tissue, resolution, surfaces, limits)
    if len(open_):
        candidates = np.asarray(tissue.neighbors.candidates)[open_]
        traced = trace_sizes(tissue.given, tissue.neighbors.domain, open_, candidates)
        found = traced._asdict() if traced is not None else {}
        for name in found.keys() & sizes.keys():
            sizes[name][open_] = found[name]
    return plain(sizes, tissue.positions.dtype)


def plain(sizes: Mapping[str, np.ndarray], dtype: Any, surfaces: bool = True) -> CellGeometry:
    """The columns as sizes in a precision, with or without the sizes on the surfaces."""
    kept = {name: column for name, column in sizes.items() if surfaces or name not in ON_SURFACES}
    exact = {name: column if column.dtype == bool else column.astype(dtype) for name, column in kept.items()}
    return CellGeometry(**{name: jnp.asarray(column) for name, column in exact.items()})


def measure_by_rules(
    tissue: Tissue, resolution: Resolution, surfaces: bool, limits: tuple[float, float]
) -> tuple[dict[str, np.ndarray], Int[np.ndarray, " cells"]]:
    """Sizes of all cells with their errors, and the cells that may be beyond the limits.

    All are measured by the rule of the `resolution` and by a finer one. Twice the difference, and its median
    over the cells, bound the error of the first. Cells on which this is beyond a limit, a fraction of the
    mean cell, take the value of the finer rule, whose error the difference itself bounds.
    """
    n, everyone = len(tissue.positions), np.arange(len(tissue.positions))
    first, narrow = measure_lines(tissue, resolution, surfaces, everyone)
    second, narrower = measure_lines(tissue, finer(resolution), surfaces, everyone)
    sizes, finely = _on_host(first), _on_host(second)
    mean = np.array(
        [float(tissue.neighbors.domain.volume) / n, min(sizes["lateral_area"].mean(), finely["lateral_area"].mean())]
    )
    allowed = np.array(limits)[:, None] * mean[:, None]
    before, after = (np.stack([t["volume"], t["lateral_area"]]).astype(float) for t in (sizes, finely))
    rounding = 30 * np.finfo(tissue.positions.dtype).eps * np.abs(after)
    gap = np.abs(after - before)
    error = SAFETY * np.where(narrow, CARE, 1) * gap + np.nanmedian(gap, axis=1, keepdims=True) + rounding
    keeps = (error <= allowed).all(axis=0)  # not what is not a number
    error = np.where(keeps, error, np.where(narrower, CARE, 1) * gap + rounding)
    for name, column in finely.items():
        sizes[name] = np.where(keeps, sizes[name], column)
    sizes |= {"volume_error": error[0], "lateral_area_error": error[1]}
    small = sizes["volume"] < SMALL * mean[0]
    crowd = np.append(np.flatnonzero(small), np.asarray(tissue.neighbors.candidates)[small])
    open_ = np.append(np.flatnonzero(~(error <= allowed).all(axis=0)), crowd)
    return sizes, np.union1d(open_, near_twins(tissue.positions, tissue.neighbors.domain))


def over_limits(cells: CellGeometry, limits: tuple[float, float]) -> Iterator[tuple[float, str]]:
    """The limits, of the mean volume and lateral area, that errors of cells are beyond, and which cells these are."""
    for name, limit in zip(("volume", "lateral_area"), limits, strict=True):
        size = np.asarray(getattr(cells, name), float)
        share = np.asarray(getattr(cells, f"{name}_error"), float) / max(size.mean(), 1e-300)
        over = np.flatnonzero(~(share <= limit))
        if len(over) and len(size) > 1:
            worst = over[np.argsort(-np.nan_to_num(share[over], nan=np.inf))[:5]]
            listed = ", ".join(f"{cell} ({100 * share[cell]:.2g} %)" for cell in worst)
            told = f"the {name.replace('_', ' ')} of {len(over)} of {len(size)} cells may be wrong by more than"
            yield limit, f"{told} {100 * limit:g} % of the mean: cells {listed}"


def near_twins(positions: Float[np.ndarray, "n 2"], tube: Tube, coarse: float = COARSE) -> Int[np.ndarray, " cells"]:
    """Cells of backbones too near to each other to be told apart well in the precision of their positions."""
    eps = np.finfo(positions.dtype).eps
    scale = np.array([float(tube.length), 2 * math.pi])
    place = np.mod(positions.astype(float), [np.inf, 2 * math.pi]) / scale
    place[:, 1] %= 1.0
    tree = KDTree(place, boxsize=[0, 1])
    pairs = tree.query_pairs(coarse * eps, output_type="ndarray")
    return np.unique(pairs)


def finer(resolution: Resolution) -> Resolution:
    """The next rule."""
    layers, density = resolution.layers * FINER[0], resolution.density * FINER[1]
    return Resolution(math.ceil(layers), density)


def measure_lines(
    tissue: Tissue, resolution: Resolution, surfaces: bool, cells: Int[np.ndarray, " cells"]
) -> tuple[CellGeometry, Bool[np.ndarray, " cells"]]:
    """Sizes of the given cells by the rule of a resolution, and which cells are narrow.

    Narrow cells end far before the next line. The cells are shared out among the devices of this process.
    """
    positions, _, neighbors = tissue
    tube, sides, all_round = neighbors.domain, neighbors.candidates, neighbors.is_far
    lines = plan_lines(tube, len(positions), resolution, surfaces=surfaces)
    devices = tuple(jax.local_devices())
    size = -(-len(cells) // len(devices)) * len(devices)
    padded = np.append(cells, np.full(size - len(cells), cells[-1])).astype(np.int32)
    placed = jax.tree.map(np.asarray, (tube, lines, sides))
    sizes, narrow = jax.tree.map(
        lambda column: column[: len(cells)], measuring(devices)(padded, positions, *placed, all_round)
    )
    return sizes, np.asarray(narrow)


@functools.cache
def measuring(devices: tuple[Any, ...]) -> Callable[..., tuple[CellGeometry, Array]]:
    """The program that measures cells on several devices, an equal share on each."""

    def share(
        cells: Int[Array, "share"],
        positions: Array,
        tube: Tube,
        lines: Lines,
        sides: Array,
        all_round: Array | None = None,
    ) -> tuple[CellGeometry, Array]:
        sizes, seen = measure_cells(positions, tube, lines, sides, cells, all_round)
        inner = int(np.sum(lines.layer < lines.inner_layers))
        length = seen.reach[..., :inner].sum(axis=1)
        shortest = jnp.where(length > -jnp.inf, length, 0).min(axis=1)
        return sizes, -shortest > NARROW * length.max(axis=1)

    def measure_shares(cells: Array, *rest: Any) -> tuple[CellGeometry, Array]:
        one, whole = PartitionSpec(CELLS), PartitionSpec()
        specs = (one, *(whole for _ in rest))
        shared = jax.shard_map(share, mesh=mesh(devices), in_specs=specs, out_specs=one, check_vma=False)
        return shared(cells, *rest)

    return jax.jit(measure_shares if len(devices) > 1 else share, compiler_options=options())


@functools.cache
def mesh(devices: tuple[Any, ...]) -> Mesh:
    """The devices in a row."""
    return jax.make_mesh((len(devices),), (CELLS,), (AxisType.Auto,), devices=devices)


def _on_host(cells: CellGeometry) -> dict[str, np.ndarray]:
    """The columns that are there, as arrays that can be written to."""
    columns = {name: getattr(cells, name) for name in cells.__dataclass_fields__}
    return {name: np.array(column) for name, column in columns.items() if column is not None}
