"""Connectivity against the surface ratio, of three kinds of tissue, as a table."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxtissue.diagram.spread import separation
from jaxtissue.energy import tube_model
from jaxtissue.reproduction.experiments import THRESHOLDS, Plan, Store, Table, tabulate
from jaxtissue.reproduction.tissues import random_tissue, relax_lloyd
from jaxtissue.tissue.measurer import measure_tissue
from jaxtissue.topology.neighbor_law import bound_ratios
from jaxtissue.topology.statistics import KIND_ORDER, find_connectivity, summarize_connectivity

KINDS = ("random", "lloyd", "annealed")


def measure_ratios(plan: Plan, store: Store) -> Table:
    """Connectivity of random, Lloyd-relaxed and annealed tissue against the surface ratio (Figs. 12, 13, 15).

    A row for each ratio, kind of tissue and seed: energy, means over all cells, and, as `..._above_1`, `_2`
    and `_5`, the means if walls below 1, 2 and 5 % of the mean wall are no contacts; `lemma_...` and
    `corollary_...` are the largest neighborhoods / the bounds that the tissue's tightness sets.
    """
    keys = [(ratio, kind, seed) for ratio in plan.ratios for kind in KINDS for seed in range(plan.seeds)]
    found = {key: store.find_row(_row_name(plan, *key)) for key in keys}
    missing = [key for key in keys if found[key] is None]
    annealed = [(ratio, seed) for ratio, kind, seed in missing if kind == "annealed"]
    runs = store.anneal([(plan.annealing(ratio), seed) for ratio, seed in annealed])
    places = {(ratio, "annealed", seed): run.positions[-1] for (ratio, seed), run in zip(annealed, runs, strict=True)}
    for ratio, kind, seed in missing:
        if kind != "annealed":
            places[ratio, kind, seed] = np.asarray(random_tissue(plan.tube(ratio), plan.cells, seed))
    rows = store.rows(_connect, {_row_name(plan, *key): (plan, *key, places[key]) for key in missing})
    return tabulate([found[key] or rows[_row_name(plan, *key)] for key in keys])


def _row_name(plan: Plan, ratio: float, kind: str, seed: int) -> str:
    name = f"connectivity_ratio{ratio:g}_{kind}_cells{plan.cells}_length{plan.length:g}_seed{seed}"
    return name + (f"_sweeps{plan.sweeps}" if kind == "annealed" else "")


def _connect(plan: Plan, ratio: float, kind: str, seed: int, place: np.ndarray) -> dict[str, Any]:
    """The row of a tissue, whose relaxation by Lloyd's method is left to do."""
    tube = plan.tube(ratio)
    place = relax_lloyd(place, tube) if kind == "lloyd" else place
    cells = measure_tissue(jnp.asarray(place), tube)
    energy = tube_model(tube, plan.cells).cell_energy(cells, tube_model(tube, plan.cells))
    found = find_connectivity(place, tube)
    row: dict[str, Any] = {"ratio": ratio, "kind": kind, "seed": seed}
    row |= {"energy": float(np.sum(energy, dtype=float)), "volume_spread": _variation(cells.volume)}
    row |= summarize_connectivity(found)
    inner = summarize_connectivity(found, inner_only=True)
    row |= {f"{name}_inner": inner[name] for name in ("neighbors", "transitions", "scutoid_fraction")}
    for bound in bound_ratios(place, tube, found, hops=(2, 3)):
        row[f"{bound['bound'].lower().replace(' ', '_')}_hops_{bound['hops']}"] = bound["ratio"]
        row["tightness"] = bound["tightness"]
    row["covering_radius"] = row["tightness"] * float(separation(jnp.asarray(place), tube))
    contacts, mean = found.contacts, found.contacts.area.mean()
    for threshold in THRESHOLDS[1:]:
        kept = contacts.area >= threshold * mean
        ending = f"_above_{100 * threshold:g}"
        counts = {what: 2 * (kept & (contacts.kind == what)).sum() / plan.cells for what in KIND_ORDER}
        touched = np.unique(contacts.pairs[kept & (contacts.kind == "internal")])
        row |= {f"{what}_neighbors{ending}": count for what, count in counts.items()}
        row |= {
            f"neighbors{ending}": sum(counts.values()),
            f"internal_fraction{ending}": len(touched) / plan.cells,
        }
    return row


def _variation(volumes: Any) -> float:
    """Standard deviation / mean."""
    volume = np.asarray(volumes, float)
    return float(volume.std() / volume.mean())
