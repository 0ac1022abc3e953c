"""Exports of a run, one format after the other, each whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from jaxtissue.exports.images import Spacing, write_ome_tiff, write_ome_zarr
from jaxtissue.exports.solids import write_glb, write_solids
from jaxtissue.exports.tables import tables, write_anndata, write_graphml, write_parquet
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.exports.vtk_files import write_series, write_vtk
from jaxtissue.runs import storage
from jaxtissue.runs.formats import IMAGES
from jaxtissue.runs.reports import printable_columns
from jaxtissue.system.locks import alone

Writer = Callable[..., list[Path]]
OWN_SUFFIXES = (".vtu", ".ply", ".stl")  # of what exported folders hold; others are not deleted
OWN_NAMES = ("zarr.json", *map(str, range(10)))  # and what a folder of OME-Zarr holds


def _write_csv(tissue: TissueRecord, folder: Path) -> list[Path]:
    for name, columns in tables(tissue).items():
        storage.write_table(folder / f"{name}.csv", columns)
    return [folder / f"{name}.csv" for name in tables(tissue)]


def _write_graph(tissue: TissueRecord, folder: Path) -> list[Path]:
    return write_graphml(tissue, folder, printable_columns(tissue.columns))


WRITERS: dict[str, Writer] = {
    "ome-tiff": partial(write_ome_tiff, spacing=None),
    "ome-zarr": partial(write_ome_zarr, spacing=None),
    "vtu": write_vtk,
    "pvd": write_series,
    "ply": partial(write_solids, kind="ply"),
    "stl": partial(write_solids, kind="stl"),
    "glb": write_glb,
    "graphml": _write_graph,
    "csv": _write_csv,
    "parquet": write_parquet,
    "anndata": write_anndata,
}


def export_tissue(
    tissue: TissueRecord, folder: Path, formats: Sequence[str], spacing: Spacing | None = None
) -> list[Path]:
    """Write a tissue to a folder in the given formats.

    Args:
        tissue: The tissue, for example from `read_tissue`.
        folder: Folder to write to.
        formats: Names of formats: "ome-tiff", "ome-zarr", "vtu", "pvd", "ply", "stl", "glb", "graphml", "csv",
            "parquet" or "anndata".
        spacing: Sides (dz, dy, dx) of a voxel for "ome-tiff" and "ome-zarr", in length units. Defaults to None: a
            tenth of the side of a mean cell.

    Returns:
        Paths of the files and folders that were written. Each is written completely or not at all.

    Raises:
        ValueError: If a format requires a missing package, too much memory, or data that the tissue does not have.
    """
    with alone(folder, what="a run or an export"):
        return [path for name in dict.fromkeys(formats) for path in _export(tissue, folder, name, spacing)]


def _export(tissue: TissueRecord, folder: Path, name: str, spacing: Spacing | None) -> list[Path]:
    """Write a tissue in one format."""
    written: list[Path] = []
    write = partial(WRITERS[name], spacing=spacing) if name in IMAGES else WRITERS[name]
    with tempfile.TemporaryDirectory(dir=folder, prefix=".export.", suffix=".part") as temporary:
        for part in write(tissue, Path(temporary)):
            target = folder / part.name
            if target.is_dir():
                inside = [path.name for path in target.iterdir() if path.suffix not in OWN_SUFFIXES]
                foreign = [name for name in inside if name not in OWN_NAMES]
                if foreign or not part.is_dir():
                    raise ValueError(f"{target} contains other files than exports {foreign[:1]}; choose another --out")
                shutil.rmtree(target)
            os.replace(part, target)
            written.append(target)
    return written
