"""The edges of the diagram, where three labels meet, followed from vertex to vertex.

From seeds, edges are followed to the vertices that end them, and from each new vertex its other edges. Every
vertex ends four edges, every edge has two ends: what is missing shows as an open end.
"""

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.bisectors import BOUNDS, TIE, TINY, TOUCH, Bisectors, ranges
from jaxtissue.topology.continuation import CLOSED, FAILED, RUNNING, Fronts, begin, passes, refine_all, step
from jaxtissue.topology.seeds import Seeds, seed, seed_lenses

TRIES = 8  # tracings at most
CARE = 4.0  # by how much steps are shorter at most
PART = 1e-7  # of the distances to their next: how far walls that meet in one line of four cells are parted
NEAR_TIES = 4  # a fifth label may lag behind four by so many ties and still count as tied
WIDE = 100  # times that: what is narrower may come of it
FIRST = 8  # of the seeds at most one in so many is followed at first, then those on no edge yet
TOGETHER = 64  # seeds to follow at first, at least: fewer fronts take hardly less time a step


class EdgeGraph(NamedTuple):
    """The vertices and edges of a tissue of n cells by their sorted labels.

    The labels are those of cells, and n .. n + 3 for the apical and basal surface and the ends x = 0 and x = L. Edges
    with one cell are arcs of the circles at the tube's ends. Edges come in short segments of given ends and unit
    tangents, all along grad lead_1 x grad lead_2 over the edge's first label.
    """

    cells: int
    vertices: Float[np.ndarray, "v 3"]
    vertex_labels: Int[np.ndarray, "v 4"]
    edge_labels: Int[np.ndarray, "e 3"]
    edge_vertices: Int[np.ndarray, "e 2"]  # -1 for a closed edge
    segment_edge: Int[np.ndarray, " s"]
    points: Float[np.ndarray, "s 2 3"]
    tangents: Float[np.ndarray, "s 2 3"]
    open_ends: int  # of edges, cells not met or told apart: if not 0, parts may be missing
    blur: float  # how far walls are off, at most, where more than four labels met and had to be parted
    bisectors: Bisectors  # of the tissue itself, built once for all that is found from its edges


def trace_edges(positions: PositionsLike, tube: Tube) -> EdgeGraph:
    """Trace all edges and vertices of the cells of backbones at (axial, angle) positions, [n, 2], in 64 bits.

    Every step looks at all backbones near enough to lead; where an end stays open, all is traced again in shorter
    steps. Where five labels meet, as on lattices, tiny weights on the squared distances of the cells concerned part
    them into vertices of four. Warns of open ends. Paper, section 4.1.
    """
    place = as_positions(positions, tube, np.float64)
    plain = Bisectors(place, tube)
    random, weights, care, best = np.random.default_rng(0), np.zeros(len(place)), 1.0, None
    for _ in range(TRIES):
        graph, tied, lost = _trace(Bisectors(place, tube, care, weights if weights.any() else None))
        rank = graph.open_ends, int(tied.sum())
        if best is None or rank < best[0]:
            best = rank, graph, weights.copy()
        if not any(rank):
            break
        if not tied.any() and care < CARE:  # a step crossed a wall and crossed it back
            care *= 2
            continue
        parted = tied if tied.any() else lost
        gaps = _gaps(plain, plain.inner) * _gaps(plain, plain.outer)
        weights[parted] = random.uniform(0, PART, parted.sum()) * gaps[parted]
    assert best is not None
    (_, untold), graph, weights = best
    graph = graph._replace(open_ends=graph.open_ends + untold, bisectors=plain)
    if graph.open_ends:
        message = (
            f"{graph.open_ends} edges of the diagram could not be followed, so contacts and transition points may be"
        )
        warnings.warn(f"{message} missing; separate backbones that nearly coincide", stacklevel=2)
    return _settle(graph, plain, weights) if weights.any() else graph


def _gaps(bisectors: Bisectors, radius: float) -> Float[np.ndarray, " n"]:
    """The distance from each backbone to the next at a radius."""
    ends = np.stack([bisectors.axial, radius * bisectors.cosine, radius * bisectors.sine], axis=1)[: bisectors.count]
    return KDTree(ends).query(ends, k=2)[0][:, 1]


def _settle(graph: EdgeGraph, bisectors: Bisectors, weights: Float[np.ndarray, " n"]) -> EdgeGraph:
    """The graph traced with weights: its vertices where they are without, if four walls meet in a point."""
    blur = float((weights / np.maximum(_gaps(bisectors, bisectors.inner), TINY)).max()) / 2
    small = np.full(len(graph.vertices), TOUCH * bisectors.size)
    point, found = bisectors.solve(graph.vertices, graph.vertex_labels, small)
    found &= np.abs(point - graph.vertices).max(axis=1, initial=0) < WIDE * blur
    return graph._replace(vertices=np.where(found[:, None], point, graph.vertices), blur=blur)


def _trace(bisectors: Bisectors) -> tuple[EdgeGraph, Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The graph, the cells at vertices where a fifth label ties, and the cells whose edges were lost."""
    graph, seeds = _Growing(bisectors), seed(bisectors)
    apart = min(FIRST, 1 + len(seeds.point) // TOGETHER)
    graph.grow(Seeds(*(column[::apart] for column in seeds)))
    graph.grow(Seeds(*(column[~graph.covers(seeds)] for column in seeds)))
    lenses = seed_lenses(*graph.walls(), bisectors)
    if len(lenses.point):
        graph.grow(Seeds(*(column[~graph.covers(lenses)] for column in lenses)))
    return graph.finish()


class _Growing:
    """The graph while it is traced."""

    def __init__(self, bisectors: Bisectors) -> None:
        self.bisectors = bisectors
        self.points: list[list[float]] = []
        self.labels: list[tuple[int, ...]] = []
        self.known: dict[tuple[int, ...], list[int]] = {}
        self.closed: dict[int, int] = {}  # the other end of the edge at each end; the front of a loop at -1 - it
        self.begun: list[Fronts] = []
        self.count = 0
        self.edges: list[tuple[int, int, int]] = []  # front, its end, the end it came to
        self.walked: list[tuple[np.ndarray, np.ndarray]] = []  # fronts, and the points between which they went

    def grow(self, seeds: Seeds) -> None:
        """Follow the edges at seeds, and all edges joined to them."""
        sign, end = np.ones(len(seeds.point)), np.full(len(seeds.point), -1)
        fronts, waiting = self._begin(seeds.point, seeds.labels, sign, end), np.zeros(0, int)
        while len(fronts.point) or len(waiting):
            moved, met = step(fronts, self.bisectors)
            good = met != FAILED
            self.walked.append((moved.number[good], np.stack([fronts.point, moved.point], axis=1)[good]))
            first = len(self.points)
            self._enter(moved, met)
            open_ = np.array([end not in self.closed for end in moved.end.tolist()], bool)
            going = open_ & ((met == RUNNING) | (met == FAILED)) & (moved.longest > TOUCH * self.bisectors.size)
            fronts = moved.of(going)
            left = np.append(waiting, np.arange(4 * first, 4 * len(self.points)))
            new, waiting = self._leave(left, fronts)
            fronts = Fronts.of_all([fronts, new])

    def _begin(self, point: np.ndarray, labels: np.ndarray, sign: np.ndarray, end: np.ndarray) -> Fronts:
        fronts = begin(point, labels, sign, end, self.count, self.bisectors)
        self.count += len(point)
        self.begun.append(fronts)
        return fronts

    def _enter(self, fronts: Fronts, met: np.ndarray) -> None:
        """Enter the edges whose vertex has been reached."""
        home = fronts.of(met == CLOSED)
        self.edges += [(number, -1, -1) for number in home.number.tolist()]
        there = met >= 0
        ends = fronts.of(there)
        four = np.sort(np.append(ends.labels, met[there, None], axis=1), axis=1)
        place = (four < met[there, None]).sum(axis=1)
        rows = zip(*(column.tolist() for column in (ends.number, ends.end, place, ends.point)), strict=True)
        for labels, (number, left, omitted, point) in zip(zip(*four.T.tolist(), strict=True), rows, strict=True):
            end = 4 * self._vertex(point, labels) + omitted
            if left < 0 or left in self.closed:
                continue
            if end in self.closed:  # one of the two went astray: its other end stays open, or is met rightly
                continue
            self.closed[left], self.closed[end] = end, left
            self.edges.append((number, left, end))

    def _vertex(self, point: list[float], labels: tuple[int, ...]) -> int:
        """The number of a vertex, new or known."""
        same, near = self.known.setdefault(labels, []), 1e-8 * self.bisectors.size
        for number in same:
            (a, b, c), (x, y, z) = self.points[number], point
            if abs(a - x) < near and abs(b - y) < near and abs(c - z) < near:
                return number
        same.append(len(self.points))
        self.points.append(point)
        self.labels.append(labels)
        return same[-1]

    def _leave(self, ends: np.ndarray, fronts: Fronts) -> tuple[Fronts, np.ndarray]:
        """Fronts along edges from their ends, if not yet followed, and the ends that wait.

        An end waits while an edge of its labels is followed, by one of `fronts` or by the first of the new ones:
        that is most often the same edge, from its other end.
        """
        ends = np.array([end for end in ends.tolist() if end not in self.closed], int)
        vertex, omitted = ends // 4, ends % 4
        labels = np.array([self.labels[number] for number in vertex.tolist()], int).reshape(-1, 4)
        rest = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[omitted]
        triple, other = np.take_along_axis(labels, rest, axis=1), labels[np.arange(len(ends)), omitted]
        key, followed = self._keys(triple), self._keys(fronts.labels[fronts.end >= 0])
        go = np.unique(key, return_index=True)[1]
        go = go[~np.isin(key[go], followed)]
        waiting, ends, triple, other = np.delete(ends, go), ends[go], triple[go], other[go]
        point = np.array([self.points[number] for number in (ends // 4).tolist()]).reshape(-1, 3)
        _, slope = self.bisectors.over_first(point, np.stack([triple[:, 0], other], axis=1))
        sign = -np.sign((self.bisectors.tangent(point, triple) * slope[..., 0].T).sum(axis=1))
        return self._begin(point, triple, sign, ends), waiting

    def _keys(self, labels: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
        """A number for each three labels."""
        base = self.bisectors.count + 4
        return labels @ [base**2, base, 1]

    def _segments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Labels of all fronts; the front and the two points of each segment walked, in order."""
        labels = np.concatenate([fronts.labels for fronts in self.begun])
        front, points = (np.concatenate(part) for part in zip(*self.walked, strict=True))
        order = np.argsort(front, kind="stable")
        return labels, front[order], points[order]

    def covers(self, seeds: Seeds) -> Bool[np.ndarray, " m"]:
        """Whether an edge has been followed past each seed."""
        labels, front, points = self._segments()
        key, wanted = self._keys(labels[front]), self._keys(seeds.labels)
        order = np.argsort(key)
        first, last = (np.searchsorted(key[order], wanted, side=side) for side in ("left", "right"))
        row, place = ranges(first, last - first)
        start, stop = points[order[place]].transpose(1, 0, 2)
        near = passes(seeds.point[row], start, stop, np.linalg.norm(stop - start, axis=1) / 5)
        return np.bincount(row, near, len(wanted)) > 0

    def walls(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pairs of cells with a wall, and for each a ball that holds every backbone as near to its rim as they."""
        labels, front, points = self._segments()
        place, three = points.mean(axis=1), labels[front]
        foot, out = (
            self.bisectors.feet(place, three[:, 0]),
            np.linalg.norm(points[:, 1] - points[:, 0], axis=1),
        )
        out += np.linalg.norm(place - foot, axis=1)
        sides = np.concatenate([three[:, [0, 1]], three[:, [1, 2]], three[:, [0, 2]]])
        wall = np.flatnonzero(sides[:, 1] < self.bisectors.count)
        keys, which = np.unique(sides[wall] @ [self.bisectors.count, 1], return_inverse=True)
        row, size = wall % len(three), np.bincount(which)
        center = np.stack([np.bincount(which, x[row]) / size for x in place.T], axis=1)
        reach = np.zeros(len(keys))
        np.maximum.at(reach, which, np.linalg.norm(place[row] - center[which], axis=1) + out[row])
        return np.stack(np.divmod(keys, self.bisectors.count), axis=1), center, reach

    def finish(self) -> tuple[EdgeGraph, Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """The graph traced, and the cells at ties and at open ends."""
        bisectors, n = self.bisectors, self.bisectors.count
        labels, front, points = self._segments()
        begun = np.array(self.edges, int).reshape(-1, 3)
        sign = np.concatenate([fronts.sign for fronts in self.begun])
        closed = np.flatnonzero(begun[:, 1] < 0)
        _, once = np.unique(labels[begun[closed, 0]], axis=0, return_index=True)
        begun = begun[np.sort(np.append(np.flatnonzero(begun[:, 1] >= 0), closed[once]))]
        edge_of = np.full(self.count, -1)
        edge_of[begun[:, 0]] = np.arange(len(begun))
        edge = edge_of[front]
        front, points, edge = front[edge >= 0], points[edge >= 0], edge[edge >= 0]
        order = np.argsort(edge, kind="stable")
        edge, points, along = edge[order], points[order], sign[front[order]]
        points = np.where((along > 0)[:, None, None], points, points[:, ::-1])
        points, tangents, segment = refine_all(points, labels[begun[edge, 0]], bisectors)
        four, vertices = np.array(self.labels, int).reshape(-1, 4), np.array(self.points).reshape(-1, 3)
        rival, beyond = bisectors.nearest_competitor(vertices, four)
        tied, lost = np.zeros(n + BOUNDS, bool), np.zeros(n + BOUNDS, bool)
        ties = beyond > -NEAR_TIES * TIE * bisectors.size
        tied[four[ties]] = tied[rival[ties]] = True
        ended = np.bincount(np.array(list(self.closed), int) // 4, minlength=len(four))
        lost[four[ended < 4]] = True
        unseen = np.bincount(labels[begun[:, 0]].ravel(), minlength=n)[:n] == 0  # behind a twin
        lost[:n] |= unseen
        graph = EdgeGraph(
            n,
            vertices,
            four,
            labels[begun[:, 0]],
            begun[:, 1:] // 4,
            edge[segment],
            points,
            tangents,
            int(4 * len(four) - len(self.closed) + unseen.sum()),
            0.0,
            bisectors,
        )
        return graph, tied[:n], lost[:n]
