"""Gradients: of energies against differences, in both modes and precisions; relaxation against Metropolis."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import read_reference
from known import known

import jaxtissue as jt
from jaxtissue.measurement.quadrature import PRESETS, plan_lines, trace_lines
from jaxtissue.minimization.lbfgs import LBFGS, Point
from jaxtissue.minimization.relaxation import MINIMIZERS
from jaxtissue.minimization.traced_energy import TracedEnergy
from jaxtissue.minimization.tube_energy import TubeEnergy
from jaxtissue.topology.traced_slopes import trace_tissue, traced_slopes

WITH_GRADIENT = jax.jit(jax.value_and_grad(jt.tissue_energy), static_argnames="resolution")
TUBE, CELLS = jt.Tube(length=16.0, apical_radius=2.0, basal_radius=5.0), 60
MINIMUM = np.array(
    [  # of 12 cells in Tube(6, 1, 3), relaxed with "traced"
        (1.015492558, 3.369066477),
        (0.967020631, 1.941124558),
        (0.979546607, 0.227414668),
        (3.000241280, 0.815834463),
        (0.967056930, 4.797144413),
        (3.000330925, 4.320603848),
        (2.999980688, 2.417429924),
        (2.999675512, 5.922223091),
        (5.032811165, 1.940834284),
        (5.020356655, 0.227458328),
        (4.984429836, 3.368995428),
        (5.032856941, 4.796985626),
    ]
)


@pytest.fixture(scope="module")
def start() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(2), CELLS))


def surfaces_too(cells: jt.CellGeometry, model: jt.Model) -> jax.Array:
    """An energy of all sizes and of parameters."""
    rings, basal = model.parameters * known(cells.apical_perimeter) ** 2, 0.2 * known(cells.basal_area)
    return jt.epithelial_energy(cells, model) + rings + basal


def test_the_gradient_is_that_of_the_energy(start, x64):
    model = jt.tube_model(TUBE, CELLS, cell_energy=surfaces_too, parameters=jnp.linspace(0.1, 0.3, CELLS))
    model, place = model.with_surfaces(), jnp.asarray(start, float)
    neighbors = jt.NeighborList.allocate(place, TUBE)

    @jax.jit
    def both(place, model):
        return jax.value_and_grad(jt.tissue_energy, argnums=(0, 1))(place, model, neighbors, "draft")

    @jax.jit
    def forward(place, way):
        return jax.jvp(lambda place: jt.tissue_energy(place, model, neighbors, "draft"), (place,), (way,))[1]

    by_place, by_model = both(place, model)[1]
    rng, step = np.random.default_rng(0), 1e-6
    for _ in range(3):
        way = rng.normal(size=place.shape)
        expected = float(both(place + step * way, model)[0] - both(place - step * way, model)[0]) / (2 * step)
        assert float((by_place * way).sum()) == pytest.approx(expected, rel=1e-5)  # differences in float64
        assert float(forward(place, jnp.asarray(way))) == pytest.approx(float((by_place * way).sum()), rel=1e-9)
    for name, where in {
        "tube.length": lambda model: model.tube.length,
        "tube.apical_radius": lambda model: model.tube.apical_radius,
        "tube.basal_radius": lambda model: model.tube.basal_radius,
        "tension": lambda model: model.tension,
    }.items():
        leaves, tree = jax.tree.flatten(model)
        at = [leaf is where(model) for leaf in leaves].index(True)

        def moved(by: float, leaves: list = leaves, tree=tree, at: int = at):
            changed = [jnp.asarray(leaf) + by * (k == at) for k, leaf in enumerate(leaves)]
            return both(place, jax.tree.unflatten(tree, changed))[0]

        expected = float(moved(step) - moved(-step)) / (2 * step)
        assert float(where(by_model)) == pytest.approx(expected, rel=1e-5, abs=1e-5), name


def test_the_energy_is_that_of_the_measured_cells(start):
    model = jt.tube_model(TUBE, CELLS)
    cells = jt.measure_tissue(start, TUBE, "draft", refine=False)
    expected = float(jt.epithelial_energy(cells, model).sum())
    assert jt.relax(start, model, steps=0).energy == pytest.approx(expected, rel=1e-4)


@pytest.mark.filterwarnings("ignore:backbones .* too close to each other")
@pytest.mark.parametrize("name", ["n1", "duplicate_x", "near_coincident"])
def test_gradients_are_finite_on_every_reference_tube(name: str):
    ref = read_reference(name)
    place = jnp.asarray(ref.positions, jnp.float32)
    model = jt.tube_model(ref.tube, len(place))
    neighbors = jt.NeighborList.allocate(place, ref.tube)
    energy, gradient = WITH_GRADIENT(place, model, neighbors, "draft")
    assert np.isfinite(float(energy)) and np.isfinite(np.asarray(gradient)).all()
    traced = TracedEnergy(model, len(place))
    assert np.isfinite(traced(ref.positions * traced.units).gradient).all()
    assert abs(float(gradient[:, 1].sum())) <= 1e-3 * float(jnp.abs(gradient).max()) * len(
        place
    )  # turning costs nothing


def test_traced_gradients_are_those_of_true_sizes():
    """Of cells at the ends and round the lumen, with adhesion, and with a wall parallel to the axis."""
    tube, n = jt.Tube(6.0, 1.0, 3.0), 12
    place = np.array(tube.random_positions(jax.random.key(0), n), float)
    model = jt.tube_model(tube, n, adhesion=jt.Adhesion(np.arange(n) % 2, [[1.0, 2.0], [2.0, 0.5]]))
    energy, step = TracedEnergy(model, n), 1e-4
    level = place.copy()
    level[1, 0] = level[0, 0]
    for given, bar in ((place, 1e-5), (level, 1e-3)):  # level backbones are parted
        x = given * energy.units
        way = np.random.default_rng(0).normal(size=x.shape)
        way[:2] *= [[given is place, 1]]
        expected = (energy(x + step * way).energy - energy(x - step * way).energy) / (2 * step)
        assert (energy(x).gradient * way).sum() == pytest.approx(expected, rel=bar)
    neighbors = jt.NeighborList.allocate(place, tube)
    found = jax.jit(jax.grad(lambda place: jt.tissue_energy(place, model, neighbors, "traced")))(jnp.asarray(place))
    here = energy(np.asarray(jnp.asarray(place), float) * energy.units)
    expected = here.gradient * energy.units
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())  # float32
    by_length = jax.grad(
        lambda length: jt.tissue_energy(place, jt.tube_model(jt.Tube(length, 1.0, 3.0), n), neighbors, "traced")
    )
    assert np.isnan(by_length(6.0))  # not derived, which must not pass for 0
    with pytest.raises(ValueError, match="sizes on the surfaces"):
        jt.tissue_energy(place, model.with_surfaces(), neighbors, "traced")
    with pytest.raises(ValueError, match="centroids"):
        jt.relax(place, model, "lloyd", resolution="traced")


def test_volume_gradients_are_those_of_true_volumes(x64):
    ref = read_reference("bluenoise_ratio10")
    place, tube = ref.positions, ref.tube
    model = jt.tube_model(tube, len(place), cell_energy=jt.volume_elasticity)
    neighbors = jt.NeighborList.allocate(place, tube)
    gradient = np.asarray(WITH_GRADIENT(jnp.asarray(place), model, neighbors, "standard")[1])

    def energy(place: Any) -> float:
        sizes = known(jt.find_connectivity(place, tube).sizes)
        return float(
            np.sum(jt.volume_elasticity(jt.CellGeometry(*map(jnp.asarray, (sizes.volume, sizes.lateral_area))), model))
        )

    found, expected, step = [], [], 1e-4
    for seed in range(3):
        way = np.random.default_rng(seed).normal(size=place.shape) / [1, float(tube.basal_radius)]
        found.append((gradient * way).sum())
        expected.append((energy(place + step * way) - energy(place - step * way)) / (2 * step))
    cosine = np.dot(found, expected) / np.linalg.norm(found) / np.linalg.norm(expected)
    assert cosine > 0.9999  # the bar; measured 0.99999


@pytest.mark.parametrize("apart", [0.0, 1e-6, 2e-5, 3e-4])
def test_traced_gradients_hold_in_level_rings(apart):
    """Walls along the axis, or nearly so, on either side of what is taken as level."""
    rng, tube = np.random.default_rng(2), jt.Tube(4, 2, 4)
    angle = np.tile(2 * np.pi * np.arange(9) / 9, 2) + rng.uniform(-0.05, 0.05, 18)
    place = np.column_stack([np.repeat([1.1, 2.9], 9) + apart * rng.uniform(-1, 1, 18), angle])
    weight, way = rng.normal(size=(2, 18)), np.column_stack([np.zeros(18), rng.normal(size=18)])

    def value(step: float) -> float:
        sizes = known(trace_tissue(place + step * way, tube)).sizes
        return float(weight[0] @ np.asarray(sizes.volume) + weight[1] @ np.asarray(sizes.lateral_area))

    slope = traced_slopes(known(trace_tissue(place, tube)).graph, *weight)
    assert np.sum(slope * way) == pytest.approx((value(1e-4) - value(-1e-4)) / 2e-4, rel=1e-3)


def test_area_gradients_on_few_layers_are_those_of_true_areas(x64):
    """Cells exchange neighbors between the layers: counted where they are seen, their corners would be off by 0.08."""
    fold, n = jt.Fold(width=6, depth=3, amplitude=0.6, wavelength=6, thickness=0.5), 60
    place = np.asarray(fold.random_positions(jax.random.key(0), n), float)
    model = jt.tube_model(fold, n, cell_energy=jt.lateral_tension)
    neighbors = jt.NeighborList.allocate(place, fold)
    slope = jax.jit(jax.grad(jt.tissue_energy), static_argnames="resolution")
    few, many = (np.asarray(slope(place, model, neighbors, resolution=layers)) for layers in ("4x1", "24x1"))
    cosine = (few * many).sum() / np.linalg.norm(few) / np.linalg.norm(many)
    assert cosine > 0.999  # the bar; measured 0.9993, and 0.9965 with the corners counted so


def test_where_changes_of_the_energy_are_noise_slopes_lead_on():
    """The gradient vanishes 1e-5 away from the lowest energy, which is lower there by 1e-10 of it at most."""
    stiff, away = np.array([[1.0, 3.0], [0.3, 2.0]]), 1e-5

    def reached(noise: float) -> float:
        def function(place):
            return Point(place, 1 + (stiff * place**2).sum() / 2, stiff * (place - away), noise)

        minimizer, here = LBFGS(), function(np.ones((2, 2)))
        points = [here := minimizer.step(function, here, 1.0) for _ in range(40)]
        return min(float(np.linalg.norm(point.gradient)) for point in points if point.energy <= 1 + 1e-9)

    assert reached(1e-9) < 1e-12 < 1e-10 < reached(0.0)  # by leaps alone


def test_traced_energies_lead_on_by_slopes_in_any_session(start, dtype):
    energy = TracedEnergy(jt.tube_model(TUBE, CELLS), CELLS)
    here = energy(energy.placed(start))
    assert here._replace(energy=here.energy * (1 + 1e-10)).is_level_with(here)
    assert not here._replace(energy=here.energy * (1 + 1e-8)).is_level_with(here)


def test_lines_of_traced_tubes_are_those_of_tubes(dtype):
    trace = jax.jit(trace_lines, static_argnums=(1, 2, 3))
    for size in (PRESETS["draft"], jt.Resolution(2, 3.0), jt.Resolution(1, 4.0)):
        known, traced = plan_lines(TUBE, CELLS, size, surfaces=True), trace(TUBE, CELLS, size, True)
        assert known.half == traced.half
        for one, other in zip(jax.tree.leaves(known), jax.tree.leaves(traced), strict=True):
            np.testing.assert_allclose(one, other, rtol=3e-5 if dtype == jnp.float32 else 1e-12)


@pytest.fixture(scope="module")
def swept(start) -> float:
    """The energy after some sweeps that only go down."""
    model = jt.tube_model(TUBE, CELLS)
    annealer = jt.Annealer(model, "draft", "is-mh", 0, np.zeros(8))
    state, energy = annealer.start(start), 0.0
    while state.sweep < 8:
        state, records, _ = annealer.advance(state)
        energy = records[-1].energy
    return energy


@pytest.mark.parametrize("method", MINIMIZERS)
def test_relaxation_goes_where_sweeps_go_and_below(start, swept, method: str):
    model = jt.tube_model(TUBE, CELLS)
    heard: list[float] = []
    result = jt.relax(start, model, method, steps=3, callback=lambda record, place: heard.append(record.energy))
    energies = [record.energy for record in result.history]
    assert heard == energies and energies == sorted(energies, reverse=True)
    assert result.energy < swept < 0.5 * energies[0]
    again = jt.measure_tissue(result.positions, TUBE, "draft", refine=False)
    assert float(jt.epithelial_energy(again, model).sum()) == pytest.approx(result.energy, rel=1e-4)  # lists held


def test_centroids_are_those_of_points_however_the_tube_is_turned(start):
    energy = TubeEnergy(jt.tube_model(TUBE, CELLS), CELLS, PRESETS["draft"])
    axial, radius, turn = np.meshgrid(
        (np.arange(80) + 0.5) / 80 * 16, 2 + (np.arange(9) + 0.5) / 3, (np.arange(120) + 0.5) / 120 * 2 * np.pi
    )
    points = np.stack([axial.ravel(), radius.ravel(), turn.ravel()], axis=-1)
    cosine = np.cos(points[:, 2:] - start[:, 1])
    foot = np.clip(points[:, 1:2] * cosine, 2, 5)
    square = (points[:, :1] - start[:, 0]) ** 2 + foot**2 - 2 * foot * points[:, 1:2] * cosine
    cell, turn = square.argmin(axis=1), points[:, 2]
    moments = [np.bincount(cell, points[:, 1] * by) for by in (1, points[:, 0], np.cos(turn), np.sin(turn))]
    expected = np.stack([moments[1] / moments[0], np.arctan2(moments[3], moments[2])], axis=-1)
    place = start * energy.units
    energy.renew(place)
    found = energy.centroids(place)
    off, around = found - expected * energy.units, 2 * np.pi * energy.units[1]
    off[:, 1] = (off[:, 1] + around / 2) % around - around / 2
    assert np.sqrt((off**2).mean()) < 0.02 * energy.width  # points are 0.1 widths apart, lines a fourth
    turned = place + np.array([0, 2.0])
    np.testing.assert_allclose(energy.centroids(turned) - turned, found - place, atol=1e-4)  # float32


def test_lloyd_makes_cells_alike(start):
    model, energies = jt.tube_model(TUBE, CELLS), []
    result = jt.relax(start, model, "lloyd", steps=3, callback=lambda record, _: energies.append(record.energy))
    assert result.energy < 0.5 * energies[0] and result.energy == energies[-1] and not result.converged
    assert jt.relax(start, model, "lloyd", steps=3, tolerance=0.5).message == "converged"


def test_relaxation_ends_and_refuses():
    place = TUBE.random_positions(jax.random.key(1), CELLS)
    model = jt.tube_model(TUBE, CELLS)
    ended = jt.relax(place, model, steps=2, callback=lambda *_: True)
    assert len(ended.history) == 1 and ended.message == "stopped by the callback"
    np.testing.assert_array_equal(ended.positions, place)
    with pytest.raises(ValueError, match="unknown method 'newton'"):
        jt.relax(place, model, "newton")
    with pytest.raises(ValueError, match="cells"):
        jt.relax(place[:-1], model)


def test_a_minimum_moves_with_the_tension():
    """Where it has moved to, the changed energy pulls no more than the energy before the change did there."""
    tube = jt.Tube(6.0, 1.0, 3.0)

    def with_tension(tension):
        return jt.tube_model(tube, len(MINIMUM), tension=tension)

    way, step = jt.minimum_response(MINIMUM, with_tension, 0.4), 0.01
    changed = TracedEnergy(with_tension(0.4 + step), len(MINIMUM))
    pulls = [np.linalg.norm(changed(place * changed.units).gradient) for place in (MINIMUM, MINIMUM + step * way)]
    assert pulls[1] < 0.1 * pulls[0]  # 0.05, of which the most is left of the relaxation that found the minimum
    with pytest.raises(ValueError, match="not a minimum"):
        jt.minimum_response(MINIMUM + np.array([0.01, 0]), with_tension, 0.4)
