"""Contacts and transition points on any domain: against tracing in a tube, by identities, and by brute force."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import read_reference
from known import known

import jaxtissue as jt
from jaxtissue.topology import domain_connectivity

BENT = jt.BentTube(8, 1.5, 1.5, 3)


def random_positions(domain, n: int) -> np.ndarray:
    return np.asarray(domain.random_positions(jax.random.key(1), n), float)


@pytest.mark.parametrize("name", ["thin_1.01", "random"])
def test_a_tube_has_what_tracing_finds(name):
    if name == "random":  # a ratio of 2, with walls of all four kinds
        tube = jt.Tube(20, 5, 10)
        positions = np.random.default_rng(3).uniform([0, 0], [20, 2 * math.pi], (80, 2))
    else:
        tube, positions = read_reference(name).tube, read_reference(name).positions
    same = jt.RoundTube(float(tube.length), float(tube.apical_radius), float(tube.basal_radius))
    traced, found = jt.find_connectivity(positions, tube), jt.find_connectivity(positions, same)
    first, second = traced.contacts, found.contacts
    np.testing.assert_array_equal(second.pairs, first.pairs)
    np.testing.assert_array_equal(second.kind, first.kind)
    np.testing.assert_array_equal(second.pieces, first.pieces)
    assert name != "random" or len(set(first.kind)) == 4
    # measured 2e-3 on a single wall that bends where feet reach the apical end, else 1e-4
    np.testing.assert_allclose(second.area, first.area, atol=5e-3 * first.area.mean())
    assert first.area_error is None
    assert (np.abs(second.area - first.area) <= second.area_error + 1e-6 * first.area.mean()).mean() > 0.98
    assert known(second.area_error).max() < 0.02 * first.area.mean()
    np.testing.assert_allclose(second.apical_length, first.apical_length, atol=1e-3)
    np.testing.assert_array_equal(found.is_end, traced.is_end)
    orders = [np.lexsort((t.points[:, 0], *t.cells.T)) for t in (traced.transitions, found.transitions)]
    np.testing.assert_array_equal(found.transitions.cells[orders[1]], traced.transitions.cells[orders[0]])
    np.testing.assert_allclose(found.transitions.points[orders[1]], traced.transitions.points[orders[0]], atol=1e-9)
    radius = np.hypot(*found.transitions.points[:, 1:].T)
    ends = float(tube.apical_radius), float(tube.basal_radius)
    np.testing.assert_allclose(known(found.transitions.height), (radius - ends[0]) / (ends[1] - ends[0]), atol=1e-9)
    np.testing.assert_allclose(known(found.stretch_anisotropy), ends[1] / ends[0], rtol=1e-9)


@pytest.mark.filterwarnings("ignore:the areas of .* walls may be wrong")
def test_transition_points_have_four_nearest_backbones():
    positions = random_positions(BENT, 60)
    found = jt.find_connectivity(positions, BENT)
    assert len(found.transitions.points) > 20 and found.transitions.open_ends == 0
    backbones = BENT.embed(positions)
    start = np.asarray(backbones.apical, float)
    along = np.asarray(backbones.basal, float) - start
    way = found.transitions.points[:, None] - start
    share = np.clip((way * along).sum(axis=-1) / (along**2).sum(axis=-1), 0, 1)
    distance = np.linalg.norm(way - share[..., None] * along, axis=-1)
    np.testing.assert_array_equal(np.sort(np.argsort(distance, axis=1)[:, :4], axis=1), found.transitions.cells)
    four = np.sort(distance, axis=1)[:, :4]
    assert np.ptp(four, axis=1).max() < 1e-5  # the ends as embedded are single precision
    stretch = jt.tabulate_connectivity(found)["stretch_anisotropy"]
    across = np.cos(positions[:, 1])  # (R + r_b) / (R + r_a) along the tube, r_b / r_a across
    np.testing.assert_allclose(stretch, 2 * (8 + 1.5 * across) / (8 + 3 * across), rtol=1e-6)


def test_a_closed_surface_keeps_its_mean_degree():
    """Six on each surface of a periodic tube, and more neighbors in all by half of the transitions."""
    tube = jt.RoundTube(10, 2, 4, periodic=True)
    summary = jt.summarize_connectivity(jt.find_connectivity(random_positions(tube, 60), tube))
    assert summary["apical_degree"] == summary["basal_degree"] == 6
    assert summary["identity_residual"] == pytest.approx(0, abs=1e-12) and summary["scutoid_fraction"] > 0.5


@pytest.mark.parametrize(
    ("domain", "n", "degree"),
    [(jt.Sphere(1, 1.5), 50, 6 - 12 / 50), (jt.Slab(6, 5, 2, periodic=(True, True)), 40, 6.0)],
)
def test_spheres_and_slabs_have_no_scutoids(domain, n, degree):
    positions = random_positions(domain, n)
    found = jt.find_connectivity(positions, domain)
    assert not len(found.transitions.points) and not found.is_end.any()
    assert found.contacts.degree().mean() == pytest.approx(degree, abs=1e-12)
    assert set(found.contacts.kind) == {"apical_basal"}
    np.testing.assert_allclose(known(found.stretch_anisotropy), 1, rtol=1e-9)
    if isinstance(domain, jt.Sphere):  # walls between great circles are flat: l (R_b^2 - R_a^2) / 2
        contacts = found.contacts
        np.testing.assert_allclose(contacts.area, contacts.apical_length * (1.5**2 - 1) / 2, rtol=1e-9)


def test_lattices_touch_side_by_side_only():
    """Four cells meet along each line: none of them are neighbors across it."""
    x, y = np.meshgrid(np.arange(5) + 0.5, np.arange(4) + 0.5)
    found = jt.find_connectivity(np.stack([x.ravel(), y.ravel()], axis=1), jt.Slab(5, 4, 1.5))
    assert len(found.contacts.pairs) == 4 * 4 + 5 * 3 and not len(found.transitions.points)
    np.testing.assert_allclose(found.contacts.area, 1.5, rtol=1e-9)
    assert found.is_end.sum() == 14


def test_walls_with_large_errors_are_named(monkeypatch):
    monkeypatch.setattr(domain_connectivity, "DOUBTED", 1e-6)
    with pytest.warns(UserWarning, match=r"areas of \d+ of \d+ walls may be wrong .* between cells \d+-\d+ \("):
        jt.find_connectivity(random_positions(BENT, 60), BENT)


@pytest.mark.parametrize(
    ("domain", "euler"),
    [
        (jt.Ellipsoid([2, 1, 1], [2.5, 1.5, 1.5]), 2),
        (jt.BentTube(4, 2 * math.pi, 1.5, 2.5), 0),
        (jt.Shell(lambda n: n * jnp.array([1.5, 1.0, 1.0]), lambda n: n * 1.9), 2),
    ],
)
@pytest.mark.filterwarnings("ignore:the areas of .* walls may be wrong")
def test_closed_shapes_have_the_degree_of_their_euler_number(domain, euler):
    """6 - 6 euler / n on each surface, and more neighbors in all by half of the transitions."""
    positions = random_positions(domain, 60)
    if euler == 0:  # random cells go round, or nearly so
        row, column = np.divmod(np.arange(90), 6)
        lattice = np.stack([(row + 0.5) / 15 * domain.base.extent[0], (column + row % 2 / 2) * math.pi / 3], axis=1)
        positions = lattice + np.random.default_rng(0).normal(size=(90, 2)) * [0.2, 0.15]
    found = jt.find_connectivity(positions, domain)
    summary = jt.summarize_connectivity(found)
    assert summary["apical_degree"] == pytest.approx(6 - 6 * euler / len(positions), abs=1e-12)
    assert summary["basal_degree"] == pytest.approx(summary["apical_degree"], abs=1e-12)
    assert summary["identity_residual"] == pytest.approx(0, abs=1e-12)
    assert found.transitions.open_ends == 0 and len(found.transitions.points) > 5 and not found.is_end.any()


def test_one_cell_of_a_closed_tissue_has_no_neighbors():
    for position in ([0, 0, 1], [[0, 0, 1], [0, 1, 0]]):
        found = jt.find_connectivity([position], jt.Sphere(1, 1.5))
        assert repr(found) == "Connectivity(1 cells: 0 contacts, 0 transition points, 0 scutoids)"
        assert found.forms.pieces.tolist() == [1] and jt.summarize_connectivity(found)["neighbors"] == 0
    with pytest.raises(ValueError, match="no three of the 2 cells meet"):  # their wall is a ring
        jt.find_connectivity([[0, 0, 1], [0, 0, -1]], jt.Sphere(1, 1.5))


def test_cells_that_go_round_are_refused():
    with pytest.raises(ValueError, match="wraps around"):
        jt.find_connectivity([[2, 0], [8, 0]], jt.RoundTube(10, 1, 2))
