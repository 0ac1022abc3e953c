"""Distribution of work: one process, a job of a Slurm array, or one of several processes under JAX."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import jax
from jax.experimental import multihost_utils

T = TypeVar("T")


@dataclass(frozen=True)
class Part:
    """Part `number` of `count`, counted from 0; `joined` where the others run at the same time under JAX."""

    number: int = 0
    count: int = 1
    joined: bool = False

    def share(self, rows: Sequence[T]) -> list[T]:
        """Every `count`-th row, so that neighbors in a grid spread over all parts.

        >>> Part(1, 3).share("abcdefg")
        ['b', 'e']
        """
        return list(rows[self.number :: self.count])

    def wait(self, name: str) -> None:
        """Wait until all processes are here; those of parts that are not joined do not wait.

        Raises `ConnectionError` where one is lost.
        """
        try:
            if self.joined:
                multihost_utils.sync_global_devices(name)
        except RuntimeError as error:
            raise ConnectionError(f"the connection to another process was lost ({error})") from error


def slurm_part(environment: Mapping[str, str] = os.environ) -> Part:
    """The part of this job in a Slurm array. Raises `ValueError` outside of one, and for one with gaps.

    >>> slurm_part({"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_MIN": "5", "SLURM_ARRAY_TASK_COUNT": "4"})
    Part(number=2, count=4, joined=False)
    """
    names = ("ID", "COUNT", "MIN", "STEP")
    task = {name: environment.get(f"SLURM_ARRAY_TASK_{name}") for name in names}
    if not (task["ID"] and task["COUNT"]):
        raise ValueError(
            "SLURM_ARRAY_TASK_ID and SLURM_ARRAY_TASK_COUNT are not set; use --slurm only in a job of sbatch --array"
        )
    number, rest = divmod(int(task["ID"]) - int(task["MIN"] or 0), int(task["STEP"] or 1))
    if rest or not 0 <= number < int(task["COUNT"]):
        raise ValueError(f"SLURM_ARRAY_TASK_ID={task['ID']}: the job array has gaps; submit it with --array=0-N")
    return Part(number, int(task["COUNT"]))


def join(coordinator: str | None, place: tuple[int, int] | None) -> Part:
    """Join the processes that run together, at a coordinator as process (number, count).

    Without these the environment tells them (Slurm, Open MPI, Kubernetes, Cloud TPU). Raises `ValueError` where that
    fails.
    """
    number, count = place if place else (None, None)
    try:
        # processes that are done first wait for the others in the end
        jax.distributed.initialize(coordinator, count, number, shutdown_timeout_seconds=3600)
    except (RuntimeError, ValueError) as error:
        remedy = "give --coordinator HOST:PORT and --process K/N"
        raise ValueError(f"the processes can't connect to each other ({error}); {remedy}") from error
    return Part(jax.process_index(), jax.process_count(), joined=True)
