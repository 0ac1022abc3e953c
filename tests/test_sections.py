"""Polygons of sections: edges that come and go in their order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.neighbors.section_lists import crowd_of
from jaxtissue.sections.cells import QUICK, RULE, cell_sections
from jaxtissue.sections.crowd import distances, missing
from jaxtissue.sections.rings import Ring, inserted, without

HEIGHTS = np.array([0.07, 0.33, 0.67, 0.93])
SHAPES = {
    "bent tube": jt.BentTube(bend_radius=8, arc=1, apical_radius=1, basal_radius=1.5),
    "ellipsoid": jt.Ellipsoid(apical_axes=(2, 1, 1), basal_axes=(2.5, 1.5, 1.5)),
    "wide tube": jt.RoundTube(40, 5, 10),
    "narrow tube": jt.RoundTube(20, 1, 10),
}


@pytest.mark.parametrize("height", [0.2, 3.0, 60.0])
@pytest.mark.parametrize("bent", [False, True])
def test_missing_neighbors_are_found(height, bent):
    """Beside a search through all backbones: flat cells, and some of 200 times their width, which had been unproved."""
    slab, n, rng = jt.Slab(4.0, 4.0, height), 150, np.random.default_rng(0)
    place = np.asarray(slab.random_positions(jax.random.key(1), n), float)
    nodes = np.clip(place[:, None] + rng.normal(0, 0.05, (n, 4, 2)), 0, 4) if bent else place
    crowd, cells = crowd_of(slab, nodes), np.repeat(np.arange(n), 20)
    lists = np.where(rng.random((24, n)) < 0.7, rng.integers(0, n, (24, n)), -1)
    points = np.append(
        place[cells] + rng.normal(0, 0.15, (len(cells), 2)), rng.random((len(cells), 1)) * height, axis=1
    )
    start, along = crowd.pieces()
    whole = distances(start[:, None], along[:, None], points[:, None])
    own = whole[np.arange(len(cells)), cells]
    out = (np.arange(n) != cells[:, None]) & (lists.T[cells][:, :, None] != np.arange(n)).all(axis=1)
    nearer = out & (whole < 0.99 * own[:, None])
    pairs, unproved = missing(crowd, lists, points, cells)
    found = np.zeros((n, n), bool)
    found[tuple(pairs.T)] = True
    assert unproved == 0 and nearer.any(axis=1).sum() > 100
    assert (found[cells] & nearer).any(axis=1)[nearer.any(axis=1)].all()
    assert not (found & ~np.logical_or.reduceat(out & (whole < own[:, None]), np.arange(0, len(cells), 20))).any()


@pytest.mark.parametrize("shape", SHAPES)
def test_sections_are_the_same_after_more_passes(shape):
    """Chords of bent walls that cut each other off changed some by 4 to 14 %; sums are those of the layers."""
    domain, whole, apart = SHAPES[shape], [], []
    measure = jax.jit(cell_sections, static_argnames="rule")
    for seed in range(3):
        place = domain.random_positions(jax.random.key(seed), 200)
        neighbors = jt.NeighborList.allocate(place, domain)
        lists, heights = jnp.asarray(neighbors.candidates).T, jnp.asarray(HEIGHTS, place.dtype)
        found = {
            passes: np.asarray(measure(domain, place, lists, heights, rule._replace(slots=20)).volume, float)
            for passes, rule in ((2, QUICK), (3, RULE), (7, RULE._replace(passes=7)))
        }
        apart.append([np.abs(found[passes] / found[7] - 1).max() for passes in (2, 3)])
        whole.append(found[7].sum(axis=1) / np.asarray(domain.layer_volume(heights)) - 1)
    quick, usual = np.max(apart, axis=0)
    assert usual < 5e-3 and quick < 0.06
    assert np.abs(whole).max() < 1e-3


def hexagon() -> Ring:
    """Six edges in eight slots, counterclockwise, each on the line of its number."""
    number = np.arange(8)[:, None, None]
    is_edge = number < 6
    return Ring(*(jnp.asarray(table) for table in (number, is_edge, (number - 1) % 6, (number + 1) % 6)))


def lines_in_order(ring: Ring) -> list[int]:
    """The lines from the first edge on, after checking that links go both ways."""
    line, is_edge, before, after = (np.asarray(table)[:, 0, 0] for table in ring)
    slot = first = int(np.flatnonzero(is_edge)[0])
    found = []
    while True:
        assert is_edge[slot] and before[after[slot]] == slot
        found.append(int(line[slot]))
        slot = int(after[slot])
        if slot == first:
            return found


def one(number: int | bool) -> jax.Array:
    return jnp.full((1, 1, 1), number)


@pytest.mark.parametrize(
    "corners, expected",
    [
        ([2], [0, 1, 2, 9, 3, 4, 5]),  # between two edges
        ([2, 3], [0, 1, 2, 9, 4, 5]),  # an edge is cut off
        ([1, 2, 3, 4], [0, 1, 9, 5]),
        ([5, 0], [9, 1, 2, 3, 4, 5]),  # past the last slot
    ],
)
def test_a_line_comes_in_where_it_cuts_off_corners(corners, expected):
    outside = sum(1 << corner for corner in corners)
    for corner in corners:  # it may be deepest at any
        ring, found = inserted(hexagon(), one(9), one(outside), one(corner), one(True))
        assert lines_in_order(ring) == expected and bool(found.is_new.all())
    same, _ = inserted(hexagon(), one(9), one(outside), one(corners[0]), one(False))
    assert lines_in_order(same) == [0, 1, 2, 3, 4, 5]


def test_edges_go_and_their_neighbors_meet():
    goes = np.zeros((8, 1, 1), bool)
    goes[[0, 1, 3]] = True
    assert lines_in_order(without(hexagon(), jnp.asarray(goes))) == [2, 4, 5]


def test_without_a_free_slot_the_polygon_stays():
    full = jax.tree.map(lambda table: table[:6], hexagon())
    ring, found = inserted(full, one(9), one(1 << 2), one(2), one(True))
    assert lines_in_order(ring) == [0, 1, 2, 3, 4, 5] and not bool(found.is_new.any())
    ring, _ = inserted(full, one(9), one(0b1100), one(2), one(True))
    assert lines_in_order(ring) == [0, 1, 2, 9, 4, 5]  # the slot of the edge that went
