"""Compiled programs: kept for all arguments alike in shapes, and lifted over replicas and devices.

A function is written for one replica. `Batch.run` calls it for several: calls alike in shapes run as one program.
"""

import functools
import os
import stat
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any
from uuid import uuid4

import jax
import jax.numpy as jnp
import numpy as np
import platformdirs
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxtissue.compilation import program_cache
from jaxtissue.compilation.fusion import options

AXIS = "replicas"
IN_TURN = ("cpu",)  # platforms whose devices take their replicas one after another, not all at once
PROGRAMS: dict[Any, Callable | Future] = {}  # compiled, or being so, for arguments alike in shapes
BESIDE = ThreadPoolExecutor(2, "compile")  # compile what will be needed, beside what is done meanwhile
Function = Callable[..., Any]


class Batch:
    """Runs functions of one replica for several replicas at once, spread over the devices of this process.

    The arrays of a program have a leading axis of `slots` replicas; slots without a call are skipped. So a program
    serves any number of replicas up to `slots`, and no replica's result depends on the others.

    Attributes:
        compile_seconds: The time spent tracing or waiting for programs.
    """

    def __init__(self, slots: int = 1) -> None:
        self.compile_seconds = 0.0
        devices = max(1, min(len(jax.local_devices()), slots))
        self._mesh, self._slots = _mesh(devices), -(-slots // devices) * devices

    def run(self, function: Function, calls: Sequence[tuple], light: bool = False) -> list[Any]:
        """The results of a jittable function, as NumPy arrays, for the arguments of each replica.

        If `light`, the function is optimized less, and compiled sooner.
        """
        return self.start(function, calls, light)()

    def start(self, function: Function, calls: Sequence[tuple], light: bool = False) -> Callable[[], list[Any]]:
        """As `run`, but what is returned gives the results when it is called: the host may go on until then."""
        arguments = [_plain(call) for call in calls]
        groups: dict[Any, list[int]] = {}
        for number, call in enumerate(arguments):
            groups.setdefault(_shapes(call), []).append(number)
        begun = []
        for alike in groups.values():
            for first in range(0, len(alike), self._slots):
                numbers = alike[first : first + self._slots]
                begun.append((numbers, *self._begin(function, [arguments[k] for k in numbers], light)))

        def results() -> list[Any]:
            found: list[Any] = [None] * len(calls)
            for numbers, pending, places in begun:
                whole = jax.tree.map(np.asarray, pending)
                for number, place in zip(numbers, places, strict=True):
                    found[number] = jax.tree.map(lambda leaf, place=place: leaf[place], whole)
            return found

        return results

    def prepare(self, function: Function, call: tuple, light: bool = False) -> None:
        """Begin to compile a function for arguments like these, unless that was begun before.

        It is traced here, under the settings of this thread. Accelerators try out kernels while they compile, and are
        left alone.
        """
        if self._mesh.devices.flat[0].platform not in IN_TURN:
            return
        begin = time.perf_counter()

        def shape(leaf: np.ndarray) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct((self._slots, *leaf.shape), leaf.dtype)

        rows = jax.ShapeDtypeStruct((self._slots,), np.dtype(bool)), jax.tree.map(shape, _plain(call))
        known = function, _shapes(rows), self._mesh
        if known not in PROGRAMS:
            PROGRAMS[known] = BESIDE.submit(_compiling(function, light, self._mesh, rows))
        self.compile_seconds += time.perf_counter() - begin

    def _begin(self, function: Function, calls: list[tuple], light: bool) -> tuple[Any, np.ndarray]:
        """Dispatch calls alike in shapes: the pending results of all slots, and the slot of each call."""
        devices = self._mesh.size
        # one replica on each device first, then the second on each
        places = np.arange(self._slots).reshape(devices, -1).T.ravel()[: len(calls)]

        def stacked(*leaves: np.ndarray) -> np.ndarray:
            table = np.empty((self._slots, *leaves[0].shape), leaves[0].dtype)
            table[:] = leaves[0]
            for place, leaf in zip(places[1:], leaves[1:], strict=True):
                table[place] = leaf
            return table

        active = np.zeros(self._slots, bool)
        active[places] = True
        rows = active, jax.tree.map(stacked, *calls)
        known = function, _shapes(rows), self._mesh
        program = PROGRAMS.get(known)
        if program is None or isinstance(program, Future):
            begin = time.perf_counter()
            begun = None if program is None or program.exception() else program
            program = begun.result() if begun else _compiling(function, light, self._mesh, rows)()
            PROGRAMS[known] = program
            self.compile_seconds += time.perf_counter() - begin
        return program(*rows), places


def keep_compiled() -> None:
    """Keep what is compiled in the user's cache folder, for the next process.

    Unless JAX was told of a folder (`JAX_COMPILATION_CACHE_DIR`), or to keep nothing
    (`JAX_ENABLE_COMPILATION_CACHE=0`). Where it can't be read or written, JAX warns and compiles. A folder
    that others can write is not used, with a warning: programs in it could be theirs. A user without a
    home keeps nothing.
    """
    config: Any = jax.config  # its settings are not declared
    if not config.jax_compilation_cache_dir:
        try:
            usual = Path(platformdirs.user_cache_dir("jaxtissue"))
        except RuntimeError:  # there is no home; older ones give a path that begins with ~
            return
        if not usual.is_absolute():
            return
        jax.config.update("jax_compilation_cache_dir", str(usual))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    folder = Path(config.jax_compilation_cache_dir)
    if not _is_private(folder):
        jax.config.update("jax_compilation_cache_dir", None)
        told = f"other users can write to {folder}, so compiled programs are neither stored there nor loaded from there"
        warnings.warn(f"{told}; remove the folder", stacklevel=2)


def _is_private(folder: Path) -> bool:
    """Whether a folder, which is made for this user if it is not there, can be written by no other user."""
    if os.name != "posix" or "://" in str(folder):
        return True
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except OSError:
        return True  # JAX warns
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _plain(arguments: tuple) -> tuple:
    """The arguments as NumPy arrays of the precision JAX works in."""

    def plain(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        return array.astype(jax.dtypes.canonicalize_dtype(array.dtype), copy=False)

    return jax.tree.map(plain, arguments)


def _shapes(arguments: Any) -> tuple:
    """The shapes and types that a program is compiled for."""
    leaves, structure = jax.tree.flatten(arguments)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)


def _compiling(function: Function, light: bool, mesh: Mesh, rows: tuple) -> Callable[[], Callable]:
    """A function that gives the program for arguments of these shapes, spread over the mesh.

    It compiles what is traced here, or loads what was kept.
    """
    sharding, chosen = NamedSharding(mesh, PartitionSpec(AXIS)), options(light)
    key = program_cache.key_of(function, rows, chosen, mesh.size)

    def shape(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)

    def trace() -> Callable[[], Callable]:
        def program(*arguments: Any) -> Any:
            return _lifted(function, mesh)(*arguments)

        name = function.__name__
        if key is not None:  # what JAX's cache gives can't be kept: by this name it holds nothing
            name += f"_{uuid4().hex}"
        program.__name__ = name
        lowered = jax.jit(program).lower(*jax.tree.map(shape, rows))

        def compiled() -> Callable:
            done = lowered.compile(chosen)
            if key is not None:
                program_cache.save(key, name, done)
            return done

        return compiled

    if key is not None and program_cache.has(key):
        return lambda: program_cache.load(key, rows, list(mesh.devices.flat)) or trace()()
    return trace()


@functools.cache
def _mesh(devices: int) -> Mesh:
    """The first devices of this process, in a row."""
    some = jax.local_devices()[:devices]
    return jax.make_mesh((devices,), (AXIS,), (AxisType.Auto,), devices=some)


def _lifted(function: Function, mesh: Mesh) -> Callable[..., Any]:
    """A function of one replica as one of many, [replicas, ...], whose replicas are spread over a mesh.

    A CPU takes its replicas one after another, and skips inactive ones; other devices take all at once.
    """
    function = jax.jit(function, inline=True)  # traced once, though asked for twice

    def one(call: tuple) -> Any:
        # a branch is compiled by itself: whatever is around it, the result is the same to the bit
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(function, *call[1]))
        return jax.lax.cond(call[0], lambda: function(*call[1]), lambda: empty)

    def share(active: jax.Array, arguments: tuple) -> Any:
        if mesh.devices.flat[0].platform in IN_TURN:
            return jax.lax.map(one, (active, arguments))
        return jax.vmap(function)(*arguments)

    spec = PartitionSpec(AXIS)
    return jax.shard_map(share, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
