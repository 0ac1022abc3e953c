"""Pictures in three dimensions: they show the cells that they are to show, in colors that stay."""

import subprocess
import sys
from functools import partial
from types import SimpleNamespace
from typing import Any

import imageio_ffmpeg
import jax
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from PIL import Image

from jaxtissue.cli.commands import main
from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.point_location import label_points
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.nodes import as_domain
from jaxtissue.geometry.shapes import Slab, Sphere
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.cell_meshes import mesh_cells
from jaxtissue.meshes.coloring import PALETTE, spread_colors
from jaxtissue.meshes.straight_edges import straighten
from jaxtissue.pictures.bodies import body
from jaxtissue.pictures.domain_outsides import open_domain
from jaxtissue.pictures.movies import save_movie, turn_round
from jaxtissue.pictures.outsides import OPEN, cut_open
from jaxtissue.pictures.scenes import centers, draw_tissue
from jaxtissue.runs import formats
from jaxtissue.runs.backbone_files import BackboneTable
from jaxtissue.runs.formats import VIEWED
from jaxtissue.runs.run_folders import save_tissue
from jaxtissue.runs.surface_maps import label_surface
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
    monkeypatch.setattr("jaxtissue.pictures.outsides.PIXELS", 30_000)


@pytest.mark.usefixtures("coarse_pictures")
def test_measure_leaves_pictures_and_a_page_that_needs_nothing_else(tissue, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(formats, "LEFT", ("tissue", "scutoid"))
    save_tissue(tmp_path, TUBE, BackboneTable(tissue.positions, None))
    given = [str(tmp_path / "backbones.csv"), "--domain", str(tmp_path / "domain.json"), "--out"]
    assert main(["measure", *given, str(tmp_path / "measured")]) == 0
    assert {path.name for path in (tmp_path / "measured").glob("*.png")} == {
        "tissue.png",
        "scutoid.png",
        "surfaces.png",
    }
    page = (tmp_path / "measured" / "index.html").read_text()
    assert page.count("src='data:image/png;base64,") == page.count("src=") == 3
    assert "http" not in page and "scutoid fraction" in page
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.warns(UserWarning, match=r"tissue.png is not drawn: .* pip install 'jaxtissue\[viz\]'"):
        assert main(["measure", *given, str(tmp_path / "flat")]) == 0
    assert [path.name for path in (tmp_path / "flat").glob("*.png")] == ["surfaces.png"]


def test_every_view_has_a_function():
    assert tuple(VIEWS) == VIEWED


def test_neighbors_have_other_colors_which_the_rest_does_not_change():
    ring = np.array([[cell, (cell + 1) % 40] for cell in range(40)])
    colors = spread_colors(40, ring)
    assert (colors[ring[:, 0]] != colors[ring[:, 1]]).all() and set(colors) <= set(range(len(PALETTE)))
    longer = spread_colors(60, np.concatenate([ring, [[50, 51]]]))
    np.testing.assert_array_equal(longer[:40], colors)


def test_faces_show_the_cells_on_the_outside(tissue):
    faces = cut_open(tissue.positions, TUBE, 20_000)
    pairs = {tuple(pair) for face in faces for pair in face.pairs().tolist()}
    assert pairs <= {tuple(pair) for pair in tissue.connectivity.contacts.pairs.tolist()} and len(pairs) > 20
    share = np.bincount(faces[0].cells.ravel(), minlength=CELLS) / faces[0].cells.size
    whole = np.bincount(label_surface(tissue.positions, TUBE, "basal", (60, 80)).ravel(), minlength=CELLS) / 4800
    # 1 % of the surface: pixels; cells between the angles that are left out are shown in part, or not
    assert (0.75 * share < whole + 0.01).all() and (np.abs(0.75 * share - whole) < 0.01).sum() >= 8
    radius = np.hypot(faces[0].points[..., 1], faces[0].points[..., 2])
    np.testing.assert_allclose(radius, 3)


def test_a_few_cells_are_meshed_as_all_are(tissue):
    few, all_ = mesh_cells(tissue.positions, TUBE, 1e-3, [3, 5]), tissue.meshes
    own = np.isin(np.arange(CELLS), [3, 5])
    assert few.is_closed(own) and all_.is_closed(np.ones(CELLS, bool)) and not few.is_closed(~own)
    volume = np.array([np.linalg.det(p[t]).sum() / 6 for p, t, _ in map(few.cell, (3, 5))])
    # both within the tolerance: 1e-3 of the cell for each triangle
    np.testing.assert_allclose(volume, tissue.connectivity.sizes.volume[[3, 5]], rtol=0.03)
    assert set(few.cell(3)[2]) == set(all_.cell(3)[2]) and len(few.triangles) < len(all_.triangles)


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
    (tmp_path / "cells.csv").write_text("cell,volume,name\n0,1.5,<b>\n")
    assert main(["view", str(tmp_path)]) == 0
    page = (tmp_path / "index.html").read_text()
    assert page.count("<img") == 1 and "&lt;b&gt;" in page and "<td>1.5</td>" in page
    assert capsys.readouterr().out == f"{tmp_path / 'tissue.png'}\n"
    assert imread(tmp_path / "tissue.png").std() > 0.1
    for arguments, told in (
        (["--what", "movie"], "needs the stored sweeps of a run"),
        (["--what", "cell", "--cell", "16"], "give 0 to 15"),
        (["--out", str(tmp_path / "a.jpg")], "must end in .png"),
        (["--what", "surfaces", "--cell", "3"], "--cell is for --what cell, scutoid, internal"),
    ):
        assert main(["view", str(tmp_path), *arguments]) == 2
        assert told in capsys.readouterr().err


def test_edges_are_straight_and_cells_as_large_as_before(tissue):
    meshes, backbones = tissue.meshes, Crowd(tissue.positions, as_domain(TUBE))
    straight = straighten(meshes, backbones, partial(label_points, positions=tissue.positions, domain=TUBE))
    assert straight.triangles is meshes.triangles

    def off(shown):
        """How far the vertices of three cells are from a wall between two of them, 95 % of them at most."""
        pairs = np.unique(np.stack([np.repeat(shown.triangles, 2), np.tile(shown.sides, 3).ravel()], axis=1), axis=0)
        first, count = np.unique(pairs[:, 0], return_index=True, return_counts=True)[1:]
        chosen = first[count == 3][:, None] + np.arange(3)
        point, label = shown.points[pairs[chosen[:, 0], 0]], pairs[chosen, 1]
        inner = label.max(axis=1) < CELLS
        away = [backbones.offset(point[inner], cell) for cell in label[inner].T]
        lead = np.abs((away[0] ** 2).sum(axis=1) - (away[1] ** 2).sum(axis=1))
        return np.quantile(lead / np.linalg.norm(away[0] - away[1], axis=1) / 2, 0.95)

    assert off(straight) < 0.02 * off(meshes)
    true = tissue.connectivity.sizes.volume
    np.testing.assert_allclose(straight.volumes(), true, rtol=0.04)  # the meshes' own tolerance here
    assert np.abs(straight.volumes() / true - 1).mean() < np.abs(meshes.volumes() / true - 1).mean()


@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_a_turntable_shows_the_tissue_from_all_round(tissue, tmp_path, ending):
    plotter = draw_tissue(cut_open(tissue.positions, TUBE), np.full((CELLS, 3), 200, np.uint8), None)
    frames = list(turn_round(plotter, 3))
    plotter.close()
    assert all((frame[0] == 255).all() and (frame[:, [0, -1]] == 255).all() for frame in frames)  # none is cut off
    assert all((frame < 250).any(axis=2).mean() > 0.1 for frame in frames) and (frames[0] != frames[1]).any()
    save_movie(frames, tmp_path / f"turn.{ending}", 0.2, 2)
    if ending == "mp4":
        command = ["-loglevel", "error", "-i", tmp_path / "turn.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
        data = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *command], capture_output=True, check=True).stdout
        shown = np.frombuffer(data, np.uint8).reshape(15, 160, 240, 3)  # 25 a second
        assert np.abs(shown[7].astype(int) - frames[1]).mean() < 10
    else:
        with Image.open(tmp_path / "turn.gif") as movie:
            assert getattr(movie, "n_frames", 1) == 3 and movie.size == (120, 80)


def test_other_domains_are_opened_and_drawn(tmp_path, capsys):
    cyst = Sphere(1, 2)
    places = np.random.default_rng(0).normal(size=(30, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    faces = open_domain(places, cyst, 3000)
    away = [np.linalg.norm(face.points, axis=2) for face in faces]
    np.testing.assert_allclose(away[0], 1)
    np.testing.assert_allclose(away[1], 2)
    for face in faces[2:]:  # the cut: planes through the x axis
        normal = np.linalg.svd(face.points.reshape(-1, 3))[2][2]
        np.testing.assert_allclose(face.points @ normal, 0, atol=1e-6)
    # cells of radial backbones are cones: the nearest direction
    u, v = (np.arange(faces[1].cells.shape[axis]) + 0.5 for axis in (0, 1))
    north = np.pi * (u / len(u) - 0.5)[:, None]
    turn = (OPEN[1] + v / len(v) * 1.5 * np.pi)[None]
    ways = np.stack([np.sin(north) + 0 * turn, np.cos(north) * np.cos(turn), np.cos(north) * np.sin(turn)], axis=-1)
    np.testing.assert_array_equal(faces[1].cells, (ways @ places.T).argmax(axis=2))
    slab = open_domain(np.array([[1.0, 1.0], [3.0, 1.0]]), Slab(4, 2, 1), 1000)
    assert len(slab) == 6 and all(set(np.unique(face.cells)) <= {0, 1} for face in slab)
    contacts = SimpleNamespace(pairs=np.concatenate([face.pairs() for face in faces]))
    traced: Any = SimpleNamespace(contacts=contacts)
    view_tissue(TissueRecord(places, cyst, traced=traced), "tissue", tmp_path / "cyst.png")
    assert imread(tmp_path / "cyst.png").std() > 0.1
    save_tissue(tmp_path, cyst, BackboneTable(places, None))
    assert main(["export", str(tmp_path), "--to", "ome-tiff", "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'out' / 'labels.ome.tif'}\n"


def test_a_run_becomes_a_movie(tissue, tmp_path):
    moving = TissueRecord(tissue.positions, TUBE, history={0: tissue.positions, 3: tissue.positions * [1, 0.98]})
    view_tissue(moving, "movie", tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as movie:
        assert getattr(movie, "n_frames", 1) == 2 and movie.size == (240, 160)
