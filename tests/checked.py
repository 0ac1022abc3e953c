"""Functions of the library check their arguments and results against their annotations, where a test asks for it.

An import hook, to be installed before the library is imported, wraps every function of the modules that annotate
arrays. A wrapped function costs nothing until `CHECKING` is set; then its first calls are checked.
"""

import ast
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType
from typing import Any

from beartype import BeartypeConf, beartype
from jaxtyping import jaxtyped

PACKAGE = "jaxtissue."
CALLS = 30  # of each function that are checked: a check takes 0.1 ms, and kinds of arguments are few
CHECKING: set[str] = set()  # the test modules that ask for checks
TYPECHECKER = beartype(conf=BeartypeConf(is_pep484_tower=True))  # a whole number is a float


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, its first calls checked; how to check it is worked out in the first of them, in some ms."""
    calls, check = 0, function

    @wraps(function)
    def run(*args: Any, **options: Any) -> Any:
        nonlocal calls, check
        if not CHECKING or calls == CALLS:
            return function(*args, **options)
        if not calls:
            check = jaxtyped(function, typechecker=TYPECHECKER)
        calls += 1
        return check(*args, **options)

    return run


class _Wrapping(ast.NodeTransformer):
    """Decorates functions and methods, nearest to them, but not functions within functions: these are made often."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.decorator_list.append(ast.copy_location(ast.Name("_checked", ast.Load()), node))
        return node


class _Loader(SourceFileLoader):
    """Loads a module with its functions wrapped, past the compiled files of others."""

    def get_code(self, fullname: str) -> CodeType | None:
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path), path)
        if not any(isinstance(node, ast.ImportFrom) and node.module == "jaxtyping" for node in tree.body):
            return super().get_code(fullname)
        return compile(ast.fix_missing_locations(_Wrapping().visit(tree)), path, "exec", dont_inherit=True)

    def exec_module(self, module: Any) -> None:
        module.__dict__["_checked"] = checked
        super().exec_module(module)


class _Finder(MetaPathFinder):
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: Any = None) -> ModuleSpec | None:
        found = PathFinder.find_spec(fullname, path, target) if fullname.startswith(PACKAGE) else None
        if found is not None and isinstance(found.loader, SourceFileLoader):
            found.loader = _Loader(found.loader.name, found.loader.path)
        return found


def install() -> None:
    """Wrap what is imported of the library from now on."""
    assert not any(name.startswith(PACKAGE) for name in sys.modules), "the library is imported already"
    sys.meta_path.insert(0, _Finder())


install()
