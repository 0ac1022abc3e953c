"""What the benchmarks share: where results go, what they were taken with, true sizes, memory."""

import argparse
import json
import os
import resource
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxtissue as jt
from jaxtissue.runs.settings import processor, provenance

HERE = Path(__file__).resolve().parent
REFERENCES = HERE.parent / "tests" / "data"
BARS = {"coarse": (0.005, 0.03), "close": (0.0007, 0.01)}  # errors V and A at which programs are compared


def options(description: str, name: str, peer: bool = False) -> argparse.ArgumentParser:
    """The options that benchmarks have in common."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, default=HERE / "results" / f"{name}.json", help="JSON file to write")
    if peer:
        parser.add_argument("--peer", type=Path, help="folder of the C++ peer's programs, `peer`, `peer_incr`")
    return parser


def output(description: str, name: str) -> Path:
    """The file that the command line asks for, by default in `benchmarks/results`."""
    return options(description, name).parse_args().out


def write(path: Path, results: dict[str, Any]) -> None:
    """Write results with what they were taken with."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made_by = provenance() | {"processor": f"{processor()}, {os.cpu_count()} cores", "commit": commit()}
    path.write_text(json.dumps(made_by | results, indent=1) + "\n")
    print(f"wrote {path}")


def commit() -> str:
    """The commit of this checkout, with "-dirty" where code is not as committed; nothing outside of one."""

    def git(*arguments: str) -> str:
        command = ["git", *arguments]
        return subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False).stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "--", "*.py", "../src")
    return git("rev-parse", "HEAD") + ("-dirty" if changed else "")


def rms(measured: Any, exact: np.ndarray) -> float:
    """Root mean square error over cells, relative to the mean cell (absolute where that is 0)."""
    error = np.sqrt(np.mean((np.asarray(measured, float) - exact) ** 2))
    return float(error / exact.mean()) if exact.mean() > 0 else float(error)


def peak_memory_mb() -> float:
    """The most memory this process has held; of its parent's, nothing."""
    status = Path("/proc/self/status")
    if status.is_file():
        (line,) = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Truth(NamedTuple):
    """True sizes of the cells in the middle of a tube, all if there are few."""

    cells: np.ndarray
    volume: np.ndarray
    lateral_area: np.ndarray

    def errors(self, volume: Any, lateral_area: Any) -> tuple[float, float]:
        """Errors of V and A, rms over these cells / their mean."""
        measured = (np.asarray(sizes)[self.cells] for sizes in (volume, lateral_area))
        first, second = map(rms, measured, (self.volume, self.lateral_area))
        return first, second


def true_sizes(place: np.ndarray, tube: jt.Tube, samples: int = 100, most: int = 1000) -> Truth:
    """Sizes by the exact path; its V is off by 2e-6 of the mean cell and A by less than 1e-4 at n = 500.

    Of more than `most` cells half as many are measured, in the middle of the tube, among all backbones within
    two covering radii of them: no other can bound their cells.
    """
    place = np.asarray(place, float)
    aside = np.abs(place[:, 0] - float(tube.length) / 2)
    cells = np.arange(len(place))
    if len(place) > most:
        cells = np.sort(np.argsort(aside)[: most // 2])
    halo = 2.2 * float(jt.covering_radius(jnp.asarray(place), tube))  # a tenth more, for sampling phi
    near = np.flatnonzero(aside <= aside[cells].max() + halo)
    exact = jt.exact_cells(place[near], tube, samples)
    at = np.searchsorted(near, cells)
    return Truth(cells, exact.volume[at], exact.lateral_area[at])
