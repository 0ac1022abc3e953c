"""What fitting and drawing need to know of each shape of domain.

To fit a further shape is to add its row to `FITTERS`.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.geometry.shapes import Ellipsoid, RoundTube, Slab, Sphere
from jaxtissue.geometry.tube import Tube
from jaxtissue.images.backbone_fit import Positions
from jaxtissue.images.frame import Frame
from jaxtissue.images.outside import APICAL, BASAL
from jaxtissue.images.shell_fit import fit_ellipsoid, fit_sphere
from jaxtissue.images.slab_fit import fit_slab
from jaxtissue.images.tube_fit import fit_tube

INSIDE = 3  # the mark of points of the tissue, beside APICAL and BASAL
TURNS = 30  # of bisection for the height of a point in a shell


class Fitter(NamedTuple):
    """What fitting needs to know of a shape.

    Attributes:
        kind: The classes of its domains.
        domain: The domain and its frame, from an image of labels and the sides of a voxel along x, y and z.
        start: First positions, from the domain, the points of all cells in its frame, their cells and the number of
            cells.
        invert: The points of the base surface and the heights, 0 to 1, of points in the domain's frame.
        settle: Brings positions back into the domain, or to within a distance of its ends, also those of nodes.
        enclose: Extends the domain to where backbones of cells at the border of the image stand, within reason; the
            domain, its frame and the positions in it, from these, also from those of nodes.
        locate: Marks points by where they are: `INSIDE` the tissue, on its `APICAL` or `BASAL` side, or 0, neither.
    """

    kind: tuple[type, ...]
    domain: Callable[[Int[np.ndarray, "z y x"], Float[np.ndarray, "3"]], tuple[Any, Frame]]
    start: Callable[[Any, Float[np.ndarray, "p 3"], Int[np.ndarray, " p"], int], Float[np.ndarray, "n d"]]
    invert: Callable[[Any, Float[np.ndarray, "p 3"]], tuple[Float[np.ndarray, "p d"], Float[np.ndarray, " p"]]]
    settle: Callable[[Any, Positions, float], Positions]
    enclose: Callable[[Any, Frame, Positions], tuple[Any, Frame, Positions]]
    locate: Callable[[Any, Float[np.ndarray, "p 3"]], Int[np.ndarray, " p"]]


def _start_in_tube(
    tube: Tube, points: Float[np.ndarray, "p 3"], cells: Int[np.ndarray, " p"], count: int
) -> Float[np.ndarray, "n 2"]:
    """The mean axial position and angle of each cell's points."""
    axial = np.bincount(cells, points[:, 0], count) / np.bincount(cells, minlength=count)
    angle = np.arctan2(points[:, 2], points[:, 1])
    mean = np.arctan2(np.bincount(cells, np.sin(angle), count), np.bincount(cells, np.cos(angle), count))
    return _settle_in_tube(tube, np.stack([axial, mean], axis=-1))


def _invert_tube(
    tube: Tube | RoundTube, points: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, " p"]]:
    inner, outer = float(tube.apical_radius), float(tube.basal_radius)
    height = (np.hypot(points[:, 1], points[:, 2]) - inner) / (outer - inner)
    return np.column_stack([points[:, 0], np.arctan2(points[:, 2], points[:, 1])]), np.clip(height, 0, 1)


def _settle_in_tube(tube: Tube | RoundTube, positions: Positions, beyond: float = 0.0) -> Positions:
    axial = np.clip(positions[..., 0], -beyond, float(tube.length) + beyond)
    return np.stack([axial, np.mod(positions[..., 1], 2 * math.pi)], axis=-1)


def _enclose_by_tube(
    tube: Tube | RoundTube, frame: Frame, positions: Positions
) -> tuple[Tube | RoundTube, Frame, Positions]:
    """The tube that goes on as far as the backbones do, by at most a mean cell width beyond each end."""
    length = float(tube.length)
    width = math.sqrt(float(tube.basal_area) / len(positions))
    axial = np.clip(positions[..., 0], -width, length + width)
    low, high = min(0.0, axial.min()), max(length, axial.max())
    longer = type(tube)(high - low, tube.apical_radius, tube.basal_radius)
    moved = Frame(frame.to_image(np.array([[low, 0.0, 0.0]]))[0], frame.axes)
    return longer, moved, _settle_in_tube(longer, np.stack([axial - low, positions[..., 1]], axis=-1))


def _locate_in_tube(tube: Tube | RoundTube, points: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
    radius = np.hypot(points[:, 1], points[:, 2])
    marks = np.where(radius < tube.apical_radius, APICAL, np.where(radius > tube.basal_radius, BASAL, INSIDE))
    return np.where((points[:, 0] >= 0) & (points[:, 0] <= tube.length), marks, 0)


def _start_in_slab(
    slab: Slab, points: Float[np.ndarray, "p 3"], cells: Int[np.ndarray, " p"], count: int
) -> Float[np.ndarray, "n 2"]:
    """The mean place of each cell's points in the plane."""
    number = np.bincount(cells, minlength=count)
    return _settle_in_slab(slab, np.stack([np.bincount(cells, part, count) / number for part in points.T[:2]], axis=-1))


def _invert_slab(
    slab: Slab, points: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, " p"]]:
    return points[:, :2], np.clip(points[:, 2] / float(slab.thickness), 0, 1)


def _settle_in_slab(slab: Slab, positions: Positions, beyond: float = 0.0) -> Positions:
    return np.clip(positions, -beyond, np.array([float(slab.width), float(slab.depth)]) + beyond)


def _enclose_by_slab(slab: Slab, frame: Frame, positions: Positions) -> tuple[Slab, Frame, Positions]:
    """The sheet that goes on as far as the backbones do, by at most a mean cell width beyond each side."""
    extent = np.array([float(slab.width), float(slab.depth)])
    width = math.sqrt(extent.prod() / len(positions))
    place = np.clip(positions, -width, extent + width)
    flat = place.reshape(-1, 2)
    low, high = np.minimum(0, flat.min(axis=0)), np.maximum(extent, flat.max(axis=0))
    across, along = (high - low).tolist()
    wider = Slab(across, along, slab.thickness)
    moved = Frame(frame.to_image(np.append(low, 0.0)[None])[0], frame.axes)
    return wider, moved, _settle_in_slab(wider, place - low)


def _locate_in_slab(slab: Slab, points: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
    marks = np.where(points[:, 2] < 0, APICAL, np.where(points[:, 2] > float(slab.thickness), BASAL, INSIDE))
    extent = [float(slab.width), float(slab.depth)]
    return np.where(((points[:, :2] >= 0) & (points[:, :2] <= extent)).all(axis=1), marks, 0)


def _semi_axes(shell: Sphere | Ellipsoid) -> Float[np.ndarray, "2 3"]:
    """The semi-axes of the apical and the basal surface."""
    if isinstance(shell, Sphere):
        return np.outer([float(shell.apical_radius), float(shell.basal_radius)], np.ones(3))
    return np.array([shell.apical_axes, shell.basal_axes], float)


def _start_in_shell(
    shell: Sphere | Ellipsoid, points: Float[np.ndarray, "p 3"], cells: Int[np.ndarray, " p"], count: int
) -> Float[np.ndarray, "n 3"]:
    """The mean direction of each cell's points, where the surface between the two is a unit sphere."""
    unit = _settle_in_shell(shell, points / _semi_axes(shell).mean(axis=0))
    return _settle_in_shell(shell, np.stack([np.bincount(cells, part, count) for part in unit.T], axis=-1))


def _invert_shell(
    shell: Sphere | Ellipsoid, points: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """The height by bisection: where the layer of semi-axes between those of both surfaces goes through the point."""
    apical, basal = _semi_axes(shell)
    low, high = np.zeros(len(points)), np.ones(len(points))
    for _ in range(TURNS):
        middle = (low + high) / 2
        above = np.linalg.norm(points / (apical + middle[:, None] * (basal - apical)), axis=1) > 1
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return _settle_in_shell(shell, points / (apical + low[:, None] * (basal - apical))), low


def _settle_in_shell(shell: Sphere | Ellipsoid, positions: Positions, beyond: float = 0.0) -> Positions:
    return positions / np.linalg.norm(positions, axis=-1, keepdims=True)


def _enclose_by_shell(
    shell: Sphere | Ellipsoid, frame: Frame, positions: Positions
) -> tuple[Sphere | Ellipsoid, Frame, Positions]:
    """The same: a closed shell has all backbones already."""
    return shell, frame, _settle_in_shell(shell, positions)


def _locate_in_shell(shell: Sphere | Ellipsoid, points: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
    above, below = (np.linalg.norm(points / semi, axis=1) for semi in _semi_axes(shell))
    return np.where(above < 1, APICAL, np.where(below > 1, BASAL, INSIDE))


_TUBE = _start_in_tube, _invert_tube, _settle_in_tube, _enclose_by_tube, _locate_in_tube
_SLAB = _start_in_slab, _invert_slab, _settle_in_slab, _enclose_by_slab, _locate_in_slab
_SHELL = _start_in_shell, _invert_shell, _settle_in_shell, _enclose_by_shell, _locate_in_shell
FITTERS = {
    "tube": Fitter((Tube, RoundTube), fit_tube, *_TUBE),
    "slab": Fitter((Slab,), fit_slab, *_SLAB),
    "sphere": Fitter((Sphere,), fit_sphere, *_SHELL),
    "ellipsoid": Fitter((Ellipsoid,), fit_ellipsoid, *_SHELL),
}
