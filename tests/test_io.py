"""Files: what is written reads back exactly, what can't be read is refused in one clear line."""

import errno
import json
import math
import os
from typing import Any

import numpy as np
import pytest

from jaxtissue.dynamics.annealer import AnnealState
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.geometry.tube import Tube
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import read_backbones
from jaxtissue.system.files import check_folder, checksum, write_json

TUBE = Tube(100, 1, 10)


@pytest.fixture
def table(tmp_path):
    """A function that writes text or bytes to a file and returns its path."""

    def write(content):
        path = tmp_path / "backbones.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("named", [False, True])
def test_backbones_read_back_exactly(tmp_path, dtype, named):
    share = np.random.default_rng(1).random((50, 2))
    positions = (share * [100, 2 * math.pi]).astype(dtype)
    names = tuple(f"a, b\n{k} é" for k in range(50)) if named else None
    storage.write_backbones(tmp_path / "b.csv", positions, names)
    read = read_backbones(tmp_path / "b.csv", TUBE)
    assert read.positions.tolist() == positions.astype(float).tolist()
    assert read.names == names


def test_names_that_would_break_a_table_or_be_computed_read_back_exactly(tmp_path):
    names = (
        "=1+1",
        "+a",
        "-3",
        "@b",
        "'=1",
        "''a",
        "a\x1b[31mb",
        "c\r\nd",
        "e\x00",
        r"\u001b",
        r"$\xi$",
        "\x85",
    )
    positions = np.stack([np.arange(1.0, 1 + len(names)), np.zeros(len(names))], axis=1)
    storage.write_backbones(tmp_path / "b.csv", positions, names)
    written = (tmp_path / "b.csv").read_text()
    assert written.count("\n") == len(names) + 1 and written.replace("\n", "").isprintable()
    assert not [line for line in written.splitlines()[1:] if line.split(",")[2][0] in "=+-@"]
    assert read_backbones(tmp_path / "b.csv", TUBE).names == names


def test_any_angle_is_wrapped(table):
    read = read_backbones(table("axial,angle\n0,-1\n50,7\n100,-1e-20\n"), TUBE)
    assert read.positions[:, 1].tolist() == [2 * math.pi - 1, 7 - 2 * math.pi, 0.0]
    with pytest.warns(UserWarning, match="angles up to 200, which are read as radians"):
        read_backbones(table("axial,angle\n0,-1\n50,200\n"), TUBE)


def test_names_are_read_back_from_a_table_that_was_written(table):
    text = "cell,axial,angle,name\n0,1,2,left\n1,3,2,right\n"
    assert read_backbones(table(text), TUBE).names == ("left", "right")


def test_headers_of_spreadsheets_are_understood(table):
    text = "\ufeffcell, angle , note, axial\r\nx, 1.5, hello, 2.5\r\n\r\n"
    positions, names = read_backbones(table(text), TUBE)
    assert positions.tolist() == [[2.5, 1.5]] and names == ("x",)


BAD_FILES = {
    "": "is empty",
    "\n\n": "is empty",
    "axial,angle\n": "contains only a header",
    "axial,theta\n1,2\n": "no column 'angle'",
    "1.0,2.0\n": "no column 'axial'",
    "axial,angle\n1,2\n3,nan\n": "line 3: angle='nan'",
    "axial,angle\ninf,2\n": "line 2: axial='inf'",
    "axial,angle\n1,two\n": "line 2: angle='two'",
    "axial,angle\n1,2\n\n1\n": "line 4: angle=''",
    "axial,angle\n-0.5,2\n": "line 2: axial=-0.5 is outside the tube; give a value from 0 to 100.0",
    "axial,angle\n100.5,2\n": "axial=100.5",
    "axial,angle\n5,1\n6,1\n5,1\n": "lines 2 and 4 are the same backbone, axial=5.0, angle=1.0",
    f"axial,angle\n5,1\n5,{1 + 6 * math.pi!r}\n": "lines 2 and 3",
    f"axial,angle\n5,0\n5,{-1e-9!r}\n": "lines 2 and 3",
    "axial,angle,cell\n5,1,a\n6,1,\n": "line 3: cell is empty",
    "axial,angle,cell\n5,1,a\n6,1,a\n": "line 3: cell='a' is also on line 2",
    "axial,angle\n1,2\n3,1,7\n": "line 3 has more fields than the header",
    b"axial,angle\n\xff,1\n": "not UTF-8",
}


@pytest.mark.filterwarnings("ignore:.* has angles up to")
@pytest.mark.parametrize("content", BAD_FILES, ids=repr)
def test_bad_files_are_refused(table, content):
    path = table(content)
    with pytest.raises(ValueError) as refusal:
        read_backbones(path, TUBE)
    message = str(refusal.value)
    assert message.startswith(str(path)) and BAD_FILES[content] in message and "\n" not in message


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.csv can't be read"):
        read_backbones(tmp_path / "nowhere.csv", TUBE)


def test_backbones_that_only_64_bits_tell_apart(table, request):
    path = table(f"axial,angle\n5,1\n5,{1 + 1e-12!r}\n")
    with pytest.raises(ValueError, match="--x64"):
        read_backbones(path, TUBE)
    request.getfixturevalue("x64")
    assert len(read_backbones(path, TUBE).positions) == 2


def test_neighbors_in_axial_position_are_no_twins(table):
    near = float(np.nextafter(np.float32(5), np.float32(6)))
    assert len(read_backbones(table(f"axial,angle\n5,1\n{near!r},1\n"), TUBE).positions) == 2


def test_json_has_no_infinity_and_no_nan(tmp_path):
    values = {"a": math.inf, "b": [np.float32("nan"), 0.1, np.int64(3)], "c": {"d": True, "e": None}}
    write_json(tmp_path / "s.json", values)

    def refuse(constant):
        raise AssertionError(constant)

    read = json.loads((tmp_path / "s.json").read_text(), parse_constant=refuse)
    assert read == {"a": None, "b": [None, 0.1, 3], "c": {"d": True, "e": None}}


@pytest.fixture
def checkpoint():
    rng = np.random.default_rng(0)
    state = AnnealState(7, rng.random((3, 2), np.float32), 56)
    return storage.Checkpoint(state, np.array([0, 5]), rng.random((2, 3, 2), np.float32), 64 * "0")


def test_checkpoints_read_back_exactly(tmp_path, checkpoint):
    path = tmp_path / "checkpoint.npz"
    storage.save_checkpoint(path, checkpoint)
    read = storage.load_checkpoint(path)
    assert [type(part) for part in read.state] == [type(part) for part in checkpoint.state]
    assert read.rows == checkpoint.rows
    for new, old in zip((*read.state, *read[1:3]), (*checkpoint.state, *checkpoint[1:3]), strict=True):
        np.testing.assert_array_equal(new, old, strict=True)


def test_a_broken_write_leaves_the_old_checkpoint(tmp_path, checkpoint, monkeypatch):
    path = tmp_path / "checkpoint.npz"
    storage.save_checkpoint(path, checkpoint)
    whole = path.read_bytes()

    def die(file, **arrays):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", die)
    with pytest.raises(OSError, match="disk full"):
        storage.save_checkpoint(path, checkpoint)
    assert path.read_bytes() == whole and [p.name for p in tmp_path.iterdir()] == ["checkpoint.npz"]


def test_a_full_disk_names_the_file(tmp_path, checkpoint, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device, while writing .*checkpoint\.npz"):
        storage.save_checkpoint(tmp_path / "checkpoint.npz", checkpoint)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_damaged_checkpoints_are_refused(tmp_path, checkpoint, share):
    path = tmp_path / "checkpoint.npz"
    storage.save_checkpoint(path, checkpoint)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match="damaged"):
        storage.load_checkpoint(path)


def write_records(path, count):
    numbers = np.random.default_rng(2).random(count)
    with path.open("w", newline="") as file:
        for sweep, number in enumerate(numbers):
            values: dict[str, Any] = dict.fromkeys(SweepRecord._fields, float(number)) | {"sweep": sweep, "rounds": 3}
            storage.write_sweep(file, SweepRecord(**values))
    return numbers


def test_sweeps_read_back_exactly(tmp_path):
    numbers = write_records(tmp_path / "sweeps.csv", 4)
    read = storage.read_sweeps(tmp_path / "sweeps.csv")
    assert read["sweep"].tolist() == [0, 1, 2, 3] and read["energy"].tolist() == numbers.tolist()
    needed = "sweep,energy,volume_energy,area_energy,temperature,acceptance,rounds,collisions,seconds"
    assert ",".join(read).startswith(needed)


def test_rows_after_the_checkpoint_are_cut(tmp_path):
    path, short = tmp_path / "sweeps.csv", tmp_path / "short.csv"
    write_records(path, 6)
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])  # a torn last row
    short.write_bytes(b"".join(whole.splitlines(keepends=True)[:5]))
    rows = checksum(short)
    assert storage.cut_sweeps(path, 3, rows, keep=True).hexdigest() == rows
    assert path.read_bytes() == whole[:-5]
    with pytest.raises(ValueError, match="checksum does not match its rows"):
        storage.cut_sweeps(path, 4, rows)
    storage.cut_sweeps(path, 3, rows)
    assert path.read_bytes() == short.read_bytes()
    with pytest.raises(ValueError, match="no row for sweep 4"):
        storage.cut_sweeps(path, 4, rows)
    assert path.read_bytes() == short.read_bytes()


def test_folders_are_refused_before_anything_is_written(tmp_path):
    (tmp_path / "file").touch()
    for folder, force, problem in [
        (tmp_path, False, "add --force"),
        (tmp_path / "file", True, "is a file"),
        (tmp_path / "file" / "inside", True, "is not writable"),
    ]:
        with pytest.raises(ValueError, match=problem):
            check_folder(folder, force)
    check_folder(tmp_path / "new" / "newer", False)
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / ".lock").touch()
    check_folder(tmp_path / "begun", False)  # nothing is there but what a killed process left
    (tmp_path / "begun" / ".lock").unlink()
    (tmp_path / "begun").rmdir()
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
