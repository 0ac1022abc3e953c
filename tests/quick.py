"""Compile quickly, in tests and in the commands they start: what runs little needs no optimizing."""

import os
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxtissue.__main__ import run as run_command
from jaxtissue.compilation import batching, fusion
from jaxtissue.compilation.fusion import is_option
from jaxtissue.measurement import walls
from jaxtissue.neighbors import search
from jaxtissue.runs import formats
from jaxtissue.sections import half_planes
from jaxtissue.tissue import measurer, refinement

Options = dict[str, str | bool]
ASKED = "JAXTISSUE_TESTS_COMPILE"  # the variable by which processes are told how to compile
QUICKEST, OPTIMIZED = "quickest", "optimized"
OPTIONS: dict[str, Options] = {
    # without optimization; replicas get other bits than alone
    QUICKEST: {"xla_cpu_use_fusion_emitters": False},
    OPTIMIZED: {
        "xla_cpu_use_fusion_emitters": False,
        "xla_backend_optimization_level": "1",
        "xla_llvm_disable_expensive_passes": False,
    },
}
COMPILING = (fusion, search, measurer, batching, refinement)  # the modules that compile with options
# candidates compared in loops that are unrolled less: two thirds of the time to compile
SHORT_LOOPS = [(walls, "CHUNK", 4), (walls, "UNROLLED", 0), (half_planes, "CHUNK", 4)]
USERS_OPTIONS = fusion.options
# named as the installed command, by which it knows that signals are for it to answer
RUN = f"""
import sys
sys.argv[0] = "jaxtissue"
sys.path.insert(0, {str(Path(__file__).parent)!r})
import quick
quick.run()
"""


def begin() -> None:
    """Compile quickly in this process and in those that it starts; to be called before JAX starts.

    Programs without options of their own are never optimized. Loops are short in all tests: JAX traces a function
    once, whatever has changed since.
    """
    # JAX does not start where its compiler does not know a flag, and this one is gone since 0.11.1
    if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_use_fusion_emitters=false"
    import jax  # not before signals are answered, in the commands that tests start

    os.environ |= {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1", ASKED: QUICKEST}
    jax.config.update("jax_disable_most_optimizations", True)
    compile_as_asked()


def settings(asked: str) -> list[tuple[ModuleType, str, Any]]:
    """What is to stand in each module that compiles with options: module, name, value."""

    def compiling(wanted: Options) -> Callable[[bool], Options]:
        def options(light: bool = False) -> Options:
            usual = {name: value for name, value in USERS_OPTIONS(light).items() if name not in OPTIONS[OPTIMIZED]}
            return usual | {name: value for name, value in wanted.items() if is_option(name, value)}

        return options

    return [(module, "options", compiling(OPTIONS[asked])) for module in COMPILING]


def command(*arguments: object) -> list[str | bytes]:
    """The command line of a `jaxtissue` that compiles as the test does that starts it."""
    given = (part if isinstance(part, bytes) else str(part) for part in arguments)
    return [sys.executable, "-c", RUN, *given]


def compile_as_asked() -> None:
    """Compile as the test does that started this process."""
    for module, name, value in (*settings(os.environ[ASKED]), *SHORT_LOOPS):
        setattr(module, name, value)


def coarse() -> list[tuple[Any, str, Any]]:
    """What draws few pixels and lays nothing out, which are half of the time of a short run: owner, name, value."""
    from matplotlib.figure import Figure

    from jaxtissue.runs import plots

    set_dpi = Figure.set_dpi
    return [
        (plots, "_PIXELS", (100, 48)),
        (Figure, "get_layout_engine", lambda figure: None),
        (Figure, "set_dpi", lambda figure, val: set_dpi(figure, 30)),
    ]


def meet(folder: Path, name: str, count: int) -> None:
    """Compile as asked, in each of `count` processes: none is done before all have begun."""
    compile_as_asked()
    (folder / name).touch()
    ends = time.monotonic() + 100
    while len(list(folder.iterdir())) < count and time.monotonic() < ends:
        time.sleep(0.01)


def run() -> None:
    """`jaxtissue` in a process that a test started; it draws coarsely, and nothing in three dimensions."""
    compile_as_asked()
    formats.LEFT = ()
    for owner, name, value in coarse():
        setattr(owner, name, value)
    run_command()
