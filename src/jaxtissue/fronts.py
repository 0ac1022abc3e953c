"""Points that move along the diagram's edges, step by step, each to the vertex that ends its edge."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.leads import TINY, TOUCH, Leads

STEP = 0.3  # longest step, in mean cell widths at the local radius
TURN = 0.97  # cosine of the most that an edge may turn in a step
GOING, HOME, LOST = -1, -2, -3  # nobody met yet; back where the front began; the step was too long


class Fronts(NamedTuple):
    """Points on edges, where they go, and what they left: 4 vertex + place of the label not on the edge, or
    -1 within an edge."""

    number: Int[np.ndarray, " m"]
    end: Int[np.ndarray, " m"]
    labels: Int[np.ndarray, "m 3"]
    sign: Float[np.ndarray, " m"]  # along the edge's tangent, or against it
    start: Float[np.ndarray, "m 3"]
    point: Float[np.ndarray, "m 3"]
    ahead: Float[np.ndarray, "m 3"]
    longest: Float[np.ndarray, " m"]  # step
    safe: Float[np.ndarray, " m"]  # step that crosses no wall unseen
    gone: Float[np.ndarray, " m"]

    def of(self, chosen: np.ndarray) -> "Fronts":
        """Some of the fronts, by mask or place."""
        return Fronts(*(column[chosen] for column in self))

    def join(self, other: "Fronts") -> "Fronts":
        """These fronts and others."""
        return Fronts(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def begin(
    point: Float[np.ndarray, "m 3"],
    labels: Int[np.ndarray, "m 3"],
    sign: Float[np.ndarray, " m"],
    end: Int[np.ndarray, " m"],
    number: int,
    leads: Leads,
) -> Fronts:
    """Fronts that start at points, numbered from `number` on."""
    ahead, longest = sign[:, None] * leads.tangent(point, labels), widest(point, leads)
    safe = leads.foremost(point, labels, ahead, longest)[2]
    numbers = number + np.arange(len(point))
    return Fronts(numbers, end, labels, sign, point, point, ahead, longest, safe, np.zeros(len(point)))


def widest(point: Float[np.ndarray, "m 3"], leads: Leads) -> Float[np.ndarray, " m"]:
    """The longest step allowed at points."""
    return STEP * np.sqrt(2 * np.pi * leads.length / leads.count * np.hypot(point[:, 1], point[:, 2]))


def step(fronts: Fronts, leads: Leads) -> tuple[Fronts, Int[np.ndarray, " m"]]:
    """One step of every front, and who is met: a label, GOING, HOME, or LOST for a step to be tried shorter."""
    old, longest = fronts.point, fronts.longest
    size = np.minimum(longest, np.maximum(fronts.safe, longest / 20))
    new, ahead, safe, met = advance(fronts, size, np.minimum(2 * longest, widest(old, leads)), leads)
    good = met != LOST
    home = (fronts.end < 0) & (fronts.gone > 3 * size) & good
    home &= passes(fronts.start, old, new, size / 5)
    new[home], met[home] = fronts.start[home], HOME
    moved = fronts._replace(
        point=np.where(good[:, None], new, old),
        ahead=np.where(good[:, None], ahead, fronts.ahead),
        safe=np.where(good, safe, fronts.safe),
        longest=np.where(good, np.minimum(2 * longest, widest(new, leads)), size / 4),
        gone=fronts.gone + np.where(good, size, 0),
    )
    return moved, met


def passes(target: np.ndarray, start: np.ndarray, stop: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Whether a target lies beside the way from start to stop."""
    way, off = stop - start, target - start
    share = (off * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), TINY)
    return (share > 0) & (share <= 1) & (np.linalg.norm(off - share[:, None] * way, axis=1) < within)


def advance(
    fronts: Fronts, step: np.ndarray, reach: np.ndarray, leads: Leads
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The points a step on, tangents, safe lengths up to `reach`, and who is met.

    Whoever leads at the new point ends the edge before it, at the vertex with them.
    """
    near, start, labels, sign = TOUCH * leads.size, fronts.point, fronts.labels, fronts.sign
    point, error = leads.solve(start + step[:, None] * fronts.ahead, labels, 5)
    met = np.where(error < near, GOING, LOST)
    point = np.where(error[:, None] < near, point, start)
    ahead = sign[:, None] * leads.tangent(point, labels)
    met[(ahead * fronts.ahead).sum(axis=1) < TURN] = LOST
    rival, beyond, safe = leads.foremost(point, labels, ahead, reach)
    open_ = np.flatnonzero((met == GOING) & (beyond > near))
    for _ in range(8):  # each vertex lies before the last, until nobody leads there
        met[open_] = rival[open_]
        four = np.append(labels[open_], met[open_, None], axis=1)
        point[open_], error = leads.solve(point[open_], four, 8)
        failed = ~(error < near)
        met[open_[failed]], open_, four = LOST, open_[~failed], four[~failed]
        rival[open_], beyond[open_], _ = leads.foremost(point[open_], four, ahead[open_], np.zeros(len(open_)))
        open_ = open_[beyond[open_] > near]
        if not len(open_):
            break
    met[open_] = LOST
    point = np.where(met[:, None] == LOST, start, point)
    ends = np.flatnonzero(met >= 0)
    ahead[ends] = sign[ends, None] * leads.tangent(point[ends], labels[ends])
    _, slope = leads.over_first(point[ends], np.stack([labels[ends, 0], met[ends]], axis=1))
    leaving = (slope[:, 0] * ahead[ends]).sum(axis=1) <= 0  # a vertex that begins the edge, not ends it
    moved = ((point - start) * fronts.ahead).sum(axis=1)
    bad = (moved < -near) | (moved > 2 * step) | ((ahead * fronts.ahead).sum(axis=1) < TURN)
    met[bad], met[ends[leaving]] = LOST, LOST
    return point, ahead, safe, met
