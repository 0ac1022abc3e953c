"""Contacts where positions are not generic, lattices and round numbers, and in a thin lumen."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxtissue.diagram.exact import exact_cells
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology import edges
from jaxtissue.topology.bisectors import Bisectors
from jaxtissue.topology.contacts import find_contacts
from jaxtissue.topology.edges import _trace, trace_edges
from jaxtissue.topology.statistics import Connectivity, find_connectivity
from jaxtissue.topology.transitions import find_forms, find_transitions

AWKWARD = np.load(Path(__file__).parent / "data" / "degenerate" / "awkward.npz")


def awkward(number: int) -> tuple[np.ndarray, Tube]:
    return AWKWARD[f"positions_{number}"], Tube(*AWKWARD[f"sizes_{number}"])


def lattice(levels: int, around: int, shift: float = 0.0) -> np.ndarray:
    """Levels of so many cells each, every second one turned by a share of the angle between two."""
    level, place = np.meshgrid(np.arange(levels), np.arange(around), indexing="ij")
    angle = (place + shift * (level % 2)) * 2 * math.pi / around
    return np.stack([level.ravel() + 0.5, angle.ravel()], axis=1)


def whole(tissue: Connectivity) -> None:
    """Nothing is lost, nothing detached."""
    assert tissue.transitions.open_ends == 0
    assert set(tissue.forms.pieces.tolist()) == {1} and set(tissue.contacts.pieces.tolist()) <= {1, 2}


@pytest.mark.parametrize("jitter", [0, 1e-13, 1e-11])
@pytest.mark.parametrize("levels, around, tube", [(10, 8, Tube(20, 1, 3)), (3, 3, Tube(3, 0.1, 3))])
def test_a_square_lattice_has_four_neighbors_and_no_transitions(levels, around, tube, jitter):
    places = lattice(levels, around) * [tube.length / levels, 1]
    places += jitter * np.random.default_rng(0).uniform(-1, 1, places.shape)
    tissue = find_connectivity(places, tube)
    contacts, ring = tissue.contacts, np.pi * (tube.basal_radius**2 - tube.apical_radius**2)
    beside = contacts.pairs[:, 0] // around == contacts.pairs[:, 1] // around
    assert (beside.sum(), (~beside).sum()) == (levels * around, (levels - 1) * around)
    flat = tube.length / levels * (tube.basal_radius - tube.apical_radius)
    np.testing.assert_allclose(contacts.area, np.where(beside, flat, ring / around), rtol=1e-6)
    assert set(contacts.kind.tolist()) == {"apical_basal"} and set(contacts.pieces.tolist()) == {1}
    assert tissue.transitions.per_cell.sum() == 0 and not tissue.forms.is_ring.any()
    assert tissue.is_end.sum() == 2 * around
    whole(tissue)


@pytest.mark.parametrize("around, tube", [(3, Tube(5, 0.02, 3)), (4, Tube(5, 1, 3)), (9, Tube(5, 1, 3))])
def test_a_shifted_lattice_is_as_regular_as_it_looks(around, tube):
    places = lattice(5, around, 0.5)
    tissue, exact = find_connectivity(places, tube), exact_cells(places, tube, 60)
    contacts, forms = tissue.contacts, tissue.transitions.per_cell.reshape(5, around)
    assert contacts.pairs.tolist() == exact.pairs[exact.wall_area > 1e-6].tolist()
    # Qhull's facets zigzag: measured 2e-5 of the mean
    area = exact.wall_area[exact.wall_area > 1e-6]
    np.testing.assert_allclose(contacts.area, area, atol=1e-4 * area.mean())
    assert (forms == forms[:, :1]).all() and (forms == forms[::-1]).all()
    per_cell = np.bincount(contacts.pairs.ravel(), np.repeat(contacts.area, 2)).reshape(5, around)
    np.testing.assert_allclose(per_cell, np.tile(per_cell[:, :1], around), rtol=1e-6)
    whole(tissue)


@pytest.mark.parametrize("step, degrees", [(1, 5), (0.5, 1)])
def test_round_numbers_are_no_trouble(step, degrees):
    # a fine lattice of places, most of them empty: ties here and there
    random = np.random.default_rng(3)
    drawn = random.uniform([0, 0], [12 / step, 360 / degrees], (30, 2)).round()
    places = np.unique(drawn % [12 / step + 1, 360 / degrees], axis=0) * [step, math.radians(degrees)]
    tube = Tube(12, 1, 3)
    tissue, exact = find_connectivity(places, tube), exact_cells(places, tube, 30)
    area = exact.wall_area / exact.wall_area.mean()
    found = dict(zip(map(tuple, tissue.contacts.pairs.tolist()), tissue.contacts.area, strict=True))
    assert {tuple(pair) for pair in exact.pairs[area > 1e-3].tolist()} <= found.keys()
    assert {pair for pair, size in found.items() if size > 1e-3 * exact.wall_area.mean()} <= set(
        map(tuple, exact.pairs.tolist())
    )
    same = [found.get(tuple(pair), 0) for pair in exact.pairs.tolist()]
    np.testing.assert_allclose(same, exact.wall_area, atol=1e-3 * exact.wall_area.mean())
    whole(tissue)


def test_mirror_images_make_mirror_images():
    half = np.random.default_rng(2).uniform([0, 0], [8, math.pi], (12, 2))
    tissue = find_connectivity(np.concatenate([half, half * [1, -1]]), Tube(8, 1, 4))
    contacts, image = tissue.contacts, np.roll(np.arange(24), 12)
    row = np.lexsort(np.sort(image[contacts.pairs], axis=1).T[::-1])
    np.testing.assert_array_equal(np.sort(image[contacts.pairs], axis=1)[row], contacts.pairs)
    np.testing.assert_allclose(contacts.area[row], contacts.area, atol=1e-6 * contacts.area.mean())
    np.testing.assert_array_equal(tissue.transitions.per_cell[image], tissue.transitions.per_cell)
    whole(tissue)


def compare_walls(places: np.ndarray, tube: Tube, samples: int) -> None:
    """The same walls as on the exact path, to 1 % of the mean."""
    contacts, exact = find_contacts(places, tube), exact_cells(places, tube, samples)
    large = exact.wall_area > 3e-3 * exact.wall_area.mean()
    found = dict(zip(map(tuple, contacts.pairs.tolist()), contacts.area, strict=True))
    same = [found.pop(tuple(pair), 0) for pair in exact.pairs.tolist()]
    np.testing.assert_allclose(same, exact.wall_area, atol=1e-2 * exact.wall_area.mean())
    assert large.sum() <= len(contacts.pairs) and sum(found.values()) < 1e-2 * exact.wall_area.mean()


def test_a_wall_from_end_to_end_is_found():
    places = np.array([[2.87, 0.76], [1.74, 4.45], [0.46, 0.84], [1.88, 0.67], [2.76, 4.36], [0.37, 4.31]])
    contacts = find_contacts(places, Tube(3.06, 8.75, 10))
    wall = (contacts.pairs == [1, 3]).all(axis=1)
    assert contacts.area[wall] == pytest.approx([3.8251371], rel=1e-6)
    compare_walls(places, Tube(3.06, 8.75, 10), 60)


def test_a_wall_that_folds_in_a_thin_lumen_has_its_area():
    contacts = find_contacts([[19.665, 6.07], [19.724, 0.052]], Tube(27.19, 0.0483, 10))
    assert contacts.area == pytest.approx([616.8432], rel=1e-6)  # exact path, extrapolated


@pytest.mark.parametrize("number", [448, 361, 1738])
def test_walls_in_a_thin_lumen_have_their_areas(number):
    compare_walls(*awkward(number), 50)


def count_parts(places: np.ndarray, tube: Tube, layers: int, lines: int) -> np.ndarray:
    """Connected parts of the cells by brute force: their intervals on lines along the axis.

    Intervals are joined where those of neighboring lines overlap.
    """
    n, axial = len(places), places[:, 0]
    radius = np.linspace(tube.apical_radius, tube.basal_radius, layers)[:, None, None]
    turn = (np.arange(lines) * 2 * np.pi / lines)[:, None] - places[:, 1]
    foot = np.maximum(radius * np.cos(turn), tube.apical_radius)
    square = radius**2 - foot * (2 * radius * np.cos(turn) - foot)
    low, high = np.zeros((n, layers, lines)), np.full((n, layers, lines), float(tube.length))
    for cell in range(n):
        gap = axial - axial[cell]
        with np.errstate(divide="ignore", invalid="ignore"):
            place = (axial + axial[cell]) / 2 + (square - square[..., cell, None]) / (2 * gap)
        high[cell] = np.minimum(high[cell], np.where(gap > 0, place, np.inf).min(axis=-1))
        low[cell] = np.maximum(low[cell], np.where(gap < 0, place, -np.inf).max(axis=-1))
        high[cell][((gap == 0) & (square < square[..., cell, None])).any(axis=-1)] = -1
    count = np.zeros(n, int)
    node = np.arange(layers * lines).reshape(layers, lines)
    for cell in range(n):
        links = []
        for axis, others in ((0, node[1:]), (1, np.roll(node, -1, axis=1))):
            one, two = (
                (low[cell], high[cell]),
                tuple(np.roll(x, -1, axis=axis) for x in (low[cell], high[cell])),
            )
            over = np.minimum(one[1], two[1]) > np.maximum(one[0], two[0])
            over = over[: len(others)]
            links.append(np.stack([node[: len(others)][over], others[over]]))
        one, two = np.concatenate(links, axis=1)
        graph = coo_array((np.ones(len(one), bool), (one, two)), shape=(node.size, node.size))
        _, part = connected_components(graph, directed=False)
        count[cell] = len(np.unique(part[(high[cell] > low[cell]).ravel()]))
    return count


@pytest.mark.parametrize(
    "number, two, lines", [(66, [3], (12, 800)), (479, [26], (40, 800)), (570, [1, 2, 7], (12, 6000))]
)
def test_parts_at_the_ends_are_counted(number, two, lines):
    places, tube = awkward(number)
    pieces = find_forms(places, tube).pieces
    assert (pieces[two] == 2).all()
    np.testing.assert_array_equal(pieces, count_parts(places, tube, *lines))


def test_open_ends_are_said(monkeypatch):
    def careless(bisectors: Bisectors) -> tuple:
        graph, tied, lost = trace(bisectors)
        return graph._replace(open_ends=2), tied, lost

    places, tube, trace = lattice(2, 3, 0.5), Tube(2, 1, 2), _trace
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        find_connectivity(places, tube)
    monkeypatch.setattr(edges, "_trace", careless)
    monkeypatch.setattr(edges, "TRIES", 2)
    for find in (find_contacts, find_transitions, find_forms, find_connectivity, trace_edges):
        with pytest.warns(UserWarning, match="^2 edges of the diagram could not be followed"):
            find(places, tube)


def test_an_edge_that_stands_still_is_left(monkeypatch) -> None:
    """Brought back to where it was by every step, it was followed forever: no result, no error."""
    positions, tube = awkward(77679)
    step, steps = edges.step, []

    def counted(fronts, bisectors):
        steps.append(len(fronts.point))
        assert len(steps) < 1000
        return step(fronts, bisectors)

    monkeypatch.setattr(edges, "step", counted)
    tissue, exact = find_connectivity(positions, tube), exact_cells(positions, tube, 60)
    assert tissue.transitions.open_ends == 0
    assert tissue.sizes is not None
    np.testing.assert_allclose(tissue.sizes.volume, exact.volume, atol=1e-4 * exact.volume.mean())
