"""The paper's evaluation from one command: what is there is not made again, what is wrong is said."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from quick import meet

from jaxtissue.cli.commands import main
from jaxtissue.diagram.labels import label_volumes, nearest_backbones
from jaxtissue.diagram.voxels import cylindrical_voxels
from jaxtissue.geometry.tube import Tube
from jaxtissue.reproduction import experiments, ratios, reproduce, timings, tissues
from jaxtissue.reproduction.experiments import QUICK, Plan, Store, measure_runs, measure_volumes
from jaxtissue.reproduction.items import ITEMS, Product
from jaxtissue.reproduction.ratios import measure_ratios
from jaxtissue.reproduction.timings import play_whole
from jaxtissue.reproduction.tissues import Annealing, History, anneal_history, random_tissue, relax_lloyd
from jaxtissue.reproduction.workers import Workers
from jaxtissue.system.files import write_sealed
from jaxtissue.system.locks import alone

TINY = replace(QUICK, cells=12, length=6.0, sweeps=2, kept=(1, 2))


def made_up(annealing, seed):
    """A history without annealing."""
    sweeps = annealing.sweeps + 1
    records = {name: np.arange(sweeps, dtype=float) for name in ("sweep", "energy", "rounds", "seconds")}
    place = np.asarray(random_tissue(annealing.tube, annealing.cells, seed))
    return History(records, np.tile(place, (sweeps, 1, 1)))


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "data", lambda _: None)


def test_an_unknown_item_is_named_with_those_that_exist(tmp_path, capsys):
    assert main(["reproduce", "fig5", "fig6", "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "'fig6'" in error and all(item in error for item in ITEMS)
    assert not (tmp_path / "out").exists()


def test_items_come_in_the_papers_order():
    assert reproduce.choose_items([]) == reproduce.choose_items(["all"]) == list(ITEMS)
    assert reproduce.choose_items(["fig16", "table1"]) == ["table1", "fig16"]
    assert reproduce.make_plan(True, None) == QUICK and reproduce.make_plan(False, 3) == Plan(seeds=3)


def test_a_quick_item_from_the_command_line(tmp_path, capsys):
    folder = tmp_path / "out"
    arguments = ["reproduce", "fig7", "--quick", "--out", str(folder)]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert "report.md" in said.out and "fig7 done" in said.err
    names = {path.name for path in folder.iterdir()}
    assert names == {"fig7.csv", "fig7.png", "manifest.json", "report.md", "report.csv"}
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["plan"]["quick"] is True and manifest["items"]["fig7"]["versions"]["jax"]
    assert len(reproduce.read_table(folder / "fig7.csv")["axial"]) == QUICK.cells
    before = (folder / "fig7.png").stat().st_mtime_ns
    assert main(arguments) == 0 and (folder / "fig7.png").stat().st_mtime_ns == before
    assert "already computed" in capsys.readouterr().err
    assert main([*arguments, "--seeds", "3"]) == 2 and "seeds = 2, not 3" in capsys.readouterr().err
    (folder / "fig7.csv").unlink()
    assert main(arguments) == 0 and (folder / "fig7.csv").exists()
    assert main([*arguments, "--force"]) == 0 and "fig7 done" in capsys.readouterr().err


def test_a_folder_with_other_files_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("mine")
    assert main(["reproduce", "fig7", "--quick", "--out", str(tmp_path)]) == 2
    assert "other files" in capsys.readouterr().err and len(list(tmp_path.iterdir())) == 1
    with alone(tmp_path):
        assert main(["reproduce", "fig7", "--quick", "--out", str(tmp_path), "--force"]) == 2
    assert "a reproduction is still in progress" in capsys.readouterr().err
    (tmp_path / "manifest.json").write_text("[]")
    assert main(["reproduce", "fig7", "--quick", "--out", str(tmp_path)]) == 2
    write_sealed(tmp_path / "manifest.json", {"format": 1})  # as another command's
    assert main(["reproduce", "fig7", "--quick", "--out", str(tmp_path), "--force"]) == 2
    assert "was not written by this command" in capsys.readouterr().err


def test_what_was_finished_before_a_stop_is_kept(tmp_path, monkeypatch):
    calls = []

    def stopped(plan, store):
        """Two."""
        calls.append("stopped")
        raise KeyboardInterrupt

    def made(plan, store):
        """One."""
        calls.append("made")
        return Product({"": {"x": np.zeros(2)}}, Figure())

    monkeypatch.setattr(reproduce, "ITEMS", {"fig7": made, "fig8": stopped})
    for items in (["fig8"], ["fig7", "fig8"], ["fig7", "fig8"]):
        with pytest.raises(KeyboardInterrupt):
            reproduce.reproduce(tmp_path / "out", items, QUICK)
        (tmp_path / "out/data").mkdir(exist_ok=True)  # as an item that is stopped leaves it
    assert calls == ["stopped", "made", "stopped", "stopped"] and "Fig. 7" in (tmp_path / "out/report.md").read_text()


def test_rows_are_computed_once_unless_all_is_to_be_fresh(store):
    count = iter(range(9))
    compute = lambda: {"value": next(count), "nothing": float("nan")}  # noqa: E731
    assert store.row("one", compute) == store.row("one", compute) == {"value": 0, "nothing": None}
    fresh = Store(store.folder, store.say, fresh=True)
    assert fresh.row("one", compute)["value"] == fresh.row("one", compute)["value"] == 1
    assert np.isnan(experiments.tabulate([store.row("one", compute)])["nothing"][0])


def test_only_missing_seeds_are_annealed(store, monkeypatch):
    asked = []
    monkeypatch.setattr(experiments, "anneal_history", lambda a, seed: asked.append(seed) or made_up(a, seed))
    annealing = TINY.annealing(5.0)
    first = store.histories(annealing, [0, 2])
    both = store.histories(annealing, range(3))
    assert asked == [0, 2, 1] and np.array_equal(first[1].positions, both[2].positions)
    path = next(store.folder.glob("*.npz"))
    path.write_bytes(b"not one")
    with pytest.raises(ValueError, match="damaged"):
        store.histories(annealing, range(3))


def test_what_another_version_kept_is_computed_anew(store, monkeypatch, tmp_path, capsys):
    asked = []
    monkeypatch.setattr(experiments, "anneal_history", lambda a, seed: asked.append(seed) or made_up(a, seed))
    annealing = TINY.annealing(5.0)
    store.histories(annealing, [0])
    store.row("one", lambda: {"value": 1})
    monkeypatch.setattr(experiments, "FORMAT", experiments.FORMAT + 1)
    store.histories(annealing, [0, 1])
    store.histories(annealing, [0])
    assert asked == [0, 0, 1] and store.row("one", lambda: {"value": 2})["value"] == 2
    for text in ("{", '{"format": 9, "row": {"value": 3}}'):
        (store.folder / "one.json").write_text(text)
        with pytest.raises(ValueError, match="damaged"):
            store.row("one", lambda: {"value": 5})
    made = []
    monkeypatch.setattr(
        reproduce, "ITEMS", {"fig7": lambda *_: made.append(1) or Product({"": {"x": np.zeros(2)}}, Figure())}
    )
    monkeypatch.setattr(reproduce.ITEMS["fig7"], "__doc__", "One.")
    for version in (1, 1, 2):
        monkeypatch.setattr(reproduce, "FORMAT", version)
        reproduce.reproduce(tmp_path / "out", ["fig7"], QUICK)
    assert len(made) == 2 and "another version" in capsys.readouterr().err


def test_a_folder_of_before_there_were_checksums_is_made_anew(tmp_path, monkeypatch, capsys):
    folder, made = tmp_path / "out", []

    def one(plan, store):
        """One."""
        made.append(store.row("one", lambda: {"value": 4})["value"])
        return Product({"": {"x": np.zeros(2)}}, Figure())

    monkeypatch.setattr(reproduce, "ITEMS", {"fig7": one})
    (folder / "data").mkdir(parents=True)
    (folder / "data/one.json").write_text('{"format": 9, "row": {"value": 3}}')
    (folder / "manifest.json").write_text('{"format": 9, "plan": {}, "items": {"fig7": {"files": []}}}')
    reproduce.reproduce(folder, ["fig7"], QUICK)
    assert made == [4] and "another version" in capsys.readouterr().err


def test_a_damaged_file_is_told_in_one_line_with_the_cure(tmp_path, monkeypatch, capsys):
    folder, made = tmp_path / "out", []

    def one(plan, store):
        """One."""
        made.append(store.row("one", lambda: {"value": 1})["value"])
        run = store.histories(TINY.annealing(5.0), [0])[0]
        return Product({"": {"x": run.positions.ravel()}}, Figure())

    monkeypatch.setattr(experiments, "anneal_history", made_up)
    monkeypatch.setattr(reproduce, "ITEMS", {"fig7": one})
    command = ["reproduce", "fig7", "--quick", "--out", str(folder)]
    assert main(command) == 0
    shown = [folder / name for name in ("fig7.csv", "fig7.png", "manifest.json")]
    rng = np.random.default_rng(0)
    for path in (*shown, *(folder / "data").iterdir()):
        kept = path.read_bytes()
        if path not in shown:  # they are read where the item is made again
            (folder / "fig7.csv").rename(tmp_path / "fig7.csv")
        for byte, bit in zip(rng.integers(len(kept), size=9), rng.integers(8, size=9), strict=True):
            damaged = bytearray(kept)
            damaged[byte] ^= 1 << bit
            path.write_bytes(damaged)
            capsys.readouterr()
            assert main(command) == 2
            *_, error = capsys.readouterr().err.splitlines()
            cure = "add --force" if path.name == "manifest.json" else "remove it"
            assert f"{path.name} is damaged" in error and cure in error
        path.unlink() if path.name != "manifest.json" else path.write_bytes(kept)
        assert main(command) == 0  # what is removed is made again
    (folder / "manifest.json").write_text("{")
    assert main([*command, "--force"]) == 0 and set(made) == {1}


def test_a_link_in_place_of_the_data_is_not_followed(tmp_path, capsys):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/data").symlink_to(tmp_path / "elsewhere")
    assert main(["reproduce", "fig5", "--quick", "--force", "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "data is a symbolic link" in error and error.count("\n") == 1
    assert not list((tmp_path / "elsewhere").iterdir())


def test_names_of_histories_tell_apart_all_that_differs():
    tube = Tube(6, 2, 10)
    kinds = [
        Annealing(tube, 12, 2),
        Annealing(tube, 13, 2),
        Annealing(tube, 12, 3),
        Annealing(Tube(6, 1, 10), 12, 2),
    ]
    kinds += [Annealing(tube, 12, 2, "mh"), Annealing(tube, 12, 2, "is-mh", "2-hop")]
    assert len({kind.name for kind in kinds}) == len(kinds)


def test_tables_of_runs_and_volumes(store, monkeypatch):
    monkeypatch.setattr(experiments, "anneal_history", made_up)
    monkeypatch.setattr(experiments, "covering_radius", lambda place, tube: 6.0)
    monkeypatch.setattr(experiments, "separation", lambda place, tube: 0.5)
    runs = measure_runs(TINY, store)
    assert len(runs["sweep"]) == 2 * 2 * 2 * 3 and list(runs["rounds_so_far"][:3]) == [0, 1, 3]
    own = runs["algorithm"] == "is-mh"
    assert (runs["tightness"][own] == 12).all() and np.isnan(runs["tightness"][~own]).all()
    volumes = measure_volumes(TINY, store)
    first = volumes["volume"][:12]
    assert (np.diff(first) >= 0).all() and first.sum() == pytest.approx(float(TINY.tube(10).volume), rel=2e-3)


def test_mh_with_whole_diagrams_is_mh_and_rules_are_timed(monkeypatch):
    """The energy of all cells and the local difference decide alike, move for move."""
    monkeypatch.setattr(timings, "RULES", {"near": "near", "8_phi": "8-phi"})  # one program for both
    monkeypatch.setattr(timings, "WARM_UP", 2)  # when lists are renewed after each sweep
    annealing = Annealing(Tube(15, 2, 10), 60, timings.WARM_UP)
    contest = timings.Contest(annealing, np.asarray(random_tissue(annealing.tube, 60, 3)), 1)
    annealer, state = contest.annealers["mh"], contest.states["mh"]
    whole, taken = play_whole(annealer, state, contest.measurer, 60)
    _, rows, trail = annealer.advance(state)
    assert len(taken) == 60 and 0.2 < rows[0].acceptance < 0.8
    assert np.abs(whole - trail[0]).max() < 1e-6
    row = contest.play()
    assert all(row[f"{name}_seconds"] > 0 for name in ("mh", "whole", *timings.RULES))
    assert row["8_phi_rounds"] > row["near_rounds"] >= 30 and row["near_put_off"] < 0.02


def test_table_1_is_timed_in_turns_that_are_kept(store, monkeypatch):
    plan, played = replace(TINY, table_cells=(12,), turns=2), []

    class Made:
        def __init__(self, annealing, positions, turns):
            self.radius = annealing.tube.apical_radius

        def play(self):
            played.append(float(self.radius))
            return {"apical_radius": float(self.radius), "cells": 12, "near_seconds": float(len(played))}

    monkeypatch.setattr(experiments, "anneal_history", made_up)
    monkeypatch.setattr(timings, "Contest", Made)
    monkeypatch.setattr(timings, "_sets", lambda *_: {"near_sets": 4})
    table, turns = timings.measure_table(plan, store)
    assert played == [1.0, 5.0, 1.0, 5.0, 1.0, 5.0]  # the first pair compiles, and is not kept
    assert list(turns["near_seconds"]) == [3, 4, 5, 6] and list(turns["turn"]) == [1, 1, 2, 2]
    assert list(table["near_seconds"]) == [4, 5] and list(table["near_sets"]) == [4, 4]
    again, _ = timings.measure_table(plan, store)
    assert len(played) == 6 and list(again["near_seconds"]) == [4, 5]
    (store.folder / "table1_turn2.json").unlink()  # as where it was stopped before
    _, turns = timings.measure_table(plan, store)
    assert len(played) == 10 and list(turns["near_seconds"]) == [3, 4, 9, 10]


def test_histories_start_from_the_random_tissue_of_their_seed():
    annealing = Annealing(Tube(15, 1, 10), 60, 1)  # of the shapes of other tests, compiled once
    history = anneal_history(annealing, 5)
    assert history.positions.shape == (2, 60, 2) and list(history.records["sweep"]) == [0, 1]
    start = np.asarray(random_tissue(annealing.tube, 60, 5))
    assert np.array_equal(history.positions[0], start) and not np.array_equal(history.positions[1], start)


def test_lloyd_makes_volumes_alike_however_the_tube_is_turned():
    tube, turn = Tube(12, 3, 8), np.array([0.0, 2.0])
    points, weights = cylindrical_voxels(tube, (48, 4, 100))

    def spread(positions):
        labels, _ = nearest_backbones(points, tube.embed(jnp.asarray(positions)))
        return np.asarray(label_volumes(labels[:, 0], weights, 40)).std()

    start = np.asarray(random_tissue(tube, 40, 1))
    relaxed = [relax_lloyd(start, tube, iterations) for iterations in (0, 2, 10)]
    spreads = [spread(place) for place in relaxed]
    assert spreads[2] < 0.6 * spreads[1] < 0.6 * spreads[0]
    turned = relax_lloyd(start + turn, tube, 2) - turn - relaxed[1]
    turned[:, 1] = (turned[:, 1] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(turned).max() < 0.25  # voxels are not turned along; they are 0.26 wide


def test_two_processes_give_what_one_gives_to_the_bit(store, tmp_path, monkeypatch):
    monkeypatch.setattr(ratios, "KINDS", ("random",))  # to anneal, each process would compile for long
    tube, plan = Tube(12, 3, 8), replace(TINY, ratios=(2.0,))
    calls = [(tube, 40, seed) for seed in (0, 1)]
    alone = dict(Workers().run(random_tissue, calls))
    (meeting := tmp_path / "meeting").mkdir()
    with Workers(2) as workers:
        dict(workers.run(meet, [(meeting, name, 2) for name in "ab"]))  # both compile as this process does
        told = dict(workers.run(random_tissue, calls))
        shared = Store(tmp_path / "shared", lambda _: None, workers=workers)
        tables = [measure_ratios(plan, one) for one in (shared, store)]
        with pytest.raises(ValueError, match="radius"):
            dict(workers.run(Tube, [(1.0, 1.0, 2.0), (1.0, 3.0, 2.0)]))
    assert all(np.array_equal(told[seed], alone[seed]) for seed in (0, 1))
    for name, column in tables[0].items():
        assert all(np.array_equal(column, table[name], equal_nan=name != "kind") for table in tables[1:]), name


def test_lloyds_lists_are_as_long_as_they_must_be(monkeypatch):
    tube = Tube(12, 3, 8)
    start = np.asarray(random_tissue(tube, 40, 1))
    relaxed = []
    for listed in (40, 2):
        monkeypatch.setattr(tissues, "LISTED", listed)
        relaxed.append(relax_lloyd(start, tube, 3))
    assert np.array_equal(*relaxed)
