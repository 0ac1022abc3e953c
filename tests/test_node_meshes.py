"""Meshes, pictures and exports of tilted and bent backbones: cells as large as the exact path's, with common walls."""

import csv
import re
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import pyvista
import tifffile
import trimesh
from bent_tissues import evenly_bent
from matplotlib.image import imread

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domain_files import save_domain
from jaxtissue.measurement.cell_geometry import SIZES
from jaxtissue.meshes.cell_meshes import CellMeshes, mesh_cells
from jaxtissue.runs import formats, storage
from jaxtissue.runs.exporting import export_tissue

CELLS = 30
SLAB, BALL, TUBE = jt.Slab(6, 5, 1.5, periodic=(True, True)), jt.Sphere(1, 1.5), jt.Tube(6, 1, 2)
PIPE = jt.RoundTube(6, 1, 2)


CASES = {
    "slab": (SLAB, evenly_bent(SLAB, CELLS, 3, 0.06)),
    "ball": (BALL, evenly_bent(BALL, CELLS, 3, 0.15)),
    "tube": (TUBE, evenly_bent(PIPE, CELLS, 2, 0.04)),
}


def walls(meshes: CellMeshes) -> dict[tuple[int, int], float]:
    """The areas of the walls, by their two cells."""
    inner = meshes.sides[:, 1] < meshes.cells
    pairs, number = np.unique(meshes.sides[inner], axis=0, return_inverse=True)
    area = np.bincount(number.ravel(), np.linalg.norm(meshes.normals()[inner], axis=1))
    return {(first, second): size for (first, second), size in zip(pairs.tolist(), area.tolist(), strict=True)}


@pytest.mark.filterwarnings("ignore:the areas of .* walls may be wrong")  # of contacts, where walls have creases
@pytest.mark.parametrize("name", CASES)
def test_cells_are_closed_as_large_as_the_exact_path_s_and_share_walls(name):
    domain, place = CASES[name]
    meshes = mesh_cells(place, domain)
    volume, exact = meshes.volumes(), jt.exact_cells(place, domain, 16).volume
    # flat faces in place of curved surfaces
    assert volume.sum() == pytest.approx(domain.volume, rel=1e-12 if name == "slab" else 1e-3)
    assert np.abs(volume - exact).max() < 0.01 * exact.mean()  # measured 0.003 to 0.007, most of it of the exact path
    assert meshes.is_closed(np.ones(CELLS, bool))
    for cell in (0, 7):
        points, triangles, _ = meshes.cell(cell)
        assert trimesh.Trimesh(points, triangles, process=False).volume == pytest.approx(volume[cell], rel=1e-9)
    contacts = jt.find_connectivity(place, domain).contacts
    mean, found = contacts.area.mean(), walls(meshes)
    known = dict(zip(map(tuple, contacts.pairs.tolist()), contacts.area.tolist(), strict=True))
    for pair in known.keys() | found.keys():
        # 0.1 of the mean wall: where walls meet, triangles stray by some of a tetrahedron; measured 0.03
        assert abs(known.get(pair, 0) - found.get(pair, 0)) < 0.1 * mean, pair
    some = mesh_cells(place, domain, 1e-3, [3])
    assert some.volumes()[3] == pytest.approx(volume[3], rel=0.02)


def test_upright_backbones_by_their_nodes_have_the_meshes_of_straight_ones():
    place = np.asarray(SLAB.random_positions(jax.random.key(0), 12), float)
    straight = mesh_cells(place, SLAB, 1e-3)
    tilted = mesh_cells(np.stack([place, place], axis=1), SLAB, 1e-3)
    np.testing.assert_array_equal(tilted.triangles, straight.triangles)
    np.testing.assert_allclose(tilted.points, straight.points, atol=1e-12)
    # three nodes in line: points of walls are searched for in another way, within the tolerance
    bent = mesh_cells(np.stack([place] * 3, axis=1), SLAB, 1e-3)
    np.testing.assert_allclose(bent.volumes(), straight.volumes(), rtol=0.01)


def test_backbones_that_nearly_cross_have_right_meshes_and_are_named(tmp_path):
    """A hundred thousand points for each cell are counted: right to 1 % at three standard deviations."""
    place = evenly_bent(BALL, CELLS, 2, 0.6)

    def measure(*_):
        """Sizes of which one is off by 4 % of the mean volume, and one by 2 %."""
        volume = tissue.meshes.volumes()
        volume[[4, 7]] += np.array([0.04, 0.02]) * volume.mean()
        return SimpleNamespace(**dict.fromkeys(SIZES, np.ones(CELLS)) | {"volume": volume})

    tissue = TissueRecord(place, BALL, tolerance=2e-4, measure=measure)
    random = np.random.default_rng(0)
    points = random.normal(size=(100_000 * CELLS, 3))
    points *= np.cbrt(random.uniform(1, 1.5**3, len(points)) / np.linalg.norm(points, axis=1) ** 3)[:, None]
    share = np.bincount(jt.label_points(points, place, BALL), minlength=CELLS) / len(points)
    volume = tissue.meshes.volumes()
    np.testing.assert_allclose(volume / volume.sum(), share, atol=0.02 * share.mean())
    with pytest.warns(UserWarning) as told:
        assert "neighbors" not in tissue.columns
    contacts, volumes = (str(one.message) for one in told)
    assert "contacts are not computed: the contacts of cells 1, 2, 3" in contacts
    assert "volumes of 1 of 30 cells are not those of their meshes: cells 4 (" in volumes
    assert {tuple(pair) for pair in tissue.pairs.tolist()} == walls(tissue.meshes).keys()
    export_tissue(tissue, tmp_path, ["vtu", "stl"])
    assert len(list((tmp_path / "stl").iterdir())) == CELLS and not (tmp_path / "transitions.vtp").exists()
    with pytest.raises(ValueError, match="cell"):
        export_tissue(tissue, tmp_path, ["csv"])


@pytest.mark.usefixtures("coarse_pictures")
@pytest.mark.filterwarnings("ignore:the (areas of .* walls|volume of .* cells) may be wrong")
def test_commands_draw_and_export_bent_cells(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(formats, "LEFT", ("tissue", "scutoid"))
    monkeypatch.setattr("jaxtissue.pictures.scenes.SIZE", (240, 160))
    domain, place = CASES["ball"]
    storage.write_backbones(tmp_path / "b.csv", place, None, domain.columns)
    save_domain(domain, tmp_path / "d.json")
    run, out, how = str(tmp_path / "run"), tmp_path / "out", ["--domain", str(tmp_path / "d.json"), "--out"]
    assert main(["measure", str(tmp_path / "b.csv"), *how, run]) == 0
    assert {"tissue.png", "scutoid.png"} <= {path.name for path in (tmp_path / "run").iterdir()}
    assert main(["view", run, "--what", "exploded", "--out", str(tmp_path / "e.png")]) == 0
    assert all(imread(path).std() > 0.05 for path in (tmp_path / "run/tissue.png", tmp_path / "e.png"))
    assert main(["export", run, "--to", "vtu", "csv", "ome-tiff", "--out", str(out)]) == 0
    lines = pyvista.read(out / "backbones.vtp")
    assert lines.n_cells == CELLS and lines.n_points == 3 * CELLS
    steps = np.linalg.norm(np.diff(lines.points.reshape(CELLS, 3, 3), axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(lines.compute_cell_sizes().cell_data["Length"], steps, rtol=1e-6)
    with (out / "cells.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {"apical_nx", "basal_nz", "neighbors", "tilt"} <= set(rows[0])
    middle = np.array([[float(row[axis]) for axis in "xyz"] for row in rows])
    np.testing.assert_array_equal(jt.label_points(middle, place, domain), range(CELLS))  # on its own backbone
    count = np.bincount(tifffile.imread(out / "labels.ome.tif").ravel(), minlength=CELLS + 1)[1:]
    volume = np.array([float(row["volume"]) for row in rows])
    # 1,000 voxels for each cell, a tenth of them at its walls
    np.testing.assert_allclose(count / count.sum(), volume / volume.sum(), atol=0.03 / CELLS)
    assert not re.search("error", capsys.readouterr().err)
