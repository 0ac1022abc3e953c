"""A tissue fitted to an image, written as files from which the other commands continue."""

import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.images.image_files import read_image
from jaxtissue.images.tissue_fit import TissueFit, fit_tissue
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import BackboneTable
from jaxtissue.runs.run_folders import CELLS, FILES, FIT, FRAME, save_tissue
from jaxtissue.runs.settings import provenance
from jaxtissue.runs.viewing import leave_pictures
from jaxtissue.system.files import make_folder, write_json
from jaxtissue.system.locks import alone


def run_fit(path: Path, spacing: Any, shape: str, folder: Path, nodes: int = 1, flat: bool = False) -> dict[str, Any]:
    """Fit a tissue to the image in a file, write it into a folder with its page, and return the report.

    `flat` leaves out the pictures in three dimensions.
    Raises `ValueError` as `read_image` and `fit_tissue` do; nothing is written then.
    """
    read = read_image(path, spacing)
    begun = time.perf_counter()
    try:
        fit = fit_tissue(read.image, read.spacing, shape, nodes)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    columns = fit.columns()
    report = fit.report | {"seconds": time.perf_counter() - begun}
    about = {"image": str(path), "shape": shape, "nodes": nodes, "spacing": read.spacing, "unit": read.unit}
    with alone(folder):
        make_folder(folder, FILES)
        save_tissue(folder, fit.domain, BackboneTable(fit.positions, tuple(map(str, fit.labels.tolist()))))
        write_json(folder / FRAME, _frame(fit, read.unit))
        storage.write_table(folder / CELLS, columns)
        write_json(folder / FIT, report | about | {"voxels": read.image.shape} | provenance())
        tissue = TissueRecord(fit.positions, fit.domain, unit=read.unit or "", traced=fit.connectivity)
        leave_pictures(tissue, folder, flat)
    return report


def _frame(fit: TissueFit, unit: str | None) -> dict[str, Any]:
    """Where the domain lies in the image: the voxel (k, j, i) is centered at (i, j, k) times its sides."""
    axes = np.asarray(fit.frame.axes)
    return {"origin": fit.frame.origin.tolist(), "axes": axes.tolist(), "order": "x, y, z", "unit": unit}
