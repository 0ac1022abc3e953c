"""One annealing run in a folder: begun, saved as it goes, resumed to the bit, finished with figures."""

import json
import os
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxtissue import io
from jaxtissue.anneal import SPAN, Annealer, AnnealState, renews_at
from jaxtissue.diagrams import measure_tissue
from jaxtissue.lines import PRESETS, resolution_named
from jaxtissue.memory import tell_memory
from jaxtissue.plot import Tissue, plot_energy, plot_surfaces, plot_volumes
from jaxtissue.schedules import has_stalled
from jaxtissue.settings import Settings, now, provenance
from jaxtissue.statistics import find_connectivity
from jaxtissue.stopping import Stop
from jaxtissue.tables import CONTACT_TABLES, contact_summary, contact_warning, tabulate_cells, write_contacts

FIGURES = ("energy.png", "volumes.png", "surfaces.png")
TABLES = ("initial_backbones.csv", "backbones.csv", "cells.csv", "sweeps.csv")
FILES = ("checkpoint.npz", "manifest.json", *TABLES, *CONTACT_TABLES, *FIGURES)
KEPT_SWEEPS = (0, 1, 5, 25, 50, 100, 250, 500, 1000, 2500, 5000, 10_000)  # drawn in the figures
CHECKPOINT_SECONDS = 2.0  # with sweeps shorter than this no more than 4 s are ever lost


@dataclass
class Run:
    """A run under way: what it does, where it stands, and its manifest so far."""

    folder: Path
    settings: Settings
    annealer: Annealer
    state: AnnealState
    kept: dict[int, np.ndarray]  # positions after some sweeps, for the figures
    names: tuple[str, ...] | None
    manifest: dict[str, Any]

    def save(self) -> None:
        """Write the checkpoint; the rows of sweeps.csv up to it must be on the disk before.

        Only between spans of sweeps, where a longer run would be too: the odd sweeps at a run's end are
        played again if it goes on.
        """
        if not renews_at(self.state.sweep):
            return
        kept = np.array(list(self.kept)), np.stack(list(self.kept.values()))
        io.save_checkpoint(self.folder / "checkpoint.npz", io.Checkpoint(self.state, *kept))

    def write_manifest(self, **news: Any) -> None:
        """Write the manifest with what is new."""
        self.manifest |= news
        io.write_json(self.folder / "manifest.json", self.manifest)


def run_annealing(folder: Path, settings: Settings, force: bool = False) -> int:
    """Anneal from the start into `folder` and return the exit code, 128 + signal for a run that was stopped.

    Raises `ValueError` for bad settings or backbones, and for a folder that exists (unless forced) or can't
    be written; nothing is written then.
    """
    io.check_folder(folder, force)
    with Stop() as stop:
        return _go_on(_begin(folder, settings), stop)


def resume_annealing(folder: Path, settings: Settings, backbones: Path | None = None) -> int:
    """Take up the run in `folder` at its checkpoint and return the exit code, as `run_annealing`.

    `settings` come from `saved_settings`; `backbones`, where given, must be those that the run began with.
    A finished run is left as it is. Raises `ValueError` for other backbones and damaged files.
    """
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    initial = io.read_backbones(folder / "initial_backbones.csv", settings.tube)
    if backbones is not None:
        given = io.read_backbones(backbones, settings.tube)
        if given.names != initial.names or not np.array_equal(given.positions, initial.positions):
            raise ValueError(f"--backbones {backbones} differs from the run to resume; leave it out")
    if manifest["finished"] and settings.sweeps == manifest["arguments"]["sweeps"]:
        _say(f"{folder} is finished after {manifest['final']['sweep']} sweeps; nothing to do")
        return 0
    checkpoint = io.load_checkpoint(folder / "checkpoint.npz")
    io.cut_sweeps(folder / "sweeps.csv", checkpoint.state.sweep)
    kept = dict(zip(checkpoint.kept_sweeps.tolist(), checkpoint.kept_positions, strict=True))
    annealer = settings.annealer(manifest["cooling_sweeps"])
    run = Run(folder, settings, annealer, checkpoint.state, kept, initial.names, manifest)
    again = {"at_sweep": checkpoint.state.sweep} | provenance()
    run.write_manifest(arguments=asdict(settings), finished=None, resumed=[*manifest["resumed"], again])
    with Stop() as stop:
        return _go_on(run, stop)


def _begin(folder: Path, settings: Settings) -> Run:
    """A run before its first sweep, with its first checkpoint on the disk."""
    tube, names = settings.tube, None
    if settings.backbones:
        initial, names = io.read_backbones(Path(settings.backbones), tube)
    else:
        initial = np.asarray(tube.random_positions(jax.random.key(settings.seed), settings.cells))
    settings = replace(settings, cells=len(initial))
    started = provenance()
    annealer = settings.annealer(settings.sweeps)
    _say(tell_memory(len(initial), tube, resolution_named(settings.resolution), 8 if settings.x64 else 4))
    _say(f"annealing {len(initial)} cells in {folder}: compiling")
    state = annealer.start(tube.reflect(jnp.asarray(initial)))
    record = annealer.record(state)
    io.make_folder(folder, FILES)
    manifest = {"arguments": asdict(settings), "cooling_sweeps": settings.sweeps} | started
    manifest |= {"finished": None, "compile_seconds": 0.0, "resumed": []}
    run = Run(folder, settings, annealer, state, {0: state.positions}, names, manifest)
    run.write_manifest()
    io.write_backbones(folder / "initial_backbones.csv", initial, names)
    with (folder / "sweeps.csv").open("w", encoding="utf-8", newline="") as table:
        io.write_sweep(table, record)
        os.fsync(table.fileno())
    run.save()
    return run


def _go_on(run: Run, stop: Stop) -> int:
    """Sweep until the run ends or is stopped, then finish or leave it; the exit code."""
    compiled_before = run.manifest["compile_seconds"]
    ended = _sweep(run, stop)
    run.manifest["compile_seconds"] = compiled_before + run.annealer.compile_seconds
    if ended:
        _finish(run)
        return 0
    assert stop.signal is not None
    run.write_manifest()
    at = f"after sweep {run.state.sweep} of {run.settings.sweeps}"
    _say(f"stopped by {stop.signal.name} {at}; continue with: jaxtissue anneal --out {run.folder} --resume")
    return 128 + stop.signal


def _sweep(run: Run, stop: Stop) -> bool:
    """Sweep, write each row, save every few seconds; whether the run came to its end."""
    path, settings = run.folder / "sweeps.csv", run.settings
    energies = io.read_sweeps(path)["energy"].tolist()

    def ended() -> bool:
        stalled = settings.patience > 0 and has_stalled(energies, settings.patience)
        return stalled or run.state.sweep >= settings.sweeps

    bar = tqdm(total=settings.sweeps, initial=run.state.sweep, desc="compiling", unit="sweep", disable=None)
    with path.open("a", encoding="utf-8", newline="") as table, bar:
        compiling, saved = True, time.monotonic()
        while not (ended() or stop.signal):
            last_chunk = settings.sweeps - run.state.sweep <= SPAN
            if time.monotonic() - saved > CHECKPOINT_SECONDS or last_chunk:
                os.fsync(table.fileno())
                run.save()
                saved = time.monotonic()
            run.state, records, trail = run.annealer.advance(run.state)
            for record, positions in zip(records, trail, strict=True):
                io.write_sweep(table, record)
                energies.append(record.energy)
                if record.sweep in KEPT_SWEEPS:
                    run.kept[record.sweep] = positions
            if compiling:
                compiling = False
                _say(f"compiled in {run.annealer.compile_seconds:.1f} s; annealing")
                bar.set_description("annealing", refresh=False)
            bar.update(len(records))
            shown = {"energy": f"{records[-1].energy:.4g}", "acceptance": f"{records[-1].acceptance:.2f}"}
            bar.set_postfix(shown | {"rounds": records[-1].rounds})
        os.fsync(table.fileno())
        run.save()
    return ended()


def _finish(run: Run) -> None:
    """Write what a finished run leaves: tables, figures, the manifest; print the result."""
    _say("measuring and drawing" if run.settings.no_contacts else "measuring, tracing contacts, drawing")
    model, settings = run.annealer.model, run.settings
    resolution = resolution_named(settings.resolution)
    connectivity, place = None, run.state.positions
    if not settings.no_contacts:
        connectivity = find_connectivity(place, settings.tube, settings.minimum_contact)
    columns, summary = tabulate_cells(place, model, resolution, run.names, connectivity)
    io.write_backbones(run.folder / "backbones.csv", place, run.names)
    io.write_table(run.folder / "cells.csv", columns)
    if connectivity is not None:
        write_contacts(run.folder, connectivity)
        summary |= contact_summary(connectivity)
        if warning := contact_warning(connectivity):
            _say(f"warning: {warning}")
    shown = run.kept | {run.state.sweep: run.state.positions}
    fine = [measure_tissue(jnp.asarray(at), model.tube, PRESETS["fine"])[0] for at in shown.values()]
    fine_energy = [float(model.cell_energy(cells, model).sum()) for cells in fine]
    sweeps = io.read_sweeps(run.folder / "sweeps.csv")
    before, after = (
        Tissue(f"sweep {sweep}", shown[sweep], cells.volume)
        for sweep, cells in ((0, fine[0]), (run.state.sweep, fine[-1]))
    )
    figures = (
        plot_energy(sweeps, (list(shown), fine_energy), "total, measured with 'fine'"),
        plot_volumes(*_a_few(list(shown), [cells.volume for cells in fine]), float(model.mean_volume)),
        plot_surfaces(model.tube, (before, after)),
    )
    for name, (figure, _) in zip(FIGURES, figures, strict=True):
        _save_figure(run.folder / name, figure)
    energy = {"initial": sweeps["energy"][0], "final": sweeps["energy"][-1]}
    energy |= {"initial_fine": fine_energy[0], "final_fine": fine_energy[-1]}
    run.write_manifest(energy=energy, final={"sweep": run.state.sweep} | summary, finished=now())
    _print_result(run)


def _a_few(sweeps: list[int], volumes: list[Array]) -> tuple[list[int], list[Array]]:
    """At most seven of the kept sweeps, the first and the last among them."""
    picked = np.unique(np.linspace(0, len(sweeps) - 1, min(7, len(sweeps))).round().astype(int))
    return [sweeps[i] for i in picked], [volumes[i] for i in picked]


def _save_figure(path: Path, figure: Figure) -> None:
    with io.replacing(path, "wb") as file:
        figure.savefig(file, format="png", dpi=150)


def _print_result(run: Run) -> None:
    energy, final = run.manifest["energy"], run.manifest["final"]
    print(f"cells            {run.settings.cells}")
    print(f"sweeps           {run.state.sweep}")
    for label, ending in ((run.settings.resolution, ""), ("fine", "_fine")):
        first, last = energy["initial" + ending], energy["final" + ending]
        share = f" ({100 * last / first:.3g} %)" if first > 0 else ""
        print(f"{f'energy, {label}':17}{first:.6g} -> {last:.6g}{share}")
    shown = ("separation", "covering_radius", "tightness", "neighbors", "transitions", "scutoid_fraction")
    for name in shown:
        if name in final:
            print(f"{name:17}{final[name]:.6g}")
    print(f"written to       {run.folder}")


def _say(text: str) -> None:
    tqdm.write(text, file=sys.stderr)
