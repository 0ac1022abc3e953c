"""The outside of a tissue that planes cut open, as faces with an image of the cells on each.

Only points on the faces are labeled, so that a picture takes about as long for any number of cells.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.tube import Tube

PIXELS = 800_000  # of all faces together
OPEN = math.pi / 2, math.pi  # the angles between which the tissue is left out
_STEP = math.radians(2)  # of the straight pieces that circles are drawn by
_POINTS = 4_000_000  # labeled together


class Face(NamedTuple):
    """A face of the outside: a grid of points, and the cells in an image that is laid over it.

    Attributes:
        points: Its points, [u, v, 3].
        cells: The cells at the middles of the image's pixels, [p, q]; p goes with u and q with v.
    """

    points: Float[np.ndarray, "u v 3"]
    cells: Int[np.ndarray, "p q"]

    def pairs(self) -> Int[np.ndarray, "m 2"]:
        """The pairs of cells that touch on the face."""
        one = np.concatenate([self.cells[1:].ravel(), self.cells[:, 1:].ravel()])
        two = np.concatenate([self.cells[:-1].ravel(), self.cells[:, :-1].ravel()])
        return np.unique(np.sort(np.stack([one, two], axis=1)[one != two], axis=1), axis=0)

    def image(self, colors: Int[np.ndarray, "n 3"], line: tuple[int, int, int]) -> Int[np.ndarray, "p q 3"]:
        """The face with its cells in colors, and lines where they meet."""
        cells, image = self.cells, colors[self.cells]
        image[:-1][cells[1:] != cells[:-1]] = line
        image[1:][cells[1:] != cells[:-1]] = line
        image[:, :-1][cells[:, 1:] != cells[:, :-1]] = line
        return image


def cut_open(positions: PositionsLike, tube: Tube, pixels: int | None = None) -> list[Face]:
    """The faces of a tube of which a quarter is left out, between the angles `OPEN`, in about so many pixels.

    >>> faces = cut_open([[1, 0], [3, 3]], Tube(4, 1, 2), pixels=1000)
    >>> faces[0].points.shape, sum(face.cells.size for face in faces)
    ((2, 136, 3), 1124)
    """
    length, inner, outer = (float(size) for size in (tube.length, tube.apical_radius, tube.basal_radius))
    boxes, faces = list(_boxes(length, inner, outer)), []
    extents = [(high - low) * [1, 1, outer] for low, high in boxes]
    side = math.sqrt(sum(math.prod(extent[extent > 0].tolist()) for extent in extents) / (pixels or PIXELS))
    for (low, high), extent in zip(boxes, extents, strict=True):
        first, second = np.flatnonzero(extent > 0).tolist()
        count = [max(2, math.ceil(part / side)) for part in extent[[first, second]].tolist()]
        middles = [low[axis] + (np.arange(n) + 0.5) / n * (high - low)[axis]
                   for axis, n in zip((first, second), count, strict=True)]  # fmt: skip
        knots = [np.linspace(low[axis], high[axis], math.ceil((high - low)[2] / _STEP) + 1 if axis == 2 else 2)
                 for axis in (first, second)]  # fmt: skip
        points = _points(low, (first, second), middles).reshape(-1, 3)
        parts = np.array_split(points, math.ceil(len(points) / _POINTS))
        cells = np.concatenate([label_points(part, positions, tube) for part in parts]).reshape(count)
        faces.append(Face(_points(low, (first, second), knots), cells))
    return faces


def _boxes(length: float, inner: float, outer: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The least and the largest axial position, radius and angle of each face; one of them is the same in both."""
    begin, end = OPEN[1], OPEN[0] + 2 * math.pi
    for radius in (outer, inner):
        yield np.array([0, radius, begin]), np.array([length, radius, end])
    for angle in (begin, end):
        yield np.array([0, inner, angle]), np.array([length, outer, angle])
    for axial in (0, length):
        yield np.array([axial, inner, begin]), np.array([axial, outer, end])


def _points(
    base: Float[np.ndarray, "3"], axes: tuple[int, int], values: list[Float[np.ndarray, " _"]]
) -> Float[np.ndarray, "u v 3"]:
    """Points with these values along two of the axes and the base's along the third."""
    place = np.tile(base, (len(values[0]), len(values[1]), 1))
    place[..., axes[0]], place[..., axes[1]] = values[0][:, None], values[1][None]
    x, radius, angle = np.moveaxis(place, -1, 0)
    return np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
