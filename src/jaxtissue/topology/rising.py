"""Cells followed from the apical to the basal surface: their junctions move, and where four labels meet, sides flip.

From layer to layer every junction is solved anew. A side whose far label has come nearer than the junction's own has
flipped in between: the point where all four meet is solved for, and the map changed there. Where that does not explain
a layer, or a side may have flipped and flipped back, steps are halved. Where the shortest step does not help, as where
a part of a cell's section comes off or vanishes, the map of the next layer is found anew, from many points.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.topology.junctions import Junctions
from jaxtissue.topology.layer_gaps import LayerGaps, Spots
from jaxtissue.topology.sampled_map import sampled_map

STEPS = 16  # from the apical to the basal surface
LEAST = 2.0**-12  # the shortest step
FORCED = 4  # steps taken though neither explained nor followed by a new map; then the cells are given up
RESTARTS = 4  # with new maps, and one more for every twenty cells
ROUNDS = 24  # of flips within a step
TIE = 1e-11  # of the tissue's size: labels as near are as near as each other
NAMED = 8  # cells in a message
ALIKE = 9  # digits of the heights of flips
LATE = 1e-9  # of the height, by which a flip may be found before or after its step


class Pieces(NamedTuple):
    """Edges between two heights with the same four labels: the two cells, and those at both ends.

    Each of both ends is known at one height, with its drift, from which others are found.
    """

    quad: Int[np.ndarray, "e 4"]
    place: Float[np.ndarray, "e 2 d"]
    at: Float[np.ndarray, "e 2"]
    drift: Float[np.ndarray, "e 2 2"]
    low: Float[np.ndarray, " e"]
    high: Float[np.ndarray, " e"]
    life: Int[np.ndarray, " e"]


class Flips(NamedTuple):
    """Where sides flip: the four labels, the point and the height."""

    labels: Int[np.ndarray, "k 4"]
    point: Float[np.ndarray, "k 3"]
    height: Float[np.ndarray, " k"]


class Rise(NamedTuple):
    """The cells of a tissue from the apical to the basal surface.

    Attributes:
        apical: The junctions of the apical surface.
        basal: Those of the basal surface.
        pieces: All edges in between.
        flips: All flips, also those at the ends of the tissue.
        unexplained: The labels of cells round each change that no flip was found for.
    """

    apical: Junctions
    basal: Junctions
    pieces: Pieces
    flips: Flips
    unexplained: list[Int[np.ndarray, " k"]]


class SideGaps(NamedTuple):
    """How far beyond each junction the label across each side is, and how this grows with the height, [t, 3]."""

    ahead: Float[np.ndarray, "t 3"]
    rate: Float[np.ndarray, "t 3"]
    drift: Float[np.ndarray, "t 2"]


def side_gaps(gaps: LayerGaps, junctions: Junctions, spots: Spots) -> SideGaps:
    """The gaps of the labels across the sides of junctions that are at the given spots."""
    count = len(junctions.labels)
    order = np.sort(junctions.labels, axis=1)
    rival = junctions.labels[np.maximum(junctions.beside, 0), junctions.side]
    labels = np.concatenate([order, rival], axis=1)
    # limits behind cells; the rivals stand last and may be either
    lead = gaps.lead(spots, labels)
    drift = gaps.drift(lead)
    rate = lead.slope[:, 2:, 2] + np.einsum("tki,ti->tk", lead.slope[:, 2:, :2], drift)
    steep = np.maximum(lead.steep[:, 2:], 1e-300)
    ahead = np.where(junctions.beside < 0, np.inf, lead.value[:, 2:] / steep)
    return SideGaps(ahead.reshape(count, 3), rate / steep, drift)


class _Climb:
    """One tissue on its way up."""

    def __init__(self, gaps: LayerGaps, junctions: Junctions) -> None:
        self.gaps, self.now = gaps, junctions
        self.lives = int(junctions.life.max()) + 1
        self.pieces: list[Pieces] = []
        self.flips: list[Flips] = []
        self.unexplained: list[np.ndarray] = []
        self.forced, self.restarts = 0, 0

    def settle(self) -> None:
        """Put junctions where they are on their layer, and flip sides until no label is nearer than those that meet."""
        now, row, side = self.now, np.zeros(0, int), np.zeros(0, int)
        for _ in range(8 * ROUNDS):
            spots, _, done = self.gaps.meet(np.sort(now.labels, axis=1), now.place, now.at)
            found_gaps = side_gaps(self.gaps, now, spots)
            now.place, now.drift = spots.place, found_gaps.drift
            row, side = failing(self.gaps, now, found_gaps, done)
            row, side = row[done[row]], side[done[row]]
            if not len(row):
                return
            used: set[int] = set()
            for t, k in zip(row.tolist(), side.tolist(), strict=True):
                other = int(now.beside[t, k])
                if t in used or other in used:
                    continue
                used |= {t, other}
                now.flip(t, k, int(now.life[t, k]), float(now.at[t]))
        self.unexplained += list(now.quads(row, side))

    def step(self, low: float, high: float, force: bool) -> bool:
        """Go from one layer to the next; False, and nothing done, where a change can't be explained."""
        begun, lives, pieces, flips = self.now.copy(), self.lives, len(self.pieces), len(self.flips)
        before = side_gaps(self.gaps, begun, self.gaps.look(begun.place, 0 * begun.drift, begun.at))
        now, known = self.now, np.zeros(len(begun.at), bool)
        spots = self.gaps.look(now.place, now.drift * (high - now.at)[:, None], np.full(len(now.at), high))
        done, row, side = known.copy(), np.zeros(0, int), np.zeros(0, int)
        for _ in range(ROUNDS):
            open_ = np.flatnonzero(~known)
            if len(open_):
                ahead = now.drift[open_] * (high - now.at[open_])[:, None]
                found, _, fine = self.gaps.meet(
                    np.sort(now.labels[open_], axis=1), now.place[open_], np.full(len(open_), high), ahead
                )
                for part, new in zip(spots, found, strict=True):
                    part[open_] = new
                done[open_], known[open_] = fine, True
            found_gaps = side_gaps(self.gaps, now, spots)
            row, side = failing(self.gaps, now, found_gaps, done)
            if not len(row):
                if not force and self._may_return(begun, before, found_gaps, high - low):
                    break
                self._close(high)
                now.place, now.at[:], now.drift, now.since[:] = spots.place, high, found_gaps.drift, high
                return True
            if not self._flip(row, side, low, high, known):
                break
        failed, fresh = list(self.now.quads(row, side)) or [np.zeros(0, int)], self._map_anew(high) if force else None
        if force and fresh is None:
            self.now.place, self.now.at[:], self.now.since[:] = spots.place, high, high
            self.unexplained += failed
            self.settle()
            self.forced += 1
            return True
        self.now, self.lives = begun, lives
        del self.pieces[pieces:], self.flips[flips:]
        if fresh is not None:
            self.now = fresh
            self.settle()
            changed, self.lives = self.now.renumber(begun, lives)
            self.unexplained += changed or failed
        return force

    def _map_anew(self, height: float) -> Junctions | None:
        """The map of a layer by its points; None where that is none, or after too many."""
        self.restarts += 1
        if self.restarts > RESTARTS + self.gaps.count // 20:
            return None
        try:
            fresh = sampled_map(self.gaps, height)
        except ValueError:
            return None
        fresh.at[:], fresh.since[:] = height, height
        return fresh

    def _flip(
        self, row: Int[np.ndarray, " k"], side: Int[np.ndarray, " k"], low: float, high: float, known: np.ndarray
    ) -> bool:
        """Flip the failing sides that are first in their place; False if none can be located."""
        now, other = self.now, self.now.beside[row, side]
        quads = np.sort(now.quads(row, side), axis=1)
        begin = np.maximum(now.at[row], now.at[other])
        # where the lead, as it falls, is lost
        here = self.gaps.look(now.place[row], 0 * now.drift[row], now.at[row])
        found_gaps = side_gaps(self.gaps, now, self.gaps.look(now.place, 0 * now.drift, now.at))
        ahead, rate = found_gaps.ahead[row, side], found_gaps.rate[row, side]
        wait = np.where(rate < 0, ahead / np.where(rate < 0, -rate, 1), high - low)
        guess = np.clip(now.at[row] + wait, begin, high)
        away = now.drift[row] * (guess - now.at[row])[:, None]
        spots, height, done = self.gaps.meet(quads, here.place, guess, away)
        valid = done & (height >= begin - LATE) & (height <= high + LATE)
        used: set[int] = set()
        flipped = False
        # sides share their four labels where one label lies on both sides of a junction: the shorter edge vanishes
        far = self.gaps.look(now.place[other], 0 * now.drift[other], now.at[other])
        length = np.linalg.norm(far.point - here.point, axis=1)
        for k in np.lexsort((length, np.where(valid, height, np.inf).round(ALIKE))).tolist():
            t, u = int(row[k]), int(other[k])
            free = not used & {t, u}
            used |= {t, u}
            if not valid[k] or not free:
                continue
            self._close(float(height[k]), now.around(t, int(side[k])))
            now.flip(t, int(side[k]), self.lives, float(height[k]))
            self.lives, flipped = self.lives + 1, True
            now.place[[t, u]], now.at[[t, u]], known[[t, u]] = spots.place[k], height[k], False
            self.flips.append(Flips(quads[[k]], spots.point[[k]], height[[k]]))
        if flipped:
            self._turn()
        return flipped

    def _turn(self) -> None:
        """Find the drift of all junctions anew, where they are."""
        now = self.now
        now.drift = side_gaps(self.gaps, now, self.gaps.look(now.place, 0 * now.drift, now.at)).drift

    def _close(self, high: float, sides: list[tuple[int, int]] | None = None) -> None:
        """Note the edges of some sides, or of all, as they were up to a height."""
        now = self.now
        row, side = now.edges() if sides is None else map(np.array, zip(*sides, strict=True))
        there = now.beside[row, side] >= 0
        row, side = row[there], side[there]
        ends = np.stack([row, now.beside[row, side]], axis=1)
        self.pieces.append(Pieces(now.quads(row, side), now.place[ends], now.at[ends], now.drift[ends],
                                  now.since[row, side].copy(), np.full(len(row), high),
                                  now.life[row, side].copy()))  # fmt: skip

    def _may_return(self, begun: Junctions, before: SideGaps, after: SideGaps, step: float) -> bool:
        """Whether a side that has not flipped may have flipped and flipped back, by the cubic through both layers."""
        now = self.now
        same = (now.at == begun.at)[:, None] & (now.at == begun.at)[np.maximum(now.beside, 0)]
        same &= (begun.labels == now.labels).all(axis=1)[:, None] & np.isfinite(before.ahead)
        start, end = before.ahead[same], after.ahead[same]
        tie = TIE * self.gaps.size
        first, last = step * before.rate[same], step * after.rate[same]
        share = np.linspace(0, 1, 17)[1:-1, None]
        cubic = ((1 + 2 * share) * start + share * first) * (1 - share) ** 2
        cubic += ((3 - 2 * share) * end + (share - 1) * last) * share**2
        return bool(((cubic.min(axis=0, initial=np.inf) < -tie) & (start > tie) & (end > tie)).any())


def failing(
    gaps: LayerGaps, now: Junctions, found_gaps: SideGaps, done: Bool[np.ndarray, " t"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """The sides whose far label is nearer than the junction's own, or that end at a junction which is not known."""
    row, side = now.edges()
    other, back = now.beside[row, side], now.side[row, side]
    quads = now.quads(row, side)
    able = (quads[:, 2] != quads[:, 3]) & (quads[:, 2:].min(axis=1) < gaps.count)
    tie = -TIE * gaps.size
    behind = (
        ~((found_gaps.ahead[row, side] >= tie) & (found_gaps.ahead[other, back] >= tie)) | ~done[row] | ~done[other]
    )
    return row[able & behind], side[able & behind]


def rise(gaps: LayerGaps, junctions: Junctions) -> Rise:
    """Follow the cells from the apical surface, where the junctions are nearly known, to the basal one.

    Raises `ValueError` where that can't be done.
    """
    climb = _Climb(gaps, junctions)
    climb.settle()
    apical, low, step = climb.now.copy(), 0.0, 1 / STEPS
    while low < 1:
        high = min(1.0, low + step)
        if climb.step(low, high, step <= LEAST):
            low, step = high, min(2 * step, 1 / STEPS)
        else:
            step /= 2
        if climb.forced > FORCED or len(climb.unexplained) > gaps.count:
            told = (
                f"the contacts of {cell_names(climb.unexplained, gaps.count)} can't be followed beyond height {low:.3g}"
            )
            why = "they may wrap around the tissue there, or their backbones nearly cross"
            raise ValueError(f"{told}; {why}: use more cells, or separate these")
    pieces = Pieces(*(np.concatenate(parts) for parts in zip(*climb.pieces, strict=True)))
    none = Flips(np.zeros((0, 4), int), np.zeros((0, 3)), np.zeros(0))
    flips = Flips(*(np.concatenate(parts) for parts in zip(none, *climb.flips, strict=True)))
    return Rise(apical, climb.now, pieces, flips, climb.unexplained)


def cell_names(labels: list[Int[np.ndarray, " k"]], count: int) -> str:
    """The first few cells among labels, as messages name them."""
    found = np.unique(np.concatenate([*labels, np.zeros(0, int)]))
    found = found[found < count].tolist()
    return f"cells {', '.join(map(str, found[:NAMED]))}{' and others' if len(found) > NAMED else ''}"
