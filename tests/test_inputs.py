"""The gate: positions of every kind are measured as floats, and what is none is refused everywhere alike."""

import decimal
import math
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.geometry.positions import as_positions
from jaxtissue.measurement.quadrature import as_resolution, plan_lines
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.transitions import find_forms

TUBE = jt.Tube(20, 1, 3)
WHOLE = [[1, 0], [3, 2], [7, 4], [12, 1], [18, 5], [5, 3]]
FLOATS = np.array(WHOLE, float)


class Frame:
    """As a pandas DataFrame: named columns, of which NumPy makes an array."""

    def __init__(self, **columns):
        self._columns = columns

    columns = property(lambda self: list(self._columns))

    def __getitem__(self, name):
        return self._columns[name]

    def __array__(self, dtype=None, copy=None):
        return np.array(list(self._columns.values()), dtype).T


AXIAL, ANGLE = FLOATS.T
WHOLE_DTYPES = ("i1", "u1", "<i2", ">i2", "u2", "i4", ">u4", "i8", "u8")
FLOAT_DTYPES = ("f2", ">f2", "f4", ">f4", "f8", ">f8", "longdouble")
KINDS: dict[str, Any] = {dtype: FLOATS.astype(dtype) for dtype in WHOLE_DTYPES + FLOAT_DTYPES} | {
    "list": WHOLE,
    "tuple": tuple(map(tuple, WHOLE)),
    "list of arrays": [np.array(row) for row in WHOLE],
    "objects": np.array(WHOLE, object),
    "decimals": [[decimal.Decimal(x) for x in row] for row in WHOLE],
    "mixed": [[np.int8(x), float(t)] for x, t in WHOLE],
    "Fortran order": np.asfortranarray(FLOATS),
    "strides": np.repeat(FLOATS, 2, axis=0)[::2],
    "unmasked": np.ma.masked_array(FLOATS, False),
    "frame": Frame(axial=AXIAL, angle=ANGLE),
    "frame the other way round": Frame(name=np.arange(6), angle=ANGLE, axial=AXIAL.astype(int)),
    "frame in capitals": Frame(**{"Angle ": ANGLE, "AXIAL": AXIAL}),
    "structured": np.rec.fromarrays([ANGLE, AXIAL], [("angle", ANGLE.dtype), ("axial", AXIAL.dtype)]),
    "dictionary": {"angle": ANGLE.tolist(), "axial": AXIAL.tolist()},
}


@pytest.mark.parametrize("kind", [*KINDS, "jax", "jax whole", "bfloat16", "read-only"])
def test_positions_of_any_kind_are_floats(kind):
    fixed = FLOATS.copy()
    fixed.flags.writeable = False
    others = {"jax": jnp.asarray(FLOATS), "jax whole": jnp.asarray(WHOLE)}
    others |= {"bfloat16": jnp.asarray(WHOLE, jnp.bfloat16), "read-only": fixed}
    given = (KINDS | others)[kind]
    for dtype in (np.float32, np.float64):
        place = as_positions(given, TUBE, dtype)
        assert type(place) is np.ndarray and place.dtype == dtype and place.dtype.isnative
        np.testing.assert_array_equal(place, FLOATS)
    assert as_positions(given, TUBE).dtype == np.float32
    place[:] = 0  # a copy
    np.testing.assert_array_equal(as_positions(given, TUBE), FLOATS)


def test_whole_numbers_are_measured_as_floats():
    right = jt.measure_tissue(FLOATS, TUBE, "draft", surfaces=False)
    exact = jt.exact_cells(FLOATS, TUBE, 50)
    np.testing.assert_allclose(right.volume, exact.volume, rtol=1e-4)
    np.testing.assert_allclose(right.lateral_area, exact.lateral_area, rtol=3e-3)  # samples, the exact path
    measurer = jt.CellMeasurer(TUBE, "draft")
    kept = measurer.measure(FLOATS).volume
    for kind in ("i8", "u1", "f2", ">f8", "list", "frame"):
        cells = jt.measure_tissue(KINDS[kind], TUBE, "draft", surfaces=False)
        for column, same in zip(jax.tree.leaves(cells), jax.tree.leaves(right), strict=True):
            np.testing.assert_array_equal(column, same)
        np.testing.assert_array_equal(measurer.measure(KINDS[kind]).volume, kept)


def test_all_functions_take_whole_numbers_and_frames():
    functions = [jt.separation, jt.covering_radius, jt.tightness]
    functions += [lambda place, tube: jt.label_image(place, tube, 0.5)]
    functions += [lambda place, tube: jt.exact_cells(place, tube, 10).volume]
    functions += [lambda place, tube: jt.find_contacts(place, tube).area]
    functions += [lambda place, tube: jt.find_transitions(place, tube).points]
    functions += [lambda place, tube: find_forms(place, tube).pieces]
    functions += [lambda place, tube: trace_edges(place, tube).vertices]
    functions += [lambda place, tube: jt.find_connectivity(place, tube).contacts.area]
    for function in functions:
        expected = function(FLOATS, TUBE)
        for kind in ("list", ">i2", "frame the other way round"):
            np.testing.assert_array_equal(function(KINDS[kind], TUBE), expected)


NAN = math.nan
BAD = {
    "no rows": ([], r"shape \(0,\)"),
    "no cells": (np.zeros((0, 2)), r"shape \(0, 2\)"),
    "a number": (5, r"shape \(\)"),
    "one row": ([1, 2], r"shape \(2,\)"),
    "three columns": (np.ones((4, 3)), r"shape \(4, 3\)"),
    "columns for rows": (FLOATS.T, r"shape \(2, 6\)"),
    "frame of other names": (Frame(x=AXIAL, theta=ANGLE), "the columns x, theta; rename the columns to axial, angle"),
    "dictionary of other names": ({"axial": AXIAL}, "the columns axial; rename the columns to axial, angle"),
    "ragged": ([[1, 2], [3]], "must be real numbers"),
    "text": ([["1", "2"]], "must be real numbers .*<U1"),
    "text among objects": (np.array([["1", 2]], object), "must be real numbers .*type str"),
    "complex": (np.array([[1j, 2]]), "must be real numbers .*complex128"),
    "truth": (np.array([[True, False]]), "must be real numbers .*bool"),
    "truth among objects": (np.array([[True, 2]], object), "must be real numbers .*bool"),
    "nothing": (None, "must be real numbers"),
    "missing": ([[1, None]], "must be real numbers"),
    "dates": (np.array([["2020-01-01", "2021-01-01"]], "M8[D]"), "must be real numbers .*datetime64"),
    "masked": (np.ma.masked_array([[1.0, 2.0]], [[True, False]]), "some are masked"),
    "not a number": ([[5, 1], [NAN, 2]], "backbone 1: axial=nan is not a finite number"),
    "infinite": ([[5, math.inf]], "backbone 0: angle=inf is not a finite number"),
    "beyond": ([[5, 1], [25, 2]], r"backbone 1: axial=25.0 is outside the tube; give a value from 0 to 20.0"),
    "before": ([[-0.1, 1]], "backbone 0: axial=-0.1 is outside"),
    "twins": ([[5, 1], [5, 1], [15, 2]], "backbones 0 and 1 are the same backbone, axial=5.0, angle=1.0"),
    "twins a turn apart": ([[15, 2], [5, 1], [5, 1 + 2 * math.pi]], "backbones 1 and 2 are the same"),
    "twins three turns back": ([[5, 1], [5, 1 - 6 * math.pi]], "backbones 0 and 1 are the same"),
    "twins across zero": ([[5, 1e-17], [5, -1e-17]], "backbones 0 and 1 are the same"),
    "all of them one": (np.ones((3000, 2)), "backbones 0 and 1 are the same"),
}
TAKERS = {
    "measure_tissue": lambda place: jt.measure_tissue(place, TUBE),
    "CellMeasurer": lambda place: jt.CellMeasurer(TUBE).measure(place),
    "find_connectivity": lambda place: jt.find_connectivity(place, TUBE),
    "find_contacts": lambda place: jt.find_contacts(place, TUBE),
    "find_transitions": lambda place: jt.find_transitions(place, TUBE),
    "find_forms": lambda place: find_forms(place, TUBE),
    "trace_edges": lambda place: trace_edges(place, TUBE),
    "bound_ratios": lambda place: jt.bound_ratios(place, TUBE, jt.find_connectivity(FLOATS, TUBE)),
    "exact_cells": lambda place: jt.exact_cells(place, TUBE, 2),
    "separation": lambda place: jt.separation(place, TUBE),
    "covering_radius": lambda place: jt.covering_radius(place, TUBE),
    "label_image": lambda place: jt.label_image(place, TUBE, 1.0),
    "Annealer.start": lambda place: jt.Annealer(
        jt.tube_model(TUBE, 6), "draft", "mh", 0, jt.constant_schedule(1.0, 1)
    ).start(place),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_tissue_is_refused_everywhere_in_the_same_words(name):
    given, words = BAD[name]
    with pytest.raises(ValueError, match=words) as refusal:
        as_positions(given, TUBE)
    assert "\n" not in str(refusal.value)
    for take in TAKERS.values():
        with pytest.raises(ValueError, match=words):
            take(given)


def test_another_number_of_cells_than_the_model_s_is_refused():
    place = TUBE.random_positions(jax.random.key(0), 25)
    run = jt.Annealer(jt.tube_model(TUBE, 20), "draft", "mh", 0, jt.constant_schedule(1.0, 1))
    with pytest.raises(ValueError, match=r"25 backbones for a model of 20 cells; .*tube_model\(tube, 25\)"):
        run.start(place)
    assert len(run.start(place[:20]).positions) == 20


def test_a_rounding_beyond_the_ends_is_put_on_them():
    end = 20.1
    place = as_positions([[float(np.float32(end)), 0], [-1e-17, 1], [0, 2]], jt.Tube(end, 1, 3), np.float64)
    assert place.tolist() == [[end, 0], [0, 1], [0, 2]]


def test_large_angles_lose_no_digits():
    turns = 2 * math.pi * np.array([0, 10_000, -10_000])
    place = as_positions(np.stack([[1, 2, 3], 1 + turns], axis=1), TUBE)
    np.testing.assert_allclose(place[:, 1], 1, atol=1e-6)  # float32 has 0.004 at 10,000 turns


def test_backbones_too_near_for_float32():
    others = [[5, 1], [9, 3], [14, 6], [1, 1], [18, 2]]
    with pytest.raises(ValueError, match=r"same backbone, .*--x64"):
        jt.measure_tissue([*others, [5, 1 + 1e-7]], TUBE, refine=False)
    near = np.array([*others, [5 + 1e-6, 1 + 1e-6]])
    with pytest.warns(UserWarning, match=r"backbones 0 and 5 are too close .* float32: .*--x64"):
        jt.measure_tissue(near, TUBE, "draft", surfaces=False, refine=False)
    with jax.enable_x64(True), warnings.catch_warnings():
        warnings.simplefilter("error")
        cells = jt.measure_tissue(near, TUBE, "draft", surfaces=False, refine=False)
        as_positions([*others, [5, 1 + 1e-7]], TUBE)
    exact = jt.exact_cells(near, TUBE, 100)
    np.testing.assert_allclose(cells.volume, exact.volume, atol=0.01 * exact.volume.mean())  # `draft`


def test_backbones_near_enough_to_measure_bring_no_warning():
    level = [[5, 1], [5, 1 + 2e-6], [9, 3]]  # their wall is radial
    apart = [[5, 1], [5 + 1e-4, 1 + 1e-4], [9, 3]]
    ring = np.stack([np.full(300, 5.0), np.arange(300) * 2 * math.pi / 300], axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for place in (level, apart, ring):
            as_positions(place, TUBE)


def test_places_that_float32_moves_by_much_of_their_distance_are_told():
    tube = jt.Tube(1e5, 1, 3)
    with pytest.warns(UserWarning, match=r"backbones 0 and 1 are too close .*--x64"):
        as_positions([[70_000.001, 0], [70_000.02, 0.001]], tube)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_positions([[70_000.001, 0], [70_001.02, 0.01]], tube)
        as_positions([[70_000.001, 0], [70_000.02, 0.001]], tube, np.float64)


def test_traced_positions_pass(x64):
    place = jnp.asarray(FLOATS)
    assert float(jax.jit(jt.separation)(place, TUBE)) == float(jt.separation(place, TUBE))
    both = jax.vmap(jt.separation, (0, None))(jnp.stack([place, place[::-1]]), TUBE)
    np.testing.assert_allclose(both, float(jt.separation(place, TUBE)))
    with pytest.raises(ValueError, match="shape"):
        jax.jit(jt.separation)(place[:, :1], TUBE)


@pytest.mark.parametrize("sizes", [(20, 1, 3), (np.int8(20), np.uint8(1), np.float16(3)), (20, np.array(1), 3.0)])
def test_sizes_of_tubes_are_floats(sizes):
    tube = jt.Tube(*sizes)
    assert all(type(size) is float for size in (tube.length, tube.apical_radius, tube.basal_radius))
    assert tube.volume == pytest.approx(160 * math.pi)


@pytest.mark.parametrize(
    "sizes, words",
    [
        ((NAN, 1, 3), "length=nan is not a positive finite number"),
        ((20, math.inf, 3), "apical_radius=inf"),
        ((20, 1, 0), "basal_radius=0"),
        ((20, "1", 3), "apical_radius='1' is not a number"),
        ((None, 1, 3), "length=None is not a number"),
        ((True, 1, 3), "length=True is not a number"),
        ((1j, 1, 3), "length=1j is not a number"),
        ((20, np.array([1.0, NAN]), 3), "apical_radius="),
        ((4e-19, 1e-20, 1e-19), "length=4e-19 is out of the range of float32, .*--x64"),
        ((1e12, 1, 3), "length=1000000000000.0 is out of the range of float32, .*--x64"),
        ((1e200, 1, 3), r"range of float32, [^x]*$"),
        ((20, 1, 1 + 1e-8), "too close to be distinguished in float32; use 64 bits"),
        ((20, 3, 1), "apical_radius=3.0 is not smaller than basal_radius=1.0"),
    ],
)
def test_sizes_that_make_no_tube_are_refused(sizes, words):
    with pytest.raises(ValueError, match=words):
        jt.Tube(*sizes)


def test_concrete_jax_sizes_are_checked():
    with pytest.raises(ValueError, match="length="):
        jt.Tube(jnp.array(NAN), 1, 3)


def test_sizes_that_64_bits_can_measure(x64):
    small = jt.Tube(20e-20, 1e-20, 3e-20)
    cells = jt.measure_tissue(FLOATS * [1e-20, 1], small, "draft", surfaces=False)
    usual = jt.measure_tissue(FLOATS, TUBE, "draft", surfaces=False)
    np.testing.assert_allclose(cells.volume * 1e60, usual.volume, rtol=1e-9)
    with pytest.raises(ValueError, match="range of float64"):
        jt.Tube(1e200, 1, 3)


@pytest.mark.parametrize("given", ["8x12", (8, 12), jt.Resolution(8, 12), [8, 12.0], (np.int64(8), 12)])
def test_resolutions_are_given_as_any_of_these(given):
    assert as_resolution(given) == jt.Resolution(8, 12)


def test_presets_are_taken_by_name():
    tube, place = jt.Tube(20, 1, 3), FLOATS
    sizes = [jt.PRESETS["draft"], "draft", "4x4"]
    same, *others = (jt.measure_tissue(place, tube, size, surfaces=False, refine=False).volume for size in sizes)
    for other in others:
        np.testing.assert_array_equal(other, same)
    assert jt.CellMeasurer(tube, "fine").resolution == jt.PRESETS["fine"]
    run = jt.Annealer(jt.tube_model(tube, 6), "standard", "mh", 0, jt.constant_schedule(1.0, 1))
    assert run.resolution == jt.PRESETS["standard"]
    assert plan_lines(tube, 6, "8x12").half == plan_lines(tube, 6, jt.Resolution(8, 12)).half


@pytest.mark.parametrize("bad", ["sharp", "8x", "8x12x2", "", (0, 4), (4.5, 4), (4, NAN), None, 7, (65, 4)])
def test_other_resolutions_are_refused(bad):
    for take in (as_resolution, lambda given: jt.measure_tissue(FLOATS, TUBE, given)):
        with pytest.raises(ValueError, match="unknown resolution"):
            take(bad)
