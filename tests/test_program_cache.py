"""Programs kept on the disk: found without being traced, never taken for others, compiled anew if damaged."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import forget_programs

from jaxtissue.compilation import program_cache
from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.spans import energy_terms
from jaxtissue.energy import tube_model
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Iterator:
    before = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    monkeypatch.setattr(program_cache, "is_on", True)
    forget_programs()
    yield tmp_path
    forget_programs()
    jax.config.update("jax_compilation_cache_dir", before)


def run(cells: int = 5, tension: float = 0.4) -> tuple[np.ndarray, int]:
    """Energies by a program of its own process, as it were; how often anything was traced for it."""
    forget_programs()
    model = tube_model(Tube(10.0, 1.0, 2.0), cells, tension=tension)
    sizes = CellGeometry(jnp.linspace(1, 2, cells), jnp.linspace(5, 7, cells))
    traced: list[str] = []

    def note(event: str, duration_secs: float, **_: str | int) -> None:
        traced.extend([event] * ("trace" in event))

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        ((energy, *_),) = Batch().run(energy_terms, [(sizes, model)])
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
    return energy, len(traced)


def test_the_next_process_finds_a_program_without_tracing(folder):
    first, traced = run()
    assert traced > 0 and len(list(folder.glob("*.program"))) == 1
    again, traced = run()
    assert traced == 0
    np.testing.assert_array_equal(first, again)
    other, traced = run(tension=0.8)  # a number is no part of a program
    assert traced == 0 and (other > first).all()


@pytest.mark.parametrize("what", ["shape", "precision", "sources", "options", "settings"])
def test_another_program_is_not_taken_for_it(folder, monkeypatch, what: str):
    run()
    if what == "shape":
        assert run(6)[1] > 0
    elif what == "precision":
        with jax.enable_x64(True):
            energy, traced = run()
        assert traced > 0 and energy.dtype == np.float64
    elif what == "sources":
        monkeypatch.setattr(program_cache, "_surroundings", lambda: "an edited file")
        assert run()[1] > 0
    elif what == "options":
        monkeypatch.setattr(
            "jaxtissue.compilation.batching.options", lambda light: {"xla_backend_optimization_level": "0"}
        )
        assert run()[1] > 0
    else:
        with jax.default_matmul_precision("float32"):
            assert run()[1] > 0


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "not a program"])
def test_a_damaged_program_is_compiled_anew(folder, damage: str):
    energy, _ = run()
    (path,) = folder.glob("*.program")
    content = path.read_bytes()
    if damage == "flipped":
        content = content[:500] + bytes([content[500] ^ 1]) + content[501:]
    path.write_bytes({"cut": content[:-9], "empty": b"", "not a program": b"x\ny"}.get(damage, content))
    again, traced = run()
    assert traced > 0
    np.testing.assert_array_equal(energy, again)
    again, traced = run()
    assert traced == 0
    np.testing.assert_array_equal(energy, again)


def test_what_jax_kept_is_compiled_anew_to_be_kept(folder):
    """An executable that JAX's own cache gave could be kept, but not run."""
    for _ in range(2):
        run()
        for path in folder.glob("*.program"):
            path.unlink()
    run()
    energy, traced = run()
    assert traced == 0 and np.isfinite(energy).all()


def test_nothing_is_kept_in_a_session(folder, monkeypatch):
    monkeypatch.setattr(program_cache, "is_on", False)
    run()
    assert not list(folder.glob("*.program"))


def test_what_was_loaded_before_a_failure_is_not_loaded_again(folder):
    run()
    run()
    program_cache.forget_loaded()
    assert not list(folder.glob("*.program"))


def test_any_source_is_part_of_the_key(tmp_path, monkeypatch):
    """The sources of the whole package are hashed, not of this module's folder alone."""
    package = Path(program_cache.__file__).parent.parent
    before = program_cache._surroundings()[0]
    copy = tmp_path / "jaxtissue"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(program_cache, "__file__", str(copy / "compilation" / "program_cache.py"))
    assert program_cache._surroundings.__wrapped__()[0] == before
    with (copy / "measurement" / "walls.py").open("a") as file:
        file.write("# one more line")
    assert program_cache._surroundings.__wrapped__()[0] != before


TWO_DEVICES = """
import jax, sys
sys.path.insert(0, {tests!r})
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_compilation_cache_dir", {folder!r})
from test_program_cache import run
from jaxtissue.compilation import program_cache
program_cache.is_on = True
first, traced = run()
again, none = run()
print(jax.device_count(), traced > 0, none, bool((first == again).all()))
"""


def test_a_program_for_one_of_two_devices_is_found(tmp_path):
    """Of more devices than replicas only the first are used; a kept program is loaded on these."""
    script = TWO_DEVICES.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "2 True 0 True\n"
