"""Runs: schedules, stopping, bit-identical continuation, the smallest and the oddest tissues, every rule."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtissue.anneal import (
    CONFLICTS,
    Annealer,
    AnnealState,
    constant_schedule,
    geometric_schedule,
    has_stalled,
)
from jaxtissue.energy import epithelial_energy, tube_model
from jaxtissue.lines import PRESETS
from jaxtissue.tube import Tube

TUBE = Tube(length=20.0, apical_radius=1.0, basal_radius=3.0)
CELLS = 60
PROGRAMS: dict[Any, Any] = {}  # compiled once for all runs of one shape


@pytest.fixture(scope="module", autouse=True)
def quick_compile():
    """Compile without optimization: few cells for few sweeps, so that compiling is most of the time."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


def annealer(sweeps: int = 4, algorithm: str = "is-mh", conflicts: str = "3-hop", seed: int = 0) -> Annealer:
    run = Annealer(
        tube_model(TUBE, CELLS), PRESETS["draft"], algorithm, seed, constant_schedule(0.5, sweeps), conflicts
    )
    run._compiled = PROGRAMS
    return run


@pytest.fixture(scope="module")
def start() -> AnnealState:
    """The state before the first sweep of a tissue of 60 cells."""
    return annealer().start(TUBE.random_positions(jax.random.key(4), CELLS))


def play(run: Annealer, state: AnnealState, sweeps: int):
    """The last state and all rows."""
    rows = []
    for _ in range(sweeps):
        state, row = run.advance(state)
        rows.append(row)
    return state, rows


def without_time(rows) -> list:
    return [row._replace(seconds=0.0) for row in rows]


def test_schedules() -> None:
    assert constant_schedule(2, 3).tolist() == [2.0, 2.0, 2.0]
    np.testing.assert_allclose(geometric_schedule(8, 1, 4), [8, 4, 2, 1], rtol=1e-12)  # float64
    assert geometric_schedule(8, 1, 1).tolist() == [8.0]
    for first, last in ((0, 1), (1, 0), (-1, 1), (float("nan"), 1)):
        with pytest.raises(ValueError, match="above 0"):
            geometric_schedule(first, last, 3)


@pytest.mark.parametrize(
    "energies, patience, expected",
    [
        ([5, 4, 3], 2, False),
        ([5, 3, 4, 4], 2, True),
        ([5, 3, 4, 2], 2, False),
        ([3, 3, 3], 2, True),  # as low again is no new minimum
        ([5, 6], 2, False),  # too early to say
        ([5, 6, 7], 2, True),
        ([5, 6, 7, 8], 0, False),  # no patience given: never
    ],
)
def test_has_stalled(energies: list, patience: int, expected: bool) -> None:
    assert has_stalled(energies, patience) is expected


@pytest.mark.parametrize(
    "change, named",
    [
        ({"algorithm": "gibbs"}, "'gibbs'"),
        ({"conflicts": "5-hop"}, "'5-hop'"),
        ({"temperatures": np.array([1.0, np.nan])}, "finite"),
        ({"temperatures": np.array([-1.0])}, "at least 0"),
    ],
)
def test_what_cannot_run_is_named(change: dict, named: str) -> None:
    arguments = {"algorithm": "mh", "seed": 0, "temperatures": np.ones(2), **change}
    with pytest.raises(ValueError, match=named):
        Annealer(tube_model(TUBE, CELLS), PRESETS["draft"], **arguments)


def test_a_run_goes_on_to_the_bit(start) -> None:
    whole, rows = play(annealer(4), start, 4)
    middle, before = play(annealer(2), start, 2)  # a shorter schedule: sweeps to come change nothing
    stored = AnnealState(
        int(middle.sweep), middle.positions.copy(), middle.neighbors.copy(), middle.circle, middle.half
    )
    again, after = play(annealer(9), stored, 2)
    assert without_time(rows) == without_time(before + after)
    assert again.sweep == 4
    np.testing.assert_array_equal(again.positions, whole.positions)
    np.testing.assert_array_equal(again.neighbors, whole.neighbors)
    other, _ = play(annealer(1, seed=1), start, 1)
    assert (other.positions != play(annealer(1), start, 1)[0].positions).any()


def test_energy_falls_and_nothing_is_compiled_after_the_first_sweep(start) -> None:
    run = annealer(10)
    first = run.record(start)
    state, rows = play(run, start, 1)
    programs = len(PROGRAMS)
    state, rows = play(run, state, 9)
    assert len(PROGRAMS) == programs
    assert (first.sweep, first.rounds, first.collisions, first.seconds) == (0, 0, 0, 0.0)
    assert rows[-1].energy < 0.6 * first.energy
    assert [row.sweep for row in rows] == list(range(2, 11))
    for row in rows:
        assert row.energy == pytest.approx(row.volume_energy + row.area_energy, rel=1e-5)  # float32
        assert 0 < row.acceptance < 1 and row.temperature == 0.5 and row.rounds >= 1
        assert row.drift < 1e-4  # float32


@pytest.mark.parametrize("conflicts", CONFLICTS)
def test_every_rule_of_independence_runs(start, conflicts: str) -> None:
    _, (row,) = play(annealer(1, conflicts=conflicts), start, 1)
    assert row.energy < annealer().record(start).energy and row.drift < 1e-4  # float32
    if conflicts in ("4-hop", "8-phi"):
        assert row.collisions == 0
    if conflicts == "8-phi":
        assert row.rounds == CELLS  # 8 x covering radius spans this short tube: no two moves at once


def test_classical_mh_visits_one_by_one(start) -> None:
    _, (row,) = play(annealer(1, algorithm="mh"), start, 1)
    assert (row.rounds, row.collisions) == (CELLS, 0)
    assert row.energy < annealer().record(start).energy and row.drift < 1e-4  # float32


@pytest.mark.parametrize("cells, ratio", [(1, 3), (2, 3), (70, 200)])
def test_the_smallest_tissues_and_the_narrowest_lumen(cells: int, ratio: float) -> None:
    tube = Tube(20.0, 3.0 / ratio, 3.0)
    run = Annealer(tube_model(tube, cells), PRESETS["draft"], "is-mh", 0, constant_schedule(0.5, 3))
    state = run.start(tube.random_positions(jax.random.key(6), cells))
    first = run.record(state)
    state, rows = play(run, state, 3)
    assert state.positions.shape == (cells, 2) and np.isfinite(state.positions).all()
    assert state.positions[:, 0].min() >= 0 and state.positions[:, 0].max() <= 20
    assert all(row.drift < 1e-4 for row in rows)  # float32
    if cells == 1:
        assert first.area_energy == 0.0 and rows[-1].acceptance == 1.0
    if cells == 70:
        assert rows[-1].energy < first.energy


def test_a_user_s_energy_drives_a_run_of_five_cells() -> None:
    model = tube_model(TUBE, 5, cell_energy=lambda cells, model: 2 * epithelial_energy(cells, model))
    run = Annealer(model, PRESETS["draft"], "is-mh", 0, geometric_schedule(1.0, 0.1, 3))
    start = run.start(TUBE.random_positions(jax.random.key(6), 5))
    _, rows = play(run, start, 3)
    for row in (run.record(start), *rows):
        assert row.energy == pytest.approx(2 * (row.volume_energy + row.area_energy), rel=1e-5)  # float32
    assert rows[-1].energy < run.record(start).energy
    assert [row.temperature for row in rows] == geometric_schedule(1.0, 0.1, 3).tolist()


def test_precision_is_the_session_s(x64) -> None:
    run = annealer()
    assert run.model.mean_volume.dtype == jnp.float64
