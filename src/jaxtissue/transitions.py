"""Transition points and scutoids, and the cells that wrap round the lumen or fall into parts."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from jaxtissue.candidates import find_candidates, sided, survey_tissue
from jaxtissue.contacts import Faces, find_faces
from jaxtissue.edges import EdgeGraph, trace_edges
from jaxtissue.lines import PRESETS, Resolution
from jaxtissue.tube import Tube


@dataclass(frozen=True)
class Transitions:
    """Points of the open tissue with four nearest backbones: where they are, and their cells, sorted."""

    points: Float[np.ndarray, "k 3"]
    cells: Int[np.ndarray, "k 4"]
    per_cell: Int[np.ndarray, " n"]
    open_ends: int  # edges of the diagram that could not be followed: 0 unless the tissue is degenerate

    @property
    def is_scutoid(self) -> Bool[np.ndarray, " n"]:
        """Whether each cell has a transition point."""
        return self.per_cell > 0


@dataclass(frozen=True)
class CellForms:
    """What is unlike a column in the form of each cell."""

    is_ring: Bool[np.ndarray, " n"]  # at some radius it goes all the way round the lumen
    pieces: Int[np.ndarray, " n"]  # 1, and more for a cell with detached parts


def find_transitions(
    positions: Float[ArrayLike, "n 2"], tube: Tube, edges: EdgeGraph | None = None
) -> Transitions:
    """All transition points, d_a = d_b = d_c = d_d <= every other distance, R_a < r < R_b and 0 < x < L.

    They are the vertices of four cells at which the edges of the diagram end, to some 1e-14 of the tube's
    size by Newton in float64; x along the axis, y = r cos(angle), z = r sin(angle). Positions as (axial,
    angle), [n, 2]; `edges` spares tracing them anew. Paper, section 4.3 (decision: open tissue only).

    >>> four = find_transitions([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> four.points.round(4).tolist(), four.cells.tolist()
    ([[2.0, 1.6687, 0.0]], [[0, 1, 2, 3]])
    """
    graph = trace_edges(positions, tube) if edges is None else edges
    inner = graph.vertex_labels[:, 3] < graph.cells
    cells = graph.vertex_labels[inner]
    per_cell = np.bincount(cells.ravel(), minlength=graph.cells)
    return Transitions(graph.vertices[inner], cells, per_cell, graph.open_ends)


def find_forms(
    positions: Float[ArrayLike, "n 2"],
    tube: Tube,
    resolution: Resolution = PRESETS["standard"],
    edges: EdgeGraph | None = None,
) -> CellForms:
    """Which cells wrap round the lumen, and how many parts each has.

    A cell is one interval on each line parallel to the axis, and wraps if it is met on all lines round some
    layer of the resolution. Its parts are the connected parts of its boundary. Positions as (axial, angle),
    [n, 2]; `edges` spares tracing them anew.

    >>> find_forms([[2, 0], [8, 0]], Tube(10, 1, 3))
    CellForms(is_ring=array([ True,  True]), pieces=array([1, 1]))
    """
    place, n = np.asarray(positions, float), len(np.asarray(positions))
    if n == 1:
        return CellForms(np.ones(1, bool), np.ones(1, int))
    sides = sided(find_candidates(place, tube), place, tube)
    _, survey, lines = survey_tissue(jnp.asarray(place), tube, sides, resolution, surfaces=True)
    reach, limit, offset = np.asarray(survey.reach), np.asarray(survey.limit), lines.offset[:, None]
    filled = (reach.sum(axis=1) > 0) & (offset >= -limit[0]) & (offset <= limit[1])
    is_ring = np.zeros(n, bool)
    for layer, (circle, half) in enumerate(zip(lines.circle, lines.half, strict=True)):
        if 2 * half >= circle:
            is_ring |= filled[lines.layer == layer].all(axis=0)
    graph = trace_edges(place, tube) if edges is None else edges
    return CellForms(is_ring, _count_pieces(graph, find_faces(place, tube, graph)))


def _count_pieces(graph: EdgeGraph, faces: Faces) -> Int[np.ndarray, " n"]:
    """Connected parts of each cell's boundary: its edges, joined if in the same piece of a face."""
    n, parts = graph.cells, np.arange(len(faces.part_face))
    # holes, and rims that the tube's ends cut open, go with the first such rim, or the first whole one
    rank = np.select([faces.is_cut, faces.is_outer], [0, 1], 2)
    order = np.lexsort((rank, faces.part_face))
    main = order[np.searchsorted(faces.part_face[order], faces.part_face)]
    piece = np.where(faces.is_outer & ~faces.is_cut, parts, main)[faces.part]
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
