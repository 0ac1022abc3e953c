"""Parallel tempering: exchanges in detailed balance, and tissues as often as by single chains."""

import itertools

import jax
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.dynamics.annealer import advance_together
from jaxtissue.dynamics.tempering import TemperResult, exchange_chance

TUBE, CELLS, SWEEPS = jt.Tube(length=4.0, apical_radius=1.0, basal_radius=3.0), 6, 60
TEMPERATURES = [2.0, 4.0, 8.0]


def test_exchanges_leave_the_distribution_of_all_replicas_as_it_is():
    """All states of two replicas with four tissues each, enumerated."""
    energies, heat = np.array([-1.0, 0.0, 0.5, 3.0]), np.array([0.7, 1.9])
    weight = np.exp(-energies[:, None] / heat[0] - energies / heat[1])
    states = list(itertools.product(range(4), repeat=2))
    moves = np.zeros((16, 16))
    for row, (low, high) in enumerate(states):
        chance = exchange_chance(energies[[low, high]], heat)
        moves[row, states.index((high, low))] += chance
        moves[row, row] += 1 - chance
    flow = weight.ravel()[:, None] * moves
    np.testing.assert_allclose(flow, flow.T, rtol=1e-12)
    assert (moves[moves != np.diag(np.diag(moves))] > 0).any()


@pytest.fixture(scope="module")
def start() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(3), CELLS))


@pytest.fixture(scope="module")
def tempered(start) -> TemperResult:
    """A run, and the energies that were exchanged in it."""
    return jt.temper(start, jt.tube_model(TUBE, CELLS), TEMPERATURES, sweeps=SWEEPS, seed=1)


def mean_and_error(energies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means at each temperature after 12 sweeps, and their errors by means of batches of 8 sweeps."""
    batches = energies[13:].reshape(6, 8, -1).mean(axis=1)
    return batches.mean(axis=0), batches.std(axis=0, ddof=1) / 6**0.5


def test_tempering_finds_the_energies_of_single_chains(start, tempered):
    model = jt.tube_model(TUBE, CELLS)
    runs = [jt.Annealer(model, "draft", "mh", 9 + k, np.full(SWEEPS, heat)) for k, heat in enumerate(TEMPERATURES)]
    states, energies = [run.start(start) for run in runs], [(0.0,) * 3]
    while states[0].sweep < SWEEPS:
        played = advance_together(runs, states)
        states = [state for state, _, _ in played]
        energies += zip(*([record.energy for record in records] for _, records, _ in played), strict=True)
    (mean, error), (expected, its_error) = mean_and_error(tempered.energies), mean_and_error(np.array(energies))
    # `benchmarks/samplers.py` has longer runs
    assert (np.abs(mean - expected) < 4 * np.hypot(error, its_error)).all(), (mean, error, expected, its_error)
    assert (np.diff(mean) > 0).all()  # exchanges the wrong way would turn the temperatures round


def test_tissues_travel_and_the_seed_tells_how(start, tempered):
    assert (np.sort(tempered.origins, axis=1) == np.arange(3)).all()
    assert (tempered.swaps > 0).all() and (tempered.swaps < 1).all()
    assert len(np.unique(tempered.origins[:, 0])) > 1  # the coldest has left
    model, seen = jt.tube_model(TUBE, CELLS), []

    def see(*told) -> bool:
        seen.append(told)
        return len(seen) == 12

    again = jt.temper(start, model, TEMPERATURES, sweeps=SWEEPS, seed=1, callback=see)
    np.testing.assert_array_equal(again.energies, tempered.energies[:13])
    np.testing.assert_array_equal(again.positions, seen[-1][1])


@pytest.mark.parametrize(
    ("temperatures", "told"), [([2.0], "at least two"), ([2.0, 1.0], "above 0 and increasing"), ([0.0, 1.0], "above 0")]
)
def test_temperatures_are_refused(start, temperatures, told):
    with pytest.raises(ValueError, match=told):
        jt.temper(start, jt.tube_model(TUBE, CELLS), temperatures)
