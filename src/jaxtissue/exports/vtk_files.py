"""Files for ParaView and other VTK programs: cells, walls, backbones, transition points, and time series."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.meshes.cell_meshes import CellMeshes, mesh_cells
from jaxtissue.system.extras import optional

SHOWN = ("volume", "neighbors", "transitions", "is_scutoid", "sphericity", "surface_ratio")  # of each triangle's cell
COARSE = 4e-4  # the tolerance of the meshes of a series


def write_vtk(tissue: TissueRecord, folder: Path) -> list[Path]:
    """Write cells.vtu, walls.vtp, backbones.vtp and transitions.vtp."""
    pyvista = optional("pyvista", "viz", "the format vtu")
    columns = {name: column for name, column in tissue.columns.items() if np.asarray(column).dtype.kind in "iufb"}
    parts = {
        "cells.vtu": closed_cells(pyvista, tissue.meshes, {name: columns[name] for name in SHOWN if name in columns}),
        "walls.vtp": walls(pyvista, tissue.meshes),
        "backbones.vtp": backbones(pyvista, tissue, columns),
    }
    if tissue.followed and len(tissue.followed.transitions.points):
        points = pyvista.PolyData(tissue.followed.transitions.points)
        points.point_data["cells"] = tissue.followed.transitions.cells
        parts["transitions.vtp"] = points
    for name, part in parts.items():
        part.field_data["unit"] = [tissue.unit or "none"]
        part.save(folder / name)
    return [folder / name for name in parts]


def closed_cells(pyvista: Any, meshes: CellMeshes, values: dict[str, np.ndarray]) -> Any:
    """Return the closed surface of each cell as triangles that carry the index and the table values of the cell."""
    first, second = meshes.sides.T
    inner = second < meshes.cells
    triangles = np.concatenate([meshes.triangles, meshes.triangles[inner][:, ::-1]])
    cell = np.append(first, second[inner])
    order = np.argsort(cell, kind="stable")
    triangles, cell = triangles[order], cell[order]
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TRIANGLE: triangles}, meshes.points)
    grid.cell_data["cell"] = cell.astype(np.int32)
    for name, column in values.items():
        kind = np.float32 if column.dtype.kind == "f" else np.int32
        grid.cell_data[name] = column.astype(kind)[cell]
    return grid


def walls(pyvista: Any, meshes: CellMeshes) -> Any:
    """The walls and surfaces, each triangle once, with the two cells that it parts.

    `surface` is 0 for walls, and 1, 2, ... for what bounds the tissue; `cell_b` is -1 there.
    """
    sheet = pyvista.PolyData.from_regular_faces(meshes.points, meshes.triangles)
    first, second = meshes.sides.T
    inner = second < meshes.cells
    sheet.cell_data["cell_a"] = first.astype(np.int32)
    sheet.cell_data["cell_b"] = np.where(inner, second, -1).astype(np.int32)
    sheet.cell_data["surface"] = np.where(inner, 0, second - meshes.cells + 1).astype(np.int32)
    return sheet


def backbones(pyvista: Any, tissue: TissueRecord, columns: dict[str, np.ndarray]) -> Any:
    """Return the backbones as lines through their nodes that carry the table of cells."""
    n, k, _ = tissue.nodes.shape
    lines = np.column_stack([np.full(n, k), np.arange(n * k).reshape(n, k)])
    sheet = pyvista.PolyData(tissue.nodes.reshape(-1, 3), lines=lines.ravel())
    for name, column in columns.items():
        sheet.cell_data[name] = column.astype(np.int32) if column.dtype.kind == "b" else column
    return sheet


def write_series(tissue: TissueRecord, folder: Path) -> list[Path]:
    """Write run.pvd, a time series of the cells after each stored sweep, and the folder of its meshes."""
    pyvista = optional("pyvista", "viz", "the format pvd")
    if not tissue.history:
        raise ValueError(
            "the format pvd needs the stored sweeps of a run of jaxtissue anneal; remove pvd from the formats"
        )
    (folder / "run").mkdir()
    top = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(top, "Collection")
    for sweep, positions in sorted(tissue.history.items()):
        meshes = mesh_cells(positions, tissue.domain, COARSE)
        name = f"run/cells-{sweep:06d}.vtu"
        closed_cells(pyvista, meshes, {"volume": meshes.volumes()}).save(folder / name)
        ElementTree.SubElement(collection, "DataSet", timestep=str(sweep), part="0", file=name)
    ElementTree.ElementTree(top).write(folder / "run.pvd", xml_declaration=True)
    return [folder / "run.pvd", folder / "run"]
