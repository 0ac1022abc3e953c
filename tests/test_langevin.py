"""Langevin moves: in detailed balance, right in the mean, and within the tube."""

import itertools
from typing import Any, cast

import jax
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.minimization.langevin import Chain
from jaxtissue.minimization.lbfgs import Point


class Wells:
    """An energy of one coordinate with two wells, and of another that is free between limits."""

    def renewed(self, place: np.ndarray) -> Point:
        x = place[:, 1]
        energy = float((x**4 / 4 - x**2 / 2 + 0.3 * x).sum() + place[:, 0].sum())
        return Point(place, energy, np.stack([np.ones_like(x), x**3 - x + 0.3], axis=1))


def test_moves_are_in_detailed_balance():
    """Of all pairs among some places: what flows one way flows back, with drifts that are cut off and that are not."""
    chain = Chain(cast(Any, Wells()), np.array([[0.5, 1.0]]), 0.7, 0.4, 0, (0.0, 1.0))
    places = [chain.energy.renewed(np.array([[u, v]])) for u in (0.1, 0.8) for v in (-3.0, -0.5, 0.2, 1.5)]
    drifts = np.array([np.abs(chain.drift(here)).max() for here in places])
    assert (drifts == 2 * chain.step).any() and (drifts < 2 * chain.step).any()
    for here, there in itertools.permutations(places, 2):
        flows = []
        for one, two in ((here, there), (there, here)):
            off = two.place - one.place - chain.drift(one)
            density = -one.energy / chain.temperature - (off**2).sum() / (2 * chain.step**2)
            flows.append(density + min(0.0, chain.log_ratio(one, two)))
        assert flows[0] == pytest.approx(flows[1], abs=1e-9)


def test_means_are_those_of_the_boltzmann_distribution():
    heat = 0.7
    chain = Chain(cast(Any, Wells()), np.array([[0.5, 1.0]]), heat, 0.3, 1, (0.0, 1.0))
    for k in range(200):
        chain.adjust(k)
    found = []
    for _ in range(4000):
        chain.move()
        found.append(chain.here.place[0])
    x = np.linspace(-4, 4, 4001)
    weight = np.exp(-(x**4 / 4 - x**2 / 2 + 0.3 * x) / heat)
    u = np.linspace(0, 1, 1001)
    expected = [(u * np.exp(-u / heat)).sum() / np.exp(-u / heat).sum(), (x * weight).sum() / weight.sum()]
    batches = np.array(found).reshape(20, -1, 2).mean(axis=1)
    error = batches.std(axis=0, ddof=1) / 20**0.5
    assert (np.abs(batches.mean(axis=0) - expected) < 4 * error).all() and (error < [0.03, 0.2]).all()


def test_a_tissue_is_sampled():
    tube, n = jt.Tube(length=4.0, apical_radius=1.0, basal_radius=3.0), 6
    start, model, heard = tube.random_positions(jax.random.key(3), n), jt.tube_model(tube, n), []
    told = [jt.sample_langevin(start, model, 4.0, 20, 10, callback=lambda e, p: heard.append(e)) for _ in range(2)]
    np.testing.assert_array_equal(told[0].positions, told[1].positions)  # lists of the first serve the second as well
    result = told[0]
    assert heard[:20] == result.energies.tolist() and 0 < result.acceptance <= 1 and result.step > 0
    again = jt.measure_tissue(result.positions, tube, "draft", refine=False)
    assert float(jt.epithelial_energy(again, model).sum()) == pytest.approx(result.energies[-1], rel=1e-4)
    assert "20 moves" in repr(result)
    sphere = jt.Sphere(2.0, 2.5)
    with pytest.raises(ValueError, match="Sphere are not supported"):
        jt.sample_langevin(start, jt.tube_model(sphere, n), 1.0)
