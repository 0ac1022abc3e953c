"""Compiled programs: kept for all arguments alike in shapes, and lifted over replicas and devices.

What happens to one replica is written as for one, as a task: a generator that yields a `Request` where it
needs something compiled, and `Ahead` for what it will need. Tasks go on turn by turn; requests of one turn
that are alike run together.
"""

import functools
import os
import stat
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from uuid import uuid4

import jax
import jax.numpy as jnp
import numpy as np
import platformdirs
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxtissue.compilation import program_cache
from jaxtissue.compilation.fusion import options

T = TypeVar("T")
AXIS = "replicas"
IN_TURN = ("cpu",)  # platforms whose devices take their replicas one after another, not all at once
PROGRAMS: dict[Any, Callable | Future] = {}  # compiled, or being so, for arguments alike in shapes
BESIDE = ThreadPoolExecutor(2, "compile")  # compile what will be needed, beside what is done meanwhile


class Request(NamedTuple):
    """A call of a jittable function with the arrays of one replica.

    Where the axes of some arrays may be longer than one replica needs, `sizes` tells what it needs, and
    `fit(arguments, sizes)` pads to those of all; that must not change the result. `seldom`: it is optimized
    less, and compiled sooner. `meanwhile` is done on the host while the device computes.
    """

    function: Callable[..., Any]
    arguments: tuple
    sizes: tuple[int, ...] = ()
    fit: Callable[[tuple, tuple[int, ...]], tuple] | None = None
    seldom: bool = False
    meanwhile: Callable[[], Any] = lambda: None


class Ahead(NamedTuple):
    """A request that is likely to follow: its program is compiled while the task goes on."""

    function: Callable[..., Any]
    arguments: tuple
    seldom: bool = False


class Answer(NamedTuple):
    """The result of a request, as NumPy arrays.

    `compile_seconds` were spent tracing or waiting for a program; `meanwhile` is the result of the work done meanwhile.
    """

    result: Any
    compile_seconds: float
    meanwhile: Any = None


Task = Generator[Request | Ahead, Answer, T]


class Asker:
    """Asks for what a task needs, and adds up how long it traced or waited for programs."""

    def __init__(self) -> None:
        self.compile_seconds = 0.0

    def ask(self, step: Request | Ahead) -> Task[Answer]:
        """The answer to one request."""
        answer = yield step
        self.compile_seconds += answer.compile_seconds
        return answer


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
        told = f"others can write to {folder}, so what is compiled is neither kept nor taken from there"
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


def run_together(tasks: Sequence[Task[T]], slots: int = 0) -> list[T]:
    """Run tasks to their ends, one for each replica, and return what each returns.

    A turn takes every task to its next request; requests of one function and alike in shapes then run as one
    program. Its arrays have a leading axis of `slots` replicas (at least as many as there are tasks), spread
    over the devices of this process; slots without a request are skipped. So a program serves any number of
    replicas up to `slots`, and no replica's result depends on the others.
    """
    devices = max(1, min(len(jax.local_devices()), max(slots, len(tasks))))
    slots = -(-max(slots, len(tasks)) // devices) * devices
    ends: dict[int, T] = {}
    answers: dict[int, Any] = dict.fromkeys(range(len(tasks)))
    widest: dict[Callable, tuple[int, ...]] = {}
    while answers:
        groups: dict[Any, list[int]] = {}
        asked: dict[int, Request] = {}
        for number, answer in answers.items():
            try:
                step = tasks[number].send(answer)
                while isinstance(step, Ahead):
                    begin = time.perf_counter()
                    _compile_ahead(step, slots, devices)
                    step = tasks[number].send(Answer(None, time.perf_counter() - begin))
                asked[number] = step
            except StopIteration as end:
                ends[number] = end.value
        for function, *sizes in {(request.function, *request.sizes) for request in asked.values()}:
            widest[function] = tuple(map(max, sizes, widest.get(function, sizes)))
        for number, request in asked.items():
            arguments = _fitted(request, widest[request.function])
            asked[number] = request._replace(arguments=arguments)
            groups.setdefault((request.function, _shapes(arguments)), []).append(number)
        answers = {}
        for numbers in groups.values():
            some = [asked[number] for number in numbers]
            answers |= zip(numbers, _run_alike(some, slots, devices), strict=True)
    return [ends[number] for number in range(len(tasks))]


def _fitted(request: Request, sizes: tuple[int, ...]) -> tuple:
    """The arguments as NumPy arrays of the precision JAX works in, padded to `sizes`."""

    def plain(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        return array.astype(jax.dtypes.canonicalize_dtype(array.dtype), copy=False)

    arguments = request.fit(request.arguments, sizes) if request.fit else request.arguments
    return jax.tree.map(plain, arguments)


def _shapes(arguments: Any) -> tuple:
    """The shapes and types that a program is compiled for."""
    leaves, structure = jax.tree.flatten(arguments)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)


def _run_alike(requests: Sequence[Request], slots: int, devices: int) -> list[Answer]:
    """One answer for each request; all are alike in function and shapes."""
    # one request on each device first, then the second on each
    place = np.arange(slots).reshape(devices, -1).T.ravel()[: len(requests)]

    def stacked(*leaves: np.ndarray) -> np.ndarray:
        table = np.empty((slots, *leaves[0].shape), leaves[0].dtype)
        table[:] = leaves[0]
        for at, leaf in zip(place[1:], leaves[1:], strict=True):
            table[at] = leaf
        return table

    active = np.zeros(slots, bool)
    active[place] = True
    mesh, batch = _mesh(devices), (active, jax.tree.map(stacked, *(some.arguments for some in requests)))
    function, compiling = requests[0].function, 0.0
    known = function, _shapes(batch), mesh
    program = PROGRAMS.get(known)
    if program is None or isinstance(program, Future):
        begin = time.perf_counter()
        begun = None if program is None or program.exception() else program
        program = begun.result() if begun else _compiling(requests[0], mesh, batch)()
        PROGRAMS[known] = program
        compiling = time.perf_counter() - begin
    pending = program(*batch)
    done = [request.meanwhile() for request in requests]
    results = jax.tree.map(np.asarray, pending)
    each = [jax.tree.map(lambda leaf, at=at: leaf[at], results) for at in place]
    return [Answer(result, compiling, other) for result, other in zip(each, done, strict=True)]


def _compiling(asked: Request | Ahead, mesh: Mesh, batch: tuple) -> Callable[[], Callable]:
    """A function that gives the program for arguments of these shapes, spread over the mesh.

    It compiles what is traced here, or loads what was kept.
    """
    sharding, chosen = NamedSharding(mesh, PartitionSpec(AXIS)), options(light=asked.seldom)
    key = program_cache.key_of(asked.function, batch, chosen, mesh.size)

    def shape(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)

    def trace() -> Callable[[], Callable]:
        def program(*arguments: Any) -> Any:
            return _lifted(asked.function, mesh)(*arguments)

        name = asked.function.__name__
        if key is not None:  # what JAX's cache gives can't be kept: by this name it holds nothing
            name += f"_{uuid4().hex}"
        program.__name__ = name
        lowered = jax.jit(program).lower(*jax.tree.map(shape, batch))

        def compiled() -> Callable:
            done = lowered.compile(chosen)
            if key is not None:
                program_cache.save(key, name, done)
            return done

        return compiled

    if key is not None and program_cache.has(key):
        return lambda: program_cache.load(key, batch, list(mesh.devices.flat)) or trace()()
    return trace()


def _compile_ahead(step: Ahead, slots: int, devices: int) -> None:
    """Begin to compile a function for arguments like these, unless that was begun before.

    It is traced here, under the settings of this thread. Accelerators try out kernels while they compile, and
    are left alone.
    """
    mesh = _mesh(devices)
    if mesh.devices.flat[0].platform not in IN_TURN:
        return

    def shape(leaf: np.ndarray) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((slots, *leaf.shape), leaf.dtype)

    arguments = jax.tree.map(shape, _fitted(Request(step.function, step.arguments), ()))
    batch = jax.ShapeDtypeStruct((slots,), np.dtype(bool)), arguments
    known = step.function, _shapes(batch), mesh
    if known not in PROGRAMS:
        PROGRAMS[known] = BESIDE.submit(_compiling(step, mesh, batch))


@functools.cache
def _mesh(devices: int) -> Mesh:
    """The first devices of this process, in a row."""
    some = jax.local_devices()[:devices]
    return jax.make_mesh((devices,), (AXIS,), (AxisType.Auto,), devices=some)


def _lifted(function: Callable[..., Any], mesh: Mesh) -> Callable[..., Any]:
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
