"""The energy's formula, its scaling, and a user's own."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known import known

import jaxtissue as jt
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.dynamics.schedules import constant_schedule
from jaxtissue.dynamics.sweep_log import AcceptanceWatch, SweepRecord
from jaxtissue.energy import (
    Model,
    cell_energies,
    epithelial_energy,
    lateral_tension,
    require_finite,
    tube_model,
    volume_elasticity,
)
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry

TUBE = Tube(length=10.0, apical_radius=1.0, basal_radius=2.0)
CELLS = CellGeometry(jnp.array([1.0, 4.0, 6.0]), jnp.array([2.0, 0.0, 5.0]))


def test_energy_is_the_formula() -> None:
    model = tube_model(TUBE, 3, modulus=3.0, tension=0.5)
    mean = np.pi * 3 * 10 / 3
    volume, area = np.array([1.0, 4.0, 6.0]), np.array([2.0, 0.0, 5.0])
    # rtol: float32
    np.testing.assert_allclose(volume_elasticity(CELLS, model), 1.5 * (mean - volume) ** 2, rtol=1e-6)
    np.testing.assert_allclose(lateral_tension(CELLS, model), 0.5 * area, rtol=1e-6)
    expected = 1.5 * (mean - volume) ** 2 + 0.5 * area
    np.testing.assert_allclose(epithelial_energy(CELLS, model), expected, rtol=1e-6)


def test_the_paper_s_constants_are_the_defaults() -> None:
    model = tube_model(TUBE, 7)
    assert (model.modulus, model.tension) == (1.0, 0.4)
    assert model.mean_volume == pytest.approx(np.pi * 30 / 7)
    assert model.cell_energy is epithelial_energy


def test_a_user_s_energy_is_used() -> None:
    model = tube_model(TUBE, 3, cell_energy=lambda cells, model: model.modulus * cells.volume**3)
    assert model.cell_energy(CELLS, model).tolist() == [1.0, 64.0, 216.0]


@pytest.mark.parametrize(
    "bad, named",
    [
        ({"modulus": -1.0}, "modulus=-1.0"),
        ({"modulus": float("inf")}, "modulus=inf"),
        ({"tension": float("nan")}, "tension=nan"),
        ({"tension": -0.1}, "tension=-0.1"),
        ({"cells": 0}, "cells=0"),
    ],
)
def test_bad_constants_are_named(bad: dict, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        tube_model(**{"tube": TUBE, "cells": 3, **bad})


def started(model) -> None:
    """A run's start, in which its energy is tried; nothing is measured."""
    Annealer(model, "draft", "mh", 0, constant_schedule(1.0, 1))


@pytest.mark.parametrize("name", ["mean_volume", "modulus", "tension"])
@pytest.mark.parametrize("length", [1, 3, 57])
def test_arrays_of_constants_are_refused_by_name(name, length) -> None:
    constants: dict[str, Any] = {"mean_volume": 1.0, "modulus": 1.0, "tension": 0.4, name: np.ones(length)}
    with pytest.raises(ValueError, match=rf"{name} is an array of shape \({length},\); give a single number"):
        started(Model(TUBE, **constants))
    with pytest.raises(ValueError, match=name):
        cell_energies(CELLS, Model(TUBE, **constants))
    if name != "mean_volume":
        with pytest.raises(ValueError, match=name):
            tube_model(TUBE, 3, **{name: constants[name]})


OWN = {
    "wrong shape": (
        lambda cells, model: cells.volume.sum(),
        r"returns float32 of shape \(\) for cells of shape",
    ),
    "two numbers": (lambda cells, model: jnp.stack([cells.volume] * 2), r"shape \(2, 4\)"),
    "whole numbers": (lambda cells, model: cells.volume.astype(int), "int32"),
    "no numbers": (lambda cells, model: jnp.log(-cells.volume), "is nan in float32"),
    "infinite": (lambda cells, model: cells.volume * 1e30 * 1e30, "is inf in float32 .*--x64"),
    "array of its own": (
        lambda cells, model: cells.volume * jnp.arange(57.0),
        "raises an error .*compute each cell on its own",
    ),
    "others": (lambda cells, model: cells.volume / cells.volume.mean(), "depends on several cells"),
    "place": (lambda cells, model: cells.volume + jnp.roll(cells.lateral_area, 1), "depends on several cells"),
}


@pytest.mark.parametrize("name", OWN)
def test_energies_that_are_none_are_refused_by_name(name) -> None:
    energy, words = OWN[name]
    energy.__name__ = "mine"
    with pytest.raises(ValueError, match=f"cell_energy mine .*{words}"):
        started(tube_model(TUBE, 3, cell_energy=energy))


def test_energies_that_overflow_or_vanish_name_x64() -> None:
    huge, tiny = Tube(2e8, 1e7, 3e7), Tube(1e-7, 1e-9, 1e-8)
    for model in (tube_model(huge, 500), tube_model(TUBE, 3, modulus=1e300), tube_model(tiny, 500)):
        with pytest.raises(ValueError, match="--x64"):
            started(model)
        with jax.enable_x64(True):
            started(model)
    started(tube_model(TUBE, 3, modulus=0.0))


def test_an_energy_that_turns_infinite_is_told() -> None:
    model = tube_model(TUBE, 3)
    with pytest.raises(ValueError, match=r"epithelial_energy is inf in float32 \(mean_volume=31.4159, modu.*--x64"):
        require_finite(np.array([1, np.inf], np.float32), model)
    require_finite(np.ones(3, np.float32), model)


def test_relative_constants_anneal_a_tissue_alike_in_every_unit() -> None:
    share, runs = np.random.default_rng(0).random((16, 2)), []
    for unit in (1.0, 1000.0):
        tube = Tube(20 * unit, unit, 3 * unit)
        model = tube_model(tube, 16, 1.0, 0.05, relative=True)
        with jax.enable_x64(True):
            run = Annealer(model, "draft", "is-mh", 0, constant_schedule(0.02, 3))
            state, rows = run.start(share * [20 * unit, 6.28]), []
            while state.sweep < 3:
                state, news, _ = run.advance(state)
                rows += news
        runs.append((state.positions / [unit, 1], [(row.energy, row.acceptance) for row in rows]))
    (place, rows), (scaled, others) = runs
    np.testing.assert_allclose(scaled, place, rtol=1e-9)
    np.testing.assert_allclose(others, rows, rtol=1e-9)
    assert all(0 < acceptance < 1 for _, acceptance in rows)


def test_relative_energies_are_the_formula() -> None:
    mean, model = np.pi * 3 * 10 / 3, tube_model(TUBE, 3, 3.0, 0.5, relative=True)
    volume, area = np.array([1.0, 4.0, 6.0]), np.array([2.0, 0.0, 5.0])
    expected = 1.5 * (1 - volume / mean) ** 2 + 0.5 * area / mean ** (2 / 3)
    np.testing.assert_allclose(cell_energies(CELLS, model), expected, rtol=1e-6)  # float32


@pytest.mark.parametrize(
    "acceptance, words",
    [(0.0, "no move is accepted: T = 2 is too low"), (0.97, "97% of the moves are"), (0.95, ""), (0.01, "")],
)
def test_acceptance_is_doubted_once_and_after_enough_moves(acceptance, words) -> None:
    blank = dict.fromkeys(SweepRecord._fields, 0)
    record, watch = (
        SweepRecord(**{**blank, "temperature": 2.0, "acceptance": acceptance}),
        AcceptanceWatch(70),
    )
    assert watch.doubt([record, record]) == ""
    doubt = watch.doubt([record])
    assert doubt.startswith(words) and bool(doubt) == bool(words)
    assert watch.doubt([record]) == ""


def contractile(cells: CellGeometry, model: Model) -> jax.Array:
    """The paper's energy, with rings that contract on the apical surface and a basal surface of a preferred area."""
    sized: Any = cells  # without surfaces there is None, with which nothing can be computed
    apical = 0.3 * sized.apical_perimeter**2 + 0.1 * sized.apical_area
    basal = 0.2 * (sized.basal_area - 2.0) ** 2 + sized.basal_perimeter
    return epithelial_energy(cells, model) + apical + basal


def test_an_energy_that_reads_surfaces_adds_up(x64):
    tube, cells = Tube(16.0, 2.0, 5.0), 57
    model = tube_model(tube, cells, cell_energy=contractile).with_surfaces()
    state = jt.init(tube.random_positions(jax.random.key(1), cells), model)
    step, change, before = jax.jit(jt.step), 0.0, float(contractile(state.cells, model).sum())
    for key in jax.random.split(jax.random.key(0), 3):
        state, info = step(key, state, model)
        change += float(info.energy_change)
    fresh = jt.init(state.positions, model)
    after = float(contractile(fresh.cells, model).sum())
    assert change < -0.05 * before and abs(before + change - after) < 1e-9 * before  # the bar
    circles = 2 * np.pi * np.array([tube.apical_radius, tube.basal_radius]) * tube.length
    sums = np.array([known(fresh.cells.apical_area).sum(), known(fresh.cells.basal_area).sum()])
    np.testing.assert_allclose(sums, circles, rtol=1e-3)  # `draft`, measured 9e-5


def test_an_energy_that_reads_surfaces_must_ask_for_them():
    with pytest.raises(ValueError, match=r"use model\.with_surfaces"):
        jt.init(TUBE.random_positions(jax.random.key(1), 12), tube_model(TUBE, 12, cell_energy=contractile))
