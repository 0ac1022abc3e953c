"""What no other benchmark shows: replicas, the first sweep, contacts, energies against the slow path, drift.

The paper's tube, 500 cells, R_a = 1 and 5. Each part runs in its own process, 1 and 16 replicas in turns;
`--reproduce` adds how long `jaxtissue reproduce` takes at the paper's sizes.
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
from jaxtissue.compilation.batching import PROGRAMS
from jaxtissue.dynamics.annealer import advance_together
from jaxtissue.dynamics.replays import SPAN

CELLS, SWEEPS, SEEDS = 500, 100, 5
RADII = (1.0, 5.0, 2.0, 8.0)
DRAFT, FINE = jt.PRESETS["draft"], jt.PRESETS["fine"]


def made(radius: float, seed: int, resolution: jt.Resolution = DRAFT, algorithm: str = "is-mh", t: float = 2.0):
    """A run of the paper's tube and its start."""
    tube = jt.Tube(100.0, radius, 10.0)
    run = jt.Annealer(jt.tube_model(tube, CELLS), resolution, algorithm, seed, jt.constant_schedule(t, SWEEPS))
    return run, run.start(tube.random_positions(jax.random.key(seed), CELLS))


def sweeps(count: int, cores: int) -> dict[str, Any]:
    """Seconds a sweep of so many replicas that differ in radius, seed and temperature."""
    jt.use_cores(cores)
    kinds = zip(range(count), cycle(RADII), cycle((2.0, 1.0, 0.5)), strict=False)
    runs, states = zip(*(made(radius, seed, t=t) for seed, radius, t in kinds), strict=True)
    spans, known = [], 0
    while states[0].sweep < SWEEPS:
        begin = time.perf_counter()
        results = advance_together(runs, states)
        known = known or len(PROGRAMS)
        states = [state for state, _, _ in results]
        if states[0].sweep > 2 * SPAN:
            spans.append((time.perf_counter() - begin) / len(results[0][1]))
    row = {"devices": jax.device_count(), "compiled_after_first_span": len(PROGRAMS) - known}
    return row | {"seconds": float(np.mean(spans))}


def one() -> dict[str, Any]:
    """A sweep of one replica, on one core, which is the fastest."""
    return sweeps(1, cores=1)


def sixteen() -> dict[str, Any]:
    """A sweep of 16 replicas, on all cores."""
    return sweeps(16, cores=os.cpu_count() or 1)


def first() -> dict[str, Any]:
    """Seconds from a tissue to the end of the first sweep, with no compiled program kept."""
    jt.use_cores(1)
    begin = time.perf_counter()
    run, state = made(1.0, 0)
    run.advance(state)
    return {"compile_and_first_sweep_seconds": time.perf_counter() - begin}


def contacts() -> dict[str, Any]:
    """Seconds for contacts and transition points, of random and of annealed tissue."""
    jt.use_cores(1)
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
    jt.use_cores(1)
    found: dict[str, Any] = {}
    for radius in RADII[:2]:
        for algorithm, resolution in (("is-mh", DRAFT), ("mh", FINE)):
            ends, drift = [], 0.0
            for seed in range(SEEDS):
                run, state = made(radius, seed, resolution, algorithm)
                while state.sweep < SWEEPS:
                    state, rows, _ = run.advance(state)
                    drift = max(drift, rows[-1].drift)
                cells = jt.measure_tissue(state.positions, run.model.tube, FINE, refine=False)
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
    part.__name__: part for part in (one, sixteen, first, contacts, energies, reproduce)
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
    turns = 3 * ["one", "sixteen"] + ["first", "contacts", "energies"] + arguments.reproduce * ["reproduce"]
    found: dict[str, Any] = {}
    for name in turns:
        command = [sys.executable, __file__, "--alone", name]
        kept_out = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "0"}
        done = subprocess.run(command, env=kept_out, capture_output=True, text=True, check=True)
        row = json.loads(done.stdout.splitlines()[-1])
        print(name, json.dumps(row, indent=1), flush=True)
        found.setdefault(name, []).append(row)
    alone, many = (np.median([row["seconds"] for row in found[name]]) for name in ("one", "sixteen"))
    found = {name: rows if len(rows) > 1 else rows[0] for name, rows in found.items()}
    found["sixteen_to_one"] = many / alone
    print("16 replicas take", many / alone, "times as long as one")
    common.write(arguments.out, found)


if __name__ == "__main__":
    main()
