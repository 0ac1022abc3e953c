"""Statistics of connectivity: cases counted by hand, identities on random and even tissue, the graph."""

import math

import networkx as nx
import numpy as np
import pytest

from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.contacts import Contacts
from jaxtissue.topology.neighbor_law import NeighborLaw, bound_ratios, fit_neighbor_law
from jaxtissue.topology.statistics import (
    Connectivity,
    find_connectivity,
    polygon_classes,
    summarize_connectivity,
    tabulate_connectivity,
    tissue_graph,
)
from jaxtissue.topology.transitions import CellForms, Transitions

TUBE, CELLS = Tube(15, 1, 10), 60


@pytest.fixture(scope="module")
def tissues():
    """Positions and connectivity of a random tissue, and of one whose cells are about even."""
    draw, (ring, place) = np.random.default_rng(5), np.divmod(np.arange(CELLS), 6)
    lattice = np.stack([1.5 * ring + 0.75, (place + ring % 2 / 2) * math.pi / 3], axis=1)
    places = {
        "random": draw.uniform([0, 0], [15, 2 * math.pi], (CELLS, 2)),
        "even": lattice + 0.15 * draw.normal(size=(CELLS, 2)),
    }
    return {name: (place, find_connectivity(place, TUBE)) for name, place in places.items()}


def built(pairs, kinds, transitions, is_end, rings=(), pieces=None):
    """A connectivity made by hand; walls of area 1, 2, ..."""
    count, n = len(pairs), len(is_end)
    ones = np.ones(count)
    contacts = Contacts(n, np.array(pairs), ones.cumsum(), ones, 2 * ones, np.array(kinds), ones.astype(int))
    four = np.array(transitions, int).reshape(-1, 4)
    found = Transitions(np.zeros((len(four), 3)), four, np.bincount(four.ravel(), minlength=n), 0)
    forms = CellForms(np.isin(np.arange(n), rings), np.ones(n, int) if pieces is None else np.array(pieces))
    return Connectivity(contacts, found, forms, np.array(is_end))


# a wheel: 0 in the middle of 1, 2, 3, 4, and 5 outside, beside 4; 1 and 3 meet inside only
WHEEL = built(
    [(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (2, 3), (3, 4), (4, 5)],
    ["apical_basal"] * 4 + ["apical", "internal", "basal", "apical_basal", "apical_basal"],
    [(0, 1, 2, 3), (0, 1, 2, 3), (0, 1, 3, 4)],
    [False] * 5 + [True],
    rings=[5],
    pieces=[1, 1, 2, 1, 1, 1],
)


def test_a_wheel_is_summarized_as_counted_by_hand():
    columns = tabulate_connectivity(WHEEL)
    assert list(columns) == [
        *("neighbors", "apical_basal_neighbors", "apical_neighbors", "basal_neighbors"),
        *("internal_neighbors", "transitions", "is_scutoid", "is_ring", "pieces"),
    ]
    assert columns["neighbors"].tolist() == [4, 3, 3, 4, 3, 1]
    assert columns["internal_neighbors"].tolist() == [0, 1, 0, 1, 0, 0]
    assert columns["transitions"].tolist() == [3, 3, 2, 3, 1, 0]
    assert columns["is_scutoid"].tolist() == [True] * 5 + [False]
    everywhere, inner = summarize_connectivity(WHEEL), summarize_connectivity(WHEEL, inner_only=True)
    assert everywhere == pytest.approx(
        {
            "neighbors": 18 / 6,
            "apical_basal_neighbors": 12 / 6,
            "apical_neighbors": 2 / 6,
            "basal_neighbors": 2 / 6,
            "internal_neighbors": 2 / 6,
            "apical_degree": 14 / 6,
            "basal_degree": 14 / 6,
            "transitions": 12 / 6,
            "transitions_max": 3,
            "scutoid_fraction": 5 / 6,
            "internal_fraction": 2 / 6,
            "ring_fraction": 1 / 6,
            "detached_fraction": 1 / 6,
            "identity_residual": (18 - 14 - 6) / 6,
        },
        rel=1e-12,
    )
    assert list(everywhere) == list(inner)
    # the contact of 4 with 5 still counts for 4
    assert (inner["neighbors"], inner["transitions"], inner["ring_fraction"]) == (17 / 5, 12 / 5, 0)


def test_no_inner_cells_leave_no_means():
    alone = find_connectivity([[5, 1]], Tube(10, 1, 2))
    assert alone.is_end.tolist() == [True]
    assert summarize_connectivity(alone)["neighbors"] == 0
    assert all(math.isnan(value) for value in summarize_connectivity(alone, inner_only=True).values())
    assert len(polygon_classes(alone, [1.0])["sides"]) == 0
    assert polygon_classes(alone, [1.0], inner_only=False)["sides"].tolist() == [0]


def test_classes_of_a_wheel_are_those_counted_by_hand():
    areas = [6.0, 2, 2, 3, 3, 2]
    table = polygon_classes(WHEEL, areas, "apical", inner_only=False)
    # apical sides of 0 to 5: 4, 2, 2, 2, 3, 1
    assert table["sides"].tolist() == [1, 2, 3, 4]
    assert table["count"].tolist() == [1, 3, 1, 1]
    np.testing.assert_allclose(table["fraction"], np.array([1, 3, 1, 1]) / 6)
    np.testing.assert_allclose(table["relative_area"], np.array([2, 7 / 3, 3, 6]) / 3)
    # of the class of two, 1: (4, 2), 2: (4, 2), 3: (4, 3); 4: (4, 2, 1); 0: (2, 2, 2, 3)
    np.testing.assert_allclose(table["neighbor_sides"], [3, 19 / 6, 7 / 3, 9 / 4])
    np.testing.assert_allclose(table["sides_times_neighbor_sides"], [3, 19 / 3, 7, 9])
    inner = polygon_classes(WHEEL, areas, "apical")
    assert inner["count"].tolist() == [3, 1, 1] and inner["sides"].tolist() == [2, 3, 4]
    # 5 is no neighbor of 4 now, but still one of its sides
    np.testing.assert_allclose(inner["neighbor_sides"], [19 / 6, 3, 9 / 4])
    np.testing.assert_allclose(inner["relative_area"], np.array([7 / 3, 3, 6]) / 3.2)
    assert polygon_classes(WHEEL, areas, "all")["sides"].tolist() == [3, 4]
    assert polygon_classes(WHEEL, areas, "basal")["count"].tolist() == [1, 1, 2, 1]
    with pytest.raises(ValueError, match="'lateral'"):
        polygon_classes(WHEEL, areas, "lateral")
    with pytest.raises(ValueError, match="6 cells"):
        polygon_classes(WHEEL, areas[1:])


def test_a_staggered_lattice_is_made_of_hexagons():
    beside = [(12 * row + k, 12 * row + (k + 1) % 12) for row in range(5) for k in range(12)]
    above = [(12 * row + k, 12 * row + 12 + (k + turn) % 12) for row in range(4) for k in range(12)
             for turn in ((0, 1) if row % 2 else (-1, 0))]  # fmt: skip
    pairs = np.sort(beside + above, axis=1)
    lattice = built(pairs, ["apical_basal"] * len(pairs), [], [k // 12 in (0, 4) for k in range(60)])
    for surface in ("apical", "basal", "all"):
        inner = polygon_classes(lattice, np.ones(60), surface)
        assert [inner[name].tolist() for name in ("sides", "count", "neighbor_sides")] == [[6], [36], [6]]
        table = polygon_classes(lattice, np.ones(60), surface, inner_only=False)
        assert table["sides"].tolist() == [4, 6] and table["count"].tolist() == [24, 36]
        # an end cell meets two of four sides and two of six; of three inner rows one meets no end cells
        np.testing.assert_allclose(table["neighbor_sides"], [5, (24 * 32 + 12 * 36) / 216])
    summary = summarize_connectivity(lattice, inner_only=True)
    assert (summary["neighbors"], summary["apical_degree"], summary["identity_residual"]) == (6, 6, 0)


@pytest.mark.parametrize("name", ["random", "even"])
def test_sums_and_identities(tissues, name):
    _, tissue = tissues[name]
    summary, contacts = summarize_connectivity(tissue), tissue.contacts
    twice = -2 * (contacts.pieces - 1).sum() / CELLS  # pairs that touch in two places
    assert summary["identity_residual"] == pytest.approx(twice, abs=0.02)
    kinds = ("apical_basal", "apical", "basal", "internal")
    parts = [summary[f"{kind}_neighbors"] for kind in kinds]
    assert summary["neighbors"] == pytest.approx(sum(parts)) and all(0 < part < 6 for part in parts)
    areas = np.random.default_rng(1).uniform(1, 2, CELLS)
    for surface, chosen in (("apical", kinds[:2]), ("basal", kinds[::2]), ("all", kinds)):
        table = polygon_classes(tissue, areas, surface, inner_only=False)
        assert table["count"] @ table["sides"] == 2 * np.isin(contacts.kind, chosen).sum()
        assert table["count"].sum() == CELLS and table["fraction"].sum() == pytest.approx(1)
        assert table["fraction"] @ table["relative_area"] == pytest.approx(1)
        # Weaire's sum rule: sum of n m(n) = sum of n^2 over the cells
        weighed = table["count"] @ table["sides_times_neighbor_sides"]
        assert weighed == pytest.approx(table["count"] @ table["sides"] ** 2)
        inner = polygon_classes(tissue, areas, surface)
        assert inner["count"].sum() == (~tissue.is_end).sum() and 0 < inner["count"].sum() < CELLS


def test_the_inner_cells_have_no_point_of_an_end(tissues):
    place, tissue = tissues["random"]
    radius, angle = np.meshgrid(np.linspace(1, 10, 40), np.linspace(0, 2 * math.pi, 241))
    turn = angle.ravel()[:, None] - place[:, 1]
    foot = np.maximum(radius.ravel()[:, None] * np.cos(turn), 1)
    across = radius.ravel()[:, None] ** 2 + foot**2 - 2 * radius.ravel()[:, None] * foot * np.cos(turn)
    owners = {int(k) for end in (0, 15) for k in ((place[:, 0] - end) ** 2 + across).argmin(axis=1)}
    marked = set(np.flatnonzero(tissue.is_end).tolist())
    # cells too small on the end plane for the grid are marked all the same
    assert owners <= marked and len(marked - owners) <= 2


def test_order_and_full_turns_change_nothing(tissues):
    place, tissue = tissues["random"]
    order = np.random.default_rng(2).permutation(CELLS)
    moved = place[order] + np.array([0, 2 * math.pi]) * np.arange(-2, CELLS - 2)[:, None]
    other = find_connectivity(moved, TUBE)
    for inner_only in (False, True):
        before, after = (summarize_connectivity(one, inner_only) for one in (tissue, other))
        assert after == pytest.approx(before, abs=1e-12)
    columns, renamed = tabulate_connectivity(tissue), tabulate_connectivity(other)
    for name, column in columns.items():
        np.testing.assert_array_equal(renamed[name], column[order], err_msg=name)
    np.testing.assert_array_equal(other.is_end, tissue.is_end[order])
    areas = np.arange(1.0, CELLS + 1)
    before, after = polygon_classes(tissue, areas), polygon_classes(other, areas[order])
    for name, column in before.items():
        np.testing.assert_allclose(after[name], column, rtol=1e-12, err_msg=name)
    for one, two in zip(bound_ratios(place, TUBE, tissue), bound_ratios(moved, TUBE, other), strict=True):
        assert one["measured"] == two["measured"] and one["ratio"] == pytest.approx(two["ratio"], rel=1e-4)


def test_a_threshold_drops_contacts_and_nothing_else(tissues):
    place, tissue = tissues["random"]
    large, walls = find_connectivity(place, TUBE, 0.1), tissue.contacts
    kept = walls.area >= 0.1 * walls.area.mean()
    assert large.contacts.pairs.tolist() == walls.pairs[kept].tolist() and 0 < kept.sum() < len(kept)
    assert large.transitions.per_cell.tolist() == tissue.transitions.per_cell.tolist()
    assert large.is_end.tolist() == tissue.is_end.tolist()
    for bad in (-0.1, math.nan):
        with pytest.raises(ValueError, match="fraction of the mean wall"):
            find_connectivity(place, TUBE, bad)


@pytest.mark.parametrize("name", ["random", "even"])
def test_bounds_hold(tissues, name):
    place, tissue = tissues[name]
    rows = bound_ratios(place, TUBE, tissue)
    assert [(row["bound"], row["hops"]) for row in rows] == [
        *(("Lemma 1", 1), ("Lemma 2", 1)),
        *(("Corollary 1", hops) for hops in (1, 2, 3)),
    ]
    ways = dict(nx.all_pairs_shortest_path_length(tissue_graph(tissue)))
    for row in rows:
        reached = [sum(0 < far <= row["hops"] for far in way.values()) for way in ways.values()]
        assert row["measured"] == max(reached)
        assert 0 < row["ratio"] == row["measured"] / row["limit"] <= 1
    gaps = np.abs(np.sin((place[:, None, 1] - place[:, 1]) / 2)) * 2
    apart = np.hypot(place[:, None, 0] - place[:, 0], gaps)[~np.eye(CELLS, dtype=bool)].min()
    phi = rows[0]["tightness"]  # in 32 bits
    reach = 2 * phi + 0.5
    assert rows[0]["limit"] == pytest.approx(8 * reach**3 + 6 * reach**2 * 9 / apart, rel=1e-4)
    assert rows[3]["limit"] == pytest.approx(4 * (4 * phi + 0.5) ** 2)


def test_the_graph_survives_graphml(tissues, tmp_path):
    _, tissue = tissues["random"]
    columns = tabulate_connectivity(tissue) | {"volume": np.linspace(0, 1, CELLS, dtype=np.float32)}
    columns |= {"name": np.array([f'cell <{k}> "é"' for k in range(CELLS)])}
    graph = tissue_graph(tissue, columns)
    nx.write_graphml(graph, tmp_path / "graph.graphml")
    back = nx.read_graphml(tmp_path / "graph.graphml", node_type=int)
    assert dict(back.nodes(data=True)) == dict(graph.nodes(data=True))
    assert {frozenset(pair[:2]): pair[2] for pair in back.edges(data=True)} == {
        frozenset(pair[:2]): pair[2] for pair in graph.edges(data=True)
    }
    assert {type(value) for value in graph.nodes[3].values()} == {int, bool, float, str}
    contacts = tissue.contacts
    assert [graph.degree[k] for k in range(CELLS)] == contacts.degree().tolist()
    first, second = contacts.pairs[7].tolist()
    assert graph.edges[first, second]["area"] == contacts.area[7]
    assert graph.edges[second, first]["kind"] == contacts.kind[7]
    assert list(tissue_graph(tissue).nodes[0]) == list(tabulate_connectivity(tissue))


RATIOS = np.array([1.25, 1.5, 2, 3, 5, 10, 20, 50, 100, 200])


def test_the_law_is_recovered():
    law = NeighborLaw(6, 14.5, 7, 1.1, {}, 0, 1)
    # by hand: s^k / (s^k + m^k)
    assert law(50) == pytest.approx(6 + 8.5 * 50**1.1 / (50**1.1 + 7**1.1))
    order = np.random.default_rng(0).permutation(len(RATIOS))
    for fit in (fit_neighbor_law(RATIOS, law(RATIOS)), fit_neighbor_law(RATIOS[order], law(RATIOS[order]))):
        found = [fit.low, fit.high, fit.middle, fit.steepness]
        np.testing.assert_allclose(found, [6, 14.5, 7, 1.1], rtol=1e-6)
        assert fit.residual < 1e-8 and fit.r2 == pytest.approx(1)
        np.testing.assert_allclose(fit.predict(1000), law(1000))


def test_a_falling_law_is_a_rising_one_upside_down():
    neighbors = NeighborLaw(6, 14.5, 7, 1.1, {}, 0, 1)(RATIOS)
    neighbors += np.random.default_rng(3).normal(0, 0.05, len(RATIOS))
    rising, falling = fit_neighbor_law(RATIOS, neighbors), fit_neighbor_law(RATIOS, 20 - neighbors)
    found = [20 - falling.low, 20 - falling.high, falling.middle, falling.steepness]
    expected = [rising.low, rising.high, rising.middle, rising.steepness]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert falling.standard_errors == pytest.approx(rising.standard_errors, rel=1e-4)
    assert rising.standard_errors["low"] != pytest.approx(rising.standard_errors["high"], rel=0.1)


def test_standard_errors_are_those_of_repeated_measurements():
    law, random = NeighborLaw(6, 14, 7, 1.2, {}, 0, 1), np.random.default_rng(4)
    fits = [fit_neighbor_law(RATIOS, law(RATIOS) + random.normal(0, 0.03, 10)) for _ in range(150)]
    for name, truth in (("low", 6), ("high", 14), ("middle", 7), ("steepness", 1.2)):
        values = np.array([getattr(fit, name) for fit in fits])
        stated = np.mean([fit.standard_errors[name] for fit in fits])
        assert values.std() == pytest.approx(stated, rel=0.25)  # 150 fits: 6 %
        assert abs(values.mean() - truth) < stated
    # ten points less four parameters
    assert np.mean([fit.residual**2 for fit in fits]) == pytest.approx(0.6 * 0.03**2, rel=0.15)
    assert np.mean([fit.r2 for fit in fits]) > 0.999


def test_the_law_fits_the_neighbors_of_random_tissue():
    # measured with the reference at n = 500, three seeds
    ratios, neighbors = [1.25, 2, 5, 10, 50, 200], [6.32, 7.35, 9.33, 10.91, 13.98, 14.57]
    law = fit_neighbor_law(ratios, neighbors)
    assert law.r2 > 0.99 and law.low < 6.32 and 14.57 < law.high < 16
    assert all(0 < error < math.inf for error in law.standard_errors.values())
    exact = fit_neighbor_law(ratios[::2] + ratios[-1:], neighbors[::2] + neighbors[-1:])
    assert exact.residual < 1e-4 and all(map(math.isnan, exact.standard_errors.values()))


@pytest.mark.parametrize(
    ("ratios", "neighbors", "named"),
    [
        ([1, 2, 5], [6, 7, 8], "four"),
        ([1, 2, 5, 5], [6, 7, 8, 8], "four"),
        ([1, 2, 5, 9], [6, 7, 8], "four"),
        ([1, 2, 5, 9], [6, 7, math.nan, 8], "finite"),
        ([0, 2, 5, 9], [6, 7, 7, 8], "above 0"),
        ([1, 2, 5, 9], [6, 6, 6, 6], "the same"),
        ([1, 2, 4, 8, 16], [6, 7, 8.1, 9.4, 11], "levels off"),
    ],
)
def test_what_makes_no_law_is_refused(ratios, neighbors, named):
    with pytest.raises(ValueError, match=named):
        fit_neighbor_law(ratios, neighbors)
