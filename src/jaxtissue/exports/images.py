"""Label images as OME-TIFF, with the size of their voxels and where they begin."""

from pathlib import Path

import numpy as np

from jaxtissue.diagram.labels import label_image
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.system.extras import optional

VOXELS = 2**31  # most of an image: two bytes each
_FINE = 10  # voxels along the side of a mean cell, where no spacing is given


def write_ome_tiff(tissue: TissueRecord, folder: Path, spacing: tuple[float, float, float] | None) -> list[Path]:
    """Write labels.ome.tif: axes (z, y, x), 0 outside, cell index + 1 inside, with spacing, unit and origin."""
    tifffile = optional("tifffile", "io", "the format ome-tiff")
    tube = tissue.tube
    if spacing is None:
        side = (float(tube.volume) / len(tissue.positions)) ** (1 / 3) / _FINE
        spacing = side, side, side
    across, length = 2 * float(tube.basal_radius), float(tube.length)
    count = np.prod([size / side for size, side in zip((across, across, length), spacing, strict=True)])
    if count > VOXELS:
        raise ValueError(f"--spacing {' '.join(map(str, spacing))} makes {count:.2g} voxels; give a larger one")
    image = label_image(tissue.positions, tube, spacing)
    dz, dy, dx = spacing
    deep, high, _ = image.shape
    origin = {"X": dx / 2, "Y": (0.5 - high / 2) * dy, "Z": (0.5 - deep / 2) * dz}  # of the first voxel's center
    unit = {"um": "µm", "": "reference frame"}.get(tissue.unit, tissue.unit)
    metadata = {"axes": "ZYX", "Name": "cell labels: 0 outside, cell number + 1 inside"}
    for axis, side in zip("ZYX", spacing, strict=True):
        metadata |= {f"PhysicalSize{axis}": side, f"PhysicalSize{axis}Unit": unit}
    plane = {f"Position{axis}": [place] * deep for axis, place in origin.items()}
    plane["PositionZ"] = [origin["Z"] + level * dz for level in range(deep)]
    plane |= {f"Position{axis}Unit": [unit] * deep for axis in "XYZ"}
    path = folder / "labels.ome.tif"
    tifffile.imwrite(path, image, ome=True, metadata=metadata | {"Plane": plane}, compression="zlib")
    return [path]
