"""How much nearer one backbone is than another, on any domain, in 64 bits, and the points where cells meet.

Labels 0 .. n - 1 are cells, n .. n + 3 the limits of a rectangle: low u, low v, high u, high v. Rows of labels have
cells first. The gap of a label over the first one is d_j^2 - d_i^2, or the coordinate's way to the limit: where it is
0 two cells touch, or a cell touches an end. In periodic directions a cell is as far as the nearest of its copies.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.diagram.nearest import Crowd
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.nodes import ends_on
from jaxtissue.geometry.vectors import Vector, rows

CHUNK = 2048  # places looked at in one call: always as many, so that one program serves all
TURNS = 12  # most steps of Newton's method
CLOSE = 1e-13  # of the tissue's size: a step as short is the last
SAMPLES = 8  # points of a backbone that are searched, and one more
FOUND = 24  # of these that are looked at round a point


class Spots(NamedTuple):
    """Points of the tissue: on the base surface, in space, and their derivatives by both coordinates and the height."""

    place: Float[np.ndarray, "p d"]
    point: Float[np.ndarray, "p 3"]
    columns: Float[np.ndarray, "p 3 3"]  # the last axis: by y_1, y_2, h
    way: Float[np.ndarray, "p 2"]  # the local coordinates of another point

    def some(self, chosen: Any) -> "Spots":
        """Some of the points."""
        return Spots(*(part[chosen] for part in self))


class Lead(NamedTuple):
    """The gaps of labels over the first one of their row, [p, k], and their derivatives."""

    value: Float[np.ndarray, "p k"]
    slope: Float[np.ndarray, "p k 3"]  # by y_1, y_2, h
    pull: Float[np.ndarray, "p k 3"]  # by the point
    steep: Float[np.ndarray, "p k"]  # how fast it grows with the distance


@jax.jit
def _look(domain: Domain, m: Vector, y: Vector, h: jax.Array, other: Vector) -> tuple[jax.Array, ...]:
    frame = domain.frame(m, y, h)
    place, way = domain.base.chart(m, y), domain.base.difference(m, other)
    columns = jnp.stack([rows(frame.first), rows(frame.second), rows(frame.upward)], axis=-1)
    return rows(place), rows(frame.point), columns, rows(way)


class LayerGaps:
    """The gaps between the cells of one tissue."""

    def __init__(self, domain: Domain, positions: Float[np.ndarray, "n d"] | Float[np.ndarray, "n k d"]) -> None:
        with usual_modes(), double_precision():
            self.domain, self.count = in_doubles(domain), len(positions)
            self.base = base = self.domain.base
        self.extent = np.array([float(e) for e in base.extent]) if isinstance(base, Rectangle) else None
        self.is_free = np.asarray(base.is_end()[:2])
        self.apical = ends_on(positions, "apical", domain)  # where each backbone crosses the first layer
        self.crowd = crowd = Crowd(positions, self.domain)
        ends = np.concatenate([crowd.start[0, : self.count], (crowd.start + crowd.along)[-1, : self.count]])
        self.size = float(np.linalg.norm(np.ptp(ends, axis=0)))
        self.width = 0.5 * float(np.sqrt(float(domain.basal_area) / self.count))
        # the straight pieces of all copies of each cell, [copies, n, 3] for each piece
        self.start, self.along = (part.reshape(-1, self.count, 3) for part in (crowd.start, crowd.along))
        self.square = crowd.square.reshape(-1, self.count)

    def look(
        self,
        place: Float[np.ndarray, "p d"],
        away: Float[np.ndarray, "p 2"],
        height: Float[np.ndarray, " p"],
        other: Float[np.ndarray, "p d"] | None = None,
    ) -> Spots:
        """The points at local coordinates round places, on layers, and the way from the places to others."""
        other, found = place if other is None else other, []
        with usual_modes(), double_precision():
            for first in range(0, len(height), CHUNK):
                some = [part[first : first + CHUNK] for part in (place, away, height, other)]
                lacks = CHUNK - len(some[2])
                full = [np.concatenate([part, np.repeat(part[-1:], lacks, axis=0)]) if lacks else part for part in some]
                m, y, h, o = (tuple(part.T) if part.ndim > 1 else part for part in full)
                seen = _look(self.domain, m, y, h, o)
                found.append([np.asarray(part)[: CHUNK - lacks] for part in seen])
        if not found:
            return Spots(place, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 2)))
        return Spots(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def offset(self, point: Float[np.ndarray, "... 3"], cell: Int[np.ndarray, "..."]) -> Float[np.ndarray, "... 3"]:
        """From the nearest point of each cell's backbone, or of the nearest of its copies, to a point."""
        best = least = None
        for start, along, square in zip(self.start, self.along, self.square, strict=True):
            way, ahead = point - start[cell], along[cell]
            share = np.clip(np.einsum("...i,...i", way, ahead) / square[cell], 0, 1)
            way -= share[..., None] * ahead
            apart = np.einsum("...i,...i", way, way)
            if best is None or least is None:
                best, least = way, apart
            else:
                nearer = apart < least
                best, least = np.where(nearer[..., None], way, best), np.where(nearer, apart, least)
        assert best is not None
        return best

    def lead(self, spots: Spots, labels: Int[np.ndarray, "p k"]) -> Lead:
        """The gaps of all labels but the first over the first."""
        away = self.offset(spots.point[:, None], np.minimum(labels, self.count - 1))
        apart = away[:, 1:] - away[:, :1]
        value = np.einsum("pki,pki->pk", apart, away[:, 1:] + away[:, :1])
        pull = 2 * apart
        slope = pull @ spots.columns
        steep = np.sqrt(np.einsum("pki,pki->pk", pull, pull))
        row, column = np.nonzero(labels[:, 1:] >= self.count)
        if len(row):
            limit = labels[row, column + 1] - self.count
            way, high = limit % 2, limit >= 2
            at = spots.place[row, way]
            value[row, column] = np.where(high, self._extent(way) - at, at)
            slope[row, column] = 0
            slope[row, column, way] = np.where(high, -1, 1)
            steep[row, column] = 1 / np.linalg.norm(spots.columns[row, :, way], axis=1)
        return Lead(value, slope, pull, steep)

    def _extent(self, way: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        assert self.extent is not None
        return self.extent[way]

    def meet(
        self,
        labels: Int[np.ndarray, "p k"],
        place: Float[np.ndarray, "p d"],
        height: Float[np.ndarray, " p"],
        away: Float[np.ndarray, "p 2"] | None = None,
    ) -> tuple[Spots, Float[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
        """The points where three labels meet on given layers, or four on layers that are sought, by Newton's method.

        Returns the points, their heights, and whether the last step was a short one.
        """
        count = labels.shape[1] - 1
        height, done = height.copy(), np.zeros(len(height), bool)
        spots = self.look(place, np.zeros((len(height), 2)) if away is None else away, height)
        spots = Spots(*(part.copy() for part in spots))
        open_ = np.arange(len(height))
        for _ in range(TURNS):
            here = spots.some(open_)
            lead = self.lead(here, labels[open_])
            step = solve(lead.slope[..., :count], -lead.value)
            length = np.linalg.norm(np.einsum("pij,pj->pi", here.columns[..., :count], step), axis=1)
            step *= np.minimum(1, self.width / np.maximum(length, 1e-300))[:, None]
            lost = ~np.isfinite(step).all(axis=1)
            step[lost] = 0
            if count == 3:
                step[:, 2] = np.clip(step[:, 2], -0.25, 0.25)
                height[open_] = np.clip(height[open_] + step[:, 2], -0.5, 1.5)
            moved = self.look(here.place, step[:, :2], height[open_])
            for part, new in zip(spots, moved, strict=True):
                part[open_] = new
            done[open_] = (length < CLOSE * self.size) & ~lost
            open_ = open_[~done[open_] & ~lost]
            if not len(open_):
                break
        return spots._replace(place=self.wrapped(spots.place)), height, done

    def wrapped(self, place: Float[np.ndarray, "p d"]) -> Float[np.ndarray, "p d"]:
        """The places, in closed and periodic directions within the rectangle."""
        if self.extent is None:
            return place
        return np.where(self.is_free, place, np.mod(place, self.extent))

    def drift(self, lead: Lead) -> Float[np.ndarray, "p 2"]:
        """How the points where three labels meet, with the gaps of the first two others, move with the height."""
        return solve(lead.slope[:, :2, :2], -lead.slope[:, :2, 2])

    def nearby(self, point: Float[np.ndarray, "p 3"], count: int) -> Int[np.ndarray, "p k"]:
        """The backbones, copies included, of the samples of backbones that are nearest to points."""
        share = np.linspace(0, 1, 1 + max(2, SAMPLES // len(self.crowd.start)))[:, None]
        tree = KDTree((self.start[:, :, None] + share * self.along[:, :, None]).reshape(-1, 3))
        found = tree.query(point, min(count, tree.n))[1].reshape(len(point), -1)
        return found // len(share) % self.crowd.start.shape[1]

    def ahead_of(
        self, point: Float[np.ndarray, "p 3"], labels: Int[np.ndarray, "p k"]
    ) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """How much farther than a row's first label the nearest backbone is that is not in the row, and which it is."""
        found = self.nearby(point, FOUND) % self.count
        others = np.linalg.norm(self.offset(point[:, None], found), axis=-1)
        others[(found[:, :, None] == labels[:, None]).any(axis=-1)] = np.inf
        own = np.linalg.norm(self.offset(point, labels[:, 0]), axis=-1)
        nearest = others.argmin(axis=1)
        rows_of = np.arange(len(point))
        return others[rows_of, nearest] - own, found[rows_of, nearest]


def solve(matrix: Float[np.ndarray, "p k k"], right: Float[np.ndarray, "p k"]) -> Float[np.ndarray, "p k"]:
    """Solutions of systems of two or three equations by cofactors; not finite where there is none."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if matrix.shape[1] == 2:
            (a, b), (c, d) = np.moveaxis(matrix, 0, -1)
            x, y = right.T
            return np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
        one, two, three = np.moveaxis(matrix, 1, 0)
        dual = np.stack([np.cross(two, three), np.cross(three, one), np.cross(one, two)], axis=1)
        volume = (one * dual[:, 0]).sum(axis=1)
        return np.einsum("pi,pij->pj", right, dual) / volume[:, None]
