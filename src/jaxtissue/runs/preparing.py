"""Work for the end of a run that is done beside its sweeps, which leave a processor core idle."""

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread
from typing import Any


class Preparation:
    """A thread that does one piece of work after another while the main thread goes on."""

    def __init__(self) -> None:
        self._results: dict[str, Future] = {}
        self._queue: SimpleQueue[tuple[Future, Callable[[], Any]]] = SimpleQueue()
        Thread(target=self._work, daemon=True).start()

    def add(self, name: str, work: Callable[[], Any]) -> None:
        """Have work done under a name, unless there is some of that name."""
        if name not in self._results:
            self._results[name] = Future()
            self._queue.put((self._results[name], work))

    def take(self, name: str, work: Callable[[], Any] = lambda: None) -> Any:
        """The result under that name, once it is there; if there is none, or it failed, that of other `work`.

        What failed beside will fail again in the main thread, and be told there.
        """
        with suppress(Exception):
            return self._results[name].result()
        return work()

    def _work(self) -> None:
        while True:
            result, work = self._queue.get()
            try:
                result.set_result(work())
            except Exception as error:
                result.set_exception(error)
