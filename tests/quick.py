"""Compile quickly, in tests and in the commands they start: what runs little needs no optimizing."""

import os
import sys
import time
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
LEVEL = "xla_backend_optimization_level"
# compiled in half of the time; a sweep takes a fifth longer, and replicas get other bits than alone
QUICK: Options = {"xla_cpu_use_fusion_emitters": False}
USUAL: Options = {"xla_cpu_use_fusion_emitters": True}
COMPILING = (fusion, search, measurer, batching, refinement)  # the modules that compile with options
# candidates compared in loops that are unrolled less: two thirds of the time to compile
SHORT_LOOPS = [(walls, "CHUNK", 4), (walls, "UNROLLED", 0), (half_planes, "CHUNK", 4)]
# named as the installed command, by which it knows that signals are for it to answer
RUN = f"""
import sys
sys.argv[0] = "jaxtissue"
sys.path.insert(0, {str(Path(__file__).parent)!r})
import quick
quick.run()
"""


def turn_off_emitters() -> None:
    """Compile what has no options of its own in two thirds of the time; to be called before JAX starts.

    JAX does not start where its compiler does not know a flag, and this one is gone since 0.11.1.
    """
    if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_use_fusion_emitters=false"


def usual_settings() -> list[tuple[ModuleType, str, Any]]:
    """What is to stand in each module that compiles, so that it does as without `turn_off_emitters`."""
    usual = fusion.options

    def as_users_do(light: bool = False) -> Options:
        return {name: value for name, value in USUAL.items() if is_option(name, value)} | usual(light)

    return [(module, "options", as_users_do) for module in COMPILING]


def quick_settings(replicas_as_alone: bool) -> list[tuple[ModuleType, str, Any]]:
    """What is to stand in each module that compiles, where JAX is told not to optimize: module, name, value.

    With `replicas_as_alone`, what is compiled for replicas has the usual options.
    """
    usual = fusion.options

    def quick(light: bool = False) -> Options:
        found = {name: value for name, value in usual(light).items() if name != LEVEL}
        return found | {name: value for name, value in QUICK.items() if is_option(name, value)}

    some = set(COMPILING) - {batching} if replicas_as_alone else COMPILING
    return [*((module, "options", quick) for module in some), *SHORT_LOOPS]


def command(*arguments: object) -> list[str | bytes]:
    """The command line of a `jaxtissue` that compiles as the test does that starts it."""
    given = (part if isinstance(part, bytes) else str(part) for part in arguments)
    return [sys.executable, "-c", RUN, *given]


def compile_as_asked() -> None:
    """Compile as the test does that started this process."""
    if asked := os.environ.get(ASKED):
        for module, name, value in (*usual_settings(), *quick_settings(asked == "replicas as alone")):
            setattr(module, name, value)


def meet(folder: Path, name: str, count: int) -> None:
    """Compile as asked, in each of `count` processes: none is done before all have begun."""
    compile_as_asked()
    (folder / name).touch()
    ends = time.monotonic() + 100
    while len(list(folder.iterdir())) < count and time.monotonic() < ends:
        time.sleep(0.01)


def run() -> None:
    """`jaxtissue` in a process that a test started; it draws nothing in three dimensions."""
    compile_as_asked()
    formats.LEFT = ()
    run_command()
