"""Tilted and bent backbones fitted to images: nodes are found where they were drawn."""

import csv
import json

import numpy as np
import pytest
from known import known
from scipy.spatial.transform import Rotation

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.diagram.nearest import Crowd
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.images import backbone_fit
from jaxtissue.images.drawing import draw_labels
from jaxtissue.images.frame import Frame
from jaxtissue.images.label_cells import measure_labels
from jaxtissue.images.tissue_fit import _wall_points

pytestmark = [
    pytest.mark.usefixtures("coarse_pictures"),
    pytest.mark.filterwarnings("ignore:the areas of .* walls may be wrong"),
]
TURNED = Rotation.from_euler("zyx", [33, -21, 50], degrees=True).as_matrix()
SPACING = (0.3, 0.15, 0.15)
SIZES, STEP = np.array(SPACING)[::-1], float(np.prod(SPACING) ** (1 / 3))
SLAB, TUBE, CYST = jt.Slab(6, 5, 2.4), jt.RoundTube(6, 2, 4), jt.Sphere(2, 3.6)


def bent(domain: Domain, straight: np.ndarray, nodes: int) -> np.ndarray:
    """Backbones that lean and bend alike by about half a cell, and each by itself by a part of that."""
    rng, height = np.random.default_rng(2), np.linspace(0, 1, nodes)
    n, width = straight.shape
    lean = 0.5 * np.ones(width) + 0.2 * rng.normal(size=(n, width))
    bow = 0.25 * np.ones(width) + 0.1 * rng.normal(size=(n, width))
    unit = 1 / 3 if domain is not SLAB else 1.0  # of an angle, or a direction
    place = straight[:, None] + unit * (
        lean[:, None] * (height[:, None] - 0.5) + bow[:, None] * (4 * height * (1 - height) - 2 / 3)[:, None]
    )
    if domain is CYST:
        return place / np.linalg.norm(place, axis=-1, keepdims=True)
    if domain is SLAB:
        return np.clip(place, 0, [6, 5])
    return np.stack([np.clip(place[..., 0], 0, 6), place[..., 1] % (2 * np.pi)], axis=-1)


def straight_on(domain: Domain) -> np.ndarray:
    """About twenty positions at a distance from each other."""
    rng = np.random.default_rng(0)
    if domain is CYST:
        height, turn = 1 - (2 * np.arange(20) + 1) / 20, np.pi * (3 - np.sqrt(5)) * np.arange(20)
        across = np.sqrt(1 - height**2)
        return np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
    rows, columns, size = (4, 5, [6, 5]) if domain is SLAB else (3, 7, [6, 2 * np.pi])
    row, column = np.divmod(np.arange(rows * columns), columns)
    shift = rng.uniform(-0.2, 0.2, (rows * columns, 2))
    return (np.column_stack([row, column + 0.3 * (row % 2)]) + 0.35 + shift) / [rows, columns] * size


def drawn(domain: Domain, positions: np.ndarray) -> tuple[np.ndarray, Frame]:
    """The tissue in an image, turned, with flat voxels."""
    points = nodes_in_space(domain, positions).reshape(-1, 3) @ TURNED
    low, high = points.min(axis=0) - 1.2, points.max(axis=0) + 1.2
    frame, shape = Frame(-low, TURNED), np.ceil((high - low)[::-1] / SPACING).astype(int).tolist()
    return draw_labels(domain, positions, np.arange(1, len(positions) + 1), frame, SIZES, tuple(shape))[0], frame


def nodes_in_space(domain: Domain, positions: np.ndarray) -> np.ndarray:
    """All nodes, [n, k, 3]."""
    crowd = Crowd(as_positions_on(positions, domain, np.float64, bent=True), domain)
    return np.concatenate([crowd.start, crowd.start[-1:] + crowd.along[-1:]]).swapaxes(0, 1)


def apart(fit: jt.TissueFit, domain: Domain, positions: np.ndarray, frame: Frame) -> np.ndarray:
    """The distances of nodes from the true ones, in voxels, [n, k]."""
    found, true = nodes_in_space(fit.domain, fit.positions), nodes_in_space(domain, positions[fit.labels - 1])
    off = [place.to_image(nodes.reshape(-1, 3)) for place, nodes in ((fit.frame, found), (frame, true))]
    return np.linalg.norm(off[0] - off[1], axis=1).reshape(found.shape[:2]) / STEP


@pytest.mark.parametrize(
    ("domain", "shape", "nodes", "near"),
    [(SLAB, "slab", 2, 0.9), (SLAB, "slab", 3, 0.9), (TUBE, "tube", 2, 0.2), (TUBE, "tube", 3, 0.5),
     (CYST, "sphere", 2, 0.3)],
)  # fmt: skip
def test_nodes_are_found_where_they_were_drawn(domain, shape, nodes, near):
    """Found within 0.67, 0.67, 0.11, 0.34, 0.18 voxels, rms; cells of the sheet have a third as many voxels."""
    positions = bent(domain, straight_on(domain), nodes)
    image, frame = drawn(domain, positions)
    fit = jt.fit_tissue(image, SPACING, shape, nodes)
    off = apart(fit, domain, positions, frame)
    assert type(fit.domain) is type(domain) and fit.positions.shape == positions.shape
    assert np.sqrt((off**2).mean()) < near and off.max() < 4 * near
    # walls of a few voxels may be missed or made up in the image
    assert fit.report["voxels_same"] > 0.98 and fit.report["neighbors_kept"] > 0.9
    assert fit.report["volume_error"] < 0.03 and known(fit.connectivity).transitions.open_ends == 0
    upright = jt.fit_tissue(image, SPACING, shape)
    assert upright.report["voxels_same"] < fit.report["voxels_same"] - 0.05


def test_columns_are_those_of_the_model_in_the_image():
    positions = bent(SLAB, straight_on(SLAB), 2)
    image, _ = drawn(SLAB, positions)
    fit = jt.fit_tissue(image, SPACING, "slab", 2)
    columns, model = fit.columns(), measure_labels(fit.voxels, SPACING)
    np.testing.assert_allclose(columns["basal_x"], fit.positions[:, 1, 0])
    np.testing.assert_array_equal(columns["model_neighbors"], known(fit.connectivity).contacts.degree())
    # walls of a few voxels may be missed or made up in the image
    assert abs((columns["model_neighbors"] - model.neighbors).mean()) < 0.5
    np.testing.assert_allclose(columns["model_volume"], model.volume)
    assert "nan" not in repr(fit) and columns["model_is_end"].any()


def test_one_node_is_a_straight_backbone():
    image, _ = drawn(SLAB, straight_on(SLAB))
    fits = [jt.fit_tissue(image, SPACING, "slab", nodes) for nodes in (None, 1)]
    np.testing.assert_array_equal(fits[0].positions, fits[1].positions)
    assert fits[0].positions.ndim == 2


def test_slopes_are_those_of_the_distances():
    """Against central differences; feet move, but at the smallest distance this changes nothing to first order."""
    positions = bent(TUBE, straight_on(TUBE), 3)
    image, frame = drawn(TUBE, positions)
    task = backbone_fit._Task(TUBE, _wall_points(image, SIZES, frame), STEP, np.ones(1))
    task = task._replace(root=np.ones(len(task.walls.areas)))
    found = backbone_fit._look(task, positions)
    table = backbone_fit._differences(task, positions, found, np.ones(2))
    for cell, node, axis in ((4, 0, 0), (9, 1, 1), (16, 2, 1)):
        values = []
        for change in (1e-2, -1e-2):  # float32
            moved = positions.copy()
            moved[cell, node, axis] += change
            first, second = backbone_fit._look(task, moved).feet
            values.append((first.square - second.square) * found.weight)
        column = table[:, [(cell * 3 + node) * 2 + axis]].toarray().ravel()
        slope = (values[0] - values[1]) / 2e-2
        assert np.abs(column).max() > 1 and np.abs(slope - column).max() < 0.03 * np.abs(column).max()


def test_nodes_without_walls_go_on_nearly_straight():
    """The upper half of one cell has no wall points, and its nodes there start far off."""
    positions = bent(SLAB, straight_on(SLAB), 4)
    image, frame = drawn(SLAB, positions)
    walls = _wall_points(image, SIZES, frame)
    kept = (walls.points[:, 2] < 1.2) | (walls.pairs != 7).all(axis=1)
    walls = backbone_fit.WallPoints(*(column[kept] for column in walls))
    start = positions + np.random.default_rng(0).normal(0, 0.1, positions.shape)
    start[7, 2:] += 0.8
    found = backbone_fit.fit_backbones(SLAB, start, walls, STEP, lambda place: np.clip(place, 0, [6, 5]))
    assert np.abs(np.diff(found[7], 2, axis=0)[-1]).max() < 0.25  # from 0.8, found 0.17
    assert np.abs(np.delete(found - positions, 7, axis=0)).max() < 3 * STEP


@pytest.mark.filterwarnings("ignore:contacts of the fitted cells are not computed")  # cells reach far round the lumen
def test_cells_that_the_image_cuts_stay_near():
    """Of 17 cells, 11 lack a part of their walls; without stiffness nodes of theirs were off by 23 voxels."""
    positions = bent(TUBE, straight_on(TUBE), 3)
    image, frame = drawn(TUBE, positions)
    fit = jt.fit_tissue(image[:, :, : image.shape[2] // 2], SPACING, "tube", 3)
    assert fit.cells.at_border.sum() == 11 and fit.report["voxels_same"] > 0.98
    assert apart(fit, TUBE, positions, frame)[fit.cells.at_border].max() < 5  # found up to 2.8


@pytest.mark.parametrize("nodes", [0, -2, 2.5, True, "two"])
def test_numbers_that_are_none_are_refused(nodes):
    with pytest.raises(ValueError, match="is not a number of nodes; give 1"):
        jt.fit_tissue(np.ones((4, 4, 4), int), (1, 1, 1), nodes=nodes)


def test_more_nodes_than_voxels_are_refused():
    image, _ = drawn(SLAB, straight_on(SLAB))
    with pytest.raises(ValueError, match=r"nodes=9 are too many for a tissue of 12\.7 voxels .*; give at most 7"):
        jt.fit_tissue(image, SPACING, "slab", 9)


@pytest.mark.parametrize("nodes", [2, 3])
def test_commands_go_on_from_nodes(tmp_path, capsys, nodes):
    positions = bent(TUBE, straight_on(TUBE), nodes)
    path, out = tmp_path / "labels.npy", tmp_path / "fitted"
    np.save(path, drawn(TUBE, positions)[0])
    assert main(["fit", str(path), "--spacing", *map(str, SPACING), "--nodes", str(nodes), "--out", str(out)]) == 0
    assert "--no-contacts" not in capsys.readouterr().out
    assert json.loads((out / "domain.json").read_text())["shape"] == "round_tube"
    assert json.loads((out / "fit.json").read_text())["nodes"] == nodes
    with (out / "backbones.csv").open() as file:
        rows = list(csv.DictReader(file))
    expected = {"apical_axial", "basal_angle"} if nodes == 2 else {"cell", "height", "axial", "angle"}
    assert expected <= rows[0].keys() and len(rows) == (1 if nodes == 2 else nodes) * len(positions)
    assert (out / "index.html").is_file() and not (out / "tissue.png").exists()
    taken = [str(out / "backbones.csv"), "--domain", str(out / "domain.json"), "--flat"]
    assert main(["measure", *taken, "--out", str(tmp_path / "measured")]) == 0
    with (out / "cells.csv").open() as file, (tmp_path / "measured/cells.csv").open() as other:
        drawn_cells, measured = list(csv.DictReader(file)), list(csv.DictReader(other))
    for one, two in zip(drawn_cells, measured, strict=True):
        assert float(one["model_volume"]) == pytest.approx(float(two["volume"]), rel=0.1)
    assert main(["fit", str(path), "--nodes", "0", "--out", str(tmp_path / "no")]) == 2
