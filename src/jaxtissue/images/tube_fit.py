"""Fit of a straight tube to a label image: axis, radii and ends."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.geometry.tube import Tube
from jaxtissue.images.frame import Frame, frame_of_axis
from jaxtissue.images.voxel_faces import face_areas, face_normals, find_faces

MANY = 20_000  # faces of the surface that the axis is fitted to
FACING = 0.7  # cosine between the normal and a direction, above which a face is held to face it
FEW = 10  # faces on each of the two cylinders that an axis needs
ROUNDS = 40  # steps at most
ENOUGH = 1e-4  # voxels by which the last step moves the tube
LARGE = 1e3  # voxels, of faces that face neither cylinder nor end
BEYOND = 4.0  # voxels on either side of a surface that decide where it is
NO_TUBE = "the labels do not enclose a lumen along any axis; give an image of a tube"


class Surface(NamedTuple):
    """Points of the tissue's surface, normals that point out of it, and areas."""

    points: Float[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "f 3"]
    areas: Float[np.ndarray, " f"]


def fit_tube(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"]) -> tuple[Tube, Frame]:
    """The tube that fills the labels of an image best, and where it lies.

    The axis and first radii are a robust least-squares fit of two coaxial cylinders to the faces of the surface, from
    each of the main directions of its normals and of the voxels. Radii and ends are then where they put the fewest
    voxels on the wrong side: what the tissue lacks here and there does not move them.

    Args:
        image: Labels, 0 outside; holes and missing cells are tolerated.
        sizes: The sides of a voxel along x, y and z.

    Raises:
        ValueError: If the labels enclose no lumen along any axis.
    """
    surface = find_surface(image, sizes)
    voxels = np.argwhere(image > 0)[:, ::-1] * sizes
    middle = voxels.mean(axis=0)
    spreads = [surface.normals.T * surface.areas @ surface.normals, np.cov((voxels - middle).T)]
    step = float(np.prod(sizes) ** (1 / 3))
    fits = [_fit_axis(surface, axis, middle, step) for spread in spreads for axis in np.linalg.eigh(spread)[1].T]
    cost, along, center, radii = min(fits, key=lambda fit: fit[0])
    if not np.isfinite(cost):
        raise ValueError(NO_TUBE)
    return _place(image, sizes, Frame(center, frame_of_axis(along)), radii)


def find_surface(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"]) -> Surface:
    """The surface between labels and background, at `MANY` of its faces at most."""
    faces = find_faces((image > 0).astype(np.int8))
    chosen = np.random.default_rng(0).permutation(len(faces.axis))[:MANY]
    normals = face_normals(faces, sizes, chosen)
    some = faces.where(chosen)
    return Surface(some.middle * sizes, -normals, face_areas(some, normals, sizes))


def _fit_axis(
    surface: Surface, along: Float[np.ndarray, "3"], center: Float[np.ndarray, "3"], step: float
) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"], Float[np.ndarray, "2"]]:
    """How badly a tube fits whose axis was near `along` at first, its axis, a point on it, and the two radii.

    Gauss-Newton steps of the axis, by small turns and shifts, and of the radii, in units of a voxel's side; faces
    weigh 1 / (1 + miss^2), and in each step they are sorted anew by the surface that they face.
    """
    miss, radii = np.ones(len(surface.areas)), np.zeros(2)
    for _ in range(ROUNDS):
        frame = Frame(center, frame_of_axis(along))
        place, facing = frame.to_domain(surface.points) / step, surface.normals @ frame.axes.T
        radius = np.maximum(np.hypot(place[:, 1], place[:, 2]), 1e-9)
        toward = place[:, 1:] / radius[:, None]
        outward = (facing[:, 1:] * toward).sum(axis=1)
        rows = np.stack([outward < -FACING, outward > FACING])
        if rows.sum(axis=1).min() < FEW:
            return np.inf, along, center, radii
        radii = np.array([np.median(radius[row]) for row in rows]) if not radii.any() else radii
        miss = np.where(np.abs(facing[:, 0]) > FACING, 0.0, LARGE)
        miss = np.where(rows.any(axis=0), radius - radii @ rows, miss)
        used = rows.any(axis=0)
        slopes = np.column_stack([toward * place[:, :1], toward, -rows.T.astype(float)])[used]
        weighed = slopes.T * (surface.areas / (1 + miss**2))[used]
        change = np.linalg.lstsq(weighed @ slopes, -weighed @ miss[used])[0]
        # points move by (turn x + shift) across the axis: the axis by as much the other way
        along = frame.axes[0] - change[0] * frame.axes[1] - change[1] * frame.axes[2]
        center = center - step * (change[2:4] @ frame.axes[1:])
        radii = radii + change[4:]
        if np.abs(change[2:]).max() < ENOUGH:
            break
    return float(np.average(np.minimum(miss**2, 1), weights=surface.areas)), along, center, radii * step


def _place(
    image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"], frame: Frame, radii: Float[np.ndarray, "2"]
) -> tuple[Tube, Frame]:
    """Radii and ends where they part tissue and background best."""
    voxels = frame.to_domain(np.argwhere(np.ones(image.shape, bool))[:, ::-1] * sizes)
    axial, radius, full = voxels[:, 0], np.hypot(voxels[:, 1], voxels[:, 2]), image.ravel() > 0
    margin = BEYOND * float(np.max(sizes))
    middle = radii.mean()
    wall = np.abs(radius - middle) < max(0.8 * (radii[1] - middle), 0.5 * float(np.max(sizes)))
    reach = np.abs(frame.axes[0]) @ sizes / 2
    if not (wall & full).any():
        raise ValueError(NO_TUBE)
    low, high = axial[wall & full].min(), axial[wall & full].max()
    first = find_border(axial[wall & (axial < low + margin)], full[wall & (axial < low + margin)], low - reach)
    last = -find_border(-axial[wall & (axial > high - margin)], full[wall & (axial > high - margin)], -high - reach)
    between = (axial > first + margin / 4) & (axial < last - margin / 4)
    inner, outer = (between & (np.abs(radius - size) < min(margin, middle - radii[0])) for size in radii)
    apical = find_border(radius[inner], full[inner], float(radii[0]))
    basal = -find_border(-radius[outer], full[outer], -float(radii[1]))
    if not 0 < apical < basal:
        raise ValueError(NO_TUBE)
    origin = frame.to_image(np.array([[first, 0.0, 0.0]]))[0]
    return Tube(last - first, apical, basal), Frame(origin, frame.axes)


def find_border(place: Float[np.ndarray, " v"], full: np.ndarray, default: float) -> float:
    """Above which place the fewest voxels are background, and below it tissue; the default if all are tissue."""
    order = np.argsort(place)
    place, full = place[order], full[order]
    if full.all() or not full.any():
        return default
    wrong = np.append(0, np.cumsum(np.where(full, 1, -1)))  # tissue below less background below
    best = np.flatnonzero(wrong == wrong.min())
    least, most = best[0], best[-1]
    below = place[max(least - 1, 0)] if least > 0 else place[0]
    above = place[min(most, len(place) - 1)]
    return float((below + above) / 2)
