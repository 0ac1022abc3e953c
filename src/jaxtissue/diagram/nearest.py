"""The nearest backbone of points in any domain, by exact search (host, float64)."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.nodes import as_nodes, node_points, with_copies
from jaxtissue.geometry.vectors import rows

TABLE = 2**16  # distances in one table: what fits the processor's cache
TILE = 8  # points of a grid that are looked at together, to either side


@jax.jit
def _nodes(domain: Domain, positions: Array) -> Array:
    """The ends of the straight pieces of backbones and of their copies, [pieces + 1, e, 3]."""
    if positions.ndim == 2:
        positions = jnp.stack([positions, positions], axis=1)
    return jnp.swapaxes(rows(node_points(with_copies(as_nodes(positions, domain), domain), domain)), 0, 1)


class Crowd:
    """The backbones of a tissue and their copies beyond periodic directions.

    Attributes:
        cells: n; backbone number k is backbone k mod n, or a copy of it.
        start: Where their straight pieces begin at the apical side, [pieces, e, 3].
        along: From there to where they end.
    """

    def __init__(self, positions: Float[np.ndarray, "n d"] | Float[np.ndarray, "n k d"], domain: Domain) -> None:
        with usual_modes(), double_precision():
            nodes = np.asarray(_nodes(in_doubles(domain), jnp.asarray(np.asarray(positions, float))))
        self.cells, self.start, self.along = len(positions), nodes[:-1], np.diff(nodes, axis=0)
        self.square = (self.along**2).sum(axis=-1)

    def offset(self, points: Float[np.ndarray, "... 3"], number: Int[np.ndarray, "..."]) -> np.ndarray:
        """From the nearest point of a backbone to each point."""
        best, least = np.zeros(0), np.zeros(0)
        for piece, (starts, ways, square) in enumerate(zip(self.start, self.along, self.square, strict=True)):
            way, along = points - starts[number], ways[number]
            share = np.clip((way * along).sum(axis=-1) / square[number], 0, 1)
            away = way - share[..., None] * along
            if len(self.start) == 1:
                return away
            far = (away**2).sum(axis=-1)
            best = np.where((far < least)[..., None], away, best) if piece else away
            least = np.minimum(far, least) if piece else far
        return best

    def distances(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p e"]:
        """The distances from each point to all backbones."""
        found = np.inf
        for start, along, square in zip(self.start, self.along, self.square, strict=True):
            way = (points**2).sum(axis=1)[:, None] - 2 * points @ start.T + (start**2).sum(axis=1)
            forward = points @ along.T - (start * along).sum(axis=1)
            share = np.clip(forward / square, 0, 1)
            found = np.minimum(found, way - share * (2 * forward - share * square))
        return np.sqrt(np.maximum(found, 0))

    def nearest(self, points: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
        """The number of the nearest backbone of each point."""
        found = np.empty(len(points), int)
        for some in _slices(len(points), self.start.shape[1]):
            found[some] = self.distances(points[some]).argmin(axis=1)
        return found

    def nearest_in_groups(self, points: Float[np.ndarray, "g p 3"]) -> Int[np.ndarray, "g p"]:
        """The same for groups of points close together: only what may be nearest in a group is looked at there."""
        middle = points.mean(axis=1)
        radius = np.linalg.norm(points - middle[:, None], axis=-1).max(axis=1)
        found = np.empty(points.shape[:2], int)
        for some in _slices(len(points), self.start.shape[1]):
            apart = self.distances(middle[some])
            possible = apart <= apart.min(axis=1)[:, None] + 2 * radius[some, None] * (1 + 1e-9) + 1e-300
            count = int(possible.sum(axis=1).max())
            listed = np.argpartition(apart, min(count, apart.shape[1] - 1), axis=1)[:, :count]
            for part in _slices(len(listed), 3 * points.shape[1] * count):
                away = self.offset(points[some][part][:, :, None], listed[part][:, None])
                best = (away**2).sum(axis=-1).argmin(axis=-1)
                found[some][part] = np.take_along_axis(listed[part], best, axis=1)
        return found

    def nearest_on_grid(self, points: Float[np.ndarray, "u v 3"]) -> Int[np.ndarray, "u v"]:
        """The same for a grid of points, tile by tile."""
        u, v = points.shape[:2]
        filled = np.pad(points, ((0, -u % TILE), (0, -v % TILE), (0, 0)), mode="edge")
        down, over = (count // TILE for count in filled.shape[:2])
        tiles = filled.reshape(down, TILE, over, TILE, 3).swapaxes(1, 2).reshape(-1, TILE**2, 3)
        found = self.nearest_in_groups(tiles).reshape(down, over, TILE, TILE).swapaxes(1, 2)
        return found.reshape(down * TILE, over * TILE)[:u, :v]


def _slices(count: int, width: int) -> Iterator[slice]:
    """Rows in parts of tables of such a width."""
    step = max(1, TABLE // max(width, 1))
    for first in range(0, count, step):
        yield slice(first, first + step)
