"""`python -m jaxtissue` is the command line."""

import atexit
import gc
import os
import sys
from contextlib import suppress

import jax

from jaxtissue.cli.commands import main
from jaxtissue.compilation import program_cache


def run() -> None:
    """Run the command and end the process.

    A command that was stopped does not wait for threads that still compile. Others end once what Python does at
    exit is done, without taking JAX down, which takes a third of a second.
    """
    gc.freeze()  # what was imported stays, and need not be looked through
    gc.enable()  # `stopping` put it off until here
    program_cache.is_on = True
    codes: list[int] = []
    atexit.register(_leave, codes)
    code = main()
    gc.freeze()
    if code > 128:
        sys.stderr.flush()
        os._exit(code)
    if not jax.distributed.is_initialized():  # others wait for this process to take leave of them
        codes.append(code)
    sys.exit(code)


def _leave(codes: list[int]) -> None:
    """End with the code, if there is one."""
    if codes:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os._exit(codes[0])


if __name__ == "__main__":
    run()
