"""`jaxtissue grid`: rows as runs alone, shared by devices, processes and jobs; resumed, refused, drawn."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import quick
from known import known
from test_cli import column, read_table, without_seconds

import jaxtissue
from jaxtissue.cli.commands import main
from jaxtissue.runs import batches
from jaxtissue.runs.backbone_files import read_backbones
from jaxtissue.runs.batches import anneal_batch
from jaxtissue.runs.distributed import Part, slurm_part
from jaxtissue.runs.grids import Grid
from jaxtissue.runs.settings import Settings
from jaxtissue.system.files import read_sealed
from jaxtissue.system.locks import alone, together

pytestmark = pytest.mark.usefixtures("optimized", "coarse_pictures")

VALUES = ["--length", "12", "--basal-radius", "4", "--ratio", "2", "8", "--cells", "24"]
VALUES += ["--temperature", "0.5", "--seed", "0", "1", "--sweeps", "2"]
VALUES += ["--batch", "2"]  # one program for all
GRID = Grid(
    {"length": [12.0], "basal_radius": [4.0], "ratio": [2.0, 8.0], "cells": [24], "temperature": [0.5],
     "seed": [0, 1]},
    {"sweeps": 2},
)  # fmt: skip


def start(folder: Path, *more: str, devices: int = 1) -> subprocess.Popen:
    """The command in a process of its own that sees so many devices."""
    path = os.pathsep.join([str(Path(jaxtissue.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        quick.command("grid", *VALUES, "--out", folder, *more),
        env=os.environ | {"PYTHONPATH": path, "JAX_NUM_CPU_DEVICES": str(devices)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(*running: subprocess.Popen) -> list[str]:
    """Wait for commands that should do well; what they print."""
    told = [run.communicate(timeout=400) for run in running]
    assert [run.returncode for run in running] == [0] * len(running), told
    return [out for out, _ in told]


@pytest.fixture(scope="module")
def whole(optimized, coarse_pictures, tmp_path_factory) -> Path:
    """The folder of a grid that ran through in one process."""
    folder = tmp_path_factory.mktemp("grids") / "whole"
    assert main(["grid", *VALUES, "--out", str(folder)]) == 0
    return folder


def same_grid(folder: Path, whole: Path) -> bool:
    """Whether two grids left the same, to the last byte but for the seconds."""
    names = sorted(path.name for path in (whole / "backbones").iterdir())
    assert without_seconds(folder / "table.csv") == without_seconds(whole / "table.csv")
    assert sorted(path.name for path in (folder / "backbones").iterdir()) == names
    return all(
        (folder / "backbones" / name).read_bytes() == (whole / "backbones" / name).read_bytes() for name in names
    )


def test_a_table_of_runs_with_manifest_backbones_and_picture(whole) -> None:
    table = read_table(whole / "table.csv")
    assert {path.name for path in whole.iterdir()} == {
        *("manifest.json", "table.csv", "energy.png", "rows", "backbones")
    }
    assert column(table, "row").tolist() == [0, 1, 2, 3]
    assert column(table, "ratio").tolist() == [2, 2, 8, 8] and column(table, "seed").tolist() == [0, 1, 0, 1]
    assert column(table, "apical_radius").tolist() == [2, 2, 0.5, 0.5]
    assert (column(table, "energy") < column(table, "initial_energy")).all()
    terms = column(table, "volume_energy") + column(table, "area_energy")
    np.testing.assert_allclose(column(table, "energy"), terms, rtol=1e-5)  # float32
    assert ((column(table, "acceptance") > 0) & (column(table, "acceptance") < 1)).all()
    assert (column(table, "drift") < 1e-5).all() and (column(table, "seconds") > 0).all()  # float32
    assert (column(table, "neighbors") > 3).all() and (column(table, "open_ends") == 0).all()
    assert column(table, "scutoid_fraction").max() > 0
    assert [row["backbones"] for row in table] == [f"{name}.csv" for name in GRID.identities]
    manifest = json.loads((whole / "manifest.json").read_text())
    assert manifest["arguments"]["seed"] == [0, 1] and manifest["arguments"]["tension"] == [0.4]
    assert manifest["rows"] == 4 and manifest["started"] <= manifest["finished"]
    assert manifest["versions"].keys() >= {"jaxtissue", "jax"} and manifest["dtype"] == "float32"


def test_a_row_is_the_run_of_its_settings_alone(whole) -> None:
    row = Settings(12.0, 0.5, 4.0, cells=24, seed=1, sweeps=2, temperature=0.5)
    assert GRID.rows[3] == row
    (outcome,) = known(anneal_batch([row], 2, lambda _: True))
    values = read_table(whole / "table.csv")[3]
    assert float(values["energy"]) == outcome.records[-1].energy
    assert float(values["initial_energy"]) == outcome.records[0].energy
    final = read_backbones(whole / "backbones" / values["backbones"], row.tube).positions
    np.testing.assert_array_equal(final.astype(np.float32), outcome.positions)


def test_two_devices_give_what_one_gives(whole, tmp_path) -> None:
    (told,) = finish(start(tmp_path / "two", devices=2))
    assert "4 of 4" in told
    assert same_grid(tmp_path / "two", whole)


def test_two_processes_give_what_one_gives(whole, tmp_path) -> None:
    folder = tmp_path / "joined"
    with socket.socket() as free:
        free.bind(("localhost", 0))
        place = f"localhost:{free.getsockname()[1]}"
    joined = ("--distributed", "--coordinator", place, "--process")
    first, second = finish(*(start(folder, *joined, f"{k}/2") for k in (1, 2)))
    assert "4 of 4" in first and "written" not in second  # one of them assembles the table
    assert same_grid(folder, whole)


def test_only_what_is_missing_is_done(whole, tmp_path, monkeypatch, capsys) -> None:
    folder, done = tmp_path / "parts", []

    def noted(rows, *others):
        done.extend((row.apical_radius, row.seed) for row in rows)
        return anneal_batch(rows, *others)

    monkeypatch.setattr("jaxtissue.runs.grid_runs.anneal_batch", noted)
    run = ["grid", *VALUES, "--out", str(folder)]
    assert main([*run, "--part", "2/2"]) == 0
    assert "2 of 4" in capsys.readouterr().out and done == [(2.0, 1), (0.5, 1)]
    assert json.loads((folder / "manifest.json").read_text())["finished"] is None
    assert len(read_table(folder / "table.csv")) == 2
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "8")
    monkeypatch.setenv("SLURM_ARRAY_TASK_MIN", "8")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    assert main([*run, "--slurm"]) == 0
    assert done[2:] == [(2.0, 0), (0.5, 0)] and same_grid(folder, whole)
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    assert main([*run, "--tension", "0.4"]) == 0  # the default, spelled out
    assert len(done) == 4 and {path: path.read_bytes() for path in folder.rglob("*.*")} == before
    (folder / "rows" / f"{GRID.identities[2]}.json").unlink()
    assert main(run) == 0
    assert done[4:] == [(0.5, 0)] and same_grid(folder, whole)


def test_a_signal_keeps_the_rows_that_are_done(whole, tmp_path, monkeypatch, capsys) -> None:
    number = signal.SIGTERM
    folder, advance, calls = tmp_path / "stopped", batches.advance_together, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 3:  # the first sweep of the second batch
            signal.raise_signal(number)
        return advance(*arguments)

    run = ["grid", *VALUES, "--out", str(folder)]
    with monkeypatch.context() as patch:
        patch.setattr(batches, "advance_together", interrupted)
        assert main(run) == 128 + number
    assert f"stopped by {number.name}" in capsys.readouterr().err
    done = {path.stem for path in (folder / "rows").iterdir()}
    assert done == set(GRID.identities[:2])
    assert main(run) == 0 and same_grid(folder, whole)


def test_contacts_can_be_left_out_and_force_begins_anew(tmp_path, capsys) -> None:
    folder = tmp_path / "grid"
    short = ["grid", "--length", "12", "--basal-radius", "4", "--apical-radius", "2", "--cells", "24"]
    short += ["--seed", "0", "1", "--sweeps", "1", "--batch", "2", "--out", str(folder)]
    assert main([*short, "--no-contacts"]) == 0
    assert "neighbors" not in read_table(folder / "table.csv")[0]
    capsys.readouterr()
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    for change, named in [
        (["--seed", "1"], "--seed 1 differs from 0 1"),
        ([], "--no-contacts False differs from True"),
        (["--no-contacts", "--sweeps", "2"], "--sweeps 2 differs from 1"),
        (["--no-contacts", "--x64"], "--x64 True differs from False"),
    ]:
        assert main([*short, *change]) == 2
        error = capsys.readouterr().err
        assert named in error and error.count("\n") == 1
        assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before
    (folder / "notes.txt").write_text("mine")
    assert main([*short, "--sweeps", "0", "--force"]) == 0
    row, *_ = read_table(folder / "table.csv")
    assert row["energy"] == row["initial_energy"] and "neighbors" in row and float(row["acceptance"]) == 0
    assert (folder / "notes.txt").read_text() == "mine"


BAD_ARGUMENTS = [
    ("", "--out"),
    ("--out {}", "is not empty"),
    ("--out {}/o --ratio 1", "--ratio: 1"),
    ("--out {}/o --ratio 2 --apical-radius 1", "remove one of them"),
    ("--out {}/o --apical-radius 1 10", "apical_radius=10.0"),
    ("--out {}/o --seed", "--seed"),
    ("--out {}/o --seed 1 2 1", "seed=1 is given twice"),
    ("--out {}/o --cells 10 0", "--cells: 0"),
    ("--out {}/o --temperature 1 nan", "--temperature: nan"),
    ("--out {}/o --temperature 0 1 --final-temperature 0.5", "--temperature above 0"),
    ("--out {}/o --sweeps 1 2", "unrecognized"),
    ("--out {}/o --batch 0", "--batch: 0"),
    ("--out {}/o --part 3/2", "'3/2'"),
    ("--out {}/o --part 0/2", "'0/2'"),
    ("--out {}/o --part 1/2 --force", "--force would remove"),
    ("--out {}/o --part 1/2 --slurm", "not allowed"),
    ("--out {}/o --slurm", "SLURM_ARRAY_TASK_ID"),
    ("--out {}/o --process 1/2", "--distributed"),
    ("--out {}/o --distributed --process 1/2", "--coordinator"),
    ("--out {}/o --minimum-contact 0.1 --no-contacts", "needs contacts"),
    ("--out {}/good.csv/o", "is not writable"),
]


@pytest.mark.parametrize(("line", "named"), BAD_ARGUMENTS, ids=[line for line, _ in BAD_ARGUMENTS])
def test_bad_input_gets_one_line_and_nothing_is_written(line, named, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.delenv("SLURM_ARRAY_TASK_ID", raising=False)
    (tmp_path / "good.csv").write_text("axial,angle\n1,0\n")
    assert main(["grid", *line.replace("{}", str(tmp_path)).split()]) == 2
    streams = capsys.readouterr()
    assert named in streams.err and streams.err.count("\n") == 1 and streams.out == ""
    assert [path.name for path in tmp_path.rglob("*")] == ["good.csv"]


def test_a_grid_grows_and_keeps_its_rows(whole, tmp_path, monkeypatch, capsys) -> None:
    folder, done = tmp_path / "grid", []

    def noted(rows, *others):
        done.extend((row.apical_radius, row.seed) for row in rows)
        return anneal_batch(rows, *others)

    monkeypatch.setattr("jaxtissue.runs.grid_runs.anneal_batch", noted)
    run = ["grid", *VALUES[:4], "--cells", "24", "--temperature", "0.5", "--sweeps", "2"]
    run += ["--batch", "2", "--out", str(folder)]
    assert main([*run, "--ratio", "8", "--seed", "0", "1"]) == 0
    more = [*run, "--ratio", "2", "8", "--seed", "0", "1"]
    with together(folder, lambda _: None):  # while another part is at work
        assert main(more) == 2 and "then add values" in capsys.readouterr().err
    assert main(more) == 0 and same_grid(folder, whole)
    assert done == [(0.5, 0), (0.5, 1), (2.0, 0), (2.0, 1)]
    manifest = read_sealed(folder / "manifest.json", "")
    assert manifest["rows"] == 4 and manifest["finished"] and manifest["grown"][0]["axes"] == ["ratio"]


def test_a_part_that_is_under_way_is_refused(whole, tmp_path, capsys) -> None:
    folder = shutil.copytree(whole, tmp_path / "grid")
    run = ["grid", *VALUES, "--out", str(folder)]
    with together(folder, lambda _: None), alone(folder, ".part-2-of-2.lock"):
        assert main([*run, "--part", "2/2"]) == 2 and "this part of the grid is" in capsys.readouterr().err
        assert main([*run, "--part", "1/2"]) == 0
        assert main([*run, "--force"]) == 2 and "other processes" in capsys.readouterr().err
    assert same_grid(folder, whole) and not list(folder.glob(".*"))


def test_a_flipped_bit_in_a_grid_is_told_in_one_line(whole, tmp_path, capsys) -> None:
    folder, rng = shutil.copytree(whole, tmp_path / "grid"), np.random.default_rng(0)
    paths = [folder / "manifest.json", *(folder / "rows").iterdir(), *(folder / "backbones").iterdir()]
    for path in paths:
        kept = path.read_bytes()
        for byte, bit in zip(rng.integers(len(kept), size=9), rng.integers(8, size=9), strict=True):
            damaged = bytearray(kept)
            damaged[byte] ^= 1 << bit
            path.write_bytes(damaged)
            assert main(["grid", *VALUES, "--out", str(folder)]) == 2
            error = capsys.readouterr().err
            assert "damaged" in error and path.name in error and error.count("\n") == 1
        path.write_bytes(kept)
    (folder / "rows").rename(tmp_path / "rows")
    (folder / "rows").symlink_to(tmp_path / "rows")
    assert main(["grid", *VALUES, "--out", str(folder)]) == 2
    assert "rows is a symbolic link" in capsys.readouterr().err


def test_a_damaged_manifest_is_told(tmp_path, capsys) -> None:
    folder = tmp_path / "grid"
    folder.mkdir()
    for text in ("{", "[]", '{"arguments": 3}', "{}"):
        (folder / "manifest.json").write_text(text)
        assert main(["grid", "--out", str(folder)]) == 2
        assert "damaged" in capsys.readouterr().err


def test_parts_of_a_slurm_array_cover_the_grid_once() -> None:
    def part(**task: int) -> Part:
        return slurm_part({f"SLURM_ARRAY_TASK_{name}": str(value) for name, value in task.items()})

    parts = [part(ID=number, COUNT=3, MIN=1, STEP=4) for number in (1, 5, 9)]
    shares = [one.share(range(8)) for one in parts]
    assert sorted(row for share in shares for row in share) == list(range(8))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    for gaps in ({"ID": 7, "COUNT": 3, "MIN": 1}, {"ID": 2, "COUNT": 2, "MIN": 1, "STEP": 2}):
        with pytest.raises(ValueError, match="gaps"):
            part(**gaps)


@pytest.mark.parametrize(
    ("axes", "shared", "named"),
    [
        ({"sweeps": [1]}, {}, "'sweeps'"),
        ({"seed": []}, {}, "no values"),
        ({"seed": [1]}, {"seed": 2}, "'seed'"),
        ({"seed": [1]}, {"speed": 2}, "'speed'"),
    ],
)
def test_what_makes_no_grid_is_named(axes: dict, shared: dict, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        Grid(axes, shared)


def test_batches_are_alike_in_cells() -> None:
    rows = list(enumerate(Grid({"cells": [5, 6], "seed": [0, 1, 2]}).rows))
    numbers = [[number for number, _ in batch] for batch in batches.batches(rows, 2)]
    assert numbers == [[0, 1], [2], [3, 4], [5]]


@pytest.mark.parametrize(("threads", "found"), [({}, "1"), ({"NPROC": "3"}, "3")])
def test_each_core_gets_one_thread_unless_told(threads: dict, found: str) -> None:
    told = "import os, jax, jaxtissue as jt; jt.use_cores(1); print(jax.device_count(), os.environ['NPROC'])"
    told += "; jt.use_cores(2)"  # too late: JAX has computed, and that is no error
    rest = {name: value for name, value in os.environ.items() if name not in ("NPROC", "XLA_FLAGS")}
    done = subprocess.run([sys.executable, "-c", told], env=rest | threads, capture_output=True, text=True)
    assert done.stdout.split() == ["1", found], done.stderr
