"""Label images from files: TIFF with its voxel size, and NumPy arrays."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from jaxtissue.images.label_images import as_labels, as_spacing
from jaxtissue.system.extras import optional

NAMES = (".tif", ".tiff", ".npy")
NO_SPACING = "does not contain its voxel size; give --spacing Z Y X, the sides of a voxel along z, y and x"
MICROMETERS = ("µm", "μm", "um", "micron", "microns", "micrometer", "\\u00B5m")


class ImageFile(NamedTuple):
    """A label image as read, the sides of its voxels along z, y and x, and their unit if it is known."""

    image: Int[np.ndarray, "z y x"]
    spacing: tuple[float, float, float]
    unit: str | None


def read_image(path: Path, spacing: Any = None) -> ImageFile:
    """Read a volume of labels from a TIFF or NumPy file.

    Args:
        path: The file, by its ending .tif, .tiff or .npy.
        spacing: The sides of a voxel along z, y and x; if None, those that the file tells, as OME-TIFF and ImageJ do.

    Raises:
        ValueError: If the file can't be read, is of another kind, holds no volume of labels, if no spacing is known, or
            if tifffile, which reads TIFF, is not installed.
    """
    ending = path.suffix.lower()
    if ending not in NAMES:
        raise ValueError(f"{path} is not a supported image file; give a file that ends in {', '.join(NAMES)}")
    tifffile: Any = optional("tifffile", "io", "reading TIFF") if ending != ".npy" else None
    try:
        image, told, unit = _read_tiff(tifffile, path) if tifffile else (np.load(path, allow_pickle=False), None, None)
    except OSError as error:
        raise ValueError(f"{path} can't be read ({error.strerror or error}); give a label image") from error
    except Exception as error:  # a damaged file raises one or another
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path} can't be read ({reason}); give a label image") from error
    if spacing is None and told is None:
        raise ValueError(f"{path} {NO_SPACING}")
    try:
        sides = as_spacing(told if spacing is None else spacing)
        labels = as_labels(image)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    z, y, x = sides.tolist()
    return ImageFile(labels, (z, y, x), unit if spacing is None else None)


def _read_tiff(tifffile: Any, path: Path) -> tuple[np.ndarray, tuple[float, ...] | None, str | None]:
    """The first series of a TIFF without its axes of length 1, and what it tells of its voxels."""
    with tifffile.TiffFile(path) as file:
        series = file.series[0]
        image, axes = series.asarray(), series.axes
        kept = [at for at, size in enumerate(image.shape) if size > 1 or axes[at] in "ZYX"]
        image = image.reshape([image.shape[at] for at in kept])
        axes = "".join(axes[at] for at in kept)
        if "T" in axes and image.ndim > 3:
            raise ValueError(f"it has {image.shape[axes.index('T')]} time points; save a single time point")
        if "C" in axes:
            raise ValueError(
                f"it has {image.shape[axes.index('C')]} channels; save only the channel that contains the labels"
            )
        if "S" in axes:
            raise ValueError("it is a color image; save the labels as one number per voxel")
        sides, unit = _ome_spacing(tifffile, file) if file.is_ome else _imagej_spacing(file)
    return image, sides, unit


def _ome_spacing(tifffile: Any, file: Any) -> tuple[tuple[float, ...] | None, str | None]:
    """The sides of a voxel, (z, y, x), by the metadata of OME-TIFF."""
    image = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]
    pixels = (image[0] if isinstance(image, list) else image)["Pixels"]
    names = [f"PhysicalSize{axis}" for axis in "ZYX"]
    if not all(name in pixels for name in names):
        return None, None
    units = {str(pixels.get(f"{name}Unit", "µm")) for name in names}
    if len(units) > 1:
        raise ValueError(
            f"the sides of its voxels have the units {', '.join(sorted(units))}; give --spacing Z Y X in one unit"
        )
    return tuple(float(pixels[name]) for name in names), _plain_unit(units.pop())


def _imagej_spacing(file: Any) -> tuple[tuple[float, ...] | None, str | None]:
    """The same by those of ImageJ: `spacing` along z, and pixels per unit in the resolution."""
    told, tags = file.imagej_metadata or {}, file.pages[0].tags
    if "spacing" not in told or not {"XResolution", "YResolution"} <= {tag.name for tag in tags}:
        return None, None
    counts, units = zip(*(tags[name].value for name in ("YResolution", "XResolution")), strict=True)
    if not all(counts):
        return None, None
    across = [unit / count for count, unit in zip(counts, units, strict=True)]
    return (float(told["spacing"]), *across), _plain_unit(told.get("unit"))


def _plain_unit(unit: Any) -> str | None:
    return "um" if unit in MICROMETERS else (str(unit) if unit else None)
