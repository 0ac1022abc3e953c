"""Tables of backbones, cells and sweeps as CSV, and checkpoints. Floats read back exactly."""

import csv
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.dynamics.annealer import AnnealState
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.geometry.array_likes import ArrayLike
from jaxtissue.geometry.nodes import ENDS
from jaxtissue.runs.names import to_field
from jaxtissue.system.files import load_arrays, open_own, replacing, save_arrays


class Checkpoint(NamedTuple):
    """The state from which a run goes on, the positions kept for its figures, and the checksum of its rows so far."""

    state: AnnealState
    kept_sweeps: Int[np.ndarray, "kept"]
    kept_positions: Float[np.ndarray, "kept n *k d"]
    rows: str


def write_backbones(
    path: Path,
    positions: ArrayLike,
    names: Sequence[str] | None = None,
    columns: Sequence[str] = ("axial", "angle"),
) -> None:
    """Write positions in a domain's columns, and names as `cell`, as `backbone_files.read_backbones` reads them.

    Tilted backbones have columns for both ends, bent ones a row for each node.
    """
    place, d, named = np.asarray(positions), len(columns), {"cell": np.array(names, dtype=object)} if names else {}
    if place.ndim == 2:
        table = dict(zip(columns, place.T, strict=True)) | named
    elif place.shape[1] == 2:
        ends = [(end, place[:, at]) for at, end in enumerate(ENDS)]
        table = {f"{end}_{name}": part[:, axis] for end, part in ends for axis, name in enumerate(columns)} | named
    else:
        n, k, _ = place.shape
        height = place[..., d] if place.shape[2] > d else np.tile(np.linspace(0, 1, k), (n, 1))
        table = {"cell": np.repeat(np.array(names or range(n), dtype=object), k), "height": height.ravel()}
        table |= {name: place[..., axis].ravel() for axis, name in enumerate(columns)}
    write_table(path, table)


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as CSV, floats with all their digits, texts as `to_field` has them."""
    with replacing(path, "w") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*(_fields(np.asarray(column)) for column in columns.values()), strict=True))


def _fields(column: np.ndarray) -> list[Any]:
    values = column.tolist()
    if column.dtype.kind in "biuf":
        return values
    return [to_field(value) if isinstance(value, str) else value for value in values]


def write_sweep(file: IO[str], record: SweepRecord) -> bytes:
    """Add the row of a sweep to an open table of sweeps, and return it; sweep 0 brings the header."""
    rows = [record._fields] if record.sweep == 0 else []
    rows.append(tuple(str(np.asarray(value).item()) for value in record))
    text = "".join(",".join(row) + "\n" for row in rows)
    file.write(text)
    file.flush()
    return text.encode()


def read_sweeps(path: Path) -> dict[str, Float[np.ndarray, "rows"]]:
    """The columns of a table of sweeps, by name."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, float).reshape(-1, len(header)).T, strict=True))


def cut_sweeps(path: Path, last: int, checksum: str, keep: bool = False) -> "hashlib._Hash":
    """Remove the rows after sweep `last`, unless told to keep them; the running checksum of those before.

    Raises `ValueError`, and removes nothing, for a table that does not reach it or of another checksum.
    """
    rows, remedy = hashlib.sha256(), "add --force to start again from the beginning"
    try:
        with open_own(path, "r+b") as file:
            line = b""
            for _ in range(last + 2):
                line = file.readline()
                rows.update(line)
            if not line.endswith(b"\n"):
                raise ValueError(f"{path} is damaged (it has no row for sweep {last}); {remedy}")
            if rows.hexdigest() != checksum:
                raise ValueError(f"{path} is damaged (the checksum does not match its rows); {remedy}")
            if not keep:
                file.truncate(file.tell())
    except OSError as error:
        raise ValueError(f"{path} can't be read ({error.strerror}); {remedy}") from error
    return rows


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint so that at any moment `path` holds a whole one, the old or the new."""
    kept = checkpoint._asdict()
    save_arrays(path, kept.pop("state")._asdict() | kept)


def load_checkpoint(path: Path) -> Checkpoint:
    """The checkpoint of a file. Raises `ValueError` where a bit of it is not as it was."""
    data, remedy = (
        load_arrays(path, "add --force to start again from the beginning"),
        "add --force to start again from the beginning",
    )
    try:
        state = AnnealState(int(data["sweep"]), data["positions"], int(data["around"]))
        return Checkpoint(state, data["kept_sweeps"], data["kept_positions"], str(data["rows"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} was written by another version of jaxtissue ({error}); {remedy}") from error
