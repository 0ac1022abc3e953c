"""Colors of cells that the color-blind tell apart, and no neighbor's."""

import numpy as np
from jaxtyping import Int

from jaxtissue.meshes.cell_meshes import CellMeshes

# Okabe and Ito's palette without black, and a lighter gray in its place
PALETTE = ("#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7", "#BBBBBB")


def color_cells(meshes: CellMeshes) -> Int[np.ndarray, " n"]:
    """A color of `PALETTE` for each cell, by its number and those of its neighbors alone.

    Cells take turns by number; each takes the color that its neighbors use least, which is none of theirs where one is
    left, and of several the one that its number points to.
    """
    return spread_colors(meshes.cells, meshes.sides[meshes.sides[:, 1] < meshes.cells])


def spread_colors(cells: int, pairs: Int[np.ndarray, "m 2"]) -> Int[np.ndarray, " n"]:
    """As `color_cells`, of the given pairs of neighbors.

    >>> spread_colors(3, np.array([[0, 1], [1, 2], [0, 2]])).tolist()
    [0, 1, 2]
    """
    both = np.unique(np.concatenate([pairs, pairs[:, ::-1]]) @ [cells, 1])
    start, other = np.searchsorted(both, cells * np.arange(cells + 1)).tolist(), (both % cells).tolist()
    colors, count = [0] * cells, len(PALETTE)
    for cell in range(cells):  # in lists: for a few numbers arrays take ten times as long
        used = [0] * count
        for near in other[start[cell] : start[cell + 1]]:
            if near < cell:
                used[colors[near]] += 1
        turns = [(cell + turn) % count for turn in range(count)]
        colors[cell] = min(turns, key=used.__getitem__)
    return np.array(colors, int)
