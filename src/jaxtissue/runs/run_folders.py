"""The tissue in the folder of a run, whichever command wrote it."""

from pathlib import Path

import numpy as np

from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domain_files import load_domain, save_domain
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.cell_meshes import TOLERANCE
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import BackboneTable, read_backbones
from jaxtissue.runs.formats import VIEWED, picture_name
from jaxtissue.runs.reports import CONTACT_TABLES
from jaxtissue.runs.settings import Settings
from jaxtissue.system.files import read_sealed
from jaxtissue.tissue.measurer import measure_tissue

DOMAIN, BACKBONES, MANIFEST, CHECKPOINT = "domain.json", "backbones.csv", "manifest.json", "checkpoint.npz"
INITIAL, SWEEPS, CELLS, SUMMARY = "initial_backbones.csv", "sweeps.csv", "cells.csv", "summary.json"
STEPS = "steps.csv"
FRAME, FIT, PAGE = "frame.json", "fit.json", "index.html"
FIGURES = ("energy.png", "volumes.png", "surfaces.png")
# all that commands leave in the folder of a tissue: another tissue there outdates it, whichever command brings it
FILES = (
    *(MANIFEST, CHECKPOINT, INITIAL, SWEEPS, STEPS, DOMAIN, BACKBONES, CELLS, SUMMARY, FRAME, FIT, PAGE),
    *(*CONTACT_TABLES, *FIGURES, *map(picture_name, VIEWED)),
)


def save_tissue(folder: Path, domain: Tube | Domain, backbones: BackboneTable) -> None:
    """Write the domain and the backbones of a tissue, as `read_tissue` finds them."""
    save_domain(domain, folder / DOMAIN)
    storage.write_backbones(folder / BACKBONES, *backbones, column_names(domain))


def read_tissue(folder: Path, unit: str = "", tolerance: float | None = None) -> TissueRecord:
    """Read the tissue in a folder written by the command `anneal`, `relax`, `measure` or `fit`.

    Args:
        folder: The folder.
        unit: Unit of length, such as "um". Defaults to "": unknown.
        tolerance: Tolerance of the meshes; see `mesh_cells`. Defaults to None: the default of `mesh_cells`.

    Returns:
        The tissue, with the positions after the stored sweeps of a run in `history`.

    Raises:
        ValueError: If the folder contains no tissue or an unfinished run.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; give a folder written by anneal, relax, measure or fit")
    history: dict[int, np.ndarray] = {}
    is_run = (folder / CHECKPOINT).is_file() or not (folder / DOMAIN).is_file()
    if is_run and (folder / MANIFEST).is_file():
        manifest = read_sealed(folder / MANIFEST, "write it again with jaxtissue anneal --resume --finish")
        if not (folder / BACKBONES).is_file():
            raise ValueError(
                f"the run in {folder} is not finished; continue it with: jaxtissue anneal --out {folder} --resume"
            )
        domain = Settings(**manifest["arguments"]).place
        positions, names = read_backbones(folder / BACKBONES, domain, bent=True)
        if (folder / CHECKPOINT).is_file():
            kept = storage.load_checkpoint(folder / CHECKPOINT)
            history = dict(zip(kept.kept_sweeps.tolist(), kept.kept_positions.astype(float), strict=True))
            history.setdefault(manifest["final"]["sweep"], positions)
    elif (folder / DOMAIN).is_file() and (folder / BACKBONES).is_file():
        domain = load_domain(folder / DOMAIN)
        positions, names = read_backbones(folder / BACKBONES, domain, bent=True)
    else:
        raise ValueError(
            f"{folder} contains no {BACKBONES} with {DOMAIN} or {MANIFEST}; give the folder of a run or a fit"
        )
    domain = domain_of(domain, positions)
    return TissueRecord(positions, domain, names, unit, history, tolerance or TOLERANCE, measure=measure_tissue)
