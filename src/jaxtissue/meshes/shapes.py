"""Shapes of cells from their meshes: what laboratories tabulate beside volumes and areas."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from jaxtissue.geometry.array_likes import ArrayLike
from jaxtissue.meshes.cell_meshes import CellMeshes

APICAL, BASAL = 0, 1  # the first two of what bounds a tissue


def tabulate_shapes(meshes: CellMeshes, upward: ArrayLike) -> dict[str, Float[np.ndarray, " n"]]:
    """Describe the shape of each cell by numbers, measured on its mesh (not in the paper).

    Args:
        meshes: The meshes of the cells.
        upward: For each cell the direction of its backbone, from the apical to the basal end, [n, 3].

    Returns:
        Columns [n] by name. `height` is the distance between the centers of the apical and of the basal surface of the
        cell, and `tilt` the angle, in degrees, between the line through them and the backbone. `surface_area` is the
        area of the whole boundary A, `sphericity` is pi^(1/3) (6 V)^(2/3) / A, and `solidity` is V / volume of the
        convex hull. `aspect_ratio` is the longest / the shortest axis of the ellipsoid with the cell's second moments.
        `surface_ratio` is basal / apical area. What needs a surface that the cell has not is not a number.

    >>> from jaxtissue.geometry.tube import Tube
    >>> from jaxtissue.meshes.cell_meshes import mesh_cells
    >>> shapes = tabulate_shapes(mesh_cells([[1, 0], [3, 3]], Tube(4, 1, 2), 1e-3), [[0, 1, 0], [0, -1, 0]])
    >>> shapes["surface_ratio"].round(1).tolist()
    [2.0, 2.0]
    """
    n, area = meshes.cells, np.linalg.norm(meshes.normals(), axis=1)
    volume, boundary = meshes.volumes(), _of_cells(meshes, area)
    centers, areas = zip(*(_surface(meshes, area, bound) for bound in (APICAL, BASAL)), strict=True)
    line = centers[1] - centers[0]
    height = np.linalg.norm(line, axis=1)
    upward = np.asarray(upward, float)
    rise = (line * upward).sum(axis=1) / np.linalg.norm(upward, axis=1)
    hull = np.array([ConvexHull(meshes.cell(cell)[0]).volume for cell in range(n)])
    return {
        "height": height,
        "tilt": np.degrees(np.arccos(np.clip(rise / height, -1, 1))),
        "surface_area": boundary,
        "sphericity": np.cbrt(np.pi) * np.cbrt(6 * volume) ** 2 / boundary,
        "solidity": volume / hull,
        "aspect_ratio": _aspect_ratios(meshes, volume),
        "surface_ratio": ratio(areas[1], areas[0]),
    }


def ratio(over: Float[np.ndarray, " n"], under: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """A ratio, not a number where it would be one to nothing.

    >>> ratio(np.array([1.0, 3.0]), np.array([2.0, 0.0])).tolist()
    [0.5, nan]
    """
    return np.divide(over, under, out=np.full(np.shape(over), np.nan), where=np.asarray(under) > 0)


def _of_cells(meshes: CellMeshes, values: Float[np.ndarray, " t"], inward: int = 1) -> Float[np.ndarray, " n"]:
    """The sums of the triangles' values over each cell; those of its second sides times `inward`."""
    first, second = (np.bincount(side, values, meshes.cells)[: meshes.cells] for side in meshes.sides.T)
    return first + inward * second


def _surface(
    meshes: CellMeshes, area: Float[np.ndarray, " t"], bound: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Center and area of each cell on a surface of the tissue."""
    own = meshes.sides[:, 1] == meshes.cells + bound
    cell, middle = meshes.sides[own, 0], meshes.points[meshes.triangles[own]].mean(axis=1)
    total = np.bincount(cell, area[own], meshes.cells)
    with np.errstate(invalid="ignore"):
        center = [np.bincount(cell, area[own] * place, meshes.cells) / total for place in middle.T]
    return np.stack(center, axis=1), total


def _aspect_ratios(meshes: CellMeshes, volume: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Roots of the ratios of the largest to the smallest second moment, from tetrahedra over the triangles."""
    corner = meshes.points[meshes.triangles]
    whole = corner.sum(axis=1)
    part = np.einsum("ij,ij->i", corner[:, 0], meshes.normals()) / 3
    first = np.stack([_of_cells(meshes, part * axis / 4, -1) for axis in whole.T], axis=1) / volume[:, None]
    second = np.empty((meshes.cells, 3, 3))
    for i in range(3):
        for j in range(3):
            product = (corner[:, :, i] * corner[:, :, j]).sum(axis=1) + whole[:, i] * whole[:, j]
            second[:, i, j] = _of_cells(meshes, part * product / 20, -1) / volume - first[:, i] * first[:, j]
    moments = np.linalg.eigvalsh(second)
    return np.sqrt(moments[:, 2] / moments[:, 0])
