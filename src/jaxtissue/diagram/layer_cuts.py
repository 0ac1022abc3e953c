"""The exact path on any domain: layers cut into triangles, and these along the walls between cells, in 64 bits.

Nothing here knows of neighbors, polygons or edges that are followed: corners of fine triangles have the label of the
nearest backbone; where labels differ, walls are found along the sides by their distances, and junctions within. A
triangle in which a further backbone is nearest there is cut into four, and so on.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.triangles import Triangles, Walls, cut_pieces, quartered
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.vectors import Vector, add, rows, scale, subtract

CHUNK = 8192  # points looked at in one call: always as many, so that one program serves all
NODES = 200_000  # of layers that are cut at once
LEVELS = 4  # times that a triangle may be cut into four
TURNS = 6  # of finding a wall between two corners, and of Newton's method
TIE = 1e-9  # of the mean width of a cell: what is nearer by less is as near
OUTSIDE = 0.25  # of a triangle, by which a junction may lie out of it
# the axes of the faces of a cube on which a sphere is laid out
FACES = np.array([np.roll(np.diag([s, s, 1.0]), k, axis=1) for k in range(3) for s in (1.0, -1.0)])


class Spots(NamedTuple):
    """Points of a layer in space, [p, 3], and how they move with both coordinates and the height, [p, 3, 3]."""

    point: Float[np.ndarray, "p 3"]
    columns: Float[np.ndarray, "p 3 3"]


@functools.partial(jax.jit, static_argnames="moves")
def _look(domain: Domain, axes: Array, place: Array, h: Array, moves: bool) -> tuple[Array, Array | None]:
    """Points at coordinates from 0 to 1 on the rectangle, or on a face of a cube round the sphere; their moves."""

    def base_point(s: Array, t: Array) -> Vector:
        if isinstance(domain.base, Rectangle):
            return (s * domain.base.extent[0], t * domain.base.extent[1])
        x, y = jnp.tan(jnp.pi / 4 * (2 * s - 1)), jnp.tan(jnp.pi / 4 * (2 * t - 1))
        way = tuple(axes[:, 0, k] + x * axes[:, 1, k] + y * axes[:, 2, k] for k in range(3))
        return scale(1 / jnp.sqrt(1 + x * x + y * y), way)

    def at(s: Array, t: Array) -> tuple[Vector, Vector]:
        apical, basal = domain.surfaces(base_point(s, t))
        upward = subtract(basal, apical)
        return add(apical, scale(h, upward)), upward

    s, t = place[:, 0], place[:, 1]
    if not moves:
        return rows(at(s, t)[0]), None
    one, none = jnp.ones_like(s), jnp.zeros_like(s)
    (point, upward), (first, _) = jax.jvp(at, (s, t), (one, none))
    _, (second, _) = jax.jvp(at, (s, t), (none, one))
    return rows(point), jnp.stack([rows(first), rows(second), rows(upward)], axis=-1)


class LayerCuts:
    """A tissue that is measured on layers, with so many triangles across the mean cell.

    A sheet is one face of a layer: number k is face k mod `faces` of layer k // `faces`.
    """

    def __init__(self, positions: Float[np.ndarray, "n d"], domain: Domain, layers: int, across: int) -> None:
        with usual_modes(), double_precision():
            self.domain, self.crowd = in_doubles(domain), Crowd(positions, domain)
            self.width = float(domain.basal_area / len(positions)) ** 0.5
        nodes, weights = np.polynomial.legendre.leggauss(layers)
        self.faces = 1 if isinstance(domain.base, Rectangle) else len(FACES)
        self.heights, self.weights = np.append((nodes + 1) / 2, 1.0), weights / 2
        self.counts = self._counts(across)

    def look(self, sheet: Int[np.ndarray, " p"], place: Float[np.ndarray, "p 2"]) -> Spots:
        """The points at coordinates on sheets, and how they move."""
        return Spots(*self._seen(sheet, place, True))

    def points(self, sheet: Int[np.ndarray, " p"], place: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p 3"]:
        """The points alone."""
        return self._seen(sheet, place, False)[0]

    def _seen(self, sheet: np.ndarray, place: np.ndarray, moves: bool) -> list[np.ndarray]:
        found = []
        axes, level = FACES[sheet % self.faces], self.heights[sheet // self.faces]
        with usual_modes(), double_precision():
            for first in range(0, len(place), CHUNK):
                some = [part[first : first + CHUNK] for part in (axes, place, level)]
                lacks = CHUNK - len(some[0])
                full = [np.concatenate([part, np.repeat(part[-1:], lacks, axis=0)]) if lacks else part for part in some]
                seen = _look(self.domain, *full, moves)[: 1 + moves]
                found.append([np.asarray(part)[: CHUNK - lacks] for part in seen])
        return [np.concatenate(parts) for parts in zip(*found, strict=True)] or [np.zeros((0, 3)), np.zeros((0, 3, 3))]

    def measure(
        self, layers: Int[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, "w 2"], Float[np.ndarray, " w"]]:
        """What layers add to the volumes of all cells, and to areas of walls, in parts with their pairs of cells."""
        n = self.crowd.cells
        triangles, labels = self._first(layers)
        parts: list[Triangles] = []
        owners, walls = [], []
        for level in range(LEVELS + 1):
            whole = (labels == labels[:, :1]).all(axis=1)
            parts.append(Triangles(*(part[whole] for part in triangles)))
            owners.append(labels[whole, 0])
            mixed, labels = Triangles(*(part[~whole] for part in triangles)), labels[~whole]
            again, pieces, owner, wall = self._cut(mixed, labels, level == LEVELS)
            parts.append(pieces)
            owners.append(owner)
            walls.append(wall)
            if not len(again):
                break
            triangles = quartered(Triangles(*(part[again] for part in mixed)))
            labels = self._labels(triangles)
        filled = Triangles(*map(np.concatenate, zip(*parts, strict=True)))
        wall = Walls(*map(np.concatenate, zip(*walls, strict=True)))
        volume = np.bincount(np.concatenate(owners) % n, self._volumes(filled), n)
        pair = np.sort(wall.pair % n, axis=1)
        real = pair[:, 0] != pair[:, 1]
        return volume, pair[real], self._areas(wall)[real]

    def _counts(self, across: int) -> tuple[int, int]:
        """How many nodes there are along both coordinates of a face."""
        grid = np.linspace(0, 1, 17)
        s, t = (table.ravel() for table in np.meshgrid(grid, grid, indexing="ij"))
        basal = np.full(len(s), len(self.weights) * self.faces)
        point = self.points(basal, np.stack([s, t], axis=1)).reshape(17, 17, 3)
        found = []
        for k in (0, 1):
            length = np.linalg.norm(np.diff(point, axis=k), axis=-1).sum(axis=k).max()
            found.append(2 + int(np.ceil(length * across / self.width)))
        return found[0], found[1]

    def _first(self, layers: Int[np.ndarray, " k"]) -> tuple[Triangles, Int[np.ndarray, "m 3"]]:
        """The triangles of whole layers, and the labels of their corners."""
        first, second = self.counts
        s, t = np.meshgrid(np.linspace(0, 1, first), np.linspace(0, 1, second), indexing="ij")
        place = np.stack([s, t], axis=-1)
        corners, labels, sheets = [], [], []
        for sheet in (layers[:, None] * self.faces + np.arange(self.faces)).ravel().tolist():
            point = self.points(np.full(s.size, sheet), place.reshape(-1, 2))
            label = self.crowd.nearest_on_grid(point.reshape(first, second, 3))
            for table, into in ((place, corners), (label, labels)):
                a, b, c, d = table[:-1, :-1], table[1:, :-1], table[1:, 1:], table[:-1, 1:]
                for three in ((a, b, c), (a, c, d)):
                    into.append(np.stack(three, axis=2).reshape(-1, 3, *table.shape[2:]))
            sheets.append(np.full(2 * (first - 1) * (second - 1), sheet))
        return Triangles(np.concatenate(corners), np.concatenate(sheets)), np.concatenate(labels)

    def _labels(self, triangles: Triangles) -> Int[np.ndarray, "m 3"]:
        point = self.points(np.repeat(triangles.sheet, 3), triangles.corner.reshape(-1, 2))
        return self.crowd.nearest(point).reshape(-1, 3)

    def _gap(self, sheet: np.ndarray, place: np.ndarray, pair: Int[np.ndarray, "p 2"]) -> np.ndarray:
        """How much farther the second segment of a pair is than the first, as squares."""
        away = self.crowd.offset(self.points(sheet, place)[:, None], pair)
        return (away[:, 1] ** 2 - away[:, 0] ** 2).sum(axis=-1)

    def _cut(
        self, triangles: Triangles, labels: Int[np.ndarray, "m 3"], is_last: bool
    ) -> tuple[np.ndarray, Triangles, Int[np.ndarray, " k"], Walls]:
        """Cut triangles with two or three labels along the walls; first come those that are to be made smaller."""
        corner, sheet = triangles
        two = labels[:, 1:] == labels[:, [2, 0]]  # corners 1 and 2, or 2 and 0, are alike
        turn = np.where(two[:, 0], 0, np.where(two[:, 1], 1, np.where(labels[:, 0] == labels[:, 1], 2, 0)))
        order = (np.arange(3) + turn[:, None]) % 3  # the one that stands alone comes first
        labels, corner = np.take_along_axis(labels, order, axis=1), np.take_along_axis(corner, order[..., None], axis=1)
        is_two = labels[:, 1] == labels[:, 2]
        row, side = np.nonzero(~is_two[:, None] | [True, False, True])
        ends = np.stack([side, (side + 1) % 3], axis=1)
        pair, sides, bad = labels[row[:, None], ends], np.zeros((len(sheet), 3, 2)), np.zeros(len(sheet), bool)
        sides[row, side] = self._crossing(sheet[row], corner[row[:, None], ends], pair)
        bad[row[self._is_other(sheet[row], sides[row, side], pair)]] = True
        three = np.flatnonzero(~is_two)
        middle = sides.mean(axis=1)
        middle[three], lost = self._junction(sheet[three], corner[three], middle[three], labels[three])
        bad[three] |= lost | self._is_other(sheet[three], middle[three], labels[three])
        bad &= not is_last
        pieces, walls = cut_pieces(corner, sides, middle, labels, is_two)
        piece_of, part, owner = (np.concatenate(column) for column in zip(*pieces, strict=True))
        wall_of, ends, pair = (np.concatenate(column) for column in zip(*walls, strict=True))
        kept, seen = ~bad[piece_of], ~bad[wall_of]
        return (np.flatnonzero(bad), Triangles(part[kept], sheet[piece_of[kept]]), owner[kept],
                Walls(ends[seen], sheet[wall_of[seen]], pair[seen]))  # fmt: skip

    def _crossing(self, sheet: np.ndarray, ends: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Where two segments are as near, between two places of which each is nearer to one, by regula falsi."""
        low, high, share = np.zeros(len(sheet)), np.ones(len(sheet)), np.full(len(sheet), 0.5)
        below, above = (self._gap(sheet, ends[:, k], pair) for k in (0, 1))
        before = np.zeros(
            len(sheet), int
        )  # the side that was moved last; where one is moved twice, the other counts half
        for _ in range(TURNS):
            fall = below - above
            share = np.where(fall > 0, low + (high - low) * below / np.where(fall > 0, fall, 1), (low + high) / 2)
            value = self._gap(sheet, ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0]), pair)
            first = value > 0  # still nearer to the first
            above = np.where(first, np.where(before == 1, above / 2, above), value)
            below = np.where(first, value, np.where(before == -1, below / 2, below))
            low, high, before = np.where(first, share, low), np.where(first, high, share), np.where(first, 1, -1)
        return ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])

    def _is_other(self, sheet: np.ndarray, place: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """Whether a segment that is not among the labels is nearer to a place than all of these."""
        point = self.points(sheet, place)
        nearest = self.crowd.nearest(point)
        own = np.linalg.norm(self.crowd.offset(point[:, None], labels), axis=-1).max(axis=1, initial=0)
        other = np.linalg.norm(self.crowd.offset(point, nearest), axis=-1)
        return (nearest[:, None] != labels).all(axis=1) & (other < own - TIE * self.width)

    def _junction(
        self, sheet: np.ndarray, corner: np.ndarray, start: np.ndarray, labels: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where three segments are as near, by Newton's method, and whether that lies out of the triangle."""
        place = start.copy()
        sides = np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2)
        for _ in range(TURNS):
            spots = self.look(sheet, place)
            away = self.crowd.offset(spots.point[:, None], labels)
            apart = away[:, 1:] - away[:, :1]
            value = (apart * (away[:, 1:] + away[:, :1])).sum(axis=-1)
            slope = 2 * apart @ spots.columns[..., :2] @ sides
            a, b, c, d = slope.reshape(-1, 4).T
            turn = a * d - b * c
            turn = np.where(np.abs(turn) > 1e-300, turn, np.inf)
            step = np.stack([d * value[:, 0] - b * value[:, 1], a * value[:, 1] - c * value[:, 0]], axis=1)
            step = np.clip(step / turn[:, None], -0.5, 0.5)
            place = place - np.einsum("pij,pj->pi", sides, step)
        within = np.linalg.solve(sides, (place - corner[:, 0])[..., None])[..., 0]
        share = np.concatenate([1 - within.sum(axis=1, keepdims=True), within], axis=1)
        lost = ~(share.min(axis=1, initial=1) > -OUTSIDE)
        place[lost] = start[lost]
        return place, lost

    def _volumes(self, triangles: Triangles) -> Float[np.ndarray, " m"]:
        """What triangles add to volumes: a rule of three places, exact to the second degree."""
        corner, sheet = triangles
        one, two = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
        size = (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
        places = (corner.sum(axis=1, keepdims=True) + 3 * corner) / 6
        columns = self.look(np.repeat(sheet, 3), places.reshape(-1, 2)).columns
        element = np.abs((np.cross(columns[..., 0], columns[..., 1]) * columns[..., 2]).sum(axis=-1))
        return self._weight(sheet) * size * element.reshape(-1, 3).mean(axis=1)

    def _areas(self, walls: Walls) -> Float[np.ndarray, " w"]:
        """What parts of walls add to areas, from the place in the middle of each part."""
        spots = self.look(walls.sheet, walls.ends.mean(axis=1))
        away = self.crowd.offset(spots.point[:, None], walls.pair)
        slope = np.einsum("pi,pij->pj", 2 * (away[:, 1] - away[:, 0]), spots.columns)
        along = np.einsum("pij,pj->pi", spots.columns[..., :2], walls.ends[:, 1] - walls.ends[:, 0])
        steep = np.maximum((slope[:, :2] ** 2).sum(axis=1), 1e-300)
        lean = -(slope[:, 2] / steep)[:, None] * slope[:, :2]  # the wall's way with the height
        upward = spots.columns[..., 2] + np.einsum("pij,pj->pi", spots.columns[..., :2], lean)
        return self._weight(walls.sheet) * np.linalg.norm(np.cross(along, upward), axis=1)

    def _weight(self, sheet: np.ndarray) -> np.ndarray:
        return self.weights[sheet // self.faces]


def measure_layers(
    positions: Float[np.ndarray, "n d"], domain: Domain, layers: int, across: int
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """The volumes of all cells, the pairs of cells with a wall, and the areas of these, from Gauss-Legendre layers."""
    cuts, n = LayerCuts(positions, domain, layers, across), len(positions)
    volume, keys, areas = np.zeros(n), [], []
    at_once = max(1, NODES // (cuts.faces * cuts.counts[0] * cuts.counts[1]))
    for first in range(0, layers, at_once):
        found, pairs, area = cuts.measure(np.arange(first, min(first + at_once, layers)))
        volume += found
        keys.append(pairs @ [n, 1])
        areas.append(area)
    key, row = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.zeros(len(key))
    np.add.at(total, row, np.concatenate(areas))
    return volume, np.stack(np.divmod(key, n), axis=1), total
