"""The experiments behind the paper's figures, as tables; what took time to compute is kept in a folder."""

import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxtissue import io
from jaxtissue.candidates import measure_tissue
from jaxtissue.energy import tube_model
from jaxtissue.laws import bound_ratios
from jaxtissue.reproduction.tissues import Annealing, History, anneal_histories, random_tissue, relax_lloyd
from jaxtissue.spread import covering_radius, separation
from jaxtissue.statistics import KIND_ORDER, find_connectivity, summarize_connectivity
from jaxtissue.tube import Tube

Table = dict[str, np.ndarray]
KINDS = ("random", "lloyd", "annealed")
THRESHOLDS = (0.0, 0.01, 0.02, 0.05)  # smallest walls counted, in mean walls
BASAL_RADIUS = 10.0
FORMAT = 2  # of what is kept in a folder; raised when other code would compute other values


@dataclass(frozen=True)
class Plan:
    """How much is computed. The paper's sizes (section 4.3) are the defaults.

    The quick plan keeps the density of cells, on a shorter piece of the tube; all of it has the cells of the
    table's first row, so that little is compiled.
    """

    quick: bool = False
    seeds: int = 10
    cells: int = 500
    length: float = 100.0
    sweeps: int = 100
    kept: tuple[int, ...] = (1, 5, 25, 50, 100)  # whose volumes are shown
    ratios: tuple[float, ...] = (1.25, 1.5, 2, 3, 5, 7, 10, 15, 20, 35, 50, 100, 200, 1000)
    table_cells: tuple[int, ...] = (100, 500, 1000)
    timed_sweeps: int = 15

    def tube(self, ratio: float) -> Tube:
        """The tube of a surface ratio R_b / R_a, with R_b = 10."""
        return Tube(self.length, BASAL_RADIUS / ratio, BASAL_RADIUS)

    def annealing(self, ratio: float, algorithm: str = "is-mh") -> Annealing:
        """How the tissues of a surface ratio are annealed."""
        return Annealing(self.tube(ratio), self.cells, self.sweeps, algorithm)


QUICK = Plan(
    quick=True,
    seeds=2,
    cells=100,
    length=20.0,
    sweeps=10,
    kept=(1, 5, 10),
    ratios=(1.25, 2, 10, 50),
    table_cells=(100,),
    timed_sweeps=5,
)


@dataclass
class Store:
    """What experiments share, in a folder: a run that is stopped takes up there.

    `fresh` forgets the old; what has another `FORMAT` is computed anew. Damaged files raise `ValueError`.
    """

    folder: Path
    say: Callable[[str], None]
    fresh: bool = False
    renewed: set[Path] = field(default_factory=set)

    def _is_usable(self, path: Path) -> bool:
        return path.exists() and (not self.fresh or path in self.renewed)

    def row(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """A row of named numbers, computed only if it is not there."""
        path = self.folder / f"{name}.json"
        if self._is_usable(path) and (row := _load_row(path)) is not None:
            return row
        self.folder.mkdir(parents=True, exist_ok=True)
        self.say(name.replace("_", " "))
        io.write_json(path, {"format": FORMAT, "row": compute()})
        self.renewed.add(path)
        return json.loads(path.read_text(encoding="utf-8"))["row"]

    def histories(self, annealing: Annealing, seeds: Sequence[int]) -> list[History]:
        """One annealing run for each seed; those that are not there are computed, each kept as it ends."""
        paths = {seed: self.folder / f"{annealing.name}_seed{seed}.npz" for seed in seeds}
        found = {seed: _load_history(path) for seed, path in paths.items() if self._is_usable(path)}
        known = {seed: history for seed, history in found.items() if history is not None}
        missing = [seed for seed in seeds if seed not in known]
        if missing:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.say(f"annealing {len(missing)} x {annealing.name.replace('_', ' ')}")
        new = anneal_histories(annealing, missing) if missing else []
        for seed, history in zip(missing, new, strict=True):
            columns: dict[str, Any] = {"format": FORMAT, "positions": history.positions}
            with io.replacing(paths[seed], "wb") as file:
                np.savez(file, allow_pickle=False, **columns, **history.records)
            self.renewed.add(paths[seed])
            known[seed] = history
        return [known[seed] for seed in seeds]


def _load_history(path: Path) -> History | None:
    """The history in a file, none where it has another format."""
    try:
        with np.load(path, allow_pickle=False) as file:
            columns = dict(file)
        if columns.pop("format", 0) != FORMAT:
            return None
        return History(columns, columns.pop("positions"))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is damaged ({error}); remove it") from error


def _load_row(path: Path) -> dict[str, Any] | None:
    """The row in a file, none where it has another format."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        return kept["row"] if kept.get("format") == FORMAT else None
    except (ValueError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({error}); remove it") from error


def tabulate(rows: Sequence[dict[str, Any]]) -> Table:
    """Rows as columns; what is missing is not a number."""
    return {name: np.array([np.nan if row[name] is None else row[name] for row in rows]) for name in rows[0]}


def measure_runs(plan: Plan, store: Store) -> Table:
    """Every sweep of the annealing runs with R_a = 1 and 5, by both algorithms, a row each (Fig. 10).

    `covering_radius`, `separation` and their ratio `tightness` (phi) are measured for IS-MH only.
    """
    tables = []
    for radius in (1.0, 5.0):
        for algorithm in ("is-mh", "mh"):
            annealing = plan.annealing(BASAL_RADIUS / radius, algorithm)
            runs = store.histories(annealing, range(plan.seeds))
            for seed, run in enumerate(runs):
                count = len(run.positions)
                table = {"apical_radius": np.full(count, radius), "algorithm": np.full(count, algorithm)}
                table |= {"seed": np.full(count, seed)} | run.records
                table["rounds_so_far"] = np.cumsum(run.records["rounds"])
                tables.append(table | _spread(run, annealing.tube, algorithm == "is-mh"))
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _spread(run: History, tube: Tube, measured: bool) -> Table:
    nothing = np.full(len(run.positions), np.nan)
    covering, apart = nothing, nothing
    if measured:
        places = [jnp.asarray(place) for place in run.positions]
        covering = np.array([float(covering_radius(place, tube)) for place in places])
        apart = np.array([float(separation(place, tube)) for place in places])
    return {"covering_radius": covering, "separation": apart, "tightness": covering / apart}


def measure_volumes(plan: Plan, store: Store) -> Table:
    """The volume of every cell after some sweeps of the runs with R_a = 1 (Fig. 11), measured by `standard`.

    Cells of a seed and sweep come from the smallest to the largest; `rank` counts them from 1.
    """
    annealing, tables = plan.annealing(BASAL_RADIUS), []
    for seed, run in enumerate(store.histories(annealing, range(plan.seeds))):
        for sweep in (0, *plan.kept):
            place = jnp.asarray(run.positions[sweep])
            cells, _ = measure_tissue(place, annealing.tube)
            volume, ends, count = np.asarray(cells.volume), np.asarray(cells.touches_end), len(place)
            order = np.argsort(volume, kind="stable")
            table = {"seed": np.full(count, seed), "sweep": np.full(count, sweep)}
            table |= {"rank": np.arange(1, count + 1), "cell": order, "axial": np.asarray(place)[order, 0]}
            table |= {
                "volume": np.asarray(cells.volume)[order],
                "is_end": ends[order],
            }
            tables.append(table)
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def measure_ratios(plan: Plan, store: Store) -> Table:
    """Connectivity of random, Lloyd-relaxed and annealed tissue against the surface ratio (Figs. 12, 13, 15).

    A row for each ratio, kind of tissue and seed: energy, means over all cells, and, as `..._above_1`, `_2`
    and `_5`, the means if walls below 1, 2 and 5 % of the mean wall are no contacts; `lemma_...` and
    `corollary_...` are the largest neighborhoods / the bounds that the tissue's tightness sets.
    """
    rows = []
    for ratio in plan.ratios:
        for kind in KINDS:
            for seed in range(plan.seeds):
                size = f"cells{plan.cells}_length{plan.length:g}"
                name = f"connectivity_ratio{ratio:g}_{kind}_{size}_seed{seed}"
                name += f"_sweeps{plan.sweeps}" if kind == "annealed" else ""
                rows.append(store.row(name, lambda at=(ratio, kind, seed): _connect(plan, store, *at)))
    return tabulate(rows)


def make_tissue(plan: Plan, store: Store, ratio: float, kind: str, seed: int) -> np.ndarray:
    """The positions of a random, Lloyd-relaxed or annealed tissue."""
    if kind == "annealed":
        return store.histories(plan.annealing(ratio), range(plan.seeds))[seed].positions[-1]
    place = np.asarray(random_tissue(plan.tube(ratio), plan.cells, seed))
    return relax_lloyd(place, plan.tube(ratio)) if kind == "lloyd" else place


def _connect(plan: Plan, store: Store, ratio: float, kind: str, seed: int) -> dict[str, Any]:
    tube, place = plan.tube(ratio), make_tissue(plan, store, ratio, kind, seed)
    cells, _ = measure_tissue(jnp.asarray(place), tube)
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
