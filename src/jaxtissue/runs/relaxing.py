"""One relaxation in a folder: minimizes the energy of a tissue, and writes the files and figures of a run."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import jax.numpy as jnp
import numpy as np

from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.geometry.domains import Domain
from jaxtissue.minimization.relaxation import RelaxRecord, RelaxResult, relax
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import BackboneTable
from jaxtissue.runs.reports import contact_summary, contacts_of_run, tabulate_cells, write_contacts
from jaxtissue.runs.run_files import RESULTS, initial_backbones, say
from jaxtissue.runs.run_folders import CELLS, DOMAIN, FIGURES, FILES, INITIAL, MANIFEST, STEPS, SUMMARY, save_tissue
from jaxtissue.runs.settings import FORMAT, Settings, now, provenance
from jaxtissue.system.files import check_folder, checksum, make_folder, open_own, write_json, write_sealed
from jaxtissue.system.locks import alone
from jaxtissue.system.signals import Stop
from jaxtissue.tissue.measurer import measure_tissue

OF_ANNEALING = ("sweeps", "temperature", "final_temperature", "algorithm", "patience")  # settings of no meaning here


@dataclass(frozen=True)
class Descent:
    """How a tissue is relaxed: the arguments of `relax`."""

    method: str = "lbfgs"
    steps: int = 50
    tolerance: float = 1e-6


@dataclass
class _Watch:
    """Writes each step of a relaxation as it comes, and ends it when the user asks for it."""

    folder: Path
    table: IO[str]
    names: tuple[str, ...] | None
    domain: Any
    stop: Stop

    def __call__(self, record: RelaxRecord, positions: np.ndarray) -> bool:
        rows = [record._fields] if record.step == 0 else []
        rows.append(tuple(str(np.asarray(value).item()) for value in record))
        self.table.write("".join(",".join(row) + "\n" for row in rows))
        self.table.flush()
        save_tissue(self.folder, self.domain, BackboneTable(positions, self.names))
        return bool(self.stop.signal)


def run_relaxation(folder: Path, settings: Settings, descent: Descent, force: bool = False) -> int:
    """Relax a tissue into `folder` and return the exit code, 128 + signal for one that was stopped.

    The backbones are on the disk after every step. Raises `ValueError` for bad settings or backbones, and for a folder
    that holds files (unless forced) or that another run is at.
    """
    check_folder(folder, force)
    initial, names = initial_backbones(settings, bent=isinstance(settings.place, Domain))
    settings = replace(settings, cells=len(initial), x64=jnp.result_type(float) == jnp.float64)
    model = settings.model
    relax(initial, model, descent.method, 0, descent.tolerance, settings.resolution)  # what it refuses, before files
    with Stop() as stop, alone(folder):
        check_folder(folder, force)
        make_folder(folder, FILES)
        started = provenance()
        storage.write_backbones(folder / INITIAL, initial, names, column_names(settings.place))
        say(f"relaxing {len(initial)} cells in {folder}")
        with open_own(folder / STEPS, "w") as table:
            watch = _Watch(folder, table, names, settings.place, stop)
            result = relax(initial, model, descent.method, descent.steps, descent.tolerance, settings.resolution, watch)
            os.fsync(table.fileno())
        arguments = {name: value for name, value in asdict(settings).items() if name not in OF_ANNEALING}
        manifest = {"format": FORMAT, "command": "relax", "arguments": arguments | asdict(descent)} | started
        if stop.signal:
            write_sealed(folder / MANIFEST, manifest | {"finished": None})
            again = f"jaxtissue relax --backbones {folder / 'backbones.csv'} --domain {folder / DOMAIN} --out DIR"
            say(f"stopped by {stop.signal.name} after step {result.history[-1].step}; continue with: {again}")
            return 128 + stop.signal
        _finish(folder, settings, initial, names, result, manifest)
    return 0


def _finish(
    folder: Path,
    settings: Settings,
    initial: np.ndarray,
    names: tuple[str, ...] | None,
    result: RelaxResult,
    manifest: Mapping[str, Any],
) -> None:
    """Write tables, figures and the manifest, and print the result."""
    from jaxtissue.runs.plots import Tissue, plot_relaxation, plot_surfaces, plot_volumes, save_figure
    from jaxtissue.runs.viewing import leave_pictures

    say(
        "measuring cells and drawing figures"
        if settings.no_contacts
        else "measuring cells and contacts, drawing figures"
    )
    model, place, connectivity = settings.model, result.positions, None
    domain = model.domain
    if not settings.no_contacts:
        connectivity = contacts_of_run(place, domain, settings.minimum_contact)
    columns, summary = tabulate_cells(place, model, settings.resolution, names, connectivity)
    storage.write_table(folder / CELLS, columns)
    if connectivity is not None:
        write_contacts(folder, connectivity)
        summary |= contact_summary(connectivity)
    write_json(folder / SUMMARY, summary)
    before = np.asarray(measure_tissue(initial, domain, settings.resolution, refine=False).volume)
    volumes, last = [before, columns["volume"]], result.history[-1]
    tissues = [Tissue("before", initial, before), Tissue("relaxed", place, columns["volume"])]
    figures = (
        partial(plot_relaxation, result.history),
        partial(plot_volumes, ["before", "relaxed"], volumes, float(model.mean_volume)),
        partial(plot_surfaces, domain, tissues),
    )
    for name, draw in zip(FIGURES, figures, strict=True):
        save_figure(folder / name, draw)
    energy = {"initial": result.history[0].energy, "final": result.energy, "final_measured": summary["energy"]}
    end = {"step": last.step, "evaluations": last.evaluations, "gradient": last.gradient, "seconds": last.seconds}
    end |= {"converged": result.converged, "message": result.message}
    files = {name: checksum(folder / name) for name in (*RESULTS, STEPS) if (folder / name).is_file()}
    manifest = dict(manifest) | {"energy": energy, "final": end | summary, "finished": now(), "files": files}
    write_sealed(folder / MANIFEST, manifest)
    _print_result(settings, result, energy, summary)
    print(f"written to       {folder}")
    tissue = TissueRecord(np.asarray(place, float), domain, names, traced=connectivity)
    leave_pictures(tissue, folder, settings.no_contacts)


def _print_result(
    settings: Settings, result: RelaxResult, energy: Mapping[str, float], summary: Mapping[str, Any]
) -> None:
    first, last = result.history[0], result.history[-1]
    print(f"cells            {len(result.positions)}")
    print(f"steps            {last.step}, {last.evaluations} evaluations in {last.seconds:.3g} s")
    print(f"status           {result.message}")
    print(f"{f'energy, {settings.resolution}':17}{energy['initial']:.6g} -> {energy['final']:.6g}")
    print(f"{'energy, measured':17}{energy['final_measured']:.6g}")
    print(f"{'gradient':17}{first.gradient:.3g} -> {last.gradient:.3g}")
    for name in ("tightness", "neighbors", "transitions", "scutoid_fraction"):
        if name in summary:
            print(f"{name:17}{summary[name]:.6g}")
