"""Checks of label images, and removal of specks and of background lines between cells."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

LINES = 0.1  # of the faces where cells touch: with fewer voxels between cells, these are not lines
FEW = 1  # equal voxels among the six round a voxel, up to which it is a speck


def as_labels(image: Any) -> Int[np.ndarray, "z y x"]:
    """A label image as an array of whole numbers, 0 outside. Raises `ValueError` for what is none.

    >>> as_labels([[1, 2], [3, 4]])
    Traceback (most recent call last):
    ValueError: the image has 2 dimensions (shape (2, 2)); give a 3D label image with axes (z, y, x)
    """
    given = np.asarray(image)
    if given.ndim == 4 and given.shape[-1] in (3, 4):
        raise ValueError(f"the image has colors (shape {given.shape}); give a 3D label image, one number per voxel")
    if given.ndim != 3:
        told = f"the image has {given.ndim} dimensions (shape {given.shape})"
        raise ValueError(f"{told}; give a 3D label image with axes (z, y, x)")
    if given.dtype == bool:
        raise ValueError("the image is a mask (true or false); give each cell its own number")
    if given.dtype.kind not in "iu":
        raise ValueError(
            f"the image has numbers of type {given.dtype}; labels must be whole numbers, with 0 outside the tissue"
        )
    if given.size == 0:
        raise ValueError(f"the image of shape {given.shape} has no voxels; give a 3D label image")
    if given.min() < 0:
        raise ValueError(
            f"the image has the label {given.min()}; labels must be 0 outside the tissue and above 0 inside"
        )
    if not given.any():
        raise ValueError("the image contains only the label 0; give a label image with one number per cell")
    return given


def as_spacing(spacing: Any) -> Float[np.ndarray, "3"]:
    """The sides of a voxel along z, y and x. Raises `ValueError` for what is none."""
    try:
        values = np.array([float(side) for side in spacing])
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (3,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(f"spacing={spacing} is invalid; give the three sides of a voxel along z, y and x, above 0")
    return values


def close_gaps(image: Int[np.ndarray, "z y x"]) -> Int[np.ndarray, "z y x"]:
    """Give the voxels of label 0 between two cells, as a watershed leaves them, to one of these.

    Such a voxel has another label on either side of it, in one of 13 directions; one where such lines meet, once
    these are filled. An image whose cells touch each other, and that has few such voxels, comes back as it is.

    >>> close_gaps(np.array([[[1, 1, 0, 2, 2, 0]]])).tolist()
    [[[1, 1, 1, 2, 2, 0]]]
    """
    filled, touching = image.copy(), _count_touching(image)
    for turn in range(2):
        padded = np.pad(filled, 1)
        gap, label = np.zeros(filled.shape, bool), np.zeros_like(filled)
        for step in list(np.ndindex(3, 3, 3))[:13]:  # one of each two opposite directions
            before, behind = _shifted(padded, step), _shifted(padded, tuple(2 - along for along in step))
            here = (filled == 0) & (before > 0) & (behind > 0) & (before != behind)
            label = np.where(here & ~gap, before, label)
            gap |= here
        if turn == 0 and np.count_nonzero(gap) <= LINES * touching:
            return image
        filled = np.where(gap, label, filled)
    return filled


def remove_specks(image: Int[np.ndarray, "z y x"]) -> Int[np.ndarray, "z y x"]:
    """Give every voxel that at most one of the six round it equals the most frequent label of the 26 round it.

    Walls and edges between cells stay: there each voxel has two and more of its own label beside it.
    """
    padded = np.pad(image, 1, mode="edge")
    same = np.zeros(image.shape, np.int8)
    for axis in range(3):
        for along in (0, 2):
            same += _shifted(padded, tuple(along if other == axis else 1 for other in range(3))) == image
    at = np.argwhere(same <= FEW)
    steps = np.array([step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)])
    cleaned = image.copy()
    for part in np.array_split(at, len(at) // 100_000 + 1):
        around = np.sort(padded[tuple((part[:, None] + steps).transpose(2, 0, 1))], axis=1)
        cleaned[tuple(part.T)] = _modes(around)
    return cleaned


def touches_border(image: Int[np.ndarray, "z y x"], labels: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether each of the labels has a voxel at the border of the image."""
    border = [np.moveaxis(image, axis, 0)[end].ravel() for axis in range(3) for end in (0, -1)]
    return np.isin(labels, np.unique(np.concatenate(border)))


def _count_touching(image: Int[np.ndarray, "z y x"]) -> int:
    """The number of faces between voxels of two cells."""
    count = 0
    for axis in range(3):
        low, high = np.moveaxis(image, axis, 0)[:-1], np.moveaxis(image, axis, 0)[1:]
        count += int(np.count_nonzero((low != high) & (low > 0) & (high > 0)))
    return count


def _shifted(padded: np.ndarray, start: tuple[int, ...]) -> np.ndarray:
    """Of an image that is one voxel wider on each side, the part of its size that begins at a voxel."""
    return padded[tuple(slice(begin, begin + size - 2) for begin, size in zip(start, padded.shape, strict=True))]


def _modes(ordered: Int[np.ndarray, "v k"]) -> Int[np.ndarray, " v"]:
    """The most frequent value of each row of rows in order."""
    row, last = np.arange(len(ordered)), np.zeros(len(ordered), int)
    run, best = np.zeros(len(ordered), int), np.zeros(len(ordered), int)
    for k in range(ordered.shape[1]):
        run = np.where((k > 0) & (ordered[:, k] == ordered[:, max(k - 1, 0)]), run + 1, 1)
        last, best = np.where(run > best, k, last), np.maximum(run, best)
    return ordered[row, last]
