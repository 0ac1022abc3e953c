"""Stopping a process by a signal: immediately with one line, or a run after its current span of sweeps."""

import contextlib
import gc
import os
import signal
import sys
import threading
from pathlib import Path
from typing import ClassVar, NoReturn

BEING_WRITTEN: set[Path] = set()  # files that are removed where the process ends at once


class Stop:
    """Notes SIGTERM and Ctrl-C, so that a sweep can be finished first; a second one ends at once.

    A signal that the process was started to ignore, as by `nohup` or in the background, stays ignored.
    """

    noting: ClassVar[bool] = False  # one of these waits for a signal, or has had it

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def __enter__(self) -> "Stop":
        both = (signal.SIGINT, signal.SIGTERM)
        noted = [number for number in both if signal.getsignal(number) is not signal.SIG_IGN]
        self._usual = {number: signal.signal(number, self._note) for number in noted}
        Stop.noting = True
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()
        Stop.noting = False

    def _restore(self) -> None:
        for number, handler in self._usual.items():
            signal.signal(number, handler)

    def _note(self, number: int, _: object) -> None:
        self.signal = signal.Signals(number)
        self._restore()


def answer_signals() -> None:
    """Let SIGTERM and Ctrl-C end the command in one line, from the first import on, but for a `Stop`.

    Only where this process is the command: `jaxtissue` or `python -m jaxtissue`. What it was told to ignore,
    as by `nohup`, it ignores. A thread answers, since the main one hears of nothing while it compiles.
    """
    name = sys.argv[0] if sys.argv else ""
    is_command = Path(name).stem == "jaxtissue" or (name == "-m" and "jaxtissue" in sys.orig_argv)
    if not is_command or os.name != "posix":
        return
    gc.disable()
    told, tell = os.pipe()
    os.set_blocking(tell, False)
    threading.Thread(target=_answer, args=(told,), daemon=True).start()
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


def _answer(told: int) -> None:
    """End the process at a signal, or at the second where a `Stop` notes the first."""
    is_noted = False
    while True:
        number = os.read(told, 1)[0]
        if number in (signal.SIGINT, signal.SIGTERM):
            if is_noted or not Stop.noting:
                _end(number)
            is_noted = True


def _end(number: int) -> NoReturn:
    """End the process, whatever its threads are at."""
    line = f"jaxtissue: error: stopped by {signal.Signals(number).name}; the results saved so far are kept\n"
    try:
        for path in list(BEING_WRITTEN):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            os.write(2, line.encode())
    finally:
        os._exit(128 + number)


answer_signals()
