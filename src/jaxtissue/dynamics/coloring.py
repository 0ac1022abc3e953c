"""Independent sets of moves: a conflict graph, and its coloring into rounds (paper, section 3.3)."""

import numpy as np
from jaxtyping import Int
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import KDTree

CONFLICTS = ("near", "2-hop", "3-hop", "4-hop", "8-phi")  # rules of which moves may be made together
REHOUSED = 2  # most cells that make room for another when rounds are emptied: 3 spare no further round


def hop_conflicts(contacts: sparse.csr_array, hops: int) -> sparse.csr_array:
    """Moves conflict if their cells are within `hops` contacts: [n, n], symmetric, no diagonal."""
    n = len(contacts.indptr) - 1
    one = sparse.csr_array(contacts.astype(bool) + sparse.eye_array(n, dtype=bool))
    reached = one
    for _ in range(hops - 1):
        reached = sparse.csr_array(reached @ one)  # of bools: "or", which does not overflow
    off = reached.indices != np.repeat(np.arange(n, dtype=np.int32), np.diff(reached.indptr))
    others = reached.indices[off]
    start = reached.indptr - np.arange(n + 1, dtype=reached.indptr.dtype)
    return sparse.csr_array((np.ones(len(others), bool), others, start), shape=(n, n))


def distance_conflicts(apical_places: np.ndarray, distance: float) -> sparse.csr_array:
    """Moves conflict if their apical ends, [n, 3], are closer than `distance`: the paper's 8 phi."""
    pairs = KDTree(apical_places).query_pairs(distance, output_type="ndarray")
    n = len(apical_places)
    half = sparse.coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    return sparse.csr_array(half + half.T)


def color(
    conflicts: sparse.csr_array, width: int, order: Int[np.ndarray, "n"] | None = None
) -> Int[np.ndarray, "rounds width"]:
    """Rounds of at most `width` moves without conflict, padded with -1.

    Cells are taken in `order`, best along the tube; without one the graph gives the order. Each joins the first round
    that it may. Then the smallest rounds are emptied, one after the other, as long as all their cells find room
    elsewhere.

    >>> ring = sparse.csr_array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1], [1, 0, 1, 0]])
    >>> color(ring, 2, np.arange(4)).tolist()
    [[0, 2], [1, 3]]
    """
    if order is None:
        order = reverse_cuthill_mckee(sparse.csr_matrix(conflicts), symmetric_mode=True)
    plan = _Rounds(conflicts, width)
    plan.fill(np.asarray(order))
    while plan.drop_smallest():
        pass
    chosen = np.unique(np.array([one.bit_length() for one in plan.round_of], int), return_inverse=True)[1]
    n = len(chosen)
    rounds = np.full((chosen.max(initial=-1) + 1, width), -1, np.int32)
    order = np.argsort(chosen, kind="stable")
    rounds[chosen[order], np.arange(n) - np.searchsorted(chosen[order], chosen[order])] = order
    return rounds


class _Rounds:
    """Rounds in the making; each is one bit of an integer, so that what is barred is a union of bits."""

    def __init__(self, conflicts: sparse.csr_array, width: int) -> None:
        self.start, self.others, self.width = conflicts.indptr, conflicts.indices, width
        self.round_of = [0] * (len(self.start) - 1)
        self.sizes: dict[int, int] = {}
        self.full = 0

    def fill(self, order: Int[np.ndarray, "n"]) -> None:
        """Put each cell into the first round that holds none of its conflicts and its share of cells so far.

        That share grows with the cells placed: were all rounds filled from the first to the last, the early
        ones would be full before the order gets to the far end of the tube.
        """
        round_of, sizes, width, n = self.round_of, self.sizes, self.width, len(order)
        share, step, closed = 1, max(1, n // width), 0
        for count, (cell, before) in enumerate(zip(order.tolist(), self._earlier(order), strict=True), 1):
            if count % step == 0 and share < width:
                share += 1
                closed = sum(one for one, size in sizes.items() if size >= share)
            barred = closed
            for other in before:
                barred |= round_of[other]
            one = ~barred & (barred + 1)
            round_of[cell] = one
            sizes[one] = sizes.get(one, 0) + 1
            if sizes[one] >= share:
                closed |= one
        self.full = sum(one for one, size in sizes.items() if size >= width)

    def _earlier(self, order: Int[np.ndarray, "n"]) -> list[list[int]]:
        """The conflicts of each cell that were placed before it, in order."""
        n = len(order)
        rank = np.empty(n, np.int32)
        rank[order] = np.arange(n, dtype=np.int32)
        own = np.repeat(rank, np.diff(self.start))
        early = rank[self.others] < own
        counts = np.bincount(own[early], minlength=n)
        sorted_others = self.others[early][np.argsort(own[early], kind="stable")].tolist()
        ends = np.cumsum(counts).tolist()
        return [sorted_others[a:b] for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def _conflicts(self, cell: int) -> list[int]:
        return self.others[self.start[cell] : self.start[cell + 1]].tolist()

    def drop_smallest(self) -> bool:
        """Spread the cells of the smallest round over the others, if all find room there."""
        if len(self.sizes) < 2:
            return False
        last = min(self.sizes, key=lambda one: (self.sizes[one], -one))
        moved: list[tuple[int, int]] = []
        for cell in [cell for cell, one in enumerate(self.round_of) if one == last]:
            if not self._rehouse(cell, last, moved):
                self._take_back(moved, 0)
                return False
        del self.sizes[last]
        return True

    def _rehouse(self, cell: int, last: int, moved: list[tuple[int, int]]) -> bool:
        """Move a cell out of round `last`, and up to REHOUSED of its conflicts out of its way."""
        rivals: dict[int, list[int]] = {}
        for other in self._conflicts(cell):
            rivals.setdefault(self.round_of[other], []).append(other)
        for one in self.sizes:
            here = rivals.get(one, [])
            if one == last or len(here) > REHOUSED or self.sizes[one] - len(here) >= self.width:
                continue
            before = len(moved)
            if all(self._find_home(other, one | last, moved) for other in here):
                self._move(cell, one, moved)
                return True
            self._take_back(moved, before)
        return False

    def _find_home(self, cell: int, barred: int, moved: list[tuple[int, int]]) -> bool:
        """Move a cell to the first round that it may join as it is; whether there was one."""
        barred |= self.full
        for other in self._conflicts(cell):
            barred |= self.round_of[other]
        home = next((one for one in self.sizes if not one & barred), 0)
        if home:
            self._move(cell, home, moved)
        return home > 0

    def _move(self, cell: int, one: int, moved: list[tuple[int, int]]) -> None:
        moved.append((cell, self.round_of[cell]))
        self._put(cell, one)

    def _take_back(self, moved: list[tuple[int, int]], keep: int) -> None:
        """Undo the moves but the first `keep`."""
        while len(moved) > keep:
            self._put(*moved.pop())

    def _put(self, cell: int, one: int) -> None:
        left = self.round_of[cell]
        self.round_of[cell] = one
        self.sizes[left] -= 1
        self.sizes[one] += 1
        self.full = (self.full & ~left) | (one if self.sizes[one] >= self.width else 0)
