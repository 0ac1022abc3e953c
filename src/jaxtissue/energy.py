"""The energy of a tissue, a sum over the cells (paper, section 3.1)."""

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
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.positions import X64
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion, check_adhesion
from jaxtissue.measurement.cell_geometry import CellGeometry

CONSTANTS = ("mean_volume", "modulus", "tension")
CellEnergy = Callable[[CellGeometry, "Model"], Float[Array, "cells"]]


@usual_modes()
def volume_elasticity(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """The elastic energy K/2 (Vbar - V_i)^2 of each cell: the cost of a volume that differs from the mean volume.

    The first term of the paper's energy (section 3.1).

    Args:
        cells: The sizes of the cells; only `volume` is read.
        model: The model, of which the modulus K and the mean volume Vbar are read.

    Returns:
        The energy of each cell, [cells], in the unit of energy that K sets.

    >>> model = tube_model(Tube(10, 1, 2), 3, modulus=2.0)
    >>> cells = CellGeometry(volume=model.mean_volume + jnp.array([0.0, 1.0, -2.0]), lateral_area=jnp.ones(3))
    >>> volume_elasticity(cells, model).round(3).tolist()
    [0.0, 1.0, 4.0]
    """
    return model.modulus / 2 * (model.mean_volume - cells.volume) ** 2


@usual_modes()
def lateral_tension(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """The energy Lambda A_i of the lateral walls that each cell shares with other cells.

    The second term of the paper's energy (section 3.1).

    Args:
        cells: The sizes of the cells; only `lateral_area` is read.
        model: The model, of which the tension Lambda is read.

    Returns:
        The energy of each cell, [cells].

    >>> cells = CellGeometry(volume=jnp.ones(2), lateral_area=jnp.array([1.0, 3.0]))
    >>> lateral_tension(cells, tube_model(Tube(10, 1, 2), 2, tension=0.5)).tolist()
    [0.5, 1.5]
    """
    return model.tension * cells.lateral_area


@usual_modes()
def epithelial_energy(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """The paper's energy of each cell, E_i = K/2 (Vbar - V_i)^2 + Lambda A_i (section 3.1).

    Args:
        cells: The sizes of the cells; `volume` and `lateral_area` are read.
        model: The model, with the modulus K, the mean volume Vbar and the tension Lambda.

    Returns:
        The energy of each cell, [cells]; the energy of the tissue is its sum.

    >>> model = tube_model(Tube(10, 1, 2), 2)
    >>> cells = CellGeometry(volume=jnp.full(2, model.mean_volume), lateral_area=jnp.array([1.0, 3.0]))
    >>> [round(energy, 3) for energy in epithelial_energy(cells, model).tolist()]
    [0.4, 1.2]
    """
    return volume_elasticity(cells, model) + lateral_tension(cells, model)


class Model(eqx.Module):
    """The energy model of a tissue: its domain, its constants, and the energy of a cell (paper, section 3.1).

    The constants are one number each, the same for all cells; `parameters` differ from cell to cell. All fields but the
    function are traced, so that they change without recompiling. `tube_model` makes a model with Vbar = |D| / n.

    Attributes:
        domain: The tube or other domain that the cells fill.
        mean_volume: Vbar, the mean volume of a cell.
        modulus: K, the weight of the volume term.
        tension: Lambda, the weight of the lateral area.
        cell_energy: A function `cell_energy(cells, model)` that gives the energy E_i of each cell, [cells]. It may be
            any jittable function of `CellGeometry.volume` and `lateral_area` (of the sizes on the surfaces too, after
            `with_surfaces`) in which the energy of a cell depends on the sizes of that cell alone.
        parameters: A pytree of arrays with the cells as first axis, [n, ...], or None. Where the function is called
            for a part of the cells, `model.parameters` holds the rows of that part.
        adhesion: How walls count by the types of the two cells that they part, or None. `lateral_area` is then the sum
            of the areas of a cell's walls, each times the weight of its pair of types. Weights above 1 between unlike
            types make these separate, as differential adhesion does.
        has_surfaces: Whether `cell_energy` is given the areas and perimeters on the apical and basal surface too; see
            `with_surfaces`.
    """

    domain: Tube | Domain
    mean_volume: float | Array
    modulus: float | Array = 1.0
    tension: float | Array = 0.4
    cell_energy: CellEnergy = eqx.field(static=True, default=epithelial_energy)
    parameters: Any = None
    adhesion: Adhesion | None = None
    has_surfaces: bool = eqx.field(static=True, default=False)

    @property
    def tube(self) -> Tube:
        """The domain, if that is a tube; raises `AttributeError` for other domains."""
        if isinstance(self.domain, Tube):
            return self.domain
        raise AttributeError(f"a model of {type(self.domain).__name__} has no tube; use model.domain")

    def with_surfaces(self) -> "Model":
        """The same model for a `cell_energy` that reads areas and perimeters on the apical and basal surface.

        They are measured in every move, so that a sweep takes 1.2 to 1.6 times as long; without this they are None.

        >>> def contractile(cells, model):
        ...     return epithelial_energy(cells, model) + 0.1 * cells.apical_perimeter**2
        >>> tube_model(Tube(10, 1, 2), 30, cell_energy=contractile).with_surfaces().has_surfaces
        True
        """
        return replace(self, has_surfaces=True)

    def of(self, cells: Int[Array | np.ndarray, "cells"]) -> "Model":
        """The model for a part of the cells, by their numbers, with the rows of the parameters that belong to them."""
        if self.parameters is None:
            return self
        rows = jax.tree.map(lambda table: take_rows(table, jnp.asarray(cells)), self.parameters)
        return replace(self, parameters=rows)


def tube_model(
    tube: Tube | Domain,
    cells: int,
    modulus: float = 1.0,
    tension: float = 0.4,
    cell_energy: CellEnergy = epithelial_energy,
    relative: bool = False,
    parameters: Any = None,
    adhesion: Adhesion | None = None,
) -> Model:
    """The energy model of `cells` cells that fill a domain, with Vbar = |D| / n (paper, sections 3.1 and 4.3).

    The defaults are the paper's constants, K = 1 and Lambda = 0.4.

    Args:
        tube: The tube, or any other domain, that the cells fill.
        cells: n, the number of cells.
        modulus: K, the weight of the volume term.
        tension: Lambda, the weight of the lateral area.
        cell_energy: The energy of each cell as a function of its sizes and the model; see `Model`.
        relative: Whether K and Lambda have no units: E_i = K/2 (1 - V_i / Vbar)^2 + Lambda A_i / Vbar^(2/3), so that a
            tissue has the same energy in every unit of length. A `cell_energy` of your own then finds the modulus
            K / Vbar^2 and the tension Lambda / Vbar^(2/3).
        parameters: Values that a `cell_energy` of your own needs of each cell, such as target volumes: an array, or a
            dictionary, tuple or other tree of arrays, with one row for each cell.
        adhesion: Types of the cells, and how much walls between two types count; by default all count alike.

    Returns:
        The model.

    Raises:
        ValueError: If the modulus or the tension is no number, negative or not finite, if there are no cells, or if the
            parameters do not have one row for each cell or are not finite numbers.

    >>> def energy(cells, model):
    ...     return (cells.volume - model.parameters) ** 2
    >>> tube = Tube(10, 1, 2)
    >>> model = tube_model(tube, 3, cell_energy=energy, parameters=jnp.array([1.0, 2.0, 3.0]))
    >>> energy(CellGeometry(jnp.ones(2), jnp.ones(2)), model.of(jnp.array([2, 0]))).tolist()
    [4.0, 0.0]
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
    """Raise `ValueError` unless the parameters have one row of finite numbers for each of `cells` cells."""
    for path, table in jax.tree_util.tree_leaves_with_path(parameters):
        name = f"parameters{jax.tree_util.keystr(path)}"
        if np.ndim(table) == 0 or len(table) != cells:
            raise ValueError(
                f"{name} has the shape {np.shape(table)}; give an array with one row for each of {cells} cells"
            )
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


def cell_energies(cells: CellGeometry, model: Model) -> Float[Array, "cells"]:
    """The energy E_i of each cell by the model's function.

    Raises `ValueError`, while it is traced, for constants that are not one number each and for an energy that
    does not give one number for each cell.
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
    """Raise `ValueError` for an energy that cannot be annealed in the precision JAX works in.

    The function is tried on a small number of cells of about the mean volume. The constants must be one number each,
    and the energies one finite number for each cell that depends on that cell alone and neither overflows nor
    underflows.
    """
    for name in CONSTANTS:
        _check_constant(name, getattr(model, name))
    dtype = np.dtype(jnp.result_type(float))
    with np.errstate(over="ignore"):
        model = in_precision(model, dtype)
        volume: Any = np.array([0.5, 1.001, 1.5, 2], dtype) * model.mean_volume
        area: Any = np.array([5, 6, 7, 8], dtype) * model.mean_volume ** dtype.type(2 / 3)
    cells = CellGeometry(volume, area, *[area / 6, area / 5, area**0.5, 1.1 * area**0.5] * model.has_surfaces)
    try:
        rows = np.arange(4) % min(map(len, jax.tree.leaves(model.parameters)), default=4)
        energy = tissue_energies(cells, model.of(rows))
        part = tissue_energies(jax.tree.map(lambda size: size[:2], cells), model.of(rows[:2]))
    except (TypeError, IndexError, KeyError, AttributeError) as error:
        reason = " ".join(str(error).split())
        none = "NoneType" in reason and not model.has_surfaces
        cure = "use model.with_surfaces() if it reads sizes there" if none else "give a function of each cell alone"
        raise ValueError(f"{_name(model)} fails ({reason}); {cure}") from error
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
