"""`python -m jaxtissue` is the command line."""

import gc
import os
import sys

from jaxtissue.cli.commands import main
from jaxtissue.compilation import program_cache


def run() -> None:
    """Run the command and end the process.

    A command that was stopped does not wait for threads that still compile.
    """
    gc.freeze()  # what was imported stays, and need not be looked through
    gc.enable()  # `stopping` put it off until here
    program_cache.is_on = True
    code = main()
    gc.freeze()
    if code > 128:
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    run()
