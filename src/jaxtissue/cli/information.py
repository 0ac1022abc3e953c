"""The command `info`, which prints versions, devices, precision and optional packages."""

from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp

from jaxtissue.runs.settings import versions

EXTRAS = ("pandas", "pyarrow", "tifffile", "trimesh", "pyvista", "anndata", "zarr")


def info(arguments: dict[str, Any]) -> int:
    """Show versions, devices, precision and the optional packages found."""
    jax.config.update("jax_enable_x64", arguments["x64"])
    for name, version in versions().items():
        print(f"{name:12}{version}")
    print(f"{'devices':12}{', '.join(map(str, jax.devices()))}")
    print(f"{'x64':12}{'on' if jnp.result_type(float) == jnp.float64 else 'off'}")
    print(f"{'extras':12}{', '.join(name for name in EXTRAS if find_spec(name)) or 'none'}")
    return 0
