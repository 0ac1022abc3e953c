"""Who touches whom: walls between cells, measured from the edges that bound them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.special import roots_jacobi

from jaxtissue.edges import EdgeGraph, trace_edges
from jaxtissue.inputs import as_positions
from jaxtissue.leads import BOUNDS, TINY, Leads, cross, dot, ranges
from jaxtissue.tube import Tube

KINDS = ("internal", "apical", "basal", "apical_basal")
ROUNDOFF = (
    1e-10  # of the mean wall: on a lattice four cells meet along an edge, and the diagonal pairs don't touch
)
NEWTON = 2  # steps from the mean plane to the wall: a third changes areas by 1e-6
STEEP = 0.1  # cosine between a wall and its mean plane below which it is taken as this
BLOCK = 2**12  # segments measured at once: what fits the processor's cache
_SHARES, _PARTS = ((1 + roots_jacobi(2, 0, 0)[0]) / 2, roots_jacobi(2, 0, 0)[1] / 2)  # of a segment
_DEPTHS, _WEIGHTS = ((1 + roots_jacobi(5, 0, 1)[0]) / 2, roots_jacobi(5, 0, 1)[1] / 4)  # of int_0^1 f(s) s ds


@dataclass(frozen=True)
class Contacts:
    """The pairs of cells that share a wall, a < b, in order; areas and lengths in units of the tube's."""

    cells: int
    pairs: Int[np.ndarray, "m 2"]
    area: Float[np.ndarray, " m"]  # of the wall
    apical_length: Float[np.ndarray, " m"]  # of its edge on the apical surface, 0 where it has none
    basal_length: Float[np.ndarray, " m"]
    kind: np.ndarray  # of KINDS, by the surfaces on which they touch
    pieces: Int[np.ndarray, " m"]  # connected parts of the wall

    def degree(self, *kinds: str) -> Int[np.ndarray, " n"]:
        """Number of neighbors of each cell, of the given kinds or of all."""
        chosen = self.pairs[np.isin(self.kind, kinds or KINDS)]
        return np.bincount(chosen.ravel(), minlength=self.cells)


class Faces(NamedTuple):
    """The faces of the cells, by the two labels they part (the second a bound on the tube's own surfaces),
    and their rims: a row for every face that an edge bounds.

    A rim's sign is 1 if the face lies to the left of the edge, seen against the normal to the second label.
    Rows of a face that are joined at vertices are a part.
    """

    labels: Int[np.ndarray, "f 2"]
    face: Int[np.ndarray, " rows"]
    edge: Int[np.ndarray, " rows"]
    sign: Float[np.ndarray, " rows"]
    part: Int[np.ndarray, " rows"]
    part_face: Int[np.ndarray, " parts"]
    is_outer: Bool[np.ndarray, " parts"]  # the part runs round a piece of its face; else a hole or the lumen
    is_cut: Bool[np.ndarray, " parts"]  # the part ends at an end of the tube, which closes it


def find_contacts(
    positions: Float[ArrayLike, "n 2"], tube: Tube, threshold: float = 0.0, edges: EdgeGraph | None = None
) -> Contacts:
    """All pairs of cells with a common wall: its area, edges on the surfaces, kind and pieces.

    The area is int dS / cos, over the projection of the wall on its mean plane, cos that of the angle between
    them, integrated from the edges inwards. Walls below `threshold`, a fraction of the mean wall, are left
    out. Positions as (axial, angle), [n, 2]; `edges` spares tracing them anew. Raises `ValueError` for a
    threshold that is negative or not a number. Paper, section 4.3.

    >>> contacts = find_contacts([[2, 0], [3, 0], [3, 3.1]], Tube(5, 1, 2))
    >>> contacts.pairs.tolist(), contacts.kind.tolist()
    ([[0, 1], [0, 2], [1, 2]], ['apical_basal', 'apical_basal', 'apical_basal'])
    """
    if not threshold >= 0:
        raise ValueError(f"threshold={threshold}; give a fraction of the mean wall, 0 or more")
    positions = as_positions(positions, tube, np.float64)
    graph = trace_edges(positions, tube) if edges is None else edges
    faces = find_faces(graph)
    length = _edge_lengths(graph)[faces.edge]
    bound = graph.edge_labels[faces.edge, 2] - graph.cells
    count = len(faces.labels)
    apical, basal = (np.bincount(faces.face, length * (bound == surface), count) for surface in (0, 1))
    kind = np.array(KINDS)[(apical > 0) + 2 * (basal > 0)]
    pieces = np.bincount(faces.part_face[faces.is_outer], minlength=count)
    walls = np.flatnonzero(faces.labels[:, 1] < graph.cells)
    area = measure_walls(faces, graph, Leads(positions, tube))
    least = max(threshold, ROUNDOFF) * area[walls].mean() if len(walls) else 0
    kept = walls[area[walls] >= least]
    columns = (faces.labels, area, apical, basal, kind, pieces)
    return Contacts(graph.cells, *(column[kept] for column in columns))


def find_faces(edges: EdgeGraph) -> Faces:
    """The faces of all cells from the edges round them."""
    edge = np.arange(len(edges.edge_labels))
    labels = edges.edge_labels
    # tangents run along grad lead_b x grad lead_c for labels a, b, c: faces ab, bc lie left of them, ac right
    sides = np.concatenate([labels[:, [0, 1]], labels[:, [1, 2]], labels[:, [0, 2]]])
    base = edges.cells + BOUNDS
    pairs, face = np.unique(sides @ [base, 1], return_inverse=True)
    pairs = np.stack(np.divmod(pairs, base), axis=1)
    edge, sign = np.tile(edge, 3), np.repeat([1.0, 1.0, -1.0], len(edge))
    vertices = edges.edge_vertices[edge]
    row, end = np.nonzero(vertices >= 0)
    corner = np.unique(face[row] * len(edges.vertices) + vertices[row, end], return_inverse=True)[1]
    size = len(edge) + corner.max(initial=-1) + 1
    joined = sparse.coo_array((np.ones(len(row), bool), (row, len(edge) + corner)), shape=(size, size))
    count, part = connected_components(joined, directed=False)
    part, part_face = part[: len(edge)], np.zeros(count, int)
    part_face[part] = face
    at_end = edges.vertex_labels[vertices[row, end], 2] >= edges.cells
    is_cut = np.bincount(part[row], at_end & (pairs[face[row], 1] >= edges.cells), count) > 0
    faces = Faces(pairs, face, edge, sign, part, part_face, is_cut, is_cut)
    return faces._replace(is_outer=_find_outer(faces, edges))


def _edge_lengths(graph: EdgeGraph) -> Float[np.ndarray, " e"]:
    """Lengths of edges: each segment an arc that turns from one tangent to the other."""
    chord = np.linalg.norm(graph.points[:, 1] - graph.points[:, 0], axis=1)
    turn = np.linalg.norm(graph.tangents[:, 1] - graph.tangents[:, 0], axis=1)
    return np.bincount(graph.segment_edge, chord * (1 + turn**2 / 24), len(graph.edge_labels))


def _rims(faces: Faces, graph: EdgeGraph, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chosen rows of faces, once for each segment of their edges, and these segments."""
    first, last = (
        np.searchsorted(graph.segment_edge, faces.edge[chosen], side=side) for side in ("left", "right")
    )
    row, segment = ranges(first, last - first)
    return chosen[row], segment


def _normals(
    face: np.ndarray, sign: np.ndarray, points: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Of each face the mean of its rim's points, and the unit normal of its mean plane."""

    def total(value: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(face, column, count) for column in value.T], axis=1).astype(float)

    center = total(points.mean(axis=1)) / np.maximum(np.bincount(face, minlength=count), 1)[:, None]
    start, stop = (points - center[face, None]).transpose(1, 2, 0)
    normal = total((sign * cross(start, stop)).T)
    return center, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), TINY)


def _find_outer(faces: Faces, graph: EdgeGraph) -> Bool[np.ndarray, " parts"]:
    """Which parts run round a piece of their face: area to their left, flattened; on the tube's own surfaces
    unrolled, int x dt, where such as go round the lumen bound no piece alone."""
    row, segment = _rims(faces, graph, np.arange(len(faces.face)))
    face, sign, points = faces.face[row], faces.sign[row], graph.points[segment]
    center, normal = _normals(face, sign, points, len(faces.labels))
    start, stop = (points - center[face, None]).transpose(1, 2, 0)
    chord = stop - start
    way = np.sqrt(dot(chord, chord)) * graph.tangents[segment].transpose(1, 2, 0)
    # int p x dp / 2 of the cubic through the ends
    swept = 60 * cross(start, stop) + 6 * cross(start - stop, way[1] - way[0]) + cross(way[1], way[0])
    flat = sign * dot(swept, normal[face].T)
    angle = np.arctan2(points[..., 2], points[..., 1])
    turn = sign * (np.mod(angle[:, 1] - angle[:, 0] + np.pi, 2 * np.pi) - np.pi)
    surface = faces.labels[face, 1] - graph.cells
    inward = np.where(surface == 0, 1, -1)
    unrolled = inward * points[..., 0].mean(axis=1) * turn
    flat = np.where((surface == 0) | (surface == 1), unrolled, flat)
    part, parts = faces.part[row], len(faces.part_face)
    round_lumen = np.abs(np.bincount(part, np.where(surface >= 0, turn, 0), parts)) > np.pi
    return (np.bincount(part, flat, parts) > 0) & ~round_lumen


def measure_walls(faces: Faces, graph: EdgeGraph, leads: Leads) -> Float[np.ndarray, " f"]:
    """Area of every wall between cells, and 0 for faces on the tube's bounds."""
    count, area = len(faces.labels), np.zeros(len(faces.labels))
    row, segment = _rims(faces, graph, np.flatnonzero(faces.labels[faces.face, 1] < graph.cells))
    face, sign, points = faces.face[row], faces.sign[row], graph.points[segment]
    center, normal = _normals(face, sign, points, count)
    for start in range(0, len(row), BLOCK):
        some = slice(start, start + BLOCK)
        which, middle, plane = face[some], center[face[some]], normal[face[some]]
        ends = points[some] - middle[:, None]
        chord = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None, None]
        for share, part in zip(_SHARES, _PARTS, strict=True):
            at, way = along(ends, graph.tangents[segment[some]] * chord, share)
            swept = part * sign[some] * dot(cross(at.T, way.T), plane.T)
            for depth, weight in zip(_DEPTHS, _WEIGHTS, strict=True):
                slant = _slant(middle + depth * at, plane, faces.labels[which], leads)
                area += np.bincount(which, swept * weight * slant, count)
    return area


def along(
    points: np.ndarray, tangents: np.ndarray, share: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Point and derivative, at a share of the way, of the cubic with the given ends and end tangents."""
    s = share
    blend = (1 - s) ** 2 * (1 + 2 * s), s**2 * (3 - 2 * s), s * (1 - s) ** 2, -(s**2) * (1 - s)
    slope = -6 * s * (1 - s), 6 * s * (1 - s), (1 - s) * (1 - 3 * s), s * (3 * s - 2)
    knots = (points[:, 0], points[:, 1], tangents[:, 0], tangents[:, 1])
    at, way = (sum(c * knot for c, knot in zip(w, knots, strict=True)) for w in (blend, slope))
    return np.asarray(at), np.asarray(way)


def _slant(point: np.ndarray, plane: np.ndarray, pair: np.ndarray, leads: Leads) -> np.ndarray:
    """1 / cos between the wall of a pair and a plane, at the wall above or below a point of the plane."""
    rise = slope = np.zeros(0)
    for _ in range(NEWTON):
        lead, slope = leads.over_first(point, pair)
        rise = dot(slope[..., 0], plane.T)
        point = point - (lead[:, 0] / np.where(rise == 0, np.inf, rise))[:, None] * plane
    return 1 / np.maximum(rise / np.sqrt(dot(slope[..., 0], slope[..., 0])), STEEP)
