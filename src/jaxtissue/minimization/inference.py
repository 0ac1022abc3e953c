"""Inference by force balance: tension and target volumes for which a given tissue is at a minimum of its energy.

The tissue is assumed to be at a minimum of E = sum of K/2 (T_i - V_i)^2 + Lambda A_i. There the force on every backbone
vanishes, and the forces, sum of (V_i - T_i) dV_i/dx + Lambda/K dA/dx, are linear in Lambda/K and in the target volumes
T_i. The volumes sum to the volume of the tube, so adding a constant to all T_i does not change the forces.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, in_precision, tube_model
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.cells import measure_cells
from jaxtissue.measurement.quadrature import Resolution, as_resolution, plan_lines
from jaxtissue.minimization.tube_energy import TubeEnergy
from jaxtissue.neighbors.neighbor_list import list_neighbors

SMALL, USUAL, LARGE = 1e-4, 0.01, 0.05  # mean cell widths, by which backbones are displaced: least, at first, most
FEW, MANY = 4, 24  # displaced tissues, to find the noise of the positions, and then the errors
STEEP = 3  # of the median pull of walls on a backbone, beyond which it is not trusted
MEDIAN, TUKEY = 0.6745, 4.685  # of a standard deviation, and standard deviations: the usual constants
ROUNDS, SETTLED = 30, 1e-3  # of weights at most, and their change after which they stay
SAME = 1e-4  # of walls' areas and heights, below which forces do not tell parameters apart


@dataclass(frozen=True, eq=False)
class InferredParameters:
    """Parameters inferred by force balance, with standard errors.

    Attributes:
        tension: Lambda, for the given modulus K.
        tension_error: Standard error of `tension`; 0 if the tension was given.
        target_volumes: Target volume of each type, in sorted order of the type labels, shape [types]. Their mean over
            all cells is the mean cell volume.
        target_volume_errors: Standard errors of the target volumes, shape [types]; 0 if there is one type only.
        noise: Standard deviation, in length units, of random displacements of the backbones (in each direction on the
            surface midway between apical and basal) that would explain the residual forces.
    """

    tension: float
    tension_error: float
    target_volumes: Float[np.ndarray, "types"]
    target_volume_errors: Float[np.ndarray, "types"]
    noise: float

    def __repr__(self) -> str:
        targets = f"{len(self.target_volumes)} target volume{'s' if len(self.target_volumes) > 1 else ''}"
        return f"InferredParameters(tension {self.tension:.4g} +- {self.tension_error:.2g}, {targets})"


class Fit(NamedTuple):
    """Tension / modulus and by how much target volumes are above the mean, and the scale of forces left over."""

    parameters: Float[np.ndarray, "parts"]
    scale: float


def force_terms(cells: CellGeometry, model: Model) -> Float[Array, "cells"]:
    """K/2 V_i^2 + P_i V_i + Lambda A_i: with P_i = -K T_i the energy itself, but for a constant."""
    return model.modulus / 2 * cells.volume**2 + model.parameters * cells.volume + model.tension * cells.lateral_area


class _Forces:
    """The forces on all backbones as measured, in parts that add up."""

    def __init__(self, positions: np.ndarray, tube: Tube, adhesion: Adhesion | None, resolution: Resolution) -> None:
        n = len(positions)
        self._mean, self._type = float(tube.volume) / n, positions.dtype.type
        model = tube_model(tube, n, cell_energy=force_terms, parameters=np.zeros(n), adhesion=adhesion)
        self._model = in_precision(model, positions.dtype)
        self._energy = TubeEnergy(self._model, n, resolution)
        self._place = positions * self._energy.units
        self.shape, self.width = self._place.shape, self._energy.width

    def __call__(
        self, tension: float, above: Any = 0.0, elastic: float = 0.0, moved: Any = 0.0
    ) -> Float[np.ndarray, "m"]:
        """Force by tension dA/dx + sum of (elastic (V_i - Vbar) - above_i) dV_i/dx, backbones moved by lengths."""
        pressure = np.full(len(self._place), -elastic * self._mean) - above
        self._energy.model = replace(
            self._model,
            modulus=self._type(elastic),
            tension=self._type(tension),
            parameters=pressure.astype(self._type),
        )
        point = self._energy.renewed(self._place + moved)
        if not np.isfinite(point.energy):
            raise ValueError("the forces are not finite; separate backbones that coincide")
        return point.gradient.ravel()


@usual_modes()
def infer_parameters(
    positions: PositionsLike,
    tube: Tube,
    types: Any = None,
    tension: float | None = None,
    modulus: float = 1.0,
    adhesion: Adhesion | None = None,
    inner_only: bool = False,
    resolution: Resolution | str = "standard",
) -> InferredParameters:
    """Infer the tension and target volumes of a relaxed tissue from its positions alone, by force balance.

    At a minimum of E = sum of K/2 (T_i - V_i)^2 + Lambda A_i the forces on all backbones vanish. The forces are linear
    in Lambda / K and in the target volumes T_i, which are estimated by robust least squares (Tukey's biweight;
    backbones with exceptionally large wall forces are left out). Two quantities cannot be inferred: energies that
    differ by a factor have the same minima, so K must be given; and since the volumes sum to the volume of the tube,
    the mean of all T_i is set to the mean cell volume. If every cell has its own target volume, forces determine only
    (V_i - T_i) K / Lambda, so the tension must be given.

    Standard errors assume independent random errors of the positions, as large as needed to explain the residual
    forces, and include the bias that such errors cause (an underestimated tension). They are therefore large for
    tissues that are far from a minimum, such as segmented images or tissues at a finite temperature.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        tube: The tube.
        types: Type of each cell, labels of any kind, shape [n]; all cells of one type share a target volume. Defaults
            to None: one type. `np.arange(n)` gives every cell its own target volume.
        tension: Lambda, if known. Defaults to None: the tension is inferred.
        modulus: K, greater than 0; sets the unit of energy. Defaults to 1.
        adhesion: An `Adhesion`, which weights walls by the types of their two cells. Defaults to None.
        inner_only: Whether to use only backbones that influence no cell at an end of the tube, for a tissue that
            continues beyond the tube. Defaults to False.
        resolution: "draft", "standard" (the default) or "fine", or a `Resolution`.

    Returns:
        Record with fields `tension`, `tension_error`, `target_volumes` and `target_volume_errors` (shape [types]) and
        `noise` (displacements of the backbones that would explain the residual forces, a length). A warning is issued
        if `noise` exceeds 0.05 mean cell widths.

    Raises:
        ValueError: If a position is invalid, if `types` does not have shape [n], if `modulus` is not positive or
            `tension` not finite, or if the forces do not determine the parameters.

    >>> tube = Tube(length=12.0, apical_radius=1.0, basal_radius=3.0)
    >>> infer_parameters([[3.0, 0.0], [8.0, 1.0]], tube, types=[0, 1])
    Traceback (most recent call last):
    ValueError: with a separate target volume V_0 for each cell, tension and V - V_0 ... give the tension, ...
    """
    place = np.asarray(as_positions(positions, tube))
    members = _members(types, len(place), tension is None)
    if not (np.isfinite(modulus) and modulus > 0) or not (tension is None or np.isfinite(tension)):
        raise ValueError(f"modulus={modulus}, tension={tension}: give a positive modulus, and a finite tension or None")
    forces = _Forces(place, tube, adhesion, as_resolution(resolution))
    rows = _inner_rows(forces, place, tube) if inner_only else np.ones(place.size, bool)
    # parameters are tension / modulus, and by how much the target volume of each type is above the mean volume
    given = np.array([(tension or 0.0) / modulus, *(0.0 for _ in members)])
    apart = scipy.linalg.null_space(members.sum(axis=1)[None])  # their mean over all cells is 0
    free = np.asarray(scipy.linalg.block_diag(np.ones((1, int(tension is None))), apart))
    height = float(tube.basal_radius) - float(tube.apical_radius)
    sizes = height * np.array([rows.sum() ** 0.5] + len(members) * [forces.width])

    def fit(moved: Any = 0.0) -> Fit:
        pushes = [forces(0.0, row, moved=moved) if len(members) > 1 else np.zeros(place.size) for row in members]
        parts = np.stack([forces(1.0, moved=moved), *pushes])[:, rows]
        return _fit_robustly(parts, forces(0.0, elastic=1.0, moved=moved)[rows], given, free, sizes)

    ((ratio, *above), _), errors, noise = _with_errors(fit, forces)
    targets = float(tube.volume) / len(place) + np.array(above)
    return InferredParameters(modulus * float(ratio), modulus * float(errors[0]), targets, errors[1:], noise)


def _members(types: Any, cells: int, seeks_tension: bool) -> Float[np.ndarray, "types n"]:
    """A row for each type that is 1 for its cells; refuses what can't be told."""
    given = np.zeros(cells, int) if types is None else np.asarray(types)
    if given.shape != (cells,):
        raise ValueError(f"types have shape {given.shape}; give the type of each of the {cells} cells")
    names, kinds = np.unique(given, return_inverse=True)
    if seeks_tension and len(names) == cells > 1:
        told = (
            "with a separate target volume V_0 for each cell, tension and V - V_0 are known only up to a common factor"
        )
        raise ValueError(f"{told}; give the tension, or give several cells the same type")
    if not seeks_tension and len(names) == 1:
        raise ValueError(
            "nothing is left to infer: the tension is given, and a single target volume is the mean volume; give types"
        )
    return (kinds == np.arange(len(names))[:, None]).astype(float)


def _inner_rows(forces: _Forces, positions: Float[np.ndarray, "n 2"], tube: Tube) -> np.ndarray:
    """Which coordinates belong to backbones whose moves change no cell that touches an end."""
    n = len(positions)
    lists = list_neighbors(positions, tube).candidates
    cells, _ = jax.jit(measure_cells)(jnp.asarray(positions), tube, plan_lines(tube, n, "draft"), lists)
    at_end = np.asarray(cells.touches_end)
    weights = np.where(at_end, np.random.default_rng(0).uniform(1, 2, n), 0)
    force = np.abs(forces(0.0, weights)).reshape(-1, 2).max(axis=1)
    inner = force <= 1e-6 * force.max()
    if not inner.any():
        raise ValueError("every cell touches an end of the tube or has such a neighbor; give inner_only=False")
    return np.repeat(inner, 2)


def _fit_robustly(
    parts: Float[np.ndarray, "parts m"],
    elastic: Float[np.ndarray, "m"],
    given: Float[np.ndarray, "parts"],
    free: Float[np.ndarray, "parts p"],
    sizes: Float[np.ndarray, "parts"],
) -> Fit:
    """Parameters of which forces of the given parts balance the elastic ones, and the scale of what is left over.

    Least squares with Tukey's weights. Backbones on which walls pull much more than on others are left out: there walls
    are nearly parallel to the axis, and their areas have steps.
    """
    pull = np.linalg.norm(parts[0].reshape(-1, 2), axis=1)
    calm = np.repeat(pull <= STEEP * np.median(pull), 2)
    design, goal = ((parts.T / sizes) @ free)[calm], -(elastic + given @ parts)[calm]
    if design.shape[0] <= design.shape[1] or np.linalg.svd(design, compute_uv=False).min() < SAME:
        told = f"{design.shape[0]} forces do not determine {design.shape[1]} parameters"
        raise ValueError(
            f"{told}: the pulls of the walls cancel, or there are too few cells; give the tension or fewer types"
        )
    weights, scale, found = np.ones(len(goal)), 0.0, np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        found = np.linalg.lstsq(design * root[:, None], goal * root, rcond=None)[0]
        left = goal - design @ found
        scale = float(np.median(np.abs(left))) / MEDIAN
        before, weights = weights, np.maximum(1 - (left / max(TUKEY * scale, 1e-300)) ** 2, 0) ** 2
        if np.abs(weights - before).max() < SETTLED:
            break
    return Fit(given + free @ found / sizes, scale)


def _with_errors(fit: Callable[..., Fit], forces: _Forces) -> tuple[Fit, Float[np.ndarray, "parts"], float]:
    """The parameters, their standard errors, and the noise of the positions that leaves such forces over.

    Tissues with as much noise again tell how far it spreads the parameters, and how far it shifts them: both count.
    """
    rng, found = np.random.default_rng(0), fit()
    size = USUAL * forces.width

    def displaced(tissues: int) -> tuple[Float[np.ndarray, "tissues parts"], float]:
        """Parameters of displaced tissues, and the noise that scales as theirs show."""
        fits = [fit(rng.normal(0, size, forces.shape)) for _ in range(tissues)]
        more = max(np.mean([one.scale**2 for one in fits]) - found.scale**2, 1e-12 * found.scale**2, 1e-300)
        return np.stack([one.parameters for one in fits]), float(size * found.scale / more**0.5)

    size = np.clip(displaced(FEW)[1], SMALL * forces.width, LARGE * forces.width)
    others, noise = displaced(MANY)
    if noise > LARGE * forces.width:
        told = f"the tissue is far from a minimum: the forces correspond to displacements of {noise / forces.width:.2g}"
        warnings.warn(f"{told} cell widths; relax the tissue, or anneal it at a low temperature", stacklevel=4)
    share = noise / size
    spread, shift = share * others.std(axis=0, ddof=1), share**2 * (others.mean(axis=0) - found.parameters)
    return found, np.hypot(spread, shift), noise
