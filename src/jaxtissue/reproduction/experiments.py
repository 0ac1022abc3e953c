"""The experiments behind the paper's figures, as tables; what took time to compute is kept in a folder."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxtissue.diagram.spread import covering_radius, separation
from jaxtissue.geometry.tube import Tube
from jaxtissue.reproduction.tissues import Annealing, History, anneal_history
from jaxtissue.reproduction.workers import Workers
from jaxtissue.system.files import (
    load_arrays,
    make_subfolder,
    read_sealed,
    refuse_link,
    save_arrays,
    write_sealed,
)
from jaxtissue.tissue.measurer import measure_tissue

Table = dict[str, np.ndarray]
THRESHOLDS = (0.0, 0.01, 0.02, 0.05)  # smallest walls counted, in mean walls
BASAL_RADIUS = 10.0
FORMAT = 10  # of what a folder keeps; raised when other code would compute other values, or read it otherwise
AGAIN = "remove it and repeat the command to compute it again"


@dataclass(frozen=True)
class Plan:
    """The amount of computation. The paper's sizes (section 4.3) are the defaults.

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
    turns: int = 5  # in which the algorithms of Table 1 are timed

    def tube(self, ratio: float) -> Tube:
        """The tube of a surface ratio R_b / R_a, with R_b = 10."""
        return Tube(self.length, BASAL_RADIUS / ratio, BASAL_RADIUS)

    def annealing(self, ratio: float, algorithm: str = "is-mh") -> Annealing:
        """The annealing of the tissues of a surface ratio."""
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
    turns=3,
)


@dataclass
class Store:
    """The state that experiments share, in a folder: a stopped run goes on from there.

    `fresh` forgets the old; what has another `FORMAT` is computed anew. Damaged files raise `ValueError`,
    as does a link in the folder's place. `workers` compute what there is more than one of.
    """

    folder: Path
    say: Callable[[str], None]
    fresh: bool = False
    workers: Workers = field(default_factory=Workers)
    renewed: set[Path] = field(default_factory=set)

    def __post_init__(self) -> None:
        refuse_link(self.folder)

    def _is_usable(self, path: Path) -> bool:
        return path.exists() and (not self.fresh or path in self.renewed)

    def row(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """A row of named numbers, computed in this process, only if it is not there."""
        if (row := self.find_row(name)) is not None:
            return row
        self.say(name.replace("_", " "))
        return self._keep_row(name, compute())

    def rows(
        self, function: Callable[..., dict[str, Any]], calls: Mapping[str, tuple[Any, ...]]
    ) -> dict[str, dict[str, Any]]:
        """Rows that are not there, by name, of the function's arguments; each is kept as it ends."""
        names, rows = list(calls), {}
        for number, row in self.workers.run(function, list(calls.values())):
            self.say(f"{names[number].replace('_', ' ')} ({len(rows) + 1} of {len(names)})")
            rows[names[number]] = self._keep_row(names[number], row)
        return rows

    def find_row(self, name: str) -> dict[str, Any] | None:
        """The row of that name, if it is there."""
        path = self.folder / f"{name}.json"
        return _load_row(path) if self._is_usable(path) else None

    def _keep_row(self, name: str, row: dict[str, Any]) -> dict[str, Any]:
        """The row as it is found from now on."""
        make_subfolder(self.folder)
        path = self.folder / f"{name}.json"
        write_sealed(path, {"format": FORMAT, "row": row})
        self.renewed.add(path)
        return read_sealed(path, AGAIN)["row"]

    def histories(self, annealing: Annealing, seeds: Sequence[int]) -> list[History]:
        """One annealing run for each seed, as by `anneal`."""
        return self.anneal([(annealing, seed) for seed in seeds])

    def anneal(self, wanted: Sequence[tuple[Annealing, int]]) -> list[History]:
        """The runs of these seeds; those that are not there are computed, each kept as it ends."""
        paths = [self.folder / f"{annealing.name}_seed{seed}.npz" for annealing, seed in wanted]
        runs = [_load_history(path) if self._is_usable(path) else None for path in paths]
        missing = [at for at, run in enumerate(runs) if run is None]
        if missing:
            make_subfolder(self.folder)
            self.say(f"tissues to anneal: {len(missing)}")
        calls, done = [wanted[at] for at in missing], 0
        for number, history in self.workers.run(anneal_history, calls):
            path, done = paths[missing[number]], done + 1
            save_arrays(path, {"format": FORMAT, "positions": history.positions} | history.records)
            self.renewed.add(path)
            self.say(f"annealed {path.stem.replace('_', ' ')} ({done} of {len(missing)})")
            runs[missing[number]] = history
        return [run for run in runs if run is not None]


def _load_history(path: Path) -> History | None:
    """The history in a file, none where it has another format."""
    columns = load_arrays(path, AGAIN)
    if columns.pop("format", 0) != FORMAT:
        return None
    return History(columns, columns.pop("positions"))


def _load_row(path: Path) -> dict[str, Any] | None:
    """The row in a file, none where it has another format."""
    kept = read_sealed(path, AGAIN)
    return kept["row"] if kept.get("format") == FORMAT else None


def tabulate(rows: Sequence[dict[str, Any]]) -> Table:
    """Rows as columns; what is missing is not a number."""
    return {name: np.array([np.nan if row[name] is None else row[name] for row in rows]) for name in rows[0]}


def measure_runs(plan: Plan, store: Store) -> Table:
    """Every sweep of the annealing runs with R_a = 1 and 5, by both algorithms, a row each (Fig. 10).

    `covering_radius`, `separation` and their ratio `tightness` (phi) are measured for IS-MH only.
    """
    kinds = [(radius, algorithm) for radius in (1.0, 5.0) for algorithm in ("is-mh", "mh")]
    keys = [(*kind, seed) for kind in kinds for seed in range(plan.seeds)]
    annealings = {kind: plan.annealing(BASAL_RADIUS / kind[0], kind[1]) for kind in kinds}
    runs = store.anneal([(annealings[key[:2]], key[2]) for key in keys])
    calls = [(run.positions, annealings[key[:2]].tube, key[1] == "is-mh") for key, run in zip(keys, runs, strict=True)]
    spreads = dict(store.workers.run(_spread, calls))
    tables = []
    for number, ((radius, algorithm, seed), run) in enumerate(zip(keys, runs, strict=True)):
        count = len(run.positions)
        table = {"apical_radius": np.full(count, radius), "algorithm": np.full(count, algorithm)}
        table |= {"seed": np.full(count, seed)} | run.records
        table["rounds_so_far"] = np.cumsum(run.records["rounds"])
        tables.append(table | spreads[number])
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _spread(positions: np.ndarray, tube: Tube, measured: bool) -> Table:
    nothing = np.full(len(positions), np.nan)
    covering, apart = nothing, nothing
    if measured:
        places = [jnp.asarray(place) for place in positions]
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
            cells = measure_tissue(place, annealing.tube)
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
