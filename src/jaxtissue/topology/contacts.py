"""Contacts: the pairs of cells that share a wall, measured from the edges that bound the walls.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.bisectors import BOUNDS
from jaxtissue.topology.edges import WIDE, EdgeGraph, trace_edges
from jaxtissue.topology.rims import SIDES, measure_rims

KINDS = ("internal", "apical", "basal", "apical_basal")
ROUNDOFF = 1e-10  # of the mean wall: smaller ones are rounding


@dataclass(frozen=True)
class Contacts:
    """Contacts of a tissue: all pairs of cells that share a wall (paper, section 4.4), sorted.

    Attributes:
        cells: Number of cells n.
        pairs: Indices a < b of the two cells of each contact, shape [m, 2].
        area: Area of the wall of each contact, in squared length units, shape [m].
        apical_length: Length of the edge of the wall on the apical surface, in length units, shape [m]. 0 if the wall
            does not reach this surface.
        basal_length: Length of the edge of the wall on the basal surface, in length units, shape [m]. 0 if the wall
            does not reach this surface.
        kind: Surfaces that each wall reaches, strings, shape [m]: "apical_basal" (both), "apical" (only the apical
            one), "basal" (only the basal one) or "internal" (neither).
        pieces: Number of connected components of each wall, shape [m].
        area_error: Estimated absolute error of each area, shape [m], from the difference of two quadrature rules. None
            for a `Tube`, in which areas are accurate to about 1e-6 of the mean wall area.
    """

    cells: int
    pairs: Int[np.ndarray, "m 2"]
    area: Float[np.ndarray, " m"]
    apical_length: Float[np.ndarray, " m"]
    basal_length: Float[np.ndarray, " m"]
    kind: np.ndarray
    pieces: Int[np.ndarray, " m"]
    area_error: Float[np.ndarray, " m"] | None = None

    def degree(self, *kinds: str) -> Int[np.ndarray, " n"]:
        """Count the neighbors of each cell.

        Args:
            *kinds: Kinds of contacts to count: "apical_basal", "apical", "basal" or "internal". Without arguments all
                contacts count.

        Returns:
            Number of neighbors of each cell, shape [n].

        >>> find_contacts([[2, 0], [3, 0], [3, 3.1]], Tube(5, 1, 2)).degree("apical_basal").tolist()
        [2, 2, 2]
        """
        chosen = self.pairs[np.isin(self.kind, kinds or KINDS)]
        return np.bincount(chosen.ravel(), minlength=self.cells)


class Faces(NamedTuple):
    """The faces of the cells and their rims, one row for every face that an edge bounds.

    A face is given by the two labels that it parts; on the tube's own surfaces the second is that of a bound. Rows of a
    face that are joined at vertices are a part. The area of a part is positive if it runs round a piece of a wall, and
    negative round a hole; it turns by 2 pi if it goes round the lumen.
    """

    labels: Int[np.ndarray, "f 2"]
    face: Int[np.ndarray, " rows"]
    edge: Int[np.ndarray, " rows"]
    part: Int[np.ndarray, " rows"]
    part_face: Int[np.ndarray, " parts"]
    area: Float[np.ndarray, " parts"]
    length: Float[np.ndarray, " parts"]
    is_round: Bool[np.ndarray, " parts"]
    edge_length: Float[np.ndarray, " e"]
    volume: Float[np.ndarray, " n"]  # of the cells within them

    def is_wall(self, blur: float = 0.0) -> Bool[np.ndarray, " parts"]:
        """Whether each part is wider than a wall of no width can seem where walls are off by `blur`."""
        return 2 * np.abs(self.area) > WIDE * blur * self.length


def find_contacts(
    positions: PositionsLike,
    tube: Tube,
    threshold: float = 0.0,
    edges: EdgeGraph | None = None,
    faces: Faces | None = None,
) -> Contacts:
    """Find all pairs of cells of a tube that share a wall, and measure the walls (paper, section 4.4).

    `find_connectivity` returns these contacts along with transition points, and supports all domains. Edges of the
    Voronoi diagram are traced in float64; areas are accurate to about 1e-6 of the mean wall area. Walls of zero width,
    between cells that meet only along a line as on a regular lattice, are omitted.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        tube: The tube.
        threshold: Omit walls smaller than this fraction of the mean wall area. Defaults to 0.
        edges: Internal: edges of this tissue from an earlier tracing. Defaults to None.
        faces: Internal: faces of `edges` from an earlier call. Defaults to None.

    Returns:
        The `Contacts`, sorted by pair.

    Raises:
        ValueError: If a position is not finite, lies outside the tube or coincides with another, or if `threshold` is
            negative or NaN.

    >>> contacts = find_contacts([[2, 0], [3, 0], [3, 3.1]], Tube(5, 1, 2))
    >>> contacts.pairs.tolist(), contacts.kind.tolist()
    ([[0, 1], [0, 2], [1, 2]], ['apical_basal', 'apical_basal', 'apical_basal'])
    """
    if not threshold >= 0:
        raise ValueError(f"threshold={threshold} is not at least 0; give a fraction of the mean wall area")
    positions = as_positions(positions, tube, np.float64)
    graph = trace_edges(positions, tube) if edges is None else edges
    faces = find_faces(graph) if faces is None else faces
    bound = graph.edge_labels[faces.edge, 2] - graph.cells
    count, length = len(faces.labels), faces.edge_length[faces.edge]
    apical, basal = (np.bincount(faces.face, length * (bound == surface), count) for surface in (0, 1))
    kind = np.array(KINDS)[(apical > WIDE * graph.blur) + 2 * (basal > WIDE * graph.blur)]
    real = faces.is_wall(graph.blur)
    area = np.bincount(faces.part_face[real], faces.area[real], count)
    pieces = np.bincount(faces.part_face[real & (faces.area > 0)], minlength=count)
    walls = np.flatnonzero((faces.labels[:, 1] < graph.cells) & (pieces > 0))
    least = max(threshold, ROUNDOFF) * area[walls].mean() if len(walls) else 0
    kept = walls[area[walls] >= least]
    columns = (faces.labels, area, apical, basal, kind, pieces)
    return Contacts(graph.cells, *(column[kept] for column in columns))


def find_faces(edges: EdgeGraph) -> Faces:
    """The faces of all cells, from the edges that bound them."""
    n, labels, rims = edges.cells, edges.edge_labels, measure_rims(edges, edges.bisectors)
    sides = np.concatenate([labels[:, [one, two]] for one, two, _ in SIDES])
    rows = np.flatnonzero(sides[:, 0] < n)
    base = n + BOUNDS
    pairs, face = np.unique(sides[rows] @ [base, 1], return_inverse=True)
    pairs, edge = np.stack(np.divmod(pairs, base), axis=1), np.tile(np.arange(len(labels)), 3)[rows]
    vertices = edges.edge_vertices[edge]
    row, end = np.nonzero(vertices >= 0)
    corner = np.unique(face[row] * len(edges.vertices) + vertices[row, end], return_inverse=True)[1]
    size = len(edge) + corner.max(initial=-1) + 1
    joined = sparse.coo_array((np.ones(len(row), bool), (row, len(edge) + corner)), shape=(size, size))
    count, part = connected_components(joined, directed=False)
    part, part_face = part[: len(edge)], np.zeros(count, int)
    part_face[part] = face
    area, turn = (np.bincount(part, values.ravel()[rows], count) for values in (rims.area, rims.turn))
    length = np.bincount(part, rims.length[edge], count)
    return Faces(pairs, face, edge, part, part_face, area, length, np.abs(turn) > np.pi, rims.length, rims.volume)
