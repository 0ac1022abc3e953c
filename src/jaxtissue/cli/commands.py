"""The command line. Results go to stdout, progress and errors to stderr.

What only one command needs, it imports itself: to import matplotlib or the reproduction takes half a second.
"""

import os
import signal
import sys
import time
import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtissue.cli.information import info
from jaxtissue.cli.inputs import (
    find_part,
    found_contacts,
    given_domain,
    need_relative,
    read_tissue,
    refuse_both,
    refuse_tolerance,
)
from jaxtissue.cli.options import command_parser
from jaxtissue.compilation import program_cache
from jaxtissue.compilation.batching import keep_compiled
from jaxtissue.compilation.devices import use_cores
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.dynamics.metropolis import warn_of_coarse_places
from jaxtissue.energy import tube_model
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domain_files import domain_values, load_domain
from jaxtissue.geometry.tube import TUBE_SIZES, Tube
from jaxtissue.runs import storage
from jaxtissue.runs.annealing import resume_annealing, run_annealing
from jaxtissue.runs.grids import AXES, SIZES, Grid
from jaxtissue.runs.reports import (
    compare_presets,
    contact_summary,
    tabulate_cells,
    write_contacts,
)
from jaxtissue.runs.run_folders import CELLS, FILES, SUMMARY, save_tissue
from jaxtissue.runs.settings import Settings, provenance
from jaxtissue.system.files import check_folder, make_folder, write_json
from jaxtissue.system.locks import alone
from jaxtissue.system.streams import open_streams

CONFIG: Any = jax.config  # its settings are not declared


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 bad input, 128 + signal stopped, 1 other."""
    open_streams()
    try:
        parser = command_parser()
        arguments = vars(parser.parse_args(argv))
        if arguments["command"] is None:
            parser.print_help()
            return 0
        work = {"anneal": anneal, "relax": relax, "grid": grid, "measure": measure, "compare": compare, "fit": fit}
        work |= {"reproduce": reproduce_paper, "info": info}
        work |= {name: partial(with_tissue, name) for name in ("export", "view")}
        warnings.formatwarning = lambda message, *_, **__: f"jaxtissue: warning: {message}\n"
        if CONFIG.jax_enable_x64 and not arguments.get("resume"):
            arguments["x64"] = True  # as JAX_ENABLE_X64 says; a run that is resumed keeps its own
        keep_compiled()
        with usual_modes():
            code = work[arguments.pop("command")](arguments)
        sys.stdout.flush()  # or it is only told at the very end that the reader has left
        return code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE  # without a word, as other commands of a pipe
    except ValueError as error:
        return _fail(error, 2)
    except OSError as error:
        return _fail(error, 1)
    except (RuntimeError, AssertionError):
        if _has_device():
            program_cache.forget_loaded()
            raise
        return _fail(f"JAX has no device for JAX_PLATFORMS={CONFIG.jax_platforms}; correct or unset this variable", 2)
    except MemoryError as error:
        return _fail(f"out of memory ({error}); use fewer cells", 1)
    except KeyboardInterrupt:
        return _fail("stopped by Ctrl-C; the results saved so far are kept", 130)


def anneal(arguments: dict[str, Any]) -> int:
    """Anneal a tissue into a folder, or take up a run there."""
    use_cores(1)
    folder, force, flat = (arguments.pop(name) for name in ("out", "force", "flat"))
    resume, finish = (arguments.pop(name) for name in ("resume", "finish"))
    if domain := given_domain(arguments, load_domain):
        is_tube = isinstance(domain, Tube)
        arguments |= {s: getattr(domain, s) for s in TUBE_SIZES} if is_tube else {"domain": domain_values(domain)}
    if resume:
        return resume_annealing(folder, arguments, finish, flat)
    if finish:
        raise ValueError("--finish applies to a run that was stopped; add --resume")
    refuse_both(arguments, "minimum_contact")
    need_relative(arguments, arguments)
    settings = Settings(**arguments)
    if settings.final_temperature is not None and not settings.temperature > 0:
        raise ValueError("--final-temperature requires a positive initial temperature; give a --temperature above 0")
    _use_x64(settings.x64)
    return run_annealing(folder, settings, force, flat)


def relax(arguments: dict[str, Any]) -> int:
    """Relax a tissue into a folder."""
    from jaxtissue.runs.relaxing import Descent, run_relaxation

    use_cores(1)
    folder, force = (arguments.pop(name) for name in ("out", "force"))
    descent = Descent(**{name: arguments.pop(name) for name in ("method", "steps", "tolerance")})
    if domain := given_domain(arguments, load_domain):
        is_tube = isinstance(domain, Tube)
        arguments |= {s: getattr(domain, s) for s in TUBE_SIZES} if is_tube else {"domain": domain_values(domain)}
    refuse_both(arguments, "minimum_contact")
    need_relative(arguments, arguments | {"temperature": None})
    settings = Settings(**arguments)
    _use_x64(settings.x64)
    return run_relaxation(folder, settings, descent, force)


def grid(arguments: dict[str, Any]) -> int:
    """Anneal a grid of tissues into one table, or what is missing of it."""
    from jaxtissue.runs.grid_runs import check_grid_folder, run_grid

    folder, force, batch = (arguments.pop(name) for name in ("out", "force", "batch"))
    places = [arguments.pop(name) for name in ("part", "slurm", "distributed", "coordinator", "process")]
    _use_x64(arguments["x64"])
    refuse_both(arguments, "minimum_contact")
    if domain := given_domain(arguments, load_domain, SIZES):
        is_tube = isinstance(domain, Tube)
        arguments |= {s: [getattr(domain, s)] for s in TUBE_SIZES} if is_tube else {"domain": domain_values(domain)}
    axes = {name: arguments.pop(name) for name in AXES if name in arguments}
    need_relative(arguments, axes)
    runs = Grid(axes, arguments)
    if runs.shared.get("final_temperature") and min(axes.get("temperature", [1.0])) == 0:
        raise ValueError("--final-temperature requires a positive initial temperature; give a --temperature above 0")
    check_grid_folder(folder, runs, force)
    part = find_part(*places)
    use_cores(min(len(part.share(runs.rows)), batch or len(runs.rows)))
    return run_grid(folder, runs, part, force, batch)


def measure(arguments: dict[str, Any]) -> int:
    """Measure the cells of given backbones, and find their contacts."""
    from jaxtissue.runs import plots
    from jaxtissue.runs.viewing import leave_pictures

    folder = arguments["out"]
    refuse_both(arguments, "minimum_contact", "graph")
    check_folder(folder, arguments["force"])
    _use_x64(arguments["x64"])
    domain, backbones = read_tissue(arguments)
    refuse_tolerance(domain, arguments["tolerance"])
    place, connectivity, tracing = backbones.positions, None, 0.0
    if not arguments["no_contacts"]:
        _say(f"tracing the contacts of {len(place)} cells")
        begun = time.perf_counter()
        connectivity = found_contacts(place, domain, arguments["minimum_contact"])
        tracing = time.perf_counter() - begun
    _say(f"measuring {len(place)} cells")
    model = tube_model(domain, len(place), arguments["modulus"], arguments["tension"])
    if isinstance(domain, Tube):
        warn_of_coarse_places(model, len(place), np.dtype(jnp.result_type(float)))
    begun = time.perf_counter()
    columns, summary = tabulate_cells(
        place, model, arguments["resolution"], backbones.names, connectivity, arguments["tolerance"]
    )
    summary["seconds"] = time.perf_counter() - begun
    with alone(folder):
        make_folder(folder, FILES)
        save_tissue(folder, domain, backbones)
        storage.write_table(folder / CELLS, columns)
        if connectivity is not None:
            write_contacts(folder, connectivity, columns if arguments["graph"] else None)
            summary |= contact_summary(connectivity) | {"contact_seconds": tracing}
        write_json(folder / SUMMARY, summary)
        _print_summary(summary)
        shown = plots.Tissue("unrolled" if plots.unrolls(domain) else "", place, columns["volume"])
        plots.save_figure(folder / "surfaces.png", partial(plots.plot_surfaces, domain, [shown]))
        tissue = TissueRecord(place, domain, backbones.names, traced=connectivity)
        leave_pictures(tissue, folder, arguments["flat"] or connectivity is None)
    return 0


def fit(arguments: dict[str, Any]) -> int:
    """Fit a tissue to a segmented image, into files that `measure` and `anneal` take."""
    from jaxtissue.runs.fit_runs import run_fit

    folder = arguments["out"]
    check_folder(folder, arguments["force"])
    _use_x64(arguments["x64"])
    _say(f"fitting a {arguments['shape']} to {arguments['file']}")
    file, spacing, shape = (arguments[name] for name in ("file", "spacing", "shape"))
    report = run_fit(file, spacing, shape, folder, arguments["nodes"], arguments["flat"])
    for name, value in report.items():
        print(f"{name:28}{value:.6g}")
    print(f"written to {folder}; continue with:")
    further = f"--domain {folder / 'domain.json'} --out {folder / 'measured'}"
    print(f"  jaxtissue measure {folder / 'backbones.csv'} {further}")
    return 0


def compare(arguments: dict[str, Any]) -> int:
    """Show the errors of each preset against the exact path."""
    folder, samples = arguments["out"], arguments["samples"]
    if folder:
        check_folder(folder, arguments["force"])
    _use_x64(arguments["x64"])
    domain, backbones = read_tissue(arguments)
    errors, exact_seconds = compare_presets(backbones.positions, domain, samples)
    if folder:
        make_folder(folder)
        storage.write_table(folder / "compare.csv", errors)
        rows = [dict(zip(errors, row, strict=True)) for row in zip(*errors.values(), strict=True)]
        summary = {"samples": samples, "exact_seconds": exact_seconds, "presets": rows}
        write_json(folder / "compare.json", summary | provenance())
    print("  ".join(f"{name:>10}" for name in errors))
    for preset, *figures in zip(*errors.values(), strict=True):
        print("  ".join([f"{preset:>10}", *(f"{figure:10.2e}" for figure in figures)]))
    print(f"errors relative to the mean cell; reference: {samples} samples per backbone, {exact_seconds:.3g} s")
    return 0


def reproduce_paper(arguments: dict[str, Any]) -> int:
    """Make the paper's table and figures, and a report that sets its numbers beside ours."""
    from jaxtissue.reproduction.reproduce import choose_items, make_plan, reproduce
    from jaxtissue.reproduction.workers import Workers, free_cores

    items = choose_items(arguments["items"])
    _use_x64(arguments["x64"])
    use_cores(1)
    plan = make_plan(arguments["quick"], arguments["seeds"])
    with Workers(free_cores()) as workers, alone(arguments["out"], what="a reproduction"):
        manifest = reproduce(arguments["out"], items, plan, arguments["force"], workers)
    for item in items:
        print(f"{item:8}{manifest['items'][item]['seconds']:10.1f} s")
    print(f"written to {arguments['out'] / 'report.md'}")
    return 0


def with_tissue(command: str, arguments: dict[str, Any]) -> int:
    """Export the tissue of a run, or draw it."""
    from jaxtissue.cli.tissue_commands import COMMANDS

    _use_x64(arguments["x64"])
    return COMMANDS[command](arguments)


def _print_summary(summary: dict[str, Any]) -> None:
    """A line for each value; those of the inner cells beside those of all."""
    inner = summary.get("inner", {})
    for name, value in summary.items():
        if name == "inner":
            continue
        if name == "cells":
            print(f"\n{'':28}{'all':>12}{'inner':>12}")
        beside = f"{value:12.6g}{inner[name]:12.6g}" if name in inner else f"{value:.6g}"
        print(f"{name:28}{beside}")


def _use_x64(x64: bool) -> None:
    """Compute in 64 bits, or not, whatever the environment says."""
    jax.config.update("jax_enable_x64", x64)


def _has_device() -> bool:
    """Whether JAX starts; if not, it says so with one error or another, or only in its log."""
    try:
        return bool(jax.devices())
    except (RuntimeError, AssertionError):
        return CONFIG.jax_platforms is None


def _say(text: str) -> None:
    """Print what takes the time, where the output is a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)


def _fail(message: object, code: int) -> int:
    print("jaxtissue: error:", " ".join(str(message).split()), file=sys.stderr)
    return code
