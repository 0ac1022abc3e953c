"""Nearest backbones, cell volumes and label images."""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known import known

from jaxtissue.diagram.labels import label_image, label_volumes, nearest_backbones
from jaxtissue.diagram.voxels import cartesian_voxels, cylindrical_voxels, image_mask
from jaxtissue.geometry.backbones import Backbones, distance_to_segment
from jaxtissue.geometry.tube import Tube

TUBE = Tube(length=20, apical_radius=2, basal_radius=5)


def closed_form_distances(points: np.ndarray, positions: np.ndarray, tube: Tube) -> np.ndarray:
    """Distances [p, n] to radial backbones in float64: foot at radius max(r cos D, R_a)."""
    radius, angle = np.hypot(points[:, 1], points[:, 2]), np.arctan2(points[:, 2], points[:, 1])
    turn = angle[:, None] - positions[:, 1]
    foot = np.clip(radius[:, None] * np.cos(turn), tube.apical_radius, tube.basal_radius)
    squared = radius[:, None] ** 2 - 2 * radius[:, None] * foot * np.cos(turn) + foot**2
    return np.sqrt((points[:, :1] - positions[:, 0]) ** 2 + np.maximum(squared, 0))


@pytest.fixture
def scene(dtype):
    """Random positions and points around, in and beyond the tissue."""
    rng = np.random.default_rng(0)
    positions = rng.uniform([0, 0], [20, 2 * math.pi], (43, 2))
    points = rng.uniform([-3, -7, -7], [23, 7, 7], (501, 3))
    return jnp.asarray(points, dtype), jnp.asarray(positions, dtype)


@pytest.mark.parametrize("block", [7, 4096])
def test_nearest_backbones_agree_with_the_closed_form(scene, block):
    points, positions = scene
    labels, distances = nearest_backbones(points, TUBE.embed(positions), count=5, block=block)
    expected = closed_form_distances(np.asarray(points, float), np.asarray(positions, float), TUBE)
    rounding = 100 * float(jnp.finfo(points.dtype).eps)  # coordinates up to 23, sums of six squares
    assert labels.dtype == jnp.int32
    assert distances.dtype == points.dtype
    np.testing.assert_allclose(distances, np.sort(expected)[:, :5], atol=rounding)
    np.testing.assert_allclose(np.take_along_axis(expected, np.asarray(labels), 1), distances, atol=rounding)
    assert all(len(set(row)) == 5 for row in labels.tolist())
    assert jnp.all(jnp.diff(distances) >= 0)


def test_all_ranks_are_a_permutation_also_among_ties(dtype):
    # A regular lattice seen from its own points of symmetry: almost every distance is shared by several.
    axial, angle = np.meshgrid(np.arange(7.0), np.arange(8) * math.pi / 4, indexing="ij")
    lattice = TUBE.embed(jnp.asarray(np.stack([axial.ravel(), angle.ravel()], axis=-1), dtype))
    twice = Backbones(jnp.tile(lattice.apical, (2, 1)), jnp.tile(lattice.basal, (2, 1)))
    points = jnp.concatenate([lattice.apical, lattice.basal, lattice.basal * jnp.array([1, 0, 0], dtype)])
    labels, distances = nearest_backbones(points, twice, count=112)
    np.testing.assert_array_equal(np.sort(labels), np.tile(np.arange(112), (len(points), 1)))
    # Exact copies tie exactly: the lower index comes first.
    ranks = np.argsort(labels, axis=1)
    assert np.all(ranks[:, :56] < ranks[:, 56:])
    assert jnp.all(jnp.diff(distances) >= 0)


def test_nearest_backbones_move_with_the_tissue(x64):
    rng = np.random.default_rng(1)
    positions = rng.uniform([0, 0], [20, 2 * math.pi], (30, 2))
    points = rng.uniform([0, -5, -5], [20, 5, 5], (300, 3))
    backbones = TUBE.embed(jnp.asarray(positions))
    labels, distances = nearest_backbones(jnp.asarray(points), backbones, count=3)
    cosine, sine = math.cos(0.7), math.sin(0.7)
    turn = np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])
    motions = {
        "turn": lambda ends: ends @ turn,
        "mirror": lambda ends: ends * np.array([-1, 1, -1]),
        "shift": lambda ends: ends + np.array([3.0, -2.0, 1.0]),
        "scale": lambda ends: 2.0 * ends,
    }
    for name, move in motions.items():
        moved = nearest_backbones(jnp.asarray(move(points)), jax.tree.map(move, backbones), count=3)
        np.testing.assert_array_equal(moved[0], labels, err_msg=name)
        scale = 2.0 if name == "scale" else 1.0
        np.testing.assert_allclose(moved[1], scale * distances, rtol=1e-12, err_msg=name)  # rounding
    order = rng.permutation(30)
    permuted = nearest_backbones(jnp.asarray(points), jax.tree.map(lambda ends: ends[order], backbones), count=3)
    np.testing.assert_array_equal(order[np.asarray(permuted[0])], labels)


def test_segments_of_any_direction_and_of_length_zero(x64):
    rng = np.random.default_rng(2)
    start, end = rng.normal(size=(2, 20, 3))
    end[::3] = start[::3]
    points = rng.normal(size=(100, 3))
    one_to_all = jax.vmap(distance_to_segment, (None, 0, 0))
    expected = jax.vmap(one_to_all, (0, None, None))(points, start, end)
    _, distances = nearest_backbones(jnp.asarray(points), Backbones(jnp.asarray(start), jnp.asarray(end)), 20)
    np.testing.assert_allclose(distances, np.sort(expected), rtol=1e-12)  # rounding


def test_nearest_backbones_reject_impossible_counts(scene):
    points, positions = scene
    for count in (0, 44):
        with pytest.raises(ValueError, match=f"count={count} "):
            nearest_backbones(points, TUBE.embed(positions), count)


@pytest.mark.parametrize(("points", "cells"), [(1_000_000, 500), (10_000, 100_000)])
def test_memory_grows_with_points_plus_backbones(points, cells):
    ends: Any = jax.ShapeDtypeStruct((cells, 3), jnp.float32)
    samples = jax.ShapeDtypeStruct((points, 3), jnp.float32)
    nearest = jax.jit(functools.partial(nearest_backbones, count=4))
    compiled = nearest.lower(samples, Backbones(ends, ends)).compile()
    # Under 20 numbers a point and a backbone, where a table would take 500 MB and more.
    assert known(compiled.memory_analysis()).temp_size_in_bytes < 80 * (points + cells)


def test_cylindrical_voxels_fill_the_tissue(dtype):
    points, volumes = cylindrical_voxels(TUBE, (4, 5, 6))
    assert points.shape == (120, 3)
    assert points.dtype == volumes.dtype == dtype
    assert float(volumes.sum()) == pytest.approx(TUBE.volume, rel=1e-6)  # sum of 120 in float32
    radius = jnp.hypot(points[:, 1], points[:, 2])
    assert radius.min() == pytest.approx(2.3, rel=1e-6)  # middle of the innermost of five layers of 0.6
    # V = r dx dr dt, voxel by voxel
    np.testing.assert_allclose(volumes, radius * 5 * 0.6 * 2 * math.pi / 6, rtol=1e-5)
    with pytest.raises(ValueError, match=r"shape=\(4, 0, 6\)"):
        cylindrical_voxels(TUBE, (4, 0, 6))


@pytest.mark.parametrize(
    ("name", "shape", "tolerance"),
    [
        ("ratio10_n100", (80, 24, 96), 0.015),  # plain counting with 2,000 voxels a cell is off by 1 %
        ("duplicate_x", (80, 24, 96), 0.03),  # walls along the grid take or leave whole layers of voxels
    ],
)
def test_counted_volumes_approach_the_reference(load_reference, name, shape, tolerance):
    reference = load_reference(name)
    cells = len(reference.positions)
    points, weights = cylindrical_voxels(reference.tube, shape)
    labels, _ = nearest_backbones(points, reference.tube.embed(jnp.asarray(reference.positions)))
    volumes = np.asarray(label_volumes(labels[:, 0], weights, cells))
    error = np.sqrt(np.mean((volumes - reference.data["V"]) ** 2)) / reference.data["V"].mean()
    assert error < tolerance
    assert volumes.sum() == pytest.approx(reference.tube.volume, rel=1e-4)  # 200,000 terms in float32


def test_volumes_of_many_samples_keep_their_digits():
    labels = jnp.arange(1_000_000) % 10
    volumes = label_volumes(labels, jnp.full(1_000_000, 0.0311, jnp.float32), 10)
    # One running float32 sum of 100,000 terms would be off by 6e-4.
    np.testing.assert_allclose(volumes, 3110, rtol=5e-5)


def test_label_image_has_its_axes_in_order():
    # Four cells on a short tube, at angles 0 (+y), 90 (+z), 180 (-y) and 270 degrees (-z).
    tube = Tube(3, 1, 4)
    positions = jnp.stack([jnp.full(4, 1.5), jnp.arange(4) * math.pi / 2], axis=-1)
    image = label_image(positions, tube, 0.5)
    assert image.shape == (16, 16, 6)
    assert image.dtype == np.uint16
    assert [image[8, 14, 3], image[14, 8, 3], image[8, 1, 3], image[1, 8, 3]] == [1, 2, 3, 4]
    assert np.all(image[8, 8] == 0)  # the lumen
    assert np.all(image[0, 0] == 0)  # a corner beyond the basal surface
    axial = label_image(jnp.array([[0.5, 0.0], [2.5, 0.0]]), tube, 0.5)
    assert axial[8, 14].tolist() == [1, 1, 1, 2, 2, 2]


def test_label_image_holds_the_reference_volumes(load_reference):
    reference = load_reference("bluenoise_ratio10")
    spacing = 0.25
    image = label_image(jnp.asarray(reference.positions), reference.tube, spacing)
    points, volumes = cartesian_voxels(reference.tube, spacing)
    mask = image_mask(reference.tube, spacing)
    assert image.shape == (80, 80, 160)
    np.testing.assert_array_equal(image > 0, mask)
    assert len(points) == mask.sum()
    counted = np.bincount(image.ravel(), minlength=201)[1:] * spacing**3
    error = np.sqrt(np.mean((counted - reference.data["V"]) ** 2)) / reference.data["V"].mean()
    assert error < 0.01  # some 4,000 voxels a cell
    assert float(volumes.sum()) == pytest.approx(reference.tube.volume, rel=5e-3)  # rough surfaces


def test_images_reject_what_they_cannot_hold():
    for spacing in (0.0, -1.0, math.nan, 50.0):
        with pytest.raises(ValueError, match=f"spacing={spacing}"):
            image_mask(TUBE, spacing)
    with pytest.raises(ValueError, match="65536 cells"):
        label_image(TUBE.random_positions(jax.random.key(0), 65536), TUBE, 1.0)
