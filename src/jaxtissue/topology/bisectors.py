"""The lead of one cell over another at a point, in float64: what the diagram's edges are solved from.

With h = y cos t_j + z sin t_j and the foot of cell j at radius s = max(h, R_a), its squared distance is
d_j^2 = |p|^2 - 2 x x_j + x_j^2 - s (2 h - s). So the *lead* of j over a, d_a^2 - d_j^2, has the continuous
gradient 2 (q_j - q_a), q the feet: lead / |gradient| is the distance to their wall, to first order. Weights
are taken from the squared distances: tiny ones part walls that meet in one line of four cells. The four
bounds of the tissue count as cells n .. n + 3: apical, basal, x = 0 and x = L, with leads R_a^2 - r^2,
r^2 - R_b^2, -x and x - L. An edge is where three labels lead equally, a vertex where four do. Label rows are
sorted, so that a bound is never the first.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.geometry.array_likes import ArrayLike
from jaxtissue.geometry.tube import Tube

BOUNDS = 4
TINY = 1e-300
STILL = 1e-100  # a reach of none: products of its inverse with lengths do not overflow
TOUCH = 1e-11  # in units of R_b + L: nearer is taken as touching
TIE = 1e-13  # in units of R_b + L: leads that rounding may turn
BLOCK = 2**15  # pairs of point and rival compared at once: what fits the processor's cache
TURNS = 8  # most Newton steps
SLACK = 0.6  # how much more than foreseen edges and walls turn against each other in the longest step


def cross(first: Float[np.ndarray, "3 ..."], second: Float[np.ndarray, "3 ..."]) -> Float[np.ndarray, "3 ..."]:
    """Cross products along the first axis; `np.cross` takes several times as long."""
    (a, b, c), (u, v, w) = first, second
    return np.stack([b * w - c * v, c * u - a * w, a * v - b * u])


def dot(first: Float[np.ndarray, "3 ..."], second: Float[np.ndarray, "3 ..."]) -> Float[np.ndarray, "..."]:
    """Dot products along the first axis."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def ranges(first: Int[np.ndarray, " m"], size: Int[np.ndarray, " m"]) -> tuple[np.ndarray, np.ndarray]:
    """Row and value of all integers first <= value < first + size, in order."""
    row = np.repeat(np.arange(len(size)), size)
    return row, np.arange(len(row)) + np.repeat(first - np.cumsum(size) + size, size)


class Bisectors:
    """Leads of the labels of one tissue; points [m, 3], label rows [m, k], gradients [3, m, k - 1]."""

    def __init__(self, positions: ArrayLike, tube: Tube, care: float = 1.0, weights: ArrayLike | None = None) -> None:
        self.care = care  # by how much steps are shorter
        self.weight = None if weights is None else np.append(np.asarray(weights, float), np.zeros(BOUNDS))
        axial, angle = np.pad(np.asarray(positions, float).T, ((0, 0), (0, BOUNDS)))
        self.count, self.axial = len(axial) - BOUNDS, axial
        self.cosine, self.sine = np.cos(angle), np.sin(angle)
        self.inner, self.outer = float(tube.apical_radius), float(tube.basal_radius)
        self.length = float(tube.length)
        self.size = self.length + self.outer
        self.order = np.argsort(axial[: self.count])
        self._sorted = axial[self.order], self.cosine[self.order], self.sine[self.order]

    def over_first(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Leads of all labels but the first over the first, [m, k - 1], and their gradients [3, m, k - 1]."""
        own, labels, (x, y, z) = labels[:, :1], labels[:, 1:], point.T[..., None]
        cosine, sine, middle = self.cosine[own], self.sine[own], self.axial[own]
        turned_y, turned_z = self.cosine[labels] - cosine, self.sine[labels] - sine
        height, turn = y * cosine + z * sine, y * turned_y + z * turned_z
        foot, own_foot = np.maximum(height + turn, self.inner), np.maximum(height, self.inner)
        gap, rise = self.axial[labels] - middle, foot - own_foot
        # written in differences: loses no digits where the cells are close
        lead = gap * (2 * (x - middle) - gap) + rise * (2 * height - foot - own_foot) + 2 * foot * turn
        if self.weight is not None:
            lead += self.weight[labels] - self.weight[own]
        slope = np.stack([gap, foot * turned_y + rise * cosine, foot * turned_z + rise * sine])
        slope *= 2
        row, column = np.nonzero(labels >= self.count)
        for bound in range(BOUNDS) if len(row) else ():
            at = labels[row, column] == self.count + bound
            here = row[at], column[at]
            lead[here], slope[:, here[0], here[1]] = self.over_bound(bound, point[row[at]])
        return lead, slope

    def over_bound(self, bound: int, point: Float[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Lead of a bound of the tissue, and its gradient [3, m]."""
        outward, slope = (-1.0, 1.0)[bound % 2], np.zeros((3, len(point)))
        if bound < 2:
            slope[1:] = 2 * outward * point.T[1:]
            square = point[:, 1] ** 2 + point[:, 2] ** 2 - (self.inner, self.outer)[bound] ** 2
            return outward * square, slope
        slope[0] = outward
        return outward * (point[:, 0] - (0, self.length)[bound - 2]), slope

    def bend(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"], ahead: Float[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "m k-1"]:
        """Second derivatives, along straight lines ahead, of the leads that `over_first` gives."""
        cosine, sine = self.cosine[labels], self.sine[labels]
        (_, y, z), (_, along_y, along_z) = point.T[..., None], ahead.T[..., None]
        bend = 2 * (y * cosine + z * sine > self.inner) * (along_y * cosine + along_z * sine) ** 2
        bend = bend[:, 1:] - bend[:, :1]
        row, column = np.nonzero(labels[:, 1:] >= self.count)
        if len(row):
            factor = np.array([-2.0, 2.0, 0.0, 0.0])[labels[row, column + 1] - self.count]
            bend[row, column] = factor * (along_y**2 + along_z**2)[row, 0]
        return bend

    def curve(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m 3"]
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """Unit tangents of edges, along the cross product of the two gradients, and their derivatives."""
        first, second = np.moveaxis(self.over_first(point, labels)[1], -1, 0)
        along = cross(first, second)
        size = np.maximum(np.sqrt(dot(along, along)), TINY)
        along /= size
        one, two = self.bend(point, labels, along.T).T
        turn = (two * cross(first, along) - one * cross(second, along)) / size
        return along.T.copy(), turn.T.copy()

    def tangent(self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3"]:
        """Unit tangents of edges, as in `curve`."""
        along = cross(*np.moveaxis(self.over_first(point, labels)[1], -1, 0))
        return (along / np.maximum(np.sqrt(dot(along, along)), TINY)).T.copy()

    def solve(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"], small: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
        """The points where four labels lead equally, or three and nearest to the given point, by Newton's method.

        The second value tells whether the last step was a small one.
        """
        point, done, open_ = point.copy(), np.zeros(len(point), bool), np.arange(len(point))
        for _ in range(TURNS):
            step = self._newton(point[open_], labels[open_])
            point[open_] -= step.T
            done[open_] = np.abs(step).max(axis=0, initial=0) < small[open_]
            open_ = open_[~done[open_]]
            if not len(open_):
                break
        return point, done

    def _newton(self, point: np.ndarray, labels: np.ndarray) -> Float[np.ndarray, "3 m"]:
        lead, slope = self.over_first(point, labels)
        rows, scale = list(np.moveaxis(slope, -1, 0)), dot(slope, slope).prod(axis=1)
        rows += [cross(*rows)] if len(rows) == 2 else []
        dual = [cross(rows[i - 2], rows[i - 1]) for i in range(3)]
        volume = dot(rows[0], dual[0])
        parallel = volume**2 <= 1e-24 * (scale if lead.shape[1] == 3 else scale**2)  # such walls don't meet
        return sum(side * row for side, row in zip(lead.T, dual, strict=False)) / np.where(parallel, np.nan, volume)

    def nearest_competitor(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"]
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """The label, beside the given ones, that leads most, and the distance gone beyond its wall."""
        still = np.zeros_like(point)
        return self.look(point, labels, still, still, np.zeros(len(point)))[:2]

    def look(
        self,
        point: Float[np.ndarray, "m 3"],
        labels: Int[np.ndarray, "m k"],
        ahead: Float[np.ndarray, "m 3"],
        turn: Float[np.ndarray, "m 3"],
        reach: Float[np.ndarray, " m"],
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """As `nearest_competitor`, with the length that is safe to go ahead on a curve of given tangent.

        It is `reach` at most, and on it no unseen wall can be crossed and crossed back; `turn` is the derivative of the
        tangent. Distances change no faster than places, so a backbone that leads within reach is now at most as far as
        the own backbone will be, and reach more; and |x_j - x| <= d_j: no list of rivals is needed.
        """
        if not len(point):
            return np.zeros(0, int), np.zeros(0), np.zeros(0)
        row, rival = self._near(point, self._span(point, labels[:, 0], ahead, reach))
        pair = np.stack([labels[row, 0], rival], axis=1)
        lead, slope = self.over_first(point[row], pair)
        slope, bend = slope[..., 0], self.bend(point[row], pair, ahead[row])[:, 0]
        norm = np.sqrt(dot(slope, slope)) + TINY
        beyond, rate = lead[:, 0] / norm, dot(slope, ahead.T[:, row]) / norm
        safe = safe_step_length(beyond, rate, (bend + dot(slope, turn.T[:, row])) / norm, reach[row])
        known = (labels[row] == rival[:, None]).any(axis=1)
        beyond[known], safe[known] = -np.inf, np.inf
        start = np.searchsorted(row, np.arange(len(point)))  # each has its own backbone among the near
        most, safe = np.maximum.reduceat(beyond, start), np.minimum.reduceat(safe, start)
        best = np.flatnonzero(beyond == most[row])[::-1]
        label = np.zeros(len(point), int)
        label[row[best]] = rival[best]
        flat = 2 * (ahead[:, 1] ** 2 + ahead[:, 2] ** 2)
        for bound, bend in enumerate((-flat, flat, 0 * flat, 0 * flat)):
            lead, slope = self.over_bound(bound, point)
            norm = np.sqrt(dot(slope, slope)) + TINY
            beyond, rate = lead / norm, dot(slope, ahead.T) / norm
            ends = safe_step_length(beyond, rate, (bend + dot(slope, turn.T)) / norm, reach)
            other = ~(labels == self.count + bound).any(axis=1)
            first = other & (beyond > most)
            label[first], most[first] = self.count + bound, beyond[first]
            safe = np.where(other, np.minimum(safe, ends), safe)
        return label, most, np.minimum(safe, reach)

    def feet(self, point: Float[np.ndarray, "m 3"], own: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
        """The points of backbones that are nearest to given points."""
        foot = np.maximum(point[:, 1] * self.cosine[own] + point[:, 2] * self.sine[own], self.inner)
        return np.stack([self.axial[own], foot * self.cosine[own], foot * self.sine[own]], axis=1)

    def _span(self, point: np.ndarray, own: np.ndarray, ahead: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """The largest distance of a backbone that can come to be as near as the own one within reach.

        The curve strays by a fifth of its length from its tangent.
        """
        away = point - self.feet(point, own)
        later = away + reach[:, None] * ahead
        square = np.maximum((away**2).sum(axis=1), (later**2).sum(axis=1))
        square += 0 if self.weight is None else self.weight.max()
        return np.sqrt(square) + 1.2 * reach + 1e-9 * self.size

    def _near(self, point: np.ndarray, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and backbones at most `span` apart, by point."""
        axial, cosine, sine = self._sorted
        first = np.searchsorted(axial, point[:, 0] - span)
        size = np.searchsorted(axial, point[:, 0] + span, side="right") - first
        within = span**2 - point[:, 1] ** 2 - point[:, 2] ** 2
        ends = np.searchsorted(np.cumsum(size), np.arange(0, size.sum(), BLOCK)[1:])
        cuts, rows, rivals = np.unique([0, *ends, len(size)]), [np.zeros(0, int)], [np.zeros(0, int)]
        for start, stop in pairwise(cuts):
            row, place = ranges(first[start:stop], size[start:stop])
            row += start
            x, y, z = point[row].T
            height = y * cosine[place] + z * sine[place]
            foot = np.maximum(height, self.inner)
            near = (x - axial[place]) ** 2 - foot * (2 * height - foot) <= within[row]
            rows.append(row[near])
            rivals.append(self.order[place[near]])
        return np.concatenate(rows), np.concatenate(rivals)


def safe_step_length(beyond: np.ndarray, rate: np.ndarray, bend: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """The length that is safe to go before a wall could be crossed and crossed back.

    beyond + rate s + bend s^2 / 2 is taken to rise by up to SLACK / reach s^2 / 2 more; 1.5 times the length at which
    it is 0, so that one step passes a wall.
    """
    beyond = np.minimum(beyond, 0)
    half = (bend + SLACK / np.maximum(reach, STILL)) / 2
    root = np.sqrt(np.maximum(rate**2 - 4 * half * beyond, 0))
    met = rate**2 >= 4 * half * beyond
    late = np.where(half > 0, (root - rate) / np.where(half > 0, 2 * half, 1), np.inf)
    first = np.where(rate < 0, late, -2 * beyond / np.maximum(rate + root, TINY))
    # crossed back after -2 rate / bend less the first crossing: half-way there at most
    back = np.where((bend < 0) & (rate > 0), rate / np.maximum(-bend, TINY), np.inf)
    return np.where(met, np.minimum(1.5 * first, np.maximum(back, first)), np.inf)
