"""Tables of backbones, cells and sweeps as CSV, and checkpoints. Floats read back exactly."""

import csv
import hashlib
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int
from scipy.spatial import KDTree

from jaxtissue.anneal import AnnealState
from jaxtissue.files import load_arrays, open_own, replacing, save_arrays
from jaxtissue.names import from_field, to_field
from jaxtissue.records import SweepRecord
from jaxtissue.tube import Tube


class BackboneTable(NamedTuple):
    """Backbones as read: (axial, angle) in float64, angles in [0, 2 pi), and their names if they have any."""

    positions: Float[np.ndarray, "n 2"]
    names: tuple[str, ...] | None


class Checkpoint(NamedTuple):
    """What a run needs to go on, the positions it keeps for its figures, the checksum of its rows so far."""

    state: AnnealState
    kept_sweeps: Int[np.ndarray, "kept"]
    kept_positions: Float[np.ndarray, "kept n 2"]
    rows: str


def read_backbones(path: Path, tube: Tube) -> BackboneTable:
    """The backbones of a CSV file with the columns `axial`, `angle` (radians) and perhaps `cell` (a name).

    A table that was written has names as `name`, which then counts. Angles are wrapped, with a warning of
    those beyond two turns, other columns left aside. Raises `ValueError`, naming file, line, value and fix,
    for a file that is empty or not UTF-8, a missing column, a line with too many, no cells, coordinates that
    are not finite or outside the tube, names that are empty or repeated, and backbones that are one in the
    precision JAX works in.
    """
    columns, rows = _read_rows(path)
    for name in ("axial", "angle"):
        if name not in columns:
            found = ",".join(columns)[:60]
            raise ValueError(f"{path} has no column {name!r} but {found!r}; begin it with axial,angle")
    if not rows:
        raise ValueError(f"{path} has no cells; give one line axial,angle per backbone")
    lines, length = [line for line, _ in rows], float(tube.length)
    axial, angle = ([_number(path, line, row, name) for line, row in rows] for name in ("axial", "angle"))
    for line, value in zip(lines, axial, strict=True):
        if not 0 <= value <= length:
            raise ValueError(f"{path} line {line}: axial={value} is outside the tube; give 0 to {length}")
    positions = np.stack([axial, angle], axis=-1)
    if (largest := np.abs(positions[:, 1]).max()) > 4 * math.pi:
        warnings.warn(f"{path} has angles up to {largest:g}: they are taken as radians", stacklevel=2)
    positions[:, 1] = np.mod(positions[:, 1], 2 * math.pi) % (2 * math.pi)
    _refuse_twins(path, lines, positions, length)
    named = next((column for column in ("name", "cell") if column in columns), None)
    return BackboneTable(positions, _read_names(path, rows, named) if named else None)


def _read_rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str | None]]]]:
    """Names of the columns, and each row with the number of its line."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns = reader.fieldnames = [name.strip() for name in reader.fieldnames or []]
            rows = [(reader.line_num, row) for row in reader]
        for line, row in rows:
            if any(row.pop(None, ())):  # type: ignore[call-overload]
                raise ValueError(f"{path} line {line} has more than the {len(columns)} columns; correct it")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not UTF-8 text (byte {error.start}); save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise ValueError(f"{path} is not a CSV file ({error}); begin it with axial,angle") from error
    except OSError as error:
        raise ValueError(f"{path} can't be read ({error.strerror}); give a CSV file of backbones") from error
    if not columns:
        raise ValueError(f"{path} is empty; begin it with axial,angle and give one line per backbone")
    return list(columns), rows


def _number(path: Path, line: int, row: dict[str, str | None], name: str) -> float:
    try:
        value = float(row[name] or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{path} line {line}: {name}={row[name] or ''!r} is not a finite number; correct it")
    return value


def _refuse_twins(path: Path, lines: list[int], positions: Float[np.ndarray, "n 2"], length: float) -> None:
    rounded = positions.astype(jnp.result_type(float))
    axial, angle = rounded.astype(float).T
    # A full turn more or less changes an angle by roundoff.
    close = 8 * np.finfo(rounded.dtype).eps
    ring = np.stack([axial / length, np.cos(angle), np.sin(angle)], axis=-1)
    twins = sorted((i, j) for i, j in KDTree(ring).query_pairs(close) if axial[i] == axial[j])
    if twins:
        first, second = twins[0]
        place = f"axial={positions[first, 0]}, angle={positions[first, 1]}"
        single = " (or use --x64 if they differ beyond 7 digits)" if rounded.dtype == np.float32 else ""
        found = f"lines {lines[first]} and {lines[second]} are the same backbone, {place}"
        raise ValueError(f"{path} {found}; remove one{single}")


def _read_names(path: Path, rows: list[tuple[int, dict[str, str | None]]], column: str) -> tuple[str, ...]:
    seen: dict[str, int] = {}
    for line, row in rows:
        name = from_field((row[column] or "").strip())
        if not name:
            raise ValueError(f"{path} line {line}: {column} is empty; name the cell or leave the column out")
        if name in seen:
            raise ValueError(
                f"{path} line {line}: {column}={name!r} is also on line {seen[name]}; rename one"
            )
        seen[name] = line
    return tuple(seen)


def write_backbones(
    path: Path, positions: Float[ArrayLike, "n 2"], names: Sequence[str] | None = None
) -> None:
    """Write (axial, angle) positions, and names as `cell`, as `read_backbones` reads them."""
    axial, angle = np.asarray(positions).T
    columns = {"axial": axial, "angle": angle}
    write_table(path, columns | ({"cell": np.array(names, dtype=object)} if names else {}))


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as CSV, floats with all their digits, texts as `to_field` has them."""
    with replacing(path, "w") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        values = ([_field(value) for value in np.asarray(column).tolist()] for column in columns.values())
        writer.writerows(zip(*values, strict=True))


def _field(value: Any) -> Any:
    return to_field(value) if isinstance(value, str) else value


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
    rows, remedy = hashlib.sha256(), "start again with --force"
    try:
        with open_own(path, "r+b") as file:
            line = b""
            for _ in range(last + 2):
                line = file.readline()
                rows.update(line)
            if not line.endswith(b"\n"):
                raise ValueError(f"{path} is damaged (it has no row for sweep {last}); {remedy}")
            if rows.hexdigest() != checksum:
                raise ValueError(f"{path} is damaged (the checksum of its rows does not hold); {remedy}")
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
    data, remedy = load_arrays(path, "start again with --force"), "start again with --force"
    try:
        state = AnnealState(int(data["sweep"]), data["positions"], int(data["around"]))
        return Checkpoint(state, data["kept_sweeps"], data["kept_positions"], str(data["rows"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is of another version ({error}); {remedy}") from error
