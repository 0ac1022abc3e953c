"""The house: rooms above each other, imports that go down only, files and functions that fit a screen."""

import ast
from functools import cache
from pathlib import Path

import pytest

import jaxtissue

FOLDER = Path(jaxtissue.__file__).parent
ROOMS = [  # from the ground up: a room imports only what stands before it
    "system",
    "compilation",
    "geometry",
    "measurement",
    "sections",
    "diagram",
    "meshes",
    "neighbors",
    "topology",
    "exports",
    "pictures",
    "tissue",
    "images",
    "energy",
    "minimization",
    "dynamics",
    "simulation",
    "runs",
    "reproduction",
    "cli",
]
FLOORS = 10
LINES, FUNCTION_LINES = 300, 50  # of a file, of a function without its docstring
ARGUMENTS, OPTIONS = 6, 6  # that a call must give, and that it may
SELDOM = {"scipy", "networkx"}  # what takes long to import is imported by what needs it
SELDOM_OWN = {
    "cli.commands",
    "runs.annealing",
    "runs.preparing",
    "runs.relaxing",
}  # and of this package by the commands
EXTRAS = {"tifffile", "skimage", "pyevtk", "pandas", "pyvista", "trimesh"}
MODULES = sorted(path for path in FOLDER.rglob("*.py") if not path.stem.startswith("__"))


def name_of(path: Path) -> str:
    """The name of a module within the package."""
    return ".".join(path.relative_to(FOLDER).with_suffix("").parts)


NAMES = {name_of(path): path for path in MODULES}


def imported(node: ast.AST) -> list[str]:
    """The full names that an import statement brings in; none for other nodes."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative import: write jaxtissue.room.module"
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


@cache
def needs_of(module: str) -> set[str]:
    """The modules of this package that one imports."""
    found = set()
    for node in ast.walk(ast.parse(NAMES[module].read_text())):
        for name in imported(node):
            if name.split(".")[0] == "jaxtissue":
                parts = name.split(".")[1:]
                known = [".".join(parts[:k]) for k in range(len(parts), 0, -1)]
                found |= {next((name for name in known if name in NAMES), "jaxtissue")}
    return found


def room_of(module: str) -> str:
    return module.split(".")[0]


def test_every_module_has_a_room():
    assert {room_of(name) for name in NAMES} == set(ROOMS)


@pytest.mark.parametrize("module", NAMES)
def test_imports_go_down(module: str):
    for other in needs_of(module):
        assert other in NAMES, f"{module} imports the package itself, not a module of it"
        assert ROOMS.index(room_of(other)) <= ROOMS.index(room_of(module)), f"{module} imports {other}"
    for function in ast.walk(ast.parse(NAMES[module].read_text())):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            local = {name.split(".")[0] for node in ast.walk(function) for name in imported(node)}
            local -= SELDOM | ({"jaxtissue"} if module in SELDOM_OWN else set())
            assert local <= EXTRAS, f"{module}.{function.name} imports {local - EXTRAS} within"


def test_no_circles_within_a_room():
    def visit(module: str, above: tuple[str, ...]) -> None:
        assert module not in above, f"a circle: {' -> '.join([*above, module])}"
        if module not in done:
            for other in needs_of(module):
                visit(other, (*above, module))
            done.add(module)

    done: set[str] = set()
    for module in NAMES:
        visit(module, ())


def test_at_most_ten_floors():
    """A room stands on the floor above the highest of all rooms that it imports; commands start on top."""
    floor: dict[str, int] = {}
    for room in ROOMS:
        below = {room_of(other) for name in NAMES if room_of(name) == room for other in needs_of(name)}
        floor[room] = 1 + max((floor[other] for other in below - {room}), default=0)
    assert max(floor.values()) + 1 <= FLOORS, floor


@pytest.mark.parametrize("module", NAMES)
def test_files_and_functions_fit_a_screen(module: str):
    text = NAMES[module].read_text()
    assert len(text.splitlines()) <= LINES
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            length = (
                (node.end_lineno or node.lineno) - node.lineno + 1 - len((ast.get_docstring(node) or "").splitlines())
            )
            given = node.args
            options = len(given.defaults) + sum(default is not None for default in given.kw_defaults)
            count = len(given.posonlyargs + given.args + given.kwonlyargs) - options
            count -= bool(given.args) and given.args[0].arg in ("self", "cls")
            where = f"{module}.{node.name}, line {node.lineno}"
            assert length <= FUNCTION_LINES, f"{where}, has {length} lines"
            assert count <= ARGUMENTS, f"{where}, must be given {count} arguments"
            assert options <= OPTIONS, f"{where}, has {options} options"
