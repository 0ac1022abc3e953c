"""Tables of tilted and bent backbones: columns for both ends, or one row per node."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.nodes import ENDS

EQUAL = 1e-6  # of the way from node to node, by which heights may be off where nodes are equally spaced


def tilted_columns(columns: Sequence[str]) -> tuple[str, ...]:
    """The columns of both ends of tilted backbones."""
    return tuple(f"{end}_{name}" for end in ENDS for name in columns)


def group_nodes(
    path: Path, lines: Sequence[int], cells: Sequence[str], height: Sequence[float], points: Float[np.ndarray, "rows d"]
) -> tuple[Float[np.ndarray, "n k d"], list[int], tuple[str, ...]]:
    """The nodes of each cell from the apical to the basal one, the lines that they are on, and the names of the cells.

    Heights that are not equally spaced are a last coordinate. Raises `ValueError` for cells with more or fewer nodes.
    """
    first = {name: row for row, name in reversed(list(enumerate(cells)))}
    names, number = sorted(first, key=first.__getitem__), Counter(cells)
    for name in names:
        where = f"{path} line {lines[first[name]]}"
        if not name:
            raise ValueError(f"{where}: cell is empty; give the cell a name")
        if number[name] != number[names[0]]:
            told = f"cell={name!r} has {number[name]} nodes, but cell={names[0]!r} has {number[names[0]]}"
            raise ValueError(f"{where}: {told}; give all cells the same number of nodes")
    order = np.lexsort((height, [first[name] for name in cells]))
    nodes = np.concatenate([points, np.asarray(height)[:, None]], axis=1)[order]
    k = number[names[0]]
    nodes = nodes.reshape(len(names), k, -1)
    if (np.abs(nodes[..., -1] - np.linspace(0, 1, k)) < EQUAL / k).all():
        nodes = nodes[..., :-1]
    return nodes, [lines[row] for row in order.tolist()], tuple(names)
