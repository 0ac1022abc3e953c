"""Sections of cells at constant radius, right to rounding: their corners are solved for (host, float64).

At radius r and angle D from its own backbone a cell is one interval along the axis, from -reach behind to
+reach ahead, each the lowest of the rivals' reaches h_j(D), as in `walls`. Each function h_j is smooth, so
between two angles at which rivals change, or the interval closes, any Gauss rule is exact to rounding. These
angles are found by halving: an interval of angles is cut where the rivals at its ends are even, where the
cell's interval closes, or where the tangents at both ends show that a third rival may come between. The grid
that this starts from runs all the way round and is finer towards the backbone, so that narrow cells and parts
across the lumen are seen.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.tube import Tube

FAR = 1e30  # half the gap to no rival
LEVEL = 1e-10  # slope against the axis given to walls closer to parallel to it
AROUND = 48  # equal steps of the first grid round the tube
GROWTH = 1.7  # by which its steps grow away from the backbone
NARROWEST = 1e-8  # first of these steps, in radians, at least
ROUNDS = 24  # most cuts of an interval of angles
GAIN = 1e-7  # of the basal radius: by less a rival is not taken to come between
BATCH = 96  # sections taken at once: fewer take longer each, more do not fit the processor's cache
SURVEYED = 7  # radii at which it is seen which rivals matter
MARGIN = 0.5  # of the longest line of a cell: rivals farther from bounding it are left out
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_NODES, _WEIGHTS = (1 + _NODES)[:, None] / 2, _WEIGHTS[:, None] / 2


class Surroundings(NamedTuple):
    """Some cells against their rivals behind and ahead, padded with rivals FAR away."""

    ends: Float[np.ndarray, "cells 2"]  # distance to the tube's end, behind and ahead
    half: Float[np.ndarray, "cells 2 rivals"]  # |x_j - x_i| / 2
    sine: Float[np.ndarray, "cells 2 rivals"]  # of half the angle t_j - t_i
    cosine: Float[np.ndarray, "cells 2 rivals"]
    nearest: Float[np.ndarray, " cells"]  # the smallest angle to a rival


class Section(NamedTuple):
    """Integrals over the angle at one radius, a value for each section."""

    length: Float[np.ndarray, " m"]  # int (hi - lo) dt: area of the section / r
    wall: Float[np.ndarray, " m"]  # area of walls between cells per r dr
    edge: Float[np.ndarray, " m"]  # length of walls on the layer / r
    at_end: Bool[np.ndarray, " m"]  # the cell touches an end of the tube there


def surround(
    positions: Float[np.ndarray, "n 2"],
    tube: Tube,
    cells: Int[np.ndarray, " cells"],
    rivals: Int[np.ndarray, "cells rivals"],
) -> Surroundings:
    """The cells against the given rivals; the cell itself, which pads the lists, is none."""
    axial, angle = positions.T
    own = cells[:, None]
    gap = axial[rivals] - axial[own]
    turn = np.remainder(angle[rivals] - angle[own] + np.pi, 2 * np.pi) - np.pi
    sine, cosine = np.sin(turn / 2), np.cos(turn / 2)
    apart = np.maximum(np.abs(gap), 2 * LEVEL * float(tube.apical_radius) * np.abs(sine))
    ahead = (gap > 0) | ((gap == 0) & (rivals > own))
    real = (rivals != own) & (apart > 0)
    sides = []
    for chosen in (real & ~ahead, real & ahead):
        width = max(1, int(chosen.sum(axis=1).max(initial=0)))
        order = np.argsort(~chosen, axis=1, kind="stable")[:, :width]
        there = np.take_along_axis(chosen, order, axis=1)
        half, s, c = (np.take_along_axis(t, order, axis=1) for t in (apart / 2, sine, cosine))
        sides.append((np.where(there, half, FAR), np.where(there, s, 0), np.where(there, c, 1)))
    width = max(side[0].shape[1] for side in sides)
    tables = []
    for columns, blank in zip(zip(*sides, strict=True), (FAR, 0.0, 1.0), strict=True):
        spare = [((0, 0), (0, width - column.shape[1])) for column in columns]
        padded = [np.pad(c, s, constant_values=blank) for c, s in zip(columns, spare, strict=True)]
        tables.append(np.stack(padded, axis=1))
    nearest = np.where(real, np.abs(turn), np.pi).min(axis=1, initial=np.pi)
    ends = np.stack([axial[cells], float(tube.length) - axial[cells]], axis=1)
    return Surroundings(ends, tables[0], tables[1], tables[2], nearest)


def measure_sections(
    about: Surroundings, cell: Int[np.ndarray, " m"], radius: Float[np.ndarray, " m"], tube: Tube
) -> Section:
    """The sections of some cells, each at a radius."""
    parts = [
        _Batch(about, cell[start : start + BATCH], radius[start : start + BATCH], tube).measure()
        for start in range(0, len(cell), BATCH)
    ]
    length, wall, edge, at_end = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Section(length, wall, edge, at_end)


def leave_out(about: Surroundings, tube: Tube) -> Surroundings:
    """The same without the rivals that are far from bounding the cells at any of some radii.

    Kept are those that are lowest on some line of the first grids, and those that come within MARGIN of what
    bounds the cell, by their values and tangents, wherever it is.
    """
    cells, _, rivals = about.half.shape
    radii = np.linspace(np.sqrt(float(tube.apical_radius)), np.sqrt(float(tube.basal_radius)), SURVEYED) ** 2
    kept = np.zeros((cells, 2, rivals + 1), bool)
    step = max(1, BATCH // (4 * SURVEYED))
    for start in range(0, cells, step):
        some = np.arange(start, min(start + step, cells))
        batch = _Batch(about, np.repeat(some, SURVEYED), np.tile(radii, len(some)), tube)
        kept[some] = batch.matter().reshape(len(some), SURVEYED, 2, rivals + 1).any(axis=1)
    chosen = kept[..., :-1]
    width = max(1, int(chosen.sum(axis=2).max(initial=0)))
    order = np.argsort(~chosen, axis=2, kind="stable")[..., :width]
    half, sine, cosine = (np.take_along_axis(t, order, axis=2) for t in about[1:4])
    half = np.where(np.take_along_axis(chosen, order, axis=2), half, FAR)
    return about._replace(half=half, sine=sine, cosine=cosine)


class _Lines(NamedTuple):
    """Lines parallel to the axis, with the reaches of all rivals there."""

    section: np.ndarray  # [p]
    angle: np.ndarray  # [p], from the own backbone
    reach: np.ndarray  # [p, 2, rivals + 1], the last is the tube's end
    slope: np.ndarray  # dh/dt

    def join(self, other: "_Lines") -> "_Lines":
        return _Lines(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class _Spans(NamedTuple):
    """Intervals of angles between two lines, with the rivals that bound the cell at either end."""

    line: np.ndarray  # [s, 2]
    by: np.ndarray  # [s, 2 ends, 2 sides]
    inside: np.ndarray  # [s, 2 ends]

    def of(self, chosen: Any) -> "_Spans":
        return _Spans(*(column[chosen] for column in self))


class _Batch:
    """Some sections, measured together."""

    def __init__(self, about: Surroundings, cell: np.ndarray, radius: np.ndarray, tube: Tube) -> None:
        self.cell, self.radius = cell, radius
        self.inner, self.size = float(tube.apical_radius), float(tube.basal_radius)
        self.ends, self.half = about.ends[cell], about.half[cell]
        self.sine, self.cosine, self.nearest = about.sine[cell], about.cosine[cell], about.nearest[cell]

    def measure(self) -> Section:
        """The integrals of every section of the batch."""
        lines, spans = self._begin()
        done = []
        for _ in range(ROUNDS):
            cut = self._cuts(lines, spans)
            whole = np.isnan(cut)
            done.append(self._ends(lines, spans.of(whole & spans.inside.any(axis=1))))
            spans, cut = spans.of(~whole), cut[~whole]
            if not len(cut):
                break
            lines, spans = self._split(lines, spans, cut)
        done.append(self._ends(lines, spans.of(spans.inside.any(axis=1))))
        return self._integrate(*(np.concatenate(column) for column in zip(*done, strict=True)))

    def matter(self) -> Bool[np.ndarray, "m 2 rivals"]:
        """The rivals, and last the tube's end, that bound each section or come near to it."""
        lines, _ = self._begin()
        count = len(self.cell)
        reach = lines.reach.reshape(count, -1, *lines.reach.shape[1:])
        slope = lines.slope.reshape(reach.shape)
        angle = lines.angle.reshape(count, -1)
        low = reach.min(axis=3)
        length = low.sum(axis=2)
        inside = length > 0
        lead = reach - low[..., None]
        row, column, side = np.ogrid[:count, : angle.shape[1], :2]
        rate = slope - slope[row, column, side, reach.argmin(axis=3)][..., None]
        width = np.diff(angle, axis=1)[..., None, None]
        # as low as either tangent gets within the span
        met = np.minimum(lead[:, :-1] + np.minimum(rate[:, :-1], 0) * width,
                         lead[:, 1:] - np.maximum(rate[:, 1:], 0) * width)  # fmt: skip
        some = (inside[:, 1:] | inside[:, :-1])[..., None, None]
        near = (met < MARGIN * length.max(axis=1)[:, None, None, None]) & some
        return near.any(axis=1) | (lead == 0).any(axis=1)

    def _begin(self) -> tuple[_Lines, _Spans]:
        """A grid round the tube, finer towards the backbone."""
        count = int(np.ceil(np.log(np.pi / NARROWEST) / np.log(GROWTH)))
        first = np.clip(self.nearest / 4, NARROWEST, np.pi / AROUND)
        count = min(count, int(np.ceil(np.log(2 * np.pi / AROUND / first.min()) / np.log(GROWTH))) + 1)
        fine = first[:, None] * GROWTH ** np.arange(count)
        fine = np.where(fine < 2 * np.pi / AROUND, fine, first[:, None] / 2)
        even = np.broadcast_to(np.linspace(-np.pi, np.pi, AROUND + 1), (len(first), AROUND + 1))
        angle = np.sort(np.concatenate([even, fine, -fine], axis=1), axis=1)
        lines = self._look(np.repeat(np.arange(len(angle)), angle.shape[1]), angle.ravel())
        number = np.arange(angle.size).reshape(angle.shape)
        line = np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2)
        by = lines.reach.argmin(axis=2)
        inside = np.take_along_axis(lines.reach, by[..., None], axis=2).sum(axis=(1, 2)) > 0
        return lines, _Spans(line, by[line], inside[line])

    def _look(self, section: np.ndarray, angle: np.ndarray) -> _Lines:
        """Lines with the reaches of all rivals."""
        shape = (len(section), 1, 1)
        radius, turn = self.radius[section].reshape(shape), angle.reshape(shape)
        half, sine, cosine = self.half[section], self.sine[section], self.cosine[section]
        reach, slope, _ = _meet(radius, turn, half, sine, cosine, self.inner)
        ends = self.ends[section][..., None]
        return _Lines(
            section,
            angle,
            np.concatenate([reach, ends], axis=2),
            np.concatenate([slope, np.zeros_like(ends)], axis=2),
        )

    def _wall(self, section: np.ndarray, angle: np.ndarray, by: np.ndarray) -> tuple[np.ndarray, ...]:
        """Reach, slope, tilt, and whether it is the tube's end, of rivals [.., s, 2] on lines [.., s]."""
        end = by == self.half.shape[2]
        row, side, at = section[:, None], np.arange(2), np.where(end, 0, by)
        half, sine, cosine = (table[row, side, at] for table in (self.half, self.sine, self.cosine))
        radius = self.radius[section][:, None]
        reach, slope, tilt = _meet(radius, angle[..., None], half, sine, cosine, self.inner)
        return np.where(end, self.ends[section], reach), np.where(end, 0, slope), np.where(end, 0, tilt), end

    def _cuts(self, lines: _Lines, spans: _Spans) -> np.ndarray:
        """Where each span is cut, or nan where it is whole."""
        first, last = lines.angle[spans.line].T
        cut = np.full(len(first), np.nan)
        width = last - first
        open_ = width > 1e-15 * np.maximum(np.abs(first), np.abs(last))
        some = open_ & spans.inside.any(axis=1)
        change = spans.by[:, 0] != spans.by[:, 1]
        for side in (1, 0):
            at = np.flatnonzero(some & change[:, side])
            cut[at] = self._even(lines, spans.of(at), side)
        at = np.flatnonzero(some & ~change.any(axis=1) & (spans.inside[:, 0] != spans.inside[:, 1]))
        cut[at] = self._closing(lines, spans.of(at))
        at = np.flatnonzero(open_ & spans.inside.all(axis=1) & ~change.any(axis=1))
        cut[at] = self._between(lines, spans.of(at))
        at = np.flatnonzero(open_ & ~spans.inside.any(axis=1))
        cut[at] = self._opening(lines, spans.of(at))
        return np.where((cut > first) & (cut < last), cut, np.nan)

    def _even(self, lines: _Lines, spans: _Spans, side: int) -> np.ndarray:
        """Where the rivals at both ends of spans reach equally far."""
        section, angle = lines.section[spans.line[:, 0]], lines.angle[spans.line].T

        def lead(at: np.ndarray) -> np.ndarray:
            one, two = (self._wall(section, at, spans.by[:, end])[0][..., side] for end in (0, 1))
            return one - two

        return _root(lead, *angle)

    def _closing(self, lines: _Lines, spans: _Spans) -> np.ndarray:
        """Where the cell's interval closes."""
        section, angle = lines.section[spans.line[:, 0]], lines.angle[spans.line].T
        return _root(lambda at: self._wall(section, at, spans.by[:, 0])[0].sum(axis=-1), *angle)

    def _between(self, lines: _Lines, spans: _Spans) -> np.ndarray:
        """Where some third rival may come between, by the tangents at both ends."""
        row, side = np.arange(len(spans.line))[:, None], np.arange(2)
        width = np.diff(lines.angle[spans.line], axis=1)[:, :, None]
        lead, rate = [], []
        for end in (0, 1):
            reach, slope = lines.reach[spans.line[:, end]], lines.slope[spans.line[:, end]]
            by = spans.by[:, end]
            lead.append(reach - reach[row, side, by][..., None])
            rate.append(slope - slope[row, side, by][..., None])
        met = (rate[0] < 0) & (rate[1] > 0)
        turn = np.where(met, rate[1] - rate[0], 1)
        share = np.where(met, (lead[0] - lead[1] + rate[1] * width) / turn, 0)
        low = np.where(met, lead[0] + rate[0] * share, np.inf).reshape(len(row), 2 * met.shape[2])
        least = low.argmin(axis=1)[:, None]
        found = np.take_along_axis(low, least, axis=1)[:, 0] < -GAIN * self.size
        share = np.take_along_axis(share.reshape(low.shape), least, axis=1)[:, 0]
        return np.where(found, lines.angle[spans.line[:, 0]] + share, np.nan)

    def _opening(self, lines: _Lines, spans: _Spans) -> np.ndarray:
        """Where a cell outside at both ends may have a part, by the tangents at both ends."""
        row, side = np.arange(len(spans.line))[:, None], np.arange(2)
        width = np.diff(lines.angle[spans.line], axis=1)[:, 0]
        length, rate = (
            np.stack([t[spans.line[:, e]][row, side, spans.by[:, e]].sum(axis=1) for e in (0, 1)])
            for t in (lines.reach, lines.slope)
        )
        met = (rate[0] > 0) & (rate[1] < 0)
        turn = np.where(met, rate[1] - rate[0], 1)
        share = (length[0] - length[1] + rate[1] * width) / turn
        found = met & (length[0] + rate[0] * share > GAIN * self.size)
        return np.where(found, lines.angle[spans.line[:, 0]] + share, np.nan)

    def _split(self, lines: _Lines, spans: _Spans, cut: np.ndarray) -> tuple[_Lines, _Spans]:
        """Two spans for each, with a new line between; there the rivals of both ends go on as far as they are
        lowest but for rounding."""
        new = self._look(lines.section[spans.line[:, 0]], cut)
        number = len(lines.angle) + np.arange(len(cut))
        row, side = np.arange(len(cut))[:, None], np.arange(2)
        best = new.reach.argmin(axis=2)
        low = new.reach[row, side, best]
        middle = []
        for end in (0, 1):
            by = spans.by[:, end]
            steep = np.abs(new.slope[row, side, by]) + np.abs(new.slope[row, side, best])
            slack = 1e-11 * self.size + 1e-15 * np.abs(cut)[:, None] * steep
            middle.append(np.where(new.reach[row, side, by] <= low + slack, by, best))
        open_ = low.sum(axis=1)
        one_sided = (spans.by[:, 0] == spans.by[:, 1]).all(axis=1) & (
            spans.inside[:, 0] != spans.inside[:, 1]
        )
        same = (middle[0] == spans.by[:, 0]).all(axis=1) & one_sided  # the interval closes here
        inside = [np.where(same, spans.inside[:, end], open_ > 0) for end in (0, 1)]
        line = np.stack([spans.line[:, 0], number, number, spans.line[:, 1]], axis=1).reshape(-1, 2)
        by = np.stack([spans.by[:, 0], middle[0], middle[1], spans.by[:, 1]], axis=1).reshape(-1, 2, 2)
        within = np.stack([spans.inside[:, 0], *inside, spans.inside[:, 1]], axis=1).reshape(-1, 2)
        return lines.join(new), _Spans(line, by, within)

    def _ends(self, lines: _Lines, spans: _Spans) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return lines.section[spans.line[:, 0]], lines.angle[spans.line], spans.by[:, 0]

    def _smooth(
        self, section: np.ndarray, angle: np.ndarray, by: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Spans cut where the foot on a backbone comes to its apical end: there slopes bend."""
        bend = np.arccos(np.minimum(self.inner / self.radius[section], 1))[:, None]
        row, side, at = section[:, None], np.arange(2), np.minimum(by, self.half.shape[2] - 1)
        turn = 2 * np.arctan2(self.sine[row, side, at], self.cosine[row, side, at])
        turn = np.append(turn, np.zeros_like(bend), axis=1)
        places = np.concatenate([turn - bend, turn + bend], axis=1)
        places = np.remainder(places + np.pi, 2 * np.pi) - np.pi
        places = np.sort(np.clip(places, angle[:, :1], angle[:, 1:]), axis=1)
        edges = np.concatenate([angle[:, :1], places, angle[:, 1:]], axis=1)
        span, part = np.nonzero(np.diff(edges, axis=1) > 0)
        return section[span], np.stack([edges[span, part], edges[span, part + 1]], axis=1), by[span]

    def _integrate(self, section: np.ndarray, angle: np.ndarray, by: np.ndarray) -> Section:
        """Sums over whole spans by Gauss's rule."""
        section, angle, by = self._smooth(section, angle, by)
        width = angle[:, 1] - angle[:, 0]
        reach, slope, tilt, end = self._wall(section, angle[:, 0] + _NODES * width, by)
        length = np.maximum(reach.sum(axis=-1), 0)
        live = length > 0
        square = (slope / self.radius[section][:, None]) ** 2
        wall = (np.where(end, 0, np.sqrt(1 + square + tilt**2)).sum(axis=-1)) * live
        edge = (np.where(end, 0, np.sqrt(1 + square)).sum(axis=-1)) * live
        length, wall, edge = (np.bincount(section, width * (_WEIGHTS * part).sum(axis=0), len(self.cell))
                for part in (length, wall, edge))  # fmt: skip
        at_end = np.bincount(
            section, (end & live.any(axis=0)[:, None]).any(axis=1) * (width > 0), len(self.cell)
        )
        return Section(length, wall, edge, at_end > 0)


def _meet(
    radius: np.ndarray,
    angle: np.ndarray,
    half: np.ndarray,
    sine: np.ndarray,
    cosine: np.ndarray,
    inner: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reach h = half + (f_j - f_i) / (4 half), dh/dt and dh/dr, in differences, which lose no digits."""
    own_sine, own_cosine = np.sin(angle), np.cos(angle)
    z, y = radius * own_cosine, radius * own_sine
    foot = np.maximum(z, inner)
    chord = 2 * radius * sine
    higher = chord * (own_sine * cosine - own_cosine * sine)  # z_j - z_i
    across = -chord * (own_cosine * cosine + own_sine * sine)  # y_j - y_i
    rival = z + higher
    rise = np.where((z > inner) & (rival > inner), higher, np.maximum(rival, inner) - foot)
    rival_foot = foot + rise
    farther = rise * (rival_foot + foot - 2 * z) - 2 * rival_foot * higher
    gap = 2 * half
    slope = (rival_foot * across + rise * y) / gap
    tilt = -(rival_foot * higher + rise * z) / (radius * gap)
    return half + farther / (2 * gap), slope, tilt


def _root(
    function: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray
) -> Float[np.ndarray, " m"]:
    """Roots of an elementwise function between bounds at which its signs differ (Illinois' rule)."""
    kept, other = low, high
    at_kept, at_other = function(low), function(high)
    for _ in range(50):
        spread = at_other - at_kept
        root = other - at_other * (other - kept) / np.where(spread == 0, np.inf, spread)
        value = function(root)
        crossed = np.sign(value) != np.sign(at_other)
        kept, at_kept = np.where(crossed, other, kept), np.where(crossed, at_other, at_kept / 2)
        moved, other, at_other = np.abs(root - other), root, value
        if ((moved <= 4e-16 * np.abs(root)) | (value == 0)).all():
            break
    return other
