"""Relaxation on domains other than tubes: down to a minimum, however the tissue is turned, across periods."""

import re

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.geometry.domain_files import save_domain
from jaxtissue.minimization import relaxation
from jaxtissue.minimization.domain_energy import DomainEnergy
from jaxtissue.minimization.merging import told_of_merging
from jaxtissue.neighbors import moving_lists
from jaxtissue.neighbors.moving_lists import MovingLists
from jaxtissue.neighbors.section_neighbors import LAYERS

CYST, CELLS = jt.Sphere(2.0, 2.5), 60


def test_a_cyst_relaxes_however_it_is_turned(x64, monkeypatch):
    start = np.asarray(CYST.random_positions(jax.random.key(0), CELLS), float)
    model, heard = jt.tube_model(CYST, CELLS, modulus=100.0), []  # volumes count most
    energy = DomainEnergy(model, start, "draft")  # one for all, as its programs take seconds to compile
    monkeypatch.setattr(relaxation, "DomainEnergy", lambda *_: energy)
    first = jt.relax(start, model, steps=3, callback=lambda record, place: heard.append(place))
    energies = [record.energy for record in first.history]
    assert first.energy < 0.7 * energies[0] and energies == sorted(energies, reverse=True)
    assert first.history[-1].gradient < 0.2 * first.history[0].gradient
    np.testing.assert_allclose(np.linalg.norm(first.positions, axis=1), 1, atol=1e-12)
    quick = jt.relax(start, model, "lloyd", steps=1)
    assert quick.energy < 0.8 * energies[0]
    again = energy.renewed(np.asarray(heard[-1]) * energy.units)  # lists made anew, as one goes on from a file
    assert again.energy == pytest.approx(first.energy, rel=1e-9)
    turned = energy.renewed(start @ Rotation.from_euler("xyz", (1.0, 2.0, 3.0)).as_matrix() * energy.units)
    assert turned.energy == pytest.approx(energies[0], rel=1e-6)
    place, step = start * energy.units, 1e-5
    here, way = energy.renewed(place), np.random.default_rng(0).normal(size=place.shape)
    expected = (energy(place + step * way).energy - energy(place - step * way).energy) / (2 * step)
    # walls' speeds are those of true walls, energies those of two layers
    assert (here.gradient * way).sum() == pytest.approx(expected, abs=0.1 * float(np.linalg.norm(here.gradient)))
    assert np.abs((here.gradient * place).sum(axis=1)).max() < 1e-9 * np.abs(here.gradient).max()  # length is nothing


def test_it_is_said_that_cells_collapse_and_why():
    """In small units the constants of the paper are mostly tension: backbones merged, and nothing could be measured."""
    cyst = jt.Sphere(1.0, 1.5)
    start = cyst.random_positions(jax.random.key(0), CELLS)
    result = jt.relax(start, jt.tube_model(cyst, CELLS))
    assert not result.converged and result.energy < 0.95 * result.history[0].energy
    told = re.match(r"cells \d+ and \d+ collapse, .* tension is ([0-9.]+) .* at most ([0-9.]+)$", result.message)
    assert told is not None
    relative, stiff = map(float, told.groups())
    assert relative == pytest.approx(0.4 / (float(cyst.volume) / CELLS) ** (4 / 3), rel=0.02)
    assert np.isfinite(jt.measure_tissue(result.positions, cyst, "draft", refine=False).volume).all()
    result = jt.relax(start, jt.tube_model(cyst, CELLS, tension=stiff), steps=15)
    assert "collapse" not in result.message
    volume = np.asarray(jt.measure_tissue(result.positions, cyst, "draft", refine=False).volume)
    assert volume.min() > 0.3 * volume.mean()


def test_backbones_that_merge_are_found():
    tube, slab = jt.Tube(10.0, 1.0, 2.0), jt.Slab(10.0, 10.0, 1.0)
    model = jt.tube_model(tube, 3, tension=1.0)
    before = np.array([[1.0, 0.0], [5.0, 1.0], [5.5, 1.0]])
    after = np.array([[1.0, 0.0], [5.2, 1.0], [5.2005, 1.0]])
    assert told_of_merging(before, after, model).startswith("cells 1 and 2 collapse")
    assert told_of_merging(before, after, model).endswith("a smaller tension would hold them apart")
    assert told_of_merging(after, after, model) == told_of_merging(after, before, model) == ""
    assert told_of_merging(before[:1], after[:1], model) == ""
    own = jt.tube_model(slab, 3, cell_energy=jt.lateral_tension)
    bent, merged = (np.stack([place, place + 1.0, place], axis=1) for place in (before, after))
    assert told_of_merging(bent, merged, own).endswith("does not hold them apart")


def test_bent_backbones_relax_down_the_gradient_of_their_nodes(x64):
    slab, n = jt.Slab(4.0, 3.0, 1.0, periodic=(True, False)), 12
    place = np.stack([np.arange(n) % 4 + 0.3 * (np.arange(n) // 4), 0.5 + np.arange(n) // 4], axis=1)
    off = np.random.default_rng(0).uniform(-0.15, 0.15, (2, n, 2))
    height = np.broadcast_to([0, 0.4, 1], (n, 3))[..., None]
    nodes = np.concatenate([np.stack([place, place + off[0], place + off[1]], axis=1), height], axis=2)
    model = jt.tube_model(slab, n, modulus=10.0)
    energy = DomainEnergy(model, nodes, "draft")
    here, found = energy.renewed(energy.placed(nodes)), []
    for seed in range(4):
        way = 1e-5 * np.random.default_rng(seed).normal(size=here.place.shape)
        found.append(
            [2 * (here.gradient * way).sum(), energy(here.place + way).energy - energy(here.place - way).energy]
        )
    one, other = np.array(found).T
    assert one @ other > 0.9999 * np.linalg.norm(one) * np.linalg.norm(other)  # 0.99999 as measured
    result = jt.relax(nodes, model, steps=1)
    assert result.history[0].energy == pytest.approx(here.energy, rel=1e-9) and result.energy < 0.98 * here.energy
    np.testing.assert_array_equal(result.positions[..., 2], nodes[..., 2])
    with pytest.raises(ValueError, match="'lloyd' moves straight backbones only"):
        jt.relax(nodes, model, "lloyd")


def test_lists_go_along_across_periods(monkeypatch):
    """What is on a list stays where it was, in a tissue that has gone on by more than a period."""
    slab, n = jt.Slab(8.0, 6.0, 1.0, periodic=(True, False)), 20
    place = np.asarray(slab.random_positions(jax.random.key(1), n), float)
    lists = np.random.default_rng(0).integers(0, n, (5, n))

    monkeypatch.setattr(moving_lists, "clearances", lambda *_: (np.zeros(lists.shape), 1.0))
    monkeypatch.setattr(moving_lists, "walls_of", lambda _: (np.zeros(0, int),) * 2)
    looked = []

    def find(domain, positions, layers, rule=None, also=lists):
        looked.append((positions, also[:5]))
        return type("Found", (), {"lists": lists, "rule": None})

    monkeypatch.setattr(moving_lists, "find_sections", find)
    moving = MovingLists(slab, place, None, LAYERS)
    for gone in (3.0, -9.0):
        moving.renew(place + np.array([gone, 0.0]))
    copies = slab.base.images()
    ways = []
    for positions, numbers in looked:
        copy, owner = np.divmod(numbers, n)
        way = positions[owner] + copies[copy] * [8, 6] - positions
        ways.append(np.where((numbers >= 0)[..., None], way, np.nan))
    assert (looked[2][0][:, 0] >= 0).all() and (looked[2][0][:, 0] <= 8).all()
    for way in ways[1:]:
        known = ~np.isnan(way[..., 0])
        assert known.mean() > 0.9
        np.testing.assert_allclose(way[known], ways[0][known], atol=1e-5)  # float32


def test_the_command_takes_a_domain(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("jaxtissue.runs.relaxing.run_relaxation", lambda *given: asked.append(given) or 0)
    save_domain(CYST, tmp_path / "domain.json")
    assert main(["relax", "--domain", str(tmp_path / "domain.json"), "--cells", "60", "--out", str(tmp_path)]) == 0
    (_, settings, descent, _) = asked[0]
    assert settings.place == CYST and settings.cells == 60 and descent.method == "lbfgs"
