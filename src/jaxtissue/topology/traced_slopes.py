"""Derivatives of volumes and lateral areas by the positions of backbones, from traced edges, in 64 bits.

Sizes are integrals round the rims of walls, of P(r, t) dt for areas: see `rims`. Where a backbone moves, P changes, and
so does the rim: an edge moves to where three cells are equally far again. What it sweeps counts with P's derivative by
r for areas. For volumes it counts nothing, since what one wall of a cell gains its next one loses.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.topology.bisectors import Bisectors, cross, dot
from jaxtissue.topology.contacts import find_faces
from jaxtissue.topology.edges import EdgeGraph, trace_edges
from jaxtissue.topology.rims import BLOCK, LEVEL, SIDES, SLOPES, WEIGHTS, flow, nodes_on, primitive
from jaxtissue.topology.traced_sizes import TracedSizes, traced_sizes

STEP = 4e-3  # of the scale on which closed forms change: differences of sixth order err by its sixth power
APART = 8  # times as far as makes two backbones level, by which level ones are parted at most
PARALLEL = 1e-12  # of the product of two slopes, below which their walls are taken as one


class Traced(NamedTuple):
    """A tissue whose edges are known, and the sizes of its cells."""

    graph: EdgeGraph
    sizes: TracedSizes


def trace_tissue(positions: Float[np.ndarray, "n 2"], tube: Tube) -> Traced | None:
    """Edges and sizes of all cells; None where edges could not be followed.

    Neighbors at the same axial position are parted, by little more than makes them level: their walls are parallel to
    the axis, and P is infinite there. No wall of the tissue traced is level, since slopes leave such walls out.
    """
    place, random = np.array(positions, float), np.random.default_rng(0)
    graph = trace_edges(place, tube)
    while len(pairs := _level_pairs(graph)):
        cells = np.unique(pairs)
        ends = np.stack([np.cos(place[pairs, 1]), np.sin(place[pairs, 1])])
        step = APART * LEVEL * float(tube.apical_radius) * np.linalg.norm(ends[..., 0] - ends[..., 1], axis=0).max()
        place[cells, 0] += step * random.uniform(-1, 1, len(cells))
        place[:, 0] = np.clip(place[:, 0], 0, float(tube.length))
        graph = trace_edges(place, tube)
    sizes = traced_sizes(graph, find_faces(graph), tube)
    return None if sizes is None else Traced(graph, sizes)


def traced_slopes(
    graph: EdgeGraph,
    by_volume: Float[np.ndarray, " n"],
    by_area: Float[np.ndarray, " n"],
    adhesion: Adhesion | None = None,
) -> Float[np.ndarray, "n 2"]:
    """The derivatives of a function of volumes and lateral areas by (axial, angle) positions, from those by sizes."""
    n, bisectors = graph.cells, graph.bisectors
    slope = np.zeros((len(bisectors.axial), 2))
    for first in range(0, len(graph.points), BLOCK):
        some = slice(first, first + BLOCK)
        labels = graph.edge_labels[graph.segment_edge[some]]
        rim = _rim(nodes_on(graph.points[some], graph.tangents[some], labels, bisectors))
        pull = np.zeros_like(rim.radius)  # of what an edge sweeps
        for one, two, sign in SIDES:
            pair = labels[:, [one, two]]
            walls = np.flatnonzero((pair[:, 1] < n) & ~_is_level(bisectors, pair))
            pair = pair[walls]
            worth = 1.0 if adhesion is None else np.asarray(adhesion.weights)[tuple(np.asarray(adhesion.types)[pair.T])]
            tension = sign * worth * by_area[pair].sum(axis=1)
            weights = np.stack([tension, *(sign * by_volume[pair]).T])
            by_gap, *by_turns = _by_parameters(rim.of(walls), pair, bisectors, weights)
            for k, turn in enumerate(by_turns):
                np.add.at(slope, pair[:, k], np.stack([(-by_gap, by_gap)[k], turn], axis=1))
            foot, next_foot = (bisectors.feet(rim.point[walls].reshape(-1, 3), np.repeat(k, 5)) for k in pair.T)
            gap = bisectors.axial[pair[:, 1]] - bisectors.axial[pair[:, 0]]
            tilt = np.linalg.norm(next_foot - foot, axis=1).reshape(-1, 5) / gap[:, None]
            pull[walls] += tension[:, None] * tilt * rim.radius[walls]
            # ends of cells at the ends of the tube, to which the backbones come nearer
            ends = np.flatnonzero((labels[:, one] < n) & (labels[:, two] >= n + 2))
            cell, section = labels[ends, one], (rim.radius[ends] ** 2 * rim.spin[ends]) @ WEIGHTS / 2
            np.add.at(slope[:, 0], cell, -sign * by_volume[cell] * section)
        _add_sweeps(slope, rim, labels, pull, bisectors)
    return slope[:n]


class _Rim(NamedTuple):
    """Nodes on segments, and how they turn and rise along these."""

    point: Float[np.ndarray, "m 5 3"]
    radius: Float[np.ndarray, "m 5"]
    angle: Float[np.ndarray, "m 5"]
    spin: Float[np.ndarray, "m 5"]
    rise: Float[np.ndarray, "m 5"]

    def of(self, rows: np.ndarray) -> "_Rim":
        return _Rim(*(table[rows] for table in self))


def _rim(point: Float[np.ndarray, "m 5 3"]) -> _Rim:
    radius, angle = np.hypot(point[..., 1], point[..., 2]), np.arctan2(point[..., 2], point[..., 1])
    turn = np.mod(angle - angle[:, :1] + np.pi, 2 * np.pi) - np.pi
    return _Rim(point, radius, angle, *(np.einsum("ij,mj->mi", SLOPES, value) for value in (turn, radius)))


def _level_pairs(graph: EdgeGraph) -> Int[np.ndarray, "m 2"]:
    pairs = np.concatenate([graph.edge_labels[:, [one, two]] for one, two, _ in SIDES])
    return pairs[_is_level(graph.bisectors, pairs)]


def _is_level(bisectors: Bisectors, pair: Int[np.ndarray, "m 2"]) -> np.ndarray:
    gap = np.abs(bisectors.axial[pair[:, 1]] - bisectors.axial[pair[:, 0]])
    chord = np.hypot(*(table[pair[:, 1]] - table[pair[:, 0]] for table in (bisectors.cosine, bisectors.sine)))
    return (pair[:, 1] < bisectors.count) & (gap < LEVEL * bisectors.inner * chord)


def _by_parameters(
    rim: _Rim, pair: Int[np.ndarray, "m 2"], bisectors: Bisectors, weights: Float[np.ndarray, "3 m"]
) -> list[Float[np.ndarray, " m"]]:
    """How weighted sums round rims change with the axial gap and both angles of pairs, at nodes that stay."""
    rows = len(pair)
    index = np.stack([np.arange(rows), rows + np.arange(rows)], axis=1)
    both = pair.T.ravel()
    gap = bisectors.axial[pair[:, 1]] - bisectors.axial[pair[:, 0]]
    little = STEP * np.minimum(0.3, np.abs(gap) / bisectors.outer)

    def summed(gap: np.ndarray, turns: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        way = (bisectors.cosine[both] + 1j * bisectors.sine[both]) * np.exp(1j * np.concatenate(turns))
        moved: Any = SimpleNamespace(
            axial=np.concatenate([0 * gap, gap]), cosine=way.real, sine=way.imag, inner=bisectors.inner
        )
        at = rim.radius, rim.angle, index, moved
        sizes = np.stack([np.sign(gap)[:, None] * primitive(*at), *flow(*at)])
        return np.einsum("km,kmi,mi,i->m", weights, sizes, rim.spin, WEIGHTS)

    none = np.zeros(rows)
    steps = [(STEP * gap, (none, none)), (none, (little, none)), (none, (none, little))]

    def change(by: np.ndarray, turns: tuple[np.ndarray, np.ndarray], times: int) -> np.ndarray:
        first, second = times * turns[0], times * turns[1]
        return summed(gap + times * by, (first, second)) - summed(gap - times * by, (-first, -second))

    return [
        (45 * change(by, turns, 1) - 9 * change(by, turns, 2) + change(by, turns, 3))
        / (60 * (by + turns[0] + turns[1]))
        for by, turns in steps
    ]


def _add_sweeps(
    slope: np.ndarray, rim: _Rim, labels: Int[np.ndarray, "m 3"], pull: Float[np.ndarray, "m 5"], bisectors: Bisectors
) -> None:
    """Add what edges sweep as they follow the backbones of their three cells."""
    point, label = rim.point.reshape(-1, 3), np.repeat(labels, 5, axis=0)
    first, second = np.moveaxis(bisectors.over_first(point, label)[1], -1, 0)
    along = cross(first, second)
    square = dot(along, along)
    fit = square > PARALLEL * dot(first, first) * dot(second, second)
    cosine, sine = np.cos(rim.angle).ravel(), np.sin(rim.angle).ravel()
    # (dr, dt) of a displacement u is (e_r . u, e_t . u / r): sweeps are spin dr - rise dt
    across = np.stack([0 * cosine, cosine, sine]) * rim.spin.ravel()
    across -= np.stack([0 * cosine, -sine, cosine]) * (rim.rise / rim.radius).ravel()
    factor = -(pull * WEIGHTS).ravel() / np.where(fit, square, np.inf)
    # the edge moves square to itself, by the dual of both gradients
    loads = [factor * dot(across, cross(second, along)), -factor * dot(across, cross(first, along))]
    own = -np.where(bisectors.count > label[:, 1:].T, loads, 0).sum(axis=0)  # bounds stay
    for k, load in enumerate((own, *loads)):
        cells = np.flatnonzero(label[:, k] < bisectors.count)
        number, at = label[cells, k], point[cells]
        height = at[:, 1] * bisectors.cosine[number] + at[:, 2] * bisectors.sine[number]
        aside = at[:, 2] * bisectors.cosine[number] - at[:, 1] * bisectors.sine[number]
        foot = np.maximum(height, bisectors.inner)
        nearer = 2 * np.stack([at[:, 0] - bisectors.axial[number], foot * aside], axis=1)
        np.add.at(slope, number, load[cells, None] * nearer)
