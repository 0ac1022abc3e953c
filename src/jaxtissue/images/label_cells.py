"""Measurement of cells in a label image, without a model: volumes, walls, neighbors and their kinds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.images.label_images import as_labels, as_spacing, close_gaps, touches_border
from jaxtissue.images.outside import APICAL, BASAL, as_sides, find_sides
from jaxtissue.images.voxel_faces import VoxelFaces, face_areas, face_normals, find_faces
from jaxtissue.system.frames import as_frame

KINDS = np.array(["internal", "apical", "basal", "apical_basal"])  # by surfaces reached: apical 1, basal 2


@dataclass(frozen=True)
class LabelCells:
    """Cells of a label image, measured from its voxels alone. Lengths are in the unit of the voxel spacing.

    Attributes:
        labels: Label of each cell, in increasing order, shape [n].
        volume: Volume of each cell, shape [n].
        centroid: Centroid (x, y, z) of each cell, shape [n, 3]. Voxel [k, j, i] has its center at (i dx, j dy, k dz).
        lateral_area: Area of the walls that each cell shares with other cells, shape [n].
        apical_area: Area of each cell on the side of the lumen, shape [n]. None if the two sides cannot be
            distinguished.
        basal_area: Area of each cell on the outer side, shape [n]. None if the two sides cannot be distinguished.
        at_border: Whether each cell has voxels at the border of the image, where it may be cut off, booleans, shape
            [n].
        pairs: Labels a < b of the two cells of each contact, shape [m, 2].
        wall_area: Area of the wall of each contact, shape [m].
        kind: Surfaces that each wall reaches, strings, shape [m]: "apical_basal" (both), "apical", "basal" or
            "internal" (neither). None if the two sides cannot be distinguished.
        sides: How apical and basal were distinguished: "given" (by the caller), "components" (the lumen is an enclosed
            component of the background), "slices" (the lumen is enclosed in slices of the image), or None (not
            distinguished).
    """

    labels: Int[np.ndarray, " n"]
    volume: Float[np.ndarray, " n"]
    centroid: Float[np.ndarray, "n 3"]
    lateral_area: Float[np.ndarray, " n"]
    apical_area: Float[np.ndarray, " n"] | None
    basal_area: Float[np.ndarray, " n"] | None
    at_border: Bool[np.ndarray, " n"]
    pairs: Int[np.ndarray, "m 2"]
    wall_area: Float[np.ndarray, " m"]
    kind: np.ndarray | None
    sides: str | None

    @property
    def neighbors(self) -> Int[np.ndarray, " n"]:
        """Number of neighbors of each cell, shape [n]."""
        return self._degree(np.ones(len(self.pairs), bool))

    @property
    def is_scutoid(self) -> Bool[np.ndarray, " n"] | None:
        """Whether each cell has a wall that does not reach both surfaces, shape [n]. None if `kind` is None."""
        return None if self.kind is None else self._degree(self.kind != "apical_basal") > 0

    def columns(self) -> dict[str, np.ndarray]:
        """Tabulate the cells: mapping from column name to an array of shape [n]."""
        columns = {"label": self.labels, "volume": self.volume}
        columns |= dict(zip(("x", "y", "z"), self.centroid.T, strict=True))
        columns |= {"lateral_area": self.lateral_area}
        if self.apical_area is not None and self.basal_area is not None:
            columns |= {"apical_area": self.apical_area, "basal_area": self.basal_area}
        columns |= {"neighbors": self.neighbors}
        if self.kind is not None:
            columns |= {f"{kind}_neighbors": self._degree(self.kind == kind) for kind in KINDS[::-1]}
        if self.is_scutoid is not None:
            columns |= {"is_scutoid": self.is_scutoid}
        return columns | {"at_border": self.at_border}

    def to_pandas(self) -> Any:
        """Convert to a pandas `DataFrame` with one row per cell.

        Raises:
            ImportError: If pandas is not installed.
        """
        return as_frame(self.columns())

    def _degree(self, chosen: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " n"]:
        at = np.searchsorted(self.labels, self.pairs[chosen].ravel())
        return np.bincount(at, minlength=len(self.labels))

    def __repr__(self) -> str:
        inner = ~self.at_border
        told = [f"{inner.sum()} not at the border of the image", f"volume {self.volume.mean():.4g}"]
        told += [f"{self.neighbors[inner].mean():.3g} neighbors"] if inner.any() else []
        told += [f"{self.is_scutoid[inner].mean():.3g} scutoids"] if inner.any() and self.is_scutoid is not None else []
        return f"LabelCells({len(self.labels)} cells, {', '.join(told)})"


def measure_labels(image: Any, spacing: Any, sides: Any = None, threshold: float = 0.0) -> LabelCells:
    """Measure the cells of a segmented image from its voxels alone, without a model.

    To fit a model to the image, use `fit_tissue`. Volumes are voxel counts. Areas are sums over voxel faces, each
    weighted by the cosine of its angle to the wall, whose normal is estimated from the faces within four voxels. For
    flat walls and for spheres with a radius of at least 5 voxels, areas are accurate to 1 %; unweighted faces would
    overestimate them by up to 73 %. Lines of label 0 between cells, one voxel wide as left by a watershed, are assigned
    to the cells. The number of neighbors depends on the smallest walls, which are only as accurate as the voxels; use
    `threshold` to omit them.

    Args:
        image: Label image with axes (z, y, x): integers of at least 0, with 0 outside the tissue.
        spacing: Sides (dz, dy, dx) of a voxel, in any length unit.
        sides: Marks of the background voxels, an integer array of the shape of `image`: 1 apical, 2 basal, 0 neither.
            Defaults to None: background enclosed by the tissue, in the image or in its slices, is taken as the lumen
            (apical).
        threshold: Omit walls smaller than this fraction of the mean wall area. Defaults to 0.

    Returns:
        A `LabelCells` with one entry per label in `labels`, `volume`, `centroid`, `lateral_area`, `apical_area`,
        `basal_area`, `neighbors`, `is_scutoid` and `at_border` (shape [n]), and one entry per wall in `pairs`,
        `wall_area` and `kind`. Lengths are in the unit of `spacing`.

    Raises:
        ValueError: If `image` is not a 3D array of integers of at least 0, if it has no label but 0, or if `spacing`,
            `sides` or `threshold` is invalid.

    >>> image = np.zeros((6, 6, 12), int)
    >>> image[1:5, 1:5, 1:6], image[1:5, 1:5, 6:11] = 1, 2
    >>> cells = measure_labels(image, (1, 0.5, 0.5))
    >>> cells.volume.tolist(), cells.pairs.tolist(), cells.wall_area.round(2).tolist()
    ([20.0, 20.0], [[1, 2]], [8.0])
    """
    image, steps = as_labels(image), as_spacing(spacing)
    if not threshold >= 0:
        raise ValueError(f"threshold={threshold} is not at least 0; give a fraction of the mean wall area")
    image = close_gaps(image)
    marks, how = find_sides(image) if sides is None else (as_sides(sides, image), "given")
    labels, dense = _number(image)
    count, sizes = len(labels), steps[::-1]
    pairs, area, reached = _walls(dense, marks, sizes, count)
    known = how is not None
    kept = area >= threshold * (area.mean() if len(area) else 0)
    pairs, area, reached = pairs[kept], area[kept], reached[kept]
    surfaces = _surfaces(dense, marks, sizes, count)
    return LabelCells(
        labels,
        np.bincount(dense.ravel(), minlength=count + 1)[1:] * float(steps.prod()),
        _centroids(dense, count) * sizes,
        np.bincount(pairs.ravel(), np.repeat(area, 2), count),
        surfaces[APICAL] if known else None,
        surfaces[BASAL] if known else None,
        touches_border(image, labels),
        labels[pairs],
        area,
        KINDS[reached] if known else None,
        how,
    )


def _number(image: Int[np.ndarray, "z y x"]) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, "z y x"]]:
    """The labels of an image, rising, and the image with 0 and the numbers 1 to n in their place."""
    found, dense = np.unique(image, return_inverse=True)
    outside = int(found[0] == 0)
    return found[outside:].astype(np.int64), dense.reshape(image.shape) + (1 - outside)


def _centroids(dense: Int[np.ndarray, "z y x"], count: int) -> Float[np.ndarray, "n 3"]:
    """The centroid of each cell in steps of voxels, (x, y, z)."""
    at = np.nonzero(dense)
    cell = dense[at] - 1
    total = np.bincount(cell, minlength=count)
    return np.stack([np.bincount(cell, along, count) for along in at[::-1]], axis=-1) / total[:, None]


def _walls(
    dense: Int[np.ndarray, "z y x"], marks: np.ndarray, sizes: Float[np.ndarray, "3"], count: int
) -> tuple[Int[np.ndarray, "m 2"], Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """The pairs of cells (from 0) that touch, the area of their wall, and which surfaces it reaches.

    Walls are continued beyond the surfaces by a voxel, each voxel there having the label of the nearest cell: a face
    that is half inside counts half, and a wall that reaches a surface goes on beyond it.
    """
    from scipy import ndimage

    inside = dense > 0
    found: Any = ndimage.distance_transform_edt(~inside, sampling=sizes[::-1], return_indices=True)
    away, nearest = found
    wide = np.where(away <= 1.01 * sizes.max(), dense[tuple(nearest)], 0)
    faces = find_faces(wide)
    faces = faces.where(faces.labels[:, 0] > 0)
    low, high = _beside(faces)
    share = (inside[low].astype(float) + inside[high]) / 2
    area = face_areas(faces, face_normals(faces, sizes), sizes) * share
    pairs, wall = faces.groups()
    reached = np.zeros(len(pairs), int)
    for side in (APICAL, BASAL):
        here = (share < 1) & ((marks[low] == side) | (marks[high] == side))
        reached[np.unique(wall[here])] |= side
    total = np.bincount(wall, area, len(pairs))
    real = np.bincount(wall, share == 1, len(pairs)) > 0  # cells that touch inside
    return pairs[real] - 1, total[real], reached[real]


def _beside(faces: VoxelFaces) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """The indices (z, y, x) of the voxels below and above each face."""
    step = np.eye(3)[faces.axis] / 2
    ends = (faces.middle - step, faces.middle + step)
    below, above = (tuple(end.round().astype(int).T[::-1]) for end in ends)
    return below, above


def _surfaces(
    dense: Int[np.ndarray, "z y x"], marks: np.ndarray, sizes: Float[np.ndarray, "3"], count: int
) -> dict[int, Float[np.ndarray, " n"]]:
    """The area of each cell on the apical and the basal surface."""
    faces = find_faces(np.where(dense > 0, count + 1, marks))  # the whole surface gives the normals
    faces = faces.where((faces.labels[:, 1] == count + 1) & (faces.labels[:, 0] > 0))
    low, high = _beside(faces)
    cell = np.maximum(dense[low], dense[high]) - 1
    area = face_areas(faces, face_normals(faces, sizes), sizes)
    return {
        side: np.bincount(cell[faces.labels[:, 0] == side], area[faces.labels[:, 0] == side], count)
        for side in (APICAL, BASAL)
    }
