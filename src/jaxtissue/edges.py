"""The edges of the diagram, where three labels meet, followed from vertex to vertex.

From each backbone a line along x meets the first wall on either surface; from there edges are followed both
ways to the vertices that end them, and from each new vertex its other edges. Every vertex ends as many edges
as it has triples of labels, every edge has two ends: what is missing shows as an open end.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int
from scipy import sparse

from jaxtissue.candidates import find_candidates, hop_lists
from jaxtissue.leads import TINY, Leads
from jaxtissue.tube import Tube

STEP = 0.3  # longest step, in mean cell widths at the local radius
TURN = 0.97  # cosine of the most that an edge may turn in a step
TOUCH = 1e-11  # in units of R_b + L: nearer is taken as touching
LOOP, LOST = -1, -2


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


class Front(NamedTuple):
    """Points that start along edges, and what they left: 4 vertex + place of the label not on the edge, or
    -1 within an edge."""

    point: Float[np.ndarray, "m 3"]
    labels: Int[np.ndarray, "m 3"]
    sign: Float[np.ndarray, " m"]  # along the edge's tangent, or against it
    end: Int[np.ndarray, " m"]


class Course(NamedTuple):
    """Where fronts came to, the label met there, LOOP or LOST, and the segments (front, its two points)."""

    point: Float[np.ndarray, "m 3"]
    met: Int[np.ndarray, " m"]
    front: Int[np.ndarray, " s"]
    points: Float[np.ndarray, "s 2 3"]


def trace_edges(positions: Float[ArrayLike, "n 2"], tube: Tube) -> EdgeGraph:
    """All edges and vertices of the cells of backbones at (axial, angle) positions, [n, 2], in float64.

    Edges of a part of the diagram that no edge joins to a wall beside a backbone are not seen: closed edges
    within the tissue. Paper, section 4.1.
    """
    place = np.asarray(positions, float)
    graph = _trace(Leads(place, tube, find_candidates(place, tube) if len(place) > 1 else None))
    if graph.open_ends:  # a list lacks a rival that touches its cell between all lines measured
        graph = _trace(Leads(place, tube, hop_lists(touching(graph), place, tube)))
    return graph


def _trace(leads: Leads) -> EdgeGraph:
    graph, front = _Growing(leads), seed(leads)
    while len(front.point):
        front = graph.take(front, follow(front, leads))
    return graph.finish()


def touching(graph: EdgeGraph) -> sparse.csr_array:
    """Who shares an edge or a vertex with whom, as a symmetric [n, n] matrix."""
    pairs = [
        rows[:, [i, j]]
        for rows in (graph.edge_labels, graph.vertex_labels)
        for i, j in combinations(range(rows.shape[1]), 2)
    ]
    first, second = np.concatenate(pairs).T
    real = second < graph.cells
    pair = np.concatenate([[first[real], second[real]], [second[real], first[real]]], axis=1)
    shape = (graph.cells, graph.cells)
    return sparse.coo_array((np.ones(pair.shape[1], bool), pair), shape=shape).tocsr()


def seed(leads: Leads) -> Front:
    """Where each backbone's end, moved along x on either surface, meets a wall or an end: there both ways."""
    n, fronts = leads.count, []
    own, surface = np.tile(np.arange(n), 2), np.repeat([0, 1], n)
    radius = np.array([leads.inner, leads.outer])[surface]
    place = np.concatenate([leads.axial[own, None], radius[:, None] * leads.direction[own]], axis=1)
    lead, slope = leads.over_first(place, np.append(own[:, None], leads.rivals[own], axis=1))
    for side in (-1, 1):
        toward = side * slope[..., 0]
        away = np.where(toward > 0, -lead / np.where(toward > 0, toward, 1), np.inf)
        other = leads.rivals[own, away.argmin(axis=1)]
        point = place.copy()
        point[:, 0] = np.clip(place[:, 0] + side * away.min(axis=1), 0, leads.length)
        met = (point[:, 0] > 0) & (point[:, 0] < leads.length)
        walls = np.stack([*np.sort([own, other], axis=0), n + surface], axis=1)
        rims = np.stack([own, n + surface, np.full(2 * n, n + 2 + (side > 0))], axis=1)
        labels = np.where(met[:, None], walls, rims)
        fronts += [(point, labels, np.full(2 * n, sign)) for sign in (-1.0, 1.0)]
    point, labels, sign = (np.concatenate(part) for part in zip(*fronts, strict=True))
    return Front(point, labels, sign, np.full(len(point), -1))


def follow(front: Front, leads: Leads) -> Course:
    """Follow every front to the vertex that ends its edge, or back to where it began."""
    count, width = len(front.point), STEP * np.sqrt(2 * np.pi * leads.length / leads.count)
    point, met = front.point.copy(), np.full(count, LOST)
    ahead = front.sign[:, None] * leads.tangent(point, front.labels)
    safe = leads.foremost(point, front.labels, ahead)[2]
    asked, gone = np.full(count, np.inf), np.zeros(count)
    done = [(np.zeros(0, int), np.zeros((0, 2, 3)))]
    active = np.arange(count)
    while len(active):
        old, labels, sign = point[active], front.labels[active], front.sign[active]
        longest = np.minimum(asked[active], width * np.sqrt(np.hypot(old[:, 1], old[:, 2])))
        step = np.minimum(longest, np.maximum(safe[active], longest / 20))
        new, turned, onward, rival = advance(old, labels, sign, ahead[active], step, leads)
        good = rival != LOST
        home = (front.end[active] < 0) & (gone[active] > 3 * step) & good
        home &= passes(front.point[active], old, new, step / 5)
        new[home] = front.point[active[home]]
        done.append((active[good], np.stack([old, new], axis=1)[good]))
        moved = active[good]
        point[moved], ahead[moved], safe[moved] = new[good], turned[good], onward[good]
        gone[moved] += step[good]
        asked[active] = np.where(good, 2 * longest, step / 4)
        met[active] = np.where(home, LOOP, np.where(good & (rival >= 0), rival, LOST))
        active = active[(met[active] == LOST) & (asked[active] > TOUCH * leads.size)]
    which, points = (np.concatenate(part) for part in zip(*done, strict=True))
    return Course(point, met, which, points)


def passes(target: np.ndarray, start: np.ndarray, stop: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Whether a target lies beside the way from start to stop."""
    way, off = stop - start, target - start
    share = (off * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), TINY)
    return (share > 0) & (share <= 1) & (np.linalg.norm(off - share[:, None] * way, axis=1) < within)


def advance(
    start: np.ndarray, labels: np.ndarray, sign: np.ndarray, ahead: np.ndarray, step: np.ndarray, leads: Leads
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One step along edges: the new points, tangents, safe lengths, and who is met: LOOP nobody yet, LOST the
    step was too long. Whoever leads at the new point ends the edge before it, at the vertex with them."""
    near = TOUCH * leads.size
    point, error = leads.solve(start + step[:, None] * ahead, labels, 4)
    met = np.where(error < near, LOOP, LOST)
    point = np.where(error[:, None] < near, point, start)
    turned = sign[:, None] * leads.tangent(point, labels)
    met[(turned * ahead).sum(axis=1) < TURN] = LOST
    rival, beyond, safe = leads.foremost(point, labels, turned)
    open_ = np.flatnonzero((met == LOOP) & (beyond > near))
    for _ in range(8):  # each vertex lies before the last, until nobody leads there
        met[open_] = rival[open_]
        four = np.append(labels[open_], met[open_, None], axis=1)
        point[open_], error = leads.solve(point[open_], four, 8)
        failed = ~(error < near)
        met[open_[failed]], open_, four = LOST, open_[~failed], four[~failed]
        rival[open_], beyond[open_], _ = leads.foremost(point[open_], four, turned[open_])
        open_ = open_[beyond[open_] > near]
        if not len(open_):
            break
    met[open_] = LOST
    point = np.where(met[:, None] == LOST, start, point)
    ends = np.flatnonzero(met >= 0)
    turned[ends] = sign[ends, None] * leads.tangent(point[ends], labels[ends])
    _, slope = leads.over_first(point[ends], np.stack([labels[ends, 0], met[ends]], axis=1))
    leaving = (slope[:, 0] * turned[ends]).sum(axis=1) <= 0  # a vertex that begins the edge, not ends it
    moved = ((point - start) * ahead).sum(axis=1)
    bad = (moved < -near) | (moved > 2 * step) | ((turned * ahead).sum(axis=1) < TURN)
    met[bad], met[ends[leaving]] = LOST, LOST
    return point, turned, safe, met


class _Growing:
    """The graph while it is traced."""

    def __init__(self, leads: Leads) -> None:
        self.leads = leads
        self.points: list[np.ndarray] = []
        self.labels: list[list[int]] = []
        self.known: dict[tuple[int, ...], list[int]] = {}
        self.started: set[int] = set()
        self.edges: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = {}  # ends, or labels of a loop

    def vertex(self, point: np.ndarray, labels: list[int]) -> int:
        """The number of a vertex, new or known."""
        same = self.known.setdefault(tuple(labels), [])
        for number in same:
            if np.abs(self.points[number] - point).max() < 1e-8 * self.leads.size:
                return number
        same.append(len(self.points))
        self.points.append(point)
        self.labels.append(labels)
        return same[-1]

    def take(self, front: Front, course: Course) -> Front:
        """Enter the edges that were followed; the fronts that leave the new vertices."""
        known, order = len(self.points), np.argsort(course.front, kind="stable")
        last = np.cumsum(np.bincount(course.front, minlength=len(course.met)))
        ways = np.split(course.points[order], last[:-1])
        of_tube = front.labels[:, 1] >= self.leads.count
        for i in np.flatnonzero((course.met != LOST) & ~(of_tube & (course.met == LOOP))):
            key = tuple(front.labels[i].tolist())
            if course.met[i] != LOOP:
                four = sorted([*key, int(course.met[i])])
                end = 4 * self.vertex(course.point[i], four) + four.index(int(course.met[i]))
                if front.end[i] < 0:
                    continue
                self.started.add(end)
                key = tuple(sorted((int(front.end[i]), end)))
            forward = int(front.sign[i])
            self.edges.setdefault(key, (front.labels[i], ways[i][::forward, ::forward]))
        return self.leave(known)

    def leave(self, first: int) -> Front:
        """Fronts along the edges that the vertices from number `first` on end, if not yet followed."""
        point = np.array(self.points[first:]).reshape(-1, 3)
        labels = np.array(self.labels[first:], int).reshape(-1, 4)
        parts = []
        for place in range(4):
            triple, other = np.delete(labels, place, axis=1), labels[:, place]
            end = 4 * (first + np.arange(len(labels))) + place
            _, slope = self.leads.over_first(point, np.stack([triple[:, 0], other], axis=1))
            sign = -np.sign((self.leads.tangent(point, triple) * slope[:, 0]).sum(axis=1))
            new = np.array([number not in self.started for number in end.tolist()], bool)
            go = (triple[:, 1] < self.leads.count) & new
            parts.append((point[go], triple[go], sign[go], end[go]))
        front = Front(*(np.concatenate(part) for part in zip(*parts, strict=True)))
        self.started |= set(front.end.tolist())
        return front

    def finish(self) -> EdgeGraph:
        """The graph traced."""
        leads, entries = self.leads, list(self.edges.items())
        labels = np.array([edge for _, (edge, _) in entries], int).reshape(-1, 3)
        ends = np.array([key if len(key) == 2 else (-1, -1) for key, _ in entries], int).reshape(-1, 2)
        ways = [way for _, (_, way) in entries]
        segment = np.repeat(np.arange(len(ways)), [len(way) for way in ways])
        points = np.concatenate([np.zeros((0, 2, 3)), *ways])
        tangents = leads.tangent(points.reshape(-1, 3), np.repeat(labels[segment], 2, axis=0)).reshape(
            -1, 2, 3
        )
        four = np.array(self.labels, int).reshape(-1, 4)
        real = (four < leads.count).sum(axis=1)
        due = (real == 4) * 4 + (real == 3) * 4 + (real == 2) * 2  # triples with at least two cells
        open_ends = int(due.sum()) - len(np.unique(ends[ends >= 0]))
        vertices = np.array(self.points).reshape(-1, 3)
        return EdgeGraph(leads.count, vertices, four, labels, ends // 4, segment, points, tangents, open_ends)
