"""Points that follow the edges of the diagram step by step to the vertices at which these end."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.system.cores import cut, in_threads
from jaxtissue.topology.bisectors import TIE, TINY, TOUCH, Bisectors

STEP = 0.6  # longest step, in mean cell widths at the local radius
NEAR = 0.5  # most that a step goes across the axis, in distances from it: edges bend near the lumen
TURN = 0.4  # longest step, in radii of curvature
BENT = 0.85  # cosine of the most that an edge may turn in a step
FINE = 0.3  # most that edges turn, in radians, in the segments that are kept
STRAY = 3e-4  # of its length: most by which an edge leaves the cubic through the ends of a segment
BENDS = 6  # steps to where a foot leaves its backbone's end
MET = 1e-5  # of a segment: the last of them at most, or it is not parted there
ENOUGH = 1e-7  # of a step: Newton's next step is its square
CROWD = 512  # fronts worth a thread
RUNNING, CLOSED, FAILED = -1, -2, -3  # no label met yet; back where the front began; the step was too long


class Fronts(NamedTuple):
    """Points on edges, their directions, and their ends.

    An end is 4 vertex + place of the label not on the edge, or -1 within an edge.
    """

    number: Int[np.ndarray, " m"]
    end: Int[np.ndarray, " m"]
    labels: Int[np.ndarray, "m 3"]
    sign: Float[np.ndarray, " m"]  # along the edge's tangent, or against it
    start: Float[np.ndarray, "m 3"]
    point: Float[np.ndarray, "m 3"]
    ahead: Float[np.ndarray, "m 3"]
    turn: Float[np.ndarray, "m 3"]  # derivative of ahead
    longest: Float[np.ndarray, " m"]  # step
    safe: Float[np.ndarray, " m"]  # step that crosses no wall unseen
    gone: Float[np.ndarray, " m"]

    def of(self, chosen: np.ndarray | slice) -> "Fronts":
        """The chosen fronts, by mask or place."""
        return Fronts(*(column[chosen] for column in self))

    @staticmethod
    def of_all(parts: Sequence["Fronts"]) -> "Fronts":
        """All fronts of the parts."""
        return Fronts(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def begin(
    point: Float[np.ndarray, "m 3"],
    labels: Int[np.ndarray, "m 3"],
    sign: Float[np.ndarray, " m"],
    end: Int[np.ndarray, " m"],
    number: int,
    bisectors: Bisectors,
) -> Fronts:
    """Fronts that start at points, numbered from `number` on."""
    ahead, turn = bisectors.curve(point, labels)
    ahead, longest = sign[:, None] * ahead, widest(point, ahead, turn, bisectors)
    looks = in_threads(
        lambda some: bisectors.look(point[some], labels[some], ahead[some], turn[some], longest[some])[2],
        cut(len(point), CROWD),
    )
    safe = np.concatenate(looks)
    numbers = number + np.arange(len(point))
    return Fronts(numbers, end, labels, sign, point, point, ahead, turn, longest, safe, np.zeros(len(point)))


def widest(
    point: Float[np.ndarray, "m 3"],
    ahead: Float[np.ndarray, "m 3"],
    turn: Float[np.ndarray, "m 3"],
    bisectors: Bisectors,
) -> np.ndarray:
    """The longest step allowed at points of edges of given tangents and curvature."""
    radius, across = np.hypot(point[:, 1], point[:, 2]), np.hypot(ahead[:, 1], ahead[:, 2])
    width = np.sqrt(2 * np.pi * bisectors.length / bisectors.count * radius)
    bend = np.maximum(np.sqrt((turn**2).sum(axis=1)), TINY)
    near = 2 * NEAR * radius  # across s + bend s^2 / 2 = near / 2
    near /= across + np.sqrt(across**2 + bend * near)
    return np.minimum(np.minimum(STEP * width, near), TURN / bend) / bisectors.care


def step(fronts: Fronts, bisectors: Bisectors) -> tuple[Fronts, Int[np.ndarray, " m"]]:
    """One step of every front, and the label that it met, or GOING, HOME, or LOST: to be tried shorter."""
    old, longest = fronts.point, fronts.longest
    size = np.minimum(longest, np.maximum(fronts.safe, longest / 20))
    parts = in_threads(lambda some: advance(fronts.of(some), size[some], bisectors), cut(len(old), CROWD))
    moved, met = Fronts.of_all([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    good = met != FAILED
    home = (fronts.end < 0) & (fronts.gone > 3 * size) & good
    home &= passes(fronts.start, old, moved.point, size / 5)
    moved.point[home], met[home] = fronts.start[home], CLOSED
    moved = Fronts(
        *(np.where(good if new.ndim == 1 else good[:, None], new, was) for new, was in zip(moved, fronts, strict=True))
    )
    moved.longest[~good] = size[~good] / 4
    return moved, met


def passes(target: np.ndarray, start: np.ndarray, stop: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Whether a target lies beside the way from start to stop."""
    way, off = stop - start, target - start
    share = (off * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), TINY)
    return (share > 0) & (share <= 1) & (np.linalg.norm(off - share[:, None] * way, axis=1) < within)


def advance(fronts: Fronts, size: np.ndarray, bisectors: Bisectors) -> tuple[Fronts, np.ndarray]:
    """The fronts a step on, and the labels that they met.

    A label that leads at the new point ends the edge before it, at the vertex with it.
    """
    near, tie, start, labels = TOUCH * bisectors.size, TIE * bisectors.size, fronts.point, fronts.labels
    far = size[:, None]
    guess = start + far * fronts.ahead + far**2 / 2 * fronts.turn
    point, found = bisectors.solve(guess, labels, np.maximum(ENOUGH * size, near))
    met = np.where(found, RUNNING, FAILED)
    point[~found] = start[~found]
    ahead, turn = bisectors.curve(point, labels)
    ahead *= fronts.sign[:, None]
    reach = widest(point, ahead, turn, bisectors)
    rival, beyond, safe = bisectors.look(point, labels, ahead, turn, reach)
    open_ = np.flatnonzero((met == RUNNING) & (beyond > tie))
    for _ in range(8):  # each vertex lies before the last, until no label leads there
        met[open_] = rival[open_]
        four = np.append(labels[open_], met[open_, None], axis=1)
        point[open_], found = bisectors.solve(point[open_], four, np.full(len(open_), near))
        met[open_[~found]], open_, four = FAILED, open_[found], four[found]
        rival[open_], beyond[open_] = bisectors.nearest_competitor(point[open_], four)
        open_ = open_[beyond[open_] > tie]
        if not len(open_):
            break
    met[open_] = FAILED
    point = np.where(met[:, None] == FAILED, start, point)
    ends = np.flatnonzero(met >= 0)
    ahead[ends] = fronts.sign[ends, None] * bisectors.tangent(point[ends], labels[ends])
    _, slope = bisectors.over_first(point[ends], np.stack([labels[ends, 0], met[ends]], axis=1))
    leaving = (slope[..., 0].T * ahead[ends]).sum(axis=1) <= 0  # a vertex that begins the edge, not ends it
    moved = ((point - start) * fronts.ahead).sum(axis=1)
    bad = (moved < -near) | (moved > 2 * size) | ((ahead * fronts.ahead).sum(axis=1) < BENT)
    bad |= (met == RUNNING) & (moved < size / 8)  # brought back to where it was, it would stand there forever
    met[bad], met[ends[leaving]] = FAILED, FAILED
    moved = fronts._replace(
        point=point, ahead=ahead, turn=turn, longest=np.minimum(4 * fronts.longest, reach), safe=safe
    )
    return moved._replace(gone=fronts.gone + size), met


class Segments(NamedTuple):
    """Pieces of edges: their ends and unit tangents, and which of the segments given each is of."""

    points: Float[np.ndarray, "s 2 3"]
    tangents: Float[np.ndarray, "s 2 3"]
    segment: Int[np.ndarray, " s"]

    def split(self, chosen: np.ndarray, middle: np.ndarray, along: np.ndarray) -> "Segments":
        """The chosen segments parted at points of given tangents; the second parts come last."""
        points, tangents = (
            np.concatenate([ends, np.stack([cut, ends[chosen, 1]], axis=1)])
            for ends, cut in ((self.points, middle), (self.tangents, along))
        )
        points[chosen, 1], tangents[chosen, 1] = middle, along
        return Segments(points, tangents, np.append(self.segment, self.segment[chosen]))


def refine_all(points: Float[np.ndarray, "s 2 3"], labels: Int[np.ndarray, "s 3"], bisectors: Bisectors) -> Segments:
    """As `refine`, in threads."""
    slices = cut(len(points), CROWD)
    parts = in_threads(lambda some: refine(points[some], labels[some], bisectors), slices)
    numbered = [part.segment + some.start for part, some in zip(parts, slices, strict=True)]
    ends, ways = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return Segments(ends, ways, np.concatenate(numbered))


def refine(points: Float[np.ndarray, "s 2 3"], labels: Int[np.ndarray, "s 3"], bisectors: Bisectors) -> Segments:
    """Segments of edges parted where a foot leaves its backbone's apical end, since edges bend there.

    They are halved until they hardly turn and follow the cubic through their ends.
    """
    tangents = bisectors.tangent(points.reshape(-1, 3), np.repeat(labels, 2, axis=0)).reshape(-1, 2, 3)
    parts = Segments(points, tangents, np.arange(len(points)))
    for place in range(3):
        parts = _part_at_bends(parts, labels[parts.segment], place, bisectors)
    new = np.arange(len(parts.points))
    for _ in range(6):
        ends, ways = parts.points[new], parts.tangents[new]
        turn, chord = ways[:, 0] - ways[:, 1], np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        guess = ends.mean(axis=1) + chord[:, None] / 8 * turn
        middle, found = bisectors.solve(guess, labels[parts.segment[new]], ENOUGH * chord)
        stray = np.linalg.norm(middle - guess, axis=1) > STRAY * chord
        split = found & (stray | ((turn**2).sum(axis=1) > FINE**2))
        bent, middle = new[split], middle[split]
        count = len(parts.points)
        parts = parts.split(bent, middle, bisectors.tangent(middle, labels[parts.segment[bent]]))
        new = np.append(bent, np.arange(count, len(parts.points)))
    order = np.argsort(parts.segment, kind="stable")
    return Segments(*(column[order] for column in parts))


def _part_at_bends(parts: Segments, labels: Int[np.ndarray, "s 3"], place: int, bisectors: Bisectors) -> Segments:
    """Segments parted where the foot on the backbone of one of their labels leaves its apical end."""
    own = labels[:, place]
    way = np.stack([bisectors.cosine[own], bisectors.sine[own]], axis=1)
    above = (parts.points[..., 1:] * way[:, None]).sum(axis=-1) - bisectors.inner
    bent = np.flatnonzero((own < bisectors.count) & (above.prod(axis=1) < 0))
    ends, three, way, above = parts.points[bent], labels[bent], way[bent], above[bent]
    share = (above[:, 0] / (above[:, 0] - above[:, 1]))[:, None]
    middle = (1 - share) * ends[:, 0] + share * ends[:, 1]
    chord = ends[:, 1] - ends[:, 0]
    width, good = np.linalg.norm(chord, axis=1), np.ones(len(bent), bool)
    along, shift = np.zeros_like(middle), np.zeros(len(bent))
    for _ in range(BENDS):
        middle, found = bisectors.solve(middle, three, ENOUGH * width)
        along = bisectors.tangent(middle, three)
        rate = (along[:, 1:] * way).sum(axis=1)
        miss = (middle[:, 1:] * way).sum(axis=1) - bisectors.inner
        good &= found & (np.abs(rate) > TINY)
        shift = miss / np.where(good, rate, np.inf)
        middle = middle - shift[:, None] * along
    good &= np.abs(shift) < MET * width
    share = ((middle - ends[:, 0]) * chord).sum(axis=1) / (chord**2).sum(axis=1)
    good &= (share > ENOUGH) & (share < 1 - ENOUGH)
    return parts.split(bent[good], middle[good], along[good])
