"""Where a domain lies in an image: the origin and the axes of its own coordinates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Frame:
    """The place of a domain in an image, in the image's unit.

    Points of the image are (x, y, z), and the voxel (k, j, i) is centered at (i, j, k) times the sides of a voxel along
    x, y and z. The point p of the domain lies at origin + p[0] axes[0] + p[1] axes[1] + p[2] axes[2].

    Attributes:
        origin: The origin of the domain in the image, (x, y, z), [3]; of a tube, the middle of the end at axial
            position 0.
        axes: The directions of the domain's x, y and z axes in the image, unit vectors in rows, [3, 3].

    >>> frame = Frame(np.array([1.0, 2.0, 3.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]))
    >>> frame.to_image(np.array([[5.0, 0, 0]])).tolist(), frame.to_domain(np.array([[1.0, 7, 3]])).tolist()
    ([[1.0, 7.0, 3.0]], [[5.0, 0.0, 0.0]])
    """

    origin: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]

    def to_domain(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Coordinates in the domain of points of the image, [p, 3]."""
        return (points - self.origin) @ self.axes.T

    def to_image(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Coordinates in the image of points of the domain, [p, 3]."""
        return points @ self.axes + self.origin


def frame_of_axis(along: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A right-handed frame with its first axis along a direction, and the second as near to the image's y as can be.

    The first axis is turned to where its largest component is positive.

    >>> frame_of_axis(np.array([-2.0, 0, 0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    first = along / np.linalg.norm(along) * np.sign(along[np.abs(along).argmax()])
    guide = np.eye(3)[1 if abs(first[1]) < 0.9 else 2]
    second = guide - first * (first @ guide)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)]) + 0.0
