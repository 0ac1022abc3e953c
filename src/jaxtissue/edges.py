"""The edges of the diagram, where three cells meet, followed from end to end: who meets whom, exactly.

With the foot of cell j at radius max(h, R_a), h = y cos t_j + z sin t_j, its squared distance is
d_j^2 = |p|^2 - 2 x x_j + x_j^2 - c(h), where c(h) = h^2 above R_a and 2 R_a h - R_a^2 below. So the *lead* of
j over a, d_a^2 - d_j^2, is smooth (C1) and its gradient is 2 (q_j - q_a), q the feet. The four bounds of the
tissue count as four more cells, whose leads are R_a^2 - r^2, r^2 - R_b^2, -x and x - L. Then an edge is where
three labels lead equally, a vertex where four do, every vertex ends four edges and every edge has two ends:
what is missing shows. All in float64.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from jaxtissue.candidates import find_candidates
from jaxtissue.tube import Tube

BOUNDS = 4  # labels n .. n + 3: apical, basal, x = 0, x = L
TURN = 0.97  # cosine of the most that an edge may turn in a step
STEP = 0.3  # largest step, in mean cell widths at the local radius
TOUCH = 1e-11  # in units of R_b + L: nearer is taken as touching


class Front(NamedTuple):
    """Points that run along edges: label rows sorted, cells before bounds."""

    point: Float[np.ndarray, "m 3"]
    labels: Int[np.ndarray, "m 3"]
    sign: Float[np.ndarray, " m"]  # along grad lead_1 x grad lead_2, or against it
    start: Int[np.ndarray, " m"]  # the end it left, 4 vertex + place of the missing label; -1 for a seed


class Segments(NamedTuple):
    """Short pieces of edges with unit tangents, all along grad lead_1 x grad lead_2 of the edge's labels."""

    edge: Int[np.ndarray, " s"]
    point: Float[np.ndarray, "s 2 3"]
    tangent: Float[np.ndarray, "s 2 3"]


class EdgeGraph(NamedTuple):
    """Vertices and edges of a tissue by their labels: cells, then n + 0 .. 3 the apical and basal surface and
    the ends x = 0 and x = L. Edges hold at least two cells."""

    cells: int
    vertices: Float[np.ndarray, "v 3"]
    vertex_labels: Int[np.ndarray, "v 4"]
    edge_labels: Int[np.ndarray, "e 3"]
    edge_vertices: Int[np.ndarray, "e 2"]  # -1 for a loop
    segments: Segments
    open_ends: int  # ends of edges at a vertex that lead nowhere: 0 unless the tissue is degenerate


class Leads:
    """Leads of labels over a cell, at points."""

    def __init__(self, positions: ArrayLike, tube: Tube) -> None:
        axial, angle = np.pad(np.asarray(positions, float).T, ((0, 0), (0, BOUNDS)))
        self.count = len(axial) - BOUNDS
        self.axial, self.direction = axial, np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.inner, self.outer = float(tube.apical_radius), float(tube.basal_radius)
        self.length = float(tube.length)
        self.size = self.outer + self.length

    def along(self, point: np.ndarray, own: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Leads [..., k] of `labels` over `own` [...] and their gradients [..., k, 3] at `point` [..., 3]."""
        point, own = point[..., None, :], own[..., None]
        height, foot = [], []
        for label in (labels, own):
            height.append((point[..., 1:] * self.direction[label]).sum(axis=-1))
            foot.append(np.maximum(height[-1], self.inner))
        # c(h) = s (2 h - s), so c(h_j) - c(h_a) loses no digits where the cells are close
        gap = self.axial[labels] - self.axial[own]
        capped = (foot[0] - foot[1]) * (2 * height[1] - foot[0] - foot[1]) + 2 * foot[0] * self._turn(
            point, labels, own
        )
        lead = gap * (2 * point[..., 0] - self.axial[labels] - self.axial[own]) + capped
        across = foot[0][..., None] * self.direction[labels] - foot[1][..., None] * self.direction[own]
        slope = 2 * np.concatenate([gap[..., None], across], axis=-1)
        for bound in range(BOUNDS):
            here = labels == self.count + bound
            if here.any():
                lead_b, slope_b = self._bound(bound, np.broadcast_to(point, slope.shape)[here])
                lead[here], slope[here] = lead_b, slope_b
        return lead, slope

    def _turn(self, point: np.ndarray, labels: np.ndarray, own: np.ndarray) -> np.ndarray:
        return (point[..., 1:] * (self.direction[labels] - self.direction[own])).sum(axis=-1)

    def _bound(self, bound: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if bound < 2:
            outward = (-1.0, 1.0)[bound]
            radius = (self.inner, self.outer)[bound]
            square = point[:, 1] ** 2 + point[:, 2] ** 2 - radius**2
            return outward * square, outward * 2 * point * [0, 1, 1]
        outward = (-1.0, 1.0)[bound - 2]
        place = (0.0, self.length)[bound - 2]
        return outward * (point[:, 0] - place), np.broadcast_to([outward, 0.0, 0.0], point.shape)

    def tangent(self, point: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """Unit tangents grad lead_1 x grad lead_2 of edges."""
        slope = self.along(point, labels[:, 0], labels[:, 1:])[1]
        cross = np.cross(slope[:, 0], slope[:, 1])
        return cross / np.maximum(np.linalg.norm(cross, axis=-1, keepdims=True), 1e-300)

    def solve(self, point: np.ndarray, labels: np.ndarray, turns: int) -> tuple[np.ndarray, np.ndarray]:
        """Newton to where all labels lead equally, nearest point for three; and the size of the last step."""
        step = np.zeros_like(point)
        for _ in range(turns):
            lead, slope = self.along(point, labels[:, 0], labels[:, 1:])
            norm = np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-300)
            rows, side = slope / norm, lead[..., None] / norm
            if rows.shape[1] == 2:
                rows = np.append(rows, np.cross(rows[:, :1], rows[:, 1:]), axis=1)
                side = np.append(side, np.zeros_like(side[:, :1]), axis=1)
            regular = np.abs(np.linalg.det(rows)) > 1e-12
            step = np.full_like(point, np.inf)
            step[regular] = np.linalg.solve(rows[regular], side[regular])[..., 0]
            point = point - np.where(np.abs(step) < self.size, step, 0)
        return point, np.abs(step).max(axis=-1, initial=0)


class Tracer:
    """Follows edges of one tissue from vertex to vertex."""

    def __init__(self, positions: ArrayLike, tube: Tube) -> None:
        self.leads = Leads(positions, tube)
        n = self.leads.count
        lists = find_candidates(np.asarray(positions), tube) if n > 1 else np.zeros((n, 1), int)
        bounds = np.broadcast_to(n + np.arange(BOUNDS), (n, BOUNDS))
        self.rivals = np.concatenate([lists, bounds], axis=1)
        self.width = np.sqrt(2 * np.pi * self.leads.length / n)

    def nearness(self, point: np.ndarray, labels: np.ndarray, ahead: np.ndarray) -> tuple[np.ndarray, ...]:
        """Every rival's label, its distance over the wall to it (negative: not yet), and its rate of approach."""
        rivals = self.rivals[labels[:, 0]]
        lead, slope = self.leads.along(point, labels[:, 0], rivals)
        norm = np.maximum(np.linalg.norm(slope, axis=-1), 1e-300)
        member = (rivals[..., None] == labels[:, None]).any(axis=-1)
        over = np.where(member, -np.inf, lead / norm)
        return rivals, over, np.einsum("mkj,mj->mk", slope, ahead) / norm

    def seeds(self) -> Front:
        """Where each cell's backbone, shifted along x on either surface, meets another cell: both ways."""
        leads, n = self.leads, self.leads.count
        own = np.tile(np.arange(n), 2)
        radius = np.repeat([leads.inner, leads.outer], n)
        point = np.concatenate([leads.axial[own, None], radius[:, None] * leads.direction[own]], axis=1)
        rivals = self.rivals[own, :-BOUNDS]
        lead, slope = leads.along(point, own, rivals)
        fronts = []
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(rivals == own[:, None], np.nan, -lead / slope[..., 0])
        for side in (-1, 1):
            far = np.where(side * reach > 0, side * reach, np.inf)
            first = far.argmin(axis=1)
            seed = point.copy()
            seed[:, 0] += side * far.min(axis=1)
            met = (seed[:, 0] > 0) & (seed[:, 0] < leads.length)
            other = rivals[np.arange(2 * n), first]
            labels = np.stack([*np.sort([own, other], axis=0), n + (np.arange(2 * n) >= n)], axis=1)
            fronts += [(seed[met], labels[met], np.full(met.sum(), sign)) for sign in (-1.0, 1.0)]
        point, labels, sign = (np.concatenate(part) for part in zip(*fronts, strict=True))
        return Front(point, labels, sign, np.full(len(point), -1))

    def advance(self, front: Front, step: np.ndarray) -> tuple[np.ndarray, ...]:
        """One step: the new points, whether it went well, and the label met there, or -1.

        A step ends where the edge has not turned much; if a rival is nearer there, at the vertex with it.
        """
        leads, labels = self.leads, front.labels
        ahead = front.sign[:, None] * leads.tangent(front.point, labels)
        _, over, rate = self.nearness(front.point, labels, ahead)
        # 0.2 for the bending of edge and walls within a step; 1.5 to pass a wall that is met head-on
        safe = np.where(rate > -0.2, 1.5 * np.maximum(-over, 0) / (np.maximum(rate, 0) + 0.2), np.inf)
        step = np.minimum(step, np.maximum(safe.min(axis=1), 0.05 * step))
        point, error = leads.solve(front.point + step[:, None] * ahead, labels, 4)
        turned = front.sign[:, None] * leads.tangent(point, labels)
        good = (error < TOUCH * leads.size) & ((turned * ahead).sum(axis=1) > TURN)
        moved = ((point - front.point) * ahead).sum(axis=1)
        good &= (moved > 0) & (moved < 2 * step)
        met = np.full(len(labels), -1)
        pending = good.copy()
        for _ in range(8):
            some = np.flatnonzero(pending)
            rivals, over, rate = self.nearness(point[some], labels[some], turned[some])
            nearer = np.where(rivals == met[some, None], -np.inf, over)
            worst = nearer.argmax(axis=1)
            beyond = nearer[np.arange(len(some)), worst] > TOUCH * leads.size
            pending[some[~beyond]] = False
            some, rival = some[beyond], rivals[np.arange(len(some)), worst][beyond]
            if not len(some):
                break
            met[some] = rival
            four = np.concatenate([labels[some], rival[:, None]], axis=1)
            point[some], error = leads.solve(point[some], four, 8)
            ends = (error < TOUCH * leads.size) & np.isfinite(point[some]).all(axis=1)
            good[some] &= ends
            pending[some] &= ends
        good &= ~pending
        last = front.sign[:, None] * leads.tangent(point, labels)
        moved = ((point - front.point) * ahead).sum(axis=1)
        good &= (moved > -TOUCH * leads.size) & (moved < 2 * step) & ((last * ahead).sum(axis=1) > TURN)
        _, slope = leads.along(point, labels[:, 0], np.maximum(met, 0)[:, None])
        good &= (met < 0) | ((slope[:, 0] * last).sum(axis=1) > 0)
        return point, good, met, step

    def follow(self, front: Front) -> "Course":
        """Follow every front to the vertex that ends its edge, or once round its loop."""
        leads, count = self.leads, len(front.point)
        point, met = front.point.copy(), np.full(count, LOST)
        step, gone = np.full(count, np.inf), np.zeros(count)
        parts = [(np.zeros(0, int), np.zeros((0, 2, 3)))]
        active = np.arange(count)
        while len(active):
            some = front._replace(point=point[active], labels=front.labels[active], sign=front.sign[active])
            cap = STEP * self.width * np.sqrt(np.hypot(*some.point[:, 1:].T))
            asked = np.minimum(step[active], cap)
            end, good, rival, tried = self.advance(some, asked)
            round_again = good & (front.start[active] < 0) & (gone[active] > 3 * tried)
            home = front.point[active] - some.point
            along = (home * (end - some.point)).sum(axis=1) / np.maximum(
                ((end - some.point) ** 2).sum(axis=1), 1e-300
            )
            off = np.linalg.norm(home - along[:, None] * (end - some.point), axis=1)
            round_again &= (along >= 0) & (along < 1) & (off < 0.2 * tried)
            end = np.where(round_again[:, None], front.point[active], end)
            parts.append((active[good], np.stack([some.point, end], axis=1)[good]))
            gone[active] += np.where(good, tried, 0)
            point[active] = np.where(good[:, None], end, some.point)
            step[active] = np.where(good, 2 * asked, tried / 4)
            met[active] = np.where(round_again, LOOP, np.where(good & (rival >= 0), rival, LOST))
            active = active[(met[active] == LOST) & (step[active] > TOUCH * leads.size)]
        which, pieces = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Course(point, met, which, pieces)


class Course(NamedTuple):
    """Where fronts came to: the point, the label met there (LOOP for a closed edge), and the way there."""

    point: np.ndarray
    met: np.ndarray
    front: np.ndarray
    pieces: np.ndarray


LOOP, LOST = -1, -2


class Vertices:
    """The vertices found so far, by labels, handedness and place."""

    def __init__(self, tolerance: float) -> None:
        self.points: list[np.ndarray] = []
        self.labels: list[tuple[int, ...]] = []
        self.known: dict[tuple[int, ...], list[int]] = {}
        self.tolerance = tolerance

    def enter(self, point: np.ndarray, labels: np.ndarray) -> int:
        key = tuple(labels.tolist())
        for vertex in self.known.get(key, []):
            if np.abs(self.points[vertex] - point).max() < self.tolerance:
                return vertex
        self.points.append(point)
        self.labels.append(key)
        self.known.setdefault(key, []).append(len(self.points) - 1)
        return len(self.points) - 1


def trace_edges(positions: ArrayLike, tube: Tube) -> EdgeGraph:
    """All edges of the diagram that can be reached from the backbones along edges."""
    tracer = Tracer(positions, tube)
    n, vertices = tracer.leads.count, Vertices(1e-8 * tracer.leads.size)
    front = tracer.seeds()
    ends: dict[tuple[int, int], tuple] = {}
    started: set[int] = set()
    loops: dict[tuple, tuple] = {}
    lost = 0
    while len(front.point):
        course = tracer.follow(front)
        order = np.argsort(course.front, kind="stable")
        bounds = np.searchsorted(course.front[order], np.arange(len(front.point) + 1))
        fresh: list[tuple] = []
        lost += int(((course.met == LOST) & (front.start >= 0)).sum())
        reached = np.flatnonzero(course.met >= 0)
        four = np.sort(np.concatenate([front.labels, course.met[:, None]], axis=1), axis=1)
        known = len(vertices.points)
        for i in reached:
            vertex = vertices.enter(course.point[i], four[i])
            place = int((four[i] == course.met[i]).argmax())
            if front.start[i] >= 0:
                end = 4 * vertex + place
                key = (min(end, int(front.start[i])), max(end, int(front.start[i])))
                started.add(end)
                ends.setdefault(key, (i, front, course.pieces[order[bounds[i] : bounds[i + 1]]]))
        for i in np.flatnonzero(course.met == LOOP):
            loops.setdefault(
                tuple(front.labels[i]), (i, front, course.pieces[order[bounds[i] : bounds[i + 1]]])
            )
        # depart from every end of the new vertices
        points = np.array(vertices.points[known:]).reshape(-1, 3)
        labels = np.array(vertices.labels[known:], int).reshape(-1, 4)
        rows = []
        for place in range(4):
            triple, other = np.delete(labels, place, axis=1), labels[:, place]
            end = 4 * (known + np.arange(len(labels))) + place
            _, slope = tracer.leads.along(points, triple[:, 0], other[:, None])
            sign = -np.sign((tracer.leads.tangent(points, triple) * slope[:, 0]).sum(axis=1))
            go = (triple[:, 1] < n) & ~np.isin(end, list(started))
            rows.append((points[go], triple[go], sign[go], end[go]))
        front = Front(*(np.concatenate(part) for part in zip(*rows, strict=True)))
        started |= set(front.start.tolist())
    return ends, vertices, loops, lost
