"""Walls that count by the types of their two cells: areas, local differences, and tissue that sorts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import plan_lines

TUBE, CELLS = jt.Tube(length=16, apical_radius=2, basal_radius=5), 90
WEIGHTS = np.array([[1.0, 3.0], [3.0, 0.5]])
STEP, MEASURE = jax.jit(jt.step), jax.jit(measure_cells)


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(3), CELLS))


@pytest.fixture(scope="module")
def types() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 2, CELLS)


def lateral_areas(positions: np.ndarray, adhesion: jt.Adhesion | None) -> np.ndarray:
    neighbors = jt.NeighborList.allocate(positions, TUBE)
    lines = plan_lines(TUBE, CELLS, jt.PRESETS["fine"])
    place = jnp.asarray(positions)
    return np.asarray(MEASURE(place, TUBE, lines, neighbors.candidates, adhesion=adhesion)[0].lateral_area)


def test_lateral_areas_are_sums_of_weighted_walls(positions, types):
    contacts = jt.find_contacts(positions, TUBE)
    one, two = contacts.pairs.T
    weighted = contacts.area * WEIGHTS[types[one], types[two]]
    expected = np.bincount(one, weighted, CELLS) + np.bincount(two, weighted, CELLS)
    found = lateral_areas(positions, jt.Adhesion(types, WEIGHTS))
    # `fine` errs by 0.2 % of the mean lateral area where walls are weighted alike; here they jump by up to six times
    np.testing.assert_allclose(found, expected, atol=0.06 * expected.mean())
    assert abs(found - expected).mean() < 0.005 * expected.mean()


def test_equal_weights_are_a_factor(positions, types):
    plain = lateral_areas(positions, None)
    np.testing.assert_allclose(
        lateral_areas(positions, jt.Adhesion(types, np.full((2, 2), 2.5))), 2.5 * plain, rtol=1e-5
    )


def test_local_differences_add_up(positions, types, x64):
    model = jt.tube_model(TUBE, CELLS, adhesion=jt.Adhesion(types, WEIGHTS))
    state, change = jt.init(positions, model), 0.0
    before = float(jt.epithelial_energy(state.cells, model).sum())
    for key in jax.random.split(jax.random.key(0), 4):
        state, info = STEP(key, state, model)
        change += float(info.energy_change)
    fresh = jt.init(state.positions, model)
    after = float(jt.epithelial_energy(fresh.cells, model).sum())
    assert after - before == pytest.approx(change, rel=1e-9)


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.int64])
def test_types_of_any_width_find_their_weights(dtype):
    weights = np.arange(400.0).reshape(20, 20)
    types = np.arange(20, dtype=dtype)
    found = jt.Adhesion(types, weights + weights.T).between(jnp.array([12, 19]), jnp.array([19, 19]))
    assert found.tolist() == [(weights + weights.T)[12, 19], (weights + weights.T)[19, 19]]


def test_lists_of_types_and_weights_will_do(positions, types):
    listed = jt.Adhesion(types.tolist(), WEIGHTS.tolist())
    energies = [
        jt.anneal(positions, TUBE, sweeps=0, model=jt.tube_model(TUBE, CELLS, adhesion=adhesion)).energies[0]
        for adhesion in (listed, jt.Adhesion(types, WEIGHTS))
    ]
    assert energies[0] == energies[1]
    contacts = jt.find_contacts(positions, TUBE)
    weighted = contacts.area * WEIGHTS[types[contacts.pairs[:, 0]], types[contacts.pairs[:, 1]]]
    model = jt.tube_model(TUBE, CELLS)
    volume = np.asarray(jt.measure_tissue(positions, TUBE).volume)
    expected = ((volume - float(model.mean_volume)) ** 2).sum() / 2 + 0.4 * 2 * weighted.sum()
    assert energies[0] == pytest.approx(expected, rel=0.02)  # by `draft`


def unlike(positions: np.ndarray, types: np.ndarray) -> float:
    """The fraction of wall area between cells of unlike types."""
    contacts = jt.find_contacts(positions, TUBE)
    apart = types[contacts.pairs[:, 0]] != types[contacts.pairs[:, 1]]
    return float(contacts.area[apart].sum() / contacts.area.sum())


def test_unlike_cells_part_and_like_ones_do_not(positions, types):
    parted, mixed = (
        jt.anneal(positions, TUBE, sweeps=14, model=jt.tube_model(TUBE, CELLS, adhesion=jt.Adhesion(types, weights)))
        for weights in (np.array([[1.0, 20.0], [20.0, 1.0]]), np.ones((2, 2)))
    )
    assert unlike(parted.positions, types) < 0.8 * unlike(mixed.positions, types)
    assert parted.energies[-1] < parted.energies[0]


@pytest.mark.parametrize(
    ("types", "weights", "told"),
    [
        (np.zeros(89, int), WEIGHTS, "each of the 90 cells"),
        (np.zeros(90), WEIGHTS, "whole number"),
        (np.full(90, 2), WEIGHTS, "types range from 2 to 2, but weights have 2 rows"),
        (np.zeros(90, int), np.ones((2, 3)), r"\(2, 3\)"),
        (np.zeros(90, int), np.array([[1.0, 2.0], [3.0, 1.0]]), "not symmetric"),
        (np.zeros(90, int), np.array([[np.nan]]), "finite"),
    ],
)
def test_bad_types_and_weights_are_refused(types, weights, told):
    with pytest.raises(ValueError, match=told):
        jt.tube_model(TUBE, 90, adhesion=jt.Adhesion(types, weights))
