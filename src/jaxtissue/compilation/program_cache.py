"""Compiled programs of commands, on the disk under keys that are known before anything is traced.

JAX's own cache finds a program by what it was lowered to. To trace and lower takes longer than the first
hundred sweeps of 500 cells, so commands find theirs by what they are made from: the sources of this package,
the versions, the settings, the processor and the shapes. In a session anything may have been patched, and
nothing is kept.
"""

import functools
import hashlib
import os
import pickle
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from jaxtissue.system.files import replacing

SURROUNDINGS = ("JAX_", "XLA_", "NPROC", "LIBTPU")  # how variables begin that may decide what is compiled
SECONDS = 60 * 86400  # what was not loaded for so long is removed

is_on = False  # in commands only
LOADED: set[Path] = set()


def key_of(function: Callable[..., Any], arguments: Any, options: Mapping[str, Any], devices: int) -> str | None:
    """The key of the program of a function of this package; none where programs are not kept."""
    if not is_on or _folder() is None or jax.process_count() > 1:  # devices of others are not found again
        return None
    leaves, structure = jax.tree.flatten(arguments)
    shapes = [(leaf.shape, str(leaf.dtype)) for leaf in leaves]
    config: Any = jax.config
    settings = [(name, str(getattr(config, name, value))) for name, value in sorted(config.values.items())]
    called = function.__module__, function.__qualname__
    told = repr((called, shapes, sorted(options.items()), devices, settings, _surroundings()))
    return hashlib.sha256(told.encode() + pickle.dumps(_like(structure))).hexdigest()


def has(key: str) -> bool:
    """Whether a program is kept under a key."""
    path = _path(key)
    return path is not None and path.is_file()


def load(key: str, arguments: tuple, devices: Sequence[Any]) -> Callable[..., Any] | None:
    """The program that is kept under a key, for arguments like these; none that can't be used."""
    if (path := _path(key)) is None:
        return None
    try:
        digest, content = path.read_bytes().split(b"\n", 1)
        if hashlib.sha256(content).hexdigest().encode() != digest:
            raise ValueError("damaged")
        with suppress(OSError):
            os.utime(path)
        program, result = pickle.loads(content)
        LOADED.add(path)
        structures = jax.tree.structure((arguments, {})), jax.tree.structure(result)
        return deserialize_and_load(program, *structures, execution_devices=devices)
    except Exception:  # whatever is wrong with it, it can be compiled anew
        with suppress(OSError):
            path.unlink()
        return None


def save(key: str, name: str, program: jax.stages.Compiled) -> None:
    """Keep a program that was just compiled, if that can be done; those that were not loaded for long go."""
    if (path := _path(key)) is None:
        return
    with suppress(Exception):  # no room, or a device whose programs can't be kept: the run goes on
        executable, _, structure = serialize(program)
        content = pickle.dumps((executable, _like(structure)))
        with replacing(path, "wb") as file:
            file.write(hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
        for other in path.parent.glob(f"jit_{name}-*"):  # JAX's own copy, which nothing finds again
            other.unlink()
        for other in path.parent.glob("*.program"):
            if other.stat().st_mtime < time.time() - SECONDS:
                other.unlink()


def forget_loaded() -> None:
    """Remove the programs that this process took from the disk: one of them may be why it failed."""
    for path in list(LOADED):
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _like(structure: Any) -> Any:
    """Something of this structure: it can be pickled, which structures of modules can't."""
    return jax.tree.unflatten(structure, range(structure.num_leaves))


def _path(key: str) -> Path | None:
    folder = _folder()
    return folder / f"{key}.program" if folder else None


def _folder() -> Path | None:
    """The folder of JAX's own cache, which `keep_compiled` has seen to be the user's own."""
    config: Any = jax.config
    name = config.jax_enable_compilation_cache and config.jax_compilation_cache_dir
    return Path(name) if name and "://" not in name else None


@functools.cache
def _surroundings() -> tuple:
    """The sources of the package, the versions, and the machine that programs are made for."""
    package, sources = Path(__file__).parent.parent, hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        sources.update(f"\n{path.relative_to(package)}\n".encode() + path.read_bytes())
    versions = sys.version, *(version(name) for name in ("jax", "jaxlib", "equinox", "numpy"))
    device = jax.local_devices()[0]
    machine = device.device_kind, device.client.platform_version, jax.device_count(), _processor()
    told = sorted(item for item in os.environ.items() if item[0].startswith(SURROUNDINGS))
    return sources.hexdigest(), versions, machine, told


def _processor() -> str:
    """The features of the processor: machines that are not alike may share a home."""
    with suppress(OSError), open("/proc/cpuinfo") as file:
        return next((line for line in file if line.startswith(("flags", "Features"))), platform.processor())
    return platform.processor()
