"""The number of processor cores that this process may use, and distribution of work over them."""

import multiprocessing
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

Part = TypeVar("Part")
Result = TypeVar("Result")


def usable_cores() -> int:
    """The cores that this process may run on, as its scheduler or `taskset` allows; at least one."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usable_threads() -> int:
    """The number of threads to work with on the host: one in a worker process."""
    return 1 if multiprocessing.parent_process() else usable_cores()


def in_threads(work: Callable[[Part], Result], parts: Iterable[Part]) -> list[Result]:
    """The results of `work` on each part, in order.

    NumPy lets other threads go on while it works on large arrays.
    """
    parts, threads = list(parts), usable_threads()
    if threads == 1 or len(parts) == 1:
        return [work(part) for part in parts]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, parts))


def cut(count: int, least: int) -> list[slice]:
    """As many rows in equal parts, one for each thread, of at least so many."""
    parts = max(1, min(usable_threads(), count // least))
    ends = [count * part // parts for part in range(parts + 1)]
    return [slice(*pair) for pair in pairwise(ends)]
