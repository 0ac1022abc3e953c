"""Fit of a tissue to a label image: domain, backbones, and agreement with the image.

Definition 3 is that of Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via
Backbone Spreads", GRAPP 2025 ("the paper").
"""

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.geometry.domain_positions import ends_in_space, place_columns
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.tube import Tube
from jaxtissue.images.backbone_fit import Positions, WallPoints, fit_backbones
from jaxtissue.images.drawing import draw_labels
from jaxtissue.images.frame import Frame
from jaxtissue.images.label_cells import LabelCells, measure_labels
from jaxtissue.images.label_images import as_labels, as_spacing, close_gaps, remove_specks, touches_border
from jaxtissue.images.node_start import start_nodes
from jaxtissue.images.shapes import FITTERS, INSIDE, Fitter
from jaxtissue.images.voxel_faces import find_faces
from jaxtissue.measurement.cell_geometry import SIZES
from jaxtissue.system.frames import as_frame
from jaxtissue.topology.statistics import Connectivity, find_connectivity, tabulate_connectivity

POOR = 0.8  # of the image's voxels: where fewer are the same, the shape is doubted
_SIZES = SIZES[:4]  # which images have too
LAYER = 2  # voxels at least from node to node
GAP = 0.02  # of a cell's voxels, which lie where the image has no cell, that make it one beside a gap


@dataclass(frozen=True)
class TissueFit:
    """Tissue fitted to a label image, as returned by `fit_tissue`. Lengths are in the unit of the voxel spacing.

    Attributes:
        domain: The fitted domain, a `Tube`, `Slab`, `Sphere` or `Ellipsoid`; a `RoundTube` for a tube with `nodes`.
        positions: Axial position and angle in radians of each backbone, or x and y, shape [n, 2], or unit vectors of
            shape [n, 3]. Of tilted and bent backbones those of their nodes, shape [n, k, 2] or [n, k, 3].
        labels: Label of the cell of each backbone in the image, in increasing order, shape [n].
        frame: Location of the domain in the image, with fields `origin` (shape [3]) and `axes` (unit vectors in rows,
            shape [3, 3]) and methods `to_domain` and `to_image`.
        voxels: Label image of the fitted model, of the shape of the given image, 0 outside.
        cells: Cells as measured in the given image after removal of isolated voxels, a `LabelCells` in the order of the
            backbones.
        beside_gap: Whether each cell of the model extends into voxels without a label in the image, for example next to
            a cell that was not segmented, booleans, shape [n].
        report: Agreement of model and image, numbers by name. `voxels_same`: fraction of the labeled voxels that have
            the same label in the model. `voxels_missing`: fraction of the model's voxels that have label 0 in the
            image. `neighbors_kept`: fraction of the neighbor pairs in the image that are neighbors in the model, by
            `connectivity`, or by `drawn` if that is None. `volume_error`: root-mean-square of the difference in
            volume, divided by the mean volume, over cells that are neither at the border of the image nor next to a
            gap. `cells`, `cells_at_border`, `cells_beside_gap`: numbers of cells.
        sizes: `volume`, `lateral_area`, `apical_area` and `basal_area` of each cell of the model by name, shape [n]: in
            a `Tube` from its traced edges, and empty if one could not be traced; in other domains those of `drawn`.
        drawn: Cells of the model as measured in `voxels`, as those of the image are, a `LabelCells`; cells without a
            voxel are missing. None in a `Tube`.
    """

    domain: Any
    positions: Positions
    labels: Int[np.ndarray, " n"]
    frame: Frame
    voxels: Int[np.ndarray, "z y x"]
    cells: LabelCells
    beside_gap: Bool[np.ndarray, " n"]
    report: dict[str, float]
    sizes: dict[str, Float[np.ndarray, " n"]]
    drawn: LabelCells | None = None

    @cached_property
    def connectivity(self) -> Connectivity | None:
        """Contacts and transition points of the cells of the model, a `Connectivity`.

        None, with a warning, where they cannot be found on another domain than a `Tube`.
        """
        try:
            return find_connectivity(self.positions, self.domain)
        except ValueError as error:
            if isinstance(self.domain, Tube):
                raise
            warnings.warn(f"contacts of the fitted cells are not computed: {error}", stacklevel=3)
            return None

    def columns(self) -> dict[str, np.ndarray]:
        """Tabulate the cells, as measured in the image (prefix `image_`) and in the model (prefix `model_`).

        Tilted and bent backbones have the coordinates of both ends (prefixes `apical_` and `basal_`). Without
        `connectivity`, the neighbors are those in `drawn`.

        Returns:
            Mapping from column name to an array of shape [n].
        """
        inside = self.frame.to_domain(self.cells.centroid)
        columns = {"label": self.labels}
        columns |= place_columns(self.positions, self.domain)
        columns |= dict(zip(("centroid_x", "centroid_y", "centroid_z"), inside.T, strict=True))
        measured = self.cells.columns()
        flag = measured.pop("at_border")
        for name in ("label", "x", "y", "z"):
            measured.pop(name)
        columns |= {f"image_{name}": column for name, column in measured.items()}
        columns |= {f"model_{name}": sizes for name, sizes in self.sizes.items()}
        if self.connectivity is not None:
            table = tabulate_connectivity(self.connectivity)
            columns |= {f"model_{name}": table[name] for name in measured if name in table}
            columns |= {"model_is_end": self.connectivity.is_end}
        elif self.drawn is not None:
            table = self.drawn.columns()
            columns |= {f"model_{name}": _of_labels(self.labels, self.drawn, table[name]) for name in measured
                        if name in table and name not in self.sizes}  # fmt: skip
        return columns | {"at_border": flag, "beside_gap": self.beside_gap}

    def to_pandas(self) -> Any:
        """Convert the table of `columns` to a pandas `DataFrame` with one row per cell.

        Raises:
            ImportError: If pandas is not installed.
        """
        return as_frame(self.columns())

    def __repr__(self) -> str:
        report = self.report
        told = f"{report['voxels_same']:.1%} of the voxels agree, {report['neighbors_kept']:.1%} of the neighbors"
        return f"TissueFit({len(self.labels)} cells in {self.domain!r}: {told})"


def fit_tissue(image: Any, spacing: Any, shape: str = "tube", nodes: int | None = None) -> TissueFit:
    """Fit a domain and its backbones to a segmented image (paper, Definition 3, inverted).

    The domain is fitted robustly to the surface of all labels. The backbones are then chosen such that points on the
    wall between cells i and j are at equal distance from both, d_i(x)^2 = d_j(x)^2: a sparse robust least-squares
    problem that starts from the centroids of the cells. Isolated voxels are removed first, and lines of label 0 between
    cells, as left by a watershed, are closed. Cells that were not segmented (label 0) are tolerated: in the model their
    neighbors fill the gap and are flagged in `beside_gap`. If the border of the image cuts the tissue, a tube or slab
    extends beyond it to contain the backbones of the cells there. A warning is issued if fewer than 80 % of the labeled
    voxels agree.

    With `nodes`, the backbones are tilted or bent: each is a polyline through k points at equally spaced heights. The
    fit then starts from the middles of the cells at these heights. Each node needs walls beside it, so nodes are less
    certain than straight backbones, the more so the more there are; a slight stiffness of the backbones places those
    that no walls determine.

    A slab has no lumen that tells its two sides apart: its apical surface is the one at the smaller coordinate along
    the axis of the image that is nearest to its normal. For the other choice flip the image along that axis.

    Args:
        image: Label image with axes (z, y, x): integers of at least 0, with 0 outside the tissue.
        spacing: Sides (dz, dy, dx) of a voxel, in any length unit.
        shape: Shape of the domain: "tube" (the default), "slab" for a flat sheet with backbones perpendicular to it,
            or "sphere" or "ellipsoid", these two closed around a lumen.
        nodes: Number of nodes k of each backbone: 2 for tilted and 3 or more for bent backbones. Defaults to None, or
            1: straight backbones, perpendicular to the surfaces of a slab and radial in a tube or sphere.

    Returns:
        A `TissueFit` with the domain, the backbones, their location in the image, and the agreement with the image.

    Raises:
        ValueError: If `image` or `spacing` is invalid, if the image has fewer than two cells, if `shape` is unknown
            or cannot be fitted, or if `nodes` is less than 1 or so large that nodes are less than two voxels apart.

    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(6, 1, 3)
    >>> positions = np.array([[1.5, 0.0], [1.5, 2.1], [1.5, 4.2], [4.5, 1.0], [4.5, 3.1], [4.5, 5.2]])
    >>> from jaxtissue.diagram.labels import label_image
    >>> fit = fit_tissue(label_image(positions, tube, 0.25), (0.25, 0.25, 0.25))
    >>> bool(np.abs(fit.positions - positions).max() < 0.1), fit.report["voxels_same"] > 0.99
    (True, True)
    """
    if shape not in FITTERS:
        raise ValueError(f"shape={shape!r} can't be fitted; use one of {', '.join(FITTERS)}")
    if nodes is not None and (isinstance(nodes, bool) or not isinstance(nodes, int | np.integer) or nodes < 1):
        told = "1 (straight backbones), 2 (tilted), or 3 or more (bent)"
        raise ValueError(f"nodes={nodes!r} is not a number of nodes; give {told}")
    fitter, given, sizes = FITTERS[shape], as_labels(image), as_spacing(spacing)[::-1]
    cleaned = remove_specks(close_gaps(given))
    labels, dense = np.unique(cleaned, return_inverse=True)
    labels, dense = labels[labels > 0].astype(np.int64), dense.reshape(given.shape) + int(labels[0] > 0)
    if len(labels) < 2:
        found = f"only one label, {labels[0]}" if len(labels) else "no cell larger than single voxels"
        raise ValueError(f"the image has {found}; give each cell its own label")
    domain, frame = fitter.domain(cleaned, sizes)
    start = _start(fitter, (domain, frame), dense, sizes, int(nodes or 1))
    domain = domain_of(domain, start)
    walls, step = _wall_points(dense, sizes, frame), float(np.prod(sizes) ** (1 / 3))
    free = touches_border(cleaned, labels).reshape(-1, *[1] * (start.ndim - 1))
    beyond = np.inf if start.ndim == 2 else math.sqrt(float(domain.basal_area) / len(labels))

    def settle(place: Positions) -> Positions:
        return np.where(free, fitter.settle(domain, place, beyond), fitter.settle(domain, place, 0.0))

    positions = fit_backbones(domain, start, walls, step, settle)
    domain, frame, positions = fitter.enclose(domain, frame, positions)
    voxels, marks = draw_labels(domain, positions, labels, frame, sizes, given.shape)
    beside, sides = _find_beside(voxels, cleaned, labels), np.where(marks == INSIDE, 0, marks)
    cells = measure_labels(cleaned, sizes[::-1], sides)
    drawn = None if isinstance(domain, Tube) else measure_labels(voxels, sizes[::-1], sides)
    fit = TissueFit(domain, positions, labels, frame, voxels.astype(given.dtype), cells, beside, {}, {}, drawn)
    fit.sizes.update(_sizes(fit))
    fit.report.update(_report(fit, given))
    if fit.report["voxels_same"] < POOR:
        told = (
            f"the fitted {shape} gives only {fit.report['voxels_same']:.0%} of the voxels the same label as the image"
        )
        warnings.warn(f"{told}; check that the tissue is a {shape} and that each label is one cell", stacklevel=2)
    return fit


def _start(
    fitter: Fitter, place: tuple[Any, Frame], dense: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"], nodes: int
) -> Positions:
    """The first positions of straight backbones, or of nodes. Raises `ValueError` for more than there are voxels."""
    domain, frame = place
    points, cells = frame.to_domain(np.argwhere(dense > 0)[:, ::-1] * sizes), dense[dense > 0] - 1
    middle = fitter.start(domain, points, cells, int(cells.max()) + 1)
    if nodes == 1:
        return middle
    apical, basal = ends_in_space(middle, domain)
    layers = float(np.linalg.norm(basal - apical, axis=1).mean() / np.prod(sizes) ** (1 / 3))
    if layers < LAYER * (nodes - 1):
        most = max(1, int(layers / LAYER) + 1)
        told = f"nodes={nodes} are too many for a tissue of {layers:.3g} voxels from surface to surface"
        raise ValueError(f"{told}; give at most {most}, or an image with finer voxels")
    above: Any = domain_of(domain, middle[:, None])
    return fitter.settle(above, start_nodes(above, middle, *fitter.invert(above, points), cells, nodes), 0.0)


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


def _sizes(fit: TissueFit) -> dict[str, Float[np.ndarray, " n"]]:
    """The sizes of the cells of the model."""
    if fit.drawn is not None:
        return {name: _of_labels(fit.labels, fit.drawn, getattr(fit.drawn, name)) for name in _SIZES}
    traced = fit.connectivity.sizes if fit.connectivity else None
    return {} if traced is None else {name: np.asarray(getattr(traced, name)) for name in _SIZES}


def _of_labels(labels: Int[np.ndarray, " n"], drawn: LabelCells, column: Any) -> np.ndarray:
    """A column of the cells that are drawn, for all labels; 0 for those without a voxel."""
    whole = np.zeros(len(labels), np.asarray(column).dtype)
    whole[np.searchsorted(labels, drawn.labels)] = column
    return whole


def _report(fit: TissueFit, given: Int[np.ndarray, "z y x"]) -> dict[str, float]:
    """How well a fit describes the image."""
    labeled, modeled = given > 0, fit.voxels > 0
    pairs = np.empty((0, 2), int) if fit.drawn is None else fit.drawn.pairs
    pairs = fit.labels[fit.connectivity.contacts.pairs] if fit.connectivity else pairs
    mine = {tuple(pair) for pair in pairs.tolist()}
    seen = {tuple(pair) for pair in fit.cells.pairs.tolist()}
    whole = ~(fit.cells.at_border | fit.beside_gap)
    error = math.nan
    if fit.sizes and whole.any():
        off = (fit.sizes["volume"] - fit.cells.volume)[whole] / fit.cells.volume.mean()
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
