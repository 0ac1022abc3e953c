"""Tissues drawn as label images, at any place and in any orientation."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.geometry.tube import Tube
from jaxtissue.images.frame import Frame
from jaxtissue.images.shapes import FITTERS, INSIDE


def draw_labels(
    domain: Any,
    positions: PositionsLike,
    labels: Int[np.ndarray, " n"],
    frame: Frame,
    sizes: Float[np.ndarray, "3"],
    shape: tuple[int, ...],
) -> tuple[Int[np.ndarray, "z y x"], Int[np.ndarray, "z y x"]]:
    """The tissue in an image: the label of each voxel, and where its center lies, as `Fitter.locate` marks it.

    Args:
        domain: What the tissue fills.
        positions: The positions of the backbones, [n, k].
        labels: The label of each cell, [n].
        frame: Where the domain lies.
        sizes: The sides of a voxel along x, y and z.
        shape: The numbers of voxels along z, y and x.

    Returns:
        The labels, 0 outside, and the marks, both [z, y, x].
    """
    points = frame.to_domain(np.argwhere(np.ones(shape, bool))[:, ::-1] * sizes)
    locate = next(fitter.locate for fitter in FITTERS.values() if isinstance(domain, fitter.kind))
    marks = locate(domain, points)
    inside, voxels = marks == INSIDE, np.zeros(len(points), np.int64)
    if inside.any():
        voxels[inside] = labels[label_points(points[inside], positions, domain)]
    return voxels.reshape(shape), marks.reshape(shape)


def draw_turned(
    tube: Tube,
    positions: PositionsLike,
    spacing: ArrayLike,
    axes: Float[np.ndarray, "3 3"],
    margin: float = 2.0,
) -> tuple[Int[np.ndarray, "z y x"], Frame]:
    """A tissue in the smallest image that leaves `margin` voxels round it, with the labels 1 to n, and its frame.

    Args:
        tube: The tube.
        positions: (axial, angle) of each backbone, [n, 2].
        spacing: The sides of a voxel along z, y and x.
        axes: The directions of the tube's x, y and z axes in the image, in rows.
        margin: In voxels.

    >>> image, frame = draw_turned(Tube(4, 0.5, 2), [[1, 0], [3, 0]], (1, 0.5, 0.5), np.eye(3))
    >>> image.shape, np.unique(image).tolist(), frame.origin.tolist()
    ((8, 12, 12), [0, 1, 2], [1.0, 3.0, 4.0])
    """
    sizes, along = np.asarray(spacing, float)[::-1], axes[0] * float(tube.length)
    round_axis = float(tube.basal_radius) * np.sqrt(np.maximum(1 - axes[0] ** 2, 0))
    low = np.minimum(along, 0) - round_axis - margin * sizes
    high = np.maximum(along, 0) + round_axis + margin * sizes
    frame = Frame(-low, axes)
    shape = tuple(np.ceil((high - low) / sizes).astype(int)[::-1].tolist())
    labels = np.arange(1, len(np.asarray(positions)) + 1)
    return draw_labels(tube, positions, labels, frame, sizes, shape)[0], frame
