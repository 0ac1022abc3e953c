"""Inference: parameters are found again at a minimum, with errors that hold, or it is said why not.

Most for made-up volumes and areas, which are quick; `benchmarks/inference.py` has many tissues.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

import jaxtissue as jt
from jaxtissue.minimization import inference

TUBE, CELLS = jt.Tube(length=10.0, apical_radius=2.0, basal_radius=5.0), 20
MEAN, TENSION, MODULUS = TUBE.volume / CELLS, 3.0, 2.0
PLACES = np.stack([np.linspace(0.5, 9.5, CELLS), np.arange(CELLS) % 6], axis=-1)


class MadeUp:
    """Volumes that add up to that of the tube, and an area, quadratic in the places of the backbones."""

    def __init__(self) -> None:
        rng, size = np.random.default_rng(0), 2 * CELLS
        self.first, second = rng.normal(0, 4, (CELLS, size)), rng.normal(0, 0.3, (CELLS, size, size))
        self.first -= self.first.mean(axis=0)
        self.second = second + second.transpose(0, 2, 1)
        self.second -= self.second.mean(axis=0)
        self.pull, self.stiff = rng.normal(0, 3, size), 2 * np.eye(size)

    def forces(self, place: np.ndarray, members: np.ndarray) -> inference.Forces:
        slopes = self.first + self.second @ place
        volumes = (self.first + slopes) @ place / 2  # above the mean
        return inference.Forces(self.pull + self.stiff @ place, volumes @ slopes, members @ slopes)

    def minimum(self, above: np.ndarray) -> np.ndarray:
        def energy(place: np.ndarray) -> tuple[float, np.ndarray]:
            volumes = (self.first + self.second @ place / 2) @ place
            area = (self.pull + self.stiff @ place / 2) @ place
            value = ((volumes - above) ** 2).sum() / 2 + TENSION / MODULUS * area
            found = self.forces(place, above[None])
            return value, found.elastic + TENSION / MODULUS * found.tension - found.pressure[0]

        return minimize(energy, np.zeros(2 * CELLS), jac=True, method="BFGS", options={"gtol": 1e-10}).x


@pytest.fixture(scope="module")
def tissue() -> MadeUp:
    return MadeUp()


@pytest.fixture
def infer(tissue, monkeypatch):
    """Inference of a made-up tissue with backbones at given places."""

    def at(place: np.ndarray, **known):
        class MadeUpTissue(SimpleNamespace):
            shape, width = (CELLS, 2), 1.0

            def forces(self, moved=0.0):
                return tissue.forces(place + np.ravel(moved), self.members)

        monkeypatch.setattr(inference, "_Tissue", lambda *given: MadeUpTissue(members=given[3]))
        return jt.infer_parameters(PLACES, TUBE, modulus=MODULUS, **known)

    return at


def test_parameters_are_found_at_a_minimum(tissue, infer):
    found = infer(tissue.minimum(np.zeros(CELLS)))
    assert found.tension == pytest.approx(TENSION, rel=1e-4) and found.tension_error < 1e-3
    np.testing.assert_allclose(found.target_volumes, float(MEAN))
    types = np.arange(CELLS) % 3
    targets = MEAN + np.array([2.0, -1.0, 0.0])
    targets -= targets[types].mean() - MEAN
    place = tissue.minimum(targets[types] - MEAN)
    found = infer(place, types=types)
    assert found.tension == pytest.approx(TENSION, rel=1e-4)
    np.testing.assert_allclose(found.target_volumes, targets, atol=1e-4)
    np.testing.assert_allclose(infer(place, types=types, tension=TENSION).target_volumes, targets, atol=1e-4)
    every = infer(place, types=np.arange(CELLS), tension=TENSION)
    np.testing.assert_allclose(every.target_volumes, targets[types], atol=1e-3)


def test_errors_hold_what_noise_does(tissue, infer):
    place, rng = tissue.minimum(np.zeros(CELLS)), np.random.default_rng(1)
    founds = [infer(place + rng.normal(0, 0.003, place.shape)) for _ in range(20)]
    off = np.array([found.tension - TENSION for found in founds])
    error = np.array([found.tension_error for found in founds])
    assert (np.abs(off) < 2 * error).sum() >= 17  # 92 % of 60 as measured; the bar is 90 %
    assert error.mean() < 3 * off.std()  # and no wider than they must be
    assert np.mean([found.noise for found in founds]) == pytest.approx(0.003, rel=0.5)  # rough


def own_targets(cells: jt.CellGeometry, model: jt.Model):
    return model.modulus / 2 * (model.parameters - cells.volume) ** 2 + model.tension * cells.lateral_area


def test_a_relaxed_tissue_tells_its_tension_and_target_volumes(monkeypatch):
    monkeypatch.setattr(inference, "MANY", 4)  # displaced tissues: errors are not looked at
    tube, types = jt.Tube(12.0, 2.0, 3.0), np.array([1, 1, 0, 0, 0, 0, 0, 2, 2])
    mean, wanted = float(tube.volume) / 9, np.array([1.0, 1.1, 0.9])
    tension = 0.1 * mean ** (4 / 3)
    model = jt.tube_model(tube, 9, 1.0, tension, own_targets, parameters=(wanted * mean)[types])
    start = np.stack([np.arange(9) + 0.5, 1.8 * np.arange(9)], axis=1) * [12 / 9, 4 / 3]
    relaxed = jt.relax(start + 0.1 * np.sin(np.arange(18)).reshape(9, 2), model, resolution="traced")
    assert relaxed.converged  # the gradient fell to 1e-6 of what it was
    found = jt.infer_parameters(relaxed.positions, tube, types=types)
    assert found.tension == pytest.approx(tension, rel=1e-4)  # 1e-6 as measured
    np.testing.assert_allclose(found.target_volumes, wanted * mean, rtol=1e-5)
    assert found.noise < 1e-5


def test_inner_backbones_are_those_that_change_no_cell_at_an_end():
    tube, n = jt.Tube(20.0, 1.0, 1.5), 24
    place = np.stack([np.arange(n) + 0.5, 2.4 * np.arange(n)], axis=1) * [20 / n, 1.0]
    inner = inference._Tissue(place, tube, None, np.ones((1, n))).inner_rows()[::2]
    ends, before = jt.find_connectivity(place, tube).is_end, inference.measured_and_slopes(place, tube, None)[0]
    for cell in (np.flatnonzero(inner)[0], np.flatnonzero(~inner & ~ends)[0]):
        moved = place.copy()
        moved[cell] += 1e-3
        change = np.abs(inference.measured_and_slopes(moved, tube, None)[0] - before)[0, ends].max()
        assert (change < 1e-10) == inner[cell]


@pytest.mark.parametrize(
    ("known", "told"),
    [
        ({"types": np.arange(CELLS)}, "only up to a common factor"),
        ({"types": [0, 1]}, "give the type of each"),
        ({"tension": 1.0}, "nothing is left to infer"),
        ({"modulus": 0.0}, "positive modulus"),
    ],
)
def test_what_forces_do_not_tell_is_refused(known, told):
    with pytest.raises(ValueError, match=told):
        jt.infer_parameters(PLACES, TUBE, **known)


def test_walls_that_pull_alike_tell_no_tension(tissue, infer, monkeypatch):
    monkeypatch.setattr(tissue, "pull", np.zeros(2 * CELLS))
    with pytest.raises(ValueError, match="pulls of the walls cancel"):
        infer(np.zeros(2 * CELLS))
