"""The energy's formula, its scaling, and a user's own."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtissue.cells import CellGeometry
from jaxtissue.energy import epithelial_energy, lateral_tension, tube_model, volume_elasticity
from jaxtissue.tube import Tube

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
