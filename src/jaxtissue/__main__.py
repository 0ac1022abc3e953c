"""`python -m jaxtissue` is the command line."""

import os
import sys

from jaxtissue.cli import main


def run() -> None:
    """Run the command and end the process.

    A command that was stopped does not wait for threads that still compile.
    """
    code = main()
    if code > 128:
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    run()
