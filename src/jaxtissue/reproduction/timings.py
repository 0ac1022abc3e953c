"""Table 1: seconds per sweep of both algorithms, and rounds under each rule of move independence."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import sparse

from jaxtissue.anneal import SPAN
from jaxtissue.coloring import CONFLICTS, color, distance_conflicts, hop_conflicts
from jaxtissue.contacts import find_contacts
from jaxtissue.reproduction.experiments import BASAL_RADIUS, Plan, Store, Table, tabulate
from jaxtissue.reproduction.tissues import Annealing
from jaxtissue.spread import covering_radius
from jaxtissue.tube import Tube

WARM_UP = SPAN  # sweeps before the timed ones: in the first 8 lists are renewed after each


def measure_table(plan: Plan, store: Store) -> Table:
    """A row for each R_a and n: seconds of a sweep, warm, by both algorithms, and rounds.

    Seconds are the median over spans of 5 whole sweeps, with what is renewed between them but no compilation.
    So it is for MH too, n moves one by one: nothing is scaled. `rounds` are those
    played; `rounds_2_hop` and so on are the sets that greedy coloring alone gives under each rule, on the
    tissue after the timed sweeps, and `random_..._hop` on the random tissue before.
    """
    rows = []
    for radius in (1.0, 5.0):
        for cells in plan.table_cells:
            name = f"table1_radius{radius:g}_cells{cells}"
            rows.append(store.row(name, lambda at=(radius, cells): _time(plan, store, *at)))
    return tabulate(rows)


def _time(plan: Plan, store: Store, radius: float, cells: int) -> dict[str, Any]:
    tube = Tube(100.0, radius, BASAL_RADIUS)
    row: dict[str, Any] = {"apical_radius": radius, "cells": cells}
    for algorithm, name in (("mh", "mh"), ("is-mh", "is_mh")):
        annealing = Annealing(tube, cells, WARM_UP + plan.timed_sweeps, algorithm)
        run = store.histories(annealing, [0])[0]
        row[f"{name}_seconds"] = float(np.median(run.records["seconds"][1 + WARM_UP :]))
    row["rounds"] = float(np.median(run.records["rounds"][1 + WARM_UP :]))
    row["collisions"] = float(np.mean(run.records["collisions"][1 + WARM_UP :]))
    for prefix, place in (("", run.positions[-1]), ("random_", run.positions[0])):
        rounds = count_rounds(place, tube)
        row |= {f"{prefix}rounds_{rule.replace('-', '_')}": count for rule, count in rounds.items()}
    return row


def count_rounds(positions: Float[np.ndarray, "n 2"], tube: Tube) -> dict[str, int]:
    """How many sets of independent moves greedy coloring finds under each of the paper's kinds of rule.

    >>> count_rounds(np.array([[2.0, 0.0], [5.0, 0.0], [8.0, 0.0]]), Tube(10, 1, 3))
    {'2-hop': 3, '3-hop': 3, '4-hop': 3, '8-phi': 3}
    """
    n, pairs = len(positions), find_contacts(positions, tube).pairs
    one = np.ones(2 * len(pairs), np.int32)
    ends = np.concatenate([pairs, pairs[:, ::-1]]).T
    contacts = sparse.coo_array((one, (ends[0], ends[1])), shape=(n, n)).tocsr()
    place = jnp.asarray(positions)
    apical, reach = np.asarray(tube.embed(place).apical), 8 * float(covering_radius(place, tube))
    counts = {}
    for rule in CONFLICTS[1:]:
        hops = rule.endswith("hop")
        graph = hop_conflicts(contacts, int(rule[0])) if hops else distance_conflicts(apical, reach)
        counts[rule] = len(color(graph, n))
    return counts
