"""A module imports only modules that come before it: tissue, diagram, cells, energy, moves, people."""

import ast
from pathlib import Path

import pytest

import jaxtissue

TISSUE = ["backbones", "tube", "sampling", "lines", "voronoi", "spread", "walls", "cells"]
TISSUE += ["candidates", "shortlists", "exact"]
CONTACTS = ["leads", "fronts", "edges", "contacts", "transitions", "statistics", "laws"]
MOVES = ["energy", "coloring", "changes", "metropolis", "spans", "schedules", "anneal"]
REPRODUCTION = ["tissues", "experiments", "timings", "published", "figures", "ratio_figures", "shapes"]
REPRODUCTION += ["pictures", "tube_pictures", "claims", "run_claims", "ratio_claims", "items", "report"]
REPRODUCTION += ["reproduce"]
PEOPLE = [
    "io",
    "plot",
    "settings",
    "stopping",
    "tables",
    "runs",
    *REPRODUCTION,
    "arguments",
    "cli",
]  # may `import jaxtissue` as users do
ORDER = TISSUE + CONTACTS + MOVES + PEOPLE
EXTRAS = {"tifffile", "skimage", "pyevtk", "pandas", "pyvista", "trimesh"}
MODULES = sorted(p for p in Path(jaxtissue.__file__).parent.glob("*.py") if not p.stem.startswith("__"))


def imported(node: ast.AST) -> list[str]:
    """The full names that an import statement brings in; none for other nodes."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative import: write jaxtissue.module"
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_imports_come_from_modules_above(path):
    tree = ast.parse(path.read_text())
    for parts in (name.split(".") for node in ast.walk(tree) for name in imported(node)):
        if parts[0] != "jaxtissue":
            continue
        if len(parts) > 1 and parts[1] in ORDER:
            assert ORDER.index(parts[1]) < ORDER.index(path.stem), f"{path.stem} imports {parts[1]}"
        else:
            assert path.stem in PEOPLE, f"{path.stem} imports the package itself"
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            local = {name.split(".")[0] for node in ast.walk(function) for name in imported(node)}
            assert local <= EXTRAS, f"{path.stem}.{function.name} imports {local - EXTRAS} within"


def test_every_module_has_a_place_in_the_order():
    assert {path.stem for path in MODULES} <= set(ORDER)
