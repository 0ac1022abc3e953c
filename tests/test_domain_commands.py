"""The commands on domains other than tubes."""

import csv

import jax
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.compilation.modes import random_key
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.geometry.domain_files import save_domain
from jaxtissue.runs.batches import Outcome
from jaxtissue.runs.plots import Tissue, plot_surfaces

pytestmark = pytest.mark.usefixtures("coarse_pictures")
CYST = jt.Sphere(1, 1.5)


def read_table(path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_what_measure_can_not_do_there_is_one_line(tmp_path, capsys):
    (tmp_path / "two.csv").write_text("axial,angle\n2,0\n8,0\n")
    save_domain(jt.RoundTube(10, 1, 2, periodic=True), tmp_path / "domain.json")
    run = [
        "measure",
        str(tmp_path / "two.csv"),
        "--domain",
        str(tmp_path / "domain.json"),
        "--out",
        str(tmp_path / "m"),
    ]
    for more, told in (
        ([], "or measure sizes only, with --no-contacts"),
        (["--tolerance", "0.01"], "use --resolution fine"),
    ):
        assert main([*run, *more]) == 2
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1


def test_a_grid_on_a_domain(tmp_path, capsys, monkeypatch):
    """Its rows have the shape and the sizes; nothing is annealed here."""

    def nothing(rows, *_):
        begun = [row.place.random_positions(random_key(row.seed), row.cells) for row in rows]
        return [Outcome([SweepRecord(*[0] * len(SweepRecord._fields))], np.asarray(place)) for place in begun]

    monkeypatch.setattr("jaxtissue.runs.grid_runs.anneal_batch", nothing)
    save_domain(jt.Slab(4, 3, 1, periodic=(True, True)), tmp_path / "domain.json")
    run = ["grid", "--domain", str(tmp_path / "domain.json"), "--cells", "40", "--seed", "3", "--out"]
    assert main([*run, str(tmp_path / "grid")]) == 0
    (row,) = read_table(tmp_path / "grid/table.csv")
    assert row["shape"] == "slab" and float(row["width"]) == 4 and row["periodic_1"] == "True"
    assert float(row["neighbors"]) == 6 and float(row["scutoid_fraction"]) == 0
    assert (tmp_path / "grid/backbones" / row["backbones"]).read_text().startswith("x,y\n")
    assert main([*run, str(tmp_path / "grid")]) == 0  # nothing is left to do
    capsys.readouterr()
    assert main([*run, str(tmp_path / "other"), "--ratio", "2"]) == 2
    assert "--ratio conflicts with the domain" in capsys.readouterr().err


def test_a_closed_surface_is_seen_from_two_sides():
    """On a sphere of two cells, one on either side, each view shows its own."""
    axes = plot_surfaces(CYST, [Tissue("", np.array([[0, 0, 1.0], [0, 0, -1.0]]), np.array([1.0, 3.0]))])[1]
    assert [panel.get_title() for panel in axes[0]] == [
        "basal surface, from above", "basal surface, from below"
    ]  # fmt: skip
    above, below = (panel.images[0].get_array()[24, 24] for panel in axes[0])
    assert above[2] > above[0] and below[0] > below[2]  # small and blue, large and red
    assert tuple(axes[1, 0].images[0].get_extent()) == (-1, 1, -1, 1)


def test_an_unrolled_map_has_the_nearest_backbones():
    fold = jt.Fold(8, 4, 0.4, 4, 0.4)
    place = np.asarray(fold.random_positions(jax.random.key(2), 12), float)
    panel = plot_surfaces(fold, [Tissue("one", place, np.arange(12.0))])[1][1, 0]
    assert tuple(panel.images[0].get_extent()) == (0, 8, 0, 4) and panel.get_title() == "apical surface, one"
    np.testing.assert_allclose(np.stack(panel.lines[0].get_data(), axis=1), place)
