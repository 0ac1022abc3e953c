"""A grid annealed into one table, in a folder: each row kept as it ends, and only what is missing done."""

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from jaxtissue import io
from jaxtissue.batches import Outcome, anneal_batch, batches, summarize, usual_batch
from jaxtissue.cluster import Part
from jaxtissue.files import check_folder, make_folder, replacing, write_json
from jaxtissue.grids import Grid, describe
from jaxtissue.memory import tell_memory
from jaxtissue.plot import plot_grid
from jaxtissue.records import SweepRecord
from jaxtissue.settings import Settings, now, provenance
from jaxtissue.stopping import Stop

FILES = ("manifest.json", "table.csv", "energy.png")
FOLDERS = ("rows", "backbones")
SECONDS = 0.5  # between looks for the rows of other processes


@dataclass
class GridRun:
    """A grid under way: its folder, its rows, and which of them are this process's."""

    folder: Path
    grid: Grid
    part: Part
    rows: list[Settings]
    stop: Stop

    def path(self, number: int, kind: str, ending: str) -> Path:
        """The file of a row."""
        return self.folder / kind / f"{number:05d}.{ending}"

    def missing(self, numbers: Sequence[int]) -> list[int]:
        """Those of the rows that are not done."""
        done = {path.name for path in (self.folder / "rows").iterdir()}
        return [number for number in numbers if f"{number:05d}.json" not in done]

    def store(self, number: int, outcome: Outcome) -> None:
        """Write a row's backbones, and then the row, by which it is done."""
        row = self.rows[number]
        io.write_backbones(self.path(number, "backbones", "csv"), outcome.positions)
        values = {"row": number} | describe(row) | summarize(row, outcome)
        write_json(self.path(number, "rows", "json"), values)


def run_grid(folder: Path, grid: Grid, part: Part, force: bool = False, batch: int | None = None) -> int:
    """Anneal a part of the rows of a grid that are not done in `folder`, and return the exit code.

    It is 128 + signal for a run that was stopped. Raises `ValueError` for a folder that holds something else
    or a grid with other arguments (unless forced) or can't be written; nothing is written then.
    """
    if force and part.count > 1 and not part.joined:
        raise ValueError("--force would remove what other parts have done; remove the folder instead")
    check_grid_folder(folder, grid, force)
    if part.number == 0 or not part.joined:
        _prepare(folder, grid, force)
    part.wait("prepared")
    rows = grid.rows
    with Stop() as stop:
        run = GridRun(folder, grid, part, rows, stop)
        mine = part.share(range(len(rows)))
        missing = run.missing(mine)
        _say(f"{len(rows)} rows in {folder}; {len(mine) - len(missing)} of this part's {len(mine)} are done")
        batch = batch or usual_batch()
        if missing:
            _say(_memory([rows[number] for number in missing], batch))
        if _anneal(run, missing, batch) and (not part.joined or _await_others(run)):
            return _finish(run)
    assert stop.signal is not None
    _say(f"stopped by {stop.signal.name}; what is done is kept, and the same command goes on")
    return 128 + stop.signal


def _memory(rows: Sequence[Settings], batch: int) -> str:
    """What the largest rows will take together."""
    largest = max(rows, key=lambda row: row.cells)
    float_bytes, count = 8 if largest.x64 else 4, min(batch, len(rows))
    return tell_memory(largest.cells, largest.tube, largest.resolution, float_bytes, count)


def check_grid_folder(folder: Path, grid: Grid, force: bool) -> None:
    """Raise `ValueError` unless `folder` is new, or this grid's, or may be written over; touches nothing."""
    manifest = folder / "manifest.json"
    if force or not folder.is_dir():
        return check_folder(folder, force=True)  # another part may just make it
    if not manifest.is_file():
        known = {"", "manifest", *FOLDERS}  # a folder that another part has just made
        return check_folder(folder, force={path.name.split(".")[0] for path in folder.iterdir()} <= known)
    try:
        before, given = json.loads(manifest.read_text(encoding="utf-8"))["arguments"], grid.arguments
        names = list(before | given)
    except (OSError, ValueError, KeyError, TypeError) as error:
        message = f"{manifest} is of no grid or damaged ({error}); choose another folder or add --force"
        raise ValueError(message) from error
    for name in names:
        if before.get(name) != given.get(name):
            option, values = "--" + name.replace("_", "-"), (given.get(name), before.get(name))
            told = " differs from ".join(_told(value) for value in values)
            raise ValueError(f"{option} {told} of the grid in {folder}; choose another folder or add --force")
    return None


def _told(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return "(not given)" if value is None else str(value)


def _prepare(folder: Path, grid: Grid, force: bool) -> None:
    """The folder with its manifest; of a grid that is forced, without the old rows."""
    make_folder(folder, FILES if force else ())
    for name in FOLDERS:
        known = list((folder / name).iterdir()) if force and (folder / name).is_dir() else []
        make_folder(folder / name, [path.name for path in known if path.stem.isdigit()])
    if not (folder / "manifest.json").is_file():
        manifest = {"arguments": grid.arguments, "rows": len(grid.rows)} | provenance()
        write_json(folder / "manifest.json", manifest | {"finished": None})


def _anneal(run: GridRun, missing: list[int], size: int) -> bool:
    """Anneal the missing rows, batch by batch; whether that came to its end."""
    slots = min(size, len(run.rows))  # so that going on needs no other program
    sweeps = run.rows[0].sweeps
    bar = tqdm(total=len(missing) * sweeps, desc="compiling", unit="sweep", disable=None)
    with bar:
        for batch in batches([(number, run.rows[number]) for number in missing], size):
            before = bar.n

            def go_on(records: list[SweepRecord], before: float = before) -> bool:
                bar.set_description("annealing" if records[0].sweep else "compiling", refresh=False)
                bar.update(before + len(records) * records[0].sweep - bar.n)
                return run.stop.signal is None

            outcomes = anneal_batch([row for _, row in batch], slots, go_on)
            if outcomes is None:
                return False
            for (number, _), outcome in zip(batch, outcomes, strict=True):
                run.store(number, outcome)
            bar.update(before + len(batch) * sweeps - bar.n)
            done = len(run.rows) - len(run.missing(range(len(run.rows))))
            _say(f"{done} of {len(run.rows)} rows done")
            if run.stop.signal:
                return False
    return True


def _await_others(run: GridRun) -> bool:
    """Wait until the rows of all processes are there, as long as nobody stops this one."""
    while run.missing(range(len(run.rows))):
        if run.stop.signal:
            return False
        time.sleep(SECONDS)
    return True


def _finish(run: GridRun) -> int:
    """Gather the rows that are there into the table; of processes that are joined, the first one does."""
    if run.part.joined and run.part.number:
        return 0
    everyone = range(len(run.rows))
    table = _gather(run)
    while (written := len(table.get("row", ()))) < len(everyone) - len(run.missing(everyone)):
        table = _gather(run)  # another part has added a row
    if written == len(everyone):
        manifest = json.loads((run.folder / "manifest.json").read_text(encoding="utf-8"))
        if not manifest["finished"]:
            write_json(run.folder / "manifest.json", manifest | {"finished": now()})
        figure, _ = plot_grid(table, [name for name in run.grid.axes if len(run.grid.axes[name]) > 1])
        with replacing(run.folder / "energy.png", "wb") as file:
            figure.savefig(file, format="png", dpi=150)
    print(f"rows             {written} of {len(everyone)}")
    print(f"written to       {run.folder / 'table.csv'}")
    return 0


def _gather(run: GridRun) -> dict[str, np.ndarray]:
    """Write the table of the rows that are done, and return it."""
    everyone = range(len(run.rows))
    done = sorted(set(everyone) - set(run.missing(everyone)))
    rows = [json.loads(run.path(number, "rows", "json").read_text(encoding="utf-8")) for number in done]
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name) for row in rows] for name in names}
    table = {
        name: np.array([math.nan if value is None else value for value in values])
        for name, values in columns.items()
    }
    io.write_table(run.folder / "table.csv", table)
    return table


def _say(text: str) -> None:
    tqdm.write(text, file=sys.stderr)
