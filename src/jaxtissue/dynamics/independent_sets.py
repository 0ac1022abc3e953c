"""The rounds of a sweep: cells that move together, one by one or in independent sets (paper, section 3.3)."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from jaxtissue.diagram.spread import covering_radius
from jaxtissue.dynamics.coloring import color, distance_conflicts, hop_conflicts
from jaxtissue.dynamics.local_updates import HasAround, update_capacity
from jaxtissue.dynamics.metropolis import Order, move_bound
from jaxtissue.energy import Model
from jaxtissue.geometry.nodes import ends_on

ROUNDS = 32  # sets that the cells are spread over at least: coloring takes 36 to 45
MEAN_MOVE = 2 / 3  # of a move uniform in a disc, in its radius
FIT = 128  # moves made together on a CPU, if there are many: what they are about fits the cache
PIECES = 16  # of a round at most, since each takes a look at all cells
CAPACITY = 64  # rounds are padded to a multiple of it


def one_by_one(seed: int, sweep: int, cells: int) -> Int[np.ndarray, "cells 1"]:
    """One move a round, in a random order that differs from sweep to sweep."""
    return np.random.default_rng([seed, sweep]).permutation(cells).astype(np.int32)[:, None]


def independent_rounds(
    rule: str,
    positions: Float[np.ndarray, "n *k d"],
    model: Model,
    contacts: Callable[[float], sparse.csr_array],
) -> Int[np.ndarray, "rounds width"]:
    """Rounds of moves without conflict by a rule of `CONFLICTS`, padded with -1.

    `contacts(within)` gives the pairs of cells that touch, or could if one of them moved by at most `within`. On a CPU
    rounds of many moves are cut along the tube, and all are played in one stretch of it before the next.
    """
    n, along = len(positions), ends_on(positions, "apical", model.domain)[:, 0]
    if rule == "8-phi":
        place = jnp.asarray(positions)
        apical = np.asarray(model.tube.embed(place).apical)
        graph = distance_conflicts(apical, 8 * float(covering_radius(place, model.tube)))
    elif rule == "near":
        graph = hop_conflicts(contacts(float(MEAN_MOVE * move_bound(model, n))), 2)
    else:
        graph = hop_conflicts(contacts(0.0), int(rule[0]))
    rounds = color(graph, _uncut_width(n), np.argsort(along, kind="stable"))
    return cut(rounds, along, _pieces(n))


def round_width(cells: int) -> int:
    """The most moves of a round."""
    return -(-_uncut_width(cells) // _pieces(cells))


def _uncut_width(cells: int) -> int:
    return max(1, round(cells / ROUNDS))


def _pieces(cells: int) -> int:
    if jax.default_backend() != "cpu":
        return 1
    return min(max(1, _uncut_width(cells) // FIT), PIECES)


def cut(
    rounds: Int[np.ndarray, "rounds width"], axial: Float[np.ndarray, "n"], pieces: int
) -> Int[np.ndarray, "more less"]:
    """Every round cut into so many pieces along the axis; first the first piece of each, then the second.

    >>> cut(np.array([[0, 2, 3, -1], [1, 4, 5, 6]]), np.arange(7), 2).tolist()
    [[0, 2], [1, 4], [3, -1], [5, 6]]
    """
    if pieces == 1:
        return rounds
    rows = (row[row >= 0] for row in rounds)
    along = (row[np.argsort(axial[row], kind="stable")] for row in rows)
    parts = zip(*(np.array_split(row, pieces) for row in along), strict=True)
    found = [part for stretch in parts for part in stretch if len(part)]
    few = np.full((len(found), -(-rounds.shape[1] // pieces)), -1, np.int32)
    for row, part in zip(few, found, strict=True):
        row[: len(part)] = part
    return few


def padded_orders(plan: Sequence[Int[np.ndarray, "rounds width"]], sweeps: int, near: HasAround) -> Order:
    """The rounds of one or more sweeps, padded with empty sweeps: an `Order` of leaves [sweeps, ...]."""
    capacity, width = -(-max(map(len, plan)) // CAPACITY) * CAPACITY, plan[0].shape[1]
    rounds = np.full((sweeps, capacity, width), -1, np.int32)
    for k, some in enumerate(plan):
        rounds[k, : len(some)] = some
    counts = np.array([*map(len, plan), *sweeps * [0]], np.int32)[:sweeps]
    return Order(rounds, counts, np.full(sweeps, update_capacity(width, near), np.int32))
