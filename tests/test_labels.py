"""Which cell a point lies in, by candidates, against a look at all backbones."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxtissue as jt
from jaxtissue.diagram import point_location
from jaxtissue.diagram.insides import _search, bounding_box, contains
from jaxtissue.diagram.labels import label_image
from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.point_location import label_points
from jaxtissue.diagram.spread import covering_radius
from jaxtissue.geometry.domain_positions import ends_in_space
from jaxtissue.geometry.tube import Tube

RNG = np.random.default_rng(0)
ROUND = 2 * math.pi
TISSUES = {
    "uniform": (Tube(20, 2, 5), RNG.uniform([0, 0], [20, ROUND], (300, 2))),
    "one cell": (Tube(20, 2, 5), np.array([[3.0, 1.0]])),
    "thin lumen": (Tube(20, 0.025, 5), RNG.uniform([0, 0], [20, ROUND], (60, 2))),
    "thin wall": (Tube(20, 4.99, 5), RNG.uniform([0, 0], [20, ROUND], (200, 2))),
    "short and wide": (Tube(0.5, 5, 10), RNG.uniform([0, 0], [0.5, ROUND], (300, 2))),
    "long and narrow": (Tube(1e5, 1, 3), RNG.uniform([0, 0], [1e5, ROUND], (300, 2))),
    "clump": (Tube(200, 1, 5), [100, 2] + 0.01 * RNG.normal(size=(300, 2))),
    "ring": (Tube(40, 1, 5), np.stack([np.full(60, 7.0), RNG.uniform(0, ROUND, 60)], axis=1)),
    "column": (Tube(40, 1, 5), np.stack([RNG.uniform(0, 40, 60), np.full(60, 1.0)], axis=1)),
}


def points_of(tube: Tube, count: int = 4000) -> np.ndarray:
    """Points in the tissue, on its surfaces and ends, in the lumen and beyond, some of them twice."""
    rng = np.random.default_rng(1)
    axial, share, angle = rng.uniform([-0.1, 0, 0], [1.1, 1.3, ROUND], (count, 3)).T
    axial[: count // 8] = np.round(axial[: count // 8])
    radius = tube.apical_radius + share * (tube.basal_radius - tube.apical_radius)
    radius[count // 4 : count // 2] = np.where(rng.random(count // 4) < 0.5, tube.apical_radius, tube.basal_radius)
    radius[count // 2 : 5 * count // 8] *= rng.uniform(0, 1, count // 8)
    points = np.stack([axial * tube.length, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return np.concatenate([points, points[:100]])


def distances_to_all(points: np.ndarray, positions: np.ndarray, tube: Tube) -> np.ndarray:
    """In cylindrical coordinates: the foot is at radius max(r cos D, R_a), or R_b beyond the tissue."""
    radius = np.hypot(points[:, 1], points[:, 2])[:, None]
    turn = np.arctan2(points[:, 2], points[:, 1])[:, None] - positions[:, 1]
    foot = np.clip(radius * np.cos(turn), tube.apical_radius, tube.basal_radius)
    across = (radius * np.sin(turn)) ** 2 + (radius * np.cos(turn) - foot) ** 2
    return np.sqrt((points[:, :1] - positions[:, 0]) ** 2 + across)


@pytest.mark.parametrize("name", TISSUES)
def test_points_have_the_label_of_the_nearest_of_all_backbones(name, monkeypatch):
    monkeypatch.setattr(point_location, "_CHUNK", 1500)  # so that there are several
    tube, positions = TISSUES[name]
    points = points_of(tube)
    distances = distances_to_all(points, positions, tube)
    found = label_points(points, positions, tube)
    assert found.dtype == np.int32
    nearest = distances.min(axis=1)
    own = np.take_along_axis(distances, found[:, None], axis=1)[:, 0]
    # 1e-9: roundoff of the square of up to 1e5, where a backbone is 1e-2 away and more
    np.testing.assert_allclose(own, nearest, rtol=1e-9, atol=1e-9)


def test_equally_near_backbones_give_the_lower_index():
    # along the axis both are exactly as near
    two = np.array([[6.0, 0.5], [2.0, 0.5]])
    points = np.stack([np.full(50, 4.0), *np.random.default_rng(0).normal(size=(2, 50))], axis=1)
    assert label_points(points, two, Tube(10, 1, 3)).tolist() == [0] * 50
    assert label_points(points, two[::-1], Tube(10, 1, 3)).tolist() == [0] * 50


def test_labels_turn_with_the_numbering_and_single_points_agree():
    tube, positions = TISSUES["uniform"]
    points, order = points_of(tube), np.random.default_rng(2).permutation(300)
    found = label_points(points, positions, tube)
    np.testing.assert_array_equal(order[label_points(points, positions[order], tube)], found)
    assert [label_points(points[k : k + 1], positions, tube)[0] for k in range(20)] == found[:20].tolist()


def test_the_work_grows_with_points_and_backbones_alone(monkeypatch):
    pairs = []
    narrow = point_location.narrow

    def counted(center, radius, lists, cells):
        pairs.append(len(lists.cell))
        return narrow(center, radius, lists, cells)

    monkeypatch.setattr(point_location, "narrow", counted)
    monkeypatch.setattr("jaxtissue.diagram.spread.narrow", counted)
    # some 60 distances for points and cells that are few, and 200 a cell for the covering radius
    for cells in (1000, 20_000):
        tube = Tube(cells / 5, 1, 10)
        positions = np.random.default_rng(3).uniform([0, 0], [cells / 5, ROUND], (cells, 2))
        pairs.clear()
        label_points(points_of(tube, 4000), positions, tube)
        assert sum(pairs) < 150 * (4000 + cells)
        pairs.clear()
        covering_radius(positions, tube)
        assert sum(pairs) < 400 * cells


def test_an_image_is_labeled_alike_in_both_precisions(dtype):
    tube, positions = TISSUES["uniform"]
    image = label_image(jnp.asarray(positions, dtype), tube, 0.25)
    points = (np.argwhere(image > 0) - np.array([19.5, 19.5, -0.5]))[:, ::-1] * 0.25
    expected = label_points(points, positions, tube) + 1
    assert np.mean(image[image > 0] != expected) < 1e-4  # backbones moved by a rounding


def test_what_is_not_finite_or_outside_is_refused():
    tube, positions = TISSUES["uniform"]
    with pytest.raises(ValueError, match=r"point 1, .*nan"):
        label_points([[1.0, 1, 1], [np.nan, 1, 1]], positions, tube)
    with pytest.raises(ValueError, match=r"backbone 0: axial=21"):
        label_points([[1.0, 1, 1]], [[21.0, 0.0]], tube)
    assert label_points(np.zeros((0, 3)), positions, tube).shape == (0,)


OTHERS = {
    "slab": jt.Slab(6, 5, 2, (True, False)),
    "bent tube": jt.BentTube(6, 2.0, 2, 3.2),
    "sphere": jt.Sphere(4, 6),
    "elliptic tube": jt.EllipticTube(6, [4, 5], [5, 6]),
    "fold": jt.Fold(8, 5, 0.5, 8, 0.6),
}


@pytest.mark.parametrize("name", ["slab", "bent tube", "sphere"])
def test_voxels_of_any_domain_add_up_to_its_cells(name):
    domain = OTHERS[name]
    positions = np.asarray(domain.random_positions(jax.random.key(3), 60))
    side, cells = 0.2 if name == "sphere" else 0.1, jt.exact_cells(positions, domain, 3)
    image = label_image(positions, domain, side)
    assert image.dtype == np.uint16 and image.max() == 60
    assert image.all() if name == "slab" else not image[0, 0, 0]
    volume = np.bincount(image.ravel(), minlength=61)[1:] * side**3
    walls = np.asarray(cells.lateral_area) + 2 * domain.basal_area / 60
    # a voxel at a wall is in or out at random, by half of it; walls of the slab are upright, its columns all alike
    alike = 20 if name == "slab" else 1
    off = np.abs(volume - np.asarray(cells.volume)) / (0.5 * side**2 * np.sqrt(alike * walls))
    assert off.max() < 4 and off.mean() > 0.05
    points, volumes = jt.cartesian_voxels(domain, side)
    np.testing.assert_array_equal(label_points(points, positions, domain) + 1, image[image > 0])
    assert float(volumes.sum()) == pytest.approx(domain.volume, rel=2e-3)


@pytest.mark.parametrize("name", ["bent tube", "sphere"])
def test_points_are_found_inside_alike_by_newton_and_by_closed_forms(name):
    domain = OTHERS[name]
    low, high = bounding_box(domain)
    points = np.random.default_rng(0).uniform(low - 0.3, high + 0.3, (5000, 3))
    inside = contains(points, domain)
    np.testing.assert_array_equal(_search(domain, points), inside)
    assert inside.mean() * np.prod(high - low + 0.6) == pytest.approx(domain.volume, rel=0.1)
    assert (points[inside] >= low - 1e-12).all() and (points[inside] <= high + 1e-12).all()


def test_a_fold_has_a_box_and_holds_its_own_points():
    fold: Any = OTHERS["fold"]
    rng = np.random.default_rng(1)
    m, h = rng.uniform([0, 0], [8, 5], (500, 2)), rng.uniform(-0.3, 1.3, 500)
    apical, basal = ends_in_space(m, fold)
    points = apical + h[:, None] * (basal - apical)
    np.testing.assert_array_equal(contains(points, fold), (h > 0) & (h < 1))
    low, high = bounding_box(fold)
    np.testing.assert_allclose([low[1], high[1], low[2], high[2]], [0, 5, -0.5, 1.1], atol=1e-9)


def test_labels_on_other_domains_turn_and_repeat_with_the_tissue():
    rng, sphere = np.random.default_rng(4), jt.Sphere(2, 4)
    directions, points = rng.normal(size=(50, 3)), rng.normal(size=(4000, 3)) * 2
    turn = Rotation.from_euler("zyx", [0.3, 1.1, -0.7]).as_matrix()
    found = label_points(points, directions, sphere)
    np.testing.assert_array_equal(label_points(points @ turn, directions @ turn, sphere), found)
    crowd = Crowd(directions / np.linalg.norm(directions, axis=1, keepdims=True), sphere)
    np.testing.assert_array_equal(crowd.nearest(points), found)
    slab = jt.Slab(6, 5, 2, (True, True))
    bent = rng.uniform(0, 1, (40, 1, 2)) * [6, 5] + np.cumsum(rng.normal(size=(40, 4, 2)) * 0.2, axis=1)
    points = rng.uniform(0, 1, (4000, 3)) * [6, 5, 2]
    for positions in (bent[:, 0], bent[:, [0, -1]], bent):  # straight, tilted and bent
        found = label_points(points, positions, slab)
        np.testing.assert_array_equal(Crowd(positions, slab).nearest(points) % 40, found)
        moved = np.mod(points[:, :2] + [2.5, 1.5], [6, 5])
        again = label_points(np.column_stack([moved, points[:, 2]]), positions + np.array([2.5, 1.5]), slab)
        np.testing.assert_array_equal(again, found)
