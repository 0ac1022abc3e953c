"""Separation, covering radius, and the bounds that they give."""

import math

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial import KDTree

from jaxtissue.diagram.labels import nearest_backbones
from jaxtissue.diagram.spread import (
    covering_radius,
    neighbor_bound,
    separation,
    tightness,
    tube_neighbor_bound,
)
from jaxtissue.geometry.backbones import distance_between_segments
from jaxtissue.geometry.tube import Tube

PAIRWISE = jax.jit(jax.vmap(distance_between_segments))


def test_separation_of_reference_tubes(reference, x64):
    expected = float(reference.data["min_dist"])
    # Also where it is 1e-6 (near_coincident), and infinite for the single cell.
    assert separation(jnp.asarray(reference.positions), reference.tube) == pytest.approx(expected, rel=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.99))
def test_separation_is_the_smallest_distance_of_two_segments(seed, ratio):
    tube = Tube(4, ratio, 1)
    with jax.enable_x64(True):
        # A short tube, so that opposite backbones are often the nearest ones.
        positions = tube.random_positions(jax.random.key(seed), 6)
        ends = tube.embed(positions)
        first, second = np.triu_indices(6, 1)
        pairs = ends.apical[first], ends.basal[first], ends.apical[second], ends.basal[second]
        expected = jnp.min(PAIRWISE(*pairs))
        assert separation(positions, tube) == pytest.approx(float(expected), rel=1e-9)


@pytest.mark.parametrize(("axial", "angle"), [(1e-6, 0.0), (0.0, 1e-6), (1e-6, 1e-6), (0.0, 2 * math.pi - 1e-6)])
def test_separation_of_nearly_equal_positions(axial, angle, x64):
    positions = jnp.array([[50.0, 0.0], [50.0 + axial, angle], [80.0, 3.0]])
    expected = math.hypot(axial, 2 * 5 * math.sin(angle / 2))
    assert separation(positions, Tube(100, 5, 10)) == pytest.approx(expected, rel=1e-6)


def test_separation_of_many_and_of_equal_axial_positions():
    many = np.random.default_rng(0).uniform([0, 0], [1000, 2 * math.pi], (100_000, 2))
    apical = np.stack([many[:, 0], 30 * np.cos(many[:, 1]), 30 * np.sin(many[:, 1])], axis=-1)
    expected = KDTree(apical).query(apical, k=2)[0][:, 1].min()
    # Some 3e-3, where positions up to 1,000 are rounded to 6e-5 in float32.
    assert separation(jnp.asarray(many), Tube(1000, 30, 100)) == pytest.approx(expected, abs=2e-4)
    ring = np.stack([np.full(300, 5.0), np.arange(300) * (2 * math.pi / 300)], axis=-1)
    expected = 2 * 3 * math.sin(math.pi / 300)
    # Angles up to 6.28 rounded to float32 leave 1e-5 of a step of 0.02.
    assert separation(jnp.asarray(ring), Tube(10, 3, 4)) == pytest.approx(expected, rel=1e-4)


def test_covering_radius_of_reference_tubes(reference):
    found = covering_radius(jnp.asarray(reference.positions), reference.tube)
    # Never above the reference but for rounding; half the last patch's diagonal is 0.1 % of it at most.
    assert 0.999 < float(found / reference.data["phi"]) < 1 + 1e-5


def test_covering_radius_follows_the_precision_of_its_input(load_reference, dtype):
    reference = load_reference("ratio10_n100")
    found = covering_radius(jnp.asarray(reference.positions, dtype), reference.tube)
    assert found.dtype == dtype
    assert 0.999 < float(found / reference.data["phi"]) < 1 + 1e-5  # as above


@pytest.mark.parametrize("apical_radius", [0.2, 2.0, 4.9])
def test_no_point_of_the_tissue_is_farther_than_the_covering_radius(apical_radius, x64):
    tube = Tube(12, apical_radius, 5)
    positions = tube.random_positions(jax.random.key(3), 15)
    share = np.random.default_rng(4).uniform(size=(3, 200_000))
    # Uniform over the block of (x, r, t), then also on the end planes and on both surfaces.
    share[0, :20_000] = np.round(share[0, :20_000])
    share[1, 10_000:60_000] = np.round(share[1, 10_000:60_000])
    radius, angle = apical_radius + (5 - apical_radius) * share[1], 2 * np.pi * share[2]
    points = jnp.stack([12 * share[0], radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    farthest = nearest_backbones(points, tube.embed(positions))[1].max()
    # 200,000 samples come within some 3 % of the maximum; the search must not fall below them.
    assert 0.999 * farthest < covering_radius(positions, tube) < 1.05 * farthest


def test_covering_radius_of_one_cell_is_its_farthest_corner():
    # From a backbone at the middle to the far end of the basal surface, opposite: its apical end is nearest.
    expected = math.hypot(5, 1 + 3)
    assert covering_radius(jnp.array([[5.0, 1.0]]), Tube(10, 1, 3)) == pytest.approx(expected, rel=1e-3)


def test_spread_ignores_motion_mirroring_order_and_follows_scale(x64):
    tube = Tube(20, 1, 5)
    positions = tube.random_positions(jax.random.key(5), 40)
    mirrored = jnp.array([20.0, 0.0]) - positions
    images = {
        "turn": (tube.reflect(positions + jnp.array([0.0, 2.0])), tube),
        "mirror": (tube.reflect(mirrored), tube),
        "permute": (positions[::-1], tube),
        "scale": (positions * jnp.array([3.0, 1.0]), Tube(60, 3, 15)),
    }
    for name, (moved, image) in images.items():
        scale = 3.0 if name == "scale" else 1.0
        assert separation(moved, image) == pytest.approx(scale * float(separation(positions, tube)), rel=1e-9)
        # The grid does not turn along: the search's own error, under 0.1 %.
        covering = scale * float(covering_radius(positions, tube))
        assert covering_radius(moved, image) == pytest.approx(covering, rel=1e-3), name
        assert tightness(moved, image) == pytest.approx(float(tightness(positions, tube)), rel=1e-3), name


def test_covering_radius_keeps_its_tolerance(x64):
    positions = Tube(20, 1, 5).random_positions(jax.random.key(6), 30)
    for radius in (4, 8):
        tube = Tube(20, 1, radius)
        finest = float(covering_radius(positions, tube, 1e-8))
        for tolerance in (0.3, 1e-2, 1e-4):
            assert 1 / (1 + tolerance) <= covering_radius(positions, tube, tolerance) / finest <= 1 + 1e-8
    for tolerance in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match=f"tolerance={tolerance} "):
            covering_radius(positions, Tube(20, 1, 5), tolerance)


@pytest.mark.parametrize("tube", [Tube(1e4, 1, 3), Tube(0.01, 1, 3), Tube(10, 1, 200)])
def test_covering_radius_of_long_short_and_thick_tubes(tube):
    # farthest from one backbone: opposite, beyond the lumen, at the far end
    expected = math.hypot(0.7 * tube.length, tube.apical_radius + tube.basal_radius)
    assert covering_radius([[0.3 * tube.length, 1.0]], tube, 1e-6) == pytest.approx(expected, rel=1e-6)


def test_neighbor_bounds_of_reference_tubes(reference):
    if len(reference.positions) == 1:
        assert tightness(jnp.asarray(reference.positions), reference.tube) == 0
        return
    phi = float(tightness(jnp.asarray(reference.positions), reference.tube))
    length = reference.tube.basal_radius - reference.tube.apical_radius
    graph = nx.Graph(reference.data["pairs_any"].tolist())
    degrees = max(degree for _, degree in graph.degree)
    assert degrees <= tube_neighbor_bound(phi)
    assert degrees <= neighbor_bound(phi, length / float(reference.data["min_dist"]))
    for hops in (2, 3):
        reached = max(len(nx.ego_graph(graph, cell, hops)) - 1 for cell in graph)
        assert reached <= tube_neighbor_bound(phi, hops)


def test_neighbor_bounds_are_the_formulas_of_the_paper():
    assert neighbor_bound(0.75, 3.0) == 8 * 2**3 + 6 * 2**2 * 3
    assert tube_neighbor_bound(0.75) == 4 * 2**2
    assert tube_neighbor_bound(0.75, hops=3) == 4 * 5**2
