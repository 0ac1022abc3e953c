"""How a run is stopped from outside without losing the sweep it is in."""

import signal


class Stop:
    """Notes SIGTERM and Ctrl-C, so that a sweep can be finished first; a second one ends at once."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def __enter__(self) -> "Stop":
        noted = (signal.SIGINT, signal.SIGTERM)
        self._usual = {number: signal.signal(number, self._note) for number in noted}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._usual.items():
            signal.signal(number, handler)

    def _note(self, number: int, _: object) -> None:
        self.signal = signal.Signals(number)
        self.__exit__()
