"""What is left of a run that is killed, damaged or joined by another: all of it, or one line that tells.

Kills at random moments of a process's life after its imports, single bits flipped in every file of a run, of
one that was killed and of a grid, and commands beside a live one in its folder. Results are compared to the
byte, but for seconds. Commands are forked off or played in this process, which has all imported already.
With JAX_COMPILATION_CACHE_DIR set and JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 little is compiled.
"""

import contextlib
import csv
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import numpy as np

import jaxtissue.runs.annealing
from jaxtissue.cli.commands import main as command
from jaxtissue.runs.run_files import RESULTS
from jaxtissue.system.files import check_files, read_sealed
from jaxtissue.system.locks import NAME as LOCK

TUBE = ["--length", "12", "--apical-radius", "2", "--basal-radius", "4", "--cells", "30"]
SWEEPS = 203  # no whole number of spans: the rows at the end are not in the checkpoint
RUN = ["anneal", *TUBE, "--seed", "3", "--sweeps", str(SWEEPS)]
GRID = ["grid", *TUBE, "--seed", "3", "4", "--sweeps", "2"]
PICTURES = ("tissue.png", "scutoid.png")  # those beside RESULTS whose bytes are the same each time
COMPARED = ("initial_backbones.csv", "sweeps.csv", "backbones.csv", "cells.csv")
SHARES = {"whole": {"checkpoint.npz": 4.0, "sweeps.csv": 3.0}}  # of the flips; the others have 1
SHARES["killed"] = {"checkpoint.npz": 4.0, "sweeps.csv": 0.4}  # rows past the checkpoint are played again
SHARES["grid"] = {"table.csv": 0.2, "energy.png": 0.2}  # both are written anew each time
FINISHED_ANEW = 70  # every so many flips in a finished run it is to be finished again
Told = tuple[int | str, str]  # exit code, or "traceback", and stderr


def start(log: Path, *arguments: str) -> int:
    """Fork a process that plays a command; JAX must not have computed here. What it prints goes to `log`."""
    with warnings.catch_warnings(action="ignore"):  # JAX doubts all forks
        process = os.fork()
    if process:
        return process
    code = 1
    try:
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1), os.dup2(file, 2)
        code = command(arguments)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(code)


def wait(process: int) -> int:
    """The exit code of a process, minus the signal that killed it."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def tell(*arguments: str) -> Told:
    """What a command answers that is played here."""
    told = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(told):
        try:
            return command(arguments), told.getvalue()
        except SystemExit as error:
            return int(error.code or 0), told.getvalue()
        except BaseException:
            return "traceback", traceback.format_exc()


def content(path: Path) -> Any:
    """What is compared of a file: its bytes, of tables all but the seconds."""
    if path.name not in ("sweeps.csv", "table.csv"):
        return path.read_bytes()
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    at = header.index("seconds") if "seconds" in header else len(header)
    return [row[:at] + row[at + 1 :] for row in (header, *rows)]


def same(folder: Path, whole: Path, names: tuple[str, ...] | list[str]) -> bool:
    """Whether the named files are there and the same in two folders."""
    try:
        return all(content(folder / name) == content(whole / name) for name in names)
    except (OSError, ValueError):
        return False


def moment(folder: Path) -> str:
    """Where a killed run had come to."""
    if not (folder / "checkpoint.npz").is_file():
        return "before a checkpoint"
    if read_sealed(folder / "manifest.json", "")["finished"]:
        return "finished"
    rows = (folder / "sweeps.csv").read_bytes().count(b"\n")
    return "drawing" if rows == SWEEPS + 2 else "annealing"


def kills(count: int, place: Path) -> dict[str, Any]:
    """Runs that are killed, and then resumed or, where there is no checkpoint yet, begun again."""
    run, whole = [*RUN, "--no-contacts"], place / "whole"
    begin = time.monotonic()
    assert wait(start(place / "log", *run, "--out", str(whole))) == 0
    life, rng = time.monotonic() - begin, np.random.default_rng(0)
    folders = [place / f"run{number}" for number in range(count)]
    moments_of_life = rng.permutation((np.arange(count) + rng.random(count)) / count)
    for folder, at in zip(folders, moments_of_life, strict=True):
        process = start(folder.with_suffix(".log"), *run, "--out", str(folder))
        time.sleep(life * at)
        os.kill(process, signal.SIGKILL)
        wait(process)
    jaxtissue.runs.annealing.save_figure = lambda *_: None  # they take most of the time, and are not compared
    moments: Counter[str] = Counter()
    results: Counter[str] = Counter({"same": 0, "silent": 0, "traceback": 0, "refused": 0})
    for folder in folders:
        moments[moment(folder)] += 1
        begun = (folder / "checkpoint.npz").is_file()
        told = tell("anneal", "--out", str(folder), "--resume")
        if not begun and told[0] == 2 and told[1].count("\n") == 1:
            told = tell(*run, "--out", str(folder), "--force")
        results[outcome(told, same(folder, whole, COMPARED))] += 1
    return {"kills": count, "life_seconds": life, "moments": moments, "results": results}


def outcome(told: Told, is_same: bool) -> str:
    """What became of a run that was to end as an undisturbed one."""
    if told[0] == 0:
        return "same" if is_same else "silent"
    print(told)
    return "traceback" if "Traceback" in told[1] else "refused"


def kill_after_checkpoint(folder: Path) -> None:
    """Leave in a folder what a run leaves that is killed some rows after its second checkpoint."""
    jaxtissue.runs.annealing.CHECKPOINT_SECONDS = 0.5  # or a short run has no second one before its end
    checkpoint, table = folder / "checkpoint.npz", folder / "sweeps.csv"
    process = start(folder.with_suffix(".log"), *RUN, "--out", str(folder))
    seen, rows = set(), SWEEPS
    while len(seen) < 2 or table.read_bytes().count(b"\n") < rows + 20:
        with contextlib.suppress(OSError):
            seen.add(checkpoint.stat().st_mtime_ns)
            rows = min(rows, table.read_bytes().count(b"\n")) if len(seen) == 2 else rows
        time.sleep(0.005)
    os.kill(process, signal.SIGKILL)
    assert wait(process) == -signal.SIGKILL and moment(folder) == "annealing"


def flips(count: int, place: Path) -> dict[str, Any]:
    """Single bits flipped in each file, and the command that would go on."""
    killed, whole, grid = (place / name for name in ("killed", "whole", "grid"))
    kill_after_checkpoint(killed)
    for done, arguments in ((whole, RUN), (grid, GRID)):
        assert tell(*arguments, "--out", str(done))[0] == 0
    results: dict[str, Counter[str]] = {}
    total: Counter[str] = Counter({"refused": 0, "rewritten": 0, "silent": 0, "traceback": 0})
    for folder, arguments, right, share in (
        (whole, ["anneal", "--resume"], whole, 0.5),
        (killed, ["anneal", "--resume"], whole, 0.35),
        (grid, GRID, grid, 0.15),
    ):
        paths = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != LOCK)
        paths = [path.relative_to(folder) for path in paths]
        shares = [SHARES[folder.name].get(path.name, 1.0) for path in paths]
        counts = np.diff(np.round(np.cumsum([0, *shares]) / sum(shares) * share * count)).astype(int)
        for path, some in zip(paths, counts, strict=True):
            trial = Trial(folder, right, path, arguments)
            found = Counter(trial.flip(number) for number in range(some))
            kind = path.parent / f"*{path.suffix}" if path.parent.name else path
            results.setdefault(f"{folder.name}/{kind}", Counter()).update(found)
            total.update(found)
            print(folder.name, path, dict(found), flush=True)
    return {"flips": total.total(), "results": total, "files": results}


class Trial:
    """A file whose bits are flipped, one at a time, in a copy of its folder."""

    def __init__(self, folder: Path, right: Path, path: Path, arguments: list[str]) -> None:
        self.folder, self.right, self.path, self.arguments = folder, right, path, arguments
        self.copy = folder.with_name("copy")
        self.rng = np.random.default_rng([len(folder.name), *str(path).encode()])
        names = (*RESULTS, *PICTURES) if right.name == "whole" else self._grid_names()
        self.names = [name for name in names if (right / name).is_file()]
        self._renew()

    def _grid_names(self) -> list[str]:
        return [
            "table.csv",
            "energy.png",
            *(f"backbones/{at.name}" for at in (self.right / "backbones").iterdir()),
        ]

    def _renew(self) -> None:
        shutil.rmtree(self.copy, ignore_errors=True)
        shutil.copytree(self.folder, self.copy)

    def flip(self, number: int) -> str:
        """Flip a bit and try the command; what became of it."""
        path, kept = self.copy / self.path, (self.folder / self.path).read_bytes()
        damaged = bytearray(kept)
        damaged[self.rng.integers(len(kept))] ^= 1 << int(self.rng.integers(8))
        path.write_bytes(damaged)
        again = ["--finish"] if self.folder.name == "whole" and number % FINISHED_ANEW == 0 else []
        told = tell(*self.arguments, "--out", str(self.copy), *again)
        result = self._judge(told, path, bytes(damaged))
        if result != "refused":
            self._renew()
        path.write_bytes(kept)
        if result in ("silent", "traceback"):
            print(self.folder.name, self.path, again, told, flush=True)
        return result

    def _judge(self, told: Told, path: Path, damaged: bytes) -> str:
        code, error = told
        if code == "traceback":
            return "traceback"
        if code != 0:
            is_told = error.count("\n") == 1 and path.name in error and path.read_bytes() == damaged
            return "refused" if is_told else "silent"
        if path.read_bytes() == damaged or not same(self.copy, self.right, self.names):
            return "silent"
        if self.arguments[0] == "anneal":
            check_files(self.copy, read_sealed(self.copy / "manifest.json", "")["files"], "")
        return "rewritten"


def two_runs(count: int, place: Path) -> dict[str, Any]:
    """Pairs of runs begun at once in one folder, and other commands beside a live run."""
    whole, folder = place / "whole", place / "beside"
    pairs = []
    for number in range(count):
        pair, logs = place / f"pair{number}", [place / f"log{number}{which}" for which in "ab"]
        codes = [wait(process) for process in [start(log, *RUN, "--out", str(pair)) for log in logs]]
        lines = [log.read_text() for log, code in zip(logs, codes, strict=True) if code == 2]
        is_told = [text.count("\n") for text in lines] == [1] and "Traceback" not in lines[0]
        pairs.append((pair, sorted(codes) == [0, 2] and is_told))
    first = start(place / "log", *RUN, "--out", str(folder))
    while not (folder / "checkpoint.npz").is_file():
        time.sleep(0.01)
    beside: Counter[str] = Counter()
    for more in ([], ["--force"], ["--resume"], ["--resume", "--finish"]):
        begin = ["anneal"] if "--resume" in more else RUN
        code, error = tell(*begin, "--out", str(folder), *more)
        beside["refused" if code == 2 and error.count("\n") == 1 else f"{more}: {code}"] += 1
    ended = wait(first) == 0
    assert tell(*RUN, "--out", str(whole))[0] == 0
    names = [name for name in RESULTS if (whole / name).is_file()]
    good = sum(is_told and same(pair, whole, names) for pair, is_told in pairs)
    undisturbed = ended and same(folder, whole, names)
    return {"pairs": count, "second_refused": good, "beside": beside, "first_undisturbed": undisturbed}


PARTS: dict[str, tuple[Callable[[int, Path], dict[str, Any]], int]] = {
    "kills": (kills, 50), "flips": (flips, 4000), "two_runs": (two_runs, 2)
}  # fmt: skip


def main() -> None:
    """Run every part in a process of its own, print what it found, write the JSON."""
    parser = common.options((__doc__ or "").split("\n")[0], "robustness")
    parser.add_argument("--alone", choices=PARTS, help="run one part here and print what was found")
    for name, (_, count) in PARTS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=count, help=f"{count} unless given")
    arguments = parser.parse_args()
    if arguments.alone:
        with tempfile.TemporaryDirectory() as place:
            print(json.dumps(PARTS[arguments.alone][0](getattr(arguments, arguments.alone), Path(place))))
        return
    found = {}
    for name in PARTS:
        count = str(getattr(arguments, name))
        run = [sys.executable, __file__, "--alone", name, f"--{name.replace('_', '-')}", count]
        done = subprocess.run(run, stdout=subprocess.PIPE, text=True, check=True)
        found[name] = json.loads(done.stdout.splitlines()[-1])
        print(name, json.dumps(found[name], indent=1), flush=True)
        common.write(arguments.out, found)


if __name__ == "__main__":
    main()
