"""The grid of tetrahedra in a tube: all that the meshes know of its shape."""

import math

import numpy as np

from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.grid import Grid

SURFACES = ("apical", "basal", "start", "end")  # what bounds a tube: the labels n .. n + 3
LEAST = 8, 4, 64  # steps along the axis, in radius and in angle
_FINENESS = 2  # steps for each mean cell width, on the surface where cells are narrowest
_UP = 2  # times as many in radius for each e-fold of the radius, and at least those of one cell width


def tube_grid(tube: Tube, cells: int, span: tuple[float, float] = (-math.inf, math.inf)) -> Grid:
    """A grid in a tube of so many cells, about two steps for each of them on the surface where they are narrowest.

    The axes are axial position, radius and angle. Circles become polygons of the same area, so that the tetrahedra
    together have the volume of the tube. With a span, the grid goes along the axis only as far as to hold it.

    >>> grid = tube_grid(Tube(10, 1, 2), cells=20)
    >>> grid.shape, grid.closed
    ((13, 5, 64), (False, False, True))
    """
    length, inner, outer = (float(size) for size in (tube.length, tube.apical_radius, tube.basal_radius))
    narrow, wide = (math.sqrt(2 * math.pi * radius * length / cells) for radius in (inner, outer))
    along = max(LEAST[0], math.ceil(_FINENESS * length / min(narrow, length)))
    round_ = max(LEAST[2], math.ceil(_FINENESS * 2 * math.pi * outer / wide))
    up = max(LEAST[1], math.ceil(_FINENESS * max(1, _UP * math.log(outer / inner))))
    axial = np.linspace(0, length, along + 1)
    first, last = np.searchsorted(axial, span[0], "right") - 1, np.searchsorted(axial, span[1])
    axial = axial[max(first, 0) : last + 1]
    radius = np.linspace(inner**0.5, outer**0.5, up + 1) ** 2
    angle = np.arange(round_) * (2 * math.pi / round_)
    radius = radius * math.sqrt(angle[1] / math.sin(angle[1]))
    x, r, t = np.meshgrid(axial, radius, angle, indexing="ij")
    nodes = np.stack([x, r * np.cos(t), r * np.sin(t)], axis=-1).reshape(-1, 3)
    return Grid(nodes, x.shape, (False, False, True), ((2, 3), (0, 1), None))
