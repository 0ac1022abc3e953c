"""Sweeps and whole diagrams of large tissues and many replicas on a GPU, checked against the CPU.

R_a = 1, R_b = 10, five cells per unit of length, by `draft`. Runs on the CPU too, and says so. The fraction
of the chip's limit is told for whole diagrams: floating-point operations of the innermost loop, 13 for each
line and candidate, per second, over the most that multiply-adds in registers or a matmul reach on the device.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import common
import jax
import jax.numpy as jnp
import numpy as np

import jaxtissue as jt
from jaxtissue.compilation.fusion import options
from jaxtissue.dynamics.annealer import advance_together, record_together
from jaxtissue.dynamics.replays import SPAN
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import plan_lines

CELLS, REPLICAS = (500, 10_000, 100_000, 1_000_000), (1, 64, 1024)
DRAFT = jt.PRESETS["draft"]
FLOPS = 13  # of `axial_lines.crossing`: the sagitta 4, the foot 1, the square 6, the reach 2
BYTES = 17_000  # memory that a cell takes in a sweep, its candidates most of it (see scale.py)
SWEEPS = 3 * SPAN
AGREE = 1e-4  # of the mean cell: as far as two devices may differ in one cell, in float32
_measure = jax.jit(measure_cells, compiler_options=options())


def seconds_of(call: Callable[[], Any], repeats: int = 5) -> float:
    """Median seconds of a call, after one that compiles."""
    seconds = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds[1:]))


def peaks() -> dict[str, float]:
    """What the device reaches, in 10^9 operations a second: multiply-adds in registers, and a matmul."""
    on_cpu = jax.default_backend() == "cpu"
    values = jnp.linspace(0, 1, 1 << (18 if on_cpu else 24), dtype=jnp.float32)
    side = 1024 if on_cpu else 8192

    @jax.jit
    def chain(x: jax.Array) -> jax.Array:
        y, z, w = x + 1, x + 2, x + 3  # four chains, so that none waits for itself
        for _ in range(64):
            x, y, z, w = (0.999 * v + 0.001 for v in (x, y, z, w))
        return x + y + z + w

    matrix = jnp.ones((side, side), jnp.float32)
    product_of = jax.jit(lambda m: jnp.matmul(m, m, precision=jax.lax.Precision.HIGHEST))
    return {
        "multiply_add_gflops": 4 * 64 * 2 * len(values) / seconds_of(lambda: chain(values)) / 1e9,
        "matmul_gflops": 2 * side**3 / seconds_of(lambda: product_of(matrix)) / 1e9,
    }


def tissue(cells: int) -> tuple[np.ndarray, jt.Tube]:
    """A random tissue of the paper's density."""
    tube = jt.Tube(cells / 5, 1.0, 10.0)
    return np.asarray(tube.random_positions(jax.random.key(0), cells), np.float32), tube


def diagrams(cells: int, peak: float) -> dict[str, Any]:
    """A whole diagram on kept lists: seconds, the fraction of the peak, and the difference to the CPU."""
    place, tube = tissue(cells)
    measurer = jt.CellMeasurer(tube, DRAFT)
    measurer.measure(place)
    near = measurer.sides
    assert near is not None
    lines = plan_lines(tube, cells, DRAFT)

    def measure(device: Any) -> tuple[Any, float]:
        positions, lists = jax.device_put((place, near), device)
        with jax.default_device(device):
            seconds = seconds_of(lambda: _measure(positions, tube, lines, lists)[0])
            return _measure(positions, tube, lines, lists)[0], seconds

    found, seconds = measure(jax.devices()[0])
    pairs = cells * near[0].size * len(lines.number)
    row = {"diagram_seconds": seconds, "line_candidate_pairs": pairs}
    row["fraction_of_peak"] = FLOPS * pairs / seconds / (1e9 * peak)
    if jax.default_backend() != "cpu":
        known, row["diagram_seconds_on_cpu"] = measure(jax.devices("cpu")[0])
        for name in ("volume", "lateral_area"):
            here, there = (np.asarray(getattr(sizes, name), float) for sizes in (found, known))
            row[f"largest_difference_{name}"] = float(np.abs(here - there).max() / there.mean())
        worst = max(row["largest_difference_volume"], row["largest_difference_lateral_area"])
        row["agrees_with_cpu"] = bool(worst < AGREE)
    return row


def sweeps(cells: int, replicas: int) -> dict[str, Any]:
    """Seconds a typical sweep of all replicas, and the energy a cell of the first after each."""
    place, tube = tissue(cells)
    model, schedule = jt.tube_model(tube, cells), jt.constant_schedule(2.0, SWEEPS)
    annealers = [jt.Annealer(model, DRAFT, "is-mh", seed, schedule) for seed in range(replicas)]
    states = [annealer.start(place) for annealer in annealers]
    records = [record_together(annealers, states)[0]]
    while states[0].sweep < SWEEPS:
        spans = advance_together(annealers, states)
        states = [state for state, _, _ in spans]
        records += spans[0][1]
    # a row tells the time divided by the replicas
    seconds = replicas * float(np.median([record.seconds for record in records[1 + 2 * SPAN :]]))
    row = {"sweep_seconds": seconds, "nanoseconds_per_cell": 1e9 * seconds / (cells * replicas)}
    row |= {"compile_seconds": annealers[0].compile_seconds, "rounds": records[-1].rounds}
    return row | {"energies": [record.energy / cells for record in records]}


def sweeps_on_cpu(cells: int) -> dict[str, Any]:
    """The same sweeps in a process that sees no GPU."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cpu.json"
        command = [sys.executable, __file__, "--cells", str(cells), "--replicas", "1", "--out", str(path)]
        subprocess.run(command, env=os.environ | {"JAX_PLATFORMS": "cpu"}, check=True, capture_output=True)
        return json.loads(path.read_text(encoding="utf-8"))["rows"][0]


def room() -> float:
    """Bytes that the device may hold, 0.7 of what it has."""
    stats = jax.devices()[0].memory_stats() if jax.default_backend() != "cpu" else None
    if stats and "bytes_limit" in stats:
        return 0.7 * stats["bytes_limit"]
    return 0.7 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def measure(cells: int, replicas: int, peak: float) -> dict[str, Any]:
    """One size: sweeps, for one replica a diagram and, up to 10,000 cells, the same sweeps on the CPU."""
    row: dict[str, Any] = {"cells": cells, "replicas": replicas}
    row |= sweeps(cells, replicas)
    if replicas == 1:
        row |= diagrams(cells, peak)
        if jax.default_backend() != "cpu" and cells <= 10_000:
            there = sweeps_on_cpu(cells)
            row["sweep_seconds_on_cpu"] = there["sweep_seconds"]
            # moves that are decided by less than rounding part the runs: energies agree only as means do
            pairs = zip(row["energies"], there["energies"], strict=True)
            row["largest_energy_difference"] = max(abs(a / b - 1) for a, b in pairs)
    return row


def main() -> None:
    """Measure every size that fits, print a table, write the JSON."""
    parser = common.options((__doc__ or "").split("\n")[0], "gpu")
    parser.add_argument("--cells", type=int, nargs="+", default=CELLS)
    parser.add_argument("--replicas", type=int, nargs="+", default=REPLICAS)
    parser.add_argument("--budget", type=float, default=120.0, help="seconds that one size may be expected to take")
    arguments = parser.parse_args()
    if jax.default_backend() == "cpu":
        print("no GPU here: this is measured on the CPU")
    limits, rows, skipped = peaks(), [], []
    print(", ".join(f"{name} {value:.0f}" for name, value in limits.items()))
    pace = 0.0  # seconds that the last size took, for each cell
    for replicas, cells in product(arguments.replicas, arguments.cells):
        size, reason = replicas * cells, ""
        if size * BYTES > room():
            reason = f"takes about {size * BYTES / 1e9:.0f} GB, {room() / 1e9:.0f} GB are there"
        elif size * pace > arguments.budget:
            reason = f"would take about {size * pace:.0f} s; raise --budget"
        begin = time.perf_counter()
        try:
            row = {} if reason else measure(cells, replicas, max(limits.values()))
        except jax.errors.JaxRuntimeError as error:
            row, reason = {}, str(error).splitlines()[0]
        if reason:
            print(f"{cells:9} x {replicas:<5} skipped: {reason}")
            skipped.append({"cells": cells, "replicas": replicas, "reason": reason})
            continue
        if cells >= 10_000:
            pace = (time.perf_counter() - begin) / size
        rows.append(row)
        told = [f"{key} {value:.4g}" for key, value in row.items() if isinstance(value, float)]
        print(f"{cells:9} x {replicas:<5}", ", ".join(told), flush=True)
    common.write(arguments.out, {"peaks": limits, "rows": rows, "skipped": skipped})


if __name__ == "__main__":
    main()
