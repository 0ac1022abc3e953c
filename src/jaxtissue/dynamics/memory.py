"""An estimate of the memory that a run needs, and the memory of the machine."""

import os

from jaxtissue.dynamics.independent_sets import ROUNDS
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import Resolution, plan_lines
from jaxtissue.neighbors.search import A_SIDE
from jaxtissue.neighbors.shortlists import shortlist_length

BASE = 650e6  # bytes of Python, JAX and the compiled programs, whatever the tissue
LOOKS = 2  # measured states kept at once: at the begin and at the end of a span
SCRATCH = 1.8  # bytes that are allocated at the peak for each that is counted here, fitted


def estimate_memory(
    cells: int, tube: Tube, resolution: Resolution | str, replicas: int = 1, float_bytes: int = 4
) -> int:
    """Peak memory of an annealing run in bytes: a base, and so much for each cell of each replica.

    base + replicas n (2 looks + lists + state + one round's tables): a look has for each of 2 x 56 candidates
    its number, on host and device, clearance, distance and two flags, and the reach on each line. Fitted to
    peaks by `draft` on one CPU from random backbones: 561, 657, 1,506 and 2,072 MiB at n = 500, 5,000, 50,000
    and 100,000.

    >>> tube = Tube(length=1000, apical_radius=1, basal_radius=10)
    >>> print(describe_bytes(estimate_memory(5000, tube, Resolution(4, 4))))
    0.7 GB
    """
    reach = 2 * plan_lines(tube, cells, resolution).row * float_bytes
    listed = 2 * A_SIDE
    look = listed * (4 + 4 + 2 * float_bytes + 2) + reach
    few = shortlist_length(cells)
    around = 4 * few  # as many again have the cell on their lists
    lists = 4 * (2 * few + around)
    a_round = around * reach / ROUNDS
    each = LOOKS * look + listed * float_bytes + lists + 2 * reach + a_round
    return int(BASE + SCRATCH * replicas * cells * each)


def machine_memory() -> int | None:
    """The memory of the machine in bytes, or None where the system does not tell."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def memory_warning(needed: int, available: int | None) -> str | None:
    """A warning for a run that needs more memory than there is; None where the memory is enough.

    >>> print(memory_warning(int(20e9), int(16e9)).split(";")[0])
    the run needs about 20.0 GB of memory, but the machine has 16.0 GB
    >>> memory_warning(int(2e9), int(16e9))
    """
    if available is None or needed <= available:
        return None
    return (
        f"the run needs about {describe_bytes(needed)} of memory, but the machine has "
        f"{describe_bytes(available)}; use fewer cells or replicas, or a coarser resolution"
    )


def tell_memory(cells: int, tube: Tube, resolution: Resolution | str, float_bytes: int = 4, replicas: int = 1) -> str:
    """The line printed before a run: about how much memory it takes, or a warning if there is not so much."""
    needed = estimate_memory(cells, tube, resolution, replicas, float_bytes)
    warning = memory_warning(needed, machine_memory())
    return f"warning: {warning}" if warning else f"memory: about {describe_bytes(needed)}"


def describe_bytes(count: int) -> str:
    """A number of bytes as text, in GB.

    >>> describe_bytes(1_520_000_000)
    '1.5 GB'
    """
    return f"{count / 1e9:.1f} GB"
