"""Cell meshes: closed, with common walls, filling the tube once; sizes as traced; shapes of known bodies."""

import jax
import numpy as np
import pytest
import trimesh
from known import known

import jaxtissue as jt
from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.cell_meshes import CellMeshes, mesh_cells
from jaxtissue.meshes.shapes import tabulate_shapes
from jaxtissue.topology.traced_sizes import trace_sizes

TUBE = Tube(8, 1, 3)
CELLS = 24
AWKWARD = {
    "one cell": (Tube(4, 1, 2), [[1.0, 0.0]]),
    "two rings": (Tube(10, 0.2, 3), [[2.0, 0.0], [8.0, 1.0]]),
    "a square lattice, where four cells meet in lines": (
        Tube(3, 1, 2),
        np.stack(np.meshgrid(np.arange(3) + 0.5, np.arange(5) * np.pi / 2.5), axis=-1).reshape(-1, 2),
    ),
    "two backbones that nearly coincide": (Tube(4, 1, 2), [[1.0, 0.0], [1.001, 0.0], [3.0, 2.0]]),
    "a detached piece beyond the lumen": (Tube(3, 0.3, 3), [[1.0, 0.0], [1.2, 1.5], [1.5, 1.8]]),
}


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return np.asarray(TUBE.random_positions(jax.random.key(0), CELLS), float)


@pytest.fixture(scope="module")
def meshes(positions) -> CellMeshes:
    return mesh_cells(positions, TUBE)


def solid(meshes: CellMeshes, cell: int) -> trimesh.Trimesh:
    """One cell, as an independent library takes it."""
    points, triangles, _ = meshes.cell(cell)
    return trimesh.Trimesh(points, triangles, process=False)


def windings(points: np.ndarray, meshes: CellMeshes) -> np.ndarray:
    """How often each cell encloses each point: the solid angle of its triangles / 4 pi (van Oosterom, Strackee)."""
    found = np.zeros((meshes.cells, len(points)))
    for at, point in enumerate(points):
        a, b, c = (meshes.points[meshes.triangles] - point).transpose(1, 0, 2)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        above = (a * np.cross(b, c)).sum(axis=1)
        below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        angle = np.arctan2(above, below) / (2 * np.pi)
        first, second = (np.bincount(side, angle, meshes.cells)[: meshes.cells] for side in meshes.sides.T)
        found[:, at] = first - second
    return found


def test_cells_are_closed_and_as_large_as_traced(positions, meshes):
    traced = known(trace_sizes(positions, TUBE))
    for cell in range(CELLS):
        body = solid(meshes, cell)
        assert body.is_watertight and body.is_winding_consistent
        # the bar; found at most 0.4 %
        assert body.volume == pytest.approx(traced.volume[cell], rel=0.01)
    surface = [np.linalg.norm(meshes.normals()[meshes.sides[:, 1] == CELLS + at], axis=1).sum() for at in range(4)]
    end = np.pi * (3**2 - 1)
    # polygons of 64 sides and the area of the circle are longer by (pi / 64)^2 / 6 = 4e-4
    np.testing.assert_allclose(surface, [float(TUBE.apical_area), float(TUBE.basal_area), end, end], rtol=5e-4)


def test_cells_fill_the_tube_once(positions, meshes):
    assert meshes.volumes().sum() == pytest.approx(TUBE.volume, rel=1e-12)
    random = np.random.default_rng(0)
    radius, angle = random.uniform(1.01, 2.98, 60), random.uniform(0, 2 * np.pi, 60)
    points = np.stack([random.uniform(0, 8, 60), radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    found = windings(points, meshes)
    np.testing.assert_allclose(found, found.round(), atol=1e-6)
    np.testing.assert_array_equal(found.round().sum(axis=0), 1)
    # a point within a hundredth of a cell of a wall may be on its other side
    assert (found.argmax(axis=0) == label_points(points, positions, TUBE)).sum() >= 59


@pytest.mark.parametrize("name", AWKWARD)
def test_awkward_tissues_are_meshed(name):
    tube, positions = AWKWARD[name]
    meshes = mesh_cells(positions, tube, 4e-4)
    assert meshes.volumes().sum() == pytest.approx(tube.volume, rel=1e-12)
    for cell in range(meshes.cells):
        body = solid(meshes, cell)
        assert body.is_watertight and body.is_winding_consistent and body.volume > 0
    sizes = trace_sizes(np.asarray(positions, float), tube)
    if sizes is not None:
        np.testing.assert_allclose(meshes.volumes(), sizes.volume, rtol=0.02)  # looser by the tolerance above


def test_meshes_turn_and_mirror_with_the_tissue(positions, meshes):
    """Other grids cut the same cells: as far apart as twice their errors."""
    axial, angle = positions.T
    turned = mesh_cells(np.stack([axial, angle + 1.234], axis=1), TUBE)
    mirrored = mesh_cells(np.stack([8 - axial, -angle], axis=1), TUBE)
    for other in (turned, mirrored):
        np.testing.assert_allclose(other.volumes(), meshes.volumes(), rtol=0.01)


def test_a_tolerance_must_be_one():
    with pytest.raises(ValueError, match="tolerance=0 is not positive; give a fraction"):
        mesh_cells([[1, 0]], TUBE, 0)


def test_shapes_are_those_that_others_measure(positions, meshes):
    cosine, sine = np.cos(positions[:, 1]), np.sin(positions[:, 1])
    shapes = tabulate_shapes(meshes, np.stack([0 * cosine, cosine, sine], axis=1))
    for cell in (0, 7, 20):
        body = solid(meshes, cell)
        ball = 4 * np.pi * (3 * body.volume / (4 * np.pi)) ** (2 / 3)
        assert shapes["surface_area"][cell] == pytest.approx(body.area)
        assert shapes["sphericity"][cell] == pytest.approx(ball / body.area)
        assert shapes["solidity"][cell] == pytest.approx(body.volume / body.convex_hull.volume)
        moments = body.principal_inertia_components  # of the other two axes each
        axes = moments.sum() / 2 - moments
        assert shapes["aspect_ratio"][cell] == pytest.approx(np.sqrt(axes.max() / axes.min()))
    traced = known(trace_sizes(positions, TUBE))
    # where walls meet, triangles stray by some of a tetrahedron: small surfaces are off by 5 %, volumes by less
    np.testing.assert_allclose(shapes["surface_ratio"], traced.basal_area / traced.apical_area, rtol=0.06)
    walls = meshes.sides[:, 1] < CELLS
    lateral = np.bincount(meshes.sides[walls].T.ravel(), np.tile(np.linalg.norm(meshes.normals()[walls], axis=1), 2))
    np.testing.assert_allclose(lateral, traced.lateral_area, rtol=0.05)
    assert (shapes["solidity"] <= 1).all() and (shapes["sphericity"] < 1).all() and (shapes["tilt"] < 60).all()


def test_a_cell_that_fills_the_tube_stands_upright():
    """Half of a tube: 1/4 pi (2^2 - 1) each, symmetric to its backbone."""
    tube = Tube(2, 1, 2)
    half = mesh_cells([[1, 0], [1, np.pi]], tube, 1e-3)
    shapes = tabulate_shapes(half, [[0, 1, 0], [0, -1, 0]])
    # the centers of half circles are at 2 r / pi; polygons of 64 sides are within 1e-3
    np.testing.assert_allclose(shapes["height"], 2 / np.pi, rtol=1e-3)
    np.testing.assert_allclose(shapes["tilt"], 0, atol=1)


DOMAINS = {
    "slab": jt.Slab(4, 3, 1),
    "periodic slab": jt.Slab(4, 3, 1, periodic=(True, True)),
    "sphere": jt.Sphere(2, 3),
}


@pytest.mark.parametrize("name", DOMAINS)
def test_cells_of_every_domain_are_closed_and_as_large_as_the_exact_path_s(name):
    domain, count = DOMAINS[name], 12
    place = np.asarray(domain.random_positions(jax.random.key(2), count), float)
    meshes = mesh_cells(place, domain, 1e-3)
    volume = meshes.volumes()
    # flat faces in place of curved surfaces
    assert volume.sum() == pytest.approx(domain.volume, rel=1e-12 if "slab" in name else 1e-3)
    exact = jt.exact_cells(place, domain, 10).volume
    assert np.abs(volume - exact).max() < 0.03 * exact.mean()  # measured 0.003 to 0.015
    assert meshes.is_closed(np.ones(count, bool))
    for cell in range(count):
        body = solid(meshes, cell)
        assert body.volume == pytest.approx(volume[cell], rel=1e-9)  # as trimesh computes it
        assert body.is_watertight or "periodic" in name  # pieces of one cell may meet in an edge there
    outer = meshes.sides.max(axis=1) - count
    assert set(outer[outer >= 0]) == set(range({"sphere": 2}.get(name, 6)))
    areas = [np.linalg.norm(meshes.normals()[outer == side], axis=1).sum() for side in (0, 1)]
    assert areas == pytest.approx([domain.apical_area, domain.basal_area], rel=3e-3)
    some = mesh_cells(place, domain, 1e-3, [3])
    assert some.volumes()[3] == pytest.approx(volume[3], rel=0.02)
