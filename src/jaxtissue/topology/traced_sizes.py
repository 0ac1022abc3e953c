"""Sizes of cells from their traced faces, in float64, with bounds of the remaining errors."""

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.bisectors import BOUNDS
from jaxtissue.topology.contacts import Faces, find_faces
from jaxtissue.topology.edges import WIDE, EdgeGraph, trace_edges

# Of the mean volume and lateral area: what agreement with the reference tubes vouches for. In shorter
# segments the same sizes come out, to 2e-8.
LEAST = 7e-6, 2.4e-4


class TracedSizes(NamedTuple):
    """Sizes of each cell, in 64 bits, with bounds of the errors of volume and lateral area; see `CellGeometry`."""

    volume: Float[np.ndarray, " n"]
    lateral_area: Float[np.ndarray, " n"]
    apical_area: Float[np.ndarray, " n"]
    basal_area: Float[np.ndarray, " n"]
    apical_perimeter: Float[np.ndarray, " n"]
    basal_perimeter: Float[np.ndarray, " n"]
    touches_end: Bool[np.ndarray, " n"]
    volume_error: Float[np.ndarray, " n"]
    lateral_area_error: Float[np.ndarray, " n"]


def traced_sizes(edges: EdgeGraph, faces: Faces, tube: Tube, tissue: int | None = None) -> TracedSizes | None:
    """Sizes of all cells with bounds of their errors; None where edges are missing.

    Volumes are flows through walls and ends, areas integrals round the rims of faces: `rims`. What the
    volumes miss of the tube's, and walls that were parted where they meet in a line, add to the errors. The
    cells may be a part of a `tissue` of so many.
    """
    n, total = edges.cells, float(tube.volume)
    if edges.open_ends:
        return None
    first, second = faces.labels.T
    walls, count = second < n, len(faces.labels)
    length, bound = faces.edge_length[faces.edge], edges.edge_labels[faces.edge, 2] - n

    def of_walls(size: Float[np.ndarray, " faces"]) -> Float[np.ndarray, " n"]:
        return np.bincount(faces.labels[walls].T.ravel(), np.tile(size[walls], 2), n)

    real = faces.is_wall(edges.blur)
    lateral = of_walls(np.bincount(faces.part_face[real], faces.area[real], count))
    rim = of_walls(np.bincount(faces.face, length, count))
    area = np.bincount(faces.part_face, faces.area, count)
    apical, basal = (np.bincount(first[second == n + at], area[second == n + at], n) for at in (0, 1))
    edge = [of_walls(np.bincount(faces.face, length * (bound == at), count)) for at in (0, 1)]
    off, missing = WIDE * edges.blur, abs(faces.volume.sum() - total)
    return TracedSizes(
        volume=faces.volume,
        lateral_area=lateral,
        apical_area=apical,
        basal_area=basal,
        apical_perimeter=edge[0],
        basal_perimeter=edge[1],
        touches_end=find_ends(edges),
        volume_error=LEAST[0] * total / (tissue or n) + missing + off * lateral,
        lateral_area_error=LEAST[1] * lateral.mean() + off * rim,
    )


def trace_sizes(
    positions: Float[np.ndarray, "n 2"],
    tube: Tube,
    cells: Int[np.ndarray, " cells"] | None = None,
    rivals: Int[np.ndarray, "cells rivals"] | None = None,
) -> TracedSizes | None:
    """Sizes of all cells, or of the given `cells`; None where edges could not be followed.

    For given cells, only they and the `rivals` that may bound them are traced, if these are less than half of the
    tissue.
    """
    n = len(positions)
    traced = np.arange(n)
    if cells is not None and rivals is not None:
        near = np.union1d(cells, rivals)
        traced = near if 2 * len(near) < n else traced
    place = positions[traced]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of open ends: the caller is told by None
        edges = trace_edges(place, tube)
    sizes = traced_sizes(edges, find_faces(edges), tube, n)
    if sizes is None or cells is None:
        return sizes
    at = np.searchsorted(traced, cells)
    return TracedSizes(*(column[at] for column in sizes))


def find_ends(edges: EdgeGraph) -> Bool[np.ndarray, " n"]:
    """Cells with an edge on an end plane, x = 0 or x = L."""
    is_end = np.zeros(edges.cells + BOUNDS, bool)
    is_end[edges.edge_labels[edges.edge_labels[:, 2] >= edges.cells + 2]] = True
    return is_end[: edges.cells]
