"""A measured tissue as tables: its cells, its summary, and the errors of the presets."""

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.diagram.exact import exact_cells
from jaxtissue.diagram.spread import covering_radius, separation
from jaxtissue.energy import Model, require_finite, tissue_energies
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_positions_on, place_columns
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import SIZES, CellGeometry
from jaxtissue.measurement.quadrature import PRESETS, Resolution
from jaxtissue.runs import storage
from jaxtissue.runs.names import printable
from jaxtissue.system.files import replacing
from jaxtissue.tissue.measurer import as_limits, doubts, measure_tissue
from jaxtissue.tissue.refinement import plain
from jaxtissue.topology.statistics import (
    Connectivity,
    find_connectivity,
    summarize_connectivity,
    tabulate_connectivity,
    tissue_graph,
)

Result = TypeVar("Result")
_ERRORS = ("volume_error", "lateral_area_error")
CONTACT_TABLES = ("contacts.csv", "transitions.csv", "graph.graphml")


def tabulate_cells(
    positions: PositionsLike,
    model: Model,
    resolution: Resolution | str,
    names: Sequence[str] | None = None,
    connectivity: Connectivity | None = None,
    tolerance: float | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """One row per cell, and the figures of the whole tissue; lengths, areas, volumes in units of the tube's.

    The summary's separation of a single cell is infinite; its `tiling_defect` is the relative error of an exact
    tiling sum, 0 where every cell lies within the lines it was measured on; its `largest_volume_error` and
    `largest_lateral_area_error` are fractions of the mean cell, as the `tolerance` is. Connectivity adds its
    columns and the exact `is_end`; without it, that is what the lines see.
    """
    if isinstance(model.domain, Domain):
        cells = measure_tissue(np.asarray(positions), model.domain, resolution, tolerance=tolerance)
        return _tabulate_on_domain(np.asarray(positions), cells, model, names, connectivity)
    axial, angle = np.asarray(positions).T
    positions = model.tube.reflect(jnp.asarray(positions))
    place = np.stack([axial, angle], axis=-1)
    if connectivity is not None and connectivity.sizes is not None:
        cells, defect = plain(connectivity.sizes._asdict(), jnp.result_type(float)), 0.0
        for message in doubts(cells, model.tube, as_limits(tolerance)):
            warnings.warn(message, stacklevel=2)
    else:
        cells = measure_tissue(place, model.tube, resolution, tolerance=tolerance)
        defect = cells.tiling_defect
    energy = np.asarray(tissue_energies(cells, model))
    require_finite(energy, model)
    columns = {"cell": np.arange(len(axial)), "axial": axial, "angle": angle}
    columns |= {name: np.asarray(getattr(cells, name)) for name in (*SIZES, *_ERRORS)}
    columns |= {"energy": energy, "is_end": np.asarray(cells.touches_end)}
    if connectivity is not None:
        columns |= {"is_end": connectivity.is_end} | tabulate_connectivity(connectivity)
    columns |= {"name": np.array(names, dtype=object)} if names else {}
    apart, covering = float(separation(positions, model.tube)), float(covering_radius(positions, model.tube))
    summary = {
        "tissue_volume": float(model.tube.volume),
        "total_volume": columns["volume"].sum(dtype=float),
        "total_lateral_area": columns["lateral_area"].sum(dtype=float),
        "energy": energy.sum(dtype=float),
        "separation": apart,
        "covering_radius": covering,
        "tightness": covering / apart,
        "tiling_defect": float(np.asarray(defect)),
    }
    return columns, summary | _largest_errors(columns)


def _tabulate_on_domain(
    place: Float[np.ndarray, "n d"],
    cells: CellGeometry,
    model: Model,
    names: Sequence[str] | None,
    connectivity: Connectivity | None,
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """The same on domains other than tubes, without what is of distances between backbones."""
    energy = np.asarray(tissue_energies(cells, model))
    require_finite(energy, model)
    columns = {"cell": np.arange(len(place))} | place_columns(place, model.domain)
    columns |= {name: np.asarray(getattr(cells, name)) for name in (*SIZES, *_ERRORS)}
    columns |= {"energy": energy, "is_end": np.asarray(cells.touches_end)}
    if connectivity is not None:
        columns |= {"is_end": connectivity.is_end} | tabulate_connectivity(connectivity)
    columns |= {"name": np.array(names, dtype=object)} if names else {}
    summary = {"tissue_volume": float(model.domain.volume)}
    summary |= {f"total_{name}": columns[name].sum(dtype=float) for name in ("volume", "lateral_area")}
    summary |= {"energy": energy.sum(dtype=float), "tiling_defect": float(np.asarray(cells.tiling_defect))}
    return columns, summary | _largest_errors(columns)


def _largest_errors(columns: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The largest errors as fractions of the mean cell."""
    largest = {}
    for size, error in zip(SIZES, _ERRORS, strict=False):
        mean = columns[size].mean(dtype=float)
        largest[f"largest_{error}"] = float(columns[error].max() / mean) if mean > 0 else 0.0
    return largest


def contacts_of_run(positions: PositionsLike, domain: Tube | Domain, minimum: float = 0.0) -> Connectivity | None:
    """The contacts of a tissue; none, with a warning, on domains where they can't be found."""
    try:
        return find_connectivity(positions, domain, minimum)
    except ValueError as error:
        if isinstance(domain, Tube):
            raise
        warnings.warn(f"contacts are not computed: {error}", stacklevel=3)
        return None


def contact_summary(connectivity: Connectivity) -> dict[str, Any]:
    """The means over all cells and, under `inner`, over those that touch no end, with the numbers of cells.

    `open_ends` counts edges of the diagram that could not be followed: parts may be missing then.
    """
    everywhere, inner = (summarize_connectivity(connectivity, only) for only in (False, True))
    summary = {"cells": len(connectivity.is_end), "mean_neighbors": everywhere["neighbors"]} | everywhere
    summary |= {"inner": {"cells": int((~connectivity.is_end).sum())} | inner}
    if (error := connectivity.contacts.area_error) is not None:
        summary |= {
            "largest_wall_area_error": float(error.max() / connectivity.contacts.area.mean()) if len(error) else 0
        }
    return summary | {"open_ends": connectivity.transitions.open_ends}


def write_contacts(folder: Path, connectivity: Connectivity, columns: Mapping[str, np.ndarray] | None = None) -> None:
    """Write contacts.csv and transitions.csv; with the columns of the cells also graph.graphml."""
    contacts, transitions = connectivity.contacts, connectivity.transitions
    first, second = contacts.pairs.T
    names = ("area", "apical_length", "basal_length", "kind", "pieces")
    table = {"cell_a": first, "cell_b": second} | {name: getattr(contacts, name) for name in names}
    table |= {} if contacts.area_error is None else {"area_error": contacts.area_error}
    storage.write_table(folder / "contacts.csv", table)
    points = dict(zip("xyz", transitions.points.T, strict=True))
    points |= {} if transitions.height is None else {"height": transitions.height}
    cells = zip(("cell_a", "cell_b", "cell_c", "cell_d"), transitions.cells.T, strict=True)
    storage.write_table(folder / "transitions.csv", points | dict(cells))
    if columns is not None:
        from networkx import write_graphml  # takes a sixth of a second to import

        with replacing(folder / "graph.graphml", "wb") as file:
            write_graphml(tissue_graph(connectivity, printable_columns(columns)), file)


def printable_columns(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns with such names of cells as XML takes."""
    names = [printable(name) for name in columns["name"]] if "name" in columns else None
    return dict(columns) | ({"name": np.array(names)} if names else {})


def compare_presets(
    positions: PositionsLike, domain: Tube | Domain, samples: int
) -> tuple[dict[str, np.ndarray], float]:
    """Errors and warm times of the presets against the exact path, a row each, and the exact path's seconds.

    Errors of V and A are relative to the mean cell: rms and largest over the cells; that of the total A is
    signed. They are not numbers where there is no lateral area.
    """
    exact, exact_seconds = _timed(lambda: exact_cells(np.asarray(positions), domain, samples))
    positions, rows = as_positions_on(positions, domain, sizes=False, bent=True), []
    for name, resolution in PRESETS.items():
        jax.block_until_ready(measure_tissue(positions, domain, resolution, refine=False))
        cells, seconds = _timed(lambda at=resolution: measure_tissue(positions, domain, at, refine=False))
        volume = _relative(cells.volume, exact.volume)
        area = _relative(cells.lateral_area, exact.lateral_area)
        errors = [how for error in (volume, area) for how in (math.sqrt((error**2).mean()), abs(error).max())]
        rows.append((name, *errors, area.mean(), seconds))
    names = ("preset", "volume_rms", "volume_max", "area_rms", "area_max", "area_total", "seconds")
    columns = map(np.array, zip(*rows, strict=True))
    return dict(zip(names, columns, strict=True)), exact_seconds


def _relative(measured: Float[Array, "n"], exact: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    mean = exact.mean()
    return (np.asarray(measured, float) - exact) / (mean if mean > 0 else math.nan)


def _timed(work: Callable[[], Result]) -> tuple[Result, float]:
    begun = time.perf_counter()
    result = jax.block_until_ready(work())
    return result, time.perf_counter() - begun
