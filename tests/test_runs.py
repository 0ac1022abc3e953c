"""A run's folder: held by one process, its damage found, its precision kept, its results drawn up early."""

import json
import os
import shutil
import signal
from pathlib import Path

import jax
import numpy as np
import pytest
from test_cli import SMALL, same_run, without_seconds

from jaxtissue.cli.commands import main
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.runs import storage
from jaxtissue.runs.pages import write_page
from jaxtissue.system.files import read_sealed, write_sealed
from jaxtissue.system.locks import Lock, alone, together

pytestmark = pytest.mark.usefixtures("coarse_pictures")
SWEEPS = (*SMALL, "--sweeps", "20")


def stop_at(sweep: int, folder: Path, *more: str) -> None:
    """Play a run of 20 sweeps into a folder, stopped in the span that begins at a sweep."""
    advance = Annealer.advance

    def interrupted(annealer, state):
        if state.sweep == sweep:
            signal.raise_signal(signal.SIGTERM)
        return advance(annealer, state)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Annealer, "advance", interrupted)
        assert main([*SWEEPS, *more, "--out", str(folder)]) == 128 + signal.SIGTERM


@pytest.fixture(scope="module")
def whole(coarse_pictures, tmp_path_factory) -> Path:
    """The folder of a run of 20 sweeps."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    assert main([*SWEEPS, "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def stopped(coarse_pictures, tmp_path_factory) -> Path:
    """The folder of the same run stopped after sweep 10."""
    folder = tmp_path_factory.mktemp("runs") / "stopped"
    stop_at(8, folder)
    return folder


@pytest.fixture
def copy(tmp_path):
    """A function that copies a folder, and returns the path of the copy."""

    def made(folder: Path) -> Path:
        return Path(shutil.copytree(folder, tmp_path / "copy", dirs_exist_ok=True, symlinks=True))

    return made


def refused(capsys, *arguments: str) -> str:
    """The one line by which a command refuses."""
    capsys.readouterr()
    assert main(list(arguments)) == 2
    streams = capsys.readouterr()
    assert streams.err.count("\n") == 1 and streams.out == "", streams
    return streams.err


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.name != ".lock"}


def test_a_second_run_in_a_folder_is_refused(stopped, copy, tmp_path, capsys) -> None:
    folder, new = copy(stopped), tmp_path / "new"
    before = contents(folder)
    with alone(folder), alone(new):
        for more in (["--force"], ["--resume"], ["--resume", "--finish"]):
            start = ["anneal"] if "--resume" in more else SWEEPS
            assert f"process {os.getpid()}" in refused(capsys, *start, "--out", str(folder), *more)
        assert "a run is still in progress" in refused(capsys, *SWEEPS, "--out", str(new))
        assert contents(folder) == before
    assert not new.exists() and not (folder / ".lock").exists()


def test_locks_are_shared_or_held_alone_and_end_with_the_last(tmp_path) -> None:
    told = []
    with together(tmp_path, told.append), together(tmp_path, told.append):
        with pytest.raises(ValueError, match="is still in progress"), alone(tmp_path):
            pass
        with alone(tmp_path, ".part.lock"):
            assert (tmp_path / ".part.lock").exists()
    assert told == [True, False] and not list(tmp_path.iterdir())
    first, late = Lock(tmp_path / ".lock"), Lock(tmp_path / ".lock")
    assert first.take() and not late.take()
    first.release()  # and the file is gone that the other has open
    assert late.take() and (tmp_path / ".lock").exists()
    late.release()


def flips(path: Path, count: int, seed: int) -> list[tuple[int, int]]:
    """Places in a file, byte and bit."""
    rng = np.random.default_rng(seed)
    return list(zip(rng.integers(path.stat().st_size, size=count), rng.integers(8, size=count), strict=True))


@pytest.mark.parametrize("ended", [False, True])
def test_a_flipped_bit_is_told_in_one_line(whole, stopped, copy, capsys, ended: bool) -> None:
    folder = copy(whole if ended else stopped)
    if ended:  # as `leave_pictures` and the command view do
        (folder / "tissue.png").write_bytes((folder / "energy.png").read_bytes())
        write_page(folder, ["tissue.png"])
    before = contents(folder)
    for seed, (path, whole_file) in enumerate(before.items()):
        places = flips(path, 8, seed) + [(1965, 0)] * (path.name == "checkpoint.npz")
        for byte, bit in places:
            damaged = bytearray(whole_file)
            damaged[byte] ^= 1 << bit
            path.write_bytes(damaged)
            error = refused(capsys, "anneal", "--out", str(folder), "--resume")
            assert path.name in error and "damaged" in error
            assert contents(folder) == before | {path: bytes(damaged)}
        path.write_bytes(whole_file)
    assert main(["anneal", "--out", str(folder), "--resume"]) == 0 and same_run(folder, whole)


@pytest.mark.parametrize("name", ["finished", "resumed", "cooling_sweeps", "compile_seconds", "files", "format"])
def test_a_manifest_that_lacks_something_is_told_in_one_line(stopped, copy, capsys, name: str) -> None:
    folder = copy(stopped)
    manifest = read_sealed(folder / "manifest.json", "")
    del manifest[name]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert "damaged" in refused(capsys, "anneal", "--out", str(folder), "--resume")
    write_sealed(folder / "manifest.json", manifest)
    told = "another version" if name == "format" else repr(name)
    assert told in refused(capsys, "anneal", "--out", str(folder), "--resume")


def test_what_was_played_can_be_drawn_up_and_the_run_go_on(whole, stopped, copy, tmp_path, capsys) -> None:
    folder, short = copy(stopped), tmp_path / "short"
    resume = ["anneal", "--out", str(folder), "--resume"]
    assert "--sweeps" in refused(capsys, *resume, "--finish", "--sweeps", "30")
    assert "--resume" in refused(capsys, "anneal", "--out", str(tmp_path / "new"), "--finish")
    assert main([*resume, "--finish"]) == 0
    assert main([*SMALL, "--sweeps", "10", "--out", str(short)]) == 0
    assert same_run(folder, short)
    manifest = read_sealed(folder / "manifest.json", "")
    assert manifest["finished"] is None and manifest["final"]["sweep"] == 10
    assert manifest["arguments"]["sweeps"] == 20 and manifest["resumed"] == []
    assert main(resume) == 0 and same_run(folder, whole)
    (folder / "cells.csv").unlink()  # what a finished run has lost is drawn up again
    assert "--finish" in refused(capsys, *resume)
    assert main([*resume, "--finish"]) == 0 and same_run(folder, whole)
    assert read_sealed(folder / "manifest.json", "")["finished"]


def test_a_run_goes_on_in_its_own_precision(whole, stopped, copy, tmp_path) -> None:
    folder, precise = copy(stopped), [tmp_path / "whole64", tmp_path / "run64"]
    jax.config.update("jax_enable_x64", True)  # not by --x64, but as JAX_ENABLE_X64 does
    assert main(["anneal", "--out", str(folder), "--resume"]) == 0 and same_run(folder, whole)
    jax.config.update("jax_enable_x64", True)
    assert main([*SWEEPS, "--no-contacts", "--out", str(precise[0])]) == 0
    stop_at(8, precise[1], "--no-contacts")
    assert read_sealed(precise[1] / "manifest.json", "")["arguments"]["x64"] is True
    jax.config.update("jax_enable_x64", False)
    assert main(["anneal", "--out", str(precise[1]), "--resume"]) == 0
    assert storage.load_checkpoint(precise[1] / "checkpoint.npz").state.positions.dtype == np.float64
    for name in ("backbones.csv", "cells.csv"):
        assert (precise[1] / name).read_bytes() == (precise[0] / name).read_bytes()
    assert without_seconds(precise[1] / "sweeps.csv") == without_seconds(precise[0] / "sweeps.csv")


def test_other_compilers_and_processors_are_told(stopped, copy, capsys) -> None:
    folder = copy(stopped)
    manifest = read_sealed(folder / "manifest.json", "")
    manifest["versions"]["jax"], manifest["processor"] = "0.1", "abacus"
    write_sealed(folder / "manifest.json", manifest)
    assert main(["anneal", "--out", str(folder), "--resume"]) == 0
    error = capsys.readouterr().err
    assert "processor was abacus, now" in error and f"jax was 0.1, now {jax.__version__}" in error
    assert main(["anneal", "--out", str(folder), "--resume", "--finish"]) == 0
    assert "round-off" not in capsys.readouterr().err  # as it was when the run was taken up the last time


def test_what_a_killed_process_left_is_swept(stopped, copy, tmp_path) -> None:
    folder, new = copy(stopped), tmp_path / "new"
    new.mkdir()
    for place in (folder, new):
        (place / ".cells.csv.somewhere-12.part").touch()
        (place / ".lock").touch()
        (place / ".export.abc.part").mkdir()
        (place / ".export.abc.part" / "cells.vtu").touch()
    assert main(["anneal", "--out", str(folder), "--resume", "--finish"]) == 0
    assert main([*SMALL, "--sweeps", "0", "--out", str(new)]) == 0  # killed before it had anything: no --force
    assert not [path for place in (folder, new) for path in place.glob(".*")]


def test_links_in_a_folder_are_not_followed(stopped, copy, tmp_path, capsys) -> None:
    folder, elsewhere = copy(stopped), tmp_path / "elsewhere"
    rows = (folder / "sweeps.csv").read_bytes() + b"11,"
    elsewhere.write_bytes(rows)
    (folder / "sweeps.csv").unlink()
    for name in ("sweeps.csv", "cells.csv"):
        (folder / name).symlink_to(elsewhere)
    assert "sweeps.csv is a symbolic link" in refused(capsys, "anneal", "--out", str(folder), "--resume")
    assert main([*SMALL, "--sweeps", "1", "--out", str(folder), "--force"]) == 0
    assert elsewhere.read_bytes() == rows and not (folder / "cells.csv").is_symlink()
    assert len(without_seconds(folder / "sweeps.csv")) == 2
