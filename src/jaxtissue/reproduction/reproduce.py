"""The paper's evaluation in a folder: its table and figures, item by item, and the report on them."""

import csv
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxtissue import io
from jaxtissue.files import is_empty, make_folder, replacing, write_json
from jaxtissue.plot import save_figure
from jaxtissue.reproduction.claims import Claim
from jaxtissue.reproduction.experiments import FORMAT, QUICK, Plan, Store, Table
from jaxtissue.reproduction.items import ITEMS, Product
from jaxtissue.reproduction.report import judge_items, write_report
from jaxtissue.reproduction.workers import Workers
from jaxtissue.settings import now, provenance


def choose_items(names: Sequence[str]) -> list[str]:
    """The items of the given names, in the paper's order; none, or "all", means all of them.

    Raises `ValueError` for a name that is none, with those that are.

    >>> choose_items(["fig7", "fig5", "fig7"])
    ['fig5', 'fig7']
    """
    unknown = [name for name in names if name not in ITEMS and name != "all"]
    if unknown:
        raise ValueError(f"unknown item {unknown[0]!r}; use all or any of {', '.join(ITEMS)}")
    return [item for item in ITEMS if not names or item in names or "all" in names]


def make_plan(quick: bool, seeds: int | None) -> Plan:
    """The full plan or the quick one, with another number of seeds where it is given."""
    plan = QUICK if quick else Plan()
    return replace(plan, seeds=seeds) if seeds else plan


def reproduce(
    folder: Path, items: Sequence[str], plan: Plan, force: bool = False, workers: Workers | None = None
) -> dict[str, Any]:
    """Make the items in `folder`, one after the other, and the report on all that are there; the manifest.

    Items that are there already are left as they are unless forced; a run that is stopped takes up at the
    tissue it was at. `workers` share the work, where there are any. Raises `ValueError` for a folder that
    another plan has filled or that can't be written.
    """
    manifest = _open(folder, plan, force)
    store = Store(folder / "data", lambda text: _say(f"  {text}"), fresh=force, workers=workers or Workers())
    for item in items:
        if item in manifest["items"] and not force:
            _say(f"{item} is there already; --force makes it anew")
            continue
        _say(f"{item}: {(ITEMS[item].__doc__ or '').splitlines()[0]}")
        begun = time.perf_counter()
        files = _write(folder, item, ITEMS[item](plan, store))
        seconds = time.perf_counter() - begun
        manifest["items"][item] = {"seconds": seconds, "finished": now(), "files": files} | provenance()
        write_json(folder / "manifest.json", manifest)
        _say(f"{item} done in {seconds:.1f} s")
        _report(folder, plan, manifest)
    _report(folder, plan, manifest)
    return manifest


def _open(folder: Path, plan: Plan, force: bool) -> dict[str, Any]:
    """The manifest of the folder, with the items whose files are all there, if they are of this format."""
    path = folder / "manifest.json"
    arguments = json.loads(json.dumps(asdict(plan)))
    if folder.exists() and not path.exists() and not is_empty(folder) and not force:
        raise ValueError(f"the output folder {folder} holds other files; choose another or add --force")
    manifest: dict[str, Any] = {"format": FORMAT, "plan": arguments, "items": {}}
    if path.exists():
        try:
            saved = json.loads(path.read_text(encoding="utf-8"))
            whole = {name: item for name, item in saved["items"].items() if _is_whole(folder, item)}
            planned = saved["plan"]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(
                f"{path} is no manifest of this command ({error}); choose another folder"
            ) from error
        if saved.get("format") != FORMAT:
            _say(f"{folder} was filled by another version; all that is asked for is made anew")
        elif planned == arguments:
            manifest["items"] = whole
        elif not force:
            kind = "--quick" if planned.get("quick") else "full"
            other = next((name for name in arguments if planned.get(name) != arguments[name]), "quick")
            found = f"{folder} holds a {kind} run with {other} = {planned.get(other)}, not {arguments[other]}"
            raise ValueError(f"{found}; choose another or add --force")
    make_folder(folder)
    write_json(path, manifest)  # whoever is stopped at the first item finds the folder theirs
    return manifest


def _is_whole(folder: Path, item: dict[str, Any]) -> bool:
    return all((folder / name).is_file() for name in item["files"])


def _write(folder: Path, item: str, product: Product) -> list[str]:
    """The names of the files written."""
    files = []
    for ending, table in product.tables.items():
        files.append(f"{item}{ending}.csv")
        io.write_table(folder / files[-1], table)
    picture = folder / f"{item}.png"
    save_figure(picture, lambda: (product.figure, None))
    return [*files, picture.name] if picture.is_file() else files


def _report(folder: Path, plan: Plan, manifest: dict[str, Any]) -> None:
    made = [item for item in ITEMS if item in manifest["items"]]
    files = [folder / name for item in made for name in manifest["items"][item]["files"]]
    tables = {path.stem: read_table(path) for path in files if path.suffix == ".csv"}
    claims = judge_items(tables, plan, made)
    text = write_report(claims, plan, {item: manifest["items"][item] for item in made}, tables)
    with replacing(folder / "report.md", "w") as file:
        file.write(text)
    columns = {name: np.array([getattr(claim, name) for claim in claims]) for name in Claim._fields}
    io.write_table(folder / "report.csv", columns)


def read_table(path: Path) -> Table:
    """The columns of a table that `io.write_table` wrote: numbers, truth values, or text."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    return {name: _typed(np.array([row[i] for row in rows])) for i, name in enumerate(names)}


def _typed(column: np.ndarray) -> np.ndarray:
    if np.isin(column, ("True", "False")).all():
        return column == "True"
    try:
        return column.astype(float)
    except ValueError:
        return column


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
