"""How many processor cores this process may use."""

import multiprocessing
import os


def usable_cores() -> int:
    """The cores that this process may run on, as its scheduler or `taskset` allows; at least one."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usable_threads() -> int:
    """How many threads to work with on the host: one in a worker process, beside which others work."""
    return 1 if multiprocessing.parent_process() else usable_cores()
