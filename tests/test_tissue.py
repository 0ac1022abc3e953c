"""Backbones and tubes: distances of segments, positions, reflection, sizes."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from jaxtissue.geometry.backbones import distance_between_segments, distance_to_segment
from jaxtissue.geometry.tube import Tube, cells_for_unit_volume

TUBE = Tube(length=100, apical_radius=1, basal_radius=10)
seeds = st.integers(0, 2**32 - 1)
segment_distance = jax.jit(distance_between_segments)


def random_segments(seed: int) -> np.ndarray:
    """Two segments [2, 2, 3]; one in four pairs parallel, one in four with a segment of length zero."""
    rng = np.random.default_rng(seed)
    (a, b), (c, d) = rng.normal(size=(2, 2, 3))
    if seed % 4 == 1:
        d = c + rng.normal() * (b - a)
    if seed % 4 == 2:
        d = c
    return np.array([[a, b], [c, d]])


def least_squares_distance(pair: np.ndarray) -> float:
    """The distance of two segments as a bounded least-squares problem, by an independent solver."""
    (a, b), (c, d) = pair
    solution = lsq_linear(np.stack([b - a, c - d], axis=1), c - a, bounds=(0, 1), tol=1e-14)
    return math.sqrt(2 * solution.cost)


@given(seeds)
def test_segment_distance_agrees_with_least_squares(seed):
    pair = random_segments(seed)
    with jax.enable_x64(True):
        # The solver stops within 1e-7 of the minimum; where that is 0 its root shows.
        assert segment_distance(*pair[0], *pair[1]) == pytest.approx(least_squares_distance(pair), abs=1e-6)


@given(seeds)
def test_segment_distance_ignores_motion_mirroring_order_and_follows_scale(seed):
    pair = random_segments(seed)
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng).as_matrix()
    with jax.enable_x64(True):
        expected = float(segment_distance(*pair[0], *pair[1]))
        for a, b in [
            pair @ turn + rng.normal(size=3),
            pair * [1, 1, -1],
            pair[::-1],
            pair[:, ::-1],
        ]:
            # 1e-7 and not rounding: nearly parallel lines lose half the digits of their feet.
            assert segment_distance(*a, *b) == pytest.approx(expected, abs=1e-7)
        assert segment_distance(*(5 * pair[0]), *(5 * pair[1])) == pytest.approx(5 * expected, abs=1e-6)


@pytest.mark.parametrize(
    ("pair", "expected"),
    [
        ([[[0, 0, 0], [2, 0, 0]], [[1, -1, 0], [1, 1, 0]]], 0.0),  # crossing
        ([[[0, 0, 0], [2, 0, 0]], [[1, 0, 0], [3, 0, 0]]], 0.0),  # on one line, overlapping
        ([[[0, 0, 0], [2, 0, 0]], [[5, 0, 0], [7, 0, 0]]], 3.0),  # on one line, apart
        ([[[0, 0, 0], [2, 0, 0]], [[1, 2, 0], [9, 2, 0]]], 2.0),  # parallel
        ([[[1, 1, 1], [1, 1, 1]], [[1, 1, 4], [1, 1, 4]]], 3.0),  # two points
    ],
)
def test_segment_distance_of_special_pairs(pair, expected, dtype):
    (a, b), (c, d) = jnp.array(pair, dtype)
    distance = distance_between_segments(a, b, c, d)
    assert distance.dtype == dtype
    assert distance == expected


def test_distance_to_segment_of_length_zero_has_a_gradient():
    gradient = jax.grad(distance_to_segment)(jnp.array([3.0, 4.0, 0.0]), jnp.zeros(3), jnp.zeros(3))
    np.testing.assert_allclose(gradient, [0.6, 0.8, 0.0], rtol=1e-6)  # float32 rounding


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ((0, 1, 2), "length=0"),
        ((1, -1, 2), "apical_radius=-1"),
        ((1, 1, math.nan), "basal_radius=nan"),
        ((math.inf, 1, 2), "length=inf"),
        ((1, 2, 2), "apical_radius=2"),
        ((np.float32(1), np.array(3), 2), "apical_radius=3"),
    ],
)
def test_tube_rejects_impossible_sizes(sizes, message):
    with pytest.raises(ValueError, match=message):
        Tube(*sizes)


def test_tube_is_a_pytree_of_traced_sizes():
    assert jax.tree.leaves(jax.tree.map(lambda size: -size, TUBE)) == [-100, -1, -10]
    tubes = Tube(np.array([1.0, 2.0]), np.array([1.0, 2.0]), np.array([2.0, 3.0]))
    np.testing.assert_allclose(jax.vmap(lambda tube: tube.volume)(tubes), [3 * np.pi, 10 * np.pi], rtol=1e-6)
    slope = jax.grad(lambda radius: Tube(2.0, 1.0, radius).volume)(3.0)
    assert slope == pytest.approx(12 * np.pi, rel=1e-6)  # dV/dR_b is the basal area, in float32
    assert slope == pytest.approx(Tube(2, 1, 3).basal_area, rel=1e-6)


def test_areas_and_volume_of_reference_tubes(reference):
    tube, data = reference.tube, reference.data
    # The reference claims 1e-6 of the mean per volume; areas of its surfaces are exact sums of arcs.
    assert tube.volume == pytest.approx(data["V"].sum(), rel=1e-5)
    assert tube.apical_area == pytest.approx(data["apical_area"].sum(), rel=1e-4)
    assert tube.basal_area == pytest.approx(data["basal_area"].sum(), rel=1e-4)


def test_backbones_stand_radially(dtype):
    positions = TUBE.random_positions(jax.random.key(0), 50)
    backbones = TUBE.embed(positions)
    assert positions.dtype == backbones.apical.dtype == backbones.basal.dtype == dtype
    rounding = 10 * float(jnp.finfo(dtype).eps)
    for ends, radius in [(backbones.apical, 1), (backbones.basal, 10)]:
        np.testing.assert_array_equal(ends[:, 0], positions[:, 0])
        np.testing.assert_allclose(jnp.hypot(ends[:, 1], ends[:, 2]), radius, rtol=rounding)
        angle = jnp.arctan2(ends[:, 2], ends[:, 1]) % (2 * math.pi)
        np.testing.assert_allclose(angle, positions[:, 1], rtol=0, atol=2 * math.pi * rounding)


@given(st.floats(-1e3, 1e3), st.floats(-50, 50), st.floats(0.5, 30))
def test_reflect_folds_and_wraps(axial, angle, length):
    tube = Tube(length, 1, 2)
    folded = axial
    while not 0 <= folded <= length:
        folded = -folded if folded < 0 else 2 * length - folded
    with jax.enable_x64(True):
        ((x, t),) = tube.reflect(jnp.array([[axial, angle]])).tolist()
        assert 0 <= x <= length
        assert 0 <= t < 2 * math.pi
        assert x == pytest.approx(folded, abs=1e-10)  # rounding of up to 2,000 folds
        assert math.cos(t - angle) == pytest.approx(1, abs=1e-12)
        assert tube.reflect(jnp.array([[x, t]])).tolist() == [[x, t]]


def test_reflect_leaves_the_inside_alone_and_never_gives_a_full_turn(dtype):
    inside = TUBE.random_positions(jax.random.key(1), 1000)
    np.testing.assert_array_equal(jax.jit(lambda p: TUBE.reflect(p))(inside), inside)
    edges = jnp.array([[0.0, -1e-30], [100.0, -1e-9], [-1e-30, 2 * math.pi], [200.0, -2 * math.pi]], dtype)
    axial, angle = TUBE.reflect(edges).T
    assert jnp.all((axial >= 0) & (axial <= 100))
    assert jnp.all((angle >= 0) & (angle < dtype(2 * math.pi)))


def test_random_positions_are_uniform_and_follow_the_key():
    axial, angle = np.asarray(TUBE.random_positions(jax.random.key(2), 5000)).T
    for share in (axial / 100, angle / (2 * math.pi)):
        assert kstest(share, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(axial, angle)[0, 1]) < 0.06  # four standard errors
    again, other = (TUBE.random_positions(jax.random.key(k), 5000) for k in (2, 3))
    np.testing.assert_array_equal(again[:, 0], axial)
    assert not np.array_equal(other[:, 0], axial)
    with pytest.raises(ValueError, match="count=0"):
        TUBE.random_positions(jax.random.key(2), 0)


def test_cells_for_unit_volume_gives_a_mean_volume_of_one():
    assert TUBE.volume / cells_for_unit_volume(TUBE) == pytest.approx(1, abs=0.5 / 31102)
    assert cells_for_unit_volume(Tube(0.01, 0.01, 0.02)) == 1
    assert cells_for_unit_volume(Tube(1.45 / (3 * np.pi), 1, 2)) == 2  # mean volumes 1.45 and 0.725
