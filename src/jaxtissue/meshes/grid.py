"""Grids of tetrahedra in a box of three axes, on which tissues are cut into cells."""

import math
from itertools import permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])


class Grid(NamedTuple):
    """Nodes in a box of three axes, in a right-handed order, of which each axis may be closed to a ring.

    A cube of eight nodes falls into six tetrahedra round its diagonal, and a square into two triangles: those of
    neighbors fit. Each open axis ends at two surfaces of the tissue, given by their numbers in `bounds`.
    """

    nodes: Float[np.ndarray, "nodes 3"]
    shape: tuple[int, int, int]
    closed: tuple[bool, bool, bool]
    bounds: tuple[tuple[int, int] | None, ...]  # at the low and the high end of each axis

    @property
    def turns(self) -> Int[np.ndarray, "3"]:
        """The steps after which each axis comes back to its beginning; 0 where it does not."""
        return np.where(self.closed, self.shape, 0)

    def places(self) -> Float[np.ndarray, "nodes 3"]:
        """The steps of each node along the axes."""
        return np.stack(np.unravel_index(np.arange(len(self.nodes)), self.shape), axis=1).astype(float)

    def tetrahedra(self) -> Int[np.ndarray, "t 4"]:
        """All tetrahedra, positively oriented."""
        number = self._numbers()
        corners = np.stack([self._shifted(number, corner).ravel() for corner in _CORNERS], axis=1)
        return np.concatenate([corners[:, list(path)] for path in _paths()])

    def surfaces(self) -> dict[int, Int[np.ndarray, "s 3"]]:
        """The triangles of each surface of the tissue."""
        ends = [(axis, side) for axis, bounds in enumerate(self.bounds) if bounds for side in (0, 1)]
        return {(self.bounds[axis] or (0, 0))[side]: self._surface(axis, side) for axis, side in ends}

    def _surface(self, axis: int, side: int) -> Int[np.ndarray, "t 3"]:
        """The triangles at the low (0) or high (1) end of an open axis, anticlockwise where seen from outside."""
        number = np.moveaxis(self._numbers(), [axis, (axis + 1) % 3, (axis + 2) % 3], [0, 1, 2])
        sheet = number[-1 if side else 0]
        for turn in (0, 1):
            if self.closed[(axis + turn + 1) % 3]:
                sheet = np.concatenate([sheet, np.take(sheet, [0], axis=turn)], axis=turn)
        low, right, high, left = sheet[:-1, :-1], sheet[1:, :-1], sheet[1:, 1:], sheet[:-1, 1:]
        triangles = np.stack([np.stack([low, right, high], -1), np.stack([low, high, left], -1)]).reshape(-1, 3)
        return triangles if side else triangles[:, ::-1]

    def _numbers(self) -> Int[np.ndarray, "x r t"]:
        return np.arange(math.prod(self.shape)).reshape(self.shape)

    def _shifted(self, values: np.ndarray, corner: np.ndarray) -> np.ndarray:
        """The values at one corner of each cube."""
        for axis, step in enumerate(corner.tolist()):
            if self.closed[axis]:
                values = np.roll(values, -step, axis=axis)
            else:
                values = values[(slice(None),) * axis + (slice(1, None) if step else slice(-1),)]
        return values


def _paths() -> list[tuple[int, int, int, int]]:
    """The corners of the six tetrahedra of a cube: along its edges from corner 0 to corner 7."""
    paths = []
    for first, second, third in permutations((4, 2, 1)):
        turned = (first, second, third) in ((4, 2, 1), (2, 1, 4), (1, 4, 2))
        path = (0, first, first + second, 7)
        paths.append(path if turned else (0, first + second, first, 7))
    return paths
