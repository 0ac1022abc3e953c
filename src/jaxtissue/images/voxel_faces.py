"""Faces between voxels with different labels: their positions, normals and areas."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

REACH = 4.0  # voxels round a face from which its normal is taken
CHUNK = 50_000  # faces whose neighbors are held at a time


class VoxelFaces(NamedTuple):
    """The faces between voxels of different labels, each once, ordered by their pairs of labels.

    Attributes:
        labels: The labels on the two sides, the lower one first, [f, 2].
        middle: The middle of each face in steps of voxels, (x, y, z), [f, 3]; voxel (k, j, i) is at (i, j, k).
        axis: The axis that it stands across, [f]: 0 for x, 1 for y, 2 for z.
        sign: 1 where the first label is on the lower side along that axis, or else -1, [f].
    """

    labels: Int[np.ndarray, "f 2"]
    middle: Float[np.ndarray, "f 3"]
    axis: Int[np.ndarray, " f"]
    sign: Int[np.ndarray, " f"]

    def where(self, chosen: np.ndarray) -> "VoxelFaces":
        """Some of the faces."""
        return VoxelFaces(*(column[chosen] for column in self))

    def groups(self) -> tuple[Int[np.ndarray, "m 2"], Int[np.ndarray, " f"]]:
        """The pairs of labels, in order, and the row of each face among them."""
        if not len(self.axis):
            return np.empty((0, 2), int), np.empty(0, int)
        new = np.append(True, (np.diff(self.labels, axis=0) != 0).any(axis=1))
        return self.labels[new], np.cumsum(new) - 1


def find_faces(image: Int[np.ndarray, "z y x"]) -> VoxelFaces:
    """The faces between voxels of different labels of an image; the border of the image has none.

    >>> faces = find_faces(np.array([[[1, 1, 2], [1, 0, 2]]]))
    >>> faces.labels.tolist(), faces.middle[-1].tolist(), faces.axis.tolist(), faces.sign.tolist()
    ([[0, 1], [0, 1], [0, 2], [1, 2]], [1.5, 0.0, 0.0], [0, 1, 0, 0], [-1, -1, 1, 1])
    """
    parts = []
    for axis in range(3):
        along = 2 - axis  # of the image, whose order is (z, y, x)
        low, high = np.moveaxis(image, along, 0)[:-1], np.moveaxis(image, along, 0)[1:]
        at = np.argwhere(np.moveaxis(low != high, 0, along))
        step = np.eye(3, dtype=int)[along]
        pair = np.stack([image[tuple(at.T)], image[tuple((at + step).T)]], axis=-1).astype(np.int64)
        sign = np.where(pair[:, 0] < pair[:, 1], 1, -1)
        middle = (at + step / 2)[:, ::-1]
        parts.append((np.sort(pair, axis=1), middle, np.full(len(at), axis), sign))
    labels, middle, axis, sign = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return VoxelFaces(labels, middle, axis, sign).where(np.lexsort(labels.T[::-1]))


def face_normals(
    faces: VoxelFaces, spacing: Float[np.ndarray, "3"], rows: Int[np.ndarray, " m"] | None = None
) -> Float[np.ndarray, "m 3"]:
    """The unit normal of the wall at each face, from the first to the second label, in (x, y, z).

    It is the direction of the sum of all oriented faces of the same wall within `REACH` voxels, each by the weight
    (1 - (distance / `REACH`)^2)^2; for a flat wall that is the wall's own.

    Args:
        faces: The faces.
        spacing: The sides of a voxel along x, y and z.
        rows: The faces whose normals are asked for; all if None.
    """
    rows = np.arange(len(faces.axis)) if rows is None else rows
    if not len(rows):
        return np.empty((0, 3))
    area = np.prod(spacing) / spacing[faces.axis] * faces.sign
    total = np.zeros((len(rows), 3))
    wall = faces.groups()[1]
    place = np.column_stack([faces.middle, 4 * REACH * wall])  # other walls are out of reach
    ends = np.append(np.arange(0, len(rows), CHUNK), len(rows))
    tree = KDTree(place)
    for begin, end in pairwise(ends.tolist()):
        near = KDTree(place[rows[begin:end]]).sparse_distance_matrix(tree, REACH, output_type="coo_matrix")
        weight = (1 - (near.data / REACH) ** 2) ** 2 * area[near.col]
        for axis in range(3):
            signed = np.where(faces.axis[near.col] == axis, weight, 0.0)
            total[begin:end, axis] = np.bincount(near.row, signed, end - begin)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    own = np.eye(3)[faces.axis[rows]] * faces.sign[rows, None]
    return np.where(length > 0, total / np.where(length > 0, length, 1), own)


def face_areas(
    faces: VoxelFaces, normals: Float[np.ndarray, "f 3"], spacing: Float[np.ndarray, "3"]
) -> Float[np.ndarray, " f"]:
    """The area of the wall that each face stands for: its own times the cosine between it and the wall.

    A wall of the normal n and the area A crosses faces of the area |n_k| A along each axis k, so the sum is A.
    """
    rows = np.arange(len(faces.axis))
    return np.prod(spacing) / spacing[faces.axis] * np.abs(normals[rows, faces.axis])
