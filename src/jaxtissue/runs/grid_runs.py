"""A grid annealed into one table in a folder: rows are saved when they are finished, and missing rows computed."""

import math
import re
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from jaxtissue.dynamics.memory import tell_memory
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.runs import storage
from jaxtissue.runs.batches import Outcome, anneal_batch, batches, summarize, usual_batch
from jaxtissue.runs.distributed import Part
from jaxtissue.runs.grids import Grid, describe
from jaxtissue.runs.plots import plot_grid, save_figure
from jaxtissue.runs.settings import FORMAT, Settings, now, other_bits, provenance
from jaxtissue.system.files import (
    check_files,
    check_folder,
    checksum,
    make_folder,
    make_subfolder,
    read_sealed,
    remove_leftovers,
    write_sealed,
)
from jaxtissue.system.locks import alone, together
from jaxtissue.system.signals import Stop

FILES = ("manifest.json", "table.csv", "energy.png")
FOLDERS = ("rows", "backbones")
SECONDS = 0.5  # between looks for the rows of other processes


@dataclass
class GridRun:
    """A grid under way: its folder, its rows and their names, and which of them are this process's."""

    folder: Path
    grid: Grid
    part: Part
    rows: list[Settings]
    stop: Stop

    identities: list[str]

    def path(self, number: int, kind: str, ending: str) -> Path:
        """The file of a row."""
        return self.folder / kind / f"{self.identities[number]}.{ending}"

    def missing(self, numbers: Sequence[int]) -> list[int]:
        """Those of the rows that are not done."""
        done = {path.name for path in (self.folder / "rows").iterdir()}
        return [number for number in numbers if f"{self.identities[number]}.json" not in done]

    def store(self, number: int, outcome: Outcome) -> None:
        """Write a row's backbones, and then the row, by which it is done."""
        row, backbones = self.rows[number], self.path(number, "backbones", "csv")
        storage.write_backbones(backbones, outcome.positions, columns=column_names(row.place))
        values = describe(row) | summarize(row, outcome) | {"backbones": backbones.name}
        kept = {"row": values, "files": {f"backbones/{backbones.name}": checksum(backbones)}}
        write_sealed(self.path(number, "rows", "json"), kept)

    def load(self, number: int) -> dict[str, Any]:
        """A row that is done. Raises `ValueError` where a bit of it, or of its backbones, has changed."""
        path = self.path(number, "rows", "json")
        remedy = f"remove {path} and repeat the command to anneal this row again"
        kept = read_sealed(path, remedy)
        check_files(self.folder, kept["files"], remedy)
        return {"row": number} | kept["row"]


def run_grid(folder: Path, grid: Grid, part: Part, force: bool = False, batch: int | None = None) -> int:
    """Anneal a part of the rows of a grid that are not done in `folder`, and return the exit code.

    It is 128 + signal for a run that was stopped. A folder with a grid of fewer values on some axes grows,
    and keeps its rows. Raises `ValueError` for a folder that holds something else or a grid that is no part
    of this one (unless forced), that is damaged or can't be written, and for a part that is under way
    already; nothing is written then.
    """
    if force and part.count > 1 and not part.joined:
        raise ValueError("--force would remove the results of other parts; remove the folder yourself instead")
    check_grid_folder(folder, grid, force)

    def prepare(is_alone: bool | None) -> None:
        if part.number == 0 or not part.joined:
            _prepare(folder, grid, force, is_alone)

    mine = f".part-{part.number + 1}-of-{part.count}.lock"
    if part.joined and part.number:
        part.wait("prepared")
    with Stop() as stop, together(folder, prepare), alone(folder, mine, "this part of the grid"):
        if part.joined and not part.number:
            part.wait("prepared")
        return _go_on(GridRun(folder, grid, part, grid.rows, stop, grid.identities), batch or usual_batch())


def _go_on(run: GridRun, batch: int) -> int:
    """Anneal what is missing of this part, and gather what is there; the exit code."""
    everyone = range(len(run.rows))
    mine, missing = run.part.share(everyone), run.missing(everyone)
    for number in sorted(set(everyone) - set(missing)):
        run.load(number)  # what is damaged is told before hours are spent
    missing = [number for number in mine if number in set(missing)]
    done = f"{len(mine) - len(missing)} of {len(mine)} rows of this part are done"
    _say(f"the grid in {run.folder} has {len(run.rows)} rows; {done}")
    if missing and run.rows[0].domain is None:
        _say(_memory([run.rows[number] for number in missing], batch))
    if _anneal(run, missing, batch) and (not run.part.joined or _await_others(run)):
        return _finish(run)
    assert run.stop.signal is not None
    _say(f"stopped by {run.stop.signal.name}; finished rows are saved; repeat the command to continue")
    return 128 + run.stop.signal


def _memory(rows: Sequence[Settings], batch: int) -> str:
    """The memory that the largest rows will take together."""
    largest = max(rows, key=lambda row: row.cells)
    float_bytes, count = 8 if largest.x64 else 4, min(batch, len(rows))
    return tell_memory(largest.cells, largest.tube, largest.resolution, float_bytes, count)


def check_grid_folder(folder: Path, grid: Grid, force: bool) -> list[str]:
    """The axes on which `grid` has more values than the one in `folder`; touches nothing.

    Raises `ValueError` unless the folder is new, or has a part of this grid, or may be written over.
    """
    manifest = folder / "manifest.json"
    if force or not folder.is_dir():
        check_folder(folder, force=True)  # another part may just make it
        return []
    if not manifest.is_file():
        known = {"", "manifest", *FOLDERS}  # a folder that another part has just made
        check_folder(folder, force={path.name.split(".")[0] for path in folder.iterdir()} <= known)
        return []
    remedy = "choose another folder or add --force"
    before = read_sealed(manifest, remedy)
    if before.get("format") != FORMAT or not isinstance(before.get("rows"), int):
        raise ValueError(f"{manifest} was written by another command or version; {remedy}")
    try:
        return grid.growth(before["arguments"])
    except ValueError as error:
        told = f"{error} of the grid in {folder}, to which values can only be added"
        raise ValueError(f"{told}; {remedy}") from error


def _prepare(folder: Path, grid: Grid, force: bool, is_alone: bool | None) -> None:
    """The folder with its manifest; of a grid that is forced, without the old rows."""
    path = folder / "manifest.json"
    grown, there = check_grid_folder(folder, grid, force), path.is_file()
    if (force or grown) and is_alone is False:
        change = "add values" if grown else "start again"
        raise ValueError(
            f"other processes are working on the grid in {folder}; wait until they have ended, then {change}"
        )
    make_folder(folder, FILES if force else ())
    for name in FOLDERS:
        make_subfolder(folder / name)
        if force:
            make_folder(folder / name, [old.name for old in (folder / name).iterdir() if _is_row(old)])
        if is_alone:
            remove_leftovers(folder / name)
    if is_alone:
        remove_leftovers(folder)
    kept = read_sealed(path, "") if there and not force else {"format": FORMAT, "grown": []} | provenance()
    if changes := other_bits(kept):
        _say(f"warning: round-off may differ from that of the existing rows: {changes}")
    if grown or not there or force:
        news = {"arguments": grid.arguments, "rows": len(grid.rows), "finished": None}
        more = [{"axes": grown} | provenance()] if grown else []
        write_sealed(path, kept | news | {"grown": kept["grown"] + more})


def _is_row(path: Path) -> bool:
    """Whether a file is that of a row, by its name."""
    return re.fullmatch(r"[0-9a-f]{16}\.(json|csv)", path.name) is not None


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
    """Wait until the rows of all processes are there, unless this process is stopped."""
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
        manifest = read_sealed(run.folder / "manifest.json", "start again with --force")
        if not manifest["finished"]:
            write_sealed(run.folder / "manifest.json", manifest | {"finished": now()})
        varied = [name for name in run.grid.axes if len(run.grid.axes[name]) > 1]
        save_figure(run.folder / "energy.png", lambda: plot_grid(table, varied))
    print(f"rows             {written} of {len(everyone)}")
    print(f"written to       {run.folder / 'table.csv'}")
    return 0


def _gather(run: GridRun) -> dict[str, np.ndarray]:
    """Write the table of the rows that are done, and return it."""
    everyone = range(len(run.rows))
    done = sorted(set(everyone) - set(run.missing(everyone)))
    rows = [run.load(number) for number in done]
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name) for row in rows] for name in names}
    table = {
        name: np.array([math.nan if value is None else value for value in values]) for name, values in columns.items()
    }
    storage.write_table(run.folder / "table.csv", table)
    return table


def _say(text: str) -> None:
    tqdm.write(text, file=sys.stderr)
