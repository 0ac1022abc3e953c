"""What every allowed set of versions computes alike: `python tests/smoke.py OUT.json [PINNED.json]`.

Runs the commands on a small tissue, writes their tables to OUT.json, and compares them with those that the
pinned versions wrote to PINNED.json.
"""

import csv
import json
import math
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import jax

from jaxtissue.cli.commands import main
from jaxtissue.runs.settings import versions

CLOSE = 1e-5  # of each number, or of 1 where it is smaller; sets of versions were seen to differ by 1.1e-6
TUBE = ("--length", "12", "--apical-radius", "2", "--basal-radius", "4")
Columns = dict[str, list[str]]


def run(*line: object) -> None:
    """Run a command, without what it says unless it fails."""
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = main([str(word) for word in line])
    if code:
        sys.exit(f"{said.getvalue()}exit code {code} of: jaxtissue {' '.join(map(str, line))}")


def tables(folder: Path) -> Iterator[Path]:
    """Run each command in `folder`, and give the tables that it leaves there."""
    for precision in ("float32", "x64"):
        more = ("--x64",) if precision == "x64" else ()
        whole, parts, sizes = (folder / precision / name for name in ("anneal", "resume", "measure"))
        anneal = ("anneal", *TUBE, "--cells", 24, "--seed", 3, "--flat", *more, "--out")
        run(*anneal, whole, "--sweeps", 10)
        run(*anneal, parts, "--sweeps", 5)
        run("anneal", "--out", parts, "--resume", "--sweeps", 10, "--flat")
        if (whole / "backbones.csv").read_bytes() != (parts / "backbones.csv").read_bytes():
            sys.exit(f"a resumed run in {precision} ends elsewhere than one that was never stopped")
        run("measure", whole / "initial_backbones.csv", *TUBE, "--flat", "--out", sizes, *more)
        yield from (*sorted(whole.glob("*.csv")), *sorted(sizes.glob("*.csv")))
    yield from slab(folder / "slab")
    errors, grid = folder / "compare", folder / "grid"
    run("compare", folder / "x64" / "anneal" / "initial_backbones.csv", *TUBE, "--x64", "--out", errors)
    yield errors / "compare.csv"
    axes = ("--ratio", 1.5, 3, "--basal-radius", 4)
    run("grid", "--length", 12, *axes, "--cells", 24, "--sweeps", 5, "--x64", "--out", grid)
    yield grid / "table.csv"


def slab(folder: Path) -> Iterator[Path]:
    """Measure a tissue on a domain that is no tube: its cells and walls, compiled quickly."""
    folder.mkdir()
    shape = {"shape": "slab", "width": 6, "depth": 4, "thickness": 1}
    (folder / "domain.json").write_text(json.dumps(shape), encoding="utf-8")
    draw = random.Random(1)
    rows = [f"{x + draw.uniform(0.2, 0.8)},{y + draw.uniform(0.2, 0.8)}" for x in range(6) for y in range(4)]
    (folder / "backbones.csv").write_text("\n".join(["x,y", *rows]), encoding="utf-8")
    jax.config.update("jax_disable_most_optimizations", True)
    files = (folder / "backbones.csv", "--domain", folder / "domain.json", "--out", folder / "measured")
    run("measure", *files, "--resolution", "draft", "--x64")
    jax.config.update("jax_disable_most_optimizations", False)
    yield from sorted((folder / "measured").glob("*.csv"))


def read_columns(path: Path, folder: Path) -> Columns:
    """The columns of a table, each with the name of the table, but for those that a clock filled."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    columns = {name: [row[place] for row in rows] for place, name in enumerate(header)}
    where = path.relative_to(folder).as_posix()
    return {f"{where}: {name}": cells for name, cells in columns.items() if not name.endswith("seconds")}


def difference(found: str, wanted: str) -> float:
    """How far two cells of a table are apart, relative to the wanted one or to 1; infinite for a word."""
    try:
        ours, theirs = float(found), float(wanted)
    except ValueError:
        return 0.0 if found == wanted else math.inf
    if ours == theirs or (math.isnan(ours) and math.isnan(theirs)):
        return 0.0
    off = abs(ours - theirs) / max(abs(theirs), 1)
    return math.inf if math.isnan(off) else off


def differences(found: Columns, wanted: Columns) -> dict[str, float]:
    """The largest difference in each column, infinite where it is missing or of another length."""
    off = dict.fromkeys(found.keys() ^ wanted.keys(), math.inf)
    for name in found.keys() & wanted.keys():
        pairs = list(zip(found[name], wanted[name], strict=False))
        alike = len(found[name]) == len(wanted[name])
        off[name] = max((difference(*pair) for pair in pairs), default=0.0) if alike else math.inf
    return off


def smoke(out: Path, pinned: Path | None) -> None:
    """Run all, and end with what is too far off the pinned versions' tables."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        ours = {name: cells for path in tables(folder) for name, cells in read_columns(path, folder).items()}
    out.write_text(json.dumps(ours), encoding="utf-8")
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    print(f"{used}: {time.perf_counter() - begin:.0f} s")
    if pinned:
        off = differences(ours, json.loads(pinned.read_text(encoding="utf-8")))
        worst = max(off, key=lambda name: off[name])
        print(f"{len(off)} columns, at most {off[worst]:.1e} off the pinned versions, in {worst}")
        if far := [f"{name} is {error:.1e} off" for name, error in off.items() if error > CLOSE]:
            sys.exit("\n".join(far))


if __name__ == "__main__":
    smoke(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
