"""Moves and sweeps on domains other than the tube."""

from dataclasses import asdict
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxtissue as jt
from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics import domain_lists
from jaxtissue.dynamics.domain_lists import Shortlists
from jaxtissue.dynamics.domain_runs import domain_run
from jaxtissue.dynamics.independent_sets import independent_rounds
from jaxtissue.dynamics.surface_moves import propose_moves
from jaxtissue.energy import in_precision
from jaxtissue.geometry.vectors import components
from jaxtissue.runs.settings import FORMAT, Settings, saved_settings

EGG = jt.Ellipsoid(apical_axes=[2, 1, 1], basal_axes=[2.5, 1.5, 1.5])
SHEET = jt.Slab(width=4, depth=3, thickness=1, periodic=(True, False))
CELLS = 40


@pytest.mark.parametrize(
    ("domain", "range_of", "area_per_length"),
    [
        (
            jt.Ellipsoid(apical_axes=[4, 1, 1], basal_axes=[5, 2, 2]),
            (-1, 1),
            lambda height: np.sqrt(16 * (1 - height**2) + height**2),
        ),
        (
            jt.Fold(width=4, depth=2, amplitude=1.0, wavelength=3.0, thickness=0.05),
            (0, 4),
            lambda x: np.sqrt(1 + (2 * np.pi / 3 * np.cos(2 * np.pi / 3 * x)) ** 2),
        ),
    ],
    ids=["ellipsoid", "fold"],
)
def test_proposals_alone_make_positions_uniform_by_area(domain, range_of, area_per_length) -> None:
    """Along the first coordinate, whose share of the area is a known integral."""
    count, sweeps, longest = 20_000, 60, 1.0  # so that these sweeps mix
    start = domain.base.place(tuple(np.random.default_rng(0).random((2, count), np.float32)))

    def move(place, draws):
        after, log_ratio = propose_moves(draws[:2], place, domain, jnp.asarray(longest))
        takes = draws[2] < jnp.exp(jnp.minimum(log_ratio, 0))
        return tuple(jnp.where(takes, new, old) for new, old in zip(after, place, strict=True)), takes.mean()

    draws = np.random.default_rng(1).random((sweeps, 3, count), np.float32)
    place, taken = jax.jit(lambda place: jax.lax.scan(move, place, draws))(start)
    along = np.linspace(range_of[0], range_of[1], 20_001)
    area = np.concatenate([[0], np.cumsum(area_per_length((along[1:] + along[:-1]) / 2))])
    edges = np.interp(np.linspace(0, 1, 21), area / area[-1], along)
    before, found = (np.histogram(np.asarray(values[0]), edges)[0] for values in (start, place))
    assert stats.chisquare(found).pvalue > 1e-3
    assert stats.chisquare(before).pvalue < 1e-9  # the start was not uniform by area
    assert 0.3 < taken.mean() < 0.99  # some moves have no way back


@pytest.fixture(scope="module")
def run():
    """A run on a domain, with the tissue that it begins with, measured."""
    with jax.enable_x64(True):
        model = in_precision(jt.tube_model(SHEET, CELLS, relative=True), np.dtype(float))
        made = domain_run(model, "draft", 5, np.full(20, 0.05))
        positions = np.asarray(SHEET.random_positions(jax.random.key(3), CELLS), float)
        yield made, made.survey(positions, Batch()), positions


def energy_of(run, measured) -> float:
    return float(np.sum(run.model.cell_energy(measured.state.cells.sizes, run.model)))


def test_local_differences_sum_to_the_change(run) -> None:
    run, measured, positions = run
    rounds = independent_rounds("near", positions, run.model, measured.contacts)
    played = run.play(measured, 3 * [rounds], 0, Batch())
    before, after = energy_of(run, measured), energy_of(run, played.measured)
    summed = float(played.trail.info.energy_change.sum())
    assert abs(before + summed - after) < 1e-9 * abs(before)
    assert played.drift < 1e-12
    assert 0.05 < played.trail.info.accepted.mean() / CELLS < 0.95
    # the same moves one by one, in the same order
    alone = np.full((CELLS, rounds.shape[1]), -1, np.int32)
    alone[:, 0] = rounds[rounds >= 0]
    one_by_one = run.play(measured, 3 * [alone], 0, Batch())
    np.testing.assert_array_equal(one_by_one.trail.positions, played.trail.positions)
    np.testing.assert_allclose(one_by_one.trail.sizes.volume, played.trail.sizes.volume, rtol=1e-12)


def test_a_survey_measures_the_whole_tissue(run) -> None:
    run, measured, _ = run
    assert measured.unproved == 0
    # walls of straight prisms are straight lines: only rounding is left
    np.testing.assert_allclose(measured.state.cells.sizes.volume.sum(), SHEET.volume, rtol=1e-9)
    contacts = measured.contacts()
    assert contacts.nnz / CELLS <= 6  # on the sheet, which has two ends


def test_short_lists_hold_what_a_span_brings_near(monkeypatch) -> None:
    """Else the span is played again."""
    cells = 200
    sheet = jt.Slab(width=16, depth=12, thickness=1, periodic=(True, True))
    made = domain_run(jt.tube_model(sheet, cells), "draft", 0, np.zeros(1))
    place = components(sheet.random_positions(jax.random.key(1), cells))
    before_place = np.stack(place, axis=1)
    before = made.survey(before_place, Batch())
    for sweep in range(10):  # all moves accepted
        draws = jax.random.uniform(jax.random.key(sweep), (2, cells))
        place, _ = propose_moves(draws, place, sheet, jnp.asarray(made.scene.longest))
    after = made.survey(np.stack(place, axis=1).astype(np.float32), Batch())
    assert len(Shortlists(before).lacking(after)) <= 1
    monkeypatch.setattr(domain_lists, "FEW", 16)
    monkeypatch.setattr(domain_lists, "MARGIN", 0.0)
    few = Shortlists(before)
    lacking, width = few.lacking(after), few.rivals.shape[1]
    few.add(lacking)
    assert len(lacking) > 20
    assert len(few.lacking(after)) < len(lacking) / 2  # of those that gave way some are sides
    assert few.rivals.shape[1] <= width + 8
    monkeypatch.setattr(domain_lists, "NEAREST", 16)
    assert len(Shortlists(made.survey(before_place, Batch())).lacking(after)) > 20


def test_what_cannot_be_annealed_is_refused() -> None:
    model = jt.tube_model(EGG, CELLS)
    with pytest.raises(ValueError, match="8-phi"):
        jt.Annealer(model, "draft", "is-mh", 0, np.ones(1), conflicts="8-phi")
    with pytest.raises(ValueError, match="41 backbones for a model of 40 cells"):
        jt.Annealer(model, "draft", "is-mh", 0, np.ones(1)).start(EGG.random_positions(jax.random.key(0), 41))
    with pytest.raises(ValueError, match="make a model for that"):
        jt.anneal(SHEET.random_positions(jax.random.key(0), CELLS), SHEET, 1, model=model)
    with pytest.raises(AttributeError, match="Ellipsoid has no attribute tube"):
        _ = model.tube


def test_ways_back() -> None:
    base = jt.Fold(width=4, depth=2, amplitude=0.1, wavelength=3.0, thickness=0.05).base
    m, y = (jnp.array(3.9), jnp.array(0.2)), (jnp.array(0.3), jnp.array(-0.1))
    after = base.reflect(base.chart(m, y))
    again = base.reflect(base.chart(after, base.way_back(m, y)))
    np.testing.assert_allclose(again, m, rtol=1e-6)
    assert float(after[0]) == pytest.approx(3.8)


def test_settings_of_a_run_on_a_domain() -> None:
    settings = Settings(domain={"shape": "sphere", "apical_radius": 1, "basal_radius": 2}, cells=CELLS)
    assert settings.place == jt.Sphere(1.0, 2.0)
    assert float(cast(jt.Sphere, settings.annealer(1).model.domain).basal_radius) == 2
    assert saved_settings({"format": FORMAT, "arguments": asdict(settings)}, {}, "here") == settings
    with pytest.raises(ValueError, match="is a Sphere, but only a tube"):
        _ = settings.tube
