"""Moves of single nodes of tilted and bent backbones."""

import json

import jax
import numpy as np
import pytest
from scipy.spatial import KDTree

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.domain_runs import domain_run
from jaxtissue.dynamics.independent_sets import independent_rounds
from jaxtissue.energy import in_precision
from jaxtissue.geometry.domain_files import save_domain
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.neighbors.section_lists import crowd_of
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import read_backbones
from jaxtissue.sections.crowd import turning_cells

pytestmark = pytest.mark.usefixtures("coarse_pictures")
CELLS = 40
SLAB, CYST = jt.Slab(4, 3, 1, periodic=(True, True)), jt.Sphere(1, 1.4)


@pytest.fixture(scope="module", autouse=True)
def doubles():
    """All in 64 bits, so that the programs of one test serve the others."""
    with jax.enable_x64(True):
        yield


def start(domain: jt.Slab | jt.Sphere) -> np.ndarray:
    """Tilted backbones, some across a period, and on the sphere bent ones with a node at a height of 0.3."""
    place = np.asarray(domain.random_positions(jax.random.key(3), CELLS), float)
    shift = np.random.default_rng(0).uniform(-0.1, 0.1, (2, *place.shape))
    if domain is SLAB:
        return as_domain_positions(np.stack([place, place + shift[0]], axis=1), domain, bent=True)
    nodes = np.stack([place, place + shift[0], place + shift[1]], axis=1)
    height = np.broadcast_to([0, 0.3, 1], (CELLS, 3))[..., None]
    return as_domain_positions(np.concatenate([nodes, height], axis=2), domain, bent=True)


def energy_of(run, measured) -> float:
    return float(np.sum(run.model.cell_energy(measured.state.cells.sizes, run.model)))


@pytest.mark.filterwarnings("ignore:the backbones of 2 cells nearly cross")  # on the sphere
@pytest.mark.parametrize("domain", [SLAB, CYST], ids=["tilted", "bent"])
def test_local_differences_sum_to_the_change(domain) -> None:
    model = in_precision(jt.tube_model(domain, CELLS, relative=True), np.dtype(float))
    run, positions = domain_run(model, "draft", 5, np.full(20, 2e-3)), start(domain)
    measured = run.survey(positions, Batch())
    rounds = independent_rounds("near", positions, run.model, measured.contacts)
    played = run.play(measured, 3 * [rounds], 0, Batch())
    before, after = energy_of(run, measured), energy_of(run, played.measured)
    assert abs(before + played.trail.info.energy_change.sum() - after) < 1e-9 * abs(before)
    assert played.drift < 1e-12 and after < before
    assert 0.05 < played.trail.info.accepted.mean() / CELLS < 0.95
    # the same moves one by one, in the same order
    alone = np.full((CELLS, rounds.shape[1]), -1, np.int32)
    alone[:, 0] = rounds[rounds >= 0]
    one_by_one = run.play(measured, 3 * [alone], 0, Batch())
    np.testing.assert_array_equal(one_by_one.trail.positions, played.trail.positions)
    # each sweep moves at most one node of a backbone, and over the sweeps all nodes move
    steps = np.diff(np.concatenate([positions[None], played.trail.positions]), axis=0)
    moved = (np.abs(steps) > 1e-9).any(axis=-1)
    assert moved.sum(axis=-1).max() == 1 and moved.reshape(-1, positions.shape[1]).any(axis=0).all()
    if domain is CYST:
        np.testing.assert_array_equal(played.trail.positions[..., -1], positions[None, ..., -1].repeat(3, axis=0))


def test_upright_backbones_by_their_ends_have_the_energy_of_straight_ones() -> None:
    place = start(SLAB)[:, 0]
    run = domain_run(in_precision(jt.tube_model(SLAB, CELLS), np.dtype(float)), "draft", 5, np.ones(1))
    straight, ends = (run.survey(some, Batch()) for some in (place, np.stack([place, place], axis=1)))
    assert energy_of(run, ends) == pytest.approx(energy_of(run, straight), rel=1e-10)
    assert not len(turning_cells(crowd_of(SLAB, ends.positions), *ends.walls()))
    distance, number = map(np.asarray, KDTree(place).query(place, 2))
    pair = number[distance[:, 1].argmin()].tolist()
    crossed = np.stack([place, place], axis=1)
    crossed[pair, 1] = place[pair[::-1]] + 0.01
    with pytest.warns(UserWarning, match=r"backbones of \d+ cells nearly cross"):
        walls = run.survey(crossed, Batch()).walls()
        assert set(pair) <= set(turning_cells(crowd_of(SLAB, crossed), *walls).tolist())


@pytest.mark.filterwarnings("ignore:the volume of .* of 40 cells may be wrong")  # "draft" of tilted cells
def test_a_run_from_a_table_of_nodes_goes_on_as_if_never_stopped(tmp_path) -> None:
    """By the command; its figures and tables are there, and contacts with them."""
    storage.write_backbones(tmp_path / "t.csv", start(SLAB), columns=SLAB.columns)
    save_domain(SLAB, tmp_path / "slab.json")
    folders = [tmp_path / name for name in ("whole", "parts")]
    own = ["--domain", str(tmp_path / "slab.json"), "--backbones", str(tmp_path / "t.csv"), "--x64"]
    own += ["--temperature", "1e-3"]
    assert main(["anneal", *own, "--sweeps", "5", "--out", str(folders[0])]) == 0
    assert main(["anneal", *own, "--sweeps", "3", "--out", str(folders[1])]) == 0
    assert main(["anneal", "--resume", "--sweeps", "5", "--out", str(folders[1])]) == 0
    whole, parts = (read_backbones(folder / "backbones.csv", SLAB, bent=True).positions for folder in folders)
    np.testing.assert_array_equal(whole, parts)
    assert whole.shape == (CELLS, 2, 2) and (whole != start(SLAB)).any()
    rows = [(folder / "cells.csv").read_text() for folder in folders]
    assert rows[0] == rows[1] and rows[0].startswith("cell,apical_x,apical_y,basal_x,basal_y,volume")
    assert {path.name for path in folders[0].glob("*.png")} >= {"energy.png", "volumes.png", "surfaces.png"}
    final = json.loads((folders[0] / "manifest.json").read_text())["final"]
    assert final["apical_degree"] == pytest.approx(6) and final["open_ends"] == 0
    assert (folders[0] / "contacts.csv").read_text().count("\n") > 3 * CELLS
    sweeps = storage.read_sweeps(folders[0] / "sweeps.csv")
    assert sweeps["energy"][-1] < sweeps["energy"][0] and sweeps["drift"].max() < 1e-12
    with pytest.raises(ValueError, match=r"only be measured .* on domains other than Tube, annealed"):
        jt.anneal(np.zeros((2, 2, 2)), jt.Tube(10, 1, 2), sweeps=1)
