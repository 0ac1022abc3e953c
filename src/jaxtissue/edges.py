"""The edges of the diagram, where three labels meet, followed from vertex to vertex.

From each backbone a line along x meets the first wall on either surface; from there edges are followed to the
vertices that end them, and from each new vertex its other edges. Every vertex ends as many edges as it has
triples of labels, every edge has two ends: what is missing, or ended twice, shows as an open end.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from jaxtissue.fronts import GOING, HOME, LOST, Fronts, begin, passes, refine, step
from jaxtissue.inputs import as_positions
from jaxtissue.leads import TOUCH, Leads, ranges
from jaxtissue.tube import Tube

CARE = 2.0, 4.0  # by how much steps are shorter in a second and a third try
FIRST = 8  # of the seeds one in so many is followed at first, then those on no edge yet


class EdgeGraph(NamedTuple):
    """Vertices and edges of a tissue of n cells by their sorted labels: cells, and n .. n + 3 the apical and
    basal surface and the ends x = 0 and x = L.

    Edges with one cell only (of the tube itself) are left out. Edges come in short segments of given ends and
    unit tangents, all along grad lead_1 x grad lead_2 over the edge's first label.
    """

    cells: int
    vertices: Float[np.ndarray, "v 3"]
    vertex_labels: Int[np.ndarray, "v 4"]
    edge_labels: Int[np.ndarray, "e 3"]
    edge_vertices: Int[np.ndarray, "e 2"]  # -1 for a closed edge
    segment_edge: Int[np.ndarray, " s"]
    points: Float[np.ndarray, "s 2 3"]
    tangents: Float[np.ndarray, "s 2 3"]
    open_ends: int  # 0 unless backbones coincide or lie on a lattice


class Seeds(NamedTuple):
    """Points on edges, and their labels."""

    point: Float[np.ndarray, "m 3"]
    labels: Int[np.ndarray, "m 3"]


def trace_edges(positions: Float[ArrayLike, "n 2"], tube: Tube) -> EdgeGraph:
    """All edges and vertices of the cells of backbones at (axial, angle) positions, [n, 2], in float64.

    Every step looks at all backbones near enough to lead; where an end stays open, or two edges come in at
    it, all is traced again in shorter steps. Edges of a part of the diagram
    that no edge joins to a wall beside a backbone are not seen: closed edges within the tissue. Paper,
    section 4.1.
    """
    positions = as_positions(positions, tube, np.float64)
    graph = _trace(Leads(positions, tube))
    for care in CARE:
        if graph.open_ends:  # some step crossed a wall and crossed it back
            careful = _trace(Leads(positions, tube, care))
            graph = min(graph, careful, key=lambda graph: graph.open_ends)
    return graph


def _trace(leads: Leads) -> EdgeGraph:
    graph, seeds = _Growing(leads), seed(leads)
    graph.grow(Seeds(*(column[::FIRST] for column in seeds)))
    graph.grow(Seeds(*(column[~graph.covers(seeds)] for column in seeds)))
    return graph.finish()


def seed(leads: Leads) -> Seeds:
    """Where each backbone's end, moved along x on either surface, meets a wall or an end."""
    n, seeds = leads.count, []
    own, surface = np.tile(leads.order, 2), np.repeat([0, 1], n)
    radius = np.array([leads.inner, leads.outer])[surface]
    place = np.stack([leads.axial[own], radius * leads.cosine[own], radius * leads.sine[own]], axis=1)
    for side in (-1, 1):
        away, other = first_wall(place, own, side, leads)
        point = place.copy()
        point[:, 0] = np.clip(place[:, 0] + side * away, 0, leads.length)
        met = (point[:, 0] > 0) & (point[:, 0] < leads.length)
        walls = np.stack([*np.sort([own, other], axis=0), n + surface], axis=1)
        rims = np.stack([own, n + surface, np.full(2 * n, n + 2 + (side > 0))], axis=1)
        seeds.append((point, np.where(met[:, None], walls, rims)))
    return Seeds(*(np.concatenate(part) for part in zip(*seeds, strict=True)))


def first_wall(
    place: Float[np.ndarray, "m 3"], own: Int[np.ndarray, " m"], side: int, leads: Leads
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """How far along x, on one side of points on their own backbones, the first wall is, and whose.

    A wall lies more than half-way to its backbone: those are looked through by axial place until it is so.
    """
    rank = np.empty(leads.count, int)
    rank[leads.order] = np.arange(leads.count)
    away, other = np.full(len(own), np.inf), own.copy()
    open_, done, count = np.arange(len(own)), 0, 16
    while len(open_):
        ahead = rank[own[open_], None] + side * (done + 1 + np.arange(count))
        rival = leads.order[np.clip(ahead, 0, leads.count - 1)]
        lead, slope = leads.over_first(place[open_], np.append(own[open_, None], rival, axis=1))
        toward = side * slope[0]
        walls = np.where(toward > 0, -lead / np.where(toward > 0, toward, 1), np.inf)
        best = walls.argmin(axis=1)[:, None]
        wall, rival = (np.take_along_axis(table, best, axis=1)[:, 0] for table in (walls, rival))
        nearer = wall < away[open_]
        away[open_[nearer]], other[open_[nearer]] = wall[nearer], rival[nearer]
        inside = (ahead[:, -1] >= 0) & (ahead[:, -1] < leads.count)
        done, count = done + count, 2 * count
        open_ = open_[inside & (toward[:, -1] / 4 < away[open_])]
    return away, other


class _Growing:
    """The graph while it is traced."""

    def __init__(self, leads: Leads) -> None:
        self.leads = leads
        self.points: list[list[float]] = []
        self.labels: list[tuple[int, ...]] = []
        self.known: dict[tuple[int, ...], list[int]] = {}
        self.closed: dict[
            int, int
        ] = {}  # the other end of the edge at each end; the front of a loop at -1 - it
        self.excess = 0  # ends at which a second edge came in
        self.begun: list[Fronts] = []
        self.count = 0
        self.edges: list[tuple[int, int, int]] = []  # front, its end, the end it came to
        self.walked: list[
            tuple[np.ndarray, np.ndarray]
        ] = []  # fronts, and the points between which they went

    def grow(self, seeds: Seeds) -> None:
        """Follow the edges at seeds, and all that are joined to them."""
        sign, end = np.ones(len(seeds.point)), np.full(len(seeds.point), -1)
        fronts = self._begin(seeds.point, seeds.labels, sign, end)
        while len(fronts.point):
            moved, met = step(fronts, self.leads)
            good = met != LOST
            self.walked.append((moved.number[good], np.stack([fronts.point, moved.point], axis=1)[good]))
            first = len(self.points)
            self._enter(moved, met)
            open_ = np.array([end not in self.closed for end in moved.end.tolist()], bool)
            going = open_ & ((met == GOING) | (met == LOST)) & (moved.longest > TOUCH * self.leads.size)
            fronts = moved.of(going).join(self._leave(first))

    def _begin(self, point: np.ndarray, labels: np.ndarray, sign: np.ndarray, end: np.ndarray) -> Fronts:
        fronts = begin(point, labels, sign, end, self.count, self.leads)
        self.count += len(point)
        self.begun.append(fronts)
        return fronts

    def _enter(self, fronts: Fronts, met: np.ndarray) -> None:
        """Enter the edges whose vertex has been reached."""
        home = fronts.of((met == HOME) & (fronts.labels[:, 1] < self.leads.count))
        self.edges += [(number, -1, -1) for number in home.number.tolist()]
        there = met >= 0
        ends = fronts.of(there)
        four = np.sort(np.append(ends.labels, met[there, None], axis=1), axis=1)
        place = (four < met[there, None]).sum(axis=1)
        rows = zip(
            *(column.tolist() for column in (ends.number, ends.end, four, place, ends.point)), strict=True
        )
        for number, left, labels, omitted, point in rows:
            end = 4 * self._vertex(point, tuple(labels)) + omitted
            if left < 0 or left in self.closed:
                continue
            if end in self.closed:
                self.excess += 1
                continue
            self.closed[left], self.closed[end] = end, left
            self.edges.append((number, left, end))

    def _vertex(self, point: list[float], labels: tuple[int, ...]) -> int:
        """The number of a vertex, new or known."""
        same = self.known.setdefault(labels, [])
        for number in same:
            if (
                max(abs(a - b) for a, b in zip(self.points[number], point, strict=True))
                < 1e-8 * self.leads.size
            ):
                return number
        same.append(len(self.points))
        self.points.append(point)
        self.labels.append(labels)
        return same[-1]

    def _leave(self, first: int) -> Fronts:
        """Fronts along the edges that the vertices from number `first` on end, if not yet followed."""
        point = np.array(self.points[first:]).reshape(-1, 3)
        labels = np.array(self.labels[first:], int).reshape(-1, 4)
        rest = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
        triple, other = labels[:, rest].reshape(-1, 3), labels.ravel()
        end = 4 * first + np.arange(len(other))
        new = np.array([number not in self.closed for number in end.tolist()], bool)
        go = np.flatnonzero((triple[:, 1] < self.leads.count) & new)
        triple, other, point = triple[go], other[go], point[go // 4]
        _, slope = self.leads.over_first(point, np.stack([triple[:, 0], other], axis=1))
        sign = -np.sign((self.leads.tangent(point, triple) * slope[..., 0].T).sum(axis=1))
        return self._begin(point, triple, sign, end[go])

    def _segments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Labels of all fronts; the front and the two points of each segment walked, in order."""
        labels = np.concatenate([fronts.labels for fronts in self.begun])
        front, points = (np.concatenate(part) for part in zip(*self.walked, strict=True))
        order = np.argsort(front, kind="stable")
        return labels, front[order], points[order]

    def covers(self, seeds: Seeds) -> Bool[np.ndarray, " m"]:
        """Whether an edge has been followed past each seed."""
        labels, front, points = self._segments()
        base = self.leads.count + 4
        key, wanted = (rows @ [base**2, base, 1] for rows in (labels[front], seeds.labels))
        order = np.argsort(key)
        first, last = (np.searchsorted(key[order], wanted, side=side) for side in ("left", "right"))
        row, place = ranges(first, last - first)
        start, stop = points[order[place]].transpose(1, 0, 2)
        near = passes(seeds.point[row], start, stop, np.linalg.norm(stop - start, axis=1) / 5)
        return np.bincount(row, near, len(wanted)) > 0

    def finish(self) -> EdgeGraph:
        """The graph traced."""
        leads, n = self.leads, self.leads.count
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
        points, tangents, segment = refine(points, labels[begun[edge, 0]], leads)
        four = np.array(self.labels, int).reshape(-1, 4)
        due = np.array([0, 0, 2, 4, 4])[(four < n).sum(axis=1)]  # triples with at least two cells
        return EdgeGraph(
            n,
            np.array(self.points).reshape(-1, 3),
            four,
            labels[begun[:, 0]],
            begun[:, 1:] // 4,
            edge[segment],
            points,
            tangents,
            int(due.sum()) - len(self.closed) + self.excess,
        )
