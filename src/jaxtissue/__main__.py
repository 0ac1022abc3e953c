"""`python -m jaxtissue` is the command line."""

import sys

from jaxtissue.cli import main

if __name__ == "__main__":
    sys.exit(main())
