"""Errors of measured cells, and what is done where they are large, against the exact path."""

import warnings

import equinox as eqx
import jax
import numpy as np
import pytest
from conftest import read_reference

from jaxtissue.diagram.exact import exact_cells
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.tissue import measurer, refinement
from jaxtissue.tissue.measurer import doubts, measure_tissue
from jaxtissue.tissue.refinement import LIMITS, near_twins
from jaxtissue.topology.statistics import find_connectivity


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
    return np.stack([np.abs(f - e) / max(e.mean(), 1e-9) for f, e in zip(found, (volume, area), strict=True)])


def estimates(cells: CellGeometry, volume: np.ndarray, area: np.ndarray) -> np.ndarray:
    """The errors that come with the cells, likewise."""
    told = (cells.volume_error, cells.lateral_area_error)
    return np.stack([np.asarray(t, float) / max(e.mean(), 1e-9) for t, e in zip(told, (volume, area), strict=True)])


@pytest.mark.parametrize("case", AWKWARD)
def test_awkward_cells_are_right_without_a_word(case: str) -> None:
    tube, positions = AWKWARD[case]
    exact = exact_cells(positions, tube, 200)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cells = measure_tissue(positions, tube)
    off = errors(cells, exact.volume, exact.lateral_area)
    assert off[0].max() < LIMITS[0] and off[1].max() < LIMITS[1]


@pytest.mark.parametrize("name", ["paper_Ra5", "ratio10_n100", "bluenoise_ratio10"])
def test_estimates_bound_the_errors_and_are_not_far_above(name: str) -> None:
    ref = read_reference(name)
    volume, area = ref.data["V"], ref.data["lateral"]
    cells = measure_tissue(ref.positions, ref.tube)
    off, told = errors(cells, volume, area), estimates(cells, volume, area)
    for true, bound in zip(off, told, strict=True):
        assert (bound >= true).mean() >= 0.95
        assert np.median(bound / np.maximum(true, 1e-9)) < 5


def test_a_tolerance_is_met_by_every_cell(reference) -> None:
    volume, area = reference.data["V"], reference.data["lateral"]
    cells = measure_tissue(reference.positions, reference.tube, "draft", tolerance=1e-3)
    off = errors(cells, volume, area)
    # the reference's own areas are off by up to 1.1e-3, as contacts and the exact path agree
    assert off[0].max() < 2e-5 and off[1].max() < 1.2e-3
    assert estimates(cells, volume, area).max() <= 1e-3


def test_doubtful_cells_of_a_large_tissue_are_traced_among_their_candidates() -> None:
    ref = read_reference("ratio10_n100")
    place = ref.positions.copy()
    place[1] = place[0] + 1e-5  # float32 tells them apart by a few of its steps
    cells = measure_tissue(place, ref.tube)
    exact = find_connectivity(place, ref.tube).sizes
    assert exact is not None
    off = errors(cells, exact.volume, exact.lateral_area)
    assert off[0].max() < LIMITS[0] and off[1].max() < LIMITS[1]
    assert off[:, :2].max() < 1e-6


def test_what_can_not_be_traced_is_measured_by_rules_and_said_to_be_doubtful(monkeypatch) -> None:
    ref = read_reference("ratio10_n100")
    monkeypatch.setattr(measurer, "trace_sizes", lambda *_: None)
    monkeypatch.setattr(refinement, "trace_sizes", lambda *_: None)
    with pytest.warns(UserWarning) as told:
        cells = measure_tissue(ref.positions, ref.tube, tolerance=1e-3)
    said = [str(warning.message) for warning in told]
    assert any("lateral area of" in text and "may be wrong by more than 0.1 %" in text for text in said)
    off = errors(cells, ref.data["V"], ref.data["lateral"])
    assert 1e-5 < off.max() < LIMITS[1]


def test_a_tolerance_that_is_none_is_refused() -> None:
    for tolerance in (0, -1e-3, float("nan")):
        with pytest.raises(ValueError, match="tolerance="):
            measure_tissue([[5, 1]], Tube(10, 1, 3), tolerance=tolerance)


def test_near_twins_are_those_that_rounding_moves() -> None:
    tube = Tube(10, 1, 3)
    place = np.array([[5, 1], [5, 1 + 1e-5], [2, 6.283185], [2, 1e-6], [8, 3]], np.float32)
    assert near_twins(place, tube).tolist() == [0, 1, 2, 3]
    assert near_twins(place.astype(float), tube).tolist() == []


def test_what_is_doubtful_is_named() -> None:
    tube = Tube(10, 1, 3)
    cells = measure_tissue(tube.random_positions(jax.random.key(0), 6), tube)
    assert not list(doubts(cells, tube, LIMITS))
    (message,) = doubts(eqx.tree_at(lambda c: c.volume_error, cells, cells.volume / 3), tube, LIMITS)
    worst = int(np.argmax(np.asarray(cells.volume)))
    assert message.startswith("the volume of") and f"cells {worst} (" in message
    (message,) = doubts(eqx.tree_at(lambda c: c.volume, cells, cells.volume * 0.9), tube, LIMITS)
    assert "add up to 0.9" in message
    (message,) = doubts(eqx.tree_at(lambda c: c.lateral_area, cells, cells.lateral_area * np.nan), tube, LIMITS)
    assert "lateral area of 6 of 6" in message
