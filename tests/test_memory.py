"""The estimate of a run's memory: linear in cells and replicas, and a warning only where it won't do."""

import json
from pathlib import Path

import pytest

from jaxtissue.dynamics.memory import BASE, estimate_memory, machine_memory, memory_warning
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import PRESETS


def estimate(cells: int, **options: int) -> float:
    tube = Tube(length=cells / 5, apical_radius=1.0, basal_radius=10.0)
    return estimate_memory(cells, tube, PRESETS["draft"], **options) - BASE


def test_memory_grows_with_cells_and_replicas() -> None:
    assert estimate(4800) == pytest.approx(1.6 * estimate(3000), rel=1e-6)  # whole bytes
    assert 10 * estimate(5000) < estimate(50_000) < 12 * estimate(5000)  # with more candidates
    assert estimate(500, replicas=100) == pytest.approx(100 * estimate(500), rel=1e-6)
    assert estimate(5000) < estimate(5000, float_bytes=8) < 2 * estimate(5000)


def test_it_tells_what_was_measured() -> None:
    results = Path(__file__).parent.parent / "benchmarks" / "results"
    rows = json.loads((results / "scale.json").read_text())["rows"]
    assert max(row["cells"] for row in rows) >= 100_000
    for row in rows:
        measured = 2**20 * row["peak_memory_mb"]
        assert measured < 16e9 and BASE + estimate(row["cells"]) == pytest.approx(measured, rel=0.25)


def test_the_warning_names_what_is_needed_and_what_there_is() -> None:
    assert memory_warning(10, 10) is None and memory_warning(10, None) is None
    text = memory_warning(int(33e9), int(16e9))
    assert text is not None and "33.0 GB" in text and "16.0 GB" in text and "fewer cells" in text


def test_the_machine_has_memory() -> None:
    memory = machine_memory()
    assert memory is None or memory > 1e8
