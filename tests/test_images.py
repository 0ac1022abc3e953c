"""Images of labels: measured against analytic shapes and our own tissues, and fitted back to what was drawn."""

import numpy as np
import pytest
from known import known
from scipy.spatial.transform import Rotation

import jaxtissue as jt
from jaxtissue.images.drawing import draw_labels, draw_turned
from jaxtissue.images.frame import Frame, frame_of_axis
from jaxtissue.images.label_images import close_gaps, remove_specks
from jaxtissue.images.shell_fit import fit_ellipsoid
from jaxtissue.images.voxel_faces import face_areas, face_normals, find_faces

TUBE = jt.Tube(10, 1.5, 4)
CELLS = 40
TURNED = Rotation.from_euler("zyx", [33, -21, 50], degrees=True).as_matrix()
SPACING = (0.28, 0.14, 0.14)


def even_positions(tube: jt.Tube, count: int, seed: int = 0) -> np.ndarray:
    """Positions that keep a distance from each other, as cells do: the best of many at each turn."""
    rng, placed = np.random.default_rng(seed), []
    radius = float(tube.basal_radius)
    for _ in range(count):
        tried = np.column_stack([rng.uniform(0, tube.length, 60), rng.uniform(0, 2 * np.pi, 60)])
        ring = np.column_stack([tried[:, 0], radius * np.cos(tried[:, 1]), radius * np.sin(tried[:, 1])])
        away = [min([np.inf, *(np.linalg.norm(place - other) for other, _ in placed)]) for place in ring]
        best = int(np.argmax(np.array(away)))
        placed.append((ring[best], tried[best]))
    return np.array([position for _, position in placed])


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return even_positions(TUBE, CELLS)


@pytest.fixture(scope="module")
def drawn(positions):
    """The tissue in an image, turned, with flat voxels, and where it lies there."""
    return draw_turned(TUBE, positions, SPACING, TURNED)


@pytest.fixture(scope="module")
def traced(positions) -> jt.Connectivity:
    return jt.find_connectivity(positions, TUBE)


@pytest.fixture(scope="module")
def fit(drawn) -> jt.TissueFit:
    return jt.fit_tissue(drawn[0], SPACING)


def marks_of(image, frame) -> np.ndarray:
    points = frame.to_domain(np.argwhere(np.ones(image.shape, bool))[:, ::-1] * np.array(SPACING)[::-1])
    radius, ends = np.hypot(points[:, 1], points[:, 2]), (points[:, 0] < 0) | (points[:, 0] > TUBE.length)
    return np.where(ends | (image.ravel() > 0), 0, np.where(radius < 2.5, 1, 2)).reshape(image.shape)


def shape_area(labels: np.ndarray, sizes: np.ndarray, weight=lambda points: 1.0) -> tuple[float, float]:
    """The estimated area, and that of the voxel faces alone."""
    faces = find_faces(labels)
    share = weight(faces.middle * sizes)
    plain = np.prod(sizes) / sizes[faces.axis]
    return (face_areas(faces, face_normals(faces, sizes), sizes) * share).sum(), (plain * share).sum()


@pytest.mark.parametrize("sizes", [(1, 1, 1), (0.5, 0.5, 1)])
@pytest.mark.parametrize("radius", [5, 8, 12])
def test_spheres_have_their_area(radius, sizes):
    sizes = np.array(sizes, float)
    shape = (2 * radius / sizes).astype(int)[::-1] + 6
    points = np.argwhere(np.ones(shape, bool))[:, ::-1] * sizes
    away = np.linalg.norm(points - (shape[::-1] - 1) / 2 * sizes - 0.21, axis=1)
    area, plain = shape_area((away < radius).astype(int).reshape(shape), sizes)
    assert area == pytest.approx(4 * np.pi * radius**2, rel=0.01)  # off by 0.4 % in the mean, 0.8 % at most
    assert plain == pytest.approx(1.5 * 4 * np.pi * radius**2, rel=0.1)  # what is to be avoided


@pytest.mark.parametrize("seed", range(6))
def test_flat_walls_have_their_area(seed):
    """Integrated with a smooth weight, (1 - r^2/R^2)^2 over a plane, which is pi R^2 / 3."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    points = np.argwhere(np.ones((37, 37, 37), bool))[:, ::-1] - 18.0
    side = points @ normal / np.linalg.norm(normal) < rng.uniform(-0.5, 0.5)
    labels = np.where(side, 1, 2).reshape(37, 37, 37)
    area, _ = shape_area(
        labels, np.ones(3), lambda place: np.maximum(1 - ((place - 18) ** 2).sum(axis=1) / 144, 0) ** 2
    )
    assert area == pytest.approx(np.pi * 144 / 3, rel=0.015)  # sd 0.4 %, of the few positions of so small a plane


def test_own_tissue_is_measured_as_it_is(drawn, traced):
    image, frame = drawn
    cells, sizes = jt.measure_labels(image, SPACING, marks_of(image, frame)), traced.sizes
    mean = TUBE.volume / CELLS
    np.testing.assert_array_equal(cells.labels, np.arange(1, CELLS + 1))
    assert np.abs(cells.volume - sizes.volume).max() < 0.02 * mean  # about 2,300 voxels a cell
    assert cells.lateral_area.sum() == pytest.approx(sizes.lateral_area.sum(), rel=0.01)
    assert np.std(cells.lateral_area / sizes.lateral_area) < 0.025
    assert known(cells.apical_area).sum() == pytest.approx(TUBE.apical_area, rel=0.02)
    assert known(cells.basal_area).sum() == pytest.approx(TUBE.basal_area, rel=0.01)
    assert not cells.at_border.any() and cells.sides == "given"
    contacts = traced.contacts
    true = {tuple(pair): row for row, pair in enumerate((contacts.pairs + 1).tolist())}
    seen = {tuple(pair): row for row, pair in enumerate(cells.pairs.tolist())}
    large = {pair for pair, row in true.items() if contacts.area[row] > 0.05 * contacts.area.mean()}
    assert large <= set(seen) and len(set(seen) - set(true)) <= 2
    off = [cells.wall_area[seen[pair]] - contacts.area[true[pair]] for pair in large]
    assert np.sqrt(np.mean(np.square(off))) < 0.06 * contacts.area.mean()
    same = [known(cells.kind)[seen[pair]] == contacts.kind[true[pair]] for pair in large]
    assert np.mean(same) > 0.9  # walls that end near a surface, within a voxel, are either kind
    inner = ~traced.is_end
    assert np.mean(known(cells.is_scutoid)[inner] == traced.transitions.is_scutoid[inner]) > 0.9
    assert len(jt.measure_labels(image, SPACING, threshold=0.3).pairs) < len(seen)
    frame_table = cells.to_pandas()
    assert len(frame_table) == CELLS and "apical_basal_neighbors" in frame_table and "40 cells" in repr(cells)


def test_labels_mirror_scale_and_numbers_change_nothing_else(drawn):
    image = drawn[0]
    cells = jt.measure_labels(image, SPACING)
    other = jt.measure_labels(np.where(image > 0, 7000 - 3 * image, 0)[::-1], np.multiply(SPACING, 2))
    np.testing.assert_allclose(other.volume[::-1], 8 * cells.volume)
    # where two cells are equally near, a wall is continued beyond the surface by the first
    np.testing.assert_allclose(other.lateral_area[::-1], 4 * cells.lateral_area, rtol=3e-3)
    np.testing.assert_array_equal(other.neighbors[::-1], cells.neighbors)
    assert cells.sides == "slices"  # the lumen is open at both ends


def test_sides_are_told_where_they_can_be():
    points = np.argwhere(np.ones((30, 30, 30), bool)) - 14.5
    radius = np.linalg.norm(points, axis=1).reshape(30, 30, 30)
    cyst = np.where((radius > 6) & (radius < 12), np.where(points[:, 0] > 0, 1, 2).reshape(30, 30, 30), 0)
    cells = jt.measure_labels(cyst, (1, 1, 1))
    assert cells.sides == "components" and known(cells.kind).tolist() == ["apical_basal"]
    assert known(cells.apical_area).sum() == pytest.approx(4 * np.pi * 36, rel=0.02)
    assert known(cells.basal_area).sum() == pytest.approx(4 * np.pi * 144, rel=0.02)
    around = np.hypot(points[:, 1], points[:, 2]).reshape(30, 30, 30)
    through = np.where((around > 5) & (around < 12), np.where(points[:, 0] > 0, 1, 2).reshape(30, 30, 30), 0)
    cells = jt.measure_labels(through, (1, 1, 1))
    assert cells.sides == "components" and cells.at_border.all()
    cells = jt.measure_labels(np.where(radius < 12, 1, 0), (1, 1, 1))
    assert cells.sides is cells.kind is cells.apical_area is cells.is_scutoid is None


def test_lines_and_specks_are_filled(drawn):
    image = drawn[0]
    lines = image.copy()
    for axis in range(3):
        low, high = np.moveaxis(image, axis, 0)[:-1], np.moveaxis(image, axis, 0)[1:]
        np.moveaxis(lines, axis, 0)[:-1][(low != high) & (low > 0) & (high > 0)] = 0
    assert (lines[image > 0] == 0).mean() > 0.15
    closed = close_gaps(lines)
    assert (closed[image > 0] == 0).mean() < 0.01 and (closed == image)[image > 0].mean() > 0.9
    assert close_gaps(image) is image
    rng, noisy = np.random.default_rng(0), image.copy()
    at = (rng.random(image.shape) < 0.05) & (image > 0)
    noisy[at] = rng.choice(CELLS + 1, at.sum())
    assert (remove_specks(noisy) == image)[image > 0].mean() > 0.99  # of 0.95
    assert (remove_specks(image) == image).mean() > 0.999


@pytest.mark.parametrize(
    ("image", "spacing", "told"),
    [
        (np.ones((4, 4), int), (1, 1, 1), "2 dimensions"),
        (np.ones((4, 4, 4, 3), np.uint8), (1, 1, 1), "colors"),
        (np.ones((4, 4, 4)), (1, 1, 1), "float64"),
        (np.ones((4, 4, 4), bool), (1, 1, 1), "mask"),
        (np.full((4, 4, 4), -1), (1, 1, 1), "the label -1"),
        (np.zeros((4, 4, 4), int), (1, 1, 1), "only the label 0"),
        (np.ones((0, 4, 4), int), (1, 1, 1), "no voxels"),
        (np.ones((4, 4, 4), int), (1, 1), "three sides"),
        (np.ones((4, 4, 4), int), 1, "three sides"),
        (np.ones((4, 4, 4), int), (1, 0, 1), "above 0"),
        (np.ones((4, 4, 4), int), (1, "x", 1), "three sides"),
        (np.ones((4, 4, 4), int), (1, 1, 1), "only one label, 1"),
    ],
)
def test_bad_images_are_refused(image, spacing, told):
    with pytest.raises(ValueError, match=told):
        jt.fit_tissue(image, spacing)


def test_what_can_not_be_fitted_is_refused_or_doubted():
    block = np.zeros((20, 20, 20), int)
    block[3:17, 3:17, 3:10], block[3:17, 3:17, 10:17] = 1, 2
    with pytest.raises(ValueError, match="not enclose a lumen"):
        jt.fit_tissue(block, (1, 1, 1))
    with pytest.raises(ValueError, match="shape='cone' can't be fitted; use one of tube"):
        jt.fit_tissue(block, (1, 1, 1), shape="cone")
    with pytest.raises(ValueError, match="threshold=-1"):
        jt.measure_labels(block, (1, 1, 1), threshold=-1)
    with pytest.raises(ValueError, match="values other than 0"):
        jt.measure_labels(block, (1, 1, 1), block * 5)
    with pytest.raises(ValueError, match="in the shape of the image"):
        jt.measure_labels(block, (1, 1, 1), block[:-1])


def ends_apart(fit: jt.TissueFit, positions: np.ndarray, frame) -> np.ndarray:
    """How far the ends of the fitted backbones are from the true ones, in voxels."""
    found, true = fit.domain.embed(fit.positions), TUBE.embed(positions[fit.labels - 1])
    off = [
        fit.frame.to_image(np.asarray(getattr(found, end), float))
        - frame.to_image(np.asarray(getattr(true, end), float))
        for end in ("apical", "basal")
    ]
    return np.linalg.norm(np.concatenate(off), axis=1) / np.prod(SPACING) ** (1 / 3)


def test_a_drawn_tissue_is_fitted_back(drawn, fit, positions):
    image, frame = drawn
    assert ends_apart(fit, positions, frame).max() < 0.5
    assert fit.report["voxels_same"] > 0.99 and (fit.voxels == image).mean() > 0.99
    assert fit.report["neighbors_kept"] > 0.97 and fit.report["volume_error"] < 0.02
    assert fit.report["cells_at_border"] == fit.report["cells_beside_gap"] == 0
    sizes = [fit.domain.length, fit.domain.apical_radius, fit.domain.basal_radius]
    np.testing.assert_allclose(sizes, [10, 1.5, 4], atol=0.2 * 0.14)
    np.testing.assert_allclose(np.cross(*fit.frame.axes[:2]), fit.frame.axes[2], atol=1e-12)
    columns = fit.columns()
    assert len(columns["label"]) == CELLS and {"image_volume", "model_volume", "at_border"} <= set(columns)
    assert "99." in repr(fit) or "100." in repr(fit)


def test_noise_and_missing_cells_are_tolerated(drawn, positions):
    """5 % of the voxels have another label, or none, and 10 % of the cells are missing."""
    image, frame = drawn
    rng = np.random.default_rng(1)
    gone = rng.choice(np.arange(1, CELLS + 1), CELLS // 10, replace=False)
    noisy = np.where(np.isin(image, gone), 0, image)
    at = (rng.random(image.shape) < 0.05) & (noisy > 0)
    noisy[at] = rng.choice(np.setdiff1d(np.arange(CELLS + 1), gone), at.sum())
    fit = jt.fit_tissue(noisy, SPACING)
    assert (fit.voxels == image)[(image > 0) & ~np.isin(image, gone)].mean() > 0.99
    assert ends_apart(fit, positions, frame).max() < 0.4  # found up to 0.2
    assert fit.beside_gap.any() and 0.08 < fit.report["voxels_missing"] < 0.2
    assert 0.93 < fit.report["voxels_same"] < 0.96  # against the noisy image


def test_a_tissue_that_the_image_cuts_is_flagged(positions):
    image, _ = draw_turned(TUBE, positions, SPACING, np.eye(3))
    cut = image[:, :, : image.shape[2] // 2]
    fit = jt.fit_tissue(cut, SPACING)
    touched = np.unique(cut[:, :, -1])
    np.testing.assert_array_equal(fit.labels[fit.cells.at_border], touched[touched > 0])
    assert fit.report["voxels_same"] > 0.98  # cut cells are fitted to a part of their walls
    seen = cut.shape[2] * 0.14 - 0.28
    assert seen - 0.15 < fit.domain.length < seen + 2.5  # as far as a backbone stands beyond the border


def test_frames_are_as_near_to_the_image_as_can_be():
    np.testing.assert_array_equal(frame_of_axis(np.array([0, 0, -3.0]))[0], [0, 0, 1])
    axes = frame_of_axis(np.array([0.1, 0.99, 0.1]))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)


SHELL_SPACING = (0.6, 0.3, 0.3)
MIDDLE = np.array([8.1, 7.8, 8.3])


def even_directions(count: int) -> np.ndarray:
    """Unit vectors on a spiral from pole to pole, which keep a distance from each other."""
    height, turn = 1 - (2 * np.arange(count) + 1) / count, np.pi * (3 - np.sqrt(5)) * np.arange(count)
    across = np.sqrt(1 - height**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), height])


def drawn_shell(shell, directions) -> np.ndarray:
    """A closed tissue in an image, turned, with flat voxels."""
    sizes, labels = np.array(SHELL_SPACING)[::-1], np.arange(1, len(directions) + 1)
    shape = tuple(np.ceil(16.4 / np.array(SHELL_SPACING)).astype(int).tolist())
    return draw_labels(shell, directions, labels, Frame(MIDDLE, TURNED), sizes, shape)[0]


def test_a_cyst_is_fitted_as_it_was_drawn():
    cyst, directions = jt.Sphere(4, 7), even_directions(24)
    fit = jt.fit_tissue(drawn_shell(cyst, directions), SHELL_SPACING, "sphere")
    radii = [float(fit.domain.apical_radius), float(fit.domain.basal_radius)]
    np.testing.assert_allclose(radii, [4, 7], atol=0.05)
    np.testing.assert_allclose(fit.frame.origin, MIDDLE, atol=0.05)
    ends = fit.frame.to_image(7 * fit.positions)
    assert np.linalg.norm(ends - (7 * directions @ TURNED + MIDDLE), axis=1).max() < 0.2  # half a voxel
    assert fit.report["voxels_same"] > 0.98 and fit.report["neighbors_kept"] > 0.95
    assert fit.report["volume_error"] < 0.03 and {"nx", "ny", "nz"} < fit.columns().keys()


def test_an_ellipsoid_with_a_gap_is_found_where_it_was_drawn():
    shell = jt.Ellipsoid([5, 4, 3], [7.5, 6, 5])
    labels = drawn_shell(shell, even_directions(20))
    found, frame = fit_ellipsoid(np.where(labels == 7, 0, labels), np.array(SHELL_SPACING)[::-1])
    np.testing.assert_allclose(found.apical_axes, shell.apical_axes, atol=0.1)
    np.testing.assert_allclose(found.basal_axes, shell.basal_axes, atol=0.1)
    np.testing.assert_allclose(frame.origin, MIDDLE, atol=0.1)
    np.testing.assert_allclose(np.abs(frame.axes @ TURNED.T), np.eye(3), atol=0.05)
    with pytest.raises(ValueError, match="do not enclose a lumen on all sides"):
        fit_ellipsoid(np.pad(np.ones((8, 8, 8), int), 2), np.ones(3))


def drawn_sheet(slab, places, origin) -> tuple[np.ndarray, Frame]:
    """A flat tissue in an image, turned, with flat voxels."""
    frame, labels = Frame(np.array(origin), TURNED), np.arange(1, len(places) + 1)
    shape = tuple(np.ceil(15 / np.array(SHELL_SPACING)).astype(int).tolist())
    return draw_labels(slab, places, labels, frame, np.array(SHELL_SPACING)[::-1], shape)[0], frame


def test_a_sheet_is_fitted_as_it_was_drawn():
    """Turned, with 5 % of the voxels relabeled and a cell missing; and again where the image cuts it."""
    slab, rng = jt.Slab(9, 8, 3), np.random.default_rng(0)
    places = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2) * [1.8, 2.0] + [0.9, 1.0]
    places += rng.uniform(-0.45, 0.45, places.shape)
    image, frame = drawn_sheet(slab, places, [1.5, 6.0, 10.0])
    noisy = np.where(image == 9, 0, image)
    at = (rng.random(image.shape) < 0.05) & (noisy > 0)
    noisy[at] = rng.choice(np.setdiff1d(np.arange(21), [9]), at.sum())
    fit = jt.fit_tissue(noisy, SHELL_SPACING, "slab")
    np.testing.assert_allclose(sorted([fit.domain.width, fit.domain.depth]), [8, 9], atol=0.1)
    assert fit.domain.thickness == pytest.approx(3, abs=0.05)
    true = embedded(slab, places[fit.labels - 1], frame)
    for found, end in zip(embedded(fit.domain, fit.positions, fit.frame), true, strict=True):
        assert np.sqrt(((found - end) ** 2).sum(axis=1).mean()) < 0.38  # a voxel, of which a cell has 900
    assert (fit.voxels == image)[(image > 0) & (image != 9)].mean() > 0.97
    assert fit.report["cells_at_border"] == 0 and fit.report["cells_beside_gap"] > 0
    assert {"x", "y", "image_volume", "model_apical_area"} < fit.columns().keys()
    cut = image[:, :, : image.shape[2] // 2]
    fit = jt.fit_tissue(cut, SHELL_SPACING, "slab")
    touched = np.unique(cut[:, :, -1])
    np.testing.assert_array_equal(fit.labels[fit.cells.at_border], touched[touched > 0])
    assert fit.report["voxels_same"] > 0.97


def embedded(domain, positions, frame) -> list[np.ndarray]:
    """Both ends of backbones in the image."""
    backbones = domain.embed(positions)
    return [frame.to_image(np.asarray(end, float)) for end in (backbones.apical, backbones.basal)]


def test_what_is_no_sheet_is_refused_and_missing_contacts_are_not_counted():
    points = np.argwhere(np.ones((24, 24, 24), bool)) - 11.5
    ball = np.where(np.linalg.norm(points, axis=1) < 10, 1 + (points[:, 0] > 0), 0).reshape(24, 24, 24)
    shell = np.where(np.linalg.norm(points, axis=1).reshape(24, 24, 24) > 5, ball, 0)
    with pytest.warns(UserWarning, match="contacts of the fitted cells are not computed: .* no three of the 2 cells"):
        fit = jt.fit_tissue(shell, (1, 1, 1), "sphere")
    assert "nan" not in repr(fit) and "of the voxels agree" in repr(fit)
    with pytest.raises(ValueError, match="no two parallel flat surfaces"):
        jt.fit_tissue(1 + (ball > 1), (1, 1, 1), "slab")  # the image has no background
