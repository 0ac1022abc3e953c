"""Replicas: together as alone to the bit, whatever differs among them, in one program, however lifted."""

from concurrent.futures import Future

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtissue.compilation import batching
from jaxtissue.compilation.batching import PROGRAMS, Batch
from jaxtissue.dynamics import replays
from jaxtissue.dynamics.annealer import Annealer, advance_together, record_together
from jaxtissue.energy import Model, tube_model
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import PRESETS
from jaxtissue.neighbors import shortlists

pytestmark = pytest.mark.usefixtures("optimized")

CELLS = 24
SWEEPS = 4
SLOTS = 4
KINDS = [  # tube, modulus, tension, seed, temperature
    (Tube(12.0, 2.0, 4.0), 1.0, 0.4, 0, 0.5),
    (Tube(12.0, 0.5, 4.0), 1.0, 0.4, 0, 0.5),
    (Tube(20.0, 1.0, 3.0), 0.3, 1.1, 7, 2.0),
    (Tube(9.0, 0.05, 3.0), 2.0, 0.0, 2**32 - 1, 0.0),
]
OTHERS = [
    (Tube(15.0, 1.5, 5.0), 0.7, 0.2, 3, 1.0),
    (Tube(12.0, 2.0, 4.0), 1.0, 0.5, 4, 0.1),
]


def replica(kind: tuple) -> tuple:
    """The annealer of a kind, and the state before its first sweep."""
    tube, modulus, tension, seed, temperature = kind
    model, temperatures = tube_model(tube, CELLS, modulus, tension), np.full(SWEEPS, temperature)
    run = Annealer(model, PRESETS["draft"], "is-mh", seed, temperatures)
    return run, run.start(tube.random_positions(jax.random.key(seed), CELLS))


def play(kinds: list, slots: int = 0) -> list:
    """What each replica tells of all its sweeps, from the first state to the last."""
    runs, states = zip(*map(replica, kinds), strict=True)
    told = [[record] for record in record_together(runs, states, slots)]
    while states[0].sweep < SWEEPS:
        spans = advance_together(runs, states, slots)
        states = [state for state, _, _ in spans]
        for known, (_, rows, places) in zip(told, spans, strict=True):
            known += [*(row._replace(seconds=0.0) for row in rows), *places.tolist()]
    return [(known, state.sweep, state.around) for known, state in zip(told, states, strict=True)]


@pytest.fixture(scope="module")
def together(optimized) -> tuple[list, int]:
    """What four different replicas tell that run together, and how many programs were compiled for it."""
    before = len(PROGRAMS)
    told = play(KINDS, SLOTS)
    return told, len(PROGRAMS) - before


def test_replicas_together_are_those_alone_to_the_bit(together) -> None:
    for kind, told in zip(KINDS, together[0], strict=True):
        assert [told] == play([kind])


def test_other_values_and_fewer_replicas_need_no_program_of_their_own(together) -> None:
    known, compiled = set(PROGRAMS), together[1]
    assert compiled == 3  # look, play, energies; lists of so few have all and need no check
    first, second = play(OTHERS, SLOTS)
    assert set(PROGRAMS) == known
    assert [second, first, together[0][1]] == play([*OTHERS[::-1], KINDS[1]], SLOTS)
    assert set(PROGRAMS) == known


@pytest.mark.parametrize("again", ["replayed", "in halves"])
def test_a_replay_leaves_the_others_alone(again: str, monkeypatch) -> None:
    plays, usual = [], replays.Span.call

    def noted(span, near):
        plays.append(span.seed)
        return usual(span, near)

    monkeypatch.setattr(shortlists, "CANDIDATES", 8)
    monkeypatch.setattr(replays.Span, "call", noted)
    if again == "in halves":
        monkeypatch.setattr(replays, "list_first", lambda *_: False)
    told, counts = play(KINDS, SLOTS), {seed: plays.count(seed) for seed in set(plays)}
    assert len(set(counts.values())) > 1  # some replicas were played more often than others
    assert told == [one for kind in KINDS for one in play([kind], SLOTS)]


def test_all_at_once_as_on_a_gpu_is_the_same_as_in_turn(monkeypatch) -> None:
    def shrink(start: jax.Array, model: Model) -> tuple[jax.Array, jax.Array]:
        """Halve until below a bound of the replica's own; how often."""
        return jax.lax.while_loop(
            lambda state: state[0].sum() > model.modulus,
            lambda state: (state[0] / 2, state[1] + 1),
            (start, jnp.zeros((), jnp.int32)),
        )

    def play(values: range) -> list[tuple]:
        models = [tube_model(Tube(1.0, 1.0, 2.0), 3, modulus=1.0 + value) for value in values]
        tables = [np.arange(3, dtype=np.float32) * 4**value for value in values]
        results = Batch(4).run(shrink, list(zip(tables, models, strict=True)))
        return [(table.tolist(), int(count)) for table, count in results]

    in_turn = play(range(3))
    assert len({count for _, count in in_turn}) == 3
    monkeypatch.setattr(batching, "IN_TURN", ())
    monkeypatch.setattr(batching, "PROGRAMS", {})
    assert play(range(3)) == in_turn


def total(table: jax.Array) -> jax.Array:
    return table.sum()


def test_slots_without_a_call_are_skipped_and_more_calls_than_slots_take_turns() -> None:
    def double(number: jax.Array) -> jax.Array:
        return 2 * number

    before, batch = len(PROGRAMS), Batch(5)
    for count in (1, 3, 7):
        assert batch.run(double, [(np.float32(k),) for k in range(count)]) == [2.0 * k for k in range(count)]
    assert len(PROGRAMS) == before + 1
    assert batch.run(double, []) == []


def test_the_host_may_go_on_while_a_batch_computes() -> None:
    results = Batch(2).start(total, [(np.full(3, k, np.float32),) for k in (1, 2)])
    assert results() == [3.0, 6.0]


@pytest.mark.parametrize("expected, programs_made", [(3, 1), (4, 2)])
def test_what_is_compiled_ahead_is_used_if_it_fits(expected: int, programs_made: int) -> None:
    def total(table: jax.Array) -> jax.Array:
        return table.sum()

    before, batch = len(PROGRAMS), Batch(2)
    for _ in range(2):
        batch.prepare(total, (np.zeros(expected, np.float32),))
    assert batch.run(total, 2 * [(np.ones(3, np.float32),)]) == [3.0, 3.0]
    assert len(PROGRAMS) == before + programs_made and batch.compile_seconds > 0


def test_what_failed_ahead_is_compiled_when_it_is_asked_for(monkeypatch) -> None:
    class Fails:
        def submit(self, _) -> Future:
            failed: Future = Future()
            failed.set_exception(MemoryError("none left"))
            return failed

    def total(table: jax.Array) -> jax.Array:
        return table.sum()

    monkeypatch.setattr(batching, "BESIDE", Fails())
    batch = Batch()
    batch.prepare(total, (np.zeros(3, np.float32),))
    assert batch.run(total, [(np.ones(3, np.float32),)]) == [3.0]


def test_calls_of_other_shapes_run_in_programs_of_their_own() -> None:
    tables = [np.ones(3, np.float32), np.ones(5, np.float32), np.full(3, 2, np.float32)]
    assert Batch(3).run(total, [(table,) for table in tables]) == [3.0, 5.0, 6.0]
