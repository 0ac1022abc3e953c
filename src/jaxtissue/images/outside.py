"""The two sides of a tissue in an image: which voxels of the background are lumen, and which are outside."""

from typing import Any

import numpy as np
from jaxtyping import Int, Shaped

APICAL, BASAL = 1, 2  # marks of voxels of the background; 0: neither
LEAST = 0.002  # of the tissue's voxels: fewer are no lumen


def as_sides(sides: Any, image: Int[np.ndarray, "z y x"]) -> Shaped[np.ndarray, "z y x"]:
    """The marks of the background as given. Raises `ValueError` for other marks or another shape."""
    given = np.asarray(sides)
    if given.shape != image.shape or given.dtype.kind not in "biu":
        told = f"sides is an array of {given.dtype} of shape {given.shape}"
        raise ValueError(f"{told}; give whole numbers in the shape of the image, {image.shape}")
    if not np.isin(given, (0, APICAL, BASAL)).all():
        raise ValueError("sides contains values other than 0, 1 (apical) and 2 (basal); correct them")
    return given


def find_sides(image: Int[np.ndarray, "z y x"]) -> tuple[Shaped[np.ndarray, "z y x"], str | None]:
    """Mark the background as apical or basal, and say how: "components", "slices", or None where it can't be told.

    The lumen is apical: the connected parts of the background that reach no edge of the image, where two of its border
    planes meet. A lumen that is open within the image is looked for in slices, as what each of them encloses.
    """
    from scipy import ndimage

    background, least = image == 0, LEAST * np.count_nonzero(image)
    found: Any = ndimage.label(background)
    parts, count = found
    at_edges = np.zeros(count + 1, bool)
    for axis in range(3):
        across = np.moveaxis(parts, axis, 0)
        for first, second in np.ndindex(2, 2):
            at_edges[across[:, -first, -second]] = True
    inner = background & ~at_edges[parts]
    if np.count_nonzero(inner) >= least:
        return np.where(inner, APICAL, np.where(background, BASAL, 0)).astype(np.uint8), "components"
    holes = [_holes(~background, axis) for axis in range(3)]
    best = max(holes, key=np.count_nonzero)
    if np.count_nonzero(best) >= least:
        return np.where(best, APICAL, np.where(background, BASAL, 0)).astype(np.uint8), "slices"
    return np.zeros(image.shape, np.uint8), None


def _holes(tissue: np.ndarray, axis: int) -> np.ndarray:
    """What the tissue encloses in each slice across an axis."""
    from scipy import ndimage

    slices = np.moveaxis(tissue, axis, 0)
    return np.moveaxis(np.stack([ndimage.binary_fill_holes(part) & ~part for part in slices]), 0, axis)
