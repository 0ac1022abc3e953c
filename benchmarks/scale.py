"""Time per cell and sweep, and memory, as the tube is lengthened at the same density: R_a = 1, R_b = 10.

    python benchmarks/scale.py --cells 500 5000 50000 100000

Each size runs in a process of its own, so that its peak memory is its own.
"""

import json
import subprocess
import sys
import time
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt
from jaxtissue.dynamics.replays import SPAN
from jaxtissue.measurement.quadrature import as_resolution

WARM_UP = 2 * SPAN  # sweeps before those that are timed: in the first, lists are renewed more often
FEW = 5000  # cells; of fewer more tissues are annealed, as many moves in all


def run(cells: int, sweeps: int, resolution: str) -> dict[str, Any]:
    """Anneal one tube of `cells` / 5 length; memory counted from before the tissue is made."""
    jt.use_cores(1)
    tube = jt.Tube(cells / 5, 1.0, 10.0)
    model, size = jt.tube_model(tube, cells), as_resolution(resolution)
    before, begin, first, timed = common.peak_memory_mb(), time.perf_counter(), None, []
    records: list[jt.SweepRecord] = []
    for seed in range(max(1, FEW // cells)):
        annealer = jt.Annealer(model, size, "is-mh", seed, jt.constant_schedule(2.0, WARM_UP + sweeps))
        state = annealer.start(tube.random_positions(jax.random.key(seed), cells))
        records = [annealer.record(state)]
        while state.sweep < WARM_UP + sweeps:
            state, rows, _ = annealer.advance(state)
            records += rows
            first = first or (time.perf_counter() - begin, annealer.compile_seconds)
        timed += [record.seconds for record in records[1 + WARM_UP :]]
    assert first
    seconds = float(np.mean(timed))  # so that sweeps that were played twice count in
    return {
        "cells": cells,
        "resolution": resolution,
        "seconds_per_sweep": seconds,
        "microseconds_per_cell": 1e6 * seconds / cells,
        "until_first_sweep_seconds": first[0],  # with compilation
        "compile_seconds": first[1],
        "rounds": records[-1].rounds,
        "collisions_per_move": float(np.mean([record.collisions for record in records[1:]])) / cells,
        "largest_drift": max(record.drift for record in records),
        "energies": [records[0].energy / cells, records[-1].energy / cells],
        "peak_memory_mb": common.peak_memory_mb(),
        "memory_before_mb": before,
    }


def main() -> None:
    """Run every size, print a table, write the JSON."""
    parser = common.options((__doc__ or "").split("\n")[0], "scale")
    parser.add_argument("--cells", type=int, nargs="+", default=[500, 5000, 50000, 100000])
    parser.add_argument("--sweeps", type=int, default=2 * SPAN, help="timed sweeps, after a warm-up")
    parser.add_argument("--resolution", default="draft")
    parser.add_argument("--alone", action="store_true", help="run one size here and print what was found")
    arguments = parser.parse_args()
    rest = ["--sweeps", str(arguments.sweeps), "--resolution", arguments.resolution]
    if arguments.alone:
        print(json.dumps(run(arguments.cells[0], arguments.sweeps, arguments.resolution)))
        return
    rows: list[dict[str, Any]] = []
    heads = ("cells", "s a sweep", "us a cell", "to smallest", "rounds", "peak MB", "kB a cell")
    print(*(f"{head:>12}" for head in heads))
    for cells in arguments.cells:
        command = [sys.executable, __file__, "--alone", "--cells", str(cells), *rest]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{cells:12} failed: {(done.stderr.strip().splitlines() or ['killed'])[-1]}")
            continue
        row = json.loads(done.stdout.splitlines()[-1])
        row["to_smallest"] = row["microseconds_per_cell"] / (rows or [row])[0]["microseconds_per_cell"]
        row["kb_per_cell"] = 1024 * (row["peak_memory_mb"] - (rows or [row])[0]["peak_memory_mb"]) / cells
        rows.append(row)
        keys = ("seconds_per_sweep", "microseconds_per_cell", "to_smallest", "rounds", "peak_memory_mb")
        print(f"{cells:12}", *(f"{row[key]:12.4g}" for key in (*keys, "kb_per_cell")), flush=True)
    common.write(arguments.out, {"rows": rows})


if __name__ == "__main__":
    main()
