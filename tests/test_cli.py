"""The command line as a user meets it: files and figures it leaves, resuming, and one line for bad input."""

import csv
import json
import os
import shutil
import signal
import subprocess
import time
import warnings
from pathlib import Path

import jax
import networkx as nx
import numpy as np
import pytest
import quick

import jaxtissue
from jaxtissue.cli.commands import main
from jaxtissue.compilation import program_cache
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import PRESETS
from jaxtissue.runs import reports, storage
from jaxtissue.runs.backbone_files import read_backbones
from jaxtissue.runs.run_folders import read_tissue
from jaxtissue.system.locks import alone
from jaxtissue.topology import edges

pytestmark = pytest.mark.usefixtures("coarse_pictures")
SIZES = ("--length", "12", "--apical-radius", "2", "--basal-radius", "4")
SMALL = ("anneal", *SIZES, "--cells", "16", "--seed", "3")
LONG = (*SMALL, "--sweeps", "30")
SIZE_COLUMNS = (
    "cell,axial,angle,volume,lateral_area,apical_area,basal_area,"
    "apical_perimeter,basal_perimeter,volume_error,lateral_area_error,energy,is_end"
)
CONTACT_COLUMNS = (
    "neighbors,apical_basal_neighbors,apical_neighbors,basal_neighbors,internal_neighbors,"
    "transitions,is_scutoid,is_ring,pieces"
)
SIZES_SUMMED = [
    *("tissue_volume", "total_volume", "total_lateral_area", "energy"),
    *("separation", "covering_radius", "tightness", "tiling_defect"),
    *("largest_volume_error", "largest_lateral_area_error", "seconds"),
]
COUNTED = {
    "neighbors": "deg_any",
    "apical_basal_neighbors": "deg_both",
    "apical_neighbors": "deg_aonly",
    "basal_neighbors": "deg_bonly",
    "internal_neighbors": "deg_internal",
    "transitions": "tp_count",
}
MEANS = [
    *("neighbors", "apical_basal_neighbors", "apical_neighbors", "basal_neighbors", "internal_neighbors"),
    *("apical_degree", "basal_degree", "transitions", "transitions_max", "scutoid_fraction"),
    *("internal_fraction", "ring_fraction", "detached_fraction", "identity_residual"),
]
GOOD = "axial,angle\n1,0\n5,2\n9,4\n"


def start(*arguments):
    """The command in a process of its own, with its output as text."""
    path = os.pathsep.join([str(Path(jaxtissue.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        quick.command(*arguments),
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def read_table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def without_seconds(path):
    return [{name: text for name, text in row.items() if name != "seconds"} for row in read_table(path)]


def column(rows, name):
    return np.array([float(row[name]) for row in rows])


def count_rows(path):
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


@pytest.fixture(scope="module")
def annealed(tmp_path_factory):
    """The folder of an uninterrupted run of `LONG`."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program_cache, "is_on", True)  # for commands that tests start
        assert main([*LONG, "--out", str(folder)]) == 0
    return folder


def test_anneal_leaves_tables_figures_and_a_manifest(annealed):
    assert {path.name for path in annealed.iterdir()} == {
        *("manifest.json", "initial_backbones.csv", "backbones.csv", "cells.csv", "sweeps.csv"),
        *("contacts.csv", "transitions.csv"),
        *("checkpoint.npz", "energy.png", "volumes.png", "surfaces.png", "index.html"),
    }
    sweeps, cells = read_table(annealed / "sweeps.csv"), read_table(annealed / "cells.csv")
    assert column(sweeps, "sweep").tolist() == list(range(31))
    needed = "sweep,energy,volume_energy,area_energy,temperature,acceptance,rounds,collisions,seconds"
    assert ",".join(sweeps[0]).startswith(needed)
    assert [float(sweeps[0][name]) for name in ("rounds", "collisions", "seconds")] == [0, 0, 0]
    terms = column(sweeps, "volume_energy") + column(sweeps, "area_energy")
    np.testing.assert_allclose(column(sweeps, "energy"), terms, rtol=1e-5)
    assert column(sweeps, "energy")[-1] < column(sweeps, "energy")[0]
    # Measured by `draft` in sweeps, from traced edges in the table.
    assert column(cells, "energy").sum() == pytest.approx(column(sweeps, "energy")[-1], rel=0.02)
    final = read_backbones(annealed / "backbones.csv", Tube(12, 2, 4)).positions
    np.testing.assert_array_equal(final, np.stack([column(cells, "axial"), column(cells, "angle")], axis=-1))


def test_the_manifest_tells_how_the_run_was_made(annealed):
    manifest = json.loads((annealed / "manifest.json").read_text())
    arguments = manifest["arguments"]
    assert (arguments["length"], arguments["cells"], arguments["seed"], arguments["sweeps"]) == (
        12,
        16,
        3,
        30,
    )
    assert arguments["temperature"] == 2 and arguments["tension"] == 0.4 and arguments["resolution"] == "draft"
    assert manifest["versions"].keys() >= {"jaxtissue", "jax", "jaxlib", "numpy", "scipy", "python"}
    assert manifest["dtype"] == "float32" and manifest["device"] and manifest["platform"]
    assert manifest["started"] <= manifest["finished"] and manifest["compile_seconds"] > 0
    energy = manifest["energy"]
    assert energy["final"] < energy["initial"]
    assert energy["final_measured"] == pytest.approx(energy["final"], rel=0.02)


def test_a_finished_run_is_left_as_it_is(annealed, capsys):
    before = {path: path.read_bytes() for path in annealed.iterdir()}
    assert main(["anneal", "--out", str(annealed), "--resume"]) == 0
    assert main([*LONG, "--out", str(annealed), "--resume"]) == 0
    assert {path: path.read_bytes() for path in annealed.iterdir()} == before
    assert "finished" in capsys.readouterr().err


CHANGES = [
    ("--seed", "4"),
    ("--temperature", "1"),
    ("--resolution", "fine"),
    ("--algorithm", "mh"),
    ("--basal-radius", "5"),
    ("--cells", "17"),
    ("--x64",),
    ("--sweeps", "29"),
    ("--final-temperature", "1"),
    ("--minimum-contact", "0.1"),
    ("--no-contacts",),
]


@pytest.mark.parametrize("change", CHANGES, ids=" ".join)
def test_a_changed_argument_is_refused(annealed, change, capsys):
    before = {path: path.read_bytes() for path in annealed.iterdir()}
    assert main(["anneal", "--out", str(annealed), "--resume", *change]) == 2
    error = capsys.readouterr().err
    assert " ".join(change) in error and error.count("\n") == 1
    assert {path: path.read_bytes() for path in annealed.iterdir()} == before


def same_run(folder, whole):
    """Whether two runs left the same, to the last byte but for the seconds."""
    names = ("initial_backbones.csv", "backbones.csv", "cells.csv", "contacts.csv", "transitions.csv")
    names += ("volumes.png", "surfaces.png")
    assert without_seconds(folder / "sweeps.csv") == without_seconds(whole / "sweeps.csv")
    return all((folder / name).read_bytes() == (whole / name).read_bytes() for name in names)


def test_a_killed_run_resumes_to_the_bit(annealed, tmp_path):
    folder = tmp_path / "killed"
    with start(*LONG, "--out", folder) as run:
        ends = time.monotonic() + 300
        while count_rows(folder / "sweeps.csv") < 5:
            assert run.poll() is None and time.monotonic() < ends, "it ended before it could be killed"
            time.sleep(0.002)
        run.kill()
        assert run.wait() == -signal.SIGKILL
    with (folder / "sweeps.csv").open("a") as file:
        file.write("9999,torn")
    assert main(["anneal", "--out", str(folder), "--resume"]) == 0
    assert same_run(folder, annealed)


def test_a_signal_ends_the_span_saves_and_leaves(annealed, tmp_path, monkeypatch, capsys):
    number, folder, advance = signal.SIGINT, tmp_path / "stopped", Annealer.advance  # SIGTERM: `test_runs`

    def interrupted(annealer, state):
        if state.sweep == 10:  # and so in the span up to the 15th
            signal.raise_signal(number)
        return advance(annealer, state)

    with monkeypatch.context() as patch:
        patch.setattr(Annealer, "advance", interrupted)
        assert main([*LONG, "--out", str(folder)]) == 128 + number
    error = capsys.readouterr().err
    assert f"stopped by {number.name} after sweep 15 of 30" in error and "--resume" in error
    assert storage.load_checkpoint(folder / "checkpoint.npz").state.sweep == 15 == count_rows(folder / "sweeps.csv") - 1
    assert not list(folder.glob(".*")) and not (folder / "backbones.csv").exists()
    assert main(["anneal", "--out", str(folder), "--resume"]) == 0
    assert same_run(folder, annealed)
    assert len(json.loads((folder / "manifest.json").read_text())["resumed"]) == 1


def test_sweeps_may_grow(tmp_path):
    folder = tmp_path / "run"
    assert main([*SMALL, "--final-temperature", "0.5", "--sweeps", "4", "--no-contacts", "--out", str(folder)]) == 0
    before = without_seconds(folder / "sweeps.csv")
    assert main(["anneal", "--sweeps", "7", "--out", str(folder), "--resume"]) == 0
    after = without_seconds(folder / "sweeps.csv")
    assert len(after) == 8 and after[:5] == before
    assert column(after, "temperature")[4:] == pytest.approx(0.5)


def test_a_users_backbones_are_annealed_under_their_names(annealed, tmp_path):
    path, folder = tmp_path / "mine.csv", tmp_path / "run"
    table = read_table(annealed / "backbones.csv")
    axial, angle = column(table, "axial"), column(table, "angle") - 4
    names = [f"cell {k}" for k in range(16, 0, -1)]
    storage.write_backbones(path, np.stack([axial, angle], axis=-1), names)
    run = ["anneal", *SIZES, "--backbones", str(path), "--out", str(folder)]
    assert main([*run, "--sweeps", "2"]) == 0
    cells, initial = read_table(folder / "cells.csv"), read_table(folder / "initial_backbones.csv")
    assert [row["cell"] for row in cells] == [str(k) for k in range(16)] and [row["name"] for row in cells] == names
    assert ",".join(cells[0]) == f"{SIZE_COLUMNS},{CONTACT_COLUMNS},name"
    assert [row["cell"] for row in read_table(folder / "backbones.csv")] == names
    assert column(initial, "axial").tolist() == axial.tolist()
    np.testing.assert_allclose(column(initial, "angle"), angle % (2 * np.pi), atol=1e-12)
    assert main([*run, "--resume"]) == 0  # the same file is no change
    storage.write_backbones(path, np.stack([axial, angle + 0.1], axis=-1), names)
    assert main([*run, "--resume"]) == 2


def write_reference(reference, path):
    storage.write_backbones(path, reference.positions)
    sizes = {"L": "--length", "Ra": "--apical-radius", "Rb": "--basal-radius"}
    return [
        str(path),
        *(text for name, option in sizes.items() for text in (option, repr(float(reference.data[name])))),
    ]


def test_measure_meets_the_reference(load_reference, tmp_path, capsys):
    reference = load_reference("ratio10_n100")
    data = reference.data
    assert main(["measure", *write_reference(reference, tmp_path / "b.csv"), "--out", str(tmp_path / "m")]) == 0
    rows, summary = (
        read_table(tmp_path / "m" / "cells.csv"),
        json.loads((tmp_path / "m" / "summary.json").read_text()),
    )
    assert ",".join(rows[0]) == f"{SIZE_COLUMNS},{CONTACT_COLUMNS}"
    # What the reference itself is right to, rms / mean.
    bars = {"volume": ("V", 1e-5), "lateral_area": ("lateral", 2e-4), "apical_area": ("apical_area", 3e-4)}
    bars |= {"basal_area": ("basal_area", 3e-4), "apical_perimeter": ("apical_perim", 1e-4)}
    bars |= {"basal_perimeter": ("basal_perim", 1e-4)}
    for name, (key, bar) in bars.items():
        error = column(rows, name) - data[key]
        assert np.sqrt((error**2).mean()) <= bar * data[key].mean(), name
    np.testing.assert_array_equal(column(rows, "axial"), reference.positions[:, 0])
    assert list(summary) == [
        *(*SIZES_SUMMED, "cells", "mean_neighbors", *MEANS, "inner", "open_ends", "contact_seconds")
    ]
    assert summary["mean_neighbors"] == summary["neighbors"]
    assert list(summary["inner"]) == ["cells", *MEANS]
    for name, key in COUNTED.items():
        np.testing.assert_array_equal(column(rows, name), data[key], err_msg=name)
        assert summary[name] == pytest.approx(data[key].mean(), rel=1e-12)
    inner = np.array([row["is_end"] == "False" for row in rows])
    assert summary["inner"]["cells"] == inner.sum()
    assert summary["inner"]["neighbors"] == pytest.approx(data["deg_any"][inner].mean(), rel=1e-12)
    table = read_table(tmp_path / "m" / "transitions.csv")
    points = np.stack([column(table, name) for name in "xyz"], axis=1)
    fours = np.stack([column(table, f"cell_{letter}") for letter in "abcd"], axis=1)
    expected = np.concatenate([np.sort(data["tv_cells"], axis=1), data["tv_xyz"]], axis=1)
    # in 64 bits though the sizes are not
    np.testing.assert_allclose(
        sorted(np.concatenate([fours, points], axis=1).tolist()), sorted(expected.tolist()), atol=1e-9
    )
    assert summary["total_lateral_area"] == pytest.approx(data["lateral"].sum(), rel=1e-4)
    assert summary["energy"] == pytest.approx(data["E"], rel=1e-4)
    assert summary["separation"] == pytest.approx(data["min_dist"], rel=1e-4)  # 32 bits
    assert summary["covering_radius"] == pytest.approx(data["phi"], rel=0.01)
    assert set(capsys.readouterr().out.split()) >= set(summary)


def test_the_contacts_of_a_run_are_those_of_its_backbones(annealed, tmp_path):
    folder = tmp_path / "m"
    run = ["measure", str(annealed / "backbones.csv"), *SIZES, "--resolution", "draft", "--out", str(folder)]
    assert main([*run, "--graph"]) == 0
    for name in ("contacts.csv", "transitions.csv"):
        assert (folder / name).read_bytes() == (annealed / name).read_bytes()
    final = json.loads((annealed / "manifest.json").read_text())["final"]
    summary = json.loads((folder / "summary.json").read_text())
    assert all(final[name] == summary[name] for name in (*MEANS, "inner", "open_ends"))
    cells, contacts = read_table(folder / "cells.csv"), read_table(folder / "contacts.csv")
    assert ",".join(contacts[0]) == "cell_a,cell_b,area,apical_length,basal_length,kind,pieces"
    pairs = np.stack([column(contacts, "cell_a"), column(contacts, "cell_b")], axis=1).astype(int)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    kinds = np.array([row["kind"] for row in contacts])
    for kind in ("apical_basal", "apical", "basal", "internal"):
        count = np.bincount(pairs[kinds == kind].ravel(), minlength=16)
        assert column(cells, f"{kind}_neighbors").tolist() == count.tolist()
    # a wall touches a surface just if its edge there has a length
    assert ((column(contacts, "apical_length") > 0) == np.isin(kinds, ("apical", "apical_basal"))).all()
    walls = np.bincount(pairs.ravel(), np.repeat(column(contacts, "area"), 2))
    np.testing.assert_allclose(walls, column(cells, "lateral_area"), rtol=0.15)  # of the draft preset
    graph = nx.read_graphml(folder / "graph.graphml", node_type=int)
    assert [graph.degree[k] for k in range(16)] == column(cells, "neighbors").tolist()
    assert [graph.nodes[k]["volume"] for k in range(16)] == column(cells, "volume").tolist()
    transitions = read_table(folder / "transitions.csv")
    assert ",".join(transitions[0]) == "x,y,z,cell_a,cell_b,cell_c,cell_d"
    four = np.stack([column(transitions, f"cell_{letter}") for letter in "abcd"], axis=1).astype(int)
    assert column(cells, "transitions").tolist() == np.bincount(four.ravel(), minlength=16).tolist()
    assert [row["is_scutoid"] == "True" for row in cells] == (column(cells, "transitions") > 0).tolist()


def test_control_characters_in_names_leave_tables_and_graphs_that_readers_take(tmp_path):
    path, folder = tmp_path / "mine.csv", tmp_path / "m"
    path.write_text("axial,angle,cell\n1,0.5,a\x0bb\n5,1.5,c\x1b[31m\n9,2.5,=d\n")
    assert main(["measure", str(path), *SIZES, "--graph", "--out", str(folder)]) == 0
    graph = nx.read_graphml(folder / "graph.graphml", node_type=int)
    assert [graph.nodes[k]["name"] for k in range(3)] == [r"a\u000bb", r"c\u001b[31m", "=d"]
    assert [row["name"] for row in read_table(folder / "cells.csv")] == [r"a\u000bb", r"c\u001b[31m", "'=d"]
    assert read_backbones(folder / "cells.csv", Tube(12, 2, 4)).names == ("a\x0bb", "c\x1b[31m", "=d")


def test_small_contacts_are_left_out_and_old_tables_removed(annealed, tmp_path):
    folder, walls = tmp_path / "m", column(read_table(annealed / "contacts.csv"), "area")
    run = ["measure", str(annealed / "backbones.csv"), *SIZES, "--resolution", "draft", "--out", str(folder)]
    assert main([*run, "--minimum-contact", "0.5", "--graph"]) == 0
    kept = column(read_table(folder / "contacts.csv"), "area")
    assert kept.tolist() == walls[walls >= 0.5 * walls.mean()].tolist() and 0 < len(kept) < len(walls)
    assert column(read_table(folder / "cells.csv"), "neighbors").sum() == 2 * len(kept)
    assert (folder / "transitions.csv").read_bytes() == (annealed / "transitions.csv").read_bytes()
    assert main([*run, "--no-contacts", "--force"]) == 0
    assert {path.name for path in folder.iterdir()} == {
        *("backbones.csv", "domain.json", "cells.csv", "summary.json", "surfaces.png", "index.html")
    }
    assert ",".join(read_table(folder / "cells.csv")[0]) == SIZE_COLUMNS
    assert list(json.loads((folder / "summary.json").read_text())) == SIZES_SUMMED


def test_lost_edges_are_told(annealed, tmp_path, monkeypatch):
    def careless(bisectors):
        graph, tied, lost = trace(bisectors)
        return graph._replace(open_ends=3), tied, lost

    trace = edges._trace
    run = ["measure", str(annealed / "backbones.csv"), *SIZES, "--resolution", "draft", "--out"]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".* edges of the diagram")
        assert main([*run, str(tmp_path / "whole")]) == 0
    monkeypatch.setattr(edges, "_trace", careless)
    monkeypatch.setattr(edges, "TRIES", 1)
    with pytest.warns(UserWarning, match="^3 edges of the diagram"):
        assert main([*run, str(tmp_path / "lost")]) == 0
    assert json.loads((tmp_path / "lost" / "summary.json").read_text())["open_ends"] == 3


def test_a_run_can_go_without_contacts(tmp_path, capsys):
    folder = tmp_path / "run"
    assert main([*SMALL, "--sweeps", "0", "--no-contacts", "--out", str(folder)]) == 0
    assert not (folder / "contacts.csv").exists() and not (folder / "transitions.csv").exists()
    assert "neighbors" not in json.loads((folder / "manifest.json").read_text())["final"]
    assert "neighbors" not in capsys.readouterr().out


def test_cells_at_the_ends_are_marked(annealed):
    cells = read_table(annealed / "cells.csv")
    marked = {k for k, row in enumerate(cells) if row["is_end"] == "True"}
    x, t = column(cells, "axial"), column(cells, "angle")
    radius, angle = (grid[..., None] for grid in np.meshgrid(np.linspace(2, 4, 25), np.linspace(0, 2 * np.pi, 181)))
    foot = np.clip(radius * np.cos(angle - t), 2, 4)
    across = radius**2 + foot**2 - 2 * radius * foot * np.cos(angle - t)
    owners = {int(k) for end in (0, 12) for k in np.unique(((x - end) ** 2 + across).argmin(axis=-1))}
    # A cell that only grazes an end is seen by one of the two, or by neither.
    assert len(marked ^ owners) <= 1 and 2 < len(owners) < 14


def test_a_single_cell_has_no_separation_and_no_walls(tmp_path):
    (tmp_path / "b.csv").write_text("axial,angle\n5,1\n")
    run = ["measure", str(tmp_path / "b.csv"), *SIZES, "--resolution", "draft"]
    assert main([*run, "--x64", "--out", str(tmp_path / "m")]) == 0
    summary = json.loads((tmp_path / "m" / "summary.json").read_text())
    assert summary["separation"] is None and summary["total_lateral_area"] == 0
    assert summary["neighbors"] == 0 and summary["inner"]["neighbors"] is None
    assert len(read_table(tmp_path / "m" / "contacts.csv")) == 0
    assert summary["total_volume"] == pytest.approx(np.pi * 12 * 12, rel=1e-6)


def test_compare_shows_finer_presets_to_be_better(annealed, tmp_path, capsys, monkeypatch):
    presets = {name: PRESETS[name] for name in ("draft", "fine")}  # those compiled already
    monkeypatch.setattr(reports, "PRESETS", presets)
    run = ["compare", str(annealed / "initial_backbones.csv"), *SIZES, "--samples", "40"]
    assert main([*run, "--out", str(tmp_path / "c")]) == 0
    rows = read_table(tmp_path / "c" / "compare.csv")
    assert [row["preset"] for row in rows] == ["draft", "fine"]
    assert (np.diff(column(rows, "volume_rms")) < 0).all() and (column(rows, "volume_rms") > 0).all()
    assert (column(rows, "volume_max") >= column(rows, "volume_rms")).all()
    assert (column(rows, "seconds") > 0).all()
    summary = json.loads((tmp_path / "c" / "compare.json").read_text())
    assert summary["samples"] == 40 and summary["exact_seconds"] > 0
    area_rms = [row["area_rms"] for row in summary["presets"]]
    assert area_rms == column(rows, "area_rms").tolist()
    assert "volume_rms" in capsys.readouterr().out


def test_info_names_versions_and_devices(capsys):
    assert main(["info", "--x64"]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert lines["jax"] == jax.__version__ and lines["x64"] == "on"
    assert lines["devices"] and lines["extras"]


BAD_ARGUMENTS = [
    ("anneal --out {}/o --temperature -1", "--temperature: -1"),
    ("anneal --out {}/o --temperature nan", "--temperature: nan"),
    ("anneal --out {}/o --modulus -0.5", "--modulus: -0.5"),
    ("anneal --out {}/o --tension inf", "--tension: inf"),
    ("anneal --out {}/o --minimum-contact -1", "--minimum-contact: -1"),
    ("anneal --out {}/o --minimum-contact 0.1 --no-contacts", "--minimum-contact needs contacts"),
    (
        "measure {}/good.csv --length 12 --apical-radius 2 --basal-radius 4 --out {}/o --minimum-contact nan",
        "--minimum-contact: nan",
    ),
    (
        "measure {}/good.csv --length 12 --apical-radius 2 --basal-radius 4 --out {}/o --minimum-contact 1%",
        "'1%'",
    ),
    (
        "measure {}/good.csv --length 12 --apical-radius 2 --basal-radius 4 --out {}/o --graph --no-contacts",
        "--graph needs contacts",
    ),
    ("anneal --out {}/o --sweeps -3", "--sweeps: -3"),
    ("anneal --out {}/o --sweeps 1.5", "--sweeps: invalid integer value: '1.5'"),
    ("anneal --out {}/o --cells 0", "--cells: 0"),
    ("anneal --out {}/o --seed -1", "--seed: -1"),
    ("anneal --out {}/o --length 0", "--length: 0"),
    ("anneal --out {}/o --length nan", "--length: nan"),
    ("anneal --out {}/o --apical-radius 10", "apical_radius=10.0"),
    ("anneal --out {}/o --resolution sharp", "'sharp'"),
    ("anneal --out {}/o --algorithm gibbs", "'gibbs'"),
    ("anneal --out {}/o --final-temperature 0", "--final-temperature: 0"),
    ("anneal --out {}/o --temperature 0 --final-temperature 1", "--temperature above 0"),
    ("anneal --out {}/o --backbones {}/good.csv --cells 3", "--cells"),
    ("anneal --out {}/o --backbones {}/absent.csv", "absent.csv can't be read"),
    ("anneal --out {}/o --backbones {}/twins.csv", "lines 2 and 3"),
    ("anneal --out {}/o --resume", "no checkpoint"),
    ("anneal --out {}", "is not empty"),
    ("anneal --out {}/good.csv --force", "good.csv is a file"),
    ("anneal --out {}/good.csv/o", "is not writable"),
    ("anneal", "--out"),
    ("anneal --out {}/o --speed 3", "--speed"),
    ("melt", "'melt'"),
    ("measure {}/good.csv --length 12 --apical-radius 2 --out {}/o", "--basal-radius"),
    ("measure {}/good.csv --length 12 --apical-radius 5 --basal-radius 4 --out {}/o", "apical_radius=5.0"),
    ("measure {}/good.csv --length 3 --apical-radius 2 --basal-radius 4 --out {}/o", "axial=5.0"),
    ("measure {}/latin.csv --length 12 --apical-radius 2 --basal-radius 4 --out {}/o", "not UTF-8"),
    ("measure {} --length 12 --apical-radius 2 --basal-radius 4 --out {}/o", "can't be read"),
    ("measure {}/good.csv --length 12 --apical-radius 2 --basal-radius 4 --out {}", "is not empty"),
    ("compare {}/good.csv --length 12 --apical-radius 2 --basal-radius 4 --samples 1", "--samples: 1"),
]


@pytest.mark.parametrize(("line", "named"), BAD_ARGUMENTS, ids=[line for line, _ in BAD_ARGUMENTS])
def test_bad_input_gets_one_line_and_nothing_is_written(line, named, tmp_path, capsys):
    (tmp_path / "good.csv").write_text(GOOD)
    (tmp_path / "twins.csv").write_text("axial,angle\n1,2\n1,2\n")
    (tmp_path / "latin.csv").write_bytes("axial,angle,cell\n1,2,é\n".encode("latin-1"))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(line.replace("{}", str(tmp_path)).split()) == 2
    streams = capsys.readouterr()
    assert named in streams.err and streams.err.count("\n") == 1 and streams.out == ""
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_force_removes_only_what_a_run_writes(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "checkpoint.npz").write_text("old")
    assert main([*SMALL, "--sweeps", "1", "--out", str(folder)]) == 2
    assert (folder / "checkpoint.npz").read_text() == "old"
    assert main([*SMALL, "--sweeps", "1", "--out", str(folder), "--force"]) == 0
    assert (folder / "notes.txt").read_text() == "mine"
    assert storage.load_checkpoint(folder / "checkpoint.npz").state.sweep == 1
    assert count_rows(folder / "sweeps.csv") == 2


def test_force_leaves_nothing_of_another_tissue(annealed, tmp_path):
    """What `export` and `view` read, and what they drew, is of the tissue that was measured last."""
    folder = Path(shutil.copytree(annealed, tmp_path / "run"))
    (tmp_path / "other.csv").write_text(GOOD)
    (folder / "scutoid.png").touch()
    sizes = ["--length", "10", "--apical-radius", "3", "--basal-radius", "5", "--no-contacts"]
    assert main(["measure", str(tmp_path / "other.csv"), *sizes, "--out", str(folder), "--force"]) == 0
    left = read_tissue(folder)
    assert left.domain == Tube(10, 3, 5) and len(left.positions) == 3 and not left.history
    old = {"manifest.json", "checkpoint.npz", "sweeps.csv", "contacts.csv", "energy.png", "scutoid.png"}
    assert not old & {path.name for path in folder.iterdir()}
    with alone(folder):
        arguments = ["measure", str(tmp_path / "other.csv"), *sizes, "--out", str(folder), "--force"]
        assert main(arguments) == 2 and len(read_tissue(folder).positions) == 3


@pytest.mark.parametrize("told", [True, False])
def test_what_is_compiled_is_kept_for_the_next_command(told: bool, tmp_path):
    """In the user's cache folder, unless JAX is told where."""
    many = "".join(f"{0.1 * k},{2.4 * k}\n" for k in range(70))  # fewer are measured without a program
    (tmp_path / "cells.csv").write_text("axial,angle\n" + many)
    more = ["--resolution", "1x1", "--no-contacts", "--out", "measured"]
    command = quick.command("measure", "cells.csv", *SIZES, *more)
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "user"), "HOME": str(tmp_path / "user")}
    environment["JAX_COMPILATION_CACHE_DIR"] = str(tmp_path / "told") if told else ""
    run = subprocess.run(command, cwd=tmp_path, env=environment, check=True)
    assert run.returncode == 0
    kept = {path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("jit_share-*")}
    assert kept == {"told" if told else "user"}


def test_measure_warns_of_places_too_coarse_for_32_bits(tmp_path, recwarn):
    """At 1e6 along the axis float32 is 0.06 apart, where 20 backbones stand 0.9 apart at R_a = 2e-6."""
    table = tmp_path / "far.csv"
    table.write_text("axial,angle\n" + "".join(f"{5e4 * k + 1},{0.3 * k}\n" for k in range(20)))
    size = ["--length", "1e6", "--apical-radius", "2e-6", "--basal-radius", "10", "--no-contacts"]
    for more, warned in ([], True), (["--x64"], False):
        out = tmp_path / f"out{warned}"
        assert main(["measure", str(table), "--out", str(out), *size, *more]) == 0
        told = [str(warning.message) for warning in recwarn.list]
        assert any("axial positions in float32 have steps of 0.062" in text for text in told) == warned
        recwarn.clear()
