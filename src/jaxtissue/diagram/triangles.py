"""Triangles of a layer, cut along the walls between the cells at their corners."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Triangles(NamedTuple):
    """Triangles of a layer: the coordinates of their corners, and the sheet that they lie on."""

    corner: Float[np.ndarray, "m 3 2"]
    sheet: Int[np.ndarray, " m"]


class Walls(NamedTuple):
    """Parts of walls on a layer, from one place to another, and the two segments that they part."""

    ends: Float[np.ndarray, "w 2 2"]
    sheet: Int[np.ndarray, " w"]
    pair: Int[np.ndarray, "w 2"]


def cut_pieces(
    corner: np.ndarray, sides: np.ndarray, middle: np.ndarray, labels: np.ndarray, is_two: np.ndarray
) -> tuple[list[tuple[np.ndarray, ...]], list[tuple[np.ndarray, ...]]]:
    """The parts of cut triangles with their owners, and the walls between with their pairs, each by its triangle."""
    pieces, walls = [], []
    two, three = np.flatnonzero(is_two), np.flatnonzero(~is_two)

    def add_piece(of: np.ndarray, owner: int, *places: np.ndarray) -> None:
        pieces.append((of, np.stack([place[of] for place in places], axis=1), labels[of, owner]))

    def add_wall(of: np.ndarray, first: int, second: int, *places: np.ndarray) -> None:
        walls.append((of, np.stack([place[of] for place in places], axis=1), labels[of][:, [first, second]]))

    add_piece(two, 0, corner[:, 0], sides[:, 0], sides[:, 2])
    add_piece(two, 1, sides[:, 0], corner[:, 1], corner[:, 2])
    add_piece(two, 1, sides[:, 0], corner[:, 2], sides[:, 2])
    add_wall(two, 0, 1, sides[:, 0], sides[:, 2])
    for k in range(3):
        add_piece(three, k, corner[:, k], sides[:, k], middle)
        add_piece(three, k, corner[:, k], middle, sides[:, (k + 2) % 3])
        add_wall(three, k, (k + 1) % 3, sides[:, k], middle)
    return pieces, walls


def quartered(triangles: Triangles) -> Triangles:
    """Each triangle as four."""
    a, b, c = np.moveaxis(triangles.corner, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    four = [np.stack(three, axis=1) for three in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return Triangles(np.concatenate(four), np.tile(triangles.sheet, 4))
