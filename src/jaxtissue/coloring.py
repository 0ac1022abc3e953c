"""Independent sets of moves: a conflict graph, and its coloring into rounds (paper, section 3.3)."""

import numpy as np
from jaxtyping import Int
from scipy import sparse
from scipy.spatial import KDTree

CONFLICTS = ("near", "2-hop", "3-hop", "4-hop", "8-phi")  # rules of which moves may be made together


def hop_conflicts(contacts: sparse.csr_array, hops: int) -> sparse.csr_array:
    """Moves conflict if their cells are within `hops` contacts: [n, n], symmetric, no diagonal."""
    one = contacts.astype(np.int32)
    reached = one
    for _ in range(hops - 1):
        reached = reached @ one + one
        reached.data[:] = 1
    return _without_diagonal(sparse.csr_array(reached))


def distance_conflicts(apical_places: np.ndarray, distance: float) -> sparse.csr_array:
    """Moves conflict if their apical ends, [n, 3], are closer than `distance`: the paper's 8 phi."""
    pairs = KDTree(apical_places).query_pairs(distance, output_type="ndarray")
    n = len(apical_places)
    half = sparse.coo_array((np.ones(len(pairs), np.int32), (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    return half + half.T


def _without_diagonal(graph: sparse.csr_array) -> sparse.csr_array:
    rows, columns = graph.nonzero()
    off = rows != columns
    return sparse.coo_array(
        (np.ones(off.sum(), np.int32), (rows[off], columns[off])), shape=graph.shape
    ).tocsr()


def color(conflicts: sparse.csr_array, width: int) -> Int[np.ndarray, "rounds width"]:
    """Rounds of at most `width` moves without conflict, padded with -1: greedy, most conflicts first.

    Each cell joins the first round that is not full and holds none of its conflicts.
    """
    n = len(conflicts.indptr) - 1
    start, others = conflicts.indptr, conflicts.indices
    chosen = np.full(n, -1)
    filled = np.zeros(n + 1, int)
    closed = np.zeros(n + 1, bool)
    for cell in np.argsort(-np.diff(start), kind="stable"):
        taken = chosen[others[start[cell] : start[cell + 1]]]
        barred = closed.copy()
        barred[taken[taken >= 0]] = True
        pick = int(np.argmin(barred))
        chosen[cell] = pick
        filled[pick] += 1
        closed[pick] = filled[pick] == width
    rounds = np.full((chosen.max(initial=-1) + 1, width), -1, np.int32)
    order = np.argsort(chosen, kind="stable")
    place = np.arange(n) - np.searchsorted(chosen[order], chosen[order])
    rounds[chosen[order], place] = order
    return rounds
