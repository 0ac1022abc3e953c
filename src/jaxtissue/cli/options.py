"""The options of the command line, and the checks that need no file."""

import argparse
import math
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from jaxtissue.geometry.tube import TUBE_SIZES
from jaxtissue.images.shapes import FITTERS
from jaxtissue.measurement.quadrature import as_resolution
from jaxtissue.minimization.relaxation import ITERATIONS, METHODS
from jaxtissue.runs.formats import FORMATS, UNITS, VIEWED
from jaxtissue.runs.relaxing import Descent
from jaxtissue.runs.settings import Settings

DEGREES = "angles of the table are degrees, not radians"
RELATIVE = (
    "K, LAMBDA and T without units: volumes in units of the mean cell's, Vbar, areas of Vbar^(2/3); the "
    "paper's tube of 500 cells has --tension 0.0016 --temperature 0.0005"
)
_HELP = {
    "anneal": "anneal a tissue into a folder, or take up a run there",
    "relax": "relax a tissue down the gradient of its energy into a folder",
    "grid": "anneal a grid of tissues into one table, or what is missing of it",
    "measure": "measure the cells of given backbones",
    "fit": "fit a tissue to a segmented image",
    "compare": "show the errors of each preset against the exact path",
    "reproduce": "make the paper's table and figures, and a report that sets its numbers beside ours",
    "export": "write a run's tissue in the formats of other programs",
    "view": "draw a run's tissue in three dimensions",
    "info": "show versions, devices, precision and the optional packages found",
}


def command_parser() -> argparse.ArgumentParser:
    """The parser of all commands; it raises `ValueError` for what it can't take.

    `anneal` leaves out the settings that are not given, since a resumed run has its own.
    """
    parser = _Parser(prog="jaxtissue", description="3D epithelial tubes: cells as Voronoi cells of backbones")
    parser.add_argument("--version", action="version", version=f"jaxtissue {version('jaxtissue')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    options = {
        name: commands.add_parser(name, help=text, description=text, allow_abbrev=False) for name, text in _HELP.items()
    }
    for name, command in options.items():
        default = argparse.SUPPRESS if name in ("anneal", "relax") else False
        command.add_argument("--x64", action="store_true", default=default, help="compute in 64 bits")
    _add_anneal(options["anneal"])
    _add_relax(options["relax"])
    for name in ("measure", "compare"):
        command = options[name]
        command.add_argument("file", type=Path, metavar="FILE", help="CSV: columns axial,angle, or the domain's")
        command.add_argument("--degrees", action="store_true", help=DEGREES)
        _add_domain(command)
        for size in TUBE_SIZES:
            _add(command, size, "size of the tube, if there is no --domain", None, type=_number(0, above=True),
                 metavar="X")  # fmt: skip
        _add_folder(command, required=name == "measure")
    _add_grid(options["grid"])
    _add_measure(options["measure"])
    _add_fit(options["fit"])
    _add_reproduce(options["reproduce"])
    _add_export(options["export"])
    _add_view(options["view"])
    options["compare"].add_argument(
        "--samples", type=_count(2, 10_000), default=50, metavar="S", help="points per backbone (default: 50)"
    )
    return parser


def _add_anneal(command: argparse.ArgumentParser) -> None:
    _add_folder(command, required=True)
    _add_flat(command)
    command.add_argument("--resume", action="store_true", help="go on with the run in DIR; --sweeps may grow")
    command.add_argument("--finish", action="store_true", help="with --resume: only draw up the tables and "
                         "figures of what was played; --resume can still go on")  # fmt: skip
    size, whole = _number(0), _count(0)
    kinds: dict[str, tuple[Callable[[str], Any], str, str]] = {
        "sweeps": (whole, "N", "a sweep proposes one move per cell"),
        "temperature": (size, "T", "0 accepts only moves that lower the energy"),
        "final_temperature": (_number(0, above=True), "T", "cool down to it, by the same factor every sweep"),
        "patience": (whole, "N", "stop when the energy has not fallen for N sweeps, 0: never"),
    }
    for name, (kind, metavar, text) in kinds.items():
        _add(command, name, text, getattr(Settings, name), type=kind, metavar=metavar)
    _add(command, "algorithm", "rounds of independent moves, or one move at a time", Settings.algorithm,
         choices=("is-mh", "mh"))  # fmt: skip
    _add_start(command)


def _add_relax(command: argparse.ArgumentParser) -> None:
    _add_folder(command, required=True)
    command.add_argument("--method", choices=METHODS, default=Descent.method, help=
                         f"one of {', '.join(METHODS)} (default: {Descent.method})")  # fmt: skip
    command.add_argument("--steps", type=_count(0), default=Descent.steps, metavar="N", help=
                         f"the most steps, of {ITERATIONS} iterations each (default: {Descent.steps})")  # fmt: skip
    command.add_argument("--tolerance", type=_number(0, above=True), default=Descent.tolerance, metavar="F", help=
                         "end where the gradient is this fraction of that at the start "
                         f"(default: {Descent.tolerance:g})")  # fmt: skip
    _add_start(command)


def _add_start(command: argparse.ArgumentParser) -> None:
    """The tissue to start from, its energy, and what is told of it in the end."""
    positive, size = _number(0, above=True), _number(0)
    kinds: dict[str, tuple[Callable[[str], Any], str, str]] = {
        "length": (positive, "X", "length of the tube"),
        "apical_radius": (positive, "X", "radius of the lumen"),
        "basal_radius": (positive, "X", "outer radius"),
        "seed": (_count(0, 2**32 - 1), "S", "of the random cells and moves"),
        "modulus": (size, "K", "weight of the volume term"),
        "tension": (size, "LAMBDA", "weight of the area term"),
        "resolution": (_resolution, "NAME", "draft, standard, fine or LAYERSxDENSITY"),
    }
    for name, (kind, metavar, text) in kinds.items():
        _add(command, name, text, getattr(Settings, name), type=kind, metavar=metavar)
    _add_domain(command)
    command.add_argument("--relative", action="store_true", default=argparse.SUPPRESS, help=RELATIVE)
    _add_contacts(command, argparse.SUPPRESS, argparse.SUPPRESS)
    start = command.add_mutually_exclusive_group()
    _add(start, "backbones", "CSV of backbones to start from", None, metavar="FILE")
    command.add_argument("--degrees", action="store_true", default=argparse.SUPPRESS, help=DEGREES)
    _add(start, "cells", "number of random cells to start from", Settings.cells, type=_count(1), metavar="N")


def _add_domain(command: Any) -> None:
    _add(command, "domain", "JSON file of the tissue's shape and sizes, in place of the sizes of the tube", None,
         type=Path, metavar="FILE")  # fmt: skip


def _add_grid(command: argparse.ArgumentParser) -> None:
    command.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to make or go on with")
    command.add_argument("--force", action="store_true", help="begin anew what is there already")
    positive, size = _number(0, above=True), _number(0)
    axes: dict[str, tuple[Callable[[str], Any], str, str]] = {
        "length": (positive, "X", "lengths of the tube"),
        "basal_radius": (positive, "X", "outer radii"),
        "ratio": (_number(1, above=True), "X", "outer radius / radius of the lumen"),
        "apical_radius": (positive, "X", "radii of the lumen, in place of ratios"),
        "cells": (_count(1), "N", "numbers of cells"),
        "modulus": (size, "K", "weights of the volume term"),
        "tension": (size, "LAMBDA", "weights of the area term"),
        "temperature": (size, "T", "temperatures, or those to cool down from"),
        "seed": (_count(0, 2**32 - 1), "S", "of the random cells and moves"),
    }
    grid = command.add_argument_group("the grid, one or more values each")
    for name, (kind, metavar, text) in axes.items():
        default = getattr(Settings, name, None)
        _add(grid, name, text, default, type=kind, metavar=metavar, nargs="+")
    shared = command.add_argument_group("what all rows share")
    _add_domain(shared)
    _add(shared, "sweeps", "a sweep proposes one move per cell", Settings.sweeps, type=_count(0), metavar="N")
    _add(shared, "final_temperature", "cool down to it", None, type=positive, metavar="T")
    _add(shared, "resolution", "draft, standard, fine or LAYERSxDENSITY", Settings.resolution,
         type=_resolution, metavar="NAME")  # fmt: skip
    _add(shared, "algorithm", "rounds of independent moves, or one move at a time", Settings.algorithm,
         choices=("is-mh", "mh"))  # fmt: skip
    shared.add_argument("--relative", action="store_true", default=argparse.SUPPRESS, help=RELATIVE)
    _add_contacts(shared, argparse.SUPPRESS, argparse.SUPPRESS)
    work = command.add_argument_group("who does what")
    work.add_argument("--batch", type=_count(1), metavar="N", help="rows annealed together and kept as they "
                      "end (default: 4 for each processor core, 64 for each GPU)")  # fmt: skip
    parts = work.add_mutually_exclusive_group()
    parts.add_argument("--part", type=_part, metavar="K/N", help="do the K-th of N parts, from 1/N to N/N")
    parts.add_argument("--slurm", action="store_true", help="do this job's part of a Slurm array")
    parts.add_argument("--distributed", action="store_true", help="share the rows with other processes by "
                       "jax.distributed, as the environment tells or by the next two options")  # fmt: skip
    work.add_argument("--coordinator", metavar="HOST:PORT", help="where the first process listens")
    work.add_argument("--process", type=_part, metavar="K/N", help="this is the K-th of N processes")


def _add_measure(command: argparse.ArgumentParser) -> None:
    size = _number(0)
    command.add_argument("--resolution", type=_resolution, default="standard", metavar="NAME", help=
                         "of --no-contacts: draft, standard, fine or LAYERSxDENSITY (default: standard); "
                         "otherwise sizes are of the traced edges")  # fmt: skip
    command.add_argument("--tolerance", type=_number(0, above=True), metavar="T", help="have volumes and "
                         "areas within T mean cells, as 0.001, or be told where they may not be")  # fmt: skip
    for name, metavar in (("modulus", "K"), ("tension", "LAMBDA")):
        default = getattr(Settings, name)
        text = f"in the energy (default: {default})"
        command.add_argument(_option(name), type=size, default=default, metavar=metavar, help=text)
    _add_contacts(command, Settings.minimum_contact, Settings.no_contacts)
    _add_flat(command)
    command.add_argument("--graph", action="store_true", help="write the contact graph too, as graph.graphml")


def _add_export(command: argparse.ArgumentParser) -> None:
    command.add_argument("run", type=Path, metavar="RUN", help="folder that anneal, measure or fit wrote")
    command.add_argument("--to", nargs="+", required=True, choices=FORMATS, metavar="FORMAT",
                         help=f"one or more of {', '.join(FORMATS)}")  # fmt: skip
    command.add_argument("--spacing", nargs=3, type=_number(0, above=True), metavar=("Z", "Y", "X"), help="sides of a "
                         "voxel of ome-tiff (default: a tenth of a mean cell's)")  # fmt: skip
    command.add_argument("--unit", choices=UNITS, default="", help="unit of the run's lengths, written into the files")
    _add_folder(command, required=True)


def _add_fit(command: argparse.ArgumentParser) -> None:
    command.add_argument("file", type=Path, metavar="LABELS", help="image of labels, 0 outside: .tif, .tiff or .npy, "
                         "in the order z, y, x")  # fmt: skip
    command.add_argument("--spacing", type=_number(0, above=True), nargs=3, metavar=("Z", "Y", "X"), help=
                         "sides of a voxel (default: those that the file tells)")  # fmt: skip
    command.add_argument("--shape", choices=tuple(FITTERS), default="tube", help="of the tissue (default: tube)")
    _add_flat(command)
    _add_folder(command, required=True)


def _add_view(command: argparse.ArgumentParser) -> None:
    command.add_argument("run", type=Path, metavar="RUN", help="folder that anneal, measure or fit wrote")
    command.add_argument("--what", choices=VIEWED, default="tissue", metavar="WHAT",
                         help=f"one of {', '.join(VIEWED)} (default: tissue)")  # fmt: skip
    command.add_argument("--cell", type=_count(0), metavar="N", help="the cell of cell, scutoid or internal")
    command.add_argument("--unit", choices=UNITS, default="", help="unit of the run's lengths, for the scale bar")
    command.add_argument("--out", type=Path, metavar="FILE", help="picture to write (default: WHAT.png in RUN)")


def _add_contacts(command: Any, minimum: Any, without: Any) -> None:
    text = f"leave out walls below F mean walls (default: {Settings.minimum_contact:g})"
    command.add_argument("--minimum-contact", type=_number(0), default=minimum, metavar="F", help=text)
    text = "sizes only: trace no contacts and transition points"
    command.add_argument("--no-contacts", action="store_true", default=without, help=text)


def _add_reproduce(command: argparse.ArgumentParser) -> None:
    command.add_argument("items", nargs="*", metavar="ITEM", help="table1, fig5, fig7 ... fig16 (default: all)")
    command.add_argument("--quick", action="store_true", help="a small version of everything, in minutes")
    command.add_argument("--seeds", type=_count(2, 1000), metavar="N", help="runs per mean (default: 10, quick: 2)")
    command.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to make or to go on with")
    command.add_argument("--force", action="store_true", help="make anew what is there already")


def _add(command: Any, name: str, text: str, default: Any, **options: Any) -> None:
    """Add a setting of `anneal`, with its default in the help only."""
    text += "" if default is None else f" (default: {default})"
    command.add_argument(_option(name), default=argparse.SUPPRESS, help=text, **options)


def _add_flat(command: argparse.ArgumentParser) -> None:
    command.add_argument("--flat", action="store_true", help="leave out the pictures in three dimensions")


def _add_folder(command: argparse.ArgumentParser, required: bool) -> None:
    command.add_argument("--out", type=Path, required=required, metavar="DIR", help="folder to make")
    command.add_argument("--force", action="store_true", help="write into DIR even if it exists")


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are exceptions, so that every bad input ends in the same one line."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def _number(low: float, above: bool = False) -> Callable[[str], float]:
    """A reader of finite numbers of at least `low`, or above it."""

    def number(text: str) -> float:
        value = float(text)
        if not (math.isfinite(value) and (value > low if above else value >= low)):
            bound = f"above {low:g}" if above else f"of at least {low:g}"
            raise argparse.ArgumentTypeError(f"{text} is out of range; give a finite number {bound}")
        return value

    return number


def _count(low: int, high: int = 10**9) -> Callable[[str], int]:
    """A reader of whole numbers from `low` to `high`."""

    def integer(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            bounds = f"from {low} to {high}"
            raise argparse.ArgumentTypeError(f"{text} is out of range; give a whole number {bounds}")
        return value

    return integer


def _part(text: str) -> tuple[int, int]:
    """K/N as the number of a part, counted from 0, and how many there are."""
    first, slash, second = text.partition("/")
    if not (slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
        raise argparse.ArgumentTypeError(f"{text!r} is no part; give K/N with K from 1 to N, such as 2/8")
    return int(first) - 1, int(second)


def _resolution(text: str) -> str:
    try:
        as_resolution(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text
