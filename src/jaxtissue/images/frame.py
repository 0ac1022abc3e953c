"""Location of a domain in an image: origin and axes of its coordinate system."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Frame:
    """Location of a domain in an image, in the length unit of the image.

    Points of the image are (x, y, z); voxel [k, j, i] has its center at (i dx, j dy, k dz). Point p of the domain is at
    origin + p[0] axes[0] + p[1] axes[1] + p[2] axes[2] in the image.

    Attributes:
        origin: Origin of the domain in the image, (x, y, z), shape [3]. For a tube, the center of the end at axial
            position 0.
        axes: Unit vectors along the x, y and z axes of the domain, in rows, shape [3, 3].

    >>> frame = Frame(np.array([1.0, 2.0, 3.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]))
    >>> frame.to_image(np.array([[5.0, 0, 0]])).tolist(), frame.to_domain(np.array([[1.0, 7, 3]])).tolist()
    ([[1.0, 7.0, 3.0]], [[5.0, 0.0, 0.0]])
    """

    origin: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]

    def to_domain(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Convert image coordinates to domain coordinates, shape [p, 3]."""
        return (points - self.origin) @ self.axes.T

    def to_image(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Convert domain coordinates to image coordinates, shape [p, 3]."""
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
