"""jaxtissue: simulate and measure 3D epithelial tubes from their cells' backbones.

>>> import jax, jaxtissue as jt
>>> tube = jt.Tube(length=12, apical_radius=1, basal_radius=3)
>>> positions = tube.random_positions(jax.random.key(0), 40)
>>> cells = jt.measure_tissue(positions, tube)
>>> bool(abs(cells.volume.sum() / tube.volume - 1) < 1e-3)
True
"""

import jaxtissue.compilation.flags
import jaxtissue.system.signals  # noqa: F401  Ctrl-C is answered from here on: importing JAX takes a second

# isort: split
from importlib.metadata import version

import lazy_loader

# the names in __init__.pyi are imported when they are used: a command imports only what it needs
__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("jaxtissue")


def __dir__() -> list[str]:
    """The public names alone; rooms and modules are internal."""
    return [*__all__, "__version__"]
