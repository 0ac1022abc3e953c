"""Label images as OME-TIFF and OME-Zarr, with the size of their voxels and where they begin."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt16
from matplotlib.colors import to_rgba

from jaxtissue.diagram.labels import label_image
from jaxtissue.diagram.voxels import image_box
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.meshes.coloring import PALETTE, spread_colors
from jaxtissue.system.extras import optional

VOXELS = 2**31  # most of an image: two bytes each
CHUNK, SMALL = 128, 256  # voxels along the sides of a chunk, and of the coarsest copy of an image at most
_FINE = 10  # voxels along the side of a mean cell, where no spacing is given
_WRITTEN_OUT = {"nm": "nanometer", "um": "micrometer", "mm": "millimeter", "cm": "centimeter", "m": "meter"}
Spacing = tuple[float, float, float]


class Drawn(NamedTuple):
    """A label image, the sides of its voxels, and the center of its first voxel, along z, y and x."""

    labels: UInt16[np.ndarray, "z y x"]
    spacing: Spacing
    origin: Float[np.ndarray, "3"]


def write_ome_tiff(tissue: TissueRecord, folder: Path, spacing: Spacing | None) -> list[Path]:
    """Write labels.ome.tif: axes (z, y, x), 0 outside, cell index + 1 inside, with spacing, unit and origin."""
    tifffile = optional("tifffile", "io", "the format ome-tiff")
    drawn = draw(tissue, spacing)
    deep = len(drawn.labels)
    unit = {"um": "µm", "": "reference frame"}.get(tissue.unit, tissue.unit)
    metadata: dict[str, Any] = {"axes": "ZYX", "Name": "cell labels: 0 outside, cell number + 1 inside"}
    plane: dict[str, list[Any]] = {}
    for axis, side, place in zip("ZYX", drawn.spacing, drawn.origin.tolist(), strict=True):
        metadata |= {f"PhysicalSize{axis}": side, f"PhysicalSize{axis}Unit": unit}
        plane |= {f"Position{axis}": [place] * deep, f"Position{axis}Unit": [unit] * deep}
    plane["PositionZ"] = [drawn.origin[0] + level * drawn.spacing[0] for level in range(deep)]
    path = folder / "labels.ome.tif"
    tifffile.imwrite(path, drawn.labels, ome=True, metadata=metadata | {"Plane": plane}, compression="zlib")
    return [path]


def write_ome_zarr(tissue: TissueRecord, folder: Path, spacing: Spacing | None) -> list[Path]:
    """Write labels.ome.zarr, the same image as OME-Zarr 0.5, with the colors of the pictures.

    Each further copy has every second voxel of the copy before, until no side has more than `SMALL` voxels.
    """
    zarr = optional("zarr", "zarr", "the format ome-zarr")
    drawn = draw(tissue, spacing)
    path = folder / "labels.ome.zarr"
    group, step, copies = zarr.open_group(path, mode="w", zarr_format=3), 1, []
    while True:
        labels = np.ascontiguousarray(drawn.labels[::step, ::step, ::step])
        chunks = tuple(min(CHUNK, size) for size in labels.shape)
        options = {"chunks": chunks, "dimension_names": tuple("zyx")}
        group.create_array(str(len(copies)), shape=labels.shape, dtype=labels.dtype, **options)[:] = labels
        scale = {"type": "scale", "scale": [step * side for side in drawn.spacing]}
        moved = {"type": "translation", "translation": drawn.origin.tolist()}
        copies.append({"path": str(len(copies)), "coordinateTransformations": [scale, moved]})
        if max(labels.shape) <= SMALL:
            break
        step *= 2
    unit = {"unit": _WRITTEN_OUT[tissue.unit]} if tissue.unit else {}
    axes = [{"name": axis, "type": "space"} | unit for axis in "zyx"]
    image = {"name": "cell labels: 0 outside, cell number + 1 inside", "axes": axes, "datasets": copies}
    colors = [
        {"label-value": cell + 1, "rgba": [round(255 * part) for part in to_rgba(PALETTE[color])]}
        for cell, color in enumerate(spread_colors(len(tissue.positions), tissue.pairs).tolist())
    ]
    group.attrs["ome"] = {"version": "0.5", "multiscales": [image], "image-label": {"colors": colors}}
    return [path]


def draw(tissue: TissueRecord, spacing: Spacing | None) -> Drawn:
    """Draw a tissue as an image of its cells.

    Raises:
        ValueError: If the image would have more than `VOXELS` voxels.
    """
    if spacing is None:
        side = (float(tissue.domain.volume) / len(tissue.positions)) ** (1 / 3) / _FINE
        spacing = side, side, side
    box = image_box(tissue.domain, spacing)
    count = np.prod(box.counts, dtype=float)
    if count > VOXELS:
        raise ValueError(
            f"--spacing {' '.join(map(str, spacing))} gives {count:.2g} voxels, too many; use a larger spacing"
        )
    labels = label_image(tissue.positions, tissue.domain, spacing)
    return Drawn(labels, spacing, (box.first + 0.5) * box.sides)
