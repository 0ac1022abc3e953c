"""The waiting time for a result: all that `anneal` does beside its sweeps, and a map of 10^6 pixels.

`jaxtissue anneal` of the paper's tube, made longer for more cells, 100 sweeps at R_a = 5, each run in its own
process. The first fills a cache of compiled programs and of Python's bytecode, the others are timed: what is not
sweeps is the wall time of the whole command, imports included, less the seconds in sweeps.csv.
"""

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt
from jaxtissue.runs.surface_maps import label_surface

CELLS, SWEEPS, TURNS = (500, 5000, 50_000), 100, 3
PIXELS = (2000, 500)
OWN, SHARE = 5.0, 0.2  # the bar: so many seconds and so much of the sweeps' time


def anneal(cells: int, folder: Path, cache: Path) -> dict[str, float]:
    """Seconds of the whole command, of its sweeps and of the processor."""
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2"}
    environment |= {"PYTHONPYCACHEPREFIX": str(cache / "bytecode"), "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-m", "jaxtissue", "anneal", "--cells", str(cells), "--apical-radius", "5"]
    command += ["--length", str(cells / 5), "--sweeps", str(SWEEPS), "--out", str(folder), "--force"]
    begin, before = time.perf_counter(), os.times()
    subprocess.run(command, check=True, capture_output=True, env=environment)
    whole, after = time.perf_counter() - begin, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    with (folder / "sweeps.csv").open() as file:
        sweeps = sum(float(row["seconds"]) for row in csv.DictReader(file))
    return {"whole": whole, "sweeps": sweeps, "rest": whole - sweeps, "cpu": cpu}


def draw_map(cells: int) -> float:
    """Seconds for the cell of each of 10^6 pixels of a surface."""
    tube = jt.Tube(cells / 5, 5.0, 10.0)
    positions = np.asarray(tube.random_positions(jax.random.key(0), cells))
    taken = []
    for _ in range(TURNS):
        begin = time.perf_counter()
        label_surface(positions, tube, "basal", PIXELS)
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))


def main() -> None:
    """Time all sizes and write them with the bar."""
    parser = common.options(__doc__ or "", "time_to_result")
    parser.add_argument("--cells", type=int, nargs="+", default=CELLS, help="numbers of cells")
    parser.add_argument("--maps", action="store_true", help="time the maps only, and renew them in the file")
    arguments = parser.parse_args()
    if arguments.maps:
        known = json.loads(arguments.out.read_text())
        for cells, row in known["seconds"].items():
            row["map"] = draw_map(int(cells))
            print(cells, f"map {row['map']:.2f} s", flush=True)
        arguments.out.write_text(json.dumps(known | {"commit_of_maps": common.commit()}, indent=1) + "\n")
        return
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder, cache = Path(temporary) / "run", Path(temporary) / "cache"
        for cells in arguments.cells:
            turns = [anneal(cells, folder, cache) for _ in range(1 + (TURNS if cells < 50_000 else 1))]
            row = {name: float(np.median([turn[name] for turn in turns[1:]])) for name in turns[0]}
            row |= {"cold": turns[0]["whole"], "bar": OWN + SHARE * row["sweeps"], "map": draw_map(cells)}
            rows[str(cells)] = row
            print(cells, " ".join(f"{name} {seconds:.2f} s" for name, seconds in row.items()), flush=True)
    common.write(arguments.out, {"seconds": rows, "sweeps": SWEEPS, "pixels": PIXELS[0] * PIXELS[1]})


if __name__ == "__main__":
    main()
