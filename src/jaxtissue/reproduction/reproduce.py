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

from jaxtissue.reproduction.claims import Claim
from jaxtissue.reproduction.experiments import FORMAT, QUICK, Plan, Store, Table
from jaxtissue.reproduction.items import ITEMS, Product
from jaxtissue.reproduction.report import judge_items, write_report
from jaxtissue.reproduction.workers import Workers
from jaxtissue.runs import storage
from jaxtissue.runs.plots import save_figure
from jaxtissue.runs.settings import now, provenance
from jaxtissue.system.files import (
    check_files,
    checksum,
    is_empty,
    make_folder,
    read_sealed,
    replacing,
    write_sealed,
)

_OWN = {"plan", "items"}  # only manifests of this command have them


def choose_items(names: Sequence[str]) -> list[str]:
    """The items of the given names, in the paper's order; none, or "all", means all of them.

    Raises `ValueError` for a name that is none, with those that are.

    >>> choose_items(["fig7", "fig5", "fig7"])
    ['fig5', 'fig7']
    """
    unknown = [name for name in names if name not in ITEMS and name != "all"]
    if unknown:
        raise ValueError(f"unknown item {unknown[0]!r}; use all, or some of {', '.join(ITEMS)}")
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
    another plan has filled, that is damaged (unless forced) or that can't be written.
    """
    store = Store(folder / "data", lambda text: _say(f"  {text}"), fresh=force, workers=workers or Workers())
    manifest = _open(folder, plan, force)
    for item in items:
        if item in manifest["items"] and not force:
            _say(f"{item} is already computed; add --force to compute it again")
            continue
        _say(f"{item}: {(ITEMS[item].__doc__ or '').splitlines()[0]}")
        begun = time.perf_counter()
        files = _write(folder, item, ITEMS[item](plan, store))
        seconds = time.perf_counter() - begun
        manifest["items"][item] = {"seconds": seconds, "finished": now(), "files": files} | provenance()
        write_sealed(folder / "manifest.json", manifest)
        _say(f"{item} done in {seconds:.1f} s")
        _report(folder, plan, manifest)
    _report(folder, plan, manifest)
    return manifest


def _open(folder: Path, plan: Plan, force: bool) -> dict[str, Any]:
    """The manifest of the folder, with the items whose files are all there, if they are of this format."""
    path = folder / "manifest.json"
    arguments = json.loads(json.dumps(asdict(plan)))
    if folder.exists() and not path.exists() and not is_empty(folder) and not force:
        raise ValueError(f"the output folder {folder} contains other files; choose another or add --force")
    manifest: dict[str, Any] = {"format": FORMAT, "plan": arguments, "items": {}}
    saved = _read_manifest(path, force) if path.exists() else manifest
    planned: dict[str, Any] = saved.get("plan", {})
    if saved.get("format") != FORMAT:
        if not force:
            _say(f"{folder} was written by another version of jaxtissue; the requested items are computed again")
        _forget(folder / "data")
    elif planned == arguments:
        whole = {name: item for name, item in saved["items"].items() if _is_whole(folder, name, item, force)}
        manifest["items"] = whole
    elif not force:
        kind = "--quick" if planned.get("quick") else "full"
        other = next((name for name in arguments if planned.get(name) != arguments[name]), "quick")
        found = f"{folder} contains a {kind} run with {other} = {planned.get(other)}, not {arguments[other]}"
        raise ValueError(f"{found}; choose another or add --force")
    make_folder(folder)
    write_sealed(path, manifest)  # a run stopped at the first item finds its own folder
    return manifest


def _read_manifest(path: Path, force: bool) -> dict[str, Any]:
    """What a manifest holds; one of before there were checksums has another format, and no more is read.

    Raises `ValueError` for that of another command, and for a damaged one; if forced, this counts as one of
    another format.
    """
    try:
        saved = read_sealed(path, "choose another folder or add --force")
    except ValueError:
        if force or _is_of_before(path):
            return {}
        raise
    if not saved.keys() >= _OWN:
        raise ValueError(f"{path} was not written by this command; choose another folder")
    return saved


def _is_of_before(path: Path) -> bool:
    """Whether a manifest is without a checksum since another version wrote it, not by damage."""
    try:
        saved = json.loads(path.read_bytes())
    except ValueError:
        return False
    if not (isinstance(saved, dict) and saved.keys() >= {*_OWN, "format"}):
        return False
    return "checksum" not in saved and saved["format"] != FORMAT


def _forget(data: Path) -> None:
    """Remove what another version kept, perhaps without checksums."""
    if data.is_dir():
        make_folder(data, [path.name for path in data.iterdir() if path.suffix in (".json", ".npz")])


def _is_whole(folder: Path, item: str, made: dict[str, Any], force: bool) -> bool:
    """Whether the files of an item are there. Raises `ValueError` for damaged ones, unless forced."""
    if not all((folder / name).is_file() for name in made["files"]):
        return False
    try:
        check_files(folder, made["files"], f"remove it and repeat the command to compute {item} again")
    except ValueError:
        if not force:
            raise
        return False
    return True


def _write(folder: Path, item: str, product: Product) -> dict[str, str]:
    """The files written, and their checksums."""
    paths = []
    for ending, table in product.tables.items():
        paths.append(folder / f"{item}{ending}.csv")
        storage.write_table(paths[-1], table)
    picture = folder / f"{item}.png"
    save_figure(picture, lambda: (product.figure, None))
    return {path.name: checksum(path) for path in [*paths, picture] if path.is_file()}


def _report(folder: Path, plan: Plan, manifest: dict[str, Any]) -> None:
    made = [item for item in ITEMS if item in manifest["items"]]
    files = [folder / name for item in made for name in manifest["items"][item]["files"]]
    tables = {path.stem: read_table(path) for path in files if path.suffix == ".csv"}
    claims = judge_items(tables, plan, made)
    text = write_report(claims, plan, {item: manifest["items"][item] for item in made}, tables)
    with replacing(folder / "report.md", "w") as file:
        file.write(text)
    columns = {name: np.array([getattr(claim, name) for claim in claims]) for name in Claim._fields}
    storage.write_table(folder / "report.csv", columns)


def read_table(path: Path) -> Table:
    """The columns of a table that `storage.write_table` wrote: numbers, truth values, or text."""
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
