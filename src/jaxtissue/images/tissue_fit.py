"""A tissue fitted to an image of labels: its domain, its backbones, and how well it describes the image."""

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.images.backbone_fit import WallPoints, fit_backbones
from jaxtissue.images.drawing import draw_labels
from jaxtissue.images.frame import Frame
from jaxtissue.images.label_cells import LabelCells, measure_labels
from jaxtissue.images.label_images import as_labels, as_spacing, close_gaps, remove_specks, touches_border
from jaxtissue.images.shapes import FITTERS, INSIDE
from jaxtissue.images.voxel_faces import find_faces
from jaxtissue.system.frames import as_frame
from jaxtissue.topology.statistics import Connectivity, find_connectivity, tabulate_connectivity

POOR = 0.8  # of the image's voxels: where fewer are the same, the shape is doubted
GAP = 0.02  # of a cell's voxels, which lie where the image has no cell, that make it one beside a gap


@dataclass(frozen=True)
class TissueFit:
    """A tissue that describes an image of labels.

    Attributes:
        domain: What the tissue fills, in the image's unit of length.
        positions: The position of each backbone, [n, 2]; of a tube (axial, angle).
        labels: The label of each backbone's cell in the image, rising, [n].
        frame: Where the domain lies in the image.
        voxels: The image that the model gives, of the image's shape, 0 outside.
        cells: The cells as the image shows them, without specks, in the order of the backbones.
        beside_gap: Whether the cell of the model takes up space where the image has no cell, as beside one that was not
            segmented, [n].
        report: How well the model describes the image. `voxels_same` is the share of the image's labeled voxels that
            the model labels the same, and `voxels_missing` that of the model's which the image leaves 0.
            `neighbors_kept` is the share of the image's pairs of neighbors that are neighbors in the model.
            `volume_error` is the root mean square of model - image over the mean cell, of the cells that are neither at
            the border of the image nor beside a gap. `cells_at_border` and `cells_beside_gap` count these.
    """

    domain: Any
    positions: Float[np.ndarray, "n 2"]
    labels: Int[np.ndarray, " n"]
    frame: Frame
    voxels: Int[np.ndarray, "z y x"]
    cells: LabelCells
    beside_gap: Bool[np.ndarray, " n"]
    report: dict[str, float]

    @cached_property
    def connectivity(self) -> Connectivity:
        """Contacts, transition points and sizes of the model's cells, in the order of the backbones."""
        return find_connectivity(self.positions, self.domain)

    def columns(self) -> dict[str, np.ndarray]:
        """The table of cells, a column by name: as the image shows them (`image_`) and as the model has them."""
        inside = self.frame.to_domain(self.cells.centroid)
        columns = {"label": self.labels, "axial": self.positions[:, 0], "angle": self.positions[:, 1]}
        columns |= dict(zip(("centroid_x", "centroid_y", "centroid_z"), inside.T, strict=True))
        measured = self.cells.columns()
        flag = measured.pop("at_border")
        for name in ("label", "x", "y", "z"):
            measured.pop(name)
        columns |= {f"image_{name}": column for name, column in measured.items()}
        sizes, table = self.connectivity.sizes, tabulate_connectivity(self.connectivity)
        if sizes is not None:
            for name in ("volume", "lateral_area", "apical_area", "basal_area"):
                columns[f"model_{name}"] = np.asarray(getattr(sizes, name))
        columns |= {f"model_{name}": table[name] for name in measured if name in table}
        columns |= {"model_is_end": self.connectivity.is_end}
        return columns | {"at_border": flag, "beside_gap": self.beside_gap}

    def to_pandas(self) -> Any:
        """The cells as a pandas `DataFrame`, with one row for each.

        Raises:
            ImportError: If pandas is not installed.
        """
        return as_frame(self.columns())

    def __repr__(self) -> str:
        report = self.report
        told = f"{report['voxels_same']:.1%} of the voxels the same, {report['neighbors_kept']:.1%} of the neighbors"
        return f"TissueFit({len(self.labels)} cells in {self.domain!r}: {told})"


def fit_tissue(image: Any, spacing: Any, shape: str = "tube") -> TissueFit:
    """Find the tissue whose cells run where a segmented image shows them (paper, Definition 3, inverted).

    The domain is fitted to the surface of all labels, robustly. The backbones are those for which the points x on the
    walls between the cells i and j are equally far from both, d_i(x)^2 = d_j(x)^2: a sparse least-squares problem that
    is solved from the cells' centroids on, with little weight for outliers. Specks of one voxel are removed before, and
    lines of label 0 between the cells are closed. Cells that were not segmented, with label 0, are tolerated; their
    neighbors fill the gap in the model, and are flagged. Where the border of the image cuts the tissue, the domain goes
    on beyond it as far as the backbones of the cells there stand.

    Args:
        image: Labels in the order (z, y, x), whole numbers, 0 outside the tissue.
        spacing: The sides of a voxel along z, y and x.
        shape: The shape of the domain.

    Returns:
        Domain, backbones, where they lie in the image, and how well they describe it.

    Raises:
        ValueError: If `measure_labels` refuses the image or the spacing, if it has less than two cells, or if the shape
            is unknown or can't be fitted.

    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(6, 1, 3)
    >>> positions = np.array([[1.5, 0.0], [1.5, 2.1], [1.5, 4.2], [4.5, 1.0], [4.5, 3.1], [4.5, 5.2]])
    >>> from jaxtissue.diagram.labels import label_image
    >>> fit = fit_tissue(label_image(positions, tube, 0.25), (0.25, 0.25, 0.25))
    >>> bool(np.abs(fit.positions - positions).max() < 0.1), fit.report["voxels_same"] > 0.99
    (True, True)
    """
    if shape not in FITTERS:
        raise ValueError(f"shape={shape!r} can't be fitted; give one of {', '.join(FITTERS)}")
    fitter, given, sizes = FITTERS[shape], as_labels(image), as_spacing(spacing)[::-1]
    cleaned = remove_specks(close_gaps(given))
    labels, dense = np.unique(cleaned, return_inverse=True)
    labels, dense = labels[labels > 0].astype(np.int64), dense.reshape(given.shape) + int(labels[0] > 0)
    if len(labels) < 2:
        found = f"one label only, {labels[0]}" if len(labels) else "no cell of more than single voxels"
        raise ValueError(f"the image has {found}; give each cell a label of its own")
    domain, frame = fitter.domain(cleaned, sizes)
    points = frame.to_domain(np.argwhere(dense > 0)[:, ::-1] * sizes)
    start = fitter.start(domain, points, dense[dense > 0] - 1, len(labels))
    walls, step = _wall_points(dense, sizes, frame), float(np.prod(sizes) ** (1 / 3))
    free = touches_border(cleaned, labels)[:, None]
    positions = fit_backbones(
        domain, start, walls, step, lambda place: np.where(free, place, fitter.settle(domain, place))
    )
    domain, frame, positions = fitter.enclose(domain, frame, positions)
    voxels, marks = draw_labels(domain, positions, labels, frame, sizes, given.shape)
    beside = _find_beside(voxels, cleaned, labels)
    cells = measure_labels(cleaned, sizes[::-1], np.where(marks == INSIDE, 0, marks))
    fit = TissueFit(domain, positions, labels, frame, voxels.astype(given.dtype), cells, beside, {})
    fit.report.update(_report(fit, given))
    if fit.report["voxels_same"] < POOR:
        told = f"the {shape} labels only {fit.report['voxels_same']:.0%} of the image's voxels as the image does"
        warnings.warn(f"{told}; look whether the tissue is a {shape}, and its labels are cells", stacklevel=2)
    return fit


def _find_beside(
    voxels: Int[np.ndarray, "z y x"], cleaned: Int[np.ndarray, "z y x"], labels: Int[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Which cells of the model reach, by more than layers of voxels, into what the image leaves 0."""
    from scipy import ndimage

    gap = ndimage.binary_opening((voxels > 0) & (cleaned == 0), ndimage.generate_binary_structure(3, 1))
    filled, whole = (
        np.bincount(np.searchsorted(labels, part[part > 0]), minlength=len(labels))
        for part in (np.where(gap, voxels, 0), voxels)
    )
    return filled > GAP * np.maximum(whole, 1)


def _wall_points(dense: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"], frame: Frame) -> WallPoints:
    """The middles of the voxel faces between two cells."""
    faces = find_faces(dense)
    faces = faces.where(faces.labels[:, 0] > 0)
    areas = np.prod(sizes) / sizes[faces.axis]
    return WallPoints(frame.to_domain(faces.middle * sizes), faces.labels - 1, areas)


def _report(fit: TissueFit, given: Int[np.ndarray, "z y x"]) -> dict[str, float]:
    """How well a fit describes the image."""
    labeled, modeled = given > 0, fit.voxels > 0
    mine = {tuple(pair) for pair in fit.labels[fit.connectivity.contacts.pairs].tolist()}
    seen = {tuple(pair) for pair in fit.cells.pairs.tolist()}
    sizes, whole = fit.connectivity.sizes, ~(fit.cells.at_border | fit.beside_gap)
    error = math.nan
    if sizes is not None and whole.any():
        off = (np.asarray(sizes.volume) - fit.cells.volume)[whole] / fit.cells.volume.mean()
        error = float(np.sqrt((off**2).mean()))
    return {
        "voxels_same": float((fit.voxels == given)[labeled].mean()),
        "voxels_missing": float((~labeled)[modeled].mean()) if modeled.any() else math.nan,
        "neighbors_kept": len(mine & seen) / len(seen) if seen else math.nan,
        "volume_error": error,
        "cells": len(fit.labels),
        "cells_at_border": int(fit.cells.at_border.sum()),
        "cells_beside_gap": int(fit.beside_gap.sum()),
    }
