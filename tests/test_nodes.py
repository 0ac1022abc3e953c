"""Tilted and bent backbones: the same sizes as straight ones where they are straight, and those of the exact path."""

import json

import jax
import numpy as np
import pytest
from scipy.spatial import Voronoi

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.geometry.domain_files import save_domain
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.neighbors.section_lists import find_sections, look_through
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import read_backbones
from jaxtissue.sections.cells import RULE, plan_layers
from jaxtissue.sections.contacts import layer_contacts
from jaxtissue.sections.views import Polylines
from jaxtissue.tissue.domain_tissue import THOROUGH

pytestmark = pytest.mark.usefixtures("coarse_pictures")
CELLS = 40
SLAB = jt.Slab(6, 5, 1.5, periodic=(True, True))
TUBE, PIPE = jt.Tube(10, 1, 2), jt.RoundTube(10, 1, 2)


def errors(measured, exact) -> float:
    """Root mean square error, as a part of the mean."""
    measured, exact = np.asarray(measured, float), np.asarray(exact, float)
    return float(np.sqrt(((measured - exact) ** 2).mean()) / exact.mean())


@pytest.fixture(scope="module")
def tilted():
    """Apical ends anywhere, basal ends up to a quarter of a cell's width away, some of them beyond a period."""
    apical = np.asarray(SLAB.random_positions(jax.random.key(1), CELLS), float)
    place = np.stack([apical, apical + np.random.default_rng(0).uniform(-0.2, 0.2, (CELLS, 2))], axis=1)
    return place, find_sections(SLAB, as_domain_positions(place, SLAB, bent=True), plan_layers(4))


def measured(place, found):
    """Sections on the lists of another tissue, which must be complete for this one too."""
    place = as_domain_positions(place, SLAB, bent=True)
    again, lacks = look_through(SLAB, place, found.lists, plan_layers(4), RULE)
    assert len(lacks) == again.unproved == 0
    return again


def test_upright_backbones_on_a_periodic_slab_have_prisms_over_the_plane_diagram(tilted):
    """Given by both ends. Exactly 6 neighbors on the mean, and sizes of the plane diagram to rounding."""
    place = tilted[0][:, 0]
    found = measured(np.stack([place, place], axis=1), tilted[1])
    volume, area, edges = found.sizes.volume[0], found.sizes.lateral_area[0], np.asarray(found.sections.is_edge)
    diagram = Voronoi(np.concatenate([place + np.array([6 * u, 5 * v]) for u in (0, -1, 1) for v in (0, -1, 1)]))
    for cell in range(CELLS):
        x, y = diagram.vertices[diagram.regions[diagram.point_region[cell]]].T
        order = np.argsort(np.arctan2(y - y.mean(), x - x.mean()))
        x, y = x[order], y[order]
        inside = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
        rim = np.hypot(x - np.roll(x, 1), y - np.roll(y, 1)).sum()
        assert float(volume[cell]) == pytest.approx(1.5 * inside, rel=1e-4, abs=1e-5)
        assert float(area[cell]) == pytest.approx(1.5 * rim, rel=1e-4)
    assert (edges.sum(axis=(0, 2)) == 6 * CELLS).all()
    contacts, layers = layer_contacts(found.sections, found.lists), len(found.layers.heights)
    total = np.bincount(contacts.layer, contacts.length, layers)
    np.testing.assert_allclose(2 * total[-2], np.asarray(found.sizes.perimeters[0], float).sum(), rtol=1e-5)
    assert (np.bincount(contacts.layer) <= 3 * CELLS).all() and (contacts.layer[contacts.length > 0.01] >= 0).all()


def test_the_nearest_of_the_segments_of_a_bent_backbone_counts():
    """Nodes (0, 0, 0), (1, 0, 1) and (0, 0, 2): a point inside of the bend, one outside and one beyond the end."""
    start, along = np.array([[0, 0, 0], [1, 0, 1.0]]), np.array([[1, 0, 1], [-1, 0, 1.0]])
    lines = Polylines(*(tuple(part[None, :, None, None] for part in table.T) for table in (start, along)))
    points = np.array([[0, 1, 0.8], [2, 0, 1], [0, 0, 3]])
    away = np.stack([part.ravel() for part in lines.offset(tuple(part[None, None] for part in points.T))], axis=1)
    np.testing.assert_allclose(away, [[-0.4, 1, 0.4], [1, 0, 0], [0, 0, 1]], atol=1e-6)


def test_bent_backbones_whose_nodes_are_in_line_have_the_cells_of_tilted_ones(tilted):
    place, found = tilted
    middle = 0.3 * place[:, 1] + 0.7 * place[:, 0]
    nodes = np.stack([place[:, 0], middle, place[:, 1]], axis=1)
    height = np.broadcast_to([0, 0.3, 1], (CELLS, 3))[..., None]
    sizes = measured(np.concatenate([nodes, height], axis=2), found).sizes
    # to rounding, but for corners of walls that are nearly parallel
    np.testing.assert_allclose(sizes.volume[0], found.sizes.volume[0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(sizes.lateral_area[0], found.sizes.lateral_area[0], rtol=1e-3)


def test_tilted_cells_are_those_of_the_exact_path(tilted):
    place, found = tilted
    exact = jt.exact_cells(place, SLAB, 15)
    assert exact.volume.sum() == pytest.approx(SLAB.volume, rel=1e-9)
    assert errors(found.sizes.volume[0], exact.volume) < 2e-3
    # cells 36 and 37 have backbones that nearly cross: 0.12 apart at the ends, and 0.05 half way
    others = np.delete(np.arange(CELLS), [36, 37])
    assert errors(found.sizes.lateral_area[0][others], exact.lateral_area[others]) < 3e-3
    assert errors(found.sizes.lateral_area[0], exact.lateral_area) < 1e-2
    bent = np.stack([place[:, 0], place.mean(axis=1), place[:, 1]], axis=1)
    again = jt.exact_cells(bent, SLAB, 15)
    np.testing.assert_allclose(again.volume, exact.volume, rtol=1e-9)
    np.testing.assert_allclose(again.wall_area, exact.wall_area, rtol=1e-6, atol=1e-9)


def test_layers_between_bends_integrate_what_has_kinks_there():
    """Each part has one layer more than its share, and one less in the second rule; heights may be traced."""
    bends = np.array([0.3, 0.5])

    def integral(bends):
        layers = plan_layers(4, bends=bends)
        kinked = abs(layers.heights - bends[0]) - 2 * abs(layers.heights - bends[1])
        return layers.weights @ kinked

    expected = (0.3**2 + 0.7**2) / 2 - 2 * 0.5**2
    np.testing.assert_allclose(integral(bends), [expected] * 2, rtol=1e-12)
    np.testing.assert_allclose(jax.jit(integral)(bends), [expected] * 2, rtol=1e-5)
    assert len(plan_layers(4, bends=bends).heights) == 3 * (3 + 2) + 2


def test_bent_cells_are_measured_as_well_as_on_many_layers():
    """Nodes some 0.05 cell widths aside; four layers anywhere miss volumes by 0.15 %."""
    place = np.asarray(SLAB.random_positions(jax.random.key(1), CELLS), float)
    nodes = place[:, None] + np.random.default_rng(0).normal(scale=0.04, size=(CELLS, 3, 2))
    cells, true = jt.measure_tissue(nodes, SLAB), jt.measure_tissue(nodes, SLAB, "32x1")
    assert errors(cells.volume, true.volume) < 3e-4
    assert errors(cells.lateral_area, true.lateral_area) < 2e-3


@pytest.mark.parametrize(
    ("positions", "domain", "told"),
    [
        ([[[1, 1]]], SLAB, r"give \(x, y\) for k >= 2 nodes"),
        ([[[1, 1], [1, np.nan]]], SLAB, r"backbone 0 \(node 1\): y=nan"),
        ([[[1, 1], [7, 1]]], jt.Slab(4, 3, 2), r"backbone 0 \(node 1\): x=7.0 is outside"),
        ([[[1, 1, 0], [1, 2, 0.5]]], SLAB, r"backbone 0 \(node 0\): the node heights 0, 0.5 do not increase"),
        (
            [[[1, 1], [2, 2]], [[3, 1], [2, 2]]],
            SLAB,
            r"backbones 0 \(node 1\) and 1 \(node 1\) have the same position, 2, 2",
        ),
    ],
)
def test_wrong_nodes_are_refused(positions, domain, told):
    with pytest.raises(ValueError, match=told):
        as_domain_positions(positions, domain, bent=True)


def test_what_takes_straight_backbones_alone_says_so():
    nodes, model = np.zeros((2, 2, 2)), jt.tube_model(TUBE, 2)
    for straight in (jt.NeighborList.allocate, jt.find_contacts, jt.infer_parameters):
        with pytest.raises(ValueError, match=r"can only be measured .* or for a tube a RoundTube"):
            straight(nodes, TUBE)
    with pytest.raises(ValueError, match=r"can only be measured .* or for a tube a RoundTube"):
        jt.relax(nodes, model)


@pytest.mark.parametrize("heights", [None, [0, 0.5, 1], [0, 0.2, 1]])
def test_tables_read_back(heights, tmp_path):
    place, names = np.array([[[1, 0.1], [2, 6.2]], [[3, 2], [3, 3]]]), ("a", "b")
    if heights:
        middle = np.insert(place, 1, [[4, 1], [5, 1]], axis=1)
        height = np.broadcast_to(heights, (2, 3))[..., None]
        place = middle if heights[1] == 0.5 else np.concatenate([middle, height], axis=2)
    storage.write_backbones(tmp_path / "b.csv", place, names)
    read = read_backbones(tmp_path / "b.csv", PIPE, bent=True)
    np.testing.assert_allclose(read.positions, place, rtol=1e-15)
    assert read.names == names
    with pytest.raises(ValueError, match=r"b\.csv has (tilted|bent) backbones: .* can only be measured"):
        read_backbones(tmp_path / "b.csv", PIPE)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("cell,height,axial,angle\na,0,1,1\na,1,1,1\nb,0,2,2\nb,0.5,2,2\nb,1,2,2\n", "line 4: cell='b' has 3 nodes"),
        ("cell,height,axial,angle\na,0,1,1\na,1,11,1\n", "line 3: axial=11.0 is outside"),
        ("apical_axial,apical_angle,basal_axial\n1,1,1\n", "has no column 'axial'"),
    ],
)
def test_wrong_tables_are_refused(text, told, tmp_path):
    (tmp_path / "b.csv").write_text(text)
    with pytest.raises(ValueError, match=told):
        read_backbones(tmp_path / "b.csv", TUBE, bent=True)


@pytest.mark.filterwarnings("ignore:the volume of 2 of 40 cells")
def test_measure_takes_tilted_backbones(tilted, tmp_path, capsys):
    storage.write_backbones(tmp_path / "t.csv", tilted[0] % [6, 5], columns=SLAB.columns)
    save_domain(SLAB, tmp_path / "slab.json")
    run = ["measure", str(tmp_path / "t.csv"), "--domain", str(tmp_path / "slab.json"), "--out", str(tmp_path / "m")]
    assert main(run) == 0
    summary = json.loads((tmp_path / "m/summary.json").read_text())
    assert summary["apical_degree"] == summary["basal_degree"] == pytest.approx(6)
    assert summary["mean_neighbors"] >= 6 and summary["open_ends"] == 0 and 0 < summary["scutoid_fraction"] <= 1
    assert "cells " in capsys.readouterr().out and not list((tmp_path / "m").glob("scutoid*"))
    assert ",neighbors," in (tmp_path / "m/cells.csv").read_text()
    header, *rows = (tmp_path / "m/cells.csv").read_text().splitlines()
    assert header.startswith("cell,apical_x,apical_y,basal_x,basal_y,volume") and len(rows) == CELLS
    volume = [float(row.split(",")[5]) for row in rows]
    found = find_sections(SLAB, as_domain_positions(tilted[0], SLAB, bent=True), plan_layers(4), THOROUGH)
    np.testing.assert_allclose(volume, found.sizes.volume[0], rtol=1e-4)
    assert (tmp_path / "m/backbones.csv").read_text().startswith("apical_x,apical_y,basal_x,basal_y\n")
