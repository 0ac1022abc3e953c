"""Independent sets: every cell once, no conflict within a set, and graphs as others compute them."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import sparse

from jaxtissue.dynamics.coloring import color, distance_conflicts, hop_conflicts
from jaxtissue.dynamics.independent_sets import cut


def random_graph(n: int, degree: float, seed: int) -> nx.Graph:
    return nx.gnp_random_graph(n, min(1.0, degree / n), seed=seed)


def matrix(graph: nx.Graph) -> sparse.csr_array:
    return nx.to_scipy_sparse_array(graph, dtype=bool, format="csr")


@given(st.integers(1, 60), st.floats(0, 12), st.integers(0, 99), st.integers(1, 20), st.booleans())
def test_rounds_hold_every_cell_once_and_no_conflict(
    n: int, degree: float, seed: int, width: int, given_order: bool
) -> None:
    conflicts = hop_conflicts(matrix(random_graph(n, degree, seed)), 1)
    order = np.random.default_rng(seed).permutation(n) if given_order else None
    rounds = color(conflicts, width, order)
    np.testing.assert_array_equal(rounds, color(conflicts, width, order))
    assert rounds.shape[1] == width
    assert sorted(rounds[rounds >= 0].tolist()) == list(range(n))
    for members in rounds:
        members = members[members >= 0]
        assert len(members) and not conflicts.toarray()[np.ix_(members, members)].any()
    # greedy: a round is skipped only for a conflict or when full
    most = int(conflicts.sum(axis=1).max())
    assert len(rounds) <= most + 1 + n // width


@pytest.mark.parametrize("n", [200, 2000])
def test_rounds_do_not_grow_in_number_along_a_tube(n: int) -> None:
    # everyone conflicts with the 12 next on either side: any 13 in a row need 13 rounds, and those do
    far = abs(np.subtract.outer(np.arange(n), np.arange(n)))
    conflicts = sparse.csr_array((far > 0) & (far <= 12))
    for order in (np.arange(n), np.arange(n)[::-1], None):
        assert len(color(conflicts, -(-n // 13) + 2, order)) == 13


def test_cells_make_room_until_the_smallest_rounds_are_empty() -> None:
    # a chain taken ends first: first fit takes 3 rounds for it, unless an end makes room
    chain = hop_conflicts(matrix(nx.path_graph(4)), 1)
    assert color(chain, 4, np.array([0, 3, 1, 2])).tolist() == [[0, 2, -1, -1], [1, 3, -1, -1]]


@given(st.integers(1, 60), st.integers(1, 9), st.integers(0, 99))
def test_rounds_are_cut_into_stretches_of_the_tube(n: int, pieces: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    axial, round_of = generator.random(n), generator.integers(0, 5, n)
    width = max(np.bincount(round_of))
    rounds = np.full((5, width), -1)
    for number in range(5):
        cells = np.flatnonzero(round_of == number)
        rounds[number, : len(cells)] = cells
    few = cut(rounds, axial, pieces)
    assert few.shape[1] == (width if pieces == 1 else -(-width // pieces))
    assert sorted(few[few >= 0]) == list(range(n))
    ends = dict.fromkeys(range(5), 0.0)
    for row in few[(few >= 0).any(axis=1)]:
        cells = row[row >= 0]
        (number,) = set(round_of[cells])  # what was made in one round before is not mixed with others
        if pieces > 1:
            assert axial[cells].min() > ends[number]
        ends[number] = axial[cells].max()


def test_a_complete_graph_is_visited_one_by_one_and_an_empty_one_at_once() -> None:
    assert len(color(hop_conflicts(matrix(nx.complete_graph(6)), 1), 6)) == 6
    assert color(hop_conflicts(matrix(nx.empty_graph(6)), 3), 6).tolist() == [[0, 1, 2, 3, 4, 5]]


@pytest.mark.parametrize("hops", [1, 2, 3, 4])
@given(st.integers(1, 40), st.floats(0, 4), st.integers(0, 99))
def test_hop_conflicts_are_short_paths(hops: int, n: int, degree: float, seed: int) -> None:
    graph = random_graph(n, degree, seed)
    expected = np.zeros((n, n), bool)
    for cell, near in nx.all_pairs_shortest_path_length(graph, cutoff=hops):
        expected[cell, list(near)] = True
    np.fill_diagonal(expected, False)
    np.testing.assert_array_equal(hop_conflicts(matrix(graph), hops).toarray() != 0, expected)


@given(st.integers(1, 40), st.floats(0.01, 2), st.integers(0, 99))
def test_distance_conflicts_are_close_pairs(n: int, distance: float, seed: int) -> None:
    places = np.random.default_rng(seed).normal(size=(n, 3))
    gap = np.linalg.norm(places[:, None] - places, axis=-1)
    expected = (gap <= distance) & ~np.eye(n, dtype=bool)
    np.testing.assert_array_equal(distance_conflicts(places, distance).toarray() != 0, expected)
