"""`jaxtissue fit`: from an image in a file to files that the other commands take, and one line for bad images."""

import csv
import json
import sys

import numpy as np
import pytest
import tifffile

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.images.drawing import draw_turned
from jaxtissue.images.image_files import read_image

pytestmark = pytest.mark.usefixtures("coarse_pictures")
TUBE = jt.Tube(5, 1, 2.5)
POSITIONS = np.array([[x, t + 0.5 * (x > 2)] for x in (0.8, 2.4, 4.1) for t in (0.2, 1.8, 3.3, 4.9)])
SPACING = (0.2, 0.1, 0.1)
OME = {f"PhysicalSize{axis}": side for axis, side in zip("ZYX", SPACING, strict=True)}


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    drawn, _ = draw_turned(TUBE, POSITIONS, SPACING, np.eye(3)[[2, 0, 1]])  # along the image's z
    return np.where(drawn > 0, 10 * drawn, 0).astype(np.uint16)


def rows_of(path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_commands_go_on_from_a_fit(tmp_path, image, capsys):
    path, out = tmp_path / "labels.tif", tmp_path / "fitted"
    micro = {"spacing": 0.2, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(path, image, imagej=True, resolution=(10, 10), metadata=micro)
    assert main(["fit", str(path), "--out", str(out)]) == 0
    assert "voxels_same" in capsys.readouterr().out
    domain, frame, fit = (json.loads((out / f"{name}.json").read_text()) for name in ("domain", "frame", "fit"))
    assert domain["shape"] == "tube" and domain["length"] == pytest.approx(5, abs=0.2)
    np.testing.assert_allclose(np.abs(frame["axes"][0]), [0, 0, 1], atol=0.01)
    assert frame["unit"] == "um" and fit["spacing"] == pytest.approx(SPACING)
    assert fit["voxels_same"] > 0.98 and fit["neighbors_kept"] > 0.95 and fit["volume_error"] < 0.03
    assert fit["cells_at_border"] == 0
    backbones, cells = rows_of(out / "backbones.csv"), rows_of(out / "cells.csv")
    assert [row["cell"] for row in backbones] == [row["label"] for row in cells] == [str(10 * k) for k in range(1, 13)]
    for row in cells:
        assert float(row["model_volume"]) == pytest.approx(float(row["image_volume"]), rel=0.1)
    taken = [str(out / "backbones.csv"), "--domain", str(out / "domain.json")]
    assert main(["measure", *taken, "--out", str(out / "measured")]) == 0  # `anneal` reads them by the same functions
    assert [row["name"] for row in rows_of(out / "measured/cells.csv")] == [row["cell"] for row in backbones]
    assert main(["fit", str(path), "--out", str(out)]) == 2  # the folder is there


def test_files_tell_the_size_of_their_voxels(tmp_path, image):
    tifffile.imwrite(tmp_path / "a.ome.tif", image, metadata={"axes": "ZYX"} | OME)
    read = read_image(tmp_path / "a.ome.tif")
    assert read.spacing == SPACING and read.unit == "um"
    np.testing.assert_array_equal(read.image, image)
    assert read_image(tmp_path / "a.ome.tif", (3, 2, 1)).spacing == (3, 2, 1)
    tifffile.imwrite(tmp_path / "channel.tif", image[None, :, None], imagej=True, metadata={"axes": "TZCYX"})
    assert read_image(tmp_path / "channel.tif", SPACING).image.shape == image.shape
    np.save(tmp_path / "a.npy", image)
    assert read_image(tmp_path / "a.npy", SPACING).unit is None


BAD = {
    "plain.tif": (lambda image: image, "does not contain its voxel size; give --spacing Z Y X"),
    "flat.tif": (lambda image: image[9], "does not contain its voxel size"),
    "flat.npy": (lambda image: image[9], "2 dimensions"),
    "float.npy": (lambda image: image.astype(float), "float64"),
    "negative.npy": (lambda image: -image.astype(int), "the label -120"),
    "mask.npy": (lambda image: (image > 0).astype(np.uint8), "only one label, 1"),
    "rgb.tif": (lambda image: np.stack([image[9].astype(np.uint8)] * 3, axis=-1), "color image"),
    "channels.ome.tif": (lambda image: np.stack([image] * 2), "2 channels"),
    "times.ome.tif": (lambda image: np.stack([image] * 2), "2 time points"),
    "broken.tif": (None, "can't be read"),
    "none.npy": (None, "can't be read"),
    "labels.png": (None, "ends in .tif, .tiff, .npy"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_images_get_one_line(tmp_path, image, name, capsys):
    make, told = BAD[name]
    path = tmp_path / name
    if name == "broken.tif":
        path.write_bytes(b"no tiff")
    elif make and path.suffix == ".npy":
        np.save(path, make(image))
    elif make:
        axes = {"channels": "CZYX", "times": "TZYX"}.get(name.split(".")[0])
        metadata = {"axes": axes} | OME if axes else None
        tifffile.imwrite(path, make(image), metadata=metadata, photometric="rgb" if "rgb" in name else "minisblack")
    spacing = ["--spacing", "1", "1", "1"] if path.suffix == ".npy" else []
    assert main(["fit", str(path), *spacing, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1 and not (tmp_path / "out").exists()


def test_tifffile_is_named_where_it_is_missing(tmp_path, image, monkeypatch, capsys):
    tifffile.imwrite(tmp_path / "a.tif", image)
    monkeypatch.setitem(sys.modules, "tifffile", None)
    assert main(["fit", str(tmp_path / "a.tif"), "--out", str(tmp_path / "out")]) == 2
    assert "pip install 'jaxtissue[io]'" in capsys.readouterr().err
