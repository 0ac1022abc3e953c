"""Devices of JAX: one per processor core."""

import os

import jax

from jaxtissue.system.cores import usable_cores


def use_cores(most: int) -> None:
    """Make JAX expose each processor core as a separate single-threaded device.

    This speeds up computations that are spread over devices, such as replicas that run together (`temper`), because
    small loops run best on one thread each. Call it before anything else, as it has no effect once JAX is initialized.
    The number of devices is min(number of usable cores, `most`), but at least 1. It is left unchanged if it has already
    been set by `JAX_NUM_CPU_DEVICES` or `XLA_FLAGS`. The environment variable `NPROC`, the number of threads of XLA, is
    set to 1 unless it has a value.

    Args:
        most: Maximum number of devices.

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
