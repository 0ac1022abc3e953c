"""The cells of one layer as a map: junctions, where three labels meet, each beside three others, and their exchanges.

The map of labels with a row for each junction is a triangulation, the dual of the cells. Side k of a junction is the
edge that its label k does not touch; when the edge of two cells shrinks to a point and two others come to touch, the
side flips.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int


@dataclass
class Junctions:
    """The junctions of a layer, [t], counterclockwise.

    Attributes:
        labels: The three labels that meet, [t, 3].
        beside: The junction at the other end of each side's edge, [t, 3]; -1 beyond the corner of a sheet.
        side: The side of that junction which is the same edge, [t, 3].
        place: Where they are on the base surface, [t, d], at the height `at`.
        at: [t].
        drift: How they move with the height there, in local coordinates, [t, 2].
        life: The number of the edge of each side, [t, 3], which it keeps as long as it is there.
        since: The height from which the edge has had both of its ends, [t, 3].
    """

    labels: Int[np.ndarray, "t 3"]
    beside: Int[np.ndarray, "t 3"]
    side: Int[np.ndarray, "t 3"]
    place: Float[np.ndarray, "t d"]
    at: Float[np.ndarray, " t"]
    drift: Float[np.ndarray, "t 2"]
    life: Int[np.ndarray, "t 3"]
    since: Float[np.ndarray, "t 3"]

    def copy(self) -> "Junctions":
        """The same junctions, in arrays of their own."""
        return Junctions(*(getattr(self, field.name).copy() for field in fields(self)))

    def edges(self) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
        """Each edge once, as a junction and its side."""
        row, side = np.nonzero(self.beside >= 0)
        other, back = self.beside[row, side], self.side[row, side]
        once = (row < other) | ((row == other) & (side < back))
        return row[once], side[once]

    def quads(self, row: Int[np.ndarray, " e"], side: Int[np.ndarray, " e"]) -> Int[np.ndarray, "e 4"]:
        """The two labels of edges, and then those at their ends."""
        ends = self.labels[self.beside[row, side], self.side[row, side]]
        own = self.labels[row]
        pick = np.arange(len(row))
        return np.stack([own[pick, (side + 1) % 3], own[pick, (side + 2) % 3], own[pick, side], ends], axis=1)

    def around(self, row: int, side: int) -> list[tuple[int, int]]:
        """The side itself and the four others of both of its junctions."""
        other, back = int(self.beside[row, side]), int(self.side[row, side])
        turns = [(row, (side + k) % 3) for k in (0, 1, 2)]
        return turns + [(other, (back + k) % 3) for k in (1, 2)]

    def flip(self, row: int, side: int, life: int, height: float) -> None:
        """Let the labels at the ends of an edge touch in place of its own, from this height on."""
        other, back = int(self.beside[row, side]), int(self.side[row, side])
        p, a, b = (self.labels[row, (side + k) % 3] for k in range(3))
        q = self.labels[other, back]
        kept = [(row, (side + 1) % 3), (row, (side + 2) % 3), (other, (back + 1) % 3), (other, (back + 2) % 3)]
        links = [(int(self.beside[t, k]), int(self.side[t, k]), int(self.life[t, k])) for t, k in kept]
        # (b, p), (p, a), (a, q), (q, b) come to stand in (p, a, q) and (q, b, p)
        places = [(other, 0), (row, 2), (row, 0), (other, 2)]
        moved = dict(zip(kept, places, strict=True))
        self.labels[row], self.labels[other] = (p, a, q), (q, b, p)
        for (t, k), (far, far_side, own_life) in zip(places, links, strict=True):
            far, far_side = moved.get((far, far_side), (far, far_side))
            self.beside[t, k], self.side[t, k], self.life[t, k] = far, far_side, own_life
            self.since[t, k] = height
            if far >= 0:
                self.beside[far, far_side], self.side[far, far_side] = t, k
                self.since[far, far_side] = height
        for t, far in ((row, other), (other, row)):
            self.beside[t, 1], self.side[t, 1], self.life[t, 1], self.since[t, 1] = far, 1, life, height

    def renumber(self, before: "Junctions", free: int) -> tuple[list[Int[np.ndarray, " 2"]], int]:
        """Give edges the numbers that those of the same two labels had before, or numbers from a free one on.

        Returns the two labels of each edge that is new or gone, and the next free number.
        """
        known, changed = dict(zip(before._pairs(), before.life[before.edges()].tolist(), strict=True)), []
        for pair, row, side in zip(self._pairs(), *self.edges(), strict=True):
            life = known.pop(pair, free)
            if life == free:
                changed.append(pair)
                free += 1
            self.life[row, side] = self.life[self.beside[row, side], self.side[row, side]] = life
        return [np.array(pair) for pair in [*changed, *known]], free

    def _pairs(self) -> list[tuple[int, int]]:
        """The two labels of each edge, the lower one first."""
        return [(a, b) for a, b in np.sort(self.quads(*self.edges())[:, :2], axis=1).tolist()]


def joined(labels: Int[np.ndarray, "t 3"], ways: Int[np.ndarray, "t 3"], twins: dict[int, int]) -> Junctions:
    """Junctions with the numbers of the ways from label k to k + 1, and of the ways back that there are.

    Where they are is not known yet.
    """
    where = {int(way): (t, (k + 2) % 3) for t, row in enumerate(ways) for k, way in enumerate(row)}
    beside, side = np.full(labels.shape, -1), np.full(labels.shape, -1)
    for way, (t, k) in where.items():
        if twins.get(way) in where:
            beside[t, k], side[t, k] = where[twins[way]]
    count = len(labels)
    life = np.arange(3 * count).reshape(count, 3)
    row, k = np.nonzero(beside >= 0)
    life[row, k] = np.minimum(life[row, k], life[beside[row, k], side[row, k]])
    return Junctions(labels, beside, side, np.zeros((count, 0)), np.zeros(count), np.zeros((count, 2)), life,
                     np.zeros((count, 3)))  # fmt: skip
