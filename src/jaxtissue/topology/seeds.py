"""Seeds, the points where edges begin to be followed, so that every part of the diagram is reached.

On either surface each backbone's end, moved along x, meets a wall or an end of the tube. That reaches all edges there:
each line along x meets a cell once, so a cell's patch of a surface has no hole, and one that goes round the lumen holds
its own backbone; the circles at the ends are edges too. The end planes hold no other edges: d_j^2 - d_a^2 there has no
extremum. Within the tissue an edge is joined to none of these edges only round a *lens*, the part of a cell across the
lumen that lies within the wall of two other cells.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from jaxtissue.system.cores import in_threads, usable_threads
from jaxtissue.topology.bisectors import TOUCH, Bisectors

SIDES = (-1, 1)  # along the axis
RAYS = 8  # from the middle of a lens, on which its edge is sought


class Seeds(NamedTuple):
    """Points on edges, and their labels."""

    point: Float[np.ndarray, "m 3"]
    labels: Int[np.ndarray, "m 3"]


def seed(bisectors: Bisectors) -> Seeds:
    """The points where each backbone's end, moved along x on either surface, meets a wall or an end."""
    n, seeds = bisectors.count, []
    own, surface = np.tile(bisectors.order, 2), np.repeat([0, 1], n)
    radius = np.array([bisectors.inner, bisectors.outer])[surface]
    place = np.stack([bisectors.axial[own], radius * bisectors.cosine[own], radius * bisectors.sine[own]], axis=1)
    firsts = in_threads(lambda side: first_wall(place, own, side, bisectors), SIDES)
    for side, (away, other) in zip(SIDES, firsts, strict=True):
        point = place.copy()
        point[:, 0] = np.clip(place[:, 0] + side * away, 0, bisectors.length)
        met = (point[:, 0] > 0) & (point[:, 0] < bisectors.length)
        walls = np.stack([*np.sort([own, other], axis=0), n + surface], axis=1)
        rims = np.stack([own, n + surface, np.full(2 * n, n + 2 + (side > 0))], axis=1)
        seeds.append((point, np.where(met[:, None], walls, rims)))
    return Seeds(*(np.concatenate(part) for part in zip(*seeds, strict=True)))


def first_wall(
    place: Float[np.ndarray, "m 3"], own: Int[np.ndarray, " m"], side: int, bisectors: Bisectors
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """The distance along x, on one side of points on their own backbones, to the first wall, and its other cell.

    A wall lies more than half-way to its backbone: backbones are looked through by axial position until it is so.
    """
    rank = np.empty(bisectors.count, int)
    rank[bisectors.order] = np.arange(bisectors.count)
    away, other = np.full(len(own), np.inf), own.copy()
    open_, done, count = np.arange(len(own)), 0, 16
    while len(open_):
        ahead = rank[own[open_], None] + side * (done + 1 + np.arange(count))
        rival = bisectors.order[np.clip(ahead, 0, bisectors.count - 1)]
        lead, slope = bisectors.over_first(place[open_], np.append(own[open_, None], rival, axis=1))
        toward = side * slope[0]
        walls = np.where(toward > 0, -lead / np.where(toward > 0, toward, 1), np.inf)
        best = walls.argmin(axis=1)[:, None]
        wall, rival = (np.take_along_axis(table, best, axis=1)[:, 0] for table in (walls, rival))
        nearer = wall < away[open_]
        away[open_[nearer]], other[open_[nearer]] = wall[nearer], rival[nearer]
        inside = (ahead[:, -1] >= 0) & (ahead[:, -1] < bisectors.count)
        done, count = done + count, 2 * count
        open_ = open_[inside & (toward[:, -1] / 4 < away[open_])]
    return away, other


def seed_lenses(
    pairs: Int[np.ndarray, "w 2"],
    center: Float[np.ndarray, "w 3"],
    reach: Float[np.ndarray, " w"],
    bisectors: Bisectors,
) -> Seeds:
    """Points on the edges of lenses within the walls of pairs of cells.

    The balls hold the walls and every backbone that comes as near to them as their own cells. On the wall of a and b,
    d_c^2 - d_a^2 = f_c - (1 - k) f_a - k f_b + const with k = (x_c - x_a) / (x_b - x_a) and d_j^2 = (x - x_j)^2 + f_j.
    A minimum has 0 < k < 1, the foot of c at its apical end and the feet of a and b above theirs; there half the second
    derivative is (1 - k) u_a u_a^T + k u_b u_b^T, with u_j the directions of the backbones.
    """
    way = np.stack([bisectors.cosine, bisectors.sine], axis=1)
    tips = np.concatenate([bisectors.axial[:, None], bisectors.inner * way], axis=1)[: bisectors.count]
    found = KDTree(tips).query_ball_point(center, reach, workers=usable_threads())
    wall, cell = np.repeat(np.arange(len(pairs)), [len(some) for some in found]), np.concatenate([[], *found])
    cell = cell.astype(int)
    gap = bisectors.axial[pairs[wall, 1]] - bisectors.axial[pairs[wall, 0]]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (bisectors.axial[cell] - bisectors.axial[pairs[wall, 0]]) / gap
    between = (share > 0) & (share < 1)
    share, triple = share[between], np.append(pairs[wall[between]], cell[between, None], axis=1)
    one, two, three = (way[triple[:, place]] for place in range(3))
    half = (1 - share)[:, None, None] * one[:, :, None] * one[:, None]
    half = half + share[:, None, None] * two[:, :, None] * two[:, None]
    flat = np.linalg.det(half) < 1e-9
    half[flat] = np.eye(2)
    across = np.linalg.solve(half, bisectors.inner * three[..., None])[..., 0]
    point = np.append(np.zeros((len(across), 1)), across, axis=1)
    lead, slope = bisectors.over_first(point, triple)
    with np.errstate(divide="ignore", invalid="ignore"):
        point[:, 0] = -lead[:, 0] / slope[0, :, 0]
    depth = bisectors.over_first(point, triple)[0][:, 1]
    radius = np.hypot(*across.T)
    lens = ~flat & (depth > 0) & (radius > bisectors.inner) & (radius < bisectors.outer)
    lens &= (point[:, 0] > 0) & (point[:, 0] < bisectors.length)
    for direction, clamped in ((one, False), (two, False), (three, True)):
        lens &= ((across * direction).sum(axis=1) < bisectors.inner) == clamped
    return _rays(point[lens], triple[lens], half[lens], depth[lens], bisectors)


def _rays(point: np.ndarray, triple: np.ndarray, half: np.ndarray, depth: np.ndarray, bisectors: Bisectors) -> Seeds:
    """The points where rays from the middle of lenses meet their edges, if no other backbone is nearer there."""
    turn = 2 * np.pi * np.arange(RAYS) / RAYS
    ray = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    far = np.sqrt(depth[:, None] / np.einsum("ri,mij,rj->mr", ray, half, ray))
    place = np.repeat(point[:, None], RAYS, axis=1)
    place[..., 1:] += far[..., None] * ray
    place, triple = place.reshape(-1, 3), np.repeat(triple, RAYS, axis=0)
    lead, slope = bisectors.over_first(place, triple)
    place[:, 0] -= lead[:, 0] / slope[0, :, 0]
    labels = np.sort(triple, axis=1)
    place, met = bisectors.solve(place, labels, np.full(len(place), TOUCH * bisectors.size))
    place, labels = place[met], labels[met]
    own = bisectors.nearest_competitor(place, labels)[1] <= TOUCH * bisectors.size
    return Seeds(place[own], labels[own])
