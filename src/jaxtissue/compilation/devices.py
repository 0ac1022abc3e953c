"""The devices that JAX computes on: processor cores, each as one."""

import os

import jax

from jaxtissue.system.cores import usable_cores


def use_cores(most: int) -> None:
    """Let JAX see each processor core as a device, with one thread each.

    A sweep is one small loop after another, over which threads wait for each other: two threads take a tenth longer
    than one, and at times twice as long. JAX_NUM_CPU_DEVICES and NPROC, where they are set, are left as they are, and
    nothing changes after JAX has computed anything: call this first.

    Args:
        most: The largest number of devices.

    >>> use_cores(2)  # doctest: +SKIP
    """
    os.environ.setdefault("NPROC", "1")  # threads of XLA, which reads it when it starts
    cores = usable_cores()
    forced = "device_count" in os.environ.get("XLA_FLAGS", "")
    if forced or getattr(jax.config, "jax_num_cpu_devices", -1) > 0:
        return
    try:
        jax.config.update("jax_num_cpu_devices", max(1, min(cores, most)))
    except RuntimeError:
        return
