"""Transition points and scutoids, and cells that encircle the lumen or consist of several components.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.system.cores import in_threads
from jaxtissue.topology.bisectors import Bisectors
from jaxtissue.topology.contacts import Faces, find_faces
from jaxtissue.topology.edges import WIDE, EdgeGraph, trace_edges
from jaxtissue.topology.rims import along

GAP = 1e-9  # of R_b: a gap in a silhouette that is no error of rounding


@dataclass(frozen=True)
class Transitions:
    """Transition points of a tissue: interior points with four equally near nearest backbones (paper, section 4.4).

    Attributes:
        points: Cartesian coordinates, in length units, shape [k, 3].
        cells: Indices of the four cells that meet at each point, sorted, shape [k, 4].
        per_cell: Number of transition points of each cell, shape [n].
        open_ends: Number of edges that could not be followed. If it is not 0, transition points may be missing.
        height: Height h of each point, 0 on the apical and 1 on the basal surface, shape [k]. None for a `Tube`.
    """

    points: Float[np.ndarray, "k 3"]
    cells: Int[np.ndarray, "k 4"]
    per_cell: Int[np.ndarray, " n"]
    open_ends: int
    height: Float[np.ndarray, " k"] | None = None

    @property
    def is_scutoid(self) -> Bool[np.ndarray, " n"]:
        """Whether each cell is a scutoid, that is, has at least one transition point; booleans, shape [n]."""
        return self.per_cell > 0


@dataclass(frozen=True)
class CellForms:
    """Topology of the cells of a tissue.

    Attributes:
        is_ring: Whether each cell encircles the lumen at some radius, booleans, shape [n].
        pieces: Number of connected components of each cell, shape [n]. More than 1 for a cell with a detached part.
    """

    is_ring: Bool[np.ndarray, " n"]
    pieces: Int[np.ndarray, " n"]


def find_transitions(
    positions: PositionsLike,
    tube: Tube,
    edges: EdgeGraph | None = None,
    faces: Faces | None = None,
) -> Transitions:
    """Find all transition points of a tube: interior points with four nearest backbones (paper, section 4.4).

    At a transition point, d_a = d_b = d_c = d_d <= the distance to every other backbone, R_a < r < R_b and 0 < x < L.
    `find_connectivity` returns these points along with contacts, and supports all domains. Points are located by
    Newton's method in float64, to about 1e-14 of the size of the tube. Points on the surfaces and at the ends of the
    tube do not count, nor do lines along which four cells meet, as on a square lattice. Cartesian coordinates are x
    along the axis, y = r cos(angle) and z = r sin(angle).

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        tube: The tube.
        edges: Internal: edges of this tissue from an earlier tracing. Defaults to None.
        faces: Internal: faces of `edges` from an earlier call. Defaults to None.

    Returns:
        Transition points with fields `points` (Cartesian coordinates, shape [k, 3]), `cells` (the four cells that meet
        at each point, shape [k, 4]), `per_cell` (number of points of each cell, shape [n]), `is_scutoid` (shape [n]),
        `open_ends` (number of edges that could not be followed: if it is not 0, points may be missing) and `height`
        (None).

    Raises:
        ValueError: If a position is not finite, lies outside the tube, or coincides with another.

    >>> four = find_transitions([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> four.points.round(4).tolist(), four.cells.tolist()
    ([[2.0, 1.6687, 0.0]], [[0, 1, 2, 3]])
    """
    graph = trace_edges(positions, tube) if edges is None else edges
    inner = graph.vertex_labels[:, 3] < graph.cells
    if graph.blur:
        inner &= ~_of_slivers(graph, find_faces(graph) if faces is None else faces)
    cells = graph.vertex_labels[inner]
    per_cell = np.bincount(cells.ravel(), minlength=graph.cells)
    return Transitions(graph.vertices[inner], cells, per_cell, graph.open_ends)


def _of_slivers(graph: EdgeGraph, faces: Faces) -> Bool[np.ndarray, " v"]:
    """The vertices of walls without a width: cells that meet in a line do not change neighbors there."""
    row = np.flatnonzero(~faces.is_wall(graph.blur)[faces.part])
    vertices = graph.edge_vertices[faces.edge[row]]
    return np.isin(np.arange(len(graph.vertices)), vertices)


def find_forms(
    positions: PositionsLike,
    tube: Tube,
    edges: EdgeGraph | None = None,
    faces: Faces | None = None,
) -> CellForms:
    """Find the cells that wrap round the lumen, and the number of parts of each cell.

    A cell is one interval on each line parallel to the axis, so the lines that meet it are bounded, in radius and
    angle, by its *silhouette*: its edges with one cell or end of the tube ahead and one behind. It wraps if at some
    radius there is no silhouette, as its own backbone is within. Its parts are the connected parts of its boundary.
    Positions are (axial, angle), [n, 2]; `edges` and their `faces` spare tracing and measuring them anew.

    >>> find_forms([[2, 0], [8, 0]], Tube(10, 1, 3))
    CellForms(is_ring=array([ True,  True]), pieces=array([1, 1]))
    """
    place = as_positions(positions, tube, np.float64)
    graph = trace_edges(place, tube) if edges is None else edges
    faces = find_faces(graph) if faces is None else faces
    parts = partial(_find_rings, place, tube, graph), partial(_count_pieces, graph, faces)
    return CellForms(*in_threads(lambda part: part(), parts))


def _find_rings(place: np.ndarray, tube: Tube, graph: EdgeGraph) -> Bool[np.ndarray, " n"]:
    """Find the cells that have no silhouette at some radius."""
    n, inner, outer = graph.cells, float(tube.apical_radius), float(tube.basal_radius)
    low, high = _radial_ranges(graph, graph.bisectors)
    ahead = np.concatenate([place[:, 0], [np.nan, np.nan, -np.inf, np.inf]])  # no silhouette on the surfaces
    cells, edges = [np.arange(n)], [np.full(n, -1)]
    for own, first, second in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
        cell, one, two = graph.edge_labels[:, [own, first, second]].T
        middle = ahead[np.minimum(cell, n)]
        side_one, side_two = np.sign(ahead[one] - middle), np.sign(ahead[two] - middle)
        silhouette = np.flatnonzero(side_one * side_two <= 0)  # 0: of the radial wall to a backbone abreast
        cells.append(cell[silhouette])
        edges.append(silhouette)
    cell, edge = np.concatenate(cells), np.concatenate(edges)
    low, high = np.append(low, inner)[edge], np.append(high, inner)[edge]  # the first row of each is empty
    order = np.lexsort((low, cell))
    cell, low, high = cell[order], low[order], high[order]
    # the highest so far within each cell: sorted by cell, so cells are set apart by more than any radius
    apart = 2 * outer * cell
    high = np.maximum.accumulate(high + apart) - apart
    last = np.append(cell[1:] != cell[:-1], True)
    following = np.where(last, outer, np.append(low[1:], outer))
    return np.bincount(cell, following > high + GAP * outer + WIDE * graph.blur, n) > 0


def _radial_ranges(graph: EdgeGraph, bisectors: Bisectors) -> tuple[Float[np.ndarray, " e"], Float[np.ndarray, " e"]]:
    """Least and greatest radius on each edge; found on the cubics of its segments."""
    ends, tangents = graph.points, graph.tangents
    radius = np.hypot(ends[..., 1], ends[..., 2])
    rise = (ends[..., 1:] * tangents[..., 1:]).sum(axis=-1) / radius
    chord = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    rise *= chord[:, None]
    # between the ends, where the derivative of the cubic vanishes: c + 2 b s + a s^2 = 0
    gain = radius[:, 1] - radius[:, 0]
    c, b, a = rise[:, 0], 3 * gain - 2 * rise[:, 0] - rise[:, 1], 3 * (rise[:, 0] + rise[:, 1] - 2 * gain)
    root = np.sqrt(np.maximum(b**2 - a * c, 0))
    low, high = radius.min(axis=1), radius.max(axis=1)
    q = -(b + np.where(b < 0, -root, root))
    labels = graph.edge_labels[graph.segment_edge]
    for s in (q / np.where(a == 0, np.inf, a), c / np.where(q == 0, np.inf, q)):
        inside = np.flatnonzero((b**2 >= a * c) & (s > 0) & (s < 1))
        at = along(ends[inside], tangents[inside] * chord[inside, None, None], s[inside, None])[0]
        # of the edge itself: exact to second order in the error of s
        at = bisectors.solve(at, labels[inside], 1e-7 * chord[inside])[0]
        value = np.hypot(at[:, 1], at[:, 2])
        low[inside], high[inside] = np.fmin(low[inside], value), np.fmax(high[inside], value)
    count = len(graph.edge_labels)
    lowest, highest = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(lowest, graph.segment_edge, low)
    np.maximum.at(highest, graph.segment_edge, high)
    return lowest, highest


def _count_pieces(graph: EdgeGraph, faces: Faces) -> Int[np.ndarray, " n"]:
    """Connected parts of each cell's boundary: its edges, joined if in the same piece of a face."""
    n, parts = graph.cells, np.arange(len(faces.part_face))
    # the rim of a hole goes with the first piece; on a bound no face has holes, and all rims round the lumen
    # are of one piece, as each such patch holds its backbone
    bound = faces.labels[faces.part_face, 1] >= n
    alone = np.where(bound, ~faces.is_round, faces.area > 0)
    order = np.lexsort((np.where(bound, alone, ~alone), faces.part_face))
    main = order[np.searchsorted(faces.part_face[order], faces.part_face)]
    piece = np.where(alone, parts, main)[faces.part]
    cell = faces.labels[faces.face].T.ravel()
    kept = cell < n
    keys = np.stack([np.tile(faces.edge, 2), len(graph.edge_labels) + np.tile(piece, 2)])[:, kept]
    nodes, link = np.unique(keys * n + cell[kept], return_inverse=True)
    link = link.reshape(2, -1)
    joined = sparse.coo_array((np.ones(link.shape[1], bool), link), shape=(len(nodes), len(nodes)))
    count, component = connected_components(joined, directed=False)
    owner = np.zeros(count, int)
    owner[component] = nodes % n
    return np.bincount(owner, minlength=n)
