"""Fit of a closed shell, a hollow sphere or ellipsoid, to a label image: center, axes and both surfaces."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from jaxtissue.geometry.shapes import Ellipsoid, Sphere
from jaxtissue.images.frame import Frame
from jaxtissue.images.tube_fit import BEYOND, FACING, FEW, Surface, find_border, find_surface

OUTSIDE = 99  # percent of the voxels along each axis: first semi-axes, which a few cells that bulge do not move
NO_SHELL = "the labels do not enclose a lumen on all sides; give an image of a closed shell, or another shape"


class Surfaces(NamedTuple):
    """Two ellipsoids with a common center and common axes."""

    frame: Frame
    semi: Float[np.ndarray, "2 3"]  # of the apical and the basal surface


def fit_sphere(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"]) -> tuple[Sphere, Frame]:
    """The hollow sphere that fills the labels of an image best, and where it lies; its axes are those of the image.

    As `fit_ellipsoid`, with one radius for each surface.
    """
    frame, semi = _fit_shell(image, sizes, 1)
    return Sphere(*semi[:, 0].tolist()), frame


def fit_ellipsoid(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"]) -> tuple[Ellipsoid, Frame]:
    """The hollow ellipsoid that fills the labels of an image best, and where it lies, with its longest axis first.

    Center, axes and first semi-axes are a robust least-squares fit of two ellipsoids to the faces of the surface. Each
    ellipsoid is then scaled to where it puts the fewest voxels on the wrong side.

    Args:
        image: Labels, 0 outside; holes and missing cells are tolerated.
        sizes: The sides of a voxel along x, y and z.

    Raises:
        ValueError: If the labels enclose no lumen.
    """
    frame, semi = _fit_shell(image, sizes, 3)
    return Ellipsoid(*semi), frame


def _fit_shell(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"], count: int) -> Surfaces:
    """The shell of so many different semi-axes, 1 or 3."""
    from scipy.optimize import least_squares

    surface, step = find_surface(image, sizes), float(np.prod(sizes) ** (1 / 3))
    first = _first_shell(image, sizes, count)
    outward = first.frame.to_domain(surface.points) / first.semi[1] ** 2 @ first.frame.axes
    outward = (outward * surface.normals).sum(axis=1) / np.linalg.norm(outward, axis=1)
    used = np.abs(outward) > FACING
    side = (outward[used] > 0).astype(int)
    if min(np.bincount(side, minlength=2)) < FEW:
        raise ValueError(NO_SHELL)
    faces = Surface(*(column[used] for column in surface))
    weight = np.sqrt(faces.areas / faces.areas.mean())

    def shell(change: np.ndarray) -> Surfaces:
        growth = np.exp(change[3 : 3 + 2 * count].reshape(2, count))
        turned = Rotation.from_rotvec(change[3 + 2 * count :]).as_matrix() if count > 1 else np.eye(3)
        return Surfaces(Frame(first.frame.origin + step * change[:3], turned @ first.frame.axes), first.semi * growth)

    def miss(change: np.ndarray) -> np.ndarray:
        frame, semi = shell(change)
        place, own = frame.to_domain(faces.points), semi[side]
        height = np.linalg.norm(place / own, axis=1)
        return weight * (height - 1) * height / np.linalg.norm(place / own**2, axis=1) / step

    found = least_squares(miss, np.zeros(3 + 2 * count + 3 * (count > 1)), loss="soft_l1")
    return _scaled(shell(found.x), image, sizes)


def _first_shell(image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"], count: int) -> Surfaces:
    """The shell with the center and the axes of inertia of the voxels, and their volume."""
    voxels = np.argwhere(image > 0)[:, ::-1] * sizes
    axes = np.linalg.eigh(np.cov(voxels.T))[1].T[::-1] if count > 1 else np.eye(3)
    axes[2] *= np.sign(np.linalg.det(axes))
    frame = Frame(voxels.mean(axis=0), axes)
    basal = np.percentile(np.abs(frame.to_domain(voxels)), OUTSIDE, axis=0)
    basal = basal if count > 1 else np.full(3, basal.mean())
    hollow = 1 - len(voxels) * np.prod(sizes) / (4 / 3 * np.pi * basal.prod())
    return Surfaces(frame, np.stack([basal * max(hollow, 0.03) ** (1 / 3), basal]))


def _scaled(shell: Surfaces, image: Int[np.ndarray, "z y x"], sizes: Float[np.ndarray, "3"]) -> Surfaces:
    """The shell with surfaces where they part tissue and background best."""
    voxels = shell.frame.to_domain(np.argwhere(np.ones(image.shape, bool))[:, ::-1] * sizes)
    full, growth = image.ravel() > 0, []
    near = min(BEYOND * float(np.max(sizes)), float((shell.semi[1] - shell.semi[0]).min()) / 2)
    for semi, outward in zip(shell.semi, (-1, 1), strict=True):
        height = np.linalg.norm(voxels / semi, axis=1)
        close = np.abs(height - 1) * semi.mean() < near
        growth.append(-outward * find_border(-outward * height[close], full[close], -outward * 1.0))
    scaled = shell.semi * np.array(growth)[:, None]
    if not (scaled[0] > 0).all() or not (scaled[0] < scaled[1]).all():
        raise ValueError(NO_SHELL)
    return Surfaces(shell.frame, scaled)
