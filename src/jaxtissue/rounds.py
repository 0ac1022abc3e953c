"""The rounds of a sweep: cells that move together, one by one or in independent sets (paper, section 3.3)."""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from jaxtissue.changes import Neighborhoods, room
from jaxtissue.coloring import color, distance_conflicts, hop_conflicts
from jaxtissue.energy import Model
from jaxtissue.metropolis import Order, move_bound
from jaxtissue.spread import covering_radius

ROUNDS = 32  # sets that the cells are spread over at least: coloring takes 36 to 45
MEAN_MOVE = 2 / 3  # of a move uniform in a disc, in its radius
CAPACITY = 64  # rounds are padded to a multiple of it


def one_by_one(seed: int, sweep: int, cells: int) -> Int[np.ndarray, "cells 1"]:
    """One move a round, in a random order of the sweep's own."""
    return np.random.default_rng([seed, sweep]).permutation(cells).astype(np.int32)[:, None]


def independent_rounds(
    rule: str,
    positions: Float[np.ndarray, "n 2"],
    model: Model,
    contacts: Callable[[float], sparse.csr_array],
) -> Int[np.ndarray, "rounds width"]:
    """Rounds of moves without conflict by a rule of `CONFLICTS`, padded with -1.

    `contacts(within)` gives who touches whom, or could if one of them were moved by at most `within`.
    """
    n = len(positions)
    if rule == "8-phi":
        place = jnp.asarray(positions)
        apical = np.asarray(model.tube.embed(place).apical)
        graph = distance_conflicts(apical, 8 * float(covering_radius(place, model.tube)))
    elif rule == "near":
        graph = hop_conflicts(contacts(float(MEAN_MOVE * move_bound(model, n))), 2)
    else:
        graph = hop_conflicts(contacts(0.0), int(rule[0]))
    return color(graph, round_width(n), np.argsort(positions[:, 0], kind="stable"))


def round_width(cells: int) -> int:
    """The most moves of a round."""
    return max(1, round(cells / ROUNDS))


def padded_orders(plan: Sequence[Int[np.ndarray, "rounds width"]], sweeps: int, near: Neighborhoods) -> Order:
    """The rounds of some sweeps, padded with sweeps of none: an `Order` of leaves [sweeps, ...]."""
    capacity, width = -(-max(map(len, plan)) // CAPACITY) * CAPACITY, plan[0].shape[1]
    rounds = np.full((sweeps, capacity, width), -1, np.int32)
    for k, some in enumerate(plan):
        rounds[k, : len(some)] = some
    counts = np.array([*map(len, plan), *sweeps * [0]], np.int32)[:sweeps]
    return Order(rounds, counts, np.full(sweeps, room(width, near), np.int32))
