"""Areas of walls and lengths of their edges on the surfaces, by quadrature between the heights where cells exchange."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.topology.junctions import Junctions
from jaxtissue.topology.layer_gaps import LayerGaps
from jaxtissue.topology.rising import Pieces

STEPS = 3  # of Newton's method, to a wall
OFF = 1e-5  # of the tissue's size, by which points that are not brought onto a wall miss it
# Rules from 0 to 1, each with a coarser one on some of its nodes: their difference tells the error. Along an edge
# Gauss's rule of three nodes and Kronrod's of seven, over the height of a piece the middle and Gauss's of three.
_FAR = np.array([0.960491268708020283, 0.774596669241483377, 0.434243749346802558])
_KRONROD = np.array([0.104656226026467265, 0.268488089868333440, 0.401397414775962222, 0.450916538658474142])
_GAUSS = np.array([5, 8, 5]) / 18
ALONG = (1 + np.array([*-_FAR, 0, *_FAR[::-1]])) / 2
ALONG_RULES = np.stack([np.array([*_KRONROD, *_KRONROD[2::-1]]) / 2, np.zeros(7)])
ALONG_RULES[1, [1, 3, 5]] = _GAUSS
LAYERS = (1 + np.array([-np.sqrt(0.6), 0, np.sqrt(0.6)])) / 2
LAYER_RULES = np.stack([_GAUSS, [0, 1, 0]])


class WallPoints(NamedTuple):
    """Points of walls, and the two cells of each."""

    point: Float[np.ndarray, "p 3"]
    pairs: Int[np.ndarray, "p 2"]


class Curve(NamedTuple):
    """What is integrated along edges between two cells, by the finer and the coarser rule, [2, e]."""

    length: Float[np.ndarray, "2 e"]
    area: Float[np.ndarray, "2 e"]  # of the wall, per height
    points: WallPoints


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
    rows = np.repeat(np.arange(len(pairs)), len(ALONG))
    share, labels, h, place = np.tile(ALONG, len(pairs)), pairs[rows], height[rows], start[rows]
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
    length, area = (ALONG_RULES @ size.reshape(-1, len(ALONG)).T for size in (length, area))
    missed = np.abs(lead.value[:, 0]) > OFF * gaps.size * np.maximum(lead.steep[:, 0], 1e-300)
    area[1, missed.reshape(-1, len(ALONG)).any(axis=1)] = 0  # all of the area is in doubt
    inner = np.flatnonzero(~missed & np.tile(ALONG_RULES[1] > 0, len(pairs)))
    return Curve(length, area, WallPoints(spots.point[inner], labels[inner]))


def wall_areas(gaps: LayerGaps, pieces: Pieces) -> tuple[Float[np.ndarray, "2 e"], WallPoints]:
    """The areas of the walls of pieces of edges between two cells, by the finer and the coarser rule; and points."""
    total, points = np.zeros((2, len(pieces.low))), WallPoints(np.zeros((0, 3)), np.zeros((0, 2), int))
    for node, weights in zip(LAYERS, LAYER_RULES.T, strict=True):
        height = pieces.low + (pieces.high - pieces.low) * node
        ends = []
        for k in (0, 1):
            labels = np.sort(pieces.quad[:, [0, 1, 2 + k]], axis=1)
            away = pieces.drift[:, k] * (height - pieces.at[:, k])[:, None]
            ends.append(gaps.meet(labels, pieces.place[:, k], height, away)[0].place)
        curve = edge_sizes(gaps, pieces.quad[:, :2], ends[0], ends[1], height)
        total += weights[:, None] * curve.area
        points = curve.points if weights[1] else points
    return total * (pieces.high - pieces.low), points


def surface_edges(gaps: LayerGaps, junctions: Junctions) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
    """The pairs of cells with an edge on a surface, and the lengths of these edges."""
    row, side = junctions.edges()
    pairs = junctions.quads(row, side)[:, :2]
    walls = (pairs < gaps.count).all(axis=1)
    row, side, pairs = row[walls], side[walls], pairs[walls]
    places = junctions.place[row], junctions.place[junctions.beside[row, side]]
    return pairs, edge_sizes(gaps, pairs, places[0], places[1], junctions.at[row]).length[0]
