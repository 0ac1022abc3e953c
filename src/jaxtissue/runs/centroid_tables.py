"""Tables of centroids: the column names of other programs, and a fit of the axis of the tube to the centroids."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.tube import Tube
from jaxtissue.images.frame import Frame, frame_of_axis
from jaxtissue.runs import layer_tables

Points = Float[np.ndarray, "n 3"]
COLUMNS = (
    ("centroid.x", "centroid.y", "centroid.z"),  # MorphoLibJ
    ("areashape_center_x", "areashape_center_y", "areashape_center_z"),  # CellProfiler
    ("location_center_x", "location_center_y", "location_center_z"),  # CellProfiler
    ("centroid-2", "centroid-1", "centroid-0"),  # scikit-image, whose order is z, y, x
    ("centroid_x", "centroid_y", "centroid_z"),
    ("xm", "ym", "zm"),  # Fiji, center of mass
    ("x", "y", "z"),
)
FEW = 8  # centroids that an axis needs
WITHIN = 0.9  # of the centroids that have to lie between the two radii
DOUBT = (
    "contains centroids, not backbones: the cells are approximate (in relaxed tubes volumes are wrong by 4 % and "
    "1 to 5 % of the neighbors differ, elsewhere more); if you have a segmented image, use jaxtissue fit instead"
)


def centroid_columns(names: Sequence[str]) -> tuple[str, ...] | None:
    """The columns of a table that hold x, y and z of centroids, by their names in lower case; None if there are none.

    Of centroids on layers they are radius, x and y.

    >>> centroid_columns(["label", "centroid-0", "centroid-1", "centroid-2"])
    ('centroid-2', 'centroid-1', 'centroid-0')
    """
    if set(layer_tables.NAMES) <= set(names):
        return layer_tables.COLUMNS
    return next((columns for columns in COLUMNS if set(columns) <= set(names)), None)


def place_centroids(points: Points, tube: Tube) -> Float[np.ndarray, "n 2"]:
    """(axial, angle) of the radial backbones through centroids, wherever the tube lies that they are given in.

    Its axis is that of the cylinder which fits the centroids best, robustly; their middle along it is put into the
    middle of the tube.

    Raises:
        ValueError: If there are too few centroids, or if they do not lie between the radii of the tube.

    >>> angle = np.linspace(0, 12, 24)
    >>> points = np.stack([3 * np.cos(angle), 3 * np.sin(angle), angle], axis=-1)  # round the z axis
    >>> place_centroids(points, Tube(length=14, apical_radius=2, basal_radius=4))[[0, -1], 0].round(6).tolist()
    [1.0, 13.0]
    """
    if len(points) < FEW:
        raise ValueError(
            f"{len(points)} centroids are too few; give at least {FEW}, or backbones in columns axial,angle"
        )
    frame = min((_fit_axis(points, axis, tube) for axis in np.linalg.eigh(np.cov(points.T))[1].T), key=lambda f: f[0])[
        1
    ]
    place = frame.to_domain(points)
    radius = np.hypot(place[:, 1], place[:, 2])
    low, high = float(tube.apical_radius), float(tube.basal_radius)
    if np.mean((radius > low) & (radius < high)) < WITHIN:
        found = f"{radius.min():.4g} to {radius.max():.4g}"
        told = f"centroids are {found} from their axis, but the radii are {low:g} and {high:g}"
        raise ValueError(f"{told}; use one unit of length, and multiply voxel numbers by the sides of a voxel")
    middle = (place[:, 0].min() + place[:, 0].max()) / 2
    return np.stack([place[:, 0] - middle + float(tube.length) / 2, np.arctan2(place[:, 2], place[:, 1])], axis=-1)


def _fit_axis(points: Points, along: Float[np.ndarray, "3"], tube: Tube) -> tuple[float, Frame]:
    """How badly the best cylinder near an axis fits, and its frame."""
    from scipy.optimize import least_squares  # takes a fifth of a second to import

    middle, axes = points.mean(axis=0), frame_of_axis(along)
    wall = float(tube.basal_radius) - float(tube.apical_radius)

    def frame_at(parameters: np.ndarray) -> Frame:
        tilt, shift = parameters[:2], parameters[2:4]
        return Frame(middle + wall * shift @ axes[1:], frame_of_axis(axes[0] + tilt @ axes[1:]))

    def miss(parameters: np.ndarray) -> np.ndarray:
        place = frame_at(parameters).to_domain(points)
        return np.hypot(place[:, 1], place[:, 2]) / wall - parameters[4]

    radius = np.median(np.hypot(*frame_at(np.zeros(4)).to_domain(points)[:, 1:].T)) / wall
    found = least_squares(miss, [0, 0, 0, 0, radius], loss="soft_l1", f_scale=0.1)
    return float(found.cost), frame_at(found.x)
