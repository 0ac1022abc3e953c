"""Energy of a tissue as a sum over its cells (section 3.1 of Buceta, Funke, Storandt, GRAPP 2025, "the paper")."""

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
from jaxtissue.geometry.positions import X64, check_count
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion, check_adhesion
from jaxtissue.measurement.cell_geometry import CellGeometry

CONSTANTS = ("mean_volume", "modulus", "tension")
CellEnergy = Callable[[CellGeometry, "Model"], Float[Array, "cells"]]


@usual_modes()
def volume_elasticity(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """Compute the elastic energy K/2 (Vbar - V_i)^2 of each cell, the first term of the paper's energy (section 3.1).

    Args:
        cells: Geometry of the cells, of which `volume` is used.
        model: Energy model, of which the modulus K and the mean volume Vbar are used.

    Returns:
        Energy of each cell, shape [cells], in the energy unit set by K.

    >>> model = tube_model(Tube(10, 1, 2), 3, modulus=2.0)
    >>> cells = CellGeometry(volume=model.mean_volume + jnp.array([0.0, 1.0, -2.0]), lateral_area=jnp.ones(3))
    >>> volume_elasticity(cells, model).round(3).tolist()
    [0.0, 1.0, 4.0]
    """
    return model.modulus / 2 * (model.mean_volume - cells.volume) ** 2


@usual_modes()
def lateral_tension(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """Compute the energy Lambda A_i of the walls of each cell, the second term of the paper's energy (section 3.1).

    The sum over the cells counts each wall twice, once for each of its two cells: the tension of a wall is 2 Lambda.

    Args:
        cells: Geometry of the cells, of which `lateral_area` is used.
        model: Energy model, of which the tension Lambda is used.

    Returns:
        Energy of each cell, shape [cells], in the energy unit set by Lambda.

    >>> cells = CellGeometry(volume=jnp.ones(2), lateral_area=jnp.array([1.0, 3.0]))
    >>> lateral_tension(cells, tube_model(Tube(10, 1, 2), 2, tension=0.5)).tolist()
    [0.5, 1.5]
    """
    return model.tension * cells.lateral_area


@usual_modes()
def epithelial_energy(cells: CellGeometry, model: "Model") -> Float[Array, "cells"]:
    """Compute the energy of each cell in the paper's model, E_i = K/2 (Vbar - V_i)^2 + Lambda A_i (section 3.1).

    The energy of the tissue is the sum over its cells, in which each wall between two cells counts twice.

    Args:
        cells: Geometry of the cells, of which `volume` and `lateral_area` are used.
        model: Energy model, of which the modulus K, the mean volume Vbar and the tension Lambda are used.

    Returns:
        Energy of each cell, shape [cells].

    >>> model = tube_model(Tube(10, 1, 2), 2)
    >>> cells = CellGeometry(volume=jnp.full(2, model.mean_volume), lateral_area=jnp.array([1.0, 3.0]))
    >>> [round(energy, 3) for energy in epithelial_energy(cells, model).tolist()]
    [0.4, 1.2]
    """
    return volume_elasticity(cells, model) + lateral_tension(cells, model)


class Model(eqx.Module):
    """Energy model of a tissue: its domain, the constants, and the energy function of a cell (paper, section 3.1).

    Create one with `tube_model`. `cell_energy` and `has_surfaces` are static under `jax.jit`; all other fields are
    traced and can change without recompilation.

    Attributes:
        domain: The tube or other domain that the cells fill.
        mean_volume: Vbar, mean volume of a cell, a scalar.
        modulus: K, weight of the volume term, a scalar. Defaults to 1.
        tension: Lambda, weight of the lateral area, a scalar. Defaults to 0.4.
        cell_energy: Jittable function `cell_energy(cells, model)` that returns the energy E_i of each cell, shape
            [cells]. Defaults to `epithelial_energy`. It may read `cells.volume` and `cells.lateral_area`; the energy of
            a cell must depend only on the geometry and parameters of that cell.
        parameters: Parameters that differ between cells, for use by `cell_energy`: a pytree of arrays of shape
            [n, ...], or None. If `cell_energy` is called for a subset of the cells, `model.parameters` holds their rows
            only.
        adhesion: An `Adhesion`, by which `cells.lateral_area` becomes a weighted sum of wall areas, or None.
        has_surfaces: Whether `cell_energy` may also read areas and perimeters on the surfaces; set by `with_surfaces`.
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
        """The domain, if it is a `Tube`. Raises AttributeError for other domains."""
        if isinstance(self.domain, Tube):
            return self.domain
        raise AttributeError(f"a model of {type(self.domain).__name__} has no attribute tube; use model.domain")

    def with_surfaces(self) -> "Model":
        """Return a copy whose `cell_energy` can read areas and perimeters on the surfaces, which are None otherwise.

        A sweep then takes 1.2 to 1.6 times as long.

        >>> def contractile(cells, model):
        ...     return epithelial_energy(cells, model) + 0.1 * cells.apical_perimeter**2
        >>> tube_model(Tube(10, 1, 2), 30, cell_energy=contractile).with_surfaces().has_surfaces
        True
        """
        return replace(self, has_surfaces=True)

    def of(self, cells: Int[Array | np.ndarray, "cells"]) -> "Model":
        """Return the model for a subset of the cells, given by their indices, with their rows of `parameters`."""
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
    """Create the energy model of a tissue, E = sum of K/2 (Vbar - V_i)^2 + Lambda A_i by default (paper, section 3.1).

    Vbar is the volume of the domain divided by the number of cells. The defaults of K and Lambda are those of the paper
    (section 4.3).

    Args:
        tube: The tube, or any other domain, that the cells fill.
        cells: Number of cells n, at least 1.
        modulus: K, weight of the volume term, at least 0. Defaults to 1.
        tension: Lambda, weight of the lateral area, at least 0. Defaults to 0.4.
        cell_energy: Energy of each cell as a function `cell_energy(cells, model)`; see `Model`. Defaults to
            `epithelial_energy`.
        relative: Whether `modulus` and `tension` are dimensionless. Defaults to False. With True, E_i = K/2 (1 - V_i /
            Vbar)^2 + Lambda A_i / Vbar^(2/3), which does not depend on the length unit; a custom `cell_energy` then
            reads K / Vbar^2 as `model.modulus` and Lambda / Vbar^(2/3) as `model.tension`.
        parameters: Parameters that differ between cells, such as target volumes, for use by a custom `cell_energy`: an
            array or a pytree of arrays, each of shape [n, ...]. Defaults to None.
        adhesion: An `Adhesion`, which weights walls by the types of their two cells. Defaults to None: all weights are
            1.

    Returns:
        The model.

    Raises:
        ValueError: If `modulus` or `tension` is not a finite number of at least 0, if `cells` is less than 1, if
            `parameters` are not finite or do not have one row per cell, or if the types or weights of `adhesion` are
            invalid.

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
            raise ValueError(f"{name}={value} is invalid; give a finite number of at least 0")
    if cells < 1:
        raise ValueError(f"cells={cells} is too small; give at least one cell")
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
            raise ValueError(f"{name} has shape {np.shape(table)}; give one row for each of the {cells} cells")
        if not isinstance(table, Tracer) and not np.isfinite(np.asarray(table, float)).all():
            raise ValueError(f"{name} contains a value that is not finite; give one finite number per cell")


def check_numbers(model: Model, cells: int, within: float = 0.01) -> None:
    """Raise `ValueError` for a model of another number of cells, by its mean volume, its parameters or its types."""
    check_count(cells, model.domain, model.mean_volume, within)
    check_parameters(model.parameters, cells)
    check_adhesion(model.adhesion, cells)


def in_precision(model: Model, dtype: DTypeLike) -> Model:
    """The model with its numbers as NumPy arrays in a precision; whole numbers among the parameters stay whole."""

    def convert(leaf: Any) -> np.ndarray:
        return np.asarray(leaf, dtype if np.asarray(leaf).dtype.kind == "f" else None)

    converted = jax.tree.map(lambda leaf: np.asarray(leaf, dtype), replace(model, parameters=None, adhesion=None))
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
        raise ValueError(f"{_name(model)} returns {given}; it must return one real number per cell")
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
        cure = "for areas on the surfaces, use model.with_surfaces()" if none else "compute each cell on its own"
        raise ValueError(f"{_name(model)} raises an error ({reason}); {cure}") from error
    require_finite(energy, model)
    if not np.allclose(energy[:2], part, rtol=1e-3, atol=1e-6 * float(np.abs(energy).max())):
        raise ValueError(f"{_name(model)} depends on several cells; compute each energy from one cell")
    if model.cell_energy in (epithelial_energy, volume_elasticity):
        right = float(model.modulus) / 2 * (float(volume[1]) - float(model.mean_volume)) ** 2
        least = np.asarray(volume_elasticity(CellGeometry(volume, area), model), float)[1]
        if not 0.9 * right <= least <= 1.1 * right:
            small = f"modulus={model.modulus} gives energies of {right:.1g}, too small for {dtype}"
            raise ValueError(f"{small}; change the unit of length or {X64}")


def require_finite(energies: Any, model: Model) -> None:
    """Raise `ValueError` for energies that are infinite or not numbers."""
    energy = np.asarray(energies)
    if np.isfinite(energy).all():
        return
    constants = ", ".join(f"{name}={float(getattr(model, name)):.6g}" for name in CONSTANTS)
    found = f"{_name(model)} is {energy[~np.isfinite(energy)][0]} in {energy.dtype} ({constants})"
    raise ValueError(f"{found}; correct the energy or the unit of length{f', or {X64}' * (energy.dtype == np.float32)}")


def _check_constant(name: str, value: Any) -> None:
    if isinstance(value, str | bool) or np.shape(value) != ():
        given = repr(value) if np.shape(value) == () else f"an array of shape {np.shape(value)}"
        raise ValueError(f"{name} is {given}; give a single number for all cells")


def _name(model: Model) -> str:
    return f"cell_energy {getattr(model.cell_energy, '__name__', model.cell_energy)}"
