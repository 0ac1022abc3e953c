"""Fit of a flat sheet to a label image: its plane, thickness, sides and ends."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from jaxtissue.geometry.shapes import Slab
from jaxtissue.images.frame import Frame, frame_of_axis
from jaxtissue.images.tube_fit import BEYOND, ENOUGH, FACING, FEW, ROUNDS, Surface, find_border, find_surface

CUT_OFF = 0.01  # of the tissue, more than which no straight side may cut off: a ragged one lies outside of all cells
NO_SLAB = "the labels have no two parallel flat surfaces; give an image of a flat sheet"

Box = Float[np.ndarray, "2 3"]  # the least and the largest coordinate along each axis


def fit_slab(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"]) -> tuple[Slab, Frame]:
    """The flat sheet that fills the labels of an image best, and where it lies.

    Its plane is a robust least-squares fit of two parallel planes, the apical one before the other along that axis of
    the image that it faces most, to the faces of the surface. The sides are turned to where the faces at the rim look,
    or along the image where there is no rim. Surfaces and sides are then where they put the fewest voxels on the wrong
    side: what the tissue lacks here and there does not move them. Where the rim is ragged, or cut by the image, a side
    is moved out to contain all cells.

    Args:
        image: Labels, 0 outside; holes and missing cells are tolerated.
        sizes: The sides of a voxel along x, y and z.

    Raises:
        ValueError: If the labels have no two parallel flat surfaces.
    """
    surface, voxels = find_surface(image, sizes), np.argwhere(image > 0)[:, ::-1] * sizes
    step, middle = float(np.prod(sizes) ** (1 / 3)), voxels.mean(axis=0)
    spreads = [surface.normals.T * surface.areas @ surface.normals, np.cov((voxels - middle).T)]
    tried = [axis for spread in spreads for axis in np.linalg.eigh(spread)[1].T]
    fits = [_fit_planes(surface, axis, middle, step) for axis in tried]
    share, normal = max(fits, key=lambda fit: fit[0])
    if share == 0:
        raise ValueError(NO_SLAB)
    return _place(image, sizes, _turned(surface, Frame(middle, _axes(normal))))


def _axes(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A right-handed frame with its third axis along a normal."""
    third, first, second = frame_of_axis(normal)
    return np.stack([first, second, third])


def _fit_planes(
    surface: Surface, normal: Float[np.ndarray, "3"], center: Float[np.ndarray, "3"], step: float
) -> tuple[float, Float[np.ndarray, "3"]]:
    """How much of the surface lies on two parallel planes whose normal was near `normal` at first, and their normal.

    Gauss-Newton steps by small turns, in units of a voxel's side; faces weigh 1 / (1 + miss^2).
    """
    levels, share = np.zeros(2), 0.0
    for turn in range(ROUNDS):
        axes = _axes(normal)
        place = (surface.points - center) @ axes.T / step
        facing = surface.normals @ axes[2]
        sides = np.stack([facing < -FACING, facing > FACING])
        if sides.sum(axis=1).min() < FEW:
            return 0.0, normal
        levels = levels if turn else np.array([np.median(place[side, 2]) for side in sides])
        used = sides.any(axis=0)
        miss = (place[:, 2] - levels @ sides)[used]
        weight = surface.areas[used] / (1 + miss**2)
        share = float(weight.sum())
        slopes = np.column_stack([place[used, 1], -place[used, 0], -sides.T[used].astype(float)])
        change = np.linalg.lstsq((slopes.T * weight) @ slopes, -(slopes.T * weight) @ miss)[0]
        normal = axes[2] + change[0] * axes[1] - change[1] * axes[0]
        levels = levels + change[2:]
        if np.abs(change[:2]).max() * np.abs(place).max() < ENOUGH:
            break
    return share * float(levels[1] > levels[0]), normal / np.linalg.norm(normal)


def _turned(surface: Surface, frame: Frame) -> Frame:
    """The frame turned in its plane to where the faces at the rim look: their directions, four times the angle."""
    facing = surface.normals @ frame.axes.T
    rim = np.abs(facing[:, 2]) < np.sqrt(1 - FACING**2)
    turn = 0.0
    for sharp in (0, 1, 4, 16):  # those that look well along an axis count more and more
        angle = np.arctan2(facing[rim, 1], facing[rim, 0]) - turn
        weight = surface.areas[rim] * np.abs(np.cos(2 * angle)) ** sharp
        looks = (weight * np.exp(4j * angle)).sum()
        if np.abs(looks) < 0.3 * surface.areas[rim].sum():
            break
        turn += np.angle(looks) / 4
    about = Rotation.from_rotvec([0, 0, -turn]).as_matrix()
    return Frame(frame.origin, about @ frame.axes)


def _place(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"], frame: Frame) -> tuple[Slab, Frame]:
    """Surfaces and sides where they part tissue and background best."""
    voxels = frame.to_domain(np.argwhere(np.ones(image.shape, bool))[:, ::-1] * sizes)
    full, margin = image.ravel() > 0, BEYOND * float(np.max(sizes))
    reach = np.abs(frame.axes) @ sizes / 2
    box = np.stack([np.percentile(voxels[full], q, axis=0) for q in (2, 98)])
    for axis in (2, 0, 1, 2):
        others = [k for k in range(3) if k != axis]
        inner = box[:, others] + np.outer((1, -1), np.minimum(margin, np.ptp(box[:, others], axis=0)) / 4)
        within = ((voxels[:, others] > inner[0]) & (voxels[:, others] < inner[1])).all(axis=1)
        place, filled = voxels[within, axis], full[within]
        if not filled.any():
            raise ValueError(NO_SLAB)
        ends, half = [], np.ptp(place[filled]) / 2
        for sign, end in ((1, place[filled].min()), (-1, place[filled].max())):
            near, outermost = sign * (place - end) < min(margin, half), sign * end - reach[axis]
            border = find_border(sign * place[near], filled[near], outermost)
            is_ragged = (filled & (sign * place < border)).sum() > CUT_OFF * filled.sum()
            ends.append(sign * (outermost if is_ragged else border))
        box[:, axis] = ends
    if not (box[0] < box[1]).all():
        raise ValueError(NO_SLAB)
    width, depth, thickness = (box[1] - box[0]).tolist()
    return Slab(width, depth, thickness), Frame(frame.to_image(box[:1])[0], frame.axes)
