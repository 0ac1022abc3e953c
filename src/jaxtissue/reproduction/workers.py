"""Independent calls, run by several processes at once, each on one core."""

import gc
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

import jax
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from jaxtissue.compilation.devices import use_cores
from jaxtissue.compilation.modes import keep_usual_modes
from jaxtissue.dynamics.memory import machine_memory
from jaxtissue.system.cores import usable_cores

ROOM = 2**31  # bytes of memory that a process is given
CONFIG: Any = jax.config  # its settings are not declared


def free_cores() -> int:
    """The number of processes that the machine has cores and memory for.

    It is one where JAX has accelerators, which are not shared out.
    """
    if jax.default_backend() != "cpu":
        return 1
    cores = usable_cores()
    return max(1, min(cores, (machine_memory() or cores * ROOM) // ROOM))


class Workers:
    """A pool of processes, started when first there is work for two, and ended on leaving `with`.

    With one all is computed in this process. Each has one core and the precision of this process; what one of
    them compiled the others find in a folder. Results are the same to the bit for any number.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count
        self._executor: ProcessPoolExecutor | None = None
        self._compiled: tempfile.TemporaryDirectory | None = None

    def __enter__(self) -> "Workers":
        if self.count > 1 and not CONFIG.jax_compilation_cache_dir:
            self._compiled = tempfile.TemporaryDirectory(prefix="jaxtissue-", ignore_cleanup_errors=True)
            jax.config.update("jax_compilation_cache_dir", self._compiled.name)
            reset_cache()  # JAX opens it once
        return self

    def __exit__(self, *_: object) -> None:
        if self._executor:
            self._executor.shutdown(cancel_futures=True)
        if self._compiled:
            jax.config.update("jax_compilation_cache_dir", None)
            reset_cache()
            self._compiled.cleanup()

    def run(self, function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        """Number and result of each call, by its arguments, as they end.

        Function, arguments and results must be such as `pickle` takes, if there are more processes and calls
        than one.
        """
        if min(self.count, len(calls)) < 2:
            yield from ((number, function(*call)) for number, call in enumerate(calls))
            return
        executor = self._start()
        with _ignoring_interrupts():  # as do the processes that it starts, until they are set up
            numbers = {executor.submit(function, *call): number for number, call in enumerate(calls)}
        try:
            for future in as_completed(numbers):
                yield numbers[future], future.result()
        except BrokenProcessPool as error:
            told = "a worker process died: it was killed, or memory ran out"
            raise ChildProcessError(f"{told}; repeat the command to continue from the saved results") from error
        finally:  # where one failed or the others are not wanted
            for future in numbers:
                future.cancel()

    def _start(self) -> ProcessPoolExecutor:
        if not self._executor:
            self._executor = ProcessPoolExecutor(
                self.count,
                multiprocessing.get_context("spawn"),  # JAX's threads do not survive a fork
                _set_up,
                (CONFIG.jax_compilation_cache_dir, CONFIG.jax_enable_x64),
            )
        return self._executor


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C, where that can be said: in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


def _set_up(compiled: str | None, x64: bool) -> None:
    """Make this process a worker."""
    gc.enable()  # a command's process puts it off until its imports are done
    use_cores(1)
    keep_usual_modes()
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", x64)
    jax.config.update("jax_compilation_cache_dir", compiled)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a word
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process with its parent: a parent that is killed does not end it."""
    if parent := multiprocessing.parent_process():
        parent.join()
        os._exit(1)
