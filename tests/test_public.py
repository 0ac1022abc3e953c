"""The public fence: names, manners of results, one call to anneal, one sweep as a pure function."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.cli import help_texts
from jaxtissue.cli.commands import main
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import plan_lines

TUBE = jt.Tube(length=12, apical_radius=1, basal_radius=3)
CELLS = 40
STEP = jax.jit(jt.step)
NAMES = """
BentTube Ellipsoid EllipticTube Fold RoundTube Shell Slab Sphere PRESETS Adhesion AnnealResult Annealer CellGeometry
CellMeasurer Connectivity Contacts ExactDiagram LabelCells Model NeighborList Resolution SweepRecord TissueFit Tube
anneal bound_ratios cartesian_voxels cells_for_unit_volume constant_schedule covering_radius cylindrical_voxels
epithelial_energy exact_cells find_connectivity find_contacts find_transitions fit_neighbor_law fit_tissue
geometric_schedule infer_parameters init label_image label_points label_volumes lateral_tension load_domain
measure_labels measure_tissue minimum_response nearest_backbones polygon_classes relax sample_langevin separation step
summarize_connectivity tabulate_connectivity temper tightness tissue_energy tissue_graph tube_model
use_cores volume_elasticity
"""


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(0), CELLS))


@pytest.fixture(scope="module")
def result(positions) -> jt.AnnealResult:
    return jt.anneal(positions, TUBE, sweeps=12)


def test_public_names_are_frozen():
    assert sorted(jt.__all__) == sorted(NAMES.split()) and len(jt.__all__) <= 64
    assert dir(jt) == sorted([*jt.__all__, "__version__"])
    assert not any(isinstance(getattr(jt, name), type(sys)) for name in dir(jt))
    assert jt.__version__.count(".") == 2
    described = set(
        re.findall(r"^\.\. \S+:: (\w+)$", (Path(__file__).parents[1] / "docs" / "api.md").read_text(), re.M)
    )
    assert described >= set(jt.__all__), "add to docs/api.md"


def test_one_call_anneals_as_the_annealer_does(positions, result):
    run = Annealer(jt.tube_model(TUBE, CELLS), "draft", "is-mh", 0, jt.constant_schedule(2.0, 12))
    state = run.start(positions)
    while state.sweep < 12:
        state, _, _ = run.advance(state)
    np.testing.assert_array_equal(result.positions, state.positions)
    assert len(result.energies) == 13 and result.energies[-1] < result.energies[0]
    assert [record.sweep for record in result.records] == list(range(13))
    np.testing.assert_allclose(result.cells.volume.sum(), TUBE.volume, rtol=1e-4)
    assert result.cells.tiling_defect == 0 and float(result.cells.volume_error.max()) < 0.01 * TUBE.volume / CELLS


def test_a_callback_sees_each_sweep_and_ends_the_run(positions):
    seen = []

    def callback(record, place):
        seen.append((record.sweep, place.copy()))
        return record.sweep == 3

    result = jt.anneal(positions, TUBE, sweeps=12, callback=callback)
    assert [sweep for sweep, _ in seen] == [1, 2, 3] and len(result.energies) == 4
    np.testing.assert_array_equal(result.positions, seen[-1][1])


def test_any_true_answer_ends_a_run_and_none_does_not(positions):
    ended = jt.anneal(positions, TUBE, sweeps=4, callback=lambda record, _: np.bool_(record.sweep == 2))
    assert len(ended.energies) == 3
    assert len(jt.anneal(positions, TUBE, sweeps=4, callback=lambda *_: None).energies) == 5


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"model": jt.tube_model(jt.Tube(48, 1, 3**0.5), 40)}, "make a model for that tube"),
        ({"sweeps": -1}, "sweeps=-1"),
        ({"sweeps": 3, "temperature": [1.0, 2.0]}, "for 3 sweeps; give one number"),
        ({"temperature": -1.0}, "at least 0"),
        ({"resolution": "rough"}, "rough"),
        ({"seed": -1}, "seed=-1"),
        ({"model": jt.tube_model(TUBE, 50)}, "50"),
    ],
)
def test_bad_arguments_are_refused_by_name(positions, arguments, told):
    with pytest.raises(ValueError, match=told):
        jt.anneal(positions, TUBE, **arguments)


def test_a_model_in_single_precision_is_of_the_same_tube(positions):
    tube = jt.Tube(12.1, 1.1, 3.1)
    model = Annealer(jt.tube_model(tube, CELLS), "draft", "is-mh", 0, jt.constant_schedule(2.0, 1)).model
    assert len(jt.anneal(positions, tube, sweeps=0, model=model).energies) == 1


def test_no_sweeps_measure_what_is_there(positions):
    result = jt.anneal(positions, TUBE, sweeps=0)
    np.testing.assert_array_equal(result.positions, positions)
    assert len(result.energies) == 1


def test_results_show_numbers_and_become_frames(result):
    assert "40 cells, 12 sweeps" in repr(result) and "<table>" in result._repr_html_()
    frame = result.to_pandas()
    assert list(frame.columns) == list(jt.SweepRecord._fields) and len(frame) == 13
    cells = result.cells
    assert "40 cells" in repr(cells) and "lateral area" in cells._repr_html_()
    assert list(cells.to_pandas()["volume"]) == list(np.asarray(cells.volume))
    shapes = jax.eval_shape(lambda: cells)
    assert "float32" in repr(shapes) and shapes._repr_html_() is None  # no numbers to show


def test_steps_fall_in_energy_and_keep_account(positions):
    model = jt.tube_model(TUBE, CELLS)
    state = jt.init(positions, model)
    before = float(jt.epithelial_energy(state.cells, model).sum())
    change = 0.0
    for key in jax.random.split(jax.random.key(0), 10):
        state, info = STEP(key, state, model, 2.0)
        change += float(info.energy_change)
        assert 0 < int(info.accepted) < CELLS and int(info.rounds) >= 1
    with pytest.raises(ValueError, match="40 backbones for a model of 20 cells"):
        jt.step(jax.random.key(0), state, jt.tube_model(TUBE, 20))
    after = float(jt.epithelial_energy(state.cells, model).sum())
    assert after < before and after - before == pytest.approx(change, rel=1e-3)
    fresh = jt.init(state.positions, model)
    np.testing.assert_allclose(fresh.cells.volume, state.cells.volume, atol=1e-3 * float(model.mean_volume))


def test_steps_run_for_many_keys_at_once(positions):
    model = jt.tube_model(TUBE, CELLS)
    state, keys = jt.init(positions, model), jax.random.split(jax.random.key(1), 2)
    together, _ = jax.jit(jax.vmap(lambda key: jt.step(key, state, model, 2.0)))(keys)  # the state is closed over
    alone, _ = STEP(keys[1], state, model, 2.0)
    np.testing.assert_allclose(together.cells.volume[1], alone.cells.volume, rtol=2e-3, atol=1e-3)


def test_a_list_covers_what_it_was_made_for_and_says_when_it_does_not(positions):
    neighbors = jt.NeighborList.allocate(positions.tolist(), TUBE)
    assert len(neighbors) == CELLS and neighbors.candidates.shape[1] == 2 and "40 cells" in repr(neighbors)
    assert neighbors.update(positions) is neighbors
    cells, _ = jax.jit(measure_cells)(
        positions, TUBE, plan_lines(TUBE, CELLS, jt.PRESETS["draft"]), neighbors.candidates
    )
    assert float(cells.volume.sum()) == pytest.approx(float(TUBE.volume), rel=1e-3)
    few = jt.NeighborList(
        np.sort(neighbors.candidates, axis=2)[..., :3],
        TUBE,
        neighbors.tiling_defect,
        neighbors.is_far,
        neighbors.angles,
    )
    covers = jax.jit(lambda neighbors, place: neighbors.covers(place))
    assert bool(covers(neighbors, positions)) and not bool(covers(few, positions))
    assert few.update(positions) is not few
    with pytest.raises(ValueError, match="39 positions for neighbor lists of 40"):
        neighbors.covers(positions[1:])
    with pytest.raises(ValueError, match=r"shape \(40, 1\); give .* rows \(axial, angle\)"):
        neighbors.covers(positions[:, :1])
    model = jt.tube_model(TUBE, CELLS)
    for energy in (jt.tissue_energy, jax.jit(jt.tissue_energy)):
        with pytest.raises(ValueError, match="39 positions for neighbor lists of 40"):
            energy(positions[1:], model, neighbors)
    with pytest.raises(ValueError, match="40 backbones for a model of 39 cells"):
        jt.tissue_energy(positions, jt.tube_model(TUBE, 39), neighbors)
    with pytest.raises(ValueError, match=r"types are .* of shape \(39,\)"):
        jt.tissue_energy(positions, replace(model, adhesion=jt.Adhesion([0] * 39, [[1.0]])), neighbors)
    assert len(neighbors.update(positions[1:])) == 39
    wide = jt.NeighborList.allocate(positions, TUBE, margin=0.5)
    assert wide.update(positions[1:]).margin == 0.5
    assert "float32" in repr(jax.eval_shape(lambda: jax.tree.map(jnp.asarray, neighbors)))
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        assert neighbors.covers(positions) and jax.jit(lambda place: neighbors.covers(place))(positions)


def to_target(cells, model):
    """A volume of its own for each cell, and a tension by its type."""
    target, kind = model.parameters["target"], model.parameters["kind"]
    return (cells.volume - target) ** 2 + jnp.array([0.1, 0.9])[kind] * cells.lateral_area


def test_each_cell_has_its_own_target(x64):
    """57 cells, which pack to other numbers of places: local differences add up to the global change."""
    rng, n = np.random.default_rng(0), 57
    positions = np.asarray(TUBE.random_positions(jax.random.key(2), n))
    mean = TUBE.volume / n
    parameters = {"target": mean * rng.uniform(0.5, 1.5, n), "kind": rng.integers(0, 2, n)}
    model = jt.tube_model(TUBE, n, cell_energy=to_target, parameters=parameters)
    state, change = jt.init(positions, model), 0.0
    before = float(to_target(state.cells, model).sum())
    for key in jax.random.split(jax.random.key(0), 5):
        state, info = STEP(key, state, model, 0.5)
        change += float(info.energy_change)
    fresh = jt.init(state.positions, model)
    after = float(to_target(fresh.cells, model).sum())
    assert after - before == pytest.approx(change, rel=1e-9)
    result = jt.anneal(positions, TUBE, sweeps=15, temperature=0.1, model=model)
    energy = float(to_target(result.cells, model).sum())
    assert result.energies[-1] == pytest.approx(energy, rel=0.05) and energy < 0.8 * result.energies[0]
    off = np.abs(np.asarray(result.cells.volume) - parameters["target"]).mean()
    assert off < np.abs(np.asarray(result.cells.volume) - rng.permutation(parameters["target"])).mean()


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        (np.ones(56), r"parameters has shape \(56,\); give one row for each of the 57"),
        ({"target": np.float64(3)}, r"parameters\['target'\] has shape \(\)"),
        ([np.full(57, np.nan)], r"parameters\[0\] contains a value that is not finite"),
    ],
)
def test_parameters_are_refused_by_name(parameters, told):
    with pytest.raises(ValueError, match=told):
        jt.tube_model(TUBE, 57, parameters=parameters)


def test_the_command_alone_prints_help_and_knows_its_version(capsys):
    assert main([]) == 0
    assert "grid" in capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0 and capsys.readouterr().out == f"jaxtissue {jt.__version__}\n"


def test_the_help_of_each_command_fits_80_columns(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    for command in help_texts.SUMMARIES:
        with pytest.raises(SystemExit) as end:
            main([command, "--help"])
        text = capsys.readouterr().out
        assert end.value.code == 0 and help_texts.DESCRIPTIONS[command] in text
        assert max(map(len, text.splitlines())) <= 80


def test_pandas_is_named_where_it_is_missing(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxtissue\[io\]'"):
        result.to_pandas()


def test_nothing_is_imported_that_takes_long():
    script = "import sys, jaxtissue; print({'matplotlib', 'pandas', 'scipy.optimize'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
