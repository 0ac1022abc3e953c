"""The backbones of a tissue with their copies beyond periodic directions, and the candidates of each cell."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import Vector, subtract
from jaxtissue.sections.views import Segments

NEAREST = 16  # on each of three layers
SAMPLES = 9  # points of a backbone that are searched
FOUND = 10, 160  # of these that are looked at round a corner, first, and where so few are not enough
ROUNDING = 1e-4  # of its distance, by which a corner may be nearer to a candidate that is not listed
ROUND_UP = 8  # lists have multiples of so many candidates, so that fewer programs are compiled


class Crowd(NamedTuple):
    """All backbones and their copies, [e]; number e is a copy of backbone e mod n, and the first n are themselves."""

    segments: Segments
    cells: int  # n


def gather_crowd(domain: Domain, place: Vector) -> Crowd:
    """The backbones of all cells, and their copies."""
    copies = domain.base.images()
    if isinstance(domain.base, Rectangle) and len(copies) > 1:
        shifts = [copies[:, k, None] * jnp.asarray(extent) for k, extent in enumerate(domain.base.extent)]
        place = tuple((part[None] + shift).ravel() for part, shift in zip(place, shifts, strict=True))
    apical, basal = domain.surfaces(place)
    return Crowd(Segments(apical, subtract(basal, apical)), place[0].shape[0] // len(copies))


def first_lists(crowd: Crowd) -> Int[np.ndarray, "q n"]:
    """The nearest backbones of each cell on three layers, -1 where there are fewer than others have."""
    start, along = (np.stack([np.asarray(part, float) for part in vector], axis=1) for vector in crowd.segments)
    n, found = crowd.cells, []
    count = min(NEAREST + 1, len(start))
    for h in (0.0, 0.5, 1.0):
        points = start + h * along
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
    start, along = (np.stack([np.asarray(part, float) for part in vector], axis=1) for vector in crowd.segments)
    share = np.linspace(0, 1, SAMPLES)
    tree = KDTree((start[:, None] + share[:, None] * along[:, None]).reshape(-1, 3))
    half = 0.5 * np.linalg.norm(along, axis=1).max() / (SAMPLES - 1)
    pairs, left = [np.zeros((0, 2), int)], np.arange(len(points))
    for count in (min(count, tree.n) for count in FOUND):
        near, found = (part.reshape(len(left), count) for part in tree.query(points[left], count))
        owner, cell = found // SAMPLES, cells[left]
        own = (1 - ROUNDING) * _distance(start[cell], along[cell], points[left])
        others = _distance(start[owner], along[owner], points[left, None])
        listed = (lists.T[cell][:, None] == owner[..., None]).any(axis=-1) | (owner == cell[:, None])
        lacks = ~listed & (others < own[:, None])
        row, column = np.nonzero(lacks)
        pairs.append(np.stack([cell[row], owner[row, column]], axis=1))
        unseen = np.sqrt(np.maximum(near[:, -1] ** 2 - half**2, 0))
        left = left[(unseen < own) & ~lacks.any(axis=1) & (count < tree.n)]
    return np.unique(np.concatenate(pairs), axis=0), len(left)


def extended(lists: Int[np.ndarray, "q n"], pairs: Int[np.ndarray, "m 2"]) -> Int[np.ndarray, "q n"]:
    """The lists with further candidates."""
    n = lists.shape[1]
    cell, other = pairs[np.argsort(pairs[:, 0], kind="stable")].T
    slot = np.arange(len(cell)) - np.searchsorted(cell, cell)
    more = np.full((n, slot.max(initial=-1) + 1), -1)
    more[cell, slot] = other
    return _as_lists(np.concatenate([lists.T, more], axis=1), n)


def _distance(start: np.ndarray, along: np.ndarray, point: np.ndarray) -> np.ndarray:
    share = ((point - start) * along).sum(axis=-1) / (along**2).sum(axis=-1)
    return np.linalg.norm(point - start - np.clip(share, 0, 1)[..., None] * along, axis=-1)


def as_array(lists: Int[np.ndarray, "q n"]) -> Int[Array, "q n"]:
    """The lists as programs take them."""
    return jnp.asarray(lists, jnp.int32)
