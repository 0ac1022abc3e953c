"""The backbones of a tissue with their copies beyond periodic directions, and the candidates of each cell."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import Nodes, node_points, with_copies
from jaxtissue.geometry.vectors import Vector, subtract
from jaxtissue.sections.views import Backbones, Segments, through

NEAREST = 16  # at each of three points of a backbone, of bent ones at each of up to six
SPACES = 4, 64  # between points of a backbone that are searched, at least and at most; more on slender cells
AROUND = 64  # of these that are looked at round one of a backbone
FOUND = 10, 160  # of these that are looked at round a corner, first, and where so few are not enough
ROUNDING = 1e-4  # of its distance, by which a corner may be nearer to a candidate that is not listed
CHUNK = 8192  # points that are looked at together
WIDE = 48  # candidates that complete lists have room for at least, where there are as many
STEP = 16  # these are padded to multiples of so many
TURN = 0.7  # the cosine of the angle by which a wall may turn on an eighth of the way from end to end
ROUND_UP = 8  # lists have multiples of so many candidates, so that fewer programs are compiled


class Crowd(NamedTuple):
    """All backbones and their copies, [e]; number e is a copy of backbone e mod n, and the first n are themselves."""

    segments: Backbones
    cells: int  # n

    def points(self, count: int) -> tuple[Float[np.ndarray, "count e 3"], Float[np.ndarray, "count e"]]:
        """So many points of each backbone, from end to end, and how long it is up to there."""
        start, along = self.pieces()
        length = np.linalg.norm(along, axis=-1)
        before = np.concatenate([np.zeros_like(length[:1]), np.cumsum(length, axis=0)])
        place = np.linspace(0, len(start), count)
        piece = np.minimum(place.astype(int), len(start) - 1)
        share = (place - piece)[:, None]
        return start[piece] + share[..., None] * along[piece], before[piece] + share * length[piece]

    def pieces(self) -> tuple[Float[np.ndarray, "pieces e 3"], Float[np.ndarray, "pieces e 3"]]:
        """Where the straight pieces of each backbone start, and where they go to from there, in 64 bits."""
        start, along = (np.stack([np.asarray(part, float) for part in vector], axis=-1) for vector in self.segments)
        return (start[None], along[None]) if start.ndim == 2 else (start.swapaxes(0, 1), along.swapaxes(0, 1))


def gather_crowd(domain: Domain, place: Vector) -> Crowd:
    """The backbones of all cells, and their copies."""
    copies = domain.base.images()
    if isinstance(domain.base, Rectangle) and len(copies) > 1:
        shifts = [copies[:, k, None] * jnp.asarray(extent) for k, extent in enumerate(domain.base.extent)]
        place = tuple((part[None] + shift).ravel() for part, shift in zip(place, shifts, strict=True))
    apical, basal = domain.surfaces(place)
    return Crowd(Segments(apical, subtract(basal, apical)), place[0].shape[0] // len(copies))


def gather_bent(domain: Domain, nodes: Nodes) -> Crowd:
    """The tilted or bent backbones of all cells, and their copies."""
    return Crowd(through(node_points(with_copies(nodes, domain), domain)), len(nodes.height))


def first_lists(crowd: Crowd, nearest: int = NEAREST) -> Int[np.ndarray, "q n"]:
    """So many nearest backbones of each cell on a few layers, -1 where there are fewer than others have."""
    n, found = crowd.cells, []
    layers = crowd.points(min(len(crowd.pieces()[0]) + 2, 6))[0]
    count = min(nearest + 1, layers.shape[1])
    for points in layers:
        found.append(KDTree(points).query(points[:n], count)[1].reshape(n, count))
    return _as_lists(np.concatenate(found, axis=1), n)


def _as_lists(found: Int[np.ndarray, "n k"], n: int) -> Int[np.ndarray, "q n"]:
    """Lists without the cell itself, without repetitions and without gaps, in order of numbers."""
    listed = np.sort(np.where(found == np.arange(n)[:, None], -1, found), axis=1)
    listed[:, 1:][listed[:, 1:] == listed[:, :-1]] = -1
    listed = -np.sort(-listed, axis=1)
    length = max(1, int((listed >= 0).sum(axis=1).max()))
    length = -(-length // ROUND_UP) * ROUND_UP
    wide = np.full((n, length), -1)
    wide[:, : min(length, listed.shape[1])] = listed[:, :length]
    return wide.T


def missing(
    crowd: Crowd, lists: Int[np.ndarray, "q n"], points: Float[np.ndarray, "p 3"], cells: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, "m 2"], int]:
    """Pairs of a cell and a backbone that its list lacks though it is nearer to a point of the cell's rim.

    Where a cell's section is measured without one of its neighbors, that neighbor is nearer to one of its corners: so
    lists are complete where none is missing. Also returns at how many points this could not be made sure, since more
    backbones are near than were looked at.
    """
    if not len(points):
        return np.zeros((0, 2), int), 0
    start, along = crowd.pieces()
    own = (1 - ROUNDING) * distances(start[:, cells], along[:, cells], points)
    slender = np.linalg.norm(along, axis=-1).sum(axis=0).max() / max(np.median(own), 1e-30)
    each = 1 + len(start) * math.ceil(np.clip(slender / 4, *SPACES) / len(start))  # bends are among them
    samples, length = crowd.points(each)
    tree = KDTree(samples.swapaxes(0, 1).reshape(-1, 3), balanced_tree=False, compact_nodes=False)  # quicker by 1/3
    far = np.hypot(own, 0.5 * np.diff(length, axis=0).max())  # where no sample of a backbone is nearer, it is no nearer
    pairs, left = [np.zeros((0, 2), int)], np.flatnonzero(_unlisted(tree, each, lists, points, cells) < far)
    for count in (min(count, tree.n) for count in FOUND):
        near, found = (part.reshape(len(left), count) for part in tree.query(points[left], count))
        owner, cell = found // each, cells[left]
        others = distances(start[:, owner], along[:, owner], points[left, None])
        row, column = np.nonzero((others < own[left, None]) & (owner != cell[:, None]))
        listed = (lists.T[cell[row]] == owner[row, column, None]).any(axis=-1)
        lacks = np.zeros(owner.shape, bool)
        lacks[row, column] = ~listed
        pairs.append(np.stack([cell[row], owner[row, column]], axis=1)[~listed])
        left = left[(near[:, -1] < far[left]) & ~lacks.any(axis=1) & (count < tree.n)]
    return np.unique(np.concatenate(pairs), axis=0), len(left)


def _unlisted(
    tree: KDTree,
    each: int,
    lists: Int[np.ndarray, "q n"],
    points: Float[np.ndarray, "p 3"],
    cells: Int[np.ndarray, " p"],
) -> Float[np.ndarray, " p"]:
    """How near to each point samples of unlisted backbones can be, by those round its own backbone."""
    samples = tree.data.reshape(-1, each, 3)
    away = np.linalg.norm(points[:, None] - samples[cells], axis=-1)
    nearest = away.argmin(axis=1)
    looked, back = np.unique(cells * each + nearest, return_inverse=True)
    distance, found = tree.query(tree.data[looked], min(AROUND, tree.n))
    owner, cell = found // each, looked // each
    is_listed = owner == cell[:, None]
    for row in lists:
        is_listed |= owner == row[cell, None]
    return np.where(is_listed, distance[:, -1:], distance).min(axis=1)[back] - away.min(axis=1)


def overlaps(
    crowd: Crowd, lists: Int[np.ndarray, "q n"], points: Float[np.ndarray, "p 3"], cells: Int[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """How much nearer points of a cell's rim are to one of its candidates than to its own backbone, or 0.

    It is 0 to rounding where corners and middles of edges lie on walls of the cell.
    """
    start, along = crowd.pieces()
    nearer = np.zeros(len(points))
    for first in range(0, len(points), CHUNK):
        point, cell = points[first : first + CHUNK], cells[first : first + CHUNK]
        listed = lists.T[cell]
        others = np.where(listed >= 0, distances(start[:, listed], along[:, listed], point[:, None]), np.inf).min(
            axis=1
        )
        nearer[first : first + CHUNK] = distances(start[:, cell], along[:, cell], point) - others
    return np.maximum(nearer, 0)


def turning_cells(crowd: Crowd, cell: Int[np.ndarray, " w"], rival: Int[np.ndarray, " w"]) -> Int[np.ndarray, " m"]:
    """The cells with a wall that turns too quickly to be measured, since two backbones nearly cross there."""
    points = crowd.points(9)[0]
    apart = points[:, rival] - points[:, cell]
    apart /= np.maximum(np.linalg.norm(apart, axis=-1, keepdims=True), 1e-300)
    return np.unique(cell[((apart[1:] * apart[:-1]).sum(axis=-1) < TURN).any(axis=0)])


def tell_of_turning(cells: Int[np.ndarray, " m"]) -> str:
    """What is said of them."""
    some = ", ".join(map(str, cells[:8].tolist()))
    told = f"the backbones of {len(cells)} cells nearly cross a neighbor's: cells {some}"
    return f"{told}; their sizes and energies may be wrong by much: tilt them less"


def extended(lists: Int[np.ndarray, "q n"], pairs: Int[np.ndarray, "m 2"]) -> Int[np.ndarray, "q n"]:
    """The lists with further candidates."""
    n = lists.shape[1]
    cell, other = pairs[np.argsort(pairs[:, 0], kind="stable")].T
    slot = np.arange(len(cell)) - np.searchsorted(cell, cell)
    more = np.full((n, slot.max(initial=-1) + 1), -1)
    more[cell, slot] = other
    return _as_lists(np.concatenate([lists.T, more], axis=1), n)


def padded(lists: Int[np.ndarray, "q n"], domain: Domain) -> Int[np.ndarray, "q n"]:
    """The lists with room for many candidates, where there are as many backbones: so few programs serve all lists."""
    most = lists.shape[1] * len(domain.base.images()) - 1
    width = -(-max(len(lists), min(WIDE, most)) // STEP) * STEP
    return np.pad(lists, ((0, width - len(lists)), (0, 0)), constant_values=-1)


def distances(starts: np.ndarray, ways: np.ndarray, point: np.ndarray) -> np.ndarray:
    """From points to the nearest of some pieces, [pieces, ...]."""
    found = np.inf
    for start, along in zip(starts, ways, strict=True):
        way = point - start
        share = np.einsum("...k,...k", way, along) / np.einsum("...k,...k", along, along)
        way -= np.clip(share, 0, 1)[..., None] * along
        found = np.minimum(found, np.einsum("...k,...k", way, way))
    return np.sqrt(found)


def as_array(lists: Int[np.ndarray, "q n"]) -> Int[Array, "q n"]:
    """The lists as programs take them."""
    return jnp.asarray(lists, jnp.int32)
