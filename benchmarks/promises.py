"""What no other benchmark shows: replicas, the first sweep, contacts, energies against the slow path, drift.

The paper's tube, 500 cells, R_a = 1 and 5. Each part runs in a process of its own; `--reproduce` adds how
long `jaxtissue reproduce` takes at the paper's sizes.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt
from jaxtissue.anneal import SPAN
from jaxtissue.programs import PROGRAMS

CELLS, SWEEPS, SEEDS = 500, 100, 5
RADII = (1.0, 5.0, 2.0, 8.0)
DRAFT, FINE = jt.PRESETS["draft"], jt.PRESETS["fine"]


def made(
    radius: float, seed: int, resolution: jt.Resolution = DRAFT, algorithm: str = "is-mh", t: float = 2.0
):
    """A run of the paper's tube and its start."""
    tube = jt.Tube(100.0, radius, 10.0)
    run = jt.Annealer(
        jt.tube_model(tube, CELLS), resolution, algorithm, seed, jt.constant_schedule(t, SWEEPS)
    )
    return run, run.start(tube.random_positions(jax.random.key(seed), CELLS))


def replicas() -> dict[str, Any]:
    """Seconds a sweep of 1 replica, of 16 that differ in radius, seed and temperature, and of 1 again."""

    def typical(count: int) -> tuple[float, int]:
        kinds = zip(range(count), cycle(RADII), cycle((2.0, 1.0, 0.5)), strict=False)
        runs, states = zip(*(made(radius, seed, t=t) for seed, radius, t in kinds), strict=True)
        spans, known = [], 0
        while states[0].sweep < SWEEPS:
            begin = time.perf_counter()
            results = jt.advance_together(runs, states)
            known = known or len(PROGRAMS)
            states = [state for state, _, _ in results]
            if states[0].sweep > 2 * SPAN:
                spans.append((time.perf_counter() - begin) / len(results[0][1]))
        return float(np.mean(spans)), len(PROGRAMS) - known

    (before, _), (many, compiled), (after, _) = typical(1), typical(16), typical(1)
    alone = (before + after) / 2
    row = {"devices": jax.device_count(), "seconds_of_one": [before, after], "seconds_of_16": many}
    return row | {"ratio": many / alone, "compiled_after_first_span": compiled}


def first() -> dict[str, Any]:
    """Seconds from a tissue to the end of the first sweep, with no compiled program kept."""
    begin = time.perf_counter()
    run, state = made(1.0, 0)
    run.advance(state)
    return {"compile_and_first_sweep_seconds": time.perf_counter() - begin}


def contacts() -> dict[str, Any]:
    """Seconds for contacts and transition points, of random and of annealed tissue."""
    row = {}
    for radius in RADII[:2]:
        run, state = made(radius, 0)
        for name in ("random", "annealed"):
            begin = time.perf_counter()
            jt.find_connectivity(state.positions, run.model.tube)
            row[f"R_a = {radius:g}, {name}"] = time.perf_counter() - begin
            while state.sweep < SWEEPS:
                state, _, _ = run.advance(state)
    return {"seconds": row}


def energies() -> dict[str, Any]:
    """Energies after 100 sweeps by IS-MH and `draft`, and by single moves and `fine`; all told by `fine`."""
    found: dict[str, Any] = {}
    for radius in RADII[:2]:
        for algorithm, resolution in (("is-mh", DRAFT), ("mh", FINE)):
            ends, drift = [], 0.0
            for seed in range(SEEDS):
                run, state = made(radius, seed, resolution, algorithm)
                while state.sweep < SWEEPS:
                    state, rows, _ = run.advance(state)
                    drift = max(drift, rows[-1].drift)
                cells, _ = jt.measure_tissue(state.positions, run.model.tube, FINE)
                ends.append(float(np.sum(jt.epithelial_energy(cells, run.model), dtype=float)))
            row = {"energies": ends, "mean": np.mean(ends), "spread": np.std(ends, ddof=1), "drift": drift}
            found[f"R_a = {radius:g}, {algorithm}"] = row
    return found


def reproduce() -> dict[str, Any]:
    """Seconds that the paper's evaluation takes, at its sizes."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        command = [sys.executable, "-m", "jaxtissue", "reproduce", "--out", str(Path(folder) / "paper")]
        subprocess.run(command, check=True, capture_output=True)
        return {"seconds": time.perf_counter() - begin}


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    part.__name__: part for part in (replicas, first, contacts, energies, reproduce)
}


def main() -> None:
    """Run every part, print what it found, write the JSON."""
    parser = common.options((__doc__ or "").split("\n")[0], "promises")
    parser.add_argument("--alone", choices=PARTS, help="run one part here and print what was found")
    parser.add_argument("--reproduce", action="store_true", help="the paper's evaluation too: some minutes")
    arguments = parser.parse_args()
    if arguments.alone:
        print(json.dumps(PARTS[arguments.alone](), default=float))
        return
    found, settings = {}, os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "0"}
    for name in list(PARTS)[: len(PARTS) if arguments.reproduce else -1]:
        command = [sys.executable, __file__, "--alone", name]
        devices = {"JAX_NUM_CPU_DEVICES": str(os.cpu_count())} if name == "replicas" else {}
        done = subprocess.run(command, env=settings | devices, capture_output=True, text=True, check=True)
        found[name] = json.loads(done.stdout.splitlines()[-1])
        print(name, json.dumps(found[name], indent=1), flush=True)
    common.write(arguments.out, found)


if __name__ == "__main__":
    main()
