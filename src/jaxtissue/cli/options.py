"""The options of the command line, and the checks that need no file."""

import argparse
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from jaxtissue.cli import help_texts
from jaxtissue.cli.values import count_of, number_of, part_of, resolution_of
from jaxtissue.geometry.tube import TUBE_SIZES
from jaxtissue.images.shapes import FITTERS
from jaxtissue.minimization.relaxation import ITERATIONS, METHODS
from jaxtissue.runs.formats import FORMATS, UNITS, VIEWED
from jaxtissue.runs.relaxing import Descent
from jaxtissue.runs.settings import Settings

_SIZES = {"length": "length of the tube", "apical_radius": "radius of the lumen", "basal_radius": "outer radius"}


def command_parser() -> argparse.ArgumentParser:
    """The parser of all commands; it raises `ValueError` for what it can't take.

    `anneal` leaves out the settings that are not given, since a resumed run has its own.
    """
    layout = argparse.RawDescriptionHelpFormatter
    parser = _Parser(
        prog="jaxtissue", description=help_texts.OVERVIEW, epilog=help_texts.FIRST_STEPS, formatter_class=layout
    )
    parser.add_argument("--version", action="version", version=f"jaxtissue {version('jaxtissue')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    options = {
        name: commands.add_parser(
            name,
            help=text,
            description=help_texts.DESCRIPTIONS[name],
            epilog=help_texts.EXAMPLES[name],
            formatter_class=layout,
            allow_abbrev=False,
        )
        for name, text in help_texts.SUMMARIES.items()
    }
    for name, command in options.items():
        default = argparse.SUPPRESS if name in ("anneal", "relax") else False
        command.add_argument(
            "--x64", action="store_true", default=default, help="compute in 64 bits (double precision)"
        )
    _add_anneal(options["anneal"])
    _add_relax(options["relax"])
    for name in ("measure", "compare"):
        command = options[name]
        command.add_argument("file", type=Path, metavar="FILE", help=help_texts.BACKBONES)
        command.add_argument("--degrees", action="store_true", help=help_texts.DEGREES)
        _add_domain(command)
        for size in TUBE_SIZES:
            text = f"{_SIZES[size]}; required without --domain"
            _add(command, size, text, None, type=number_of(0, above=True), metavar="X")
        _add_folder(command, required=name == "measure")
    _add_grid(options["grid"])
    _add_measure(options["measure"])
    _add_fit(options["fit"])
    _add_reproduce(options["reproduce"])
    _add_export(options["export"])
    _add_view(options["view"])
    text = "sample points per backbone of the independent method (default: 50)"
    options["compare"].add_argument("--samples", type=count_of(2, 10_000), default=50, metavar="S", help=text)
    return parser


def _add_anneal(command: argparse.ArgumentParser) -> None:
    _add_folder(command, required=True)
    _add_flat(command)
    command.add_argument("--resume", action="store_true", help="continue the run in DIR; --sweeps may be larger")
    command.add_argument("--finish", action="store_true", help="with --resume: make no more sweeps, only write the "
                         "tables and figures of the sweeps so far; --resume can still continue")  # fmt: skip
    size, whole = number_of(0), count_of(0)
    kinds: dict[str, tuple[Callable[[str], Any], str, str]] = {
        "sweeps": (whole, "N", "number of sweeps; a sweep proposes one move per cell"),
        "temperature": (size, "T", "temperature; at 0 only moves that do not raise the energy are accepted"),
        "final_temperature": (
            number_of(0, above=True),
            "T",
            help_texts.COOLING,
        ),
        "patience": (whole, "N", "stop when the energy has not fallen for N sweeps; 0: never"),
    }
    sweeps = command.add_argument_group("sweeps")
    for name, (kind, metavar, text) in kinds.items():
        _add(sweeps, name, text, getattr(Settings, name), type=kind, metavar=metavar)
    _add(sweeps, "algorithm", help_texts.ALGORITHM, Settings.algorithm,
         choices=("is-mh", "mh"))  # fmt: skip
    _add_start(command)


def _add_relax(command: argparse.ArgumentParser) -> None:
    _add_folder(command, required=True)
    descent = command.add_argument_group("minimization")
    descent.add_argument("--method", choices=METHODS, default=Descent.method, help=
                         f"{help_texts.METHODS} (default: {Descent.method})")  # fmt: skip
    descent.add_argument("--steps", type=count_of(0), default=Descent.steps, metavar="N", help=
                         f"maximum number of steps of {ITERATIONS} iterations (default: {Descent.steps})")  # fmt: skip
    descent.add_argument("--tolerance", type=number_of(0, above=True), default=Descent.tolerance, metavar="F", help=
                         f"{help_texts.DESCENT_TOLERANCE} (default: {Descent.tolerance:g})")  # fmt: skip
    _add_start(command)


def _add_start(command: argparse.ArgumentParser) -> None:
    """The tissue to start from, its energy, and the contacts to report."""
    positive, size = number_of(0, above=True), number_of(0)
    tissue = command.add_argument_group("tissue")
    start = tissue.add_mutually_exclusive_group()
    _add(start, "cells", "start from N random cells", Settings.cells, type=count_of(1), metavar="N")
    _add(start, "backbones", "start from the backbones in this CSV table", None, metavar="FILE")
    tissue.add_argument("--degrees", action="store_true", default=argparse.SUPPRESS, help=help_texts.DEGREES)
    for name, text in _SIZES.items():
        _add(tissue, name, text, getattr(Settings, name), type=positive, metavar="X")
    _add_domain(tissue)
    seeds = count_of(0, 2**32 - 1)
    _add(tissue, "seed", "seed of the random cells and moves", Settings.seed, type=seeds, metavar="S")
    energy = command.add_argument_group("energy")
    kinds: dict[str, tuple[Callable[[str], Any], str, str]] = {
        "modulus": (size, "K", help_texts.MODULUS),
        "tension": (size, "LAMBDA", help_texts.TENSION),
        "resolution": (resolution_of, "NAME", help_texts.RESOLUTION),
    }
    for name, (kind, metavar, text) in kinds.items():
        _add(energy, name, text, getattr(Settings, name), type=kind, metavar=metavar)
    energy.add_argument("--relative", action="store_true", default=argparse.SUPPRESS, help=help_texts.RELATIVE)
    _add_contacts(command.add_argument_group("contacts"), argparse.SUPPRESS, argparse.SUPPRESS)


def _add_domain(command: Any) -> None:
    _add(command, "domain", "JSON file with the shape and sizes of the tissue, in place of the sizes of the tube", None,
         type=Path, metavar="FILE")  # fmt: skip


def _add_grid(command: argparse.ArgumentParser) -> None:
    command.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder, new or to be continued")
    command.add_argument("--force", action="store_true", help="discard the results in DIR and start again")
    positive, size = number_of(0, above=True), number_of(0)
    axes: dict[str, tuple[Callable[[str], Any], str, str]] = {
        "length": (positive, "X", "length of the tube"),
        "basal_radius": (positive, "X", "outer radius"),
        "ratio": (number_of(1, above=True), "X", "surface ratio: outer radius / radius of the lumen"),
        "apical_radius": (positive, "X", "radius of the lumen, in place of --ratio"),
        "cells": (count_of(1), "N", "number of cells"),
        "modulus": (size, "K", help_texts.MODULUS),
        "tension": (size, "LAMBDA", help_texts.TENSION),
        "temperature": (size, "T", "temperature; the initial one with --final-temperature"),
        "seed": (count_of(0, 2**32 - 1), "S", "seed of the random cells and moves"),
    }
    grid = command.add_argument_group("grid parameters (one or more values each)")
    for name, (kind, metavar, text) in axes.items():
        default = getattr(Settings, name, None)
        _add(grid, name, text, default, type=kind, metavar=metavar, nargs="+")
    shared = command.add_argument_group("settings that all rows share")
    _add_domain(shared)
    _add(
        shared,
        "sweeps",
        "number of sweeps; a sweep proposes one move per cell",
        Settings.sweeps,
        type=count_of(0),
        metavar="N",
    )
    _add(
        shared,
        "final_temperature",
        help_texts.COOLING,
        None,
        type=positive,
        metavar="T",
    )
    _add(shared, "resolution", help_texts.RESOLUTION, Settings.resolution,
         type=resolution_of, metavar="NAME")  # fmt: skip
    _add(shared, "algorithm", help_texts.ALGORITHM, Settings.algorithm,
         choices=("is-mh", "mh"))  # fmt: skip
    shared.add_argument("--relative", action="store_true", default=argparse.SUPPRESS, help=help_texts.RELATIVE)
    _add_contacts(shared, argparse.SUPPRESS, argparse.SUPPRESS)
    _add_work(command.add_argument_group("distribution of the work"))


def _add_work(work: Any) -> None:
    work.add_argument("--batch", type=count_of(1), metavar="N", help="number of rows to anneal together "
                      "(default: 4 per processor core, 64 per GPU)")  # fmt: skip
    parts = work.add_mutually_exclusive_group()
    parts.add_argument("--part", type=part_of, metavar="K/N", help="compute part K of N, from 1/N to N/N")
    parts.add_argument("--slurm", action="store_true", help="compute the part of this job in a Slurm array")
    parts.add_argument("--distributed", action="store_true", help="share the rows with other processes "
                       "through jax.distributed, configured by the environment or the next two options")  # fmt: skip
    work.add_argument("--coordinator", metavar="HOST:PORT", help="address of the first process")
    work.add_argument("--process", type=part_of, metavar="K/N", help="this process is number K of N")


def _add_measure(command: argparse.ArgumentParser) -> None:
    size = number_of(0)
    command.add_argument("--resolution", type=resolution_of, default="standard", metavar="NAME", help=
                         f"{help_texts.RESOLUTION} (default: standard); in tubes it applies only with --no-contacts, "
                         "otherwise sizes come from traced edges")  # fmt: skip
    command.add_argument("--tolerance", type=number_of(0, above=True), metavar="T", help="measure volumes and "
                         "lateral areas within T of the mean cell, e.g. 0.001; warn where that is not certain; "
                         "tubes only")  # fmt: skip
    for name, metavar, text in (("modulus", "K", help_texts.MODULUS), ("tension", "LAMBDA", help_texts.TENSION)):
        default = getattr(Settings, name)
        command.add_argument(
            _option(name), type=size, default=default, metavar=metavar, help=f"{text} (default: {default})"
        )
    _add_contacts(command, Settings.minimum_contact, Settings.no_contacts)
    _add_flat(command)
    command.add_argument("--graph", action="store_true", help="also write the contact graph, graph.graphml")


def _add_export(command: argparse.ArgumentParser) -> None:
    command.add_argument("run", type=Path, metavar="RUN", help=help_texts.RUN)
    command.add_argument("--to", nargs="+", required=True, choices=FORMATS, metavar="FORMAT",
                         help=f"one or more of {', '.join(FORMATS)}")  # fmt: skip
    command.add_argument("--spacing", nargs=3, type=number_of(0, above=True), metavar=("Z", "Y", "X"), help=
                         "sides of a voxel of label images (default: a tenth of the mean cell's side)")  # fmt: skip
    command.add_argument("--unit", choices=UNITS, default="", help="unit of length of the run, stored in the files")
    _add_folder(command, required=True)


def _add_fit(command: argparse.ArgumentParser) -> None:
    command.add_argument("file", type=Path, metavar="LABELS", help="label image, axes z, y, x, one number per cell, 0 "
                         "outside: .tif, .tiff or .npy")  # fmt: skip
    command.add_argument("--spacing", type=number_of(0, above=True), nargs=3, metavar=("Z", "Y", "X"), help=
                         "sides of a voxel (default: read from the file)")  # fmt: skip
    command.add_argument("--shape", choices=tuple(FITTERS), default="tube", help="shape of the tissue: slab is a flat "
                         "sheet, sphere and ellipsoid are closed round a lumen (default: tube)")  # fmt: skip
    command.add_argument("--nodes", type=count_of(1), default=1, metavar="K", help=help_texts.NODES)
    _add_flat(command)
    _add_folder(command, required=True)


def _add_view(command: argparse.ArgumentParser) -> None:
    command.add_argument("run", type=Path, metavar="RUN", help=help_texts.RUN)
    command.add_argument("--what", choices=VIEWED, default="tissue", metavar="WHAT",
                         help=f"one of {', '.join(VIEWED)} (default: tissue)")  # fmt: skip
    command.add_argument(
        "--cell", type=count_of(0), metavar="N", help="number of the cell to draw, for --what cell, scutoid or internal"
    )
    command.add_argument("--unit", choices=UNITS, default="", help="unit of length of the run, for the scale bar")
    text = "picture to write, a movie as .gif or .mp4 (default: WHAT.png or WHAT.gif in RUN)"
    command.add_argument("--out", type=Path, metavar="FILE", help=text)


def _add_contacts(command: Any, minimum: Any, without: Any) -> None:
    text = f"{help_texts.MINIMUM} (default: {Settings.minimum_contact:g})"
    command.add_argument("--minimum-contact", type=number_of(0), default=minimum, metavar="F", help=text)
    command.add_argument("--no-contacts", action="store_true", default=without, help=help_texts.NO_CONTACTS)


def _add_reproduce(command: argparse.ArgumentParser) -> None:
    command.add_argument("items", nargs="*", metavar="ITEM", help="table1, fig5, fig7 ... fig16 (default: all)")
    command.add_argument("--quick", action="store_true", help="smaller tissues and fewer runs; takes minutes")
    command.add_argument(
        "--seeds", type=count_of(2, 1000), metavar="N", help="number of runs per mean (default: 10; with --quick 2)"
    )
    command.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder, new or to be continued")
    command.add_argument("--force", action="store_true", help="recompute the results in DIR")


def _add(command: Any, name: str, text: str, default: Any, **options: Any) -> None:
    """Add a setting of `anneal`, with its default in the help only."""
    text += "" if default is None else f" (default: {default})"
    command.add_argument(_option(name), default=argparse.SUPPRESS, help=text, **options)


def _add_flat(command: argparse.ArgumentParser) -> None:
    command.add_argument("--flat", action="store_true", help="do not draw 3D pictures")


def _add_folder(command: argparse.ArgumentParser, required: bool) -> None:
    command.add_argument("--out", type=Path, required=required, metavar="DIR", help="output folder")
    command.add_argument("--force", action="store_true", help="write to DIR even if it contains files")


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are exceptions, so that every bad input ends in the same one line."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)
