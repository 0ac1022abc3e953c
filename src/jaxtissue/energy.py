"""The energy of a tissue: a sum of per-cell terms (paper, section 3.1)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import take_rows
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.positions import X64
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cells import Adhesion, CellGeometry

CONSTANTS = ("mean_volume", "modulus", "tension")
CellEnergy = Callable[[CellGeometry, "Model"], Float[Array, "cells"]]


@usual_modes()
def volume_elasticity(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """K/2 (Vbar - V_i)^2 of each cell: what it costs not to have the mean volume."""
    return model.modulus / 2 * (model.mean_volume - cells.volume) ** 2


@usual_modes()
def lateral_tension(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """Lambda A_i of each cell: the tension of its walls with other cells."""
    return model.tension * cells.lateral_area


@usual_modes()
def epithelial_energy(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """E_i = K/2 (Vbar - V_i)^2 + Lambda A_i, the paper's energy."""
    return volume_elasticity(cells, model) + lateral_tension(cells, model)


class Model(eqx.Module):
    """What a tissue's energy depends on beside the backbones: its tube, its constants, and the energy itself.

    `modulus` is K, `tension` Lambda, `mean_volume` Vbar; `cell_energy(cells, model)` gives E_i of each cell
    and may be any jittable function of `CellGeometry.volume` and `lateral_area`, of which each cell's energy
    depends on its own alone. The constants are one number each, the same for all cells; what differs from cell
    to cell is in `parameters`, arrays whose first axis is the cells, [n, ...]. Where the energy of some cells is
    asked for, `model.parameters` holds the rows of these. All but the function are traced.

    With an `adhesion`, walls count by the types of the two cells that they part: `lateral_area` is then the sum of
    the areas of a cell's walls, each times the weight of its pair of types. Weights above 1 between unlike types
    make them part, as differential adhesion does.
    """

    tube: Tube
    mean_volume: float | Array
    modulus: float | Array = 1.0
    tension: float | Array = 0.4
    cell_energy: CellEnergy = eqx.field(static=True, default=epithelial_energy)
    parameters: Any = None  # a pytree of arrays [n, ...]
    adhesion: Adhesion | None = None

    def of(self, cells: Int[Array | np.ndarray, "cells"]) -> "Model":
        """The model of some cells: with the rows of the parameters that are theirs."""
        if self.parameters is None:
            return self
        rows = jax.tree.map(lambda table: take_rows(table, jnp.asarray(cells)), self.parameters)
        return replace(self, parameters=rows)


def tube_model(
    tube: Tube,
    cells: int,
    modulus: float = 1.0,
    tension: float = 0.4,
    cell_energy: CellEnergy = epithelial_energy,
    relative: bool = False,
    parameters: Any = None,
    adhesion: Adhesion | None = None,
) -> Model:
    """The model of `cells` cells that fill `tube`: Vbar = |D| / n. The paper's constants are the defaults.

    `relative` constants have no units: E_i = K/2 (1 - V_i / Vbar)^2 + Lambda A_i / Vbar^(2/3), so that a
    tissue has the same energy in every unit of length; those of an energy of one's own are K / Vbar^2 and
    Lambda / Vbar^(2/3).

    `parameters` are what an energy of one's own knows of each cell, such as target volumes: an array or a
    dictionary, tuple or other tree of arrays with one row for each cell.

    >>> def energy(cells, model):
    ...     return (cells.volume - model.parameters) ** 2
    >>> tube = Tube(10, 1, 2)
    >>> model = tube_model(tube, 3, cell_energy=energy, parameters=jnp.array([1.0, 2.0, 3.0]))
    >>> energy(CellGeometry(jnp.ones(2), jnp.ones(2)), model.of(jnp.array([2, 0]))).tolist()
    [4.0, 0.0]

    Raises `ValueError` for a modulus or tension that is no number, negative or not finite, for no cells, and for
    parameters that have not one row for each cell or are not finite numbers.
    """
    for name, value in (("modulus", modulus), ("tension", tension)):
        _check_constant(name, value)
        if not isinstance(value, Tracer) and not 0 <= value < float("inf"):
            raise ValueError(f"{name}={value} is not a finite number of at least 0; give one")
    if cells < 1:
        raise ValueError(f"cells={cells}: a tissue has at least one cell")
    check_parameters(parameters, cells)
    check_adhesion(adhesion, cells)
    mean = tube.volume / cells
    units = (mean**2, mean ** (2 / 3)) if relative else (1, 1)
    return Model(tube, mean, modulus / units[0], tension / units[1], cell_energy, parameters, adhesion)


def check_parameters(parameters: Any, cells: int) -> None:
    """Raise `ValueError` for parameters that have not one row of finite numbers for each of so many cells."""
    for path, table in jax.tree_util.tree_leaves_with_path(parameters):
        name = f"parameters{jax.tree_util.keystr(path)}"
        if np.ndim(table) == 0 or len(table) != cells:
            raise ValueError(f"{name} has the shape {np.shape(table)}; give one row for each of {cells} cells")
        if not isinstance(table, Tracer) and not np.isfinite(np.asarray(table, float)).all():
            raise ValueError(f"{name} holds what is not a finite number; give one for each cell")


def in_precision(model: Model, dtype: DTypeLike) -> Model:
    """The model with its numbers as NumPy arrays in a precision; whole numbers among the parameters stay whole."""

    def convert(leaf: Any) -> np.ndarray:
        return np.asarray(leaf, dtype if np.asarray(leaf).dtype.kind == "f" else None)

    constants = replace(model, parameters=None, adhesion=None)
    converted = jax.tree.map(lambda leaf: np.asarray(leaf, dtype), constants)
    cells = jax.tree.map(convert, (model.parameters, model.adhesion))
    return replace(converted, parameters=cells[0], adhesion=cells[1])


def check_adhesion(adhesion: Adhesion | None, cells: int) -> None:
    """Raise `ValueError` for types that are not one whole number for each cell, or weights that are no weights."""
    if adhesion is None or isinstance(adhesion.types, Tracer) or isinstance(adhesion.weights, Tracer):
        return
    types, weights = np.asarray(adhesion.types), np.asarray(adhesion.weights)
    if types.shape != (cells,) or types.dtype.kind not in "iu":
        raise ValueError(
            f"types are {types.dtype} of shape {types.shape}; give a whole number for each of {cells} cells"
        )
    if weights.ndim != 2 or weights.shape[0] != weights.shape[1] or not np.isfinite(weights).all():
        raise ValueError(f"weights of shape {weights.shape}; give one finite number for each pair of types, [k, k]")
    if not np.array_equal(weights, weights.T):
        raise ValueError("weights are not symmetric; give the wall between two types one weight")
    if not (types.min(initial=0) >= 0 and types.max(initial=0) < len(weights)):
        raise ValueError(f"types go from {types.min()} to {types.max()}, and weights have {len(weights)} rows")


def cell_energies(cells: CellGeometry, model: Model) -> Float[Array, "cells"]:
    """E_i of each cell by the model's energy.

    Raises `ValueError`, while it is traced, for constants that are not one number each and for an energy that
    does not give one number a cell.
    """
    for name in CONSTANTS:
        _check_constant(name, getattr(model, name))
    found, wanted = model.cell_energy(cells, model), jnp.shape(cells.volume)
    if jnp.shape(found) != wanted or not jnp.issubdtype(jnp.result_type(found), jnp.floating):
        given = f"{jnp.result_type(found)} of shape {jnp.shape(found)} for cells of shape {wanted}"
        raise ValueError(f"{_name(model)} gives {given}; give one real number for each cell")
    return found


tissue_energies = jax.jit(cell_energies)  # outside of other programs: one instead of one for each operation


def check_energy(model: Model) -> None:
    """Raise `ValueError` for an energy that can't be annealed in the precision JAX works in.

    It is tried on a few cells of about the mean volume: constants must be one number each, and energies one
    finite number a cell that depends on that cell alone, neither over- nor underflowing.
    """
    for name in CONSTANTS:
        _check_constant(name, getattr(model, name))
    dtype = np.dtype(jnp.result_type(float))
    with np.errstate(over="ignore"):
        model = in_precision(model, dtype)
        volume: Any = np.array([0.5, 1.001, 1.5, 2], dtype) * model.mean_volume
        area: Any = np.array([5, 6, 7, 8], dtype) * model.mean_volume ** dtype.type(2 / 3)
    rows = np.arange(4) % min(map(len, jax.tree.leaves(model.parameters)), default=4)
    try:
        energy, part = (
            tissue_energies(CellGeometry(volume[:count], area[:count]), model.of(rows[:count])) for count in (4, 2)
        )
    except (TypeError, IndexError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{_name(model)} fails ({reason}); give a function of each cell alone") from error
    require_finite(energy, model)
    if not np.allclose(energy[:2], part, rtol=1e-3, atol=1e-6 * float(np.abs(energy).max())):
        raise ValueError(f"{_name(model)} of a cell depends on others; give a function of each cell alone")
    if model.cell_energy in (epithelial_energy, volume_elasticity):
        off = float(volume[1]) - float(model.mean_volume)
        right = float(model.modulus) / 2 * off**2
        least = np.asarray(volume_elasticity(CellGeometry(volume, area), model), float)[1]
        if not 0.9 * right <= least <= 1.1 * right:
            small = f"modulus={model.modulus} makes energies of {right:.1g}, which vanish in {dtype}"
            raise ValueError(f"{small}; change the unit of length or {X64}")


def require_finite(energies: Any, model: Model) -> None:
    """Raise `ValueError` for energies that are infinite or not numbers."""
    energy = np.asarray(energies)
    if np.isfinite(energy).all():
        return
    constants = ", ".join(f"{name}={float(getattr(model, name)):.6g}" for name in CONSTANTS)
    found = f"{_name(model)} is {energy[~np.isfinite(energy)][0]} in {energy.dtype} ({constants})"
    single = energy.dtype == np.float32
    raise ValueError(f"{found}; change units{f' or {X64}' if single else ''}, or correct the energy")


def _check_constant(name: str, value: Any) -> None:
    if isinstance(value, str | bool) or np.shape(value) != ():
        given = repr(value) if np.shape(value) == () else f"an array of shape {np.shape(value)}"
        raise ValueError(f"{name} is {given}; give one number, the same for all cells")


def _name(model: Model) -> str:
    return f"cell_energy {getattr(model.cell_energy, '__name__', model.cell_energy)}"
