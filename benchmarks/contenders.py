"""Ways to measure a whole tissue, each timed when asked: by a process of its own, on every core or on one.

python benchmarks/contenders.py    reads requests and writes answers, one JSON object a line
"""

import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import common
import jax
import jax.numpy as jnp
import numpy as np

import jaxtissue as jt
from jaxtissue.compilation.fusion import options
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import plan_lines
from jaxtissue.neighbors.search import find_candidates

CASES = ("R_a = 1", "R_a = 5")
CALLS = 15  # timed in a row, about as long as the peer's three; their median is the answer
measure_sizes = jax.jit(  # and no survey
    lambda *arguments: measure_cells(*arguments)[0], compiler_options=options()
)


@cache
def tissue(case: str) -> tuple[np.ndarray, jt.Tube]:
    """Random tissue of 500 cells: of R_a = 5 the reference tube, of R_a = 1 one made here."""
    if case == CASES[0]:
        tube = jt.Tube(100.0, 1.0, 10.0)
        return np.asarray(tube.random_positions(jax.random.key(0), 500), np.float32), tube
    known = np.load(common.REFERENCES / "paper_Ra5.npz")
    place = np.stack([known["x"], known["theta"]], axis=-1).astype(np.float32)
    return place, jt.Tube(float(known["L"]), float(known["Ra"]), float(known["Rb"]))


def from_scratch(place: np.ndarray, tube: jt.Tube, size: jt.Resolution) -> jt.CellGeometry:
    """The cells, on lists found anew."""
    return jt.measure_tissue(place, tube, size, surfaces=False, refine=False)


def diagram(case: str, kind: str, size: Any) -> Callable[[], tuple[Any, Any]]:
    """A function that measures V and A (None where it can't) of every cell; its result may still be pending.

    `kept`: by a `CellMeasurer`, on its lists from before; `checked`: these checked first; `complete`: on the longer
    lists that `scratch` finds anew, all at a resolution. `voxels`: the nearest backbone of every voxel of
    about this width. `exact`: the exact path with so many samples.
    """
    place, tube = tissue(case)
    if kind == "exact":
        return lambda: jt.exact_cells(place, tube, size)[:2]
    positions = jnp.asarray(place)
    if kind == "voxels":
        middle = math.pi * (tube.apical_radius + tube.basal_radius)
        wall = tube.basal_radius - tube.apical_radius
        shape = [round(float(length) / size) for length in (tube.length, wall, middle)]
        points, volumes = jt.cylindrical_voxels(tube, (shape[0], shape[1], shape[2]))

        def count() -> tuple[Any, None]:
            labels, _ = jt.nearest_backbones(points, tube.embed(positions))
            return jt.label_volumes(labels[:, 0], volumes, len(place)), None

        return count
    size = jt.Resolution(*size)
    if kind == "complete":
        lines, sides = plan_lines(tube, len(place), size), jnp.asarray(find_candidates(place, tube))
        measure = partial(measure_sizes, positions, tube, lines, sides)
    elif kind == "scratch":
        measure = partial(from_scratch, place, tube, size)
    else:
        measurer = jt.CellMeasurer(tube, size)
        measurer.measure(place)
        measure = partial(measurer.measure, place, check=kind == "checked")

    def both() -> tuple[Any, Any]:
        cells = measure()
        return cells.volume, cells.lateral_area

    return both


@cache
def prepared(case: str, kind: str, size: Any) -> tuple[Callable[[], tuple[Any, Any]], dict[str, Any]]:
    """A contender after its first call, which compiles, and what that call found."""
    begin = time.perf_counter()
    run = diagram(case, kind, size)
    volume, area = jax.block_until_ready(run())
    first = time.perf_counter() - begin
    sizes = {"volume": np.asarray(volume, float).tolist()}
    if area is not None:
        sizes["lateral_area"] = np.asarray(area, float).tolist()
    return run, {"first_seconds": first, "sizes": sizes}


def answer(case: str, kind: str, size: Any) -> dict[str, Any]:
    """Median seconds of some warm calls, one where the first call took long, with what the first found."""
    run, found = prepared(case, kind, size)
    seconds = []
    for _ in range(1 if kind in ("exact", "voxels") else CALLS):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        seconds.append(time.perf_counter() - begin)
    return found | {"seconds": float(np.median(seconds))}


class Worker:
    """A process that answers requests: with a device for every core, or pinned to one."""

    def __init__(self, pinned: bool) -> None:
        command, cores = [sys.executable, __file__], 1 if pinned else os.cpu_count()
        if pinned:
            command = ["taskset", "-c", "0", *command]
        environment = os.environ | {"JAX_NUM_CPU_DEVICES": str(cores), "NPROC": "1"}
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self._process = subprocess.Popen(command, env=environment, **pipes)

    def ask(self, case: str, kind: str, size: Any) -> dict[str, Any]:
        """One answer. Raises `RuntimeError` where the process has ended."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(json.dumps([case, kind, size]) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the process that measures {kind} {size} has ended")
        return json.loads(line)

    def close(self) -> None:
        """Let the process end."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def workers() -> dict[str, Worker]:
    """One on the whole machine and, where `taskset` is, one on one core."""
    found = {"whole": Worker(False)}
    if shutil.which("taskset"):
        return found | {"one": Worker(True)}
    print("no taskset here: nothing is timed on one core")
    return found


def main() -> None:
    """Answer every line of the standard input."""
    for line in sys.stdin:
        case, kind, size = json.loads(line)
        print(json.dumps(answer(case, kind, tuple(size) if isinstance(size, list) else size)), flush=True)


if __name__ == "__main__":
    main()
