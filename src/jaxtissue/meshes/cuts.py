"""Tetrahedra with labeled nodes, cut into the parts of each label: walls that fit from one to the next.

A wall of two labels crosses the edges between their nodes, three walls meet in a line that crosses the faces of three
labels, and four in a point of a tetrahedron of four. Each of these points is put where the squared distances are equal,
but stays in its edge, face or tetrahedron. Within a tetrahedron, walls are cones from one of the points to lines in
faces, so that they never cross, wherever the points lie: the parts fill the tetrahedra without gap or overlap.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.meshes.bisection import EDGES, TOTAL, edge_keys

MARGIN = 1e-3  # of an edge or of a face's height: points keep off the corners, lest triangles vanish
STEPS = 4  # of Newton's method, for points of faces and tetrahedra
HALVINGS = 4  # of what may hold a wall of bent backbones, for points of edges
_ALIKE = np.array([4, 2, 1])  # in the kind of a tetrahedron, for nodes, sorted by label, that are as the one before
_ONE, _TWO, _PAIR, _FOUR = 3, 5, 4, 0  # kinds: one node parted from three, two from two, two from one and one, all
_LAYOUTS = {6: (3, 1, 0, 2), 2: (1, 2, 0, 3), 1: (2, 3, 0, 1)}  # even permutations of other kinds into these
_TURNS = ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 2, 0), (2, 3, 0, 1))  # even permutations


class Walls(NamedTuple):
    """Triangles between pairs of labels, anticlockwise where seen from the second, higher one; and their tetrahedra."""

    points: Float[np.ndarray, "p 3"]
    triangles: Int[np.ndarray, "t 3"]
    sides: Int[np.ndarray, "t 2"]
    origin: Int[np.ndarray, " t"]  # -1 on surfaces


class _Sorted(NamedTuple):
    """Simplices with their nodes in the order of labels, and whether that order turns them inside out."""

    nodes: Int[np.ndarray, "m k"]
    labels: Int[np.ndarray, "m k"]
    mirrored: Bool[np.ndarray, " m"]


def cut(
    nodes: Float[np.ndarray, "p 3"],
    labels: Int[np.ndarray, " p"],
    tetrahedra: Int[np.ndarray, "t 4"],
    surfaces: Mapping[int, Int[np.ndarray, "s 3"]],
    backbones: Crowd,
) -> Walls:
    """Cut tetrahedra along the walls between the cells of their nodes.

    `surfaces` are what bounds the tissue: a label and triangles, anticlockwise from outside. Of the tetrahedra only
    those with more than one label are needed, positively oriented.
    """
    four = _in_layout(_sort(tetrahedra, labels))
    crossed = four.labels[:, EDGES[:, 0]] != four.labels[:, EDGES[:, 1]]
    edges, place = np.unique(edge_keys(four.nodes[:, EDGES])[crossed], return_inverse=True)
    edge = np.full((len(crossed), 4, 4), -1)
    row, which = np.nonzero(crossed)
    one, two = EDGES[which].T
    edge[row, one, two] = edge[row, two, one] = place
    faces, sides, own, face = _number_faces(four, edge)
    inner = np.flatnonzero(_kinds(four.labels) == _FOUR)
    ends = np.stack(np.divmod(edges, TOTAL), axis=1)
    points = [_on_edges(nodes[ends], labels[ends], backbones)]
    points.append(_within(points[0][sides], own, backbones))
    points.append(_within(points[1][face[inner]], four.labels[inner], backbones))
    first = np.cumsum([0, *map(len, points)])
    middle = np.full(len(four.nodes), -1)
    middle[inner] = first[2] + np.arange(len(inner))
    parts = [*_cut_tetrahedra(four, edge, np.where(face < 0, -1, face + first[1]), middle)]
    for bound, triangles in surfaces.items():
        parts += _cut_surface(_sort(triangles, labels), bound, edges, faces, first)
    triangles, pairs, origin = (np.concatenate(column) for column in zip(*parts, strict=True))
    swapped = pairs[:, 0] > pairs[:, 1]
    triangles[swapped], pairs[swapped] = triangles[swapped, ::-1], pairs[swapped, ::-1]
    used, place = np.unique(triangles, return_inverse=True)
    return Walls(np.concatenate([*points, nodes])[used], place.reshape(-1, 3), pairs, origin)


def _sort(simplices: Int[np.ndarray, "m k"], labels: Int[np.ndarray, " p"]) -> _Sorted:
    own = labels[simplices]
    order = np.argsort(own, axis=1, kind="stable")
    one, two = np.triu_indices(simplices.shape[1], 1)
    mirrored = (order[:, one] > order[:, two]).sum(axis=1) % 2 == 1
    return _Sorted(np.take_along_axis(simplices, order, 1), np.take_along_axis(own, order, 1), mirrored)


def _kinds(labels: Int[np.ndarray, "m 4"]) -> Int[np.ndarray, " m"]:
    return (labels[:, 1:] == labels[:, :-1]) @ _ALIKE


def _in_layout(four: _Sorted) -> _Sorted:
    """The nodes so put that a lone label, or the pair of one label, is first."""
    kinds, nodes, labels = _kinds(four.labels), four.nodes.copy(), four.labels.copy()
    for kind, layout in _LAYOUTS.items():
        row = kinds == kind
        nodes[row], labels[row] = four.nodes[row][:, layout], four.labels[row][:, layout]
    return _Sorted(nodes, labels, four.mirrored)


def _number_faces(
    four: _Sorted, edge: Int[np.ndarray, "t 4 4"]
) -> tuple[Int[np.ndarray, " f"], Int[np.ndarray, "f 3"], Int[np.ndarray, "f 3"], Int[np.ndarray, "t 4"]]:
    """The keys, crossed edges and labels of all faces of three labels; that opposite each node by its number, or -1."""
    rows = np.flatnonzero(np.isin(_kinds(four.labels), (_PAIR, _FOUR)))
    keys, crossed, labels, places = [], [], [], []
    for opposite in range(4):
        i, j, k = (node for node in range(4) if node != opposite)
        sides = np.stack([edge[rows, i, j], edge[rows, j, k], edge[rows, k, i]], axis=1)
        three = (sides >= 0).all(axis=1)
        keys.append(edge_keys(sides[three]))  # two of the sides tell the third
        crossed.append(sides[three])
        labels.append(four.labels[rows[three]][:, [i, j, k]])
        places.append((rows[three], np.full(three.sum(), opposite)))
    known, first, number = np.unique(np.concatenate(keys), return_index=True, return_inverse=True)
    face = np.full((len(four.nodes), 4), -1)
    face[tuple(np.concatenate(place) for place in zip(*places, strict=True))] = number
    return known, np.concatenate(crossed)[first], np.concatenate(labels)[first], face


def _cut_tetrahedra(four: _Sorted, edge: np.ndarray, face: np.ndarray, middle: np.ndarray):
    """Triangles and their pairs of labels, by kind."""
    kinds = _kinds(four.labels)
    for kind in (_ONE, _TWO, _PAIR, _FOUR):
        row = np.flatnonzero(kinds == kind)
        e, f, p = edge[row].transpose(1, 2, 0), face[row].T, middle[row]
        if kind == _ONE:
            walls = [(0, 1, (e[0, 1], e[0, 2], e[0, 3]))]
        elif kind == _TWO:
            walls = [(0, 2, (e[0, 2], e[0, 3], e[1, 3])), (0, 2, (e[0, 2], e[1, 3], e[1, 2]))]
        elif kind == _PAIR:
            walls = [(0, 2, (e[0, 2], f[1], f[0])), (0, 2, (e[0, 2], f[0], e[1, 2]))]
            walls += [(0, 3, (e[0, 3], e[1, 3], f[0])), (0, 3, (e[0, 3], f[0], f[1])), (2, 3, (e[2, 3], f[1], f[0]))]
        else:
            walls = [(i, j, (e[i, j], f[k], p)) for i, j, _, k in _TURNS]
            walls += [(i, j, (e[i, j], p, f[k])) for i, j, k, _ in _TURNS]
        for i, j, triangle in walls:
            yield _turned(np.stack(triangle, axis=1), four.mirrored[row]), four.labels[row][:, [i, j]], row


def _cut_surface(three: _Sorted, bound: int, edges: np.ndarray, faces: np.ndarray, first: np.ndarray):
    """Triangles of a surface and their pairs of labels, by kind."""
    own = three.labels
    alike = (own[:, 1:] == own[:, :-1]) @ _ALIKE[1:]
    for kind, layout in ((3, (0, 1, 2)), (2, (2, 0, 1)), (1, (0, 1, 2)), (0, (0, 1, 2))):  # aaa, aa b, a bb, a b c
        row = np.flatnonzero(alike == kind)
        nodes, label = three.nodes[row][:, layout], own[row][:, layout]
        a, b, c = nodes.T + first[-1]
        ab, bc, ca = (np.searchsorted(edges, edge_keys(np.roll(nodes, -i, 1)[:, :2])) for i in range(3))
        if kind == 3:
            parts = [(0, (a, b, c))]
        elif kind:
            parts = [(0, (a, ab, ca)), (1, (ab, b, c)), (1, (ab, c, ca))]
        else:
            p = first[1] + np.searchsorted(faces, edge_keys(np.stack([ab, bc, ca], axis=1)))
            parts = [
                (0, (a, ab, p)),
                (0, (a, p, ca)),
                (1, (b, bc, p)),
                (1, (b, p, ab)),
                (2, (c, ca, p)),
                (2, (c, p, bc)),
            ]
        for i, triangle in parts:
            pair = np.stack([label[:, i], np.full(len(row), bound)], axis=1)
            yield _turned(np.stack(triangle, axis=1), three.mirrored[row]), pair, np.full(len(row), -1)


def _turned(triangles: Int[np.ndarray, "t 3"], mirrored: Bool[np.ndarray, " t"]) -> Int[np.ndarray, "t 3"]:
    return np.where(mirrored[:, None], triangles[:, ::-1], triangles)


def _on_edges(
    ends: Float[np.ndarray, "e 2 3"], labels: Int[np.ndarray, "e 2"], backbones: Crowd
) -> Float[np.ndarray, "e 3"]:
    """The points of edges that are as far from the backbones of both ends.

    Squared distances from a straight line are quadratic along an edge. Those from bent backbones are so in parts: the
    edge is halved a few times first.
    """
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    first, size = np.zeros(len(ends)), 1.0

    def lead(share: float) -> Float[np.ndarray, " e"]:
        """How much farther the first backbone is than the second; so far along the part of the edge looked at."""
        point = start + (first + share * size)[:, None] * along
        one, two = ((backbones.offset(point, own) ** 2).sum(axis=1) for own in labels.T)
        return one - two

    low, mid, high = lead(0), lead(0.5), lead(1)
    for _ in range(HALVINGS if len(backbones.start) > 1 else 0):
        later = mid < 0
        first, size = np.where(later, first + size / 2, first), size / 2
        low, high = np.where(later, mid, low), np.where(later, high, mid)
        mid = lead(0.5)
    slope, bend = 4 * mid - 3 * low - high, 2 * (low + high) - 4 * mid
    divisor = slope + np.sqrt(np.maximum(slope**2 - 4 * bend * low, 0))
    share = np.where(divisor > 0, -2 * low / np.where(divisor > 0, divisor, 1), 0.5)
    share = first + np.clip(share, 0, 1) * size
    return start + np.clip(share, MARGIN, 1 - MARGIN)[:, None] * along


def _within(
    corners: Float[np.ndarray, "m k 3"], labels: Int[np.ndarray, "m k"], backbones: Crowd
) -> Float[np.ndarray, "m 3"]:
    """The points within simplices that are as far from all of their backbones, or near there.

    The corners are where walls of two cells cross edges, or lines of three cross faces: since the angles of cells are
    below 180 degrees, what they run to lies between.
    """
    count, k = labels.shape
    sides = corners[:, 1:] - corners[:, :1]
    share = np.full((count, k), 1 / k)
    for _ in range(STEPS):
        place = np.einsum("mk,mkc->mc", share, corners)
        away = np.stack([backbones.offset(place, labels[:, corner]) for corner in range(k)], axis=1)
        square = np.einsum("mkc,mkc->mk", away, away)
        slope = np.zeros((count, 3, 3)) + np.diag([0.0, 0, 1])
        slope[:, : k - 1, : k - 1] = 2 * np.einsum("mic,mjc->mij", away[:, 1:] - away[:, :1], sides)
        lead = np.zeros((count, 3))
        lead[:, : k - 1] = square[:, 1:] - square[:, :1]
        rows = slope.transpose(1, 0, 2)
        dual = np.stack([np.cross(rows[i - 2], rows[i - 1]) for i in range(3)])
        volume = np.einsum("mc,mc->m", rows[0], dual[0])
        safe = np.abs(volume) > 0
        step = np.einsum("imc,mi->mc", dual, lead) / np.where(safe, volume, 1)[:, None]
        share[:, 1:] -= np.where(safe[:, None], step, 0)[:, : k - 1]
        share[:, 0] = 1 - share[:, 1:].sum(axis=1)
        share = np.maximum(share, MARGIN)
        share /= share.sum(axis=1, keepdims=True)
    return np.einsum("mk,mkc->mc", share, corners)
