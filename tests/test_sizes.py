"""Sizes of cells from their traced faces, against the reference tubes, brute force and by symmetry."""

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as some

from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.traced_sizes import TracedSizes, trace_sizes

NAMES = ("volume", "lateral_area", "apical_area", "basal_area", "apical_perimeter", "basal_perimeter")


def traced(positions: np.ndarray, tube: Tube) -> TracedSizes:
    sizes = trace_sizes(positions, tube)
    assert sizes is not None
    return sizes


def on_lines(positions: np.ndarray, tube: Tube, radius: float, lines: int) -> tuple[np.ndarray, np.ndarray]:
    """Areas of all cells on a layer and the lengths of their walls there, from many lines by brute force."""
    turn = 2 * np.pi / lines
    angle = (np.arange(lines) + 0.5) * turn
    axial, inner = positions[:, 0], float(tube.apical_radius)
    height = radius * np.cos(angle[:, None] - positions[:, 1])
    foot = np.maximum(height, inner)
    square = -foot * (2 * height - foot)
    areas, walls = np.zeros(len(axial)), np.zeros(len(axial))
    for i in range(len(axial)):
        reach = []
        for side, end in ((-1, axial[i]), (1, float(tube.length) - axial[i])):
            gap = side * (axial - axial[i])
            others = np.flatnonzero(gap > 0)
            h = gap[others] / 2 + (square[:, others] - square[:, [i]]) / (2 * gap[others])
            reach.append(np.column_stack([h, np.full(lines, end)]))
        low = [r.min(axis=1) for r in reach]
        inside = low[0] + low[1] > 0
        areas[i] = radius * turn * (low[0] + low[1])[inside].sum()
        for r, least in zip(reach, low, strict=True):
            wall = inside & (least < r[:, -1])
            both = wall & np.roll(wall, 1)
            walls[i] += np.hypot(np.diff(least, prepend=least[-1:]), radius * turn)[both].sum()
    return areas, walls


def test_the_reference_tubes(reference) -> None:
    sizes, data = traced(reference.positions, reference.tube), reference.data
    columns = {
        "volume": ("V", 2e-5),
        "apical_area": ("apical_area", 5e-4),
        "basal_area": ("basal_area", 5e-4),
    }
    columns |= {"lateral_area": ("lateral", 1.2e-3)}  # what the references are right to
    columns |= {f"{side}_perimeter": (f"{side}_perim", 1e-3) for side in ("apical", "basal")}
    for name, (key, off) in columns.items():
        expected = data[key]
        assert np.abs(getattr(sizes, name) - expected).max() <= off * max(expected.mean(), 1e-9), name
    assert sizes.volume.sum() == pytest.approx(float(reference.tube.volume), rel=1e-10)
    for name, size in (("V", "volume"), ("lateral", "lateral_area")):
        off = np.abs(getattr(sizes, size) - data[name])
        assert (off <= getattr(sizes, f"{size}_error")).mean() >= 0.95


@pytest.mark.parametrize("seed", range(4))
def test_layers_are_those_of_many_lines(seed: int) -> None:
    draw = np.random.default_rng(seed)
    tube = Tube(10.0, (0.3, 1.0, 4.0, 9.0)[seed], 10.0)
    place = draw.random((12, 2)) * [10, 2 * np.pi]
    place[:3] = np.array([5, 1]) + 0.01 * draw.normal(size=(3, 2))  # a clump
    sizes = traced(place, tube)
    for side, radius in (("apical", tube.apical_radius), ("basal", tube.basal_radius)):
        area, edge = on_lines(place, tube, float(radius), 100_000)
        np.testing.assert_allclose(getattr(sizes, f"{side}_area"), area, atol=2e-4 * area.mean())
        # lines end before the corners of steep walls
        np.testing.assert_allclose(getattr(sizes, f"{side}_perimeter"), edge, atol=2e-2 * edge.mean())


@settings(max_examples=8, phases=(Phase.explicit, Phase.generate))  # shrinking takes minutes
@given(some.integers(0, 2**32 - 1), some.integers(2, 16), some.floats(0.02, 0.98), some.floats(0.1, 40))
def test_sizes_turn_mirror_and_scale_with_the_tissue(seed, cells, ratio, length) -> None:
    tube = Tube(length, ratio, 1.0)
    place = np.random.default_rng(seed).random((cells, 2)) * [length, 2 * np.pi]
    plain = traced(place, tube)
    assert plain.volume.sum() == pytest.approx(float(tube.volume), rel=1e-7)
    for radius, area in ((ratio, plain.apical_area), (1.0, plain.basal_area)):
        assert area.sum() == pytest.approx(2 * math.pi * radius * length, rel=1e-7)
        assert area.min() > 0  # each cell reaches both surfaces
    order = np.random.default_rng(seed).permutation(cells)
    others = {
        "turned": (place + np.array([0, 2]), tube, slice(None), 1.0),
        "mirrored": (place * [1, -1], tube, slice(None), 1.0),
        "end to end": (np.array([length, 0]) + place * [-1, 1], tube, slice(None), 1.0),
        "in millimeters": (place * [1e3, 1], Tube(1e3 * length, 1e3 * ratio, 1e3), slice(None), 1e3),
        "in another order": (place[order], tube, order, 1.0),
    }
    for name, (moved, other, rows, scale) in others.items():
        sizes = traced(moved, other)
        for size, power in zip(NAMES, (3, 2, 2, 2, 1, 1), strict=True):
            expected = scale**power * getattr(plain, size)[rows]
            np.testing.assert_allclose(
                getattr(sizes, size), expected, atol=1e-5 * expected.mean(), err_msg=f"{size}, {name}"
            )


def test_some_cells_among_their_rivals_are_as_in_the_whole_tissue() -> None:
    tube, n = Tube(60, 1, 3), 300
    place = np.random.default_rng(4).random((n, 2)) * [60, 2 * np.pi]
    cells = np.array([7, 150])
    gap = np.abs(place[:, 0] - place[cells, :1])
    rivals = np.argsort(gap, axis=1)[:, :60]
    whole, part = traced(place, tube), trace_sizes(place, tube, cells, rivals)
    assert part is not None
    for name in (*NAMES, "touches_end"):
        np.testing.assert_allclose(getattr(part, name), getattr(whole, name)[cells], rtol=1e-7)
