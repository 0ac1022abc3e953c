"""The shape of a cell encloses its volume and agrees with the nearest backbones; pictures can be drawn."""

import io
from functools import partial

import jax
import numpy as np
import pytest

from jaxtissue.geometry.tube import Tube
from jaxtissue.reproduction import pictures, tube_pictures
from jaxtissue.reproduction.pictures import plot_cell_in_tissues, plot_internal_pair, plot_scutoid
from jaxtissue.reproduction.shapes import (
    APICAL,
    BASAL,
    cell_edges,
    cut_cell,
    label_section,
    shape_cell,
    to_cell_frame,
)
from jaxtissue.reproduction.tube_pictures import plot_backbones, plot_tube
from jaxtissue.topology.contacts import find_contacts
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.transitions import find_transitions

TUBE = Tube(20, 2, 6)
POSITIONS = np.asarray(TUBE.random_positions(jax.random.key(4), 24), float)
INNER = int(np.abs(POSITIONS[:, 0] - 10).argmin())


@pytest.fixture(scope="module")
def edges():
    return trace_edges(POSITIONS, TUBE)


def rendered(figure):
    """The size of the figure as a file, which fails for what can't be drawn."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=50)
    return file.tell()


def enclosed(corners):
    """The volume within quadrilaterals that are oriented outwards, by the divergence theorem."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    return ((a * np.cross(b, c)).sum() + (a * np.cross(c, d)).sum()) / 6


def test_the_surfaces_of_all_cells_enclose_the_tissue():
    volumes = [enclosed(shape_cell(POSITIONS, TUBE, cell).corners) for cell in range(len(POSITIONS))]
    assert min(volumes) > 0
    # 80 layers and 100 lines cut corners; no cell of this tissue has a detached piece
    assert sum(volumes) == pytest.approx(float(TUBE.volume), rel=5e-3)


def test_a_shape_in_the_frame_of_another_cell_is_the_same_turned():
    own, other = shape_cell(POSITIONS, TUBE, INNER), shape_cell(POSITIONS, TUBE, INNER, frame=0)
    assert enclosed(other.corners) == pytest.approx(enclosed(own.corners), rel=1e-9)
    assert other.corners[..., 0] - own.corners[..., 0] == pytest.approx(POSITIONS[INNER, 0] - POSITIONS[0, 0])


def test_lines_through_a_cell_agree_with_the_nearest_backbones():
    offsets = np.linspace(-0.7, 0.7, 29)
    section = cut_cell(POSITIONS, TUBE, INNER, 4.0, offsets)
    axial = np.linspace(0, 20, 801)
    labels = label_section(POSITIONS, TUBE, 4.0, axial, POSITIONS[INNER, 1] + offsets)
    inside = (axial >= section.lower[:, None]) & (axial <= section.upper[:, None])
    assert inside.any() and (inside == (labels == INNER)).mean() > 0.9995  # float32 labels on the very wall


def test_walls_know_what_lies_behind_them(edges):
    shape = shape_cell(POSITIONS, TUBE, INNER)
    contacts = find_contacts(POSITIONS, TUBE, threshold=0.02, edges=edges)
    touching = contacts.pairs[(contacts.pairs == INNER).any(axis=1)].sum(axis=1) - INNER
    assert set(touching) <= set(shape.behind) and {APICAL, BASAL} <= set(shape.behind)
    radii = np.linalg.norm(shape.corners[..., 1:], axis=-1)
    assert radii[shape.behind == BASAL] == pytest.approx(6) and radii[shape.behind == APICAL] == pytest.approx(2)


def test_edges_lie_on_the_shape_and_the_frame_keeps_distances(edges):
    lines = cell_edges(edges, POSITIONS, INNER)
    corners = shape_cell(POSITIONS, TUBE, INNER).corners.reshape(-1, 3)
    gap = np.linalg.norm(lines[:, 0, None] - corners, axis=-1).min(axis=1)
    assert gap.max() < 0.15  # half the distance of two lines or layers
    points = np.random.default_rng(0).normal(size=(5, 3))
    assert np.ptp(points - points[0], axis=0).sum() > 0
    moved = to_cell_frame(points, POSITIONS[3])
    assert np.linalg.norm(moved - moved[0], axis=1) == pytest.approx(np.linalg.norm(points - points[0], axis=1))


def test_pictures_of_cells_name_their_axes(edges, monkeypatch):
    monkeypatch.setattr(pictures, "shape_cell", partial(shape_cell, layers=12, across=16))
    figure, axes = plot_cell_in_tissues(TUBE, INNER, [("start", POSITIONS, edges)])
    assert rendered(figure) and "length units" in axes[0].get_zlabel()
    found, contacts = find_transitions(POSITIONS, TUBE, edges), find_contacts(POSITIONS, TUBE, edges=edges)
    cell = int(found.per_cell.argmax())
    own = (contacts.pairs == cell).any(axis=1)
    kinds = dict(zip((contacts.pairs[own].sum(axis=1) - cell).tolist(), contacts.kind[own].tolist(), strict=True))
    points = found.points[(found.cells == cell).any(axis=1)]
    figure, axes = plot_scutoid(TUBE, POSITIONS, cell, kinds, (edges, points))
    assert rendered(figure) and "degrees" in axes[2].get_xlabel()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "transition point" in labels and len(labels) == len(set(kinds.values())) + 2
    first, second = contacts.pairs[0].tolist()
    figure, axes = plot_internal_pair(TUBE, POSITIONS, (first, second), 4.0, edges)
    assert rendered(figure) and all("length units" in panel.get_xlabel() for panel in axes[:3])


def test_pictures_of_tubes_name_their_axes(monkeypatch):
    monkeypatch.setattr(tube_pictures, "_GRID", (120, 60, 8))
    for plot in (plot_backbones, plot_tube):
        figure, axes = plot(TUBE, POSITIONS)
        assert rendered(figure) and "length units" in axes.get_xlabel() and "24" in axes.get_title()
