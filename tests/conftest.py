"""The reference tubes and the two precisions, for all tests."""

import gc
import signal
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import checked  # before anything of the library is imported
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import quick
from hypothesis import settings
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from jaxtissue.compilation.batching import PROGRAMS
from jaxtissue.geometry.tube import Tube
from jaxtissue.neighbors import search
from jaxtissue.runs import formats
from jaxtissue.tissue import measurer, refinement

DATA = Path(__file__).parent / "data"
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as shells do for what they begin with &, which runs respect
    signal.signal(signal.SIGINT, signal.default_int_handler)
# the modules of tests whose calls are checked against annotations; others give wrong kinds on purpose, or wait
CHECKED = {"test_contacts", "test_layers", "test_tissue"}
PRECISE = jax.config.read("jax_enable_x64")  # as the environment has it
REFERENCES = sorted(path.stem for path in DATA.glob("*.npz"))

quick.begin()
gc.set_threshold(20_000, 20, 50)  # tracing makes many objects: to look through them takes a tenth of all time

settings.register_profile("jaxtissue", deadline=None, derandomize=True, database=None, max_examples=30)
settings.load_profile("jaxtissue")


@pytest.fixture(scope="session", autouse=True)
def keep_compiled(tmp_path_factory, worker_id):
    """All tests, and the commands they start, share what one of them compiled: most of their time."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "compiled"  # one for all workers
    folder.mkdir(exist_ok=True)
    options = {
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in options.items():
            patch.setenv(name.upper(), str(value))
            jax.config.update(name, value)
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        patch.setenv("PYTHONPYCACHEPREFIX", str(folder / "bytecode"))
        reset_cache()
        yield


@pytest.fixture(scope="module", autouse=True)
def check_annotations(request):
    """In some modules, functions of the library check arguments and results against their annotations."""
    if request.module.__name__ in CHECKED:
        checked.CHECKING.add(request.module.__name__)
    yield
    checked.CHECKING.discard(request.module.__name__)


@pytest.fixture(autouse=True)
def restore_precision():
    """What --x64, or a run that goes on, has switched ends with the test: the next one may be of another file."""
    yield
    jax.config.update("jax_enable_x64", PRECISE)


@pytest.fixture(scope="session", autouse=True)
def leave_no_scenes():
    """Runs leave pictures in three dimensions only where a test asks for them: each takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(formats, "LEFT", ())
        yield


def forget_programs() -> None:
    """Forget what is compiled, once nothing is being compiled.

    Under the options of another module it would be kept as if it were compiled under the present ones.
    """
    for program in PROGRAMS.values():
        if isinstance(program, Future):
            program.exception()
    PROGRAMS.clear()
    for kept in (search._checking, measurer._seeing, refinement.measuring):
        kept.cache_clear()


@contextmanager
def compiling(asked: str) -> Iterator[None]:
    """Compile as asked, here and in commands started by `quick.command`, and leave no program to others."""
    with pytest.MonkeyPatch.context() as patch:
        forget_programs()
        for module, name, value in quick.settings(asked):
            patch.setattr(module, name, value)
        patch.setenv(quick.ASKED, asked)
        yield
        forget_programs()


@pytest.fixture(scope="module")
def optimized():
    """What is compiled with options is optimized: for tests that compute much, or ask for equal bits.

    Without optimization replicas get other bits than alone.
    """
    with compiling(quick.OPTIMIZED):
        yield


@pytest.fixture(scope="module")
def coarse_pictures():
    """Draw pictures of few pixels, laid out without care: what runs leave them, and the same each time."""
    with pytest.MonkeyPatch.context() as patch:
        for owner, name, value in quick.coarse():
            patch.setattr(owner, name, value)
        yield


@dataclass(frozen=True)
class Reference:
    """One reference tube: the tissue, its (axial, angle) positions in float64, and the measured arrays."""

    name: str
    tube: Tube
    positions: np.ndarray
    data: dict[str, np.ndarray]


def read_reference(name: str) -> Reference:
    with np.load(DATA / f"{name}.npz") as file:
        data = dict(file)
    tube = Tube(data["L"], data["Ra"], data["Rb"])
    return Reference(name, tube, np.stack([data["x"], data["theta"]], axis=-1), data)


@pytest.fixture
def load_reference():
    """A function from the name of a reference tube to that `Reference`."""
    return read_reference


@pytest.fixture(params=REFERENCES)
def reference(request) -> Reference:
    """Each of the eight reference tubes in turn."""
    return read_reference(request.param)


@pytest.fixture
def x64():
    """64-bit arrays within one test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(params=[jnp.float32, jnp.float64], ids=["float32", "float64"])
def dtype(request):
    """Both precisions in turn, with 64-bit arrays switched on for the second."""
    with jax.enable_x64(request.param == jnp.float64):
        yield request.param
