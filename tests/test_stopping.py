"""Signals, readers that leave, workers that die, caches of others: one line at most, never a traceback."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest
from test_cli import GOOD, SIZES, SMALL, start

from jaxtissue.compilation.batching import keep_compiled
from jaxtissue.reproduction.workers import Workers
from jaxtissue.runs.storage import cut_sweeps, load_checkpoint


def wait_for(path: Path, run: subprocess.Popen) -> None:
    """Wait until a command has made a file."""
    ends = time.monotonic() + 100
    while not path.exists():
        assert run.poll() is None and time.monotonic() < ends, "it ended before it made the file"
        time.sleep(0.002)


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="sees threads in /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_modules_are_imported_ends_in_one_line(number: int) -> None:
    with start("info") as run:
        assert run.stderr
        while run.poll() is None and len(list(Path(f"/proc/{run.pid}/task").iterdir())) == 1:
            time.sleep(0.001)  # until the thread is there that answers
        time.sleep(0.05)
        run.send_signal(number)
        error = run.stderr.read()
    assert run.returncode == 128 + number
    assert error.count("\n") == 1 and f"stopped by {signal.Signals(number).name}" in error


def test_a_second_signal_ends_at_once_and_leaves_what_can_go_on(tmp_path) -> None:
    folder = tmp_path / "run"
    with start(*SMALL, "--sweeps", "100000", "--no-contacts", "--out", folder) as run:
        assert run.stderr
        wait_for(folder / "checkpoint.npz", run)
        run.send_signal(signal.SIGTERM)
        time.sleep(0.005)
        run.send_signal(signal.SIGINT)
        error = run.stderr.read()
    # where the span was done sooner than the second one came, the first one's line is there
    assert run.returncode in (130, 143) and "stopped by" in error.splitlines()[-1]
    assert "Traceback" not in error
    checkpoint = load_checkpoint(folder / "checkpoint.npz")
    cut_sweeps(folder / "sweeps.csv", checkpoint.state.sweep, checkpoint.rows)  # as they are when it goes on


def test_a_reader_that_leaves_is_no_error(tmp_path) -> None:
    (tmp_path / "b.csv").write_text(GOOD)
    command = ["measure", tmp_path / "b.csv", *SIZES, "--no-contacts", "--out", tmp_path / "m"]
    with start(*command) as run:
        assert run.stdout and run.stderr
        run.stdout.close()
        assert run.stderr.read() == ""
    assert run.returncode == 128 + signal.SIGPIPE and (tmp_path / "m" / "summary.json").exists()


def test_a_worker_that_dies_is_told() -> None:
    with Workers(2) as workers, pytest.raises(OSError, match="a worker process died"):
        dict(workers.run(os._exit, [(9,), (9,)]))


@pytest.mark.parametrize("mode", [0o700, 0o755, 0o775, 0o777])
def test_a_cache_that_others_can_write_is_not_used(tmp_path, monkeypatch, mode: int) -> None:
    before, folder = jax.config.jax_compilation_cache_dir, tmp_path / "cache"  # type: ignore[attr-defined]
    folder.mkdir()
    folder.chmod(mode)
    try:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        if mode & 0o022:
            with pytest.warns(UserWarning, match=f"other users can write to {folder}"):
                keep_compiled()
        else:
            keep_compiled()
        used = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
        assert used == (None if mode & 0o022 else str(folder))
        jax.config.update("jax_compilation_cache_dir", None)
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
        keep_compiled()
        if sys.platform == "linux":
            assert (tmp_path / "user" / "jaxtissue").stat().st_mode & 0o777 == 0o700
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
