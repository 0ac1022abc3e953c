"""Whole diagrams: again on kept lists as from scratch, and on several devices as on one."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
from known import known

from jaxtissue import PRESETS, CellMeasurer, Resolution, Tube, measure_tissue
from jaxtissue.neighbors.search import TILES, find_defect
from jaxtissue.neighbors.shortlists import CANDIDATES

TUBE = Tube(60.0, 1.0, 8.0)
CELLS = 181  # not so many for each of 3 devices
SIZES = ("volume", "lateral_area")


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(3), CELLS))


def off(some, other) -> float:
    """Largest difference of a size, in the mean cell's."""
    pairs = [(np.asarray(getattr(some, name)), np.asarray(getattr(other, name))) for name in SIZES]
    return max(np.abs(a - b).max() / b.mean() for a, b in pairs)


def test_surfaces_are_measured_unless_left_out(positions) -> None:
    whole = measure_tissue(positions, TUBE, PRESETS["draft"], refine=False)
    part = measure_tissue(positions, TUBE, PRESETS["draft"], surfaces=False, refine=False)
    assert off(part, whole) < 1e-6  # another program, in single precision
    assert whole.tiling_defect == part.tiling_defect and known(part.tiling_defect) < TILES
    assert part.apical_area is part.basal_perimeter is None
    assert float(known(whole.apical_area).sum()) == pytest.approx(2 * np.pi * 60, rel=2e-3)  # measured 8e-4


def test_a_gauge_sees_all_round_a_wide_tube() -> None:
    tube, cells = Tube(40.0, 40.0, 48.0), 800  # 70 cells round, where 16 lines would miss most
    place, random = np.array(tube.random_positions(jax.random.key(0), cells)), np.random.default_rng(0)
    measurer = CellMeasurer(tube, PRESETS["draft"])
    measurer.measure(place)
    for _ in range(3):  # by an eighth of a cell's width
        step = random.normal(scale=0.45, size=place.shape) / [1, 40]
        place = np.array(tube.reflect((place + step).astype(np.float32)))
        found = measurer.measure(place)
        assert off(found, measure_tissue(place, tube, PRESETS["draft"], surfaces=False, refine=False)) < 2e-3
    assert measurer.num_rebuilds > 1


def test_a_gauge_measures_a_tissue_that_moves_as_from_scratch(positions) -> None:
    measurer, place, random = CellMeasurer(TUBE, PRESETS["draft"]), positions.copy(), np.random.default_rng(0)
    for step in range(6):
        found = measurer.measure(place)
        expected = measure_tissue(place, TUBE, PRESETS["draft"], surfaces=False, refine=False)
        assert off(found, expected) < 2e-5, step  # float32; candidates compared are others
        place = place + random.normal(scale=0.03, size=place.shape).astype(np.float32)
        place[:, 0] = place[:, 0].clip(0, 60)
    assert measurer.num_rebuilds < 6  # lists were kept at least once


def test_a_gauge_renews_lists_that_no_longer_hold(positions) -> None:
    measurer = CellMeasurer(TUBE, PRESETS["draft"])
    measurer.measure(positions)
    mirrored = np.stack([60 - positions[:, 0], positions[::-1, 1]], axis=1)  # everyone has other neighbors
    blind = measurer.measure(mirrored, check=False)
    expected = measure_tissue(mirrored, TUBE, PRESETS["draft"], surfaces=False, refine=False)
    assert off(blind, expected) > 0.1 and measurer.num_rebuilds == 1
    assert off(measurer.measure(mirrored), expected) < 2e-5 and measurer.num_rebuilds == 2
    fewer = positions[: CELLS // 2]
    assert off(measurer.measure(fewer), measure_tissue(fewer, TUBE, PRESETS["draft"], refine=False)) < 2e-5
    assert measurer.num_rebuilds == 3


def test_lists_kept_lack_nobody_where_many_bound_a_cell() -> None:
    ring = np.stack([np.full(40, 30.0), 2 * np.pi * np.arange(40) / 40], axis=1)
    lone = np.array([[10.0, 1.0], [50.0, 4.0]])  # each bounded by the whole ring
    place = np.concatenate([ring, lone]).astype(np.float32)
    measurer = CellMeasurer(TUBE, Resolution(3, 3))
    found = measurer.measure(place)
    assert find_defect(place, TUBE, known(measurer.neighbors).candidates) < TILES
    assert known(measurer.neighbors).candidates.shape[2] == 2 * CANDIDATES  # each of the ring and some more: few shapes
    assert off(found, measure_tissue(place, TUBE, Resolution(3, 3), refine=False)) < 2e-5


def test_level_cells_are_right_where_lines_miss_them() -> None:
    tube, cells = Tube(60.0, 1.0, 8.0), 72
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, cells)
    level = np.stack([np.full(cells, 30.0), np.sort(angles)], axis=1).astype(np.float32)
    by_lines = measure_tissue(level, tube, "draft", surfaces=False, refine=False)
    assert abs(np.sum(by_lines.volume) / tube.volume - 1) > 0.03  # so coarse are they
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sizes = measure_tissue(level, tube, "draft", surfaces=False)
    gap = np.diff(np.append(level[:, 1], level[0, 1] + 2 * np.pi))
    volume = (gap + np.roll(gap, 1)) / 2 * tube.volume / (2 * np.pi)
    assert np.abs(sizes.volume - volume).max() < 0.01 * volume.mean()
    np.testing.assert_allclose(sizes.lateral_area, 2 * 7 * 60, rtol=0.05)  # radial planes


@pytest.mark.parametrize("bad", [[np.nan, 1.0], [10.0, np.inf], [60.1, 1.0], [-0.1, 1.0]])
def test_positions_that_are_none_are_named(bad: list[float], positions) -> None:
    place = positions.copy()
    measurer = CellMeasurer(TUBE, PRESETS["draft"])
    measurer.measure(place)
    place[7] = bad
    named = r"backbone 7: a\w+=\S+ is (not a finite number|outside the tube)"
    for measure in (measurer.measure, lambda place: measure_tissue(place, TUBE, PRESETS["draft"])):
        with pytest.raises(ValueError, match=named):
            measure(place)


SCRIPT = """
import sys; sys.path.insert(0, {tests!r})
import quick; quick.compile_as_asked()
import jax, numpy as np, jaxtissue as jt
place, tube = jax.device_put(np.load({place!r}), jax.devices()[-1]), jt.Tube(60.0, 1.0, 8.0)
cells = jt.measure_tissue(place, tube, jt.PRESETS["draft"], refine=False)
kept = jt.CellMeasurer(tube, jt.PRESETS["draft"]).measure(place)
assert cells.volume.shape == kept.volume.shape == (181,)
assert len(cells.volume.devices()) == len(jax.devices()) == 3
np.savez({path!r}, *map(np.asarray, jax.tree.leaves((cells, kept))))
"""


def test_cells_shared_out_among_devices_are_those_of_one(positions, tmp_path) -> None:
    cells = measure_tissue(positions, TUBE, PRESETS["draft"], refine=False)
    kept = CellMeasurer(TUBE, PRESETS["draft"]).measure(positions)
    path, place = str(tmp_path / "shared.npz"), str(tmp_path / "place.npy")
    np.save(place, positions)
    script = SCRIPT.format(tests=str(Path(__file__).parent), path=path, place=place)
    subprocess.run([sys.executable, "-c", script], env=os.environ | {"JAX_NUM_CPU_DEVICES": "3"}, check=True)
    with np.load(path) as file:
        for name, one in zip(file.files, jax.tree.leaves((cells, kept)), strict=True):
            np.testing.assert_allclose(file[name], one, rtol=3e-6)  # float32, measured 1.4e-6
