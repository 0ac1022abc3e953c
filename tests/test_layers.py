"""A module imports only modules that come before it: tissue, contacts, cells, energy, moves, people."""

import ast
from pathlib import Path

import pytest

import jaxtissue

TISSUE = ["cores", "modes", "backbones", "tube", "inputs", "sampling", "lines", "labels", "voronoi", "spread"]
CONTACTS = ["leads", "fronts", "seeds", "edges", "rims", "contacts", "transitions", "sizes"]
CELLS = ["lowering", "views", "walls", "cells", "candidates", "shortlists", "refinement"]
CELLS += ["diagrams", "moments", "exact"]
STATISTICS = ["statistics", "laws"]
MOVES = ["energy", "coloring", "changes", "metropolis", "spans", "rounds", "records"]
MOVES += ["stopping", "files", "kept", "programs"]
MOVES += ["schedules", "surveys", "anneal", "memory"]
REPRODUCTION = ["workers", "tissues", "experiments", "ratios", "timings", "published", "figures"]
REPRODUCTION += [
    "ratio_figures",
    "shapes",
    "pictures",
    "tube_pictures",
    "claims",
    "time_claims",
    "run_claims",
]
REPRODUCTION += ["ratio_claims", "items", "report", "reproduce"]
PEOPLE = [
    "names",
    "reading",
    "io",
    "locks",
    "plot",
    "settings",
    "streams",
    "tables",
    "run_files",
    "runs",
    "grids",
    "batches",
    "cluster",
    "grid_runs",
    *(f"reproduction.{name}" for name in REPRODUCTION),
    "arguments",
    "cli",
]  # may `import jaxtissue` as users do
ORDER = TISSUE + CONTACTS + CELLS + STATISTICS + MOVES + PEOPLE
SELDOM = {"scipy"}  # what takes long to import is imported by what needs it
SELDOM_OWN = {"cli", "runs"}  # and of this package by the commands
EXTRAS = {"tifffile", "skimage", "pyevtk", "pandas", "pyvista", "trimesh"}
FOLDER = Path(jaxtissue.__file__).parent
MODULES = sorted(path for path in FOLDER.rglob("*.py") if not path.stem.startswith("__"))


def name_of(path: Path) -> str:
    """The name of a module within the package."""
    return ".".join(path.relative_to(FOLDER).with_suffix("").parts)


def imported(node: ast.AST) -> list[str]:
    """The full names that an import statement brings in; none for other nodes."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative import: write jaxtissue.module"
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def module_in(name: str) -> str | None:
    """The module of the order that a full name is or lies in; none where it is the package itself."""
    parts = name.split(".")[1:]
    return next((module for k in (2, 1) if (module := ".".join(parts[:k])) in ORDER), None)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_come_from_modules_above(path):
    tree, own = ast.parse(path.read_text()), name_of(path)
    for name in (name for node in ast.walk(tree) for name in imported(node)):
        if name.split(".")[0] != "jaxtissue":
            continue
        if module := module_in(name):
            assert ORDER.index(module) < ORDER.index(own), f"{own} imports {module}"
        else:
            assert own in PEOPLE, f"{own} imports the package itself"
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            local = {name.split(".")[0] for node in ast.walk(function) for name in imported(node)}
            local -= SELDOM | ({"jaxtissue"} if own in SELDOM_OWN else set())
            assert local <= EXTRAS, f"{own}.{function.name} imports {local - EXTRAS} within"


def test_every_module_has_a_place_in_the_order():
    assert {name_of(path) for path in MODULES} == set(ORDER)
