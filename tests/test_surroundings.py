"""The command in awkward surroundings: it works, or says in one line why it does not."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import quick
from test_cli import SIZES, SMALL

import jaxtissue
from jaxtissue.cli.commands import main

RUN = (*SMALL, "--no-contacts", "--sweeps", "6")
BACKBONES = "axial,angle\n1,0\n5,2\n9,4\n"
LOST = f"""
import pwd
def unknown(*_): raise KeyError("no such user")
pwd.getpwuid = pwd.getpwnam = unknown
{quick.RUN}
"""  # the command, run by a user whom the system does not know


STRICT = {
    "JAX_NUMPY_DTYPE_PROMOTION": "strict",
    "JAX_NUMPY_RANK_PROMOTION": "raise",
    "JAX_TRANSFER_GUARD": "disallow",
    "JAX_DEBUG_NANS": "1",
    "JAX_DEFAULT_PRNG_IMPL": "rbg",
    "JAX_THREEFRY_PARTITIONABLE": "0",
    "JAX_ENABLE_X64": "1",
}
NO_HOME = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "JAX_COMPILATION_CACHE_DIR"), "")


def start(command: Sequence[str | bytes], place: Path | None = None, /, **environment: str) -> subprocess.Popen[bytes]:
    """Start a command in a place and other surroundings; an empty variable is left out of the environment."""
    path = os.pathsep.join([str(Path(jaxtissue.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    told = os.environ | {"PYTHONPATH": path} | environment
    told = {name: value for name, value in told.items() if value}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=told, stdout=pipe, stderr=pipe, cwd=place)


def end(process: subprocess.Popen[bytes]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command that ends."""
    said, told = process.communicate(timeout=300)
    return process.returncode, said.decode(), told.decode()


def test_a_run_in_odd_surroundings_is_the_usual_one(tmp_path) -> None:
    """Strict settings of JAX, a user unknown, TeX wanted and not there, ASCII streams, SIGINT ignored."""
    usual, odd = tmp_path / "usual", os.fsencode(tmp_path) + "/Ergebnis-ü-".encode() + b"\xff"
    assert main([*RUN, "--x64", "--out", str(usual)]) == 0
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfont.family: no such font\n")
    process = start(
        ["/bin/sh", "-c", 'trap "" INT; exec "$@"', "sh", sys.executable, "-c", LOST, *RUN, "--out", odd],
        MATPLOTLIBRC=str(tmp_path / "matplotlibrc"),
        PYTHONIOENCODING="ascii",
        PATH="/nowhere",
        **STRICT,
    )
    out = Path(os.fsdecode(odd))
    while process.poll() is None and not (out / "sweeps.csv").is_file():
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    code, said, told = end(process)
    assert code == 0, told
    assert "Traceback" not in told and "Ergebnis-\\xfc-\\udcff" in said
    for name in ("initial_backbones.csv", "backbones.csv", "cells.csv"):
        assert (out / name).read_bytes() == (usual / name).read_bytes(), name
    assert all((out / f"{name}.png").stat().st_size > 1000 for name in ("energy", "volumes", "surfaces"))


def test_a_platform_that_is_not_there_gets_one_line() -> None:
    code, _, told = end(start(quick.command("info"), JAX_PLATFORMS="nonesuch"))
    assert code == 2
    assert told == "jaxtissue: error: JAX has no device for JAX_PLATFORMS=nonesuch; correct or unset this variable\n"


def test_closed_streams_no_home_and_a_name_that_is_no_text(tmp_path) -> None:
    table, here = os.fsencode(tmp_path) + b"/r\xe9seau.csv", tmp_path / "here"
    Path(os.fsdecode(table)).write_text(BACKBONES)
    here.mkdir()
    measure = quick.command("measure", table, *SIZES, "--no-contacts", "--out")
    silent = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *measure]
    done = start([*silent, str(tmp_path / "cells")], here, **NO_HOME)
    assert end(done) == (0, "", "")
    assert len((tmp_path / "cells" / "cells.csv").read_text().splitlines()) == 4
    assert not list(here.iterdir())  # no cache in a folder named ~
    refused = start([*silent, str(tmp_path / "none"), "--graph"], here)
    assert end(refused) == (2, "", "") and not (tmp_path / "none").exists()
