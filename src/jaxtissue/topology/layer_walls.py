"""Areas of walls and lengths of their edges on the surfaces, by quadrature between the heights where cells exchange."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.topology.junctions import Junctions
from jaxtissue.topology.layer_gaps import LayerGaps
from jaxtissue.topology.rising import Pieces

LAYERS, ALONG = 2, 6  # Gauss-Legendre nodes, over the height of a piece and along an edge
STEPS = 3  # of Newton's method, to a wall


class Curve(NamedTuple):
    """Points on the edges between two cells, [e, ALONG], and what of an integral along the edge each stands for."""

    length: Float[np.ndarray, " e"]
    area: Float[np.ndarray, " e"]  # of the wall, per height


def edge_sizes(
    gaps: LayerGaps,
    pairs: Int[np.ndarray, "e 2"],
    start: Float[np.ndarray, "e d"],
    end: Float[np.ndarray, "e d"],
    height: Float[np.ndarray, " e"],
) -> Curve:
    """The lengths of edges between two cells from one junction to another, and the areas of their walls per height.

    A wall is a level set of the gap g: where it goes on by a step T along the layer, its area is
    |dg/dx| |det dF| |T|^2 / |dg/dN| per height, with N the step T turned by a right angle.
    """
    node, weight = np.polynomial.legendre.leggauss(ALONG)
    share, weight = (node + 1) / 2, weight / 2
    rows = np.repeat(np.arange(len(pairs)), ALONG)
    share, labels, h, place = np.tile(share, len(pairs)), pairs[rows], height[rows], start[rows]
    ahead = gaps.look(start, np.zeros((len(pairs), 2)), height, end).way[rows]
    across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    aside = np.zeros(len(rows))
    turn = 0
    while True:
        spots = gaps.look(place, share[:, None] * ahead + aside[:, None] * across, h)
        lead = gaps.lead(spots, labels)
        slope = lead.slope[:, 0, :2]
        steep = (slope * across).sum(axis=1)
        steep = np.where(np.abs(steep) > 1e-300, steep, 1e-300)
        if turn == STEPS:
            break
        aside -= np.clip(lead.value[:, 0] / steep, -0.5, 0.5)
        turn += 1
    along = ahead - across * ((slope * ahead).sum(axis=1) / steep)[:, None]
    length = np.linalg.norm(np.einsum("pij,pj->pi", spots.columns[..., :2], along), axis=1)
    element = np.abs(np.linalg.det(spots.columns)) * (ahead**2).sum(axis=1) / np.abs(steep)
    area = lead.steep[:, 0] * element
    return Curve(length.reshape(-1, ALONG) @ weight, area.reshape(-1, ALONG) @ weight)


def wall_areas(gaps: LayerGaps, pieces: Pieces) -> Float[np.ndarray, " e"]:
    """The areas of the walls of pieces of edges between two cells."""
    total = np.zeros(len(pieces.low))
    for node, weight in zip(*np.polynomial.legendre.leggauss(LAYERS), strict=True):
        height = pieces.low + (pieces.high - pieces.low) * (node + 1) / 2
        ends = []
        for k in (0, 1):
            labels = np.sort(pieces.quad[:, [0, 1, 2 + k]], axis=1)
            away = pieces.drift[:, k] * (height - pieces.at[:, k])[:, None]
            ends.append(gaps.meet(labels, pieces.place[:, k], height, away)[0].place)
        total += weight / 2 * edge_sizes(gaps, pieces.quad[:, :2], ends[0], ends[1], height).area
    return total * (pieces.high - pieces.low)


def surface_edges(gaps: LayerGaps, junctions: Junctions) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
    """The pairs of cells with an edge on a surface, and the lengths of these edges."""
    row, side = junctions.edges()
    pairs = junctions.quads(row, side)[:, :2]
    walls = (pairs < gaps.count).all(axis=1)
    row, side, pairs = row[walls], side[walls], pairs[walls]
    places = junctions.place[row], junctions.place[junctions.beside[row, side]]
    return pairs, edge_sizes(gaps, pairs, places[0], places[1], junctions.at[row]).length
