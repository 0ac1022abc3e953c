"""Pictures in three dimensions: they show the cells that they are to show, in colors that stay."""

import jax
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from jaxtissue.cli.commands import main
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.coloring import PALETTE, spread_colors
from jaxtissue.pictures.bodies import body
from jaxtissue.pictures.scenes import centers
from jaxtissue.runs.backbone_files import BackboneTable
from jaxtissue.runs.formats import VIEWED
from jaxtissue.runs.run_folders import save_tissue
from jaxtissue.runs.viewing import VIEWS, find_scutoid, view_tissue

TUBE = Tube(6, 1, 3)
CELLS = 16


@pytest.fixture(scope="module")
def tissue() -> TissueRecord:
    positions = np.asarray(TUBE.random_positions(jax.random.key(1), CELLS), float)
    return TissueRecord(positions, TUBE, tolerance=1e-3)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr("jaxtissue.pictures.scenes.SIZE", (240, 160))


def test_every_view_has_a_function():
    assert tuple(VIEWS) == VIEWED


def test_neighbors_have_other_colors_which_the_rest_does_not_change():
    ring = np.array([[cell, (cell + 1) % 40] for cell in range(40)])
    colors = spread_colors(40, ring)
    assert (colors[ring[:, 0]] != colors[ring[:, 1]]).all() and set(colors) <= set(range(len(PALETTE)))
    longer = spread_colors(60, np.concatenate([ring, [[50, 51]]]))
    np.testing.assert_array_equal(longer[:40], colors)


def test_a_body_is_the_outside_of_its_cells(tissue):
    meshes = tissue.meshes
    chosen = np.isin(np.arange(CELLS), [3, 5, 6])
    part = body(meshes, chosen)
    corner = part.points[part.triangles]
    volume = np.linalg.det(corner).sum() / 6
    assert volume == pytest.approx(meshes.volumes()[chosen].sum(), rel=1e-9)
    assert set(part.cell) == {3, 5, 6} and len(part.lines)
    middle = centers(meshes)
    assert np.abs(middle[:, 0] - tissue.positions[:, 0]).max() < 2  # a cell is at most about two wide


def test_a_cell_is_drawn_in_its_color_on_white(tissue, tmp_path):
    cell = find_scutoid(tissue)
    view_tissue(tissue, "scutoid", tmp_path / "s.png", cell)
    image = imread(tmp_path / "s.png")[..., :3]
    assert image.shape == (160, 240, 3) and (image[0] == 1).all()
    shade = np.array(to_rgb(PALETTE[0])) * 0 + [to_rgb(color) for color in PALETTE]
    shown = [(np.abs(image / np.maximum(image.max(axis=-1, keepdims=True), 0.1) - one / one.max()).max(axis=-1) < 0.1)
             .mean() for one in shade]  # fmt: skip
    assert max(shown) > 0.01 and (image.max(axis=-1) < 0.1).any()  # the cell, and a black ball


def test_the_command_draws_what_measure_left(tissue, tmp_path, capsys):
    save_tissue(tmp_path, TUBE, BackboneTable(tissue.positions, None))
    assert main(["view", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'tissue.png'}\n"
    assert imread(tmp_path / "tissue.png").std() > 0.1
    for arguments, told in (
        (["--what", "movie"], "needs the sweeps of a run"),
        (["--what", "cell", "--cell", "16"], "give 0 to 15"),
        (["--out", str(tmp_path / "a.jpg")], "must end in .png"),
        (["--what", "surfaces", "--cell", "3"], "--cell is for --what cell, scutoid, internal"),
    ):
        assert main(["view", str(tmp_path), *arguments]) == 2
        assert told in capsys.readouterr().err


def test_a_run_becomes_a_movie(tissue, tmp_path):
    from PIL import Image

    moving = TissueRecord(tissue.positions, TUBE, history={0: tissue.positions, 3: tissue.positions * [1, 0.98]})
    view_tissue(moving, "movie", tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as movie:
        assert movie.n_frames == 2 and movie.size == (240, 160)
