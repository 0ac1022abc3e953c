"""One closed mesh per cell: PLY and STL for 3D printing and Blender, GLB for web browsers."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba

from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.meshes.coloring import PALETTE, color_cells
from jaxtissue.system.extras import optional


def write_solids(tissue: TissueRecord, folder: Path, kind: str) -> list[Path]:
    """Write a folder named `kind` ("ply" or "stl") with one file per cell, named by its index."""
    place = folder / kind
    place.mkdir()
    digits = len(str(len(tissue.positions) - 1))
    for cell, solid in enumerate(_solids(tissue, kind)):
        solid.export(place / f"cell-{cell:0{digits}d}.{kind}")
    return [place]


def write_glb(tissue: TissueRecord, folder: Path) -> list[Path]:
    """Write cells.glb: a scene with one node per cell, in the same colors as the pictures."""
    trimesh = optional("trimesh", "io", "the format glb")
    scene, colors = trimesh.Scene(), color_cells(tissue.meshes)
    for cell, solid in enumerate(_solids(tissue, "glb")):
        shade = np.array([255 * part for part in to_rgba(PALETTE[colors[cell]])], np.uint8)
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=shade, roughnessFactor=0.8)
        solid.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(solid, node_name=f"cell-{cell}", geom_name=f"cell-{cell}")
    path = folder / "cells.glb"
    scene.export(path)
    return [path]


def _solids(tissue: TissueRecord, kind: str) -> list[Any]:
    trimesh = optional("trimesh", "io", f"the format {kind}")
    cells = (tissue.meshes.cell(cell)[:2] for cell in range(tissue.meshes.cells))
    return [trimesh.Trimesh(points, triangles, process=False) for points, triangles in cells]
