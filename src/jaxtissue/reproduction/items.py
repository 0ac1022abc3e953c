"""The items of the paper's evaluation, each with its tables and its figure."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from jaxtissue.geometry.tube import Tube
from jaxtissue.reproduction.experiments import (
    BASAL_RADIUS,
    Plan,
    Store,
    Table,
    measure_runs,
    measure_volumes,
)
from jaxtissue.reproduction.figures import plot_runs, plot_times, plot_volume_ranks
from jaxtissue.reproduction.pictures import plot_cell_in_tissues, plot_internal_pair, plot_scutoid
from jaxtissue.reproduction.ratio_claims import ratio_means
from jaxtissue.reproduction.ratio_figures import plot_kinds, plot_neighbors, plot_transitions
from jaxtissue.reproduction.ratios import measure_ratios
from jaxtissue.reproduction.timings import measure_table
from jaxtissue.reproduction.tissues import random_tissue
from jaxtissue.reproduction.tube_pictures import plot_backbones, plot_tube
from jaxtissue.runs.plots import Tissue, plot_surfaces
from jaxtissue.tissue.measurer import measure_tissue
from jaxtissue.topology.contacts import find_contacts
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.neighbor_law import NeighborLaw, fit_neighbor_law
from jaxtissue.topology.transitions import find_transitions

PICTURED_CELLS = 1000  # of Figs. 7 to 9
PICTURED_RATIO = 10.0  # of the tissue that shows a scutoid and internal neighbors: R_a = 1


class Product(NamedTuple):
    """Tables by the end of their names, "" for the main one, and the figure."""

    tables: dict[str, Table]
    figure: Figure


def make_table1(plan: Plan, store: Store) -> Product:
    """Seconds per sweep and rounds."""
    table, turns = measure_table(plan, store)
    return Product({"": table, "_turns": turns}, plot_times(table)[0])


def make_fig5(plan: Plan, store: Store) -> Product:
    """The cell that begins with the smallest volume, before and after annealing with R_a = 1."""
    tube = plan.tube(PICTURED_RATIO)
    run = store.histories(plan.annealing(PICTURED_RATIO), [0])[0]
    places = [np.asarray(place, float) for place in (run.positions[0], run.positions[-1])]
    volumes = [np.asarray(measure_tissue(jnp.asarray(place), tube).volume, float) for place in places]
    cell = int(volumes[0].argmin())
    states = zip(("start", f"after {plan.sweeps} sweeps"), volumes, strict=True)
    titles = [f"{when}: volume {volume[cell]:.3g} (mean {volume.mean():.3g})" for when, volume in states]
    tissues = [(title, place, trace_edges(place, tube)) for title, place in zip(titles, places, strict=True)]
    columns = {f"{name}_{when}": column for when, place in zip(("before", "after"), places, strict=True)
               for name, column in zip(("axial", "angle"), place.T, strict=True)}  # fmt: skip
    table = {"cell": np.arange(plan.cells), "before": volumes[0], "after": volumes[1]} | columns
    return Product({"": table}, plot_cell_in_tissues(tube, cell, tissues)[0])


def make_fig7(plan: Plan, store: Store) -> Product:
    """The backbones of random tissue."""
    tube, place = _pictured(plan)
    return Product({"": _backbones(place)}, plot_backbones(tube, place)[0])


def make_fig8(plan: Plan, store: Store) -> Product:
    """The cells of the same tissue."""
    tube, place = _pictured(plan)
    return Product({"": _backbones(place)}, plot_tube(tube, place)[0])


def make_fig9(plan: Plan, store: Store) -> Product:
    """The surfaces of the same tissue."""
    tube, place = _pictured(plan)
    cells = measure_tissue(jnp.asarray(place), tube)
    sizes = {name: np.asarray(getattr(cells, name)) for name in ("volume", "apical_area", "basal_area")}
    tissue = Tissue(f"{len(place)} random cells", place, sizes["volume"])
    return Product({"": _backbones(place) | sizes}, plot_surfaces(tube, [tissue])[0])


def make_fig10(plan: Plan, store: Store) -> Product:
    """Energy, rounds, covering radius and tightness over the sweeps."""
    table = measure_runs(plan, store)
    return Product({"": table}, plot_runs(table, not plan.quick)[0])


def make_fig11(plan: Plan, store: Store) -> Product:
    """Volumes after some sweeps."""
    table, tube = measure_volumes(plan, store), plan.tube(BASAL_RADIUS)
    return Product({"": table}, plot_volume_ranks(table, float(tube.volume) / plan.cells, plan.length)[0])


def make_fig12(plan: Plan, store: Store) -> Product:
    """Mean neighbors against the surface ratio, and the logistic laws that fit them."""
    table, tables = measure_ratios(plan, store), {}
    laws = {name: _fit(table, name) for name in ("neighbors", "transitions")}
    found = {name: law for name, law in laws.items() if law}
    if found:
        names = ("low", "high", "middle", "steepness", "residual", "r2")
        rows = {name: np.array([getattr(law, name) for law in found.values()]) for name in names}
        tables["_law"] = {"of": np.array(list(found))} | rows
    return Product({"": table} | tables, plot_neighbors(table, laws["neighbors"])[0])


def make_fig13(plan: Plan, store: Store) -> Product:
    """Transition points and scutoids against the surface ratio."""
    table = measure_ratios(plan, store)
    return Product({"": table}, plot_transitions(table, _fit(table, "transitions"))[0])


def make_fig14(plan: Plan, store: Store) -> Product:
    """The inner cell with the most transition points, in annealed tissue with R_a = 1."""
    tube, place, is_end = _annealed(plan, store)
    edges = trace_edges(place, tube)
    found, contacts = find_transitions(place, tube, edges), find_contacts(place, tube, edges=edges)
    cell = int(np.where(is_end, -1, found.per_cell).argmax())
    own = (found.cells == cell).any(axis=1)
    table = dict(zip("xyz", found.points[own].T, strict=True))
    table |= {f"cell_{name}": column for name, column in zip("abcd", found.cells[own].T, strict=True)}
    touched = (contacts.pairs == cell).any(axis=1)
    others = contacts.pairs[touched].sum(axis=1) - cell
    kinds = dict(zip(others.tolist(), contacts.kind[touched].tolist(), strict=True))
    figure, _ = plot_scutoid(tube, place, cell, kinds, (edges, found.points[own]))
    return Product({"": table, "_backbones": _backbones(place)}, figure)


def make_fig15(plan: Plan, store: Store) -> Product:
    """Neighbors by kind against the surface ratio."""
    table = measure_ratios(plan, store)
    return Product({"": table}, plot_kinds(table)[0])


def make_fig16(plan: Plan, store: Store) -> Product:
    """The internal neighbors with the largest wall in the tissue of Fig. 14; the table has all pairs."""
    tube, place, is_end = _annealed(plan, store)
    edges = trace_edges(place, tube)
    contacts, found = find_contacts(place, tube, edges=edges), find_transitions(place, tube, edges)
    inner = (contacts.kind == "internal") & ~is_end[contacts.pairs].any(axis=1)
    pairs, area = contacts.pairs[inner], contacts.area[inner] / contacts.area.mean()
    if not len(pairs):
        raise ValueError("the small tissue of --quick has no internal neighbors; remove --quick")
    table = {"cell_a": pairs[:, 0], "cell_b": pairs[:, 1], "relative_area": area}
    first, second = (int(cell) for cell in pairs[area.argmax()])
    corners = (found.cells == first).any(axis=1) & (found.cells == second).any(axis=1)
    radius = float(np.hypot(*found.points[corners, 1:].T).mean())
    figure, _ = plot_internal_pair(tube, place, (first, second), radius, edges)
    return Product({"": table, "_backbones": _backbones(place)}, figure)


ITEMS: dict[str, Callable[[Plan, Store], Product]] = {
    "table1": make_table1,
    "fig5": make_fig5,
    "fig7": make_fig7,
    "fig8": make_fig8,
    "fig9": make_fig9,
    "fig10": make_fig10,
    "fig11": make_fig11,
    "fig12": make_fig12,
    "fig13": make_fig13,
    "fig14": make_fig14,
    "fig15": make_fig15,
    "fig16": make_fig16,
}


def _pictured(plan: Plan) -> tuple[Tube, np.ndarray]:
    """The paper's tube of Figs. 7 to 9, L = 80, R_a = 10, R_b = 20, its 1000 cells or the quick plan's."""
    tube = Tube(80.0, 10.0, 20.0)
    return tube, np.asarray(random_tissue(tube, plan.cells if plan.quick else PICTURED_CELLS, 0), float)


def _annealed(plan: Plan, store: Store) -> tuple[Tube, np.ndarray, np.ndarray]:
    tube = plan.tube(PICTURED_RATIO)
    place = store.histories(plan.annealing(PICTURED_RATIO), [0])[0].positions[-1]
    cells = measure_tissue(jnp.asarray(place), tube)
    return tube, np.asarray(place, float), np.asarray(cells.touches_end)


def _backbones(place: np.ndarray) -> Table:
    return {"cell": np.arange(len(place)), "axial": place[:, 0], "angle": place[:, 1]}


def _fit(table: Table, name: str) -> NeighborLaw | None:
    """The law of annealed tissue, None where the ratios are too few or none fits."""
    mean = ratio_means(table)
    try:
        return fit_neighbor_law(mean["ratio"], mean[name]) if len(mean["ratio"]) > 5 else None
    except ValueError:
        return None
