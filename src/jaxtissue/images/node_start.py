"""First places of the nodes of tilted and bent backbones: the middle of each cell at every height."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import components, rows

SMOOTH, CENTERED = 1e-3, 1e-5  # of a cell's voxels: the weight of straightness, and of the middle of the cell


def start_nodes(
    domain: Domain,
    middle: Float[np.ndarray, "n d"],
    place: Float[np.ndarray, "p d"],
    height: Float[np.ndarray, " p"],
    cells: Int[np.ndarray, " p"],
    count: int,
) -> Float[np.ndarray, "n k d"]:
    """The places at equally spaced heights of the lines that lie nearest to the voxels of the cells.

    The line of each cell is straight between its nodes, and a least-squares fit to its voxels within their layers, in
    coordinates round the middle of the cell. Where the cell has few voxels the line goes straight on.

    Args:
        domain: The domain.
        middle: A point of the base surface for each cell, [n, d].
        place: The points of the base surface below the voxels of all cells, [p, d].
        height: The heights of these voxels, 0 to 1, [p].
        cells: The cell of each voxel, [p].
        count: The number of nodes k, at least 2.

    >>> from jaxtissue.geometry.shapes import Slab
    >>> place = np.array([[2.0, 3], [2.5, 3], [3, 3]])
    >>> start_nodes(Slab(5, 5, 2), place[1:2], place, np.array([0, 0.5, 1]), np.zeros(3, int), 2).round(1).tolist()
    [[[2.0, 3.0], [3.0, 3.0]]]
    """
    n, above = len(middle), height * (count - 1)
    first = np.minimum(above.astype(int), count - 2)
    shares = 1 - (above - first), above - first
    with usual_modes():
        center = components(jnp.asarray(middle[cells], float))
        offset = np.asarray(rows(domain.base.difference(center, components(jnp.asarray(place, float)))), float)
    square, right = np.zeros((n, count, count)), np.zeros((n, count, 2))
    for i, share in enumerate(shares):
        node = cells * count + first + i
        right += np.stack([np.bincount(node, share * part, n * count).reshape(n, count) for part in offset.T], axis=-1)
        for j, other in enumerate(shares):
            pair = node * count + first + j
            square += np.bincount(pair, share * other, n * count**2).reshape(n, count, count)
    bent = np.diff(np.eye(count), min(count - 1, 2), axis=0)
    prior = SMOOTH * bent.T @ bent + CENTERED * np.eye(count)
    found = np.linalg.solve(square + np.bincount(cells, minlength=n)[:, None, None] * prior, right)
    with usual_modes():
        center = components(jnp.asarray(np.repeat(middle, count, axis=0), float))
        nodes = rows(domain.base.chart(center, components(jnp.asarray(found.reshape(-1, 2), float))))
    return np.asarray(nodes, float).reshape(n, count, -1)
