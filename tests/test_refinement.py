"""Errors of measured cells, and finer rules where they are large, against the exact path."""

import warnings

import equinox as eqx
import jax
import numpy as np
import pytest
from conftest import read_reference

from jaxtissue.adaptive import COARSE, FINE, NODES, measure_adaptively
from jaxtissue.cells import CellGeometry
from jaxtissue.contacts import find_contacts
from jaxtissue.diagrams import doubts, measure_tissue
from jaxtissue.exact import exact_cells
from jaxtissue.inputs import as_positions
from jaxtissue.refinement import LIMITS, near_twins
from jaxtissue.sections import _root
from jaxtissue.tube import Tube

pytestmark = pytest.mark.usefixtures("quickest_compile")


def ring(cells: int, axial: float, jitter: float, turn: float = 0.0) -> np.ndarray:
    """Backbones evenly round the tube, but for a jitter in both directions, at one height."""
    draw = np.random.default_rng(cells).normal(size=(cells, 2))
    even = np.stack([np.full(cells, axial), turn + 2 * np.pi * np.arange(cells) / cells], axis=-1)
    return even + jitter * draw


# Each has cells that lines at `standard` miss, half see, or measure only in part.
AWKWARD = {
    "past pi from its backbone": (Tube(2, 9, 10), [[1, 0], [1.05, 0.05]]),
    "a part across the lumen": (
        Tube(8.74, 9.984, 10),
        [[8.0569, 1.84385], [4.70459, 1.42612], [8.0572, 1.84325], [4.70624, 1.42694]],
    ),
    "a ring with jitter 1e-3": (Tube(10, 1, 3), np.concatenate([ring(8, 5, 1e-3), ring(3, 2, 0.1, 1)])),
    "a ring with jitter 1e-2": (Tube(10, 1, 3), np.concatenate([ring(8, 5, 1e-2), ring(3, 2, 0.1, 1)])),
    "a column": (
        Tube(40, 1, 3),
        np.stack([np.linspace(2, 38, 8), 1 + 0.01 * np.sin(3 * np.arange(8))], axis=-1),
    ),
    "a pair 1e-4 apart": (Tube(10, 1, 3), [[5, 1], [5.0001, 1.0001], [3, 2], [7, 4], [2, 5]]),
    "a thin lumen": (Tube(27.19, 0.0483, 10), [[19.665, 6.07], [19.724, 0.052]]),
    "a wide disc": (Tube(1.13, 6, 10), np.random.default_rng(2).random((12, 2)) * [1.13, 6.28]),
}


def errors(cells: CellGeometry, volume: np.ndarray, area: np.ndarray) -> np.ndarray:
    """True errors of volume and lateral area of each cell, fractions of the mean cell, [2, n]."""
    found = (np.asarray(cells.volume, float), np.asarray(cells.lateral_area, float))
    return np.stack([np.abs(f - e) / e.mean() for f, e in zip(found, (volume, area), strict=True)])


def estimates(cells: CellGeometry, volume: np.ndarray, area: np.ndarray) -> np.ndarray:
    """The errors that come with the cells, likewise."""
    told = (cells.volume_error, cells.lateral_area_error)
    return np.stack([np.asarray(t, float) / e.mean() for t, e in zip(told, (volume, area), strict=True)])


@pytest.mark.parametrize("case", AWKWARD)
def test_awkward_cells_are_right_without_a_word(case: str) -> None:
    tube, positions = AWKWARD[case]
    exact = exact_cells(positions, tube, 200)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cells, _ = measure_tissue(positions, tube)
    off = errors(cells, exact.volume, exact.lateral_area)
    assert off[0].max() < LIMITS[0] and off[1].max() < LIMITS[1]


@pytest.mark.parametrize("case", AWKWARD)
def test_adaptive_cells_are_the_exact_paths(case: str) -> None:
    tube, positions = AWKWARD[case]
    place = as_positions(positions, tube, float)
    n, exact = len(place), exact_cells(place, tube, 200)
    everyone = np.broadcast_to(np.arange(n), (n, n))
    cells = measure_adaptively(place, tube, np.arange(n), everyone, (1e-4, 1e-3))
    assert np.abs(cells.volume - exact.volume).max() < 2e-4 * exact.volume.mean()
    # areas by contacts: the exact path's are off by 0.5 % where backbones are 1e-4 apart
    contacts, area = find_contacts(place, tube), np.zeros(n)
    np.add.at(area, contacts.pairs.ravel(), np.repeat(contacts.area, 2))
    assert np.abs(cells.lateral_area - area).max() < 2e-3 * area.mean()
    assert cells.volume.sum() == pytest.approx(tube.volume, rel=1e-4)
    for areas, radius in ((cells.apical_area, tube.apical_radius), (cells.basal_area, tube.basal_radius)):
        assert areas.sum() == pytest.approx(2 * np.pi * radius * tube.length, rel=1e-9)
        assert areas.min() > 0  # each cell reaches both surfaces


@pytest.mark.parametrize("name", ["paper_Ra5", "ratio10_n100", "bluenoise_ratio10"])
def test_estimates_bound_the_errors_and_are_not_far_above(name: str) -> None:
    ref = read_reference(name)
    volume, area = ref.data["V"], ref.data["lateral"]
    cells, _ = measure_tissue(ref.positions, ref.tube)
    off, told = errors(cells, volume, area), estimates(cells, volume, area)
    for true, bound in zip(off, told, strict=True):
        assert (bound >= true).mean() >= 0.95
        assert np.median(bound / np.maximum(true, 1e-9)) < 5


@pytest.mark.parametrize("name", ["near_coincident", "n2"])
def test_a_tolerance_is_met_by_every_cell(name: str) -> None:
    ref = read_reference(name)
    cells, _ = measure_tissue(ref.positions, ref.tube, "draft", tolerance=1e-3)
    off = errors(cells, ref.data["V"], ref.data["lateral"])
    # the reference's own areas are off by up to 1e-3, as contacts and adaptive cells agree
    assert off[0].max() < 1e-3 and off[1].max() < 2e-3
    assert estimates(cells, ref.data["V"], ref.data["lateral"]).max() <= 1.001e-3


def test_a_tolerance_that_is_none_is_refused() -> None:
    for tolerance in (0, -1e-3, float("nan")):
        with pytest.raises(ValueError, match="tolerance="):
            measure_tissue([[5, 1]], Tube(10, 1, 3), tolerance=tolerance)


def test_adaptive_cells_turn_mirror_and_scale_with_the_tissue() -> None:
    n = 9
    place = np.random.default_rng(0).random((n, 2)) * [10, 2 * np.pi]
    everyone = np.broadcast_to(np.arange(n), (n, n))

    def sizes(positions: np.ndarray, scale: float = 1.0) -> np.ndarray:
        wide = Tube(10 * scale, scale, 3 * scale)
        found = measure_adaptively(
            positions, wide, np.arange(n), everyone, (1e-2 * scale**3, 1e-1 * scale**2)
        )
        return np.stack([found.volume / scale**3, found.lateral_area / scale**2])

    plain = sizes(place)
    for other in (place + np.array([0, 2]), place * [1, -1], np.array([10, 0]) + place * [-1, 1]):
        np.testing.assert_allclose(sizes(other), plain, rtol=1e-6)
    np.testing.assert_allclose(sizes(place * [1e3, 1], 1e3), plain, rtol=1e-6)


def test_rules_over_the_radius_are_gausss_and_kronrods() -> None:
    for degree in range(23):
        exact = 0 if degree % 2 else 1 / (degree + 1)
        assert NODES**degree @ FINE == pytest.approx(exact, abs=1e-14)
        if degree < 14:
            assert NODES**degree @ COARSE == pytest.approx(exact, abs=1e-14)


def test_roots_are_found_to_rounding() -> None:
    target = np.array([0.1, 0.5, 1e-9, 0.999])
    root = _root(lambda at: np.sin(at) - np.sin(target), np.zeros(4), np.ones(4))
    np.testing.assert_allclose(root, target, rtol=1e-14)


def test_near_twins_are_those_that_rounding_moves() -> None:
    tube = Tube(10, 1, 3)
    place = np.array([[5, 1], [5, 1 + 1e-5], [2, 6.283185], [2, 1e-6], [8, 3]], np.float32)
    assert near_twins(place, tube).tolist() == [0, 1, 2, 3]
    assert near_twins(place.astype(float), tube).tolist() == []


def test_what_is_doubtful_is_named() -> None:
    tube = Tube(10, 1, 3)
    cells, _ = measure_tissue(tube.random_positions(jax.random.key(0), 6), tube)
    assert not list(doubts(cells, tube, LIMITS))
    (message,) = doubts(eqx.tree_at(lambda c: c.volume_error, cells, cells.volume / 3), tube, LIMITS)
    worst = int(np.argmax(np.asarray(cells.volume)))
    assert message.startswith("the volume of") and f"cells {worst} (" in message
    (message,) = doubts(eqx.tree_at(lambda c: c.volume, cells, cells.volume * 0.9), tube, LIMITS)
    assert "add up to 0.9" in message
    (message,) = doubts(
        eqx.tree_at(lambda c: c.lateral_area, cells, cells.lateral_area * np.nan), tube, LIMITS
    )
    assert "lateral area of 6 of 6" in message
