"""Programs as users get them: wide vectors and few optimizations change no result."""

import jax
import numpy as np
import pytest

from jaxtissue.compilation import fusion
from jaxtissue.compilation.fusion import arctan, fusion_barrier, is_option, options
from jaxtissue.diagram.exact import exact_cells
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import PRESETS, plan_lines
from jaxtissue.neighbors.search import find_candidates

TUBE = Tube(40.0, 1.0, 8.0)
CELLS = 150


@pytest.fixture(scope="module")
def tissue():
    """Random cells, a fifth of which share their height with the next: their walls take every branch."""
    positions = np.array(TUBE.random_positions(jax.random.key(1), CELLS))
    positions[1::10, 0] = positions[::10, 0]
    return positions, find_candidates(positions, TUBE), plan_lines(TUBE, CELLS, PRESETS["draft"])


@pytest.mark.parametrize("light", [False, True])
def test_cells_are_the_same_to_the_bit(tissue, light: bool) -> None:
    positions, sides, lines = tissue
    plain, ours = (
        jax.jit(lambda *arguments: measure_cells(*arguments)[0], compiler_options=told)(positions, TUBE, lines, sides)
        for told in ({}, options(light))
    )
    for name in ("volume", "lateral_area"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(plain, name))
    exact = exact_cells(positions.astype(float), TUBE, 20)
    for name, bar in (("volume", 0.005), ("lateral_area", 0.03)):  # those of `draft`
        found, true = np.asarray(getattr(ours, name)), getattr(exact, name)
        assert np.sqrt(np.mean((found - true) ** 2)) < bar * true.mean()


@pytest.mark.parametrize("light", [False, True])
def test_the_angle_of_any_tangent(dtype, light: bool) -> None:
    tangent = np.tan(np.linspace(-1.57, 1.57, 4097)).astype(dtype)
    tangent = np.concatenate([tangent, np.array([0, 1e-18, -1e9], dtype)])
    found = jax.jit(arctan, compiler_options=options(light))(tangent)
    np.testing.assert_allclose(found, np.arctan(tangent.astype(float)), rtol=6e-7)  # 5 roundings of float32


def test_options_that_the_compiler_lacks_are_left_out(monkeypatch) -> None:
    known = options(light=True)
    assert "xla_cpu_prefer_vector_width" in known
    assert not is_option("xla_cpu_no_such_option", False)
    monkeypatch.setattr(fusion, "is_option", lambda name, value: name != "xla_backend_optimization_level")
    assert "xla_backend_optimization_level" not in options(light=True)
    with pytest.raises(RuntimeError, match="xla_cpu_prefer_vector_width"):  # known, but not by this value
        is_option("xla_cpu_prefer_vector_width", "wide")


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="barriers are for the compiler for CPUs")
@pytest.mark.parametrize("truth", [True, np.ones(3)])
def test_barriers_stand_where_the_compiler_could_know_the_truth(truth) -> None:
    """Heights of layers that are constants of a program had let it fold all of its barriers: it took twice as long."""
    program = jax.jit(lambda x: fusion_barrier(lambda: x + 1, jax.numpy.asarray(truth)) * 2)
    assert "conditional(" in str(program.lower(np.ones(4, np.float32)).compile().as_text())
    assert program(np.ones(4, np.float32)).tolist() == [4.0] * 4
