"""The surface meshes of all cells of a tissue: watertight, with common walls, without gaps or overlaps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import as_domain, domain_of
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.bisection import Bisection
from jaxtissue.meshes.cuts import Walls, cut
from jaxtissue.meshes.domain_grid import Prisms, domain_grid
from jaxtissue.meshes.grid import Grid
from jaxtissue.meshes.tube_grid import tube_grid

TOLERANCE = 5e-5  # of a cell's volume, that one triangle may be off
ROUNDS = 12  # of refinement at most: each tetrahedron in up to 2^12 parts
_NEAR = 2  # tetrahedra round cells that are chosen, at first: thin parts of these lie beyond the nodes that are theirs
_FAR = 64  # and at most
_SMALL = 0.02  # of the mean volume: smaller cells may be as far off as these


@dataclass(frozen=True)
class CellMeshes:
    """Triangle meshes of the surfaces of all cells. Each wall is stored once and shared by its two cells.

    Attributes:
        cells: Number of cells n.
        points: Vertices, in length units, shape [p, 3].
        triangles: Indices of the three vertices of each triangle, counterclockwise as seen from the second side, shape
            [t, 3].
        sides: Labels of the two sides of each triangle, shape [t, 2]: two cells, the lower index first, or a cell and a
            surface of the tissue. The surfaces are n (apical) and n + 1 (basal), and where the base surface ends n + 2
            and n + 3 (low and high end of the first coordinate; x = 0 and L of a tube), n + 4 and n + 5 (second).
    """

    cells: int
    points: Float[np.ndarray, "p 3"]
    triangles: Int[np.ndarray, "t 3"]
    sides: Int[np.ndarray, "t 2"]

    def cell(self, cell: int) -> tuple[Float[np.ndarray, "q 3"], Int[np.ndarray, "s 3"], Int[np.ndarray, " s"]]:
        """Extract the closed surface of one cell.

        Args:
            cell: Index of the cell.

        Returns:
            Vertices, shape [q, 3]; triangles, counterclockwise as seen from outside, shape [s, 3]; and the label of the
            other side of each triangle, shape [s].
        """
        first, second = (np.flatnonzero(self.sides[:, side] == cell) for side in (0, 1))
        triangles = np.concatenate([self.triangles[first], self.triangles[second][:, ::-1]])
        used, place = np.unique(triangles, return_inverse=True)
        other = np.concatenate([self.sides[first, 1], self.sides[second, 0]])
        return self.points[used], place.reshape(-1, 3), other

    def volumes(self) -> Float[np.ndarray, " n"]:
        """Compute the volume of each cell from its triangles by the divergence theorem, shape [n]."""
        corner = self.points[self.triangles]
        flow = np.einsum("ij,ij->i", corner[:, 0], self.normals()) / 3
        first, second = (np.bincount(side, flow, self.cells) for side in self.sides.T)
        return first[: self.cells] - second[: self.cells]

    def is_closed(self, chosen: Bool[np.ndarray, " n"]) -> bool:
        """Return whether the surfaces of the chosen cells are closed: at each edge the number of triangles is even."""
        own = np.append(chosen, np.zeros(self.sides.max(initial=0) + 1, bool))[self.sides]
        triangle, side = np.nonzero(own)
        corner = np.sort(self.triangles[triangle], axis=1)
        edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [0, 2]]])
        key = np.column_stack([np.tile(self.sides[triangle, side], 3), edges])
        return not (np.unique(key, axis=0, return_counts=True)[1] % 2).any()

    def normals(self) -> Float[np.ndarray, "t 3"]:
        """Return the normal of each triangle toward its second side, with the area as its length, shape [t, 3]."""
        first, second, third = self.points[self.triangles].transpose(1, 0, 2)
        return np.cross(second - first, third - first) / 2


def mesh_cells(
    positions: PositionsLike,
    domain: Tube | Domain,
    tolerance: float = TOLERANCE,
    chosen: Sequence[int] | None = None,
) -> CellMeshes:
    """Mesh the surfaces of all cells of a tissue with triangles, conforming between neighbors (paper, section 2.1).

    A tetrahedral mesh of the domain is labeled at its nodes and cut along the walls d_i = d_j. Tetrahedra are bisected
    where the triangles of a wall are not accurate enough. The meshes of the cells are closed and do not overlap, and
    their volumes sum to the volume of the domain for any tolerance: exactly in a tube or slab, within 0.1 % in other
    domains. The tolerance bounds the errors of single cells.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3].
            For tilted and bent backbones positions of nodes, shape [n, k, d], or [n, k, d + 1] with heights.
        domain: The tube or other domain. Cells that cross a periodic boundary are cut there.
        tolerance: Largest volume error per triangle, as a fraction of the volume of the cell, greater than 0. With the
            default, the volumes of cells in random tissues are accurate to about 1 %. A tolerance four times as large
            halves the number of triangles and suffices for pictures.
        chosen: Indices of the cells to mesh. Defaults to None: all cells. A small selection takes much less time.

    Returns:
        The meshes of all cells, or the walls and surfaces of the chosen cells.

    Raises:
        ValueError: If a position is not finite, lies outside the domain or coincides with another, or if `tolerance` is
            not positive.

    >>> tube = Tube(4, 1, 2)
    >>> meshes = mesh_cells([[1, 0], [3, 0.5], [2, 3]], tube)
    >>> meshes.cells, round(float(meshes.volumes().sum()) / tube.volume, 6)
    (3, 1.0)
    """
    if not tolerance > 0:
        raise ValueError(
            f"tolerance={tolerance} is not positive; give a fraction of the cell volume, such as {TOLERANCE:g}"
        )
    domain = domain_of(domain, positions)
    if isinstance(domain, Domain):
        place = as_domain_positions(positions, domain, np.float64, bent=True)
        return _mesh_domain(place, domain, tolerance, chosen)
    tube, place = domain, as_positions(positions, domain, np.float64, sizes=False)
    axial, backbones = place[:, 0], Crowd(place, as_domain(tube))

    def label(points: Float[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
        return label_points(points, place, tube)

    if chosen is None:
        return mesh_grid(tube_grid(tube, len(place)), label, backbones, tolerance)
    own, near = np.isin(np.arange(len(place)), chosen), _NEAR
    grid = _grid_of(own, axial, tube, label)
    while not (meshes := mesh_grid(grid, label, backbones, tolerance, (own, near))).is_closed(own) and near < _FAR:
        near *= 2
    return meshes


def _mesh_domain(
    place: Float[np.ndarray, "n d"], domain: Domain, tolerance: float, chosen: Sequence[int] | None
) -> CellMeshes:
    """`mesh_cells` on a domain; beyond periodic directions cells go on as those of copies of their backbones."""
    n, crowd = len(place), Crowd(place, domain)
    copies = crowd.start.shape[1]
    grid = domain_grid(domain, n)
    if chosen is None:
        meshes = mesh_grid(grid, crowd.nearest, crowd, tolerance)
    else:
        own, near = np.isin(np.arange(copies) % n, chosen), _NEAR
        while not (meshes := mesh_grid(grid, crowd.nearest, crowd, tolerance, (own, near))).is_closed(own):
            if near >= _FAR:
                break
            near *= 2
    sides = np.where(meshes.sides < copies, meshes.sides % n, meshes.sides - copies + n)
    turned, apart = sides[:, 0] > sides[:, 1], sides[:, 0] != sides[:, 1]
    triangles = np.where(turned[:, None], meshes.triangles[:, ::-1], meshes.triangles)[apart]
    used, number = np.unique(triangles, return_inverse=True)
    return CellMeshes(n, meshes.points[used], number.reshape(-1, 3), np.sort(sides, axis=1)[apart])


def _grid_of(
    own: Bool[np.ndarray, " n"],
    axial: Float[np.ndarray, " n"],
    tube: Tube,
    label: Callable[[Float[np.ndarray, "m 3"]], Int[np.ndarray, " m"]],
) -> Grid:
    """A grid of the part of the tube in which the cells `own` lie."""
    low, high, length = axial[own].min(), axial[own].max(), float(tube.length)
    aside = math.sqrt(float(tube.basal_area) / len(axial))
    while True:
        grid = tube_grid(tube, len(axial), (low - aside, high + aside))
        number = np.arange(len(grid.nodes)).reshape(grid.shape)
        open_ends = [sheets for sheets in (number[:2], number[:-3:-1]) if 0 < grid.nodes[sheets[0, 0, 0], 0] < length]
        if not any(own[label(grid.nodes[sheets.ravel()])].any() for sheets in open_ends):
            return grid
        aside *= 2


def mesh_grid(
    grid: Grid | Prisms,
    label: Callable[[Float[np.ndarray, "m 3"]], Int[np.ndarray, " m"]],
    backbones: Crowd,
    tolerance: float,
    chosen: tuple[Bool[np.ndarray, " n"], int] | None = None,
) -> CellMeshes:
    """Mesh the cells of a tissue of any shape that a grid fills, where `label` tells the cells of points.

    Of the chosen cells alone, which the grid must hold as wholes, and so many tetrahedra round them are looked at.
    """
    own, near = chosen or (None, 0)
    n = backbones.start.shape[1]
    mesh = Bisection(grid, n)
    labels = label(mesh.nodes)
    if own is not None:
        looked_at = own[labels]
        for _ in range(near):
            looked_at[mesh.tetrahedra[looked_at[mesh.tetrahedra].any(axis=1)]] = True
        mesh.keep(looked_at)
    fresh = np.arange(len(mesh.tetrahedra))
    walls = cut(mesh.nodes, labels, mesh.tetrahedra[_mixed(mesh.tetrahedra, labels)], mesh.surfaces, backbones)
    volume = CellMeshes(n, *walls[:3]).volumes()
    asked = np.ones(n, bool) if own is None else own
    mean = volume[asked].mean()
    allowed = tolerance * np.where(asked, np.maximum(volume, _SMALL * mean), mean)
    for _ in range(ROUNDS):
        fresh = fresh[_mixed(mesh.tetrahedra[fresh], labels)]
        walls = cut(mesh.nodes, labels, mesh.tetrahedra[fresh], {}, backbones)
        coarse = fresh[np.unique(walls.origin[_errors(walls, label, backbones) > allowed[walls.sides].min(axis=1)])]
        if not len(coarse):
            break
        fresh = mesh.halve(coarse)
        labels = np.append(labels, label(mesh.nodes[len(labels) :]))
    mixed = _mixed(mesh.tetrahedra, labels)
    points, triangles, sides, _ = cut(mesh.nodes, labels, mesh.tetrahedra[mixed], mesh.surfaces, backbones)
    if own is not None:
        kept = np.append(own, np.zeros(sides.max() + 1 - n, bool))[sides].any(axis=1)
        used, place = np.unique(triangles[kept], return_inverse=True)
        points, triangles, sides = points[used], place.reshape(-1, 3), sides[kept]
    return CellMeshes(n, points, triangles, sides)


def _mixed(tetrahedra: Int[np.ndarray, "t 4"], labels: Int[np.ndarray, " p"]) -> Int[np.ndarray, " m"]:
    own = labels[tetrahedra]
    return np.flatnonzero((own != own[:, :1]).any(axis=1))


def _errors(walls: Walls, label: Callable[[np.ndarray], np.ndarray], backbones: Crowd) -> Float[np.ndarray, " t"]:
    """The volume between each triangle and the wall, to first order; or to a cell that the triangle lies in."""
    corner = walls.points[walls.triangles]
    center, area = (
        corner.mean(axis=1),
        np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2,
    )
    own = backbones.offset(center, walls.sides[:, 0])
    gap = np.zeros(len(center))
    for other in (walls.sides[:, 1], label(center)):
        away = backbones.offset(center, other)
        lead = np.abs((away**2).sum(axis=1) - (own**2).sum(axis=1))
        apart = np.linalg.norm(away - own, axis=1)
        gap = np.maximum(gap, np.divide(lead, 2 * apart, out=np.zeros(len(lead)), where=apart > 0))
    return gap * area
