"""The grid of tetrahedra in a domain other than the tube: a mesh of its base surface times heights."""

import math
import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domain_positions import ends_in_space
from jaxtissue.geometry.domains import Domain
from jaxtissue.meshes.grid import Grid

HEIGHTS = 4  # steps from the apical to the basal surface, at least
PER_CELL = 2.0  # steps for each mean cell width along the base surface
LEAST = 12  # steps along a direction of the base surface
TRUE = 1e-3  # of the volume of the domain, that the grid may lack where its surfaces are curved
MOST = 400_000  # nodes: a grid that is still off then is taken as it is, with a warning


class Prisms(NamedTuple):
    """Nodes over a closed triangulated base surface, in layers, each prism of which falls into three tetrahedra.

    It has what a `Grid` has. The nodes of a layer follow each other, those of the apical surface first.
    """

    nodes: Float[np.ndarray, "nodes 3"]
    base: Float[np.ndarray, "b 3"]  # in steps
    triangles: Int[np.ndarray, "t 3"]  # of a layer, counterclockwise as seen from the basal side

    @property
    def turns(self) -> Int[np.ndarray, "3"]:
        """The steps after which each axis comes back to its beginning: none does."""
        return np.zeros(3, int)

    def places(self) -> Float[np.ndarray, "nodes 3"]:
        """The places of the nodes, in steps along the base surface and from layer to layer."""
        outward = self.base / np.linalg.norm(self.base, axis=1)[:, None]
        layers = len(self.nodes) // len(self.base)
        return (self.base + np.arange(layers)[:, None, None] * outward).reshape(-1, 3)

    def tetrahedra(self) -> Int[np.ndarray, "t 4"]:
        """All tetrahedra, positively oriented. Faces are cut from the lower number below, so that neighbors fit."""
        count = len(self.base)
        order = np.argsort(self.triangles, axis=1)
        a, b, c = np.take_along_axis(self.triangles, order, axis=1).T
        is_even = np.isin(order @ [9, 3, 1], [5, 15, 19])  # the permutations 012, 120 and 201
        parts = []
        for low in range(0, len(self.nodes) - count, count):
            high = low + count
            for four in ((a + low, b + low, c + low, c + high), (a + low, b + low, b + high, c + high),
                         (a + low, a + high, b + high, c + high)):  # fmt: skip
                parts.append(np.stack(four, axis=1))
        tetrahedra = np.concatenate(parts)
        mirrored = ~np.tile(is_even, len(parts))
        # of the second of the three, the order of the corners turns the other way
        mirrored ^= np.repeat(np.arange(len(parts)) % 3 == 1, len(a))
        tetrahedra[mirrored] = tetrahedra[mirrored][:, [0, 1, 3, 2]]
        return tetrahedra

    def surfaces(self) -> dict[int, Int[np.ndarray, "s 3"]]:
        """The triangles of the apical (0) and the basal surface (1), counterclockwise as seen from outside."""
        return {0: self.triangles[:, ::-1], 1: self.triangles + len(self.nodes) - len(self.base)}


def domain_grid(domain: Domain, cells: int) -> Grid | Prisms:
    """A grid in a domain of so many cells, with several steps for each, and as many as its curvature needs.

    >>> from jaxtissue.geometry.shapes import Slab
    >>> domain_grid(Slab(4, 3, 1), cells=12).shape
    (13, 13, 5)
    """
    fineness = PER_CELL
    while True:
        grid = _grid(domain, cells, fineness)
        corner = grid.nodes[grid.tetrahedra()]
        edges = corner[:, 1:] - corner[:, :1]
        volume = np.linalg.det(edges).sum() / 6
        off = abs(volume / float(domain.volume) - 1)
        if off < TRUE:
            return grid
        if len(grid.nodes) > MOST:
            warnings.warn(f"the meshes of the cells miss {100 * off:.2g} % of the volume of the domain", stacklevel=4)
            return grid
        fineness *= 1.25


def _grid(domain: Domain, cells: int, fineness: float) -> Grid | Prisms:
    heights = np.linspace(0, 1, HEIGHTS + 1)
    if not isinstance(domain.base, Rectangle):
        base = _spiral(math.ceil(max(cells, 30) * fineness**2))
        nodes = _points(domain, np.tile(base, (len(heights), 1)), np.repeat(heights, len(base)))
        triangles = ConvexHull(base).simplices
        corner = base[triangles]
        inward = (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * corner[:, 0]).sum(axis=1) < 0
        triangles[inward] = triangles[inward, ::-1]
        step = math.sqrt(4 * math.pi / len(base))
        grid = Prisms(nodes, base / step, triangles.astype(int))
        return grid if _is_right_handed(grid) else grid._replace(triangles=triangles[:, ::-1].astype(int))
    return _box(domain, domain.base, cells, fineness, heights)


def _box(domain: Domain, base: Rectangle, cells: int, fineness: float, heights: Float[np.ndarray, " h"]) -> Grid:
    extent = [float(side) for side in base.extent]
    lengths = _lengths(domain, extent)
    width = math.sqrt(lengths[0] * lengths[1] / cells)
    counts = [max(LEAST, math.ceil(fineness * length / width)) for length in lengths]
    closed = [direction == "closed" for direction in base.directions]
    sides = [np.linspace(0, side, count + 1)[: count if ring else None]
             for side, count, ring in zip(extent, counts, closed, strict=True)]  # fmt: skip
    bounds = [None if ring else (first, first + 1) for ring, first in zip(closed, (2, 4), strict=True)]
    for order in ((0, 1), (1, 0)):  # one of them is right-handed
        axes = [sides[axis] for axis in order]
        u = np.meshgrid(*axes, heights, indexing="ij")
        place = np.stack([u[order.index(0)].ravel(), u[order.index(1)].ravel()], axis=1)
        nodes = _points(domain, place, u[2].ravel())
        rings = (closed[order[0]], closed[order[1]], False)
        grid = Grid(nodes, u[2].shape, rings, (bounds[order[0]], bounds[order[1]], (0, 1)))
        if _is_right_handed(grid):
            break
    return grid


def _is_right_handed(grid: Grid | Prisms) -> bool:
    corner = grid.nodes[grid.tetrahedra()[:64]]
    return float(np.linalg.det(corner[:, 1:] - corner[:, :1]).sum()) > 0


def _lengths(domain: Domain, extent: list[float]) -> tuple[float, float]:
    """The lengths of the middle lines of the base surface, halfway from surface to surface."""
    share = np.linspace(0, 1, 65)
    found = []
    for axis in (0, 1):
        place = np.full((65, 2), 0.5) * extent
        place[:, axis] = share * extent[axis]
        points = _points(domain, place, np.full(65, 0.5))
        found.append(float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))
    return found[0], found[1]


def _spiral(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors evenly spread over a sphere: a spiral of Fibonacci."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle, ring = np.arange(count) * math.pi * (3 - math.sqrt(5)), np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _points(domain: Domain, place: Float[np.ndarray, "p d"], height: Float[np.ndarray, " p"]) -> np.ndarray:
    apical, basal = ends_in_space(place, domain)
    return apical + height[:, None] * (basal - apical)
