"""What the benchmarks share: where results go, and what they were taken with."""

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from jaxtissue.settings import provenance

HERE = Path(__file__).resolve().parent
REFERENCES = HERE.parent / "tests" / "data"


def output(description: str, name: str) -> Path:
    """The file that the command line asks for, by default in `benchmarks/results`."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--out", type=Path, default=HERE / "results" / f"{name}.json", help="JSON file to write"
    )
    return parser.parse_args().out


def write(path: Path, results: dict[str, Any]) -> None:
    """Write results with what they were taken with."""
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=HERE, capture_output=True, text=True, check=False
    ).stdout.strip()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(provenance() | {"commit": commit} | results, indent=1) + "\n")
    print(f"wrote {path}")


def rms(measured: Any, exact: np.ndarray) -> float:
    """Root mean square error over cells, relative to the mean cell (absolute where that is 0)."""
    error = np.sqrt(np.mean((np.asarray(measured, float) - exact) ** 2))
    return float(error / exact.mean()) if exact.mean() > 0 else float(error)
