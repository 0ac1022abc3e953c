"""The page `index.html` of a run's folder: its pictures, results and settings in one file that needs nothing else."""

import base64
import csv
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import islice
from pathlib import Path
from string import Template
from typing import Any

from jaxtissue.runs.run_folders import CELLS, DOMAIN, FILES, FIT, MANIFEST, PAGE, SUMMARY
from jaxtissue.system.files import checksum, read_sealed, replacing, write_sealed

CAPTIONS = {
    "tissue.png": "The tissue, cut open: the lumen, and the cells from the apical to the basal surface. "
    "Neighbors have different colors.",
    "scutoid.png": "A scutoid and the cells at its transition points (black balls), where cells change neighbors.",
    "surfaces.png": "The basal and the apical surface, unrolled, or seen from two sides if they are closed. A cell "
    "can have different neighbors on the two surfaces. Colors show the volumes of the cells.",
    "energy.png": "The energy of the tissue during the run.",
    "volumes.png": "The volumes of the cells at several times, sorted from the smallest to the largest.",
    "internal.png": "Two cells that are in contact only inside the tissue.",
    "cell.png": "A cell among its neighbors.",
    "bodies.png": "The tissue without a quarter of its cells.",
    "exploded.png": "An exploded view of the cells.",
    "movie.gif": "The tissue after the stored sweeps.",
    "turntable.gif": "The tissue, cut open, seen from all sides.",
}
ROWS = 20  # of the table of cells that are shown
AGAIN = "write it again with the command that wrote it"


def write_page(folder: Path, drawn: Sequence[str] | None = None) -> None:
    """Write the page of a run from what lies in its folder, as anneal, measure, fit and view leave it.

    Unless more is to come, a manifest gets the checksums of the page and of the pictures that were `drawn` for it.
    """
    summary, fit, domain = (_read(folder / name) for name in (SUMMARY, FIT, DOMAIN))
    manifest = read_sealed(folder / MANIFEST, AGAIN) if (folder / MANIFEST).is_file() else {}
    results, about = manifest.get("final", summary or fit), manifest or summary or fit
    kind = (
        {"relax": "Relaxed"}.get(manifest.get("command", ""), "Annealed")
        if manifest
        else "Measured"
        if summary
        else "Fitted"
    )
    numbers = {name: value for name, value in results.items() if isinstance(value, int | float)}
    energy = {f"energy, {name.replace('_', ' ')}": value for name, value in manifest.get("energy", {}).items()}
    settings = manifest.get("arguments", domain) | {name: fit[name] for name in ("image", "spacing") if name in fit}
    software = about.get("versions", {}) | {name: about[name] for name in ("device", "dtype", "started", "finished")
                                            if about.get(name)}  # fmt: skip
    parts = [
        *_pictures(folder),
        "<h2>Results</h2>",
        *_table(("", "all", "inner cells"), _beside(energy | numbers, results.get("inner", {}))),
        f"<h2>Cells</h2><p>The first {ROWS} rows of <a href='{CELLS}'>{CELLS}</a>.</p>",
        *_table(*_first_rows(folder / CELLS)),
        "<details open><summary>Settings</summary>",
        *_table(("", ""), settings.items()),
        "</details><details><summary>Software</summary>",
        *_table(("", ""), software.items()),
        "</details><details><summary>Files</summary><ul>",
        *(f"<li><a href='{name}'>{name}</a></li>" for name in FILES if name != PAGE and (folder / name).is_file()),
        "</ul></details>",
    ]
    page = Template(files("jaxtissue.runs").joinpath("page.html").read_text("utf-8"))
    note = "Lengths, areas and volumes are in the unit of the given sizes of the tissue. Written by jaxtissue."
    name = folder.name.encode(errors="replace").decode()  # of bytes that are no text
    text = page.substitute(title=escape(f"{kind} tissue: {name}"), note=note, body="\n".join(parts))
    with replacing(folder / PAGE, "w") as file:
        file.write(text)
    if drawn is not None and manifest.get("finished"):
        files_there = {name: checksum(folder / name) for name in (*drawn, PAGE)}
        write_sealed(folder / MANIFEST, manifest | {"files": manifest.get("files", {}) | files_there})


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}


def _pictures(folder: Path) -> Iterator[str]:
    """The pictures that are there, each within the page."""
    for name, caption in CAPTIONS.items():
        if (folder / name).is_file():
            data = base64.b64encode((folder / name).read_bytes()).decode()
            source = f"data:image/{name.rpartition('.')[2]};base64,{data}"
            told = escape(caption)
            yield f"<figure><img alt='{told}' src='{source}'><figcaption>{told}</figcaption></figure>"


def _beside(every: Mapping[str, Any], inner: Mapping[str, Any]) -> Iterator[Sequence[Any]]:
    """The results over all cells, and beside them those over the cells that touch no end."""
    for name, value in every.items():
        yield name.replace("_", " "), value, inner.get(name, "")


def _first_rows(path: Path) -> tuple[Sequence[str], list[list[Any]]]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.reader(file)
        return next(rows), [[_number(field) for field in row] for row in islice(rows, ROWS)]


def _number(field: str) -> Any:
    try:
        return float(field) if not field.isdecimal() else field
    except ValueError:
        return field


def _table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> Iterator[str]:
    """A table; numbers have six digits."""
    yield "<div class='wide'><table>"
    if any(header):
        yield f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in header)}</tr>"
    for row in rows:
        told = (f"{value:.6g}" if isinstance(value, float) else "" if value is None else str(value) for value in row)
        yield f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in told)}</tr>"
    yield "</table></div>"
