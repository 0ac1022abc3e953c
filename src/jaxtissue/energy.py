"""The energy of a tissue: a sum of per-cell terms (paper, section 3.1)."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from jaxtissue.cells import CellGeometry
from jaxtissue.tube import Tube

CellEnergy = Callable[[CellGeometry, "Model"], Float[Array, "cells"]]


def volume_elasticity(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """K/2 (Vbar - V_i)^2 of each cell: what it costs not to have the mean volume."""
    return model.modulus / 2 * (model.mean_volume - cells.volume) ** 2


def lateral_tension(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """Lambda A_i of each cell: the tension of its walls with other cells."""
    return model.tension * cells.lateral_area


def epithelial_energy(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """E_i = K/2 (Vbar - V_i)^2 + Lambda A_i, the paper's energy."""
    return volume_elasticity(cells, model) + lateral_tension(cells, model)


class Model(eqx.Module):
    """What a tissue's energy depends on beside the backbones: its tube, its constants, and the energy itself.

    `modulus` is K, `tension` Lambda, `mean_volume` Vbar; `cell_energy(cells, model)` gives E_i of each cell
    and may be any jittable function of `CellGeometry.volume` and `lateral_area`. All but that are traced.
    """

    tube: Tube
    mean_volume: float | Array
    modulus: float | Array = 1.0
    tension: float | Array = 0.4
    cell_energy: CellEnergy = eqx.field(static=True, default=epithelial_energy)


def tube_model(
    tube: Tube,
    cells: int,
    modulus: float = 1.0,
    tension: float = 0.4,
    cell_energy: CellEnergy = epithelial_energy,
) -> Model:
    """The model of `cells` cells that fill `tube`: Vbar = |D| / n. The paper's constants are the defaults.

    Raises `ValueError` for a modulus or tension that is negative or not finite, and for no cells.
    """
    for name, value in (("modulus", modulus), ("tension", tension)):
        if not 0 <= value < float("inf"):
            raise ValueError(f"{name}={value} is not a finite number of at least 0; give one")
    if cells < 1:
        raise ValueError(f"cells={cells}: a tissue has at least one cell")
    return Model(tube, tube.volume / cells, modulus, tension, cell_energy)
