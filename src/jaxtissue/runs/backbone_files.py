"""Tables of backbones: CSV with commas, semicolons or tabs, read completely or rejected."""

import csv
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.domain_positions import as_positions_on, column_names
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.positions import STRAIGHT, Rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.runs import layer_tables
from jaxtissue.runs.centroid_tables import DOUBT, centroid_columns, place_centroids
from jaxtissue.runs.layer_tables import Layered, join_layers
from jaxtissue.runs.names import from_field
from jaxtissue.runs.node_tables import group_nodes, tilted_columns

SEPARATORS = ",;\t"
LABELS = ("name", "cell", "label", "id", "")  # columns that may name cells, in this order
INDEX = ("", "unnamed: 0")  # what tables of pandas call their index
RADIANS, DEGREES = ("", "rad", "radian", "radians"), ("deg", "degree", "degrees", "°")
_UNIT = re.compile(r"(.*?)\s*[(\[]\s*(.*?)\s*[)\]]")
_NUMBER = re.compile(r"[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?")


class BackboneTable(NamedTuple):
    """Backbones as read: their positions on the domain in float64, and their names if they have any.

    On a tube these are (axial, angle), angles in [0, 2 pi).
    """

    positions: Float[np.ndarray, "n d"]
    names: tuple[str, ...] | None


class _Table(NamedTuple):
    """A table as it stands: header, names and units of columns, rows by line; `columns` tell where the cells are."""

    path: Path
    columns: Sequence[str]
    header: str
    names: list[str]
    units: list[str]
    lines: list[int]
    rows: list[list[str]]
    comma: bool  # decimal commas are read

    def column(self, name: str) -> list[str]:
        """The fields of a column."""
        at = self.names.index(name)
        return [row[at] for row in self.rows]


def read_backbones(path: Path, domain: Tube | Domain, degrees: bool = False, bent: bool = False) -> BackboneTable:
    """The backbones of a table with the domain's columns, as `axial` and `angle`, and names of cells if it has any.

    Fields are set apart by commas, semicolons or tabs; with the last two, numbers may have decimal commas. Headers may
    be in any case and carry units in brackets, such as `axial (um)`. Angles are radians, or with `degrees`, or in a
    column `angle (deg)`, degrees. They are wrapped, with a warning of those that look like degrees. Names stand in the
    first of the columns `name`, `cell`, `label`, `id`, and one without a header, that has another name for each cell,
    or else in the first column of all, if it has. Other columns are left aside. Where a table for a `Tube` has no
    backbones, but centroids, also by layer, the backbones through these are taken, with a warning.

    With `bent`, backbones may be tilted, with columns for both ends, `apical_axial` and so on, or bent, with a row for
    each node: rows of one `cell` at several values of `height`. Their positions have an axis for nodes.

    Raises `ValueError`, naming file, line, value and fix, for a file that is empty or not UTF-8, a quote that is not
    closed or swallows rows, missing or repeated columns, lines with fields too many, what is no number, no cells, names
    that are empty or repeated, degrees for a domain without angles, and positions that `as_positions_on` refuses.
    """
    columns = column_names(domain)
    table = _read_table(path, columns, isinstance(domain, Tube))
    tilted, nodes = table.columns == tilted_columns(columns), table.columns == columns and _has_nodes(table)
    if (tilted or nodes) and not bent:
        raise ValueError(f"{path} has {'tilted' if tilted else 'bent'} backbones: {STRAIGHT}")
    positions = np.stack([_numbers(table, name) for name in table.columns], axis=-1)
    names = None if nodes or table.columns == layer_tables.COLUMNS else _find_names(table)
    rows = Rows(f"{path} ", "line", table.lines)
    if table.columns == columns or tilted:
        positions = _in_radians(table, positions, degrees)
    elif isinstance(domain, Tube):
        positions, joined = _place(table, positions, domain, degrees)
        names, rows = (joined.names, rows._replace(numbers=joined.lines)) if joined else (names, rows)
    if tilted:
        positions = positions.reshape(len(positions), 2, -1)
    elif nodes:
        cells = [from_field(field.strip()) for field in table.column("cell")]
        positions, lines, names = group_nodes(path, table.lines, cells, _numbers(table, "height"), positions)
        rows = rows._replace(numbers=lines)
    place = as_positions_on(positions, domain, np.float64, rows, bent=bent)
    as_positions_on(place, domain, rows=rows, sizes=False, bent=bent)  # none are one in the precision JAX works in
    if "angle" in columns:
        place[..., 1] = np.mod(place[..., 1], 2 * math.pi) % (2 * math.pi)
    return BackboneTable(place, names)


def _has_nodes(table: _Table) -> bool:
    """Whether a table has several rows for a cell, each of a height."""
    return {"cell", "height"} <= set(table.names) and len(set(table.column("cell"))) < len(table.rows)


def _in_radians(table: _Table, positions: np.ndarray, degrees: bool) -> np.ndarray:
    """The positions with all angles in radians."""
    angles = [k for k, name in enumerate(table.columns) if name.split("_")[-1] == "angle"]
    if degrees and not angles:
        raise ValueError(f"--degrees applies to angles, not to {', '.join(table.columns)} of {table.path}; remove it")
    for k in angles:
        positions[:, k] = _radians(table, table.columns[k], positions[:, k], degrees)
    return positions


def _place(table: _Table, points: np.ndarray, tube: Tube, degrees: bool) -> tuple[np.ndarray, Layered | None]:
    """(axial, angle) of backbones through the centroids of a table, with a word of doubt, and what joins layers."""
    units = {table.units[table.names.index(name)] for name in table.columns}
    if len(units) > 1:
        raise ValueError(f"{table.path}: the header {table.header!r} gives centroids in different units; use one unit")
    if degrees:
        raise ValueError(f"--degrees applies to angles, not to {', '.join(table.columns)} of {table.path}; remove it")
    joined = _join(table) if table.columns == layer_tables.COLUMNS else None
    try:
        found = joined.place(tube) if joined else place_centroids(points, tube)
    except ValueError as error:
        raise ValueError(f"{table.path}: {error}") from error
    warnings.warn(f"{table.path} {DOUBT}", stacklevel=3)
    return found, joined


def _join(table: _Table) -> Layered:
    """The cells of a table of centroids on layers."""
    keys = [[from_field(field.strip()) for field in table.column(name)] for name in ("id", "layer")]
    points = np.stack([_numbers(table, name) for name in table.columns], axis=-1)
    try:
        return join_layers(table.lines, keys[0], keys[1], points)
    except ValueError as error:
        raise ValueError(f"{table.path} {error}") from error


def find_tube(path: Path) -> Tube | None:
    """The tube that a table of centroids on layers tells; None for a file that holds no such table."""
    try:
        table = _read_table(path, ("axial", "angle"), True)
    except ValueError:  # told when it is read
        return None
    return _join(table).fit_tube() if table.columns == layer_tables.COLUMNS else None


def _read_table(path: Path, columns: Sequence[str], centroids: bool) -> _Table:
    """The table in a file; where it lacks the columns, centroids may tell where the cells are, if they are taken."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            text = file.read()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not UTF-8 text (byte {error.start}); save it as CSV in UTF-8") from error
    except OSError as error:
        raise ValueError(f"{path} can't be read ({error.strerror}); give a CSV file of backbones") from error
    physical = re.split("\r\n|\r|\n", text)
    first = next((line for line in physical if line.strip()), None)
    if first is None:
        raise ValueError(f"{path} is empty; give the header {','.join(columns)} and one line per backbone")
    separator = max(SEPARATORS, key=first.count)  # the first of those that are as frequent
    records = list(_records(path, physical, separator))
    header = [field.strip() for field in records[0][1]]
    brackets = [_UNIT.fullmatch(field) for field in header]
    names = [(unit[1] if unit else field).strip().lower() for unit, field in zip(brackets, header, strict=True)]
    units = [unit[2].lower() if unit else "" for unit in brackets]
    if centroids and not set(columns) <= set(names):
        columns = centroid_columns(names) or columns
    if set(tilted_columns(columns)) <= set(names) and not set(columns) <= set(names):
        columns = tilted_columns(columns)
    for name in columns:
        if name not in names:
            found = f"{name!r}, only {first.strip()!r}"
            raise ValueError(f"{path} has no column {found}; give the header {','.join(columns)}")
    for name in names:
        if name and names.count(name) > 1:
            raise ValueError(f"{path} has the column {name!r} twice in {first.strip()!r}; remove one of them")
    if len(records) == 1:
        raise ValueError(f"{path} contains only a header; give one line {','.join(columns)} per backbone")
    for line, row in records[1:]:
        if any(row[len(names) :]):
            raise ValueError(f"{path} line {line} has more fields than the header, {len(names)}; correct it")
        row += [""] * (len(names) - len(row))
    lines, rows = zip(*records[1:], strict=True)
    table = _Table(path, columns, first.strip(), names, units, list(lines), list(rows), separator != ",")
    _refuse_swallowed(table, physical, separator)
    return table


def _records(path: Path, physical: list[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """The records of a table that are not empty, each with the line it begins on."""
    lines = (f"{line}\n" for line in physical)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=separator != "\t", strict=True)
    while True:
        begin = reader.line_num + 1
        try:
            row = next(reader, None)
        except csv.Error as error:
            reason = f"a quotation mark that is not closed, or text outside the quotation marks ({error})"
            raise ValueError(f"{path} line {begin} has {reason}; correct it") from error
        if row is None:
            return
        if row and row != [""]:
            yield begin, row


def _refuse_swallowed(table: _Table, physical: list[str], separator: str) -> None:
    """Raise `ValueError` for quotes that run over lines which are rows themselves."""
    places = [table.names.index(name) for name in table.columns]
    ends = [*table.lines[1:], len(physical) + 1]
    for begin, end in zip(table.lines, ends, strict=True):
        for line in range(begin + 1, end):
            fields = physical[line - 1].split(separator)
            numbers = [_parse(fields[at], table.comma) for at in places if at < len(fields)]
            if len(numbers) == len(table.columns) and None not in numbers:
                told = f"an unclosed quotation mark that includes line {line}, {physical[line - 1]!r}"
                raise ValueError(f"{table.path} line {begin} has {told}; close it")


def _parse(field: str, comma: bool) -> float | None:
    """The number that a field holds, if it is one."""
    text = field.strip()
    if comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    return value if math.isfinite(value) else None


def _numbers(table: _Table, name: str) -> list[float]:
    fields, marks = table.column(name), ("," * table.comma, ".")
    if all(any(mark and mark in field for field in fields) for mark in marks):
        told = f"the column {name} contains both decimal commas and decimal points"
        raise ValueError(f"{table.path}: {told}; use one of them")
    values = []
    for line, field in zip(table.lines, fields, strict=True):
        value = _parse(field, table.comma)
        if value is None:
            told = f"{name}={field!r} is not a finite number"
            raise ValueError(f"{table.path} line {line}: {told}; correct it")
        values.append(value)
    return values


def _radians(table: _Table, name: str, angle: Float[np.ndarray, " n"], degrees: bool) -> Float[np.ndarray, " n"]:
    """Angles in radians, by the header's unit or as told; a doubt where they look like degrees."""
    unit = table.units[table.names.index(name)]
    if unit not in RADIANS + DEGREES or (degrees and unit in RADIANS[1:]):
        told = f"{table.path}: the header {table.header!r} gives angles in {unit!r}"
        cure = "remove --degrees, or correct the header" if degrees else "use rad or deg"
        raise ValueError(f"{told}; {cure}")
    if degrees or unit in DEGREES:
        return np.radians(angle)
    largest = np.abs(angle).max()
    whole = largest > 2 * math.pi and (angle == np.round(angle)).all()
    if largest > 4 * math.pi or whole:
        told = f"{table.path} has angles up to {largest:g}, which are read as radians"
        warnings.warn(f"{told}; add --degrees if they are degrees", stacklevel=3)
    return angle


def _find_names(table: _Table) -> tuple[str, ...] | None:
    """The names of the cells by the first column of LABELS that tells them apart.

    Else the first column of all may hold names, under any header: texts or whole numbers, each once.
    """
    doubt = ""
    for label in LABELS:
        column = label if label else next((name for name in INDEX if name == table.names[0]), None)
        if column is None or column not in table.names:
            continue
        names = [from_field(field.strip()) for field in table.column(column)]
        wrong = _repeated(table, column, names)
        if not wrong:
            return tuple(names)
        if label in ("name", "cell"):
            doubt = doubt or wrong
    if doubt:
        raise ValueError(doubt)
    first = table.names[0]
    names = [from_field(field.strip()) for field in table.column(first)]
    numbers = any(_parse(name, table.comma) is not None and not name.isdecimal() for name in names)
    return None if first in table.columns or numbers or _repeated(table, first, names) else tuple(names)


def _repeated(table: _Table, column: str, names: list[str]) -> str:
    """The fault of names that are empty or not unique; nothing if there is none."""
    seen: dict[str, int] = {}
    for line, name in zip(table.lines, names, strict=True):
        if not name:
            return f"{table.path} line {line}: {column} is empty; give the cell a name, or remove the column"
        if name in seen:
            return f"{table.path} line {line}: {column}={name!r} is also on line {seen[name]}; rename one of the cells"
        seen[name] = line
    return ""
