"""Groups of cells as bodies that can be drawn: their outside, its colors, and the lines where cells meet."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.meshes.cell_meshes import CellMeshes


class Body(NamedTuple):
    """The outside of a group of cells: triangles with the cell of each, and the edges at which that changes."""

    points: Float[np.ndarray, "p 3"]
    triangles: Int[np.ndarray, "t 3"]
    cell: Int[np.ndarray, " t"]
    lines: Int[np.ndarray, "m 2"]

    def surface(self, pyvista: Any, colors: Any = None) -> Any:
        """The triangles, with a color for each from those of the cells."""
        sheet = pyvista.PolyData.from_regular_faces(self.points, self.triangles)
        if colors is not None:
            sheet.cell_data["color"] = colors[self.cell]
        return sheet.compute_normals(split_vertices=True, feature_angle=35.0, consistent_normals=False)

    def edges(self, pyvista: Any) -> Any:
        """The edges as lines."""
        count = np.full(len(self.lines), 2)
        return pyvista.PolyData(self.points, lines=np.column_stack([count, self.lines]).ravel())


def body(meshes: CellMeshes, chosen: Bool[np.ndarray, " n"]) -> Body:
    """The outside of the chosen cells; walls between two of them are left out."""
    inside = np.append(chosen, np.zeros(meshes.sides.max() + 1 - meshes.cells, bool))[meshes.sides]
    first, second = inside[:, 0] & ~inside[:, 1], inside[:, 1] & ~inside[:, 0]
    triangles = np.concatenate([meshes.triangles[first], meshes.triangles[second][:, ::-1]])
    cell = np.append(meshes.sides[first, 0], meshes.sides[second, 1])
    other = np.append(meshes.sides[first, 1], meshes.sides[second, 0])
    face = np.unique(np.stack([cell, other], axis=1), axis=0, return_inverse=True)[1].ravel()
    used, place = np.unique(triangles, return_inverse=True)
    triangles = place.reshape(-1, 3)
    return Body(meshes.points[used], triangles, cell, _seams(triangles, face))


def _seams(triangles: Int[np.ndarray, "t 3"], face: Int[np.ndarray, " t"]) -> Int[np.ndarray, "m 2"]:
    """The edges between triangles of different faces."""
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    key = sides[:, 0] * (int(triangles.max(initial=0)) + 1) + sides[:, 1]
    order = np.argsort(key, kind="stable")
    key, owner = key[order], np.tile(face, 3)[order]
    seam = (key[1:] == key[:-1]) & (owner[1:] != owner[:-1])
    return sides[order[1:][seam]]
