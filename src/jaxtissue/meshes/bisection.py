"""Finer tetrahedra where they are asked for: edges are halved, the longest first, so that all still fit together.

A simplex with an edge to be halved has its longest edge halved first (Rivara 1984). That edge is halved in all
simplices round it, which may ask for edges that are longer still, so that this ends. Lengths are those in the grid, in
steps: the simplices then keep to a few shapes, and what is asked for in one place does not spread far.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.meshes.domain_grid import Prisms
from jaxtissue.meshes.grid import Grid

EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
TOTAL = 2**31  # more than there are nodes
_SIDES = np.array([[0, 1], [1, 2], [0, 2]])


def edge_keys(ends: Int[np.ndarray, "*m 2"], total: int = TOTAL) -> Int[np.ndarray, "*m"]:
    """One number for the two ends of an edge, whatever their order, below `total` each."""
    return ends.min(axis=-1) * total + ends.max(axis=-1)


class Bisection:
    """The tetrahedra and surface triangles of a grid, which are made finer together."""

    def __init__(self, grid: Grid | Prisms, first_bound: int) -> None:
        self.nodes, self.tetrahedra = grid.nodes, grid.tetrahedra()
        self.surfaces = {first_bound + bound: triangles for bound, triangles in grid.surfaces().items()}
        self._places, self._turns = grid.places(), grid.turns

    def keep(self, near: Bool[np.ndarray, " p"]) -> None:
        """Keep only what has one of these nodes."""
        self.tetrahedra = self.tetrahedra[near[self.tetrahedra].any(axis=1)]
        self.surfaces = {bound: sheet[near[sheet].any(axis=1)] for bound, sheet in self.surfaces.items()}

    def halve(self, chosen: Int[np.ndarray, " m"]) -> Int[np.ndarray, " f"]:
        """Halve the longest edges of the chosen tetrahedra, and what must be halved with them; those that are new."""
        ends = self.tetrahedra[chosen][:, EDGES]
        asked = np.unique(np.take_along_axis(edge_keys(ends), self._longest(ends)[:, None], axis=1))
        keys, middles = np.zeros(0, int), np.zeros(0, int)
        fresh = np.zeros(len(self.tetrahedra), bool)
        while True:
            order = np.argsort(np.append(keys, asked))
            middles = np.append(middles, len(self.nodes) + np.arange(len(asked)))[order]
            keys = np.append(keys, asked)[order]
            one, two = np.divmod(asked, TOTAL)
            self.nodes = np.concatenate([self.nodes, (self.nodes[one] + self.nodes[two]) / 2])
            self._places = np.concatenate([self._places, self._places[one] + self._apart(one, two) / 2])
            near = np.zeros(len(self.nodes), bool)
            near[np.stack(np.divmod(keys, TOTAL))] = True
            self.tetrahedra, asked, split = self._split(self.tetrahedra, EDGES, (keys, middles), near)
            fresh[split] = True
            fresh = np.append(fresh, np.ones(len(split), bool))
            done = not (len(asked) or len(split))
            for bound, triangles in self.surfaces.items():
                self.surfaces[bound], _, split = self._split(triangles, _SIDES, (keys, middles), near)
                done &= not len(split)
            if done:
                return np.flatnonzero(fresh)

    def _split(
        self,
        simplices: Int[np.ndarray, "s k"],
        sides: Int[np.ndarray, "e 2"],
        halved: tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]],
        near: Bool[np.ndarray, " p"],
    ) -> tuple[Int[np.ndarray, "_ k"], Int[np.ndarray, " _"], Int[np.ndarray, " _"]]:
        """The simplices, those parted whose longest edge is halved; other longest edges to halve; what was parted."""
        keys, middles = halved
        row = np.flatnonzero(near[simplices].sum(axis=1) >= 2)
        ends = simplices[row][:, sides]
        key = edge_keys(ends)
        hit = keys[np.minimum(np.searchsorted(keys, key), len(keys) - 1)] == key
        some = hit.any(axis=1)
        row, ends, key, hit = row[some], ends[some], key[some], hit[some]
        longest = self._longest(ends)
        at = np.arange(len(row)), longest
        ready = hit[at]
        middle, parted = middles[np.searchsorted(keys, key[at][ready])], row[ready]
        one, two = sides[longest[ready]].T
        second, simplices = simplices[parted], simplices.copy()
        simplices[parted, one] = middle
        second[np.arange(len(second)), two] = middle
        return np.concatenate([simplices, second]), np.unique(key[at][~ready]), parted

    def _longest(self, ends: Int[np.ndarray, "s e 2"]) -> Int[np.ndarray, " s"]:
        """The longest of the edges of each simplex, and of several the same one in all simplices."""
        size = (self._apart(ends[..., 0], ends[..., 1]) ** 2).sum(axis=-1)
        return np.where(size == size.max(axis=1, keepdims=True, initial=0), edge_keys(ends), -1).argmax(axis=1)

    def _apart(self, one: Int[np.ndarray, "*m"], two: Int[np.ndarray, "*m"]) -> Float[np.ndarray, "*m 3"]:
        """The steps from one node to another, the shorter way round where an axis is closed."""
        apart = self._places[two] - self._places[one]
        return apart - self._turns * np.round(apart / np.maximum(self._turns, 1))
