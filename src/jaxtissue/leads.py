"""How far one cell leads over another at a point, in float64: what the diagram's edges are solved from.

With h = y cos t_j + z sin t_j and the foot of cell j at radius s = max(h, R_a), its squared distance is
d_j^2 = |p|^2 - 2 x x_j + x_j^2 - s (2 h - s). So the *lead* of j over a, d_a^2 - d_j^2, has the continuous
gradient 2 (q_j - q_a), q the feet: lead / |gradient| is the distance to their wall, to first order. The four
bounds of the tissue count as cells n .. n + 3: apical, basal, x = 0 and x = L, with leads R_a^2 - r^2,
r^2 - R_b^2, -x and x - L. An edge is where three labels lead equally, a vertex where four do. Label rows are
sorted, so that a bound is never the first.
"""

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxtissue.tube import Tube

BOUNDS = 4
TINY = 1e-300
TOUCH = 1e-11  # in units of R_b + L: nearer is taken as touching
BLOCK = 2**15  # pairs of point and rival compared at once: what fits the processor's cache
BEND = 0.2  # the most that edges and walls turn against each other in a step: more than arccos(TURN) / 2


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Cross products along the last axis; `np.cross` takes several times as long."""
    (a, b, c), (u, v, w) = (np.moveaxis(side, -1, 0) for side in (first, second))
    return np.stack([b * w - c * v, c * u - a * w, a * v - b * u], axis=-1)


def ranges(first: Int[np.ndarray, " m"], size: Int[np.ndarray, " m"]) -> tuple[np.ndarray, np.ndarray]:
    """Row and value of all integers first <= value < first + size, in order."""
    row = np.repeat(np.arange(len(size)), size)
    return row, np.arange(len(row)) + np.repeat(first - np.cumsum(size) + size, size)


class Leads:
    """Leads of the labels of one tissue; points [m, 3], label rows [m, k]."""

    def __init__(self, positions: ArrayLike, tube: Tube) -> None:
        axial, angle = np.pad(np.asarray(positions, float).T, ((0, 0), (0, BOUNDS)))
        self.count, self.axial = len(axial) - BOUNDS, axial
        self.direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.inner, self.outer = float(tube.apical_radius), float(tube.basal_radius)
        self.length = float(tube.length)
        self.size = self.length + self.outer
        self.order = np.argsort(axial[: self.count])
        self._sorted = axial[self.order], *self.direction[self.order].T

    def over_first(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Leads of all labels but the first over the first, [m, k - 1], and their gradients [m, k - 1, 3]."""
        own, labels, (x, y, z) = labels[:, :1], labels[:, 1:], point.T[..., None]
        (cosine, sine), (turned_y, turned_z) = (np.moveaxis(self.direction[side], -1, 0) for side in (own, labels))
        turned_y, turned_z = turned_y - cosine, turned_z - sine
        height, turn = y * cosine + z * sine, y * turned_y + z * turned_z
        foot, own_foot = np.maximum(height + turn, self.inner), np.maximum(height, self.inner)
        gap, rise = self.axial[labels] - self.axial[own], foot - own_foot
        # written in differences: loses no digits where the cells are close
        lead = gap * (2 * x - self.axial[labels] - self.axial[own])
        lead += rise * (2 * height - foot - own_foot) + 2 * foot * turn
        slope = np.stack([gap, foot * turned_y + rise * cosine, foot * turned_z + rise * sine], axis=-1)
        slope *= 2
        row, column = np.nonzero(labels >= self.count)
        for bound in range(BOUNDS) if len(row) else ():
            at = labels[row, column] == self.count + bound
            here = row[at], column[at]
            lead[here], slope[here] = self.over_bound(bound, point[row[at]])
        return lead, slope

    def over_bound(self, bound: int, point: Float[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Lead of a bound of the tissue, and its gradient."""
        outward, slope = (-1.0, 1.0)[bound % 2], np.zeros_like(point)
        if bound < 2:
            slope[:, 1:] = 2 * outward * point[:, 1:]
            square = point[:, 1] ** 2 + point[:, 2] ** 2 - (self.inner, self.outer)[bound] ** 2
            return outward * square, slope
        slope[:, 0] = outward
        return outward * (point[:, 0] - (0, self.length)[bound - 2]), slope

    def tangent(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "m 3"]:
        """Unit tangents of edges, along the cross product of the two gradients."""
        slope = self.over_first(point, labels)[1]
        along = cross(slope[:, 0], slope[:, 1])
        return along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), TINY)

    def solve(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"], turns: int
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
        """Where four labels lead equally, or three and nearest to the point, by Newton; and the last step."""
        point, last, open_ = point.copy(), np.zeros(len(point)), np.arange(len(point))
        for _ in range(turns):
            step = self._newton(point[open_], labels[open_])
            point[open_] -= step
            last[open_] = np.abs(step).max(axis=-1, initial=0)
            open_ = open_[~(last[open_] < TOUCH * self.size)]
            if not len(open_):
                break
        return point, last

    def _newton(self, point: np.ndarray, labels: np.ndarray) -> np.ndarray:
        lead, slope = self.over_first(point, labels)
        norm = np.maximum(np.linalg.norm(slope, axis=-1), TINY)
        rows, side = slope / norm[..., None], lead / norm
        if rows.shape[1] == 2:
            rows = np.append(rows, cross(rows[:, :1], rows[:, 1:]), axis=1)
            side = np.append(side, np.zeros_like(side[:, :1]), axis=1)
        dual = cross(rows[:, [1, 2, 0]], rows[:, [2, 0, 1]])
        volume = (rows[:, 0] * dual[:, 0]).sum(axis=-1)
        volume = np.where(np.abs(volume) > 1e-12, volume, np.nan)  # parallel walls don't meet
        return (dual * side[..., None]).sum(axis=1) / volume[:, None]

    def foremost(
        self,
        point: Float[np.ndarray, "m 3"],
        labels: Int[np.ndarray, "m k"],
        ahead: Float[np.ndarray, "m 3"],
        reach: Float[np.ndarray, " m"],
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """The label, beside the given ones, that leads most, the distance gone beyond its wall (negative: to
        go), and how far, `reach` at most, one may go `ahead` before an unseen wall could be crossed and
        crossed back.

        Distances change no faster than places, so whoever leads within reach has d_j <= d_a + 2 reach, and
        |x_j - x| <= d_j: no list of rivals is needed.
        """
        own = labels[:, 0]
        height = (point[:, 1:] * self.direction[own]).sum(axis=1)
        foot = np.maximum(height, self.inner)
        across = point[:, 1] ** 2 + point[:, 2] ** 2
        square = (point[:, 0] - self.axial[own]) ** 2 + across - foot * (2 * height - foot)
        span = np.sqrt(np.maximum(square, 0)) + 2 * reach + 1e-9 * self.size
        first = np.searchsorted(self._sorted[0], point[:, 0] - span)
        size = np.searchsorted(self._sorted[0], point[:, 0] + span, side="right") - first
        ends = np.searchsorted(np.cumsum(size), np.arange(0, size.sum(), BLOCK)[1:])
        cuts = np.unique(np.concatenate([[0], ends, [len(size)]]))
        found = [
            self._within(point[some], span[some], first[some], size[some])
            for some in map(slice, cuts[:-1], cuts[1:])
        ]
        row = np.concatenate([np.zeros(0, int)] + [pair[0] + at for pair, at in zip(found, cuts, strict=False)])
        rival = np.concatenate([np.zeros(0, int)] + [pair[1] for pair in found])
        lead, slope = self.over_first(point[row], np.stack([own[row], rival], axis=1))
        return self._choose(point, labels, ahead, reach, (row, rival, lead[:, 0], slope[:, 0]))

    def _within(
        self, point: np.ndarray, span: np.ndarray, first: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points and backbones at most `span` apart, among `size` from the `first` by axial place on."""
        row, place = ranges(first, size)
        x, y, z = point.T
        axial, cosine, sine = self._sorted
        height = y[row] * cosine[place] + z[row] * sine[place]
        foot = np.maximum(height, self.inner)
        square = (x[row] - axial[place]) ** 2 - foot * (2 * height - foot)
        near = square <= (span**2 - y**2 - z**2)[row]
        return row[near], self.order[place[near]]

    def _choose(
        self, point: np.ndarray, labels: np.ndarray, ahead: np.ndarray, reach: np.ndarray, rivals: tuple
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count, (row, rival, lead, slope) = len(point), rivals
        every = np.arange(count)
        bounds = [self.over_bound(bound, point) for bound in range(BOUNDS)]
        row = np.concatenate([row, *[every] * BOUNDS])
        rival = np.concatenate([rival, *(np.full(count, self.count + bound) for bound in range(BOUNDS))])
        lead = np.concatenate([lead, *(bound[0] for bound in bounds)])
        slope = np.concatenate([slope, *(bound[1] for bound in bounds)])
        other = (labels[row] != rival[:, None]).all(axis=1)
        row, rival, lead, slope = row[other], rival[other], lead[other], slope[other]
        order = np.argsort(row, kind="stable")
        row, rival, lead, slope = row[order], rival[order], lead[order], slope[order]
        norm = np.sqrt((slope**2).sum(axis=-1)) + TINY
        beyond, rate = lead / norm, (slope * ahead[row]).sum(axis=-1) / norm
        # 1.5: one step passes a wall that is met head-on
        safe = 1.5 * np.maximum(-beyond, 0) / (np.maximum(rate, 0) + BEND)
        safe = np.where(rate > -BEND, safe, np.inf)
        start = np.searchsorted(row, every)  # at least two bounds are left for each
        if not count:
            return np.zeros(0, int), np.zeros(0), np.zeros(0)
        most = np.maximum.reduceat(beyond, start)
        best = np.flatnonzero(beyond == most[row])[::-1]
        label = np.zeros(count, int)
        label[row[best]] = rival[best]
        return label, most, np.minimum(np.minimum.reduceat(safe, start), reach)
