"""Tables of centroids on the layers of a tube, each unrolled: one row per cell and layer, and a fit of the tube."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.tube import Tube

NAMES = ("id", "layer", "radius", "x", "y")
COLUMNS = ("radius", "x", "y")  # of these, the lengths
_ROUND = 1.05  # times its circumference, that a layer reaches round at most


class Layered(NamedTuple):
    """Cells by their centroids on layers.

    Attributes:
        names: What each cell is called.
        lines: A line of the table for each cell.
        axial: Mean position of each cell along the axis, from any origin, shape [n].
        angle: Mean angle of each cell, shape [n].
        radii: Of the innermost and the outermost layer.
    """

    names: tuple[str, ...]
    lines: list[int]
    axial: Float[np.ndarray, " n"]
    angle: Float[np.ndarray, " n"]
    radii: tuple[float, float]

    def fit_tube(self) -> Tube:
        """The tube from the innermost to the outermost layer, half a mean cell longer than the centroids at each end.

        Raises:
            ValueError: If all layers have one radius.
        """
        inner, outer = self.radii
        if not inner < outer:
            raise ValueError(
                f"all layers have the radius {inner:g}; give layers at different radii, from apical to basal"
            )
        width = math.sqrt(math.pi * (inner + outer) / len(self.axial))  # of a cell, for a tube of length 1
        root = (width + math.sqrt(width**2 + 4 * float(np.ptp(self.axial)))) / 2
        return Tube(root**2, inner, outer)

    def place(self, tube: Tube) -> Float[np.ndarray, "n 2"]:
        """(axial, angle) of each cell, with the middle of all in the middle of the tube."""
        middle = (self.axial.min() + self.axial.max()) / 2
        return np.stack([self.axial - middle + float(tube.length) / 2, np.mod(self.angle, 2 * math.pi)], axis=-1)


def join_layers(
    lines: Sequence[int], cells: Sequence[str], layers: Sequence[str], points: Float[np.ndarray, "rows 3"]
) -> Layered:
    """Join the rows of each cell.

    Args:
        lines: The line of each row.
        cells: The `id` of each row.
        layers: The `layer` of each row.
        points: The `radius` of the layer, `x` along the axis and `y` along the circumference, from 0 to 2 pi radius.

    Raises:
        ValueError: If a cell is twice on a layer, if a radius is not positive, or if a layer reaches round more than
            once.

    >>> points = np.array([[2.0, 5, 0], [4, 6, 4], [2, 9, 6], [4, 9, 12]])
    >>> joined = join_layers([2, 3, 4, 5], ["a", "a", "b", "b"], ["0", "1", "0", "1"], points)
    >>> joined.names, joined.axial.tolist(), joined.angle.tolist(), joined.radii
    (('a', 'b'), [5.5, 9.0], [0.5, 3.0], (2.0, 4.0))
    """
    seen: dict[tuple[str, str], int] = {}
    for line, *place in zip(lines, cells, layers, strict=True):
        cell, layer = place
        if not cell:
            raise ValueError(f"line {line}: id is empty; give the cell a name")
        if (cell, layer) in seen:
            raise ValueError(
                f"line {line}: id={cell!r} is also on layer {layer!r} on line {seen[cell, layer]}; remove one"
            )
        seen[cell, layer] = line
    radius, x, y = points.T
    if (radius <= 0).any():
        row = int(np.argmax(radius <= 0))
        raise ValueError(f"line {lines[row]}: radius={radius[row]:g} is not above 0; give the radius of the layer")
    for layer in dict.fromkeys(layers):
        own = np.array([name == layer for name in layers])
        reach, whole = np.ptp(y[own]), 2 * math.pi * radius[own].max()
        if reach > _ROUND * whole:
            told = f"y spans {reach:.4g} on layer {layer!r}, more than its circumference of {whole:.4g}"
            raise ValueError(f"{told}; give y as the length along the circumference, in the unit of the radius")
    first = dict(reversed([(cell, line) for cell, line in zip(cells, lines, strict=True)]))
    names = tuple(sorted(first, key=first.__getitem__))
    number = {name: at for at, name in enumerate(names)}
    own = np.array([number[cell] for cell in cells])
    turn = np.bincount(own, np.sin(y / radius)), np.bincount(own, np.cos(y / radius))
    axial = np.bincount(own, x) / np.bincount(own)
    radii = float(radius.min()), float(radius.max())
    return Layered(names, [first[name] for name in names], axial, np.arctan2(*turn), radii)
