"""Figures: they show the right numbers and say what they show."""

import io

import jax
import numpy as np
import pytest
from known import known
from matplotlib.figure import Figure
from matplotlib.image import imread

from jaxtissue.geometry.tube import Tube
from jaxtissue.runs.plots import Tissue, plot_energy, plot_surfaces, plot_volumes
from jaxtissue.runs.surface_maps import label_surface

TUBE = Tube(20, 2, 5)
POSITIONS = np.asarray(TUBE.random_positions(jax.random.key(3), 12))
SWEEPS = {
    "sweep": np.arange(4),
    "energy": np.array([100.0, 50, 30, 20]),
    "volume_energy": np.array([90.0, 42, 23, 14]),
    "area_energy": np.array([10.0, 8, 7, 6]),
}


def rendered(figure):
    """The figure as an image, which fails for what can't be drawn."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=60)
    file.seek(0)
    return imread(file)


def test_energy_shows_the_total_and_its_terms():
    figure, axes = plot_energy(SWEEPS, ([0, 3], [99.0, 21.0]))
    lines = {line.get_label(): line for line in axes.lines}
    for label, column in [
        ("total", "energy"),
        ("volume term", "volume_energy"),
        ("area term", "area_energy"),
    ]:
        np.testing.assert_array_equal(lines[label].get_xdata(), SWEEPS["sweep"])
        np.testing.assert_array_equal(lines[label].get_ydata(), SWEEPS[column])
    assert np.asarray(lines["total, measured finely"].get_ydata()).tolist() == [99.0, 21.0]
    assert len({(line.get_color(), line.get_linestyle()) for line in axes.lines}) == 4
    assert axes.get_xlabel() == "sweep" and "model units" in axes.get_ylabel()
    assert len(known(axes.get_legend()).get_texts()) == 4
    assert rendered(figure).std() > 0


def test_panels_draw_where_they_are_told():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert plot_energy(SWEEPS, ax=left) == (figure, left) and len(left.lines) == 3
    assert plot_volumes([0], [np.ones(3)], 1.0, ax=right) == (figure, right) and len(right.lines) == 2


def test_energy_of_nothing_can_be_drawn():
    nothing = {name: np.zeros(1) for name in SWEEPS}
    assert rendered(plot_energy(nothing)[0]).std() > 0


def test_volumes_are_sorted_and_set_against_the_mean():
    volumes = [np.array([3.0, 1.0, 2.0]), np.array([2.1, 1.9, 2.0])]
    figure, axes = plot_volumes([0, 5], volumes, 2.0)
    first, last, mean = axes.lines
    assert np.asarray(first.get_ydata()).tolist() == [1, 2, 3]
    assert np.asarray(last.get_ydata()).tolist() == [1.9, 2.0, 2.1]
    assert [line.get_label() for line in axes.lines] == ["sweep 0", "sweep 5", "mean 2"]
    assert np.asarray(mean.get_ydata()).tolist() == [2.0, 2.0]
    assert "length units³" in axes.get_ylabel() and "smallest to the largest" in axes.get_xlabel()
    assert rendered(figure).std() > 0


@pytest.mark.parametrize(("surface", "radius"), [("apical", 2.0), ("basal", 5.0)])
def test_a_surface_is_labeled_by_the_nearest_backbone(surface, radius):
    labels = label_surface(POSITIONS, TUBE, surface, (40, 36))
    x, angle = POSITIONS.astype(float).T
    foot = np.linspace(2, 5, 3001)
    for i, j in [(0, 0), (39, 35), (17, 5), (25, 30), (8, 20)]:
        axial, turn = (i + 0.5) / 2, np.radians(10 * j + 5) - angle
        square = (axial - x) ** 2 + (radius**2 + foot[:, None] ** 2 - 2 * radius * foot[:, None] * np.cos(turn))
        assert labels[i, j] == square.min(axis=0).argmin()


def test_surfaces_are_mapped_before_and_after():
    volume = np.linspace(0.5, 1.5, 12)
    figure, axes = plot_surfaces(TUBE, (Tissue("before", POSITIONS, volume), Tissue("after", POSITIONS, volume)))
    assert [[panel.get_title() for panel in row] for row in axes] == [
        ["basal surface, before", "basal surface, after"],
        ["apical surface, before", "apical surface, after"],
    ]
    for panel, radius in zip(axes.flat, (5, 5, 2, 2), strict=True):
        image = panel.images[0]
        assert tuple(image.get_extent()) == (0, 20, 0, 360)
        assert panel.get_aspect() == pytest.approx(2 * np.pi * radius / 360)  # to scale
        assert (image.get_array()[..., :3] == 38).all(axis=-1).any()  # walls
        x, y = panel.lines[0].get_data()
        np.testing.assert_allclose(np.stack([x, np.radians(y)], axis=-1), POSITIONS, rtol=1e-6)
    assert "angle (degrees)" in axes[0, 0].get_ylabel() and "length units" in axes[1, 0].get_xlabel()
    assert [texts.get_text() for texts in figure.legends[0].get_texts()] == ["end of a backbone", "wall"]
    assert "mean volume" in figure.axes[-1].get_ylabel()
    assert rendered(figure).std() > 0


def test_a_cell_has_the_color_of_its_volume():
    tissue = Tissue("one", np.array([[5.0, 1.0], [15.0, 1.0]]), np.array([1.0, 3.0]))
    axes = plot_surfaces(TUBE, [tissue])[1]
    image = axes[0, 0].images[0].get_array()
    small, large = image[210, 200].astype(int), image[210, 600].astype(int)  # 0.5 and 1.5 of the mean: blue and red
    assert small[2] > small[0] and large[0] > large[2]
    assert (image[210, 398:402, :3] < 50).all(axis=-1).any()  # the wall between them
