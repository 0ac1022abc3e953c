"""Tables and graphs: CSV, Parquet, GraphML, AnnData."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy import sparse

from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domain_files import domain_values
from jaxtissue.system.extras import optional
from jaxtissue.topology.statistics import tissue_graph


def tables(tissue: TissueRecord) -> dict[str, dict[str, np.ndarray]]:
    """Return the tables of cells, contacts and transition points: mapping from table name to a mapping of columns."""
    contacts, transitions = tissue.connectivity.contacts, tissue.connectivity.transitions
    pairs = dict(zip(("cell_a", "cell_b"), contacts.pairs.T, strict=True))
    names = ("area", "apical_length", "basal_length", "kind", "pieces")
    points = dict(zip("xyz", transitions.points.T, strict=True))
    four = zip(("cell_a", "cell_b", "cell_c", "cell_d"), transitions.cells.T, strict=True)
    return {
        "cells": tissue.columns,
        "contacts": pairs | {name: getattr(contacts, name) for name in names},
        "transitions": points | dict(four),
    }


def write_parquet(tissue: TissueRecord, folder: Path) -> list[Path]:
    """Write cells.parquet, contacts.parquet and transitions.parquet, with length unit and domain as metadata."""
    pyarrow, parquet = (optional(name, "io", "the format parquet") for name in ("pyarrow", "pyarrow.parquet"))
    about = {"unit": tissue.unit, "domain": json.dumps(domain_values(tissue.domain))}
    for name, columns in tables(tissue).items():
        table = pyarrow.table({key: _plain(column) for key, column in columns.items()})
        parquet.write_table(table.replace_schema_metadata(about), folder / f"{name}.parquet")
    return [folder / f"{name}.parquet" for name in tables(tissue)]


def write_graphml(tissue: TissueRecord, folder: Path, columns: Mapping[str, np.ndarray]) -> list[Path]:
    """Write graph.graphml: cells as nodes with `columns` as attributes, contacts as edges."""
    from networkx import write_graphml as write  # takes a sixth of a second to import

    write(tissue_graph(tissue.connectivity, columns), folder / "graph.graphml")
    return [folder / "graph.graphml"]


def write_anndata(tissue: TissueRecord, folder: Path) -> list[Path]:
    """Write cells.h5ad: measured values in X, flags and names in obs, positions in obsm, wall areas in obsp."""
    anndata, pandas = (optional(name, "anndata", "the format anndata") for name in ("anndata", "pandas"))
    columns = {name: np.asarray(column) for name, column in tissue.columns.items()}
    measured = [name for name in columns if columns[name].dtype.kind in "iuf" and name not in ("cell", *"xyz")]
    index = pandas.Index([str(cell) for cell in columns["cell"]], dtype=object)  # HDF5 takes no Arrow strings
    rest = {name: column for name, column in columns.items() if name not in (*measured, *"xyz")}
    obs = pandas.DataFrame({name: pandas.Series(column, index, column.dtype) for name, column in rest.items()})
    values = np.stack([columns[name].astype(float) for name in measured], axis=1)
    data = anndata.AnnData(values, obs=obs, var=pandas.DataFrame(index=pandas.Index(measured, dtype=object)))
    data.obsm["spatial"] = np.stack([columns[axis] for axis in "xyz"], axis=1)
    contacts = tissue.connectivity.contacts
    first, second = contacts.pairs.T
    ends = np.append(first, second), np.append(second, first)
    shape = contacts.cells, contacts.cells
    data.obsp["contact_area"] = sparse.csr_array((np.tile(contacts.area, 2), ends), shape=shape)
    data.obsp["connectivities"] = sparse.csr_array((np.ones(2 * len(first)), ends), shape=shape)
    data.uns["domain"], data.uns["unit"] = domain_values(tissue.domain), tissue.unit
    path = folder / "cells.h5ad"
    data.write_h5ad(path)
    return [path]


def _plain(column: np.ndarray) -> np.ndarray | list[str]:
    column = np.asarray(column)
    return column if column.dtype.kind in "iufb" else [str(value) for value in column]
