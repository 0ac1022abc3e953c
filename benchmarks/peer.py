"""The C++ peer where it is built: CGAL on sampled backbones, whole diagrams, IS-MH and incremental MH."""

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxtissue as jt

RULE = ("--rule", "hop2", "--order", "degree", "--skip", "1")  # the paper's round counts, no idle diagram


class Diagram(NamedTuple):
    """A whole diagram by the peer."""

    seconds: float
    volume: np.ndarray
    lateral_area: np.ndarray


class Sweeps(NamedTuple):
    """Sweeps by the peer. `energy` is by its own measure, of the tissue after `played` whole sweeps."""

    seconds: float  # of one
    played: int  # 0: the seconds are extrapolated from a part of one
    energy: float | None
    positions: np.ndarray | None  # incremental MH does not tell them


class Peer:
    """Runs the peer's programs in `folder`, on one thread, and reads what they tell."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def diagram(self, place: np.ndarray, tube: jt.Tube, samples: int, repeats: int = 3) -> Diagram:
        """V and A of every cell; seconds are the median of some repeats, without reading and writing."""
        (row,), table = self._run("peer", "eval", place, tube, samples, "--reps", repeats)
        assert table is not None
        return Diagram(row["t_median"], table[:, 2], table[:, 3])

    def is_mh(self, place: np.ndarray, tube: jt.Tube, samples: int, sweeps: int, budget: float) -> Sweeps:
        """IS-MH with a whole diagram before and after each decision, the paper's way.

        As many sweeps as fit the budget of seconds; where not one does, it takes two diagrams a round.
        """
        rounds = self._run("peer", "rounds", place, tube, 4)[0][0]["hop2"]["degree"]
        estimate = 2 * rounds * self.diagram(place, tube, samples, 1).seconds
        sweeps = min(sweeps, int(budget / estimate))
        if not sweeps:
            return Sweeps(estimate, 0, None, None)
        rows, table = self._run("peer", "ismh", place, tube, samples, *RULE, "--steps", sweeps)
        assert table is not None
        seconds = float(np.median([row["t_step"] for row in rows[1:]]))
        return Sweeps(seconds, sweeps, rows[-1]["E_per_cell"] * len(place), table[:, :2])

    def mh(self, place: np.ndarray, tube: jt.Tube, samples: int, sweeps: int, budget: float) -> Sweeps:
        """Incremental MH: as many moves as fit the budget of seconds, at least a part of a sweep."""
        n = len(place)
        trial = self._mh(place, tube, samples, n, min(budget, 5.0))
        if trial["moves"] < n:
            trial = self._mh(place, tube, samples, n, budget)
        sweeps = min(sweeps, int(budget / trial["t_step"]))
        if trial["moves"] < n:
            return Sweeps(trial["t_step"], 0, None, None)
        row = self._mh(place, tube, samples, sweeps * n, 10 * budget) if sweeps > 1 else trial
        return Sweeps(row["t_step"], row["moves"] // n, row["E_per_cell_after"] * n, None)

    def _mh(self, place: np.ndarray, tube: jt.Tube, samples: int, moves: int, budget: float) -> dict[str, Any]:
        extra = ("--variant", 1, "--verify", 0, "--moves", moves, "--budget", budget)
        return self._run("peer_incr", "mh", place, tube, samples, *extra)[0][0]

    def _run(
        self, program: str, mode: str, place: np.ndarray, tube: jt.Tube, samples: int, *extra: Any
    ) -> tuple[list[dict[str, Any]], np.ndarray | None]:
        """The lines that a program prints, and the table of backbones (x, angle, V, A, ...) it leaves."""
        with tempfile.TemporaryDirectory() as folder:
            given, left = Path(folder) / "in", Path(folder) / "out"
            np.savetxt(given, np.asarray(place, float), fmt="%.17g")
            sizes = {"L": tube.length, "Ra": tube.apical_radius, "Rb": tube.basal_radius, "s": samples}
            command = [self.folder / program, mode, "--par", 0, "--threads", 1, "--in", given, "--dump", left]
            command += [word for name, size in sizes.items() for word in (f"--{name}", size)]
            words = [str(word) for word in (*command, *extra)]
            printed = subprocess.run(words, check=True, capture_output=True, text=True).stdout
            return [json.loads(line) for line in printed.splitlines()], (
                np.loadtxt(left, ndmin=2) if left.is_file() else None
            )


def find_peer(folder: Path | None) -> Peer | None:
    """The peer in a folder, or None, said aloud: what follows does without."""
    if folder and (folder / "peer").is_file() and (folder / "peer_incr").is_file():
        return Peer(folder)
    print(f"no C++ peer in {folder}: only ours is measured" if folder else "no --peer given: only ours is measured")
    return None
