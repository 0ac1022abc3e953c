"""Cells as an image of labels shows them: sizes, walls, neighbors and their kinds, without a model."""

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
    """The cells of a label image, measured from its voxels alone; lengths have the unit of the spacing.

    Attributes:
        labels: The label of each cell, rising, [n].
        volume: Its volume, [n].
        centroid: Its centroid, (x, y, z), [n, 3]; the voxel (k, j, i) is centered at (i, j, k) times its sides.
        lateral_area: The area of its walls with other cells, [n].
        apical_area: The area of its surface towards the lumen, [n], or None where the sides can't be told.
        basal_area: The same towards the outside, [n].
        at_border: Whether it has voxels at the border of the image, where it may be cut, [n].
        pairs: The labels of each two cells that touch, the lower one first, [m, 2].
        wall_area: The area of their wall, [m].
        kind: Which surfaces the wall reaches, "apical_basal", "apical", "basal" or "internal", [m], or None.
        sides: How apical and basal were told apart: "given", "components" of the background, "slices" in which the
            lumen is enclosed, or None where they could not be.
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
        """The number of neighbors of each cell."""
        return self._degree(np.ones(len(self.pairs), bool))

    @property
    def is_scutoid(self) -> Bool[np.ndarray, " n"] | None:
        """Whether each cell has a neighbor that it does not touch on both surfaces; None where sides can't be told."""
        return None if self.kind is None else self._degree(self.kind != "apical_basal") > 0

    def columns(self) -> dict[str, np.ndarray]:
        """The table of cells, a column by name."""
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
        """The cells as a pandas `DataFrame`, with one row for each.

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

    Volumes are counts of voxels. Areas are sums over voxel faces, each weighed by the cosine between it and the wall,
    whose direction is that of the faces within four voxels; flat walls and spheres of 5 voxels' radius and more are
    within 1 %, where faces alone count up to 73 % too much. One voxel thick lines of label 0 between cells, as a
    watershed leaves them, are given to the cells. Counts of neighbors depend on the smallest walls, which an image
    shows only down to its voxels: a `threshold` leaves them out.

    Args:
        image: Labels in the order (z, y, x), whole numbers, 0 outside the tissue.
        spacing: The sides of a voxel along z, y and x.
        sides: Marks of the voxels outside, in the image's shape: 1 apical, 2 basal, 0 neither. Without it the lumen is
            looked for: parts of the background that are enclosed, in the image or in each of its slices.
        threshold: Walls smaller than this fraction of the mean wall are left out of the contacts.

    Returns:
        The cells and their contacts, in the unit of the spacing.

    Raises:
        ValueError: If the image is no volume of whole numbers from 0, has no label but 0, or if spacing, sides or
            threshold are not as above.

    >>> image = np.zeros((6, 6, 12), int)
    >>> image[1:5, 1:5, 1:6], image[1:5, 1:5, 6:11] = 1, 2
    >>> cells = measure_labels(image, (1, 0.5, 0.5))
    >>> cells.volume.tolist(), cells.pairs.tolist(), cells.wall_area.round(2).tolist()
    ([20.0, 20.0], [[1, 2]], [8.0])
    """
    image, steps = as_labels(image), as_spacing(spacing)
    if not threshold >= 0:
        raise ValueError(f"threshold={threshold}; give a fraction of the mean wall, 0 or more")
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
