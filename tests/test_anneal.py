"""Runs: schedules, stopping, going on to the bit, replays, the smallest and oddest tissues, every rule."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtissue.compilation.batching import PROGRAMS, Batch
from jaxtissue.dynamics import replays
from jaxtissue.dynamics.annealer import Annealer, AnnealState, renews_at
from jaxtissue.dynamics.coloring import CONFLICTS
from jaxtissue.dynamics.replays import SPAN, Segment, Span, play_spans
from jaxtissue.dynamics.schedules import constant_schedule, geometric_schedule, has_stalled
from jaxtissue.dynamics.survey import survey_together
from jaxtissue.energy import epithelial_energy, tube_model
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import PRESETS
from jaxtissue.neighbors import shortlists

TUBE = Tube(length=20.0, apical_radius=1.0, basal_radius=3.0)
CELLS = 40


def annealer(
    sweeps: int = 4, algorithm: str = "is-mh", conflicts: str = "near", seed: int = 0, tube: Tube = TUBE
) -> Annealer:
    model, temperatures = tube_model(tube, CELLS), constant_schedule(0.5, sweeps)
    return Annealer(model, PRESETS["draft"], algorithm, seed, temperatures, conflicts)


@pytest.fixture(scope="module")
def start() -> AnnealState:
    """The state before the first sweep of a tissue of 60 cells."""
    return annealer().start(TUBE.random_positions(jax.random.key(4), CELLS))


def play(run: Annealer, state: AnnealState):
    """The last state of the schedule and the rows of all its sweeps."""
    rows = []
    while state.sweep < len(run.temperatures):
        before, (state, more, places) = state, run.advance(state)
        assert [row.sweep for row in more] == list(range(before.sweep + 1, state.sweep + 1))
        assert renews_at(state.sweep) or state.sweep == len(run.temperatures)
        assert places.shape == (len(more), *state.positions.shape)
        np.testing.assert_array_equal(places[-1], state.positions)
        rows += more
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
    whole, rows = play(annealer(12), start)
    middle, before = play(annealer(5), start)  # a shorter schedule: sweeps to come change nothing
    stored = AnnealState(int(middle.sweep), middle.positions.copy(), middle.around)
    again, after = play(annealer(12), stored)
    assert without_time(rows) == without_time(before + after)
    assert again.sweep == 12 and again.around == whole.around
    np.testing.assert_array_equal(again.positions, whole.positions)
    _, odd = play(annealer(7), start)  # the sweeps of a span that ends early are those of a whole one
    assert [row._replace(drift=0.0) for row in without_time(odd)] == [
        row._replace(drift=0.0) for row in without_time(rows[:7])
    ]
    other, _ = play(annealer(1, seed=1), start)
    assert (other.positions != play(annealer(1), start)[0].positions).any()


def test_energy_falls_and_nothing_is_compiled_after_the_first_span(start, monkeypatch) -> None:
    events = []
    jax.monitoring.register_event_duration_secs_listener(lambda event, *_, **__: events.append(event))
    run = annealer(20)
    monkeypatch.setattr(Span, "_exactness", np.inf)  # no drift is worked out in the first span, and in all others it is
    state, rows, _ = run.advance(start)
    programs, _ = set(PROGRAMS), events.clear()
    monkeypatch.setattr(Span, "_exactness", -1.0)
    _, more = play(run, state)
    first = run.record(start)
    assert set(PROGRAMS) == programs and not [name for name in events if "compile" in name or "trace" in name]
    jax.jit(lambda number: number + 1)(1)
    assert [name for name in events if "compile" in name] and [name for name in events if "trace" in name]
    rows += more
    assert (first.sweep, first.rounds, first.collisions, first.seconds) == (0, 0, 0, 0.0)
    assert rows[-1].energy < 0.6 * first.energy
    assert [row.sweep for row in rows] == list(range(1, 21))
    for row in rows:
        assert row.energy == pytest.approx(row.volume_energy + row.area_energy, rel=1e-5)  # float32
        assert 0 < row.acceptance < 1 and row.temperature == 0.5 and row.rounds >= 1
        assert row.drift < 1e-5  # float32


@pytest.mark.filterwarnings("ignore:backbones .* too close to each other")
def test_places_too_coarse_for_the_moves_are_told() -> None:
    tube = Tube(200_000.0, 1.0, 10.0)  # as of a million cells
    run = Annealer(tube_model(tube, 10**6), PRESETS["draft"], "is-mh", 0, constant_schedule(1.0, 1))
    with pytest.warns(UserWarning, match=r"steps of 0.016, too coarse for backbones 0.63 apart; use 64 bits"):
        run.start(np.random.default_rng(0).random((10**6, 2)) * [200_000, 6])


def test_starting_again_from_an_array_that_was_overwritten() -> None:
    place = np.array(TUBE.random_positions(jax.random.key(0), CELLS), np.float32)
    run = annealer()
    run.record(run.start(place))
    place[:] = TUBE.random_positions(jax.random.key(1), CELLS)
    assert run.record(run.start(place)) == annealer().record(annealer().start(place))


def test_tubes_of_other_sizes_need_no_program_of_their_own(start) -> None:
    play(annealer(SPAN), start)
    programs = set(PROGRAMS)
    for tube in (Tube(20.0, 0.5, 3.0), Tube(35.0, 2.0, 3.0), Tube(10.0, 0.4, 2.0)):
        run = annealer(4, tube=tube)
        state = run.start(tube.random_positions(jax.random.key(5), CELLS))
        _, rows = play(run, state)
        assert rows[-1].energy < run.record(state).energy
    assert set(PROGRAMS) == programs


def play_span(run: Annealer, state: AnnealState, sweeps: int):
    """Some sweeps by the run's own rounds."""
    batch = Batch()
    (measured,) = survey_together([run._tissue(state.positions)], batch)
    span = run._span(state, measured)
    span.segments = [Segment(sweeps * [span.segments[0].plan[0]])]
    play_spans([span], batch)
    return AnnealState(span.sweep, span.tissue.positions, span.around), span.trail, span.drift


def sweep_with(candidates: int, monkeypatch, sweeps: int):
    """State, trail and drift of some sweeps of 60 cells on so few candidates a side; how often played."""
    monkeypatch.setattr(shortlists, "CANDIDATES", candidates)
    run, plays, usual = annealer(sweeps), [], replays.Span.call

    def count(*arguments):
        plays.append(arguments)
        return usual(*arguments)

    monkeypatch.setattr(replays.Span, "call", count)
    state = run.start(TUBE.random_positions(jax.random.key(4), CELLS))
    energy = run.record(state).energy
    state, trail, drift = play_span(run, state, sweeps)
    change = run.record(state).energy - energy
    return state, trail, drift, abs(float(np.sum(trail.info.energy_change)) - change) / energy, len(plays)


def test_sweeps_that_lacked_a_candidate_are_played_again(x64, monkeypatch) -> None:
    expected = sweep_with(CELLS, monkeypatch, SPAN)
    assert expected[4] == 1  # everyone was a candidate
    assert expected[2] < 1e-9 and expected[3] < 1e-9
    few = sweep_with(8, monkeypatch, SPAN)
    assert few[4] > 1
    assert few[2] < 1e-9 and few[3] < 1e-9  # float64: no stale cell


def test_the_number_of_candidates_does_not_matter(x64, monkeypatch) -> None:
    everyone, usual, few = (sweep_with(count, monkeypatch, 1) for count in (CELLS, shortlists.CANDIDATES, 8))
    for other in (usual, few):
        np.testing.assert_array_equal(other[0].positions, everyone[0].positions)
        np.testing.assert_allclose(other[1].sizes.volume, everyone[1].sizes.volume, rtol=1e-10)  # float64, other sums
        np.testing.assert_allclose(other[1].sizes.lateral_area, everyone[1].sizes.lateral_area, rtol=1e-10)


@pytest.mark.parametrize("conflicts", CONFLICTS)
def test_every_rule_of_independence_runs(start, conflicts: str) -> None:
    _, (row,) = play(annealer(1, conflicts=conflicts), start)
    assert row.energy < annealer().record(start).energy and row.drift < 1e-5  # float32
    if conflicts in ("4-hop", "8-phi"):
        assert row.collisions == 0
    if conflicts == "8-phi":
        assert row.rounds == CELLS  # 8 x covering radius spans this short tube: no two moves at once


def test_classical_mh_visits_one_by_one(start) -> None:
    _, (row,) = play(annealer(1, algorithm="mh"), start)
    assert (row.rounds, row.collisions) == (CELLS, 0)
    assert row.energy < annealer().record(start).energy and row.drift < 1e-5  # float32


@pytest.mark.parametrize("cells, ratio", [(1, 3), (CELLS, 200)])
def test_the_smallest_tissues_and_the_narrowest_lumen(cells: int, ratio: float) -> None:
    tube = Tube(20.0, 3.0 / ratio, 3.0)
    run = Annealer(tube_model(tube, cells), PRESETS["draft"], "is-mh", 0, constant_schedule(0.5, 3))
    state = run.start(tube.random_positions(jax.random.key(6), cells))
    first = run.record(state)
    state, rows = play(run, state)
    assert state.positions.shape == (cells, 2) and np.isfinite(state.positions).all()
    assert state.positions[:, 0].min() >= 0 and state.positions[:, 0].max() <= 20
    assert all(row.drift < 1e-5 for row in rows)  # float32
    if cells == 1:
        assert first.area_energy == 0.0 and rows[-1].acceptance == 1.0
    if cells == CELLS:
        assert rows[-1].energy < first.energy


def test_a_user_s_energy_drives_a_run_of_five_cells() -> None:
    model = tube_model(TUBE, 5, cell_energy=lambda cells, model: 2 * epithelial_energy(cells, model))
    run = Annealer(model, PRESETS["draft"], "is-mh", 0, geometric_schedule(1.0, 0.1, 3))
    start = run.start(TUBE.random_positions(jax.random.key(6), 5))
    _, rows = play(run, start)
    for row in (run.record(start), *rows):
        assert row.energy == pytest.approx(2 * (row.volume_energy + row.area_energy), rel=1e-5)  # float32
    assert rows[-1].energy < run.record(start).energy
    assert [row.temperature for row in rows] == geometric_schedule(1.0, 0.1, 3).tolist()


def test_precision_is_the_session_s(x64) -> None:
    run = annealer()
    assert jnp.asarray(run.model.mean_volume).dtype == jnp.float64
