"""The yardstick against analytic cells, symmetries and the high-precision reference tubes."""

from pathlib import Path

import numpy as np
import pytest

from jaxtissue.diagram.exact import ExactDiagram, exact_cells
from jaxtissue.geometry.tube import Tube

DATA = Path(__file__).parent / "data"
TUBE = Tube(length=10.0, apical_radius=1.0, basal_radius=3.0)


def random_positions(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(0, 10, n), rng.uniform(0, 2 * np.pi, n)], axis=1)


def tube_volume(tube: Tube) -> float:
    return float(np.pi * (tube.basal_radius**2 - tube.apical_radius**2) * tube.length)


def load(name: str) -> tuple[dict[str, np.ndarray], np.ndarray, Tube]:
    data = dict(np.load(DATA / f"{name}.npz"))
    tube = Tube(length=float(data["L"]), apical_radius=float(data["Ra"]), basal_radius=float(data["Rb"]))
    return data, np.stack([data["x"], data["theta"]], axis=1), tube


def relative_rms(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean((found - expected) ** 2)) / np.mean(expected))


def walls(pairs: np.ndarray, areas: np.ndarray) -> dict[tuple[int, ...], float]:
    return dict(zip(map(tuple, pairs.tolist()), areas.tolist(), strict=True))


# Bars on the lateral area: the reference claims 2e-4 of the mean, sampled walls add at most as much.
@pytest.mark.parametrize(
    "name, lateral_bar",
    [
        ("n2", 1e-5),  # one smooth wall, both sides know it to 1e-6
        ("thin_1.01", 5e-4),
        ("near_coincident", 5e-4),
        ("duplicate_x", 5e-4),
        ("ratio10_n100", 5e-4),
        ("bluenoise_ratio10", 5e-4),
        ("paper_Ra5", 5e-4),
    ],
)
def test_reference_tubes(name: str, lateral_bar: float) -> None:
    data, positions, tube = load(name)
    cells = exact_cells(positions, tube, samples=50)
    assert relative_rms(cells.volume, data["V"]) <= 2e-5  # sampling error at 50 samples, measured 8e-6
    assert relative_rms(cells.lateral_area, data["lateral"]) <= lateral_bar
    found, expected = walls(cells.pairs, cells.wall_area), walls(data["A_pairs"], data["A_val"])
    mean = np.mean(data["A_val"])
    # tiny walls come and go with the samples: only those of some size must agree
    assert {pair for pair, area in expected.items() if area > 1e-2 * mean} <= found.keys()
    assert all(found[pair] <= 1e-3 * mean for pair in found.keys() - expected.keys())


def test_errors_fall_with_the_square_of_the_samples() -> None:
    data, positions, tube = load("ratio10_n100")
    cells = [exact_cells(positions, tube, samples) for samples in (5, 10, 20)]
    volume = [relative_rms(c.volume, data["V"]) for c in cells]
    # a doubling gains 4 for smooth walls and 5 to 7 here; 3.5 leaves room for the particular tissue
    assert volume[0] > 3.5 * volume[1] > 3.5**2 * volume[2]
    # zigzag facets alone would be 1 % too large at 10 samples; their flux is not
    assert cells[1].lateral_area.sum() == pytest.approx(data["lateral"].sum(), rel=3e-4)


@pytest.mark.parametrize("samples", [2, 3, 50])
def test_single_cell_is_the_tube(samples: int) -> None:
    cells = exact_cells([[2.0, 1.0]], TUBE, samples)
    assert cells.volume == pytest.approx([tube_volume(TUBE)], rel=1e-13)  # roundoff
    assert cells.lateral_area.tolist() == [0.0]
    assert cells.pairs.shape == (0, 2)
    assert cells.wall_area.shape == (0,)
    assert cells.lateral_area.dtype == cells.wall_area.dtype == np.float64


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_ring_of_equal_cells(count: int) -> None:
    """Radial planes part backbones at one height: the facets are parallel to the axis."""
    ring = np.stack([np.full(count, 3.0), 0.3 + 2 * np.pi * np.arange(count) / count], axis=1)
    cells = exact_cells(ring, TUBE, samples=6)
    plane = 10.0 * 2.0  # L (R_b - R_a)
    assert cells.volume == pytest.approx(np.full(count, tube_volume(TUBE) / count), rel=1e-12)  # roundoff
    assert cells.lateral_area == pytest.approx(np.full(count, 2 * plane), rel=1e-12)
    assert len(cells.pairs) == (1 if count == 2 else count)


def test_stack_of_cells() -> None:
    """Planes square to the axis part backbones at one angle."""
    cells = exact_cells([[9.0, 2.0], [1.0, 2.0], [4.0, 2.0]], TUBE, samples=6)
    disc = np.pi * (3.0**2 - 1.0**2)
    assert cells.volume == pytest.approx(disc * np.array([3.5, 2.5, 4.0]), rel=1e-12)  # roundoff
    assert cells.pairs.tolist() == [[0, 2], [1, 2]]
    assert cells.wall_area == pytest.approx([disc, disc], rel=1e-12)


def test_two_cells_swapped_by_a_half_turn() -> None:
    cells = exact_cells([[4.0, 1.0], [6.0, 1.8]], TUBE, samples=9)
    assert cells.volume == pytest.approx(np.full(2, tube_volume(TUBE) / 2), rel=1e-12)  # roundoff
    assert cells.lateral_area[0] == cells.lateral_area[1] == cells.wall_area[0]


@pytest.mark.parametrize("step", [1e-12, 1e-9, 1e-6])
def test_walls_nearly_parallel_to_the_axis(step: float) -> None:
    """The clip is well conditioned where the normal's axial part vanishes."""
    level, tilted = (exact_cells([[5.0, 0.0], [5.0 + dx, 2.0], [5.0, 3.5]], TUBE, 8) for dx in (0.0, step))
    # first order in the step with slopes of order R_b L; 1e-11 for roundoff
    assert tilted.volume == pytest.approx(level.volume, abs=100 * step + 1e-11)
    assert tilted.lateral_area == pytest.approx(level.lateral_area, abs=100 * step + 1e-11)


@pytest.mark.parametrize("samples", [2, 7])
@pytest.mark.parametrize("ratio", [1.01, 3.0, 200.0])
def test_volumes_fill_the_tube(samples: int, ratio: float) -> None:
    tube = Tube(length=10.0, apical_radius=3.0 / ratio, basal_radius=3.0)
    cells = exact_cells(random_positions(30), tube, samples)
    assert cells.volume.sum() == pytest.approx(tube_volume(tube), rel=1e-11)  # thin tubes cancel two digits
    assert cells.volume.min() > 0


def test_walls_add_up_to_lateral_areas() -> None:
    cells = exact_cells(random_positions(30), TUBE, samples=10)
    assert np.all(cells.pairs[:, 0] < cells.pairs[:, 1])
    assert cells.pairs.tolist() == sorted(cells.pairs.tolist())
    assert cells.wall_area.min() > 0
    touching = (cells.pairs[:, :, None] == np.arange(30)).any(axis=1)
    assert cells.lateral_area == pytest.approx(cells.wall_area @ touching, rel=1e-13)  # roundoff


def assert_same(found: ExactDiagram, expected: ExactDiagram, length: float = 1.0) -> None:
    # 1e-9: roundoff of Qhull's corners, grown by thin facets
    assert found.volume == pytest.approx(expected.volume * length**3, rel=1e-9)
    assert found.lateral_area == pytest.approx(expected.lateral_area * length**2, rel=1e-9)
    size = 1e-9 * expected.wall_area.mean()
    left, right = (
        {pair for pair, area in walls(c.pairs, c.wall_area / scale**2).items() if area > size}
        for c, scale in ((found, length), (expected, 1.0))
    )
    assert left == right


@pytest.mark.parametrize(
    "move",
    [
        lambda x, angle: (x, angle + 1.234),  # turn
        lambda x, angle: (x, angle + 2 * np.pi * np.arange(len(x))),  # whole turns, each its own
        lambda x, angle: (x, -angle),  # mirror along the axis
        lambda x, angle: (10 - x, angle),  # mirror across the axis
    ],
)
def test_symmetries_of_the_tube(move) -> None:
    positions = random_positions(25)
    moved = np.stack(move(*positions.T), axis=1)
    assert_same(exact_cells(moved, TUBE, 10), exact_cells(positions, TUBE, 10))


def test_scale() -> None:
    positions = random_positions(25)
    large = Tube(length=37.0, apical_radius=3.7, basal_radius=11.1)
    found = exact_cells(positions * [3.7, 1.0], large, 10)
    assert_same(found, exact_cells(positions, TUBE, 10), length=3.7)


@pytest.mark.parametrize("length, tolerance", [(1000.0, 1e-10), (9000.0, 1e-7), (29_900.0, 5e-6)])
def test_cells_far_along_a_long_tube(length: float, tolerance: float) -> None:
    """Roundoff of Qhull's corners grows with the square of the way to the tube's ends."""
    positions = random_positions(30)
    inner = np.argsort(positions[:, 0])[8:22]
    short = exact_cells(positions + np.array([15.0, 0.0]), Tube(40.0, 1.0, 3.0), 20)
    long = exact_cells(positions + np.array([0.7 * length, 0.0]), Tube(length, 1.0, 3.0), 20)
    assert long.volume[inner] == pytest.approx(short.volume[inner], rel=tolerance)
    assert long.lateral_area[inner] == pytest.approx(short.lateral_area[inner], rel=tolerance)


def test_tubes_too_long_for_qhull_are_refused() -> None:
    positions = random_positions(30) + np.array([70_000.0, 0.0])
    with pytest.raises(
        ValueError, match=r"length=100000.0 is 3.33e\+04 times basal_radius; .* at most 10000 basal radii"
    ):
        exact_cells(positions, Tube(1e5, 1.0, 3.0))


def test_order_of_backbones() -> None:
    positions, order = random_positions(25), np.random.default_rng(1).permutation(25)
    found, expected = exact_cells(positions[order], TUBE, 10), exact_cells(positions, TUBE, 10)
    pairs = np.sort(order[found.pairs], axis=1)
    back = np.argsort(order)
    assert_same(
        found._replace(volume=found.volume[back], lateral_area=found.lateral_area[back], pairs=pairs),
        expected,
    )


@pytest.mark.parametrize("shift", [(1e-6, 0.0), (0.0, 1e-6)])
def test_close_pair_shares_one_cell(shift: tuple[float, float]) -> None:
    positions = random_positions(20)
    alone = exact_cells(positions, TUBE, 10)
    close = exact_cells(np.vstack([positions, positions[3] + shift]), TUBE, 10)
    joined = close.volume[:20].copy()
    joined[3] += close.volume[20]
    assert joined == pytest.approx(alone.volume, abs=1e-4)  # the shift times a cell's wall, about 50
    assert min(close.volume[3], close.volume[20]) > 0.01 * alone.volume[3]


@pytest.mark.parametrize(
    "positions, samples, message",
    [
        ([[1.0, 0.5], [2.0, 0.0], [1.0, 0.5 + 2 * np.pi]], 50, "backbones 0 and 2 are the same"),
        ([[1.0, 0.5], [10.5, 0.0]], 50, "backbone 1: axial=10.5 .* give a value from 0 to 10"),
        ([[np.nan, 0.5]], 50, "backbone 0"),
        ([[1.0, np.inf]], 50, "backbone 0"),
        ([1.0, 0.5], 50, r"shape \(2,\)"),
        (np.zeros((0, 2)), 50, r"shape \(0, 2\)"),
        ([[1.0, 0.5]], 1, "samples=1"),
    ],
)
def test_bad_input(positions, samples: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        exact_cells(positions, TUBE, samples)
