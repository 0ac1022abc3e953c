"""Tissues drawn as label images, at any place and in any orientation."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.images.frame import Frame
from jaxtissue.images.shapes import FITTERS, INSIDE

BLOCK = 4  # voxels along each side of a block, whose points are looked at together


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
    steps = np.argwhere(np.ones(shape, bool))
    points = frame.to_domain(steps[:, ::-1] * sizes)
    locate = next(fitter.locate for fitter in FITTERS.values() if isinstance(domain, fitter.kind))
    marks = locate(domain, points)
    inside, voxels = marks == INSIDE, np.zeros(len(points), np.int64)
    if inside.any():
        voxels[inside] = labels[_nearest(points[inside], steps[inside], positions, domain)]
    return voxels.reshape(shape), marks.reshape(shape)


def _nearest(
    points: Float[np.ndarray, "p 3"], steps: Int[np.ndarray, "p 3"], positions: PositionsLike, domain: Tube | Domain
) -> Int[np.ndarray, " p"]:
    """The cell of each point, the center of a voxel with these indices."""
    if isinstance(domain, Tube):
        return np.asarray(label_points(points, positions, domain))
    crowd, found = Crowd(np.asarray(positions, float), domain), np.empty(len(points), int)
    order = np.lexsort((steps // BLOCK).T)
    groups = np.append(order, np.repeat(order[-1:], -len(order) % BLOCK**2))
    found[groups] = crowd.nearest_in_groups(points[groups].reshape(-1, BLOCK**2, 3)).ravel() % crowd.cells
    return found


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
