"""Exports, each read back by a library of its own, with sizes and units kept."""

import csv
import dataclasses
import json
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, cast

import anndata
import jax
import networkx as nx
import numpy as np
import pandas
import pytest
import pyvista
import tensorstore
import tifffile
import trimesh
import yaozarrs
from known import known
from PIL import Image
from skimage.measure import regionprops

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.exports import images
from jaxtissue.exports.tissue_record import TissueRecord, tabulate_walls
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.coloring import color_cells
from jaxtissue.runs.backbone_files import BackboneTable
from jaxtissue.runs.exporting import WRITERS, export_tissue
from jaxtissue.runs.formats import FORMATS
from jaxtissue.runs.run_folders import read_tissue, save_tissue
from jaxtissue.topology.contacts import find_contacts
from jaxtissue.topology.traced_sizes import trace_sizes

TUBE = Tube(6, 1, 3)
CELLS = 16
NAMES = tuple(f"cell {letter}" for letter in "ABCDEFGHIJKLMNOP")
SPACING = 0.1, 0.06, 0.08  # z, y, x
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(1), CELLS), float)


@pytest.fixture(scope="module")
def tissue(positions) -> TissueRecord:
    history = {0: positions, 5: positions * [1, 0.99]}
    return TissueRecord(positions, TUBE, NAMES, "um", history)


@pytest.fixture(scope="module")
def folder(tissue, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(images, "SMALL", 64)  # voxels, so that there is a coarser copy
        written = export_tissue(tissue, folder, FORMATS, SPACING)
    assert sorted(written) == sorted(folder.iterdir())
    return folder


@pytest.fixture(scope="module")
def sizes(positions):
    return trace_sizes(positions, TUBE)


def test_every_format_has_a_writer():
    assert tuple(WRITERS) == FORMATS


def test_label_images_keep_volumes_spacing_and_origin(folder, sizes, positions):
    with tifffile.TiffFile(folder / "labels.ome.tif") as file:
        image, series = file.asarray(), file.series[0]
        assert series.axes == "ZYX" and image.dtype == np.uint16 and file.is_ome
        top = ElementTree.fromstring(known(file.ome_metadata))
    pixels, plane = (
        next(node for node in top.iter() if node.tag.endswith(f"}}{name}")) for name in ("Pixels", "Plane")
    )
    assert [float(known(pixels.get(f"PhysicalSize{axis}"))) for axis in "ZYX"] == list(SPACING)
    assert pixels.get("PhysicalSizeXUnit") == "µm"
    # voxels are about a fifteenth of a cell: counted volumes are right to less than 1 %, the bar
    volume = np.zeros(CELLS)
    origin = np.array([float(known(plane.get(f"Position{axis}"))) for axis in "ZYX"])
    middle = (np.array(SPACING) * (np.array(image.shape) - 1)) / 2 + origin
    np.testing.assert_allclose(middle[:2], 0, atol=1e-9)
    for region in regionprops(image, spacing=SPACING):
        volume[region.label - 1] = region.area
    np.testing.assert_allclose(volume, sizes.volume, rtol=0.01)
    for cell, (axial, angle) in enumerate(positions):  # each label holds its backbone
        at = np.array([2 * np.sin(angle), 2 * np.cos(angle), axial])
        index = np.rint((at - origin) / SPACING).astype(int)
        assert image[tuple(index)] == cell + 1


def test_ome_zarr_is_the_same_image(folder, tissue):
    """By the schema of OME-Zarr 0.5, and read by TensorStore, which shares no code with zarr."""
    path = folder / "labels.ome.zarr"
    yaozarrs.validate_zarr_store(str(path))
    about: Any = yaozarrs.open_group(str(path)).ome_metadata()  # by the schema of the file
    assert about.version == "0.5" and [color.label_value for color in about.image_label.colors] == list(range(1, 17))
    (image,) = about.multiscales
    assert [(axis.name, axis.unit) for axis in image.axes] == [(axis, "micrometer") for axis in "zyx"]
    whole, half = (
        tensorstore.open({"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path / copy.path)}}).result()
        for copy in image.datasets
    )
    tiff = tifffile.imread(folder / "labels.ome.tif")
    np.testing.assert_array_equal(whole.read().result(), tiff)
    np.testing.assert_array_equal(half.read().result(), tiff[::2, ::2, ::2])
    assert whole.domain.labels == ("z", "y", "x")
    for step, copy in zip((1, 2), image.datasets, strict=True):
        scale, moved = cast(Any, copy.coordinateTransformations)
        assert scale.scale == [step * side for side in SPACING]
        # the image is centered on the axis, and begins at the end of the tube: the first center is half a voxel in
        expected = [SPACING[0] * (1 - tiff.shape[0]) / 2, SPACING[1] * (1 - tiff.shape[1]) / 2, SPACING[2] / 2]
        np.testing.assert_allclose(moved.translation, expected)
    assert export_tissue(tissue, folder, ["ome-zarr"], SPACING) == [path]  # in place of the old one
    assert not (path / "1").exists()


def test_cells_open_in_paraview_and_have_their_volumes(folder, sizes, tissue):
    grid = pyvista.read(folder / "cells.vtu")
    assert grid.field_data["unit"][0] == "um"
    for cell in (0, 7, 15):
        body = grid.extract_cells(np.flatnonzero(grid.cell_data["cell"] == cell)).extract_surface(algorithm=None)
        assert body.is_manifold and body.volume == pytest.approx(sizes.volume[cell], rel=0.01)
    np.testing.assert_allclose(np.unique(grid.cell_data["volume"]), np.unique(sizes.volume.astype(np.float32)))
    walls = pyvista.read(folder / "walls.vtp")
    area = walls.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    basal = area[walls.cell_data["surface"] == 2].sum()
    assert basal == pytest.approx(TUBE.basal_area, rel=1e-3)  # polygons of 64 sides
    inner = walls.cell_data["cell_b"] >= 0
    assert (walls.cell_data["cell_a"][inner] < walls.cell_data["cell_b"][inner]).all()
    lines = pyvista.read(folder / "backbones.vtp")
    length = lines.compute_cell_sizes(area=False, volume=False).cell_data["Length"]
    np.testing.assert_allclose(length, 2)
    np.testing.assert_array_equal(lines.cell_data["neighbors"], tissue.columns["neighbors"])
    points = pyvista.read(folder / "transitions.vtp")
    np.testing.assert_allclose(points.points, tissue.connectivity.transitions.points, rtol=1e-6)


def test_a_run_is_a_series_over_its_sweeps(folder):
    reader = pyvista.PVDReader(folder / "run.pvd")
    assert reader.time_values == [0, 5]
    reader.set_active_time_value(5)
    assert set(cast(Any, reader.read())[0].cell_data["cell"]) == set(range(CELLS))


@pytest.mark.parametrize("kind", ["ply", "stl"])
def test_each_cell_is_a_closed_body(folder, sizes, kind):
    assert len(list((folder / kind).iterdir())) == CELLS
    for cell in (0, 9):
        body = cast(pyvista.PolyData, pyvista.read(folder / kind / f"cell-{cell:02d}.{kind}")).clean()
        assert body.is_manifold and body.volume == pytest.approx(sizes.volume[cell], rel=0.01)
    loaded = trimesh.load_mesh(folder / kind / f"cell-03.{kind}")
    assert loaded.is_watertight and loaded.volume == pytest.approx(sizes.volume[3], rel=0.01)


def test_a_scene_holds_all_cells_in_colors(folder, sizes, tissue):
    scene = trimesh.load_scene(folder / "cells.glb")
    bodies = [scene.geometry[f"cell-{cell}"] for cell in range(CELLS)]
    # single precision, and triangles of no area that are merged
    np.testing.assert_allclose([body.volume for body in bodies], sizes.volume, rtol=0.01)
    colors = color_cells(tissue.meshes)
    pairs = tissue.connectivity.contacts.pairs
    alike = colors[pairs[:, 0]] == colors[pairs[:, 1]]
    assert alike.mean() < 0.1  # sixteen cells in a narrow tube touch more than seven others


def test_graphs_open_in_networkx(folder, positions):
    graph, contacts = nx.read_graphml(folder / "graph.graphml"), find_contacts(positions, TUBE)
    assert len(graph) == CELLS and graph.number_of_edges() == len(contacts.pairs)
    assert graph.nodes["2"]["name"] == "cell C" and isinstance(graph.nodes["2"]["sphericity"], float)
    first, second = contacts.pairs[0]
    assert graph.edges[str(first), str(second)]["area"] == contacts.area[0]


def test_tables_read_back_exactly(folder, tissue):
    text, parquet = (
        pandas.read_csv(folder / "cells.csv"),
        pandas.read_parquet(folder / "cells.parquet"),
    )
    for name, column in tissue.columns.items():
        for table in (text, parquet):
            np.testing.assert_array_equal(table[name].to_numpy(), column)
    contacts = pandas.read_parquet(folder / "contacts.parquet")
    assert set(contacts["kind"]) <= {"apical_basal", "apical", "basal", "internal"}
    import pyarrow.parquet

    about = pyarrow.parquet.read_schema(folder / "cells.parquet").metadata
    assert about[b"unit"] == b"um" and json.loads(about[b"domain"])["basal_radius"] == 3


def test_anndata_holds_features_places_and_contacts(folder, tissue):
    data = anndata.read_h5ad(folder / "cells.h5ad")
    assert data.n_obs == CELLS and data.obs["name"].tolist() == list(NAMES)
    np.testing.assert_array_equal(np.ravel(cast(np.ndarray, data[:, "volume"].X)), tissue.columns["volume"])
    area = cast(Any, data.obsp["contact_area"]).toarray()
    np.testing.assert_allclose(area.sum(axis=1), tissue.columns["lateral_area"], rtol=1e-9)
    assert data.obsm["spatial"].shape == (CELLS, 3) and data.uns["unit"] == "um"


def test_walls_are_averaged_over_neighbors(positions):
    contacts = find_contacts(positions, TUBE)
    columns, own = tabulate_walls(contacts), (contacts.pairs == 4).any(axis=1)
    assert columns["wall_area_mean"][4] == pytest.approx(contacts.area[own].mean())
    assert columns["wall_area_sd"][4] == pytest.approx(contacts.area[own].std(ddof=1))


def test_the_command_exports_what_measure_left(tmp_path, positions, capsys):
    save_tissue(tmp_path, TUBE, BackboneTable(positions, NAMES))
    again = read_tissue(tmp_path)
    np.testing.assert_array_equal(again.positions, positions)
    assert again.domain == TUBE and again.names == NAMES
    arguments = ["export", str(tmp_path), "--to", "ome-tiff", "--spacing", "0.3", "0.4", "0.5"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'out' / 'labels.ome.tif'}\n"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["labels.ome.tif"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--to", "pdf"], "argument --to: invalid choice: 'pdf'"),
        (["--to", "ome-tiff", "--spacing", "1e-5", "1", "1e-5"], "e+12 voxels, too many; use a larger spacing"),
        (["--to", "pvd"], "pvd needs the stored sweeps of a run"),
        (["--to", "csv", "--spacing", "1", "1", "1"], "--spacing applies to ome-tiff and ome-zarr only"),
    ],
)
def test_what_cannot_be_exported_is_told_in_a_line(tmp_path, positions, capsys, arguments, told):
    save_tissue(tmp_path, TUBE, BackboneTable(positions, None))
    assert main(["export", str(tmp_path), *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1


def test_64_bits_tell_near_backbones_apart(tmp_path, capsys):
    with jax.enable_x64(True):
        save_tissue(tmp_path, TUBE, BackboneTable(np.array([[3, 0.5], [3, 0.5 + 1e-9], [1, 3]]), None))
    for more, code in (([], 2), (["--x64"], 0)):
        arguments = ["export", str(tmp_path), "--to", "csv", "--out", str(tmp_path / f"out{code}")]
        assert main([*arguments, *more]) == code


def test_a_cell_without_apical_area_has_no_ratio(tissue, recwarn):
    sizes = tissue.connectivity.sizes
    bare = sizes._replace(apical_area=np.where(np.arange(CELLS) == 2, 0, sizes.apical_area))
    connectivity = dataclasses.replace(tissue.connectivity, sizes=bare)
    other = TissueRecord(tissue.positions, TUBE)
    other.__dict__.update(connectivity=connectivity, meshes=tissue.meshes)  # as if they were found
    assert np.flatnonzero(np.isnan(other.columns["surface_ratio"])).tolist() == [2] and not recwarn.list


def test_a_folder_without_a_run_is_named(tmp_path, capsys):
    assert main(["export", str(tmp_path), "--to", "csv", "--out", str(tmp_path / "out")]) == 2
    assert "contains no backbones.csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("package", "kind", "extra"),
    [
        ("pyvista", "vtu", "viz"),
        ("tifffile", "ome-tiff", "io"),
        ("zarr", "ome-zarr", "zarr"),
        ("trimesh", "ply", "io"),
        ("anndata", "anndata", "anndata"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(tissue, tmp_path, monkeypatch, package, kind, extra):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ValueError, match=rf"needs {package}; install it with: pip install 'jaxtissue\[{extra}\]'"):
        export_tissue(tissue, tmp_path, [kind])
    assert not list(tmp_path.iterdir())


def test_a_sheet_is_exported_and_drawn(tmp_path):
    domain, folder = jt.Slab(5, 4, 1), tmp_path / "sheet"
    place = np.random.default_rng(0).uniform(0, (5, 4), (12, 2))
    folder.mkdir()
    save_tissue(folder, domain, BackboneTable(place, None))
    run = ["export", str(folder), "--to"]
    assert main([*run, "vtu", "ply", "csv", "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "cells.csv").open() as file:
        rows = list(csv.DictReader(file))
    exact = jt.exact_cells(place, domain, 10)
    np.testing.assert_allclose([float(row["volume"]) for row in rows], exact.volume, rtol=5e-3)
    assert [float(row["x"]) for row in rows] == pytest.approx(place[:, 0].tolist())
    bodies = [trimesh.load_mesh(path) for path in sorted((tmp_path / "out" / "ply").iterdir())]
    np.testing.assert_allclose([body.volume for body in bodies], exact.volume, rtol=2e-2)
    grid = pyvista.read(tmp_path / "out" / "cells.vtu")
    assert grid.n_cells > 12 and set(np.unique(grid.cell_data["cell"])) == set(range(12))
    assert main(["view", str(folder), "--what", "tissue", "--out", str(tmp_path / "tissue.png")]) == 0
    picture = np.asarray(Image.open(tmp_path / "tissue.png").convert("RGB")).reshape(-1, 3)
    assert len(np.unique(picture, axis=0)) > 100  # shaded cells in several colors
    assert main([*run, "ome-tiff", "--spacing", "0.1", "0.05", "0.05", "--out", str(tmp_path / "image")]) == 0
    image = tifffile.imread(tmp_path / "image" / "labels.ome.tif")
    assert image.shape == (10, 80, 100) and image.all()
    np.testing.assert_allclose(np.bincount(image.ravel())[1:] * 0.1 * 0.05**2, exact.volume, rtol=0.03)
