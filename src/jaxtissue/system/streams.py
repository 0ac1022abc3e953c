"""Standard streams that accept any text, also if they are closed or have another encoding."""

import os
import sys
from io import TextIOWrapper


def open_streams() -> None:
    """Open what is closed of stdin, stdout and stderr to nothing, and escape what the others can't encode.

    A file opened later would else take the number of a stream, and hold what libraries report there.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
