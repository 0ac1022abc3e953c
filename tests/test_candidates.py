"""Candidate lists: complete, on the right side, and built on a true contact graph."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtissue.candidates import (
    contact_graph,
    find_candidates,
    hop_lists,
    padded,
    sided,
    survey_tissue,
    tiling_defect,
    within_hops,
)
from jaxtissue.exact import exact_cells
from jaxtissue.lines import PRESETS
from jaxtissue.tube import Tube

TUBE = Tube(length=20.0, apical_radius=1.0, basal_radius=3.0)


@pytest.fixture(scope="module", autouse=True)
def quick_compile():
    """Compile without optimization: each tissue is measured once, and compiling is most of the time."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(scope="module")
def tissue():
    """300 cells, their candidates, and who touches whom."""
    positions = TUBE.random_positions(jax.random.key(3), 300)
    lists = find_candidates(positions, TUBE)
    sides = sided(lists, positions, TUBE)
    _, survey, _ = survey_tissue(positions, TUBE, sides, PRESETS["draft"], surfaces=True)
    return positions, lists, contact_graph(positions, TUBE, sides, survey)


def test_contacts_are_mutual_and_not_with_oneself(tissue) -> None:
    contacts = tissue[2].toarray()
    np.testing.assert_array_equal(contacts, contacts.T)
    assert not contacts.diagonal().any()
    assert contacts.sum(axis=1).min() >= 3  # whoever is not at an end is walled in


def test_walls_of_some_size_are_contacts_and_candidates(tissue) -> None:
    positions, lists, contacts = tissue
    exact = exact_cells(np.asarray(positions, float), TUBE, samples=15)
    a, b = exact.pairs[exact.wall_area > 0.01 * exact.wall_area.mean()].T
    assert (lists[a] == b[:, None]).any(axis=1).all() and (lists[b] == a[:, None]).any(axis=1).all()
    # draft lines are a third of a cell apart: they miss narrow walls only
    a, b = exact.pairs[exact.wall_area > 0.5 * exact.wall_area.mean()].T
    assert contacts.toarray()[a, b].all()


def test_lists_hold_two_hops_and_nobody_twice(tissue) -> None:
    positions, lists, contacts = tissue
    own = np.arange(len(lists))[:, None]
    member = np.zeros((300, 300), int)
    np.add.at(member, (np.broadcast_to(own, lists.shape)[lists != own], lists[lists != own]), 1)
    assert member.max() == 1
    two = within_hops(contacts, 2).toarray() > 0
    np.fill_diagonal(two, False)
    again = hop_lists(contacts, positions, TUBE)
    assert all(set(np.flatnonzero(two[i])) <= set(again[i].tolist()) for i in range(300))


def test_sides_are_behind_and_ahead(tissue) -> None:
    positions, lists, _ = tissue
    axial, own = np.asarray(positions)[:, 0], np.arange(300)[:, None]
    for margin in (0.0, 0.5):
        sides = sided(lists, positions, TUBE, margin)
        wide = max(margin, 2e-4)  # twice the width within which two cells are level, at this lumen
        for side, sign in ((0, -1), (1, 1)):
            rivals = sides[:, side]
            gap = sign * (axial[rivals] - axial[:, None])
            assert (gap[rivals != own] >= -wide).all()
            listed = sign * (axial[lists] - axial[:, None]) >= -wide
            for i in range(300):
                assert set(rivals[i][rivals[i] != i]) == set(lists[i][listed[i] & (lists[i] != i)])


def test_padding_is_the_cell_itself(tissue) -> None:
    lists = tissue[1]
    wider = padded(lists, lists.shape[1] + 5)
    np.testing.assert_array_equal(wider[:, : lists.shape[1]], lists)
    assert (wider[:, lists.shape[1] :] == np.arange(300)[:, None]).all()
    np.testing.assert_array_equal(padded(lists, 1), lists)


@pytest.mark.parametrize("n, ratio", [(1, 3), (2, 3), (3, 3), (40, 3), (300, 3), (70, 200)])
def test_lists_are_complete(n: int, ratio: float) -> None:
    tube = Tube(20.0, 3.0 / ratio, 3.0)
    positions = tube.random_positions(jax.random.key(3), n)
    sides = jnp.asarray(sided(find_candidates(positions, tube), positions, tube))
    assert tiling_defect(positions, tube, sides) < 1e-5  # float32 sums over a line, measured 2e-6
