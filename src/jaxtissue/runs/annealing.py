"""One annealing run in a folder: started, saved regularly, resumed bit by bit, finished with figures."""

import os
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from jaxtissue.dynamics.replays import SPAN
from jaxtissue.dynamics.schedules import has_stalled
from jaxtissue.dynamics.sweep_log import AcceptanceWatch
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.geometry.domains import Domain
from jaxtissue.runs import formats, storage
from jaxtissue.runs.preparing import Preparation
from jaxtissue.runs.reports import contact_summary, contacts_of_run, tabulate_cells, write_contacts
from jaxtissue.runs.run_files import FIGURES, RESULTS, Run, begin, initial_backbones, say, take_up
from jaxtissue.runs.settings import Settings, now, other_bits
from jaxtissue.system.files import (
    check_folder,
    open_own,
)
from jaxtissue.system.locks import alone
from jaxtissue.system.signals import Stop

KEPT_SWEEPS = (0, 1, 5, 25, 50, 100, 250, 500, 1000, 2500, 5000, 10_000)  # drawn in the figures
CHECKPOINT_SECONDS = 2.0  # with sweeps shorter than this no more than 4 s are ever lost


def run_annealing(folder: Path, settings: Settings, force: bool = False, flat: bool = False) -> int:
    """Anneal from the start into `folder` and return the exit code, 128 + signal for a run that was stopped.

    `flat` leaves out the pictures in three dimensions.
    Raises `ValueError` for bad settings or backbones, and for a folder that holds files (unless forced), that
    another run is at, or that can't be written; nothing is written then.
    """
    check_folder(folder, force)
    initial, names = initial_backbones(settings, bent=isinstance(settings.place, Domain))
    precise = jnp.result_type(float) == jnp.float64
    settings = replace(settings, cells=len(initial), x64=precise)
    annealer = settings.annealer(settings.sweeps)
    with Stop() as stop, alone(folder):
        check_folder(folder, force)  # another run may just have ended there
        return _go_on(begin(folder, settings, annealer, initial, names), stop, flat)


def resume_annealing(folder: Path, given: Mapping[str, Any], finish: bool = False, flat: bool = False) -> int:
    """Take up the run in `folder` at its checkpoint and return the exit code, as `run_annealing`.

    Of the `given` settings only `sweeps` may differ from those of the run, and only grow. To `finish` is to
    leave what a run leaves, of the sweeps that were played; it can still be taken up afterwards. A finished
    run is left as it is, unless it is to finish again. The run's own precision is used; a change of what else
    decides bits is warned of. Raises `ValueError` for other settings or backbones, and for damaged files.
    """
    if not (folder / "checkpoint.npz").is_file():
        raise ValueError(f"{folder} contains no checkpoint to resume; remove --resume to start a new run there")
    if finish and "sweeps" in given:
        raise ValueError("--finish runs no more sweeps; remove --sweeps")
    with Stop() as stop, alone(folder):
        run = take_up(folder, given, finish)
        if run is None:
            say(f"the run in {folder} is already finished; increase --sweeps to continue it")
            return 0
        if changes := other_bits([run.manifest, *run.manifest["resumed"]][-1]):
            say(f"warning: round-off may differ from that of an uninterrupted run: {changes}")
        if finish and not run.manifest["finished"]:
            run.cut()
            _finish(run, flat)
            return 0
        run.note_resumption()
        run.cut()
        return _go_on(run, stop, flat)


def _go_on(run: Run, stop: Stop, flat: bool) -> int:
    """Sweep until the run ends or is stopped, then finish or leave it; the exit code."""
    compiled_before = run.manifest["compile_seconds"]
    preparation = Preparation()
    preparation.add("tools", partial(_read_tools, flat or run.settings.no_contacts))
    preparation.add("maps 0", partial(_maps, run, run.kept[0]))
    ended = _sweep(run, stop, preparation)
    run.manifest["compile_seconds"] = compiled_before + run.annealer.compile_seconds
    if ended:
        _finish(run, flat, preparation)
        return 0
    assert stop.signal is not None
    run.write_manifest()
    at = f"after sweep {run.state.sweep} of {run.settings.sweeps}"
    say(f"stopped by {stop.signal.name} {at}; continue with: jaxtissue anneal --out {run.folder} --resume")
    return 128 + stop.signal


def _sweep(run: Run, stop: Stop, preparation: Preparation) -> bool:
    """Sweep, write each row, save every few seconds; whether the run came to its end."""
    path, settings = run.folder / "sweeps.csv", run.settings
    energies, watch = storage.read_sweeps(path)["energy"].tolist(), AcceptanceWatch(settings.cells)

    def ended() -> bool:
        stalled = settings.patience > 0 and has_stalled(energies, settings.patience)
        return stalled or run.state.sweep >= settings.sweeps

    bar = tqdm(total=settings.sweeps, initial=run.state.sweep, desc="compiling", unit="sweep", disable=None)
    with open_own(path, "a") as table, bar:
        compiling, saved = True, time.monotonic()
        while not (ended() or stop.signal):
            last_chunk = settings.sweeps - run.state.sweep <= SPAN
            if time.monotonic() - saved > CHECKPOINT_SECONDS or last_chunk:
                os.fsync(table.fileno())
                run.save()
                saved = time.monotonic()
            run.state, records, trail = run.annealer.advance(run.state)
            for record, positions in zip(records, trail, strict=True):
                run.rows.update(storage.write_sweep(table, record))
                energies.append(record.energy)
                if record.sweep in KEPT_SWEEPS:
                    run.kept[record.sweep] = positions
            if compiling:
                compiling = False
                told = f"acceptance rate {records[-1].acceptance:.2g} in sweep {records[-1].sweep}"
                say(f"compiled in {run.annealer.compile_seconds:.1f} s; {told}")
                bar.set_description("annealing", refresh=False)
            for sweep in run.kept.keys() - {settings.sweeps}:  # now that what measures them is compiled
                preparation.add(f"volumes {sweep}", partial(_volumes, run, run.kept[sweep]))
            if doubt := watch.doubt(records):
                say(f"warning: {doubt}")
            bar.update(len(records))
            shown = {"energy": f"{records[-1].energy:.4g}", "acceptance": f"{records[-1].acceptance:.2f}"}
            bar.set_postfix(shown | {"rounds": records[-1].rounds})
        os.fsync(table.fileno())
        run.save()
    return ended()


def _finish(run: Run, flat: bool, preparation: Preparation | None = None) -> None:
    """Write the results of a run, tables, figures and the manifest, print them, and leave its page.

    A run that came to its end, with a preparation, is finished by its manifest.
    """
    from jaxtissue.runs.plots import Tissue, plot_energy, plot_surfaces, plot_volumes, save_figure
    from jaxtissue.runs.viewing import leave_pictures

    model, settings = run.annealer.model, run.settings
    connectivity, place = None, run.state.positions
    beside = preparation or Preparation()
    beside.add(f"maps {run.state.sweep}", partial(_maps, run, place))
    if "tissue" in formats.LEFT and not (flat or settings.no_contacts):
        beside.add("outside", partial(_outside, run))
    say(
        "measuring cells and drawing figures"
        if settings.no_contacts
        else "measuring cells and contacts, drawing figures"
    )
    if not settings.no_contacts:
        connectivity = contacts_of_run(place, model.domain, settings.minimum_contact)
    columns, summary = tabulate_cells(place, model, settings.resolution, run.names, connectivity)
    storage.write_backbones(run.folder / "backbones.csv", place, run.names, column_names(model.domain))
    storage.write_table(run.folder / "cells.csv", columns)
    if connectivity is not None:
        write_contacts(run.folder, connectivity)
        summary |= contact_summary(connectivity)
    shown = run.kept | {run.state.sweep: place}
    ends = (0, run.state.sweep)
    drawn = _a_few([sweep for sweep in shown if sweep < ends[1]])
    volumes = {sweep: beside.take(f"volumes {sweep}", partial(_volumes, run, shown[sweep])) for sweep in drawn}
    volumes[ends[1]] = columns["volume"]
    measured = [ends[1]], [summary["energy"]]
    sweeps = storage.read_sweeps(run.folder / "sweeps.csv")
    tissues = [Tissue(f"sweep {sweep}", shown[sweep], volumes[sweep], beside.take(f"maps {sweep}")) for sweep in ends]
    figures: list[Any] = [
        partial(plot_energy, sweeps, measured, "total, measured as in cells.csv"),
        partial(plot_volumes, list(volumes), list(volumes.values()), float(model.mean_volume)),
        partial(plot_surfaces, model.domain, tissues),
    ]
    for name, draw in zip(FIGURES, figures, strict=True):
        save_figure(run.folder / name, draw)
    energy = {"initial": sweeps["energy"][0], "final": sweeps["energy"][-1]}
    energy |= {"final_measured": summary["energy"]}
    news = {"energy": energy, "final": {"sweep": run.state.sweep} | summary}
    run.write_manifest(**news, finished=now() if preparation else None, files=run.checksums(*RESULTS))
    _print_result(run)
    tissue = TissueRecord(np.asarray(place, float), model.domain, run.names, traced=connectivity)
    leave_pictures(tissue, run.folder, flat or settings.no_contacts, beside.take("outside"))


def _read_tools(flat: bool) -> None:
    """Import what draws, and read the fonts."""
    from jaxtissue.runs.plots import read_fonts
    from jaxtissue.runs.viewing import import_pictures

    read_fonts()
    if not flat:
        import_pictures()


def _maps(run: Run, positions: np.ndarray) -> dict[str, list[Any]]:
    """The surfaces of a tissue of the run."""
    from jaxtissue.runs.plots import map_surfaces

    return map_surfaces(positions, run.annealer.model.domain)


def _outside(run: Run) -> list[Any]:
    """The outside of the last tissue, as its picture shows it."""
    from jaxtissue.runs.viewing import outside_of

    return outside_of(run.state.positions, run.annealer.model.domain)


def _volumes(run: Run, positions: np.ndarray) -> np.ndarray:
    """The volumes of a tissue of the run, measured as while annealing."""
    return np.asarray(run.annealer.measure(positions).volume)


def _a_few(sweeps: list[int]) -> list[int]:
    """At most six of the kept sweeps, the first and the last among them."""
    picked = np.unique(np.linspace(0, len(sweeps) - 1, min(6, len(sweeps))).round().astype(int))
    return [sweeps[i] for i in picked]


def _print_result(run: Run) -> None:
    energy, final = run.manifest["energy"], run.manifest["final"]
    print(f"cells            {run.settings.cells}")
    print(f"sweeps           {run.state.sweep}")
    first, last = energy["initial"], energy["final"]
    share = f" ({100 * last / first:.3g} %)" if first > 0 else ""
    print(f"{f'energy, {run.settings.resolution}':17}{first:.6g} -> {last:.6g}{share}")
    print(f"{'energy, measured':17}{energy['final_measured']:.6g}")
    shown = ("separation", "covering_radius", "tightness", "neighbors", "transitions", "scutoid_fraction")
    for name in shown:
        if name in final:
            print(f"{name:17}{final[name]:.6g}")
    print(f"written to       {run.folder}")
