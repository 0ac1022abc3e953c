"""Turn off a faulty optimization of JAX's CPU compiler, before JAX starts."""

import os
import re
import sys
import warnings
from importlib.metadata import version

OPTION = "xla_cpu_experimental_ynn_fusion_type"
WRONG, RIGHT = (0, 10, 2), (0, 12)  # the first jaxlib whose sums may be wrong, and the first known to be right


def turn_off_wrong_sums() -> None:
    """Keep the CPU compiler of jaxlib 0.10.2 and 0.11 from handing sums to YNNPACK, which now and then adds wrongly.

    There a sum over 16,384 numbers came out half as large again in one of 1,000 runs, and others are wrong each time
    (jax issue 39103). Of 0.12 none was in 8,000. A setting of this option by the user is kept. It works through the
    environment variable XLA_FLAGS, which JAX reads when it starts; if it has started, a warning says what to do.
    """
    found = tuple(int(number) for number in re.findall(r"\d+", version("jaxlib"))[:3])
    flags = os.environ.get("XLA_FLAGS", "")
    if not WRONG <= found < RIGHT or OPTION in flags:
        return
    os.environ["XLA_FLAGS"] = f"{flags} --{OPTION}=".strip()
    if _has_started():
        cure = f"import jaxtissue before using JAX, or set XLA_FLAGS=--{OPTION}="
        told = f"jaxlib {version('jaxlib')} may compute wrong sums on CPUs, and JAX has already started"
        warnings.warn(f"{told}; {cure}", stacklevel=3)


def _has_started() -> bool:
    """Whether JAX has read its flags, as far as it tells."""
    tell = getattr(sys.modules.get("jax._src.xla_bridge"), "backends_are_initialized", None)
    return tell is not None and tell()


turn_off_wrong_sums()
