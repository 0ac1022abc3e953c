"""Tables of centroids from other programs: their columns, the axis that is fitted to them, and what is told."""

from pathlib import Path

import numpy as np
import pytest
from known import known
from scipy.spatial.transform import Rotation

from jaxtissue.cli.commands import main
from jaxtissue.geometry.domain_files import load_domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.runs.backbone_files import find_tube, read_backbones
from jaxtissue.runs.centroid_tables import COLUMNS

TUBE = Tube(length=30.0, apical_radius=4.0, basal_radius=8.0)


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    """Forty backbones with both ends of the tube equally far from the last ones."""
    draw = np.random.default_rng(0)
    axial = np.concatenate([[1.0, 29.0], draw.uniform(1, 29, 38)])
    return np.stack([axial, draw.uniform(0, 2 * np.pi, 40)], axis=-1)


def centroids(positions: np.ndarray, radius: float | np.ndarray = 6.2) -> np.ndarray:
    """Points on the backbones, turned and shifted as a tissue in an image is."""
    axial, angle = positions.T
    points = np.stack([axial, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return Rotation.from_euler("xyz", [0.4, 0.7, -0.5]).apply(points) + np.array([50, -20, 7])


def write(path: Path, columns: tuple[str, ...], points: np.ndarray) -> Path:
    text = [",".join(("label", *columns))]
    text += [",".join(map(repr, (number, *row))) for number, row in enumerate(points.tolist(), 1)]
    path.write_text("\n".join(text))
    return path


@pytest.mark.parametrize("columns", COLUMNS, ids="/".join)
def test_centroids_on_backbones_give_these_backbones(tmp_path, positions, columns):
    """Up to a turn round the axis, and to which end of the tube is called its beginning."""
    path = write(tmp_path / "cells.csv", columns, centroids(positions))
    with pytest.warns(UserWarning, match="centroids, not backbones"):
        found, names = read_backbones(path, TUBE)
    assert names == tuple(map(str, range(1, 41)))
    way = np.sign(found[1, 0] - found[0, 0])
    np.testing.assert_allclose(found[:, 0] - 15, way * (positions[:, 0] - 15), atol=1e-6)  # the fit ends within 1e-8
    turned = np.exp(1j * (found[:, 1] - way * positions[:, 1]))
    np.testing.assert_allclose(turned, turned[0], atol=1e-6)


def test_outliers_do_not_move_the_axis(tmp_path, positions):
    radius = np.where(np.arange(40) % 20 == 7, 7.6, 6.2)
    path = write(tmp_path / "cells.csv", ("x (um)", "y (um)", "z (um)"), centroids(positions, radius))
    with pytest.warns(UserWarning):
        found, _ = read_backbones(path, TUBE)
    way = np.sign(found[1, 0] - found[0, 0])
    assert np.abs(found[:, 0] - 15 - way * (positions[:, 0] - 15)).max() < 0.1  # a plain mean: 0.2


def test_what_is_no_table_of_centroids_is_refused(tmp_path, positions):
    points = centroids(positions)
    for columns, shown, told in (
        (
            ("x", "y", "z"),
            10 * points,
            "centroids are 62 to 62 from their axis, but the radii are 4 and 8; use one unit",
        ),
        (("x", "y", "z"), points[:5], "5 centroids are too few"),
        (("x (um)", "y (um)", "z (px)"), points, "units"),
        (("x", "y", "depth"), points, "no column 'axial'"),
    ):
        with pytest.raises(ValueError, match=told) as refusal:
            read_backbones(write(tmp_path / "cells.csv", columns, shown), TUBE)
        assert str(refusal.value).startswith(str(tmp_path)) and "\n" not in str(refusal.value)
    with pytest.raises(ValueError, match="--degrees applies to angles"):
        read_backbones(write(tmp_path / "cells.csv", ("x", "y", "z"), points), TUBE, degrees=True)


def layers(positions: np.ndarray, radii: tuple[float, ...] = (4.0, 6.0, 8.0)) -> list[tuple[str, ...]]:
    """Rows of centroids on backbones, by layer, with the axis turned over and begun elsewhere."""
    return [
        (f"c{cell}", str(layer), repr(radius), repr(axial - 7), repr(radius * angle))
        for layer, radius in enumerate(radii)
        for cell, (axial, angle) in enumerate(positions.tolist())
    ]


def write_layers(path: Path, rows: list[tuple[str, ...]]) -> Path:
    path.write_text("\n".join(map(",".join, [("id", "layer", "radius", "x", "y"), *rows])))
    return path


def test_centroids_on_layers_tell_the_tube_too(tmp_path, positions):
    """Cells that lack a layer are joined from the others; the angle is a mean on the circle."""
    path = write_layers(tmp_path / "cells.csv", layers(positions)[5:])
    with pytest.warns(UserWarning, match="centroids, not backbones"):
        found, names = read_backbones(path, TUBE)
    order = [known(names).index(f"c{cell}") for cell in range(40)]
    np.testing.assert_allclose(found[order], positions, atol=1e-9)  # both ends are equally far from the last ones
    tube = known(find_tube(path))
    assert (tube.apical_radius, tube.basal_radius) == (4, 8)
    assert tube.length == pytest.approx(30, abs=4)  # half a cell, about 2.4 long, beyond the last ones
    path.write_text("id,axial,angle\n1,2,3\n")
    assert find_tube(path) is None and find_tube(tmp_path / "none.csv") is None


def test_measure_needs_no_sizes_for_layers(tmp_path, positions, recwarn, capsys):
    rows, out = layers(positions), tmp_path / "out"
    path = write_layers(tmp_path / "cells.csv", rows)
    assert main(["measure", str(path), "--no-contacts", "--resolution", "draft", "--out", str(out)]) == 0
    assert load_domain(out / "domain.json").basal_radius == 8 and len(recwarn) == 1
    for wrong, told in (
        ([*rows, rows[3]], "line 122: id='c3' is also on layer '0' on line 5"),
        ([("c", "0", "0", "1", "1"), *rows], "line 2: radius=0 is not above 0"),
        ([(*row[:4], str(2 * float(row[4]))) for row in rows], "give y as the length along the circumference"),
    ):
        assert main(["measure", str(write_layers(path, wrong)), "--out", str(out), "--force"]) == 2
        assert told in capsys.readouterr().err
