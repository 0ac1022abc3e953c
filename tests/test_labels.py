"""Which cell a point lies in, by candidates, against a look at all backbones."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtissue.diagram import point_location
from jaxtissue.diagram.labels import label_image
from jaxtissue.diagram.point_location import label_points
from jaxtissue.diagram.spread import covering_radius
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
