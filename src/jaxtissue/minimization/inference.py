"""Inference by force balance: tension and target volumes for which a given tissue is at a minimum of its energy.

The tissue is assumed to be at a minimum of E = sum of K/2 (T_i - V_i)^2 + Lambda A_i. There the force on every backbone
vanishes, and the forces, sum of (V_i - T_i) dV_i/dx + Lambda/K dA/dx, are linear in Lambda/K and in the target volumes
T_i. The volumes sum to the volume of the tube, so adding a constant to all T_i does not change the forces.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.minimization.traced_energy import measured_and_slopes
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.traced_sizes import find_ends

SMALL, USUAL, LARGE = 1e-4, 0.01, 0.05  # mean cell widths, by which backbones are displaced: least, at first, most
FEW, MANY = 4, 24  # displaced tissues, to find the noise of the positions, and then the errors
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


class Forces(NamedTuple):
    """The forces of the areas and of the volumes on all backbones, in energies per length, [m] each.

    Attributes:
        tension: dA/dx, for the lateral area A of all cells.
        elastic: sum of (V_i - Vbar) dV_i/dx.
        pressure: sum of dV_i/dx over the cells of each type, [types, m].
    """

    tension: Float[np.ndarray, "m"]
    elastic: Float[np.ndarray, "m"]
    pressure: Float[np.ndarray, "types m"]


class _Tissue:
    """A tissue whose backbones may be displaced, and its forces by traced edges, which are right to 8 digits."""

    def __init__(self, positions: np.ndarray, tube: Tube, adhesion: Adhesion | None, members: np.ndarray) -> None:
        self._positions, self._tube, self._adhesion, self._members = positions, tube, adhesion, members
        self._units = np.array([1.0, (float(tube.apical_radius) + float(tube.basal_radius)) / 2])
        self.shape = positions.shape
        self.width = (2 * np.pi * self._units[1] * float(tube.length) / len(positions)) ** 0.5

    def forces(self, moved: Any = 0.0) -> Forces:
        """The forces where backbones are moved by lengths, [n, 2]; beyond the tube's ends they are reflected."""
        with double_precision():
            place = np.asarray(self._tube.reflect(jnp.asarray(self._positions + moved / self._units)))
        (volume, area), back = measured_and_slopes(place, self._tube, self._adhesion)
        if not np.isfinite(area).all():
            raise ValueError("the edges of the cells could not be followed; separate backbones that nearly coincide")

        def pull(by_volume: np.ndarray, by_area: np.ndarray) -> np.ndarray:
            return (back(by_volume, by_area) / self._units).ravel()

        none, several = np.zeros_like(volume), len(self._members) > 1  # the volumes of all cells together are fixed
        pressure = [pull(row, none) if several else np.zeros(place.size) for row in self._members]
        return Forces(pull(none, none + 1), pull(volume - volume.mean(), none), np.stack(pressure))

    def inner_rows(self) -> Bool[np.ndarray, "m"]:
        """Which forces are on backbones whose moves change no cell that touches an end."""
        at_end = find_ends(trace_edges(self._positions, self._tube))
        weights = np.where(at_end, np.random.default_rng(0).uniform(1, 2, len(at_end)), 0)
        _, back = measured_and_slopes(self._positions, self._tube, None)
        force = np.abs(back(weights, np.zeros(len(at_end))) / self._units).max(axis=1)
        inner = force <= 1e-6 * force.max()
        if not inner.any():
            raise ValueError("every cell touches an end of the tube or has such a neighbor; give inner_only=False")
        return np.repeat(inner, 2)


@usual_modes()
def infer_parameters(
    positions: PositionsLike,
    tube: Tube,
    types: Any = None,
    tension: float | None = None,
    modulus: float = 1.0,
    adhesion: Adhesion | None = None,
    inner_only: bool = False,
) -> InferredParameters:
    """Infer the tension and target volumes of a relaxed tissue from its positions alone, by force balance.

    At a minimum of E = sum of K/2 (T_i - V_i)^2 + Lambda A_i the forces on all backbones vanish. The forces are linear
    in Lambda / K and in the target volumes T_i, which are estimated by robust least squares (Tukey's biweight). The
    derivatives are those of traced edges, right to 8 digits. Two quantities cannot be inferred: energies that
    differ by a factor have the same minima, so K must be given; and since the volumes sum to the volume of the tube,
    the mean of all T_i is set to the mean cell volume. If every cell has its own target volume, forces determine only
    (V_i - T_i) K / Lambda, so the tension must be given.

    Standard errors assume independent random errors of the positions, as large as needed to explain the residual
    forces. The bias that such errors cause, mostly an underestimated tension, is estimated from tissues with as large
    errors again and subtracted (simulation and extrapolation); the standard errors include its size. They are large for
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
    place = as_positions(positions, tube, np.float64)
    members = _members(types, len(place), tension is None)
    if not (np.isfinite(modulus) and modulus > 0) or not (tension is None or np.isfinite(tension)):
        raise ValueError(f"modulus={modulus}, tension={tension}: give a positive modulus, and a finite tension or None")
    tissue = _Tissue(place, tube, adhesion, members)
    rows = tissue.inner_rows() if inner_only else np.ones(place.size, bool)
    # parameters are tension / modulus, and by how much the target volume of each type is above the mean volume
    given = np.array([(tension or 0.0) / modulus, *(0.0 for _ in members)])
    apart = scipy.linalg.null_space(members.sum(axis=1)[None])  # their mean over all cells is 0
    free = np.asarray(scipy.linalg.block_diag(np.ones((1, int(tension is None))), apart))
    height = float(tube.basal_radius) - float(tube.apical_radius)
    sizes = height * np.array([rows.sum() ** 0.5] + len(members) * [tissue.width])

    def fit(moved: Any = 0.0) -> Fit:
        found = tissue.forces(moved)
        parts = np.stack([found.tension, *-found.pressure])[:, rows]
        return _fit_robustly(parts, found.elastic[rows], given, free, sizes)

    (ratio, *above), errors, noise = _with_errors(fit, tissue)
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


def _fit_robustly(
    parts: Float[np.ndarray, "parts m"],
    elastic: Float[np.ndarray, "m"],
    given: Float[np.ndarray, "parts"],
    free: Float[np.ndarray, "parts p"],
    sizes: Float[np.ndarray, "parts"],
) -> Fit:
    """Parameters of which forces of the given parts balance the elastic ones, and the scale of what is left over.

    Least squares with Tukey's weights.
    """
    design, goal = (parts.T / sizes) @ free, -(elastic + given @ parts)
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


def _with_errors(
    fit: Callable[..., Fit], tissue: _Tissue
) -> tuple[Float[np.ndarray, "parts"], Float[np.ndarray, "parts"], float]:
    """The parameters without the bias of noise, their standard errors, and the noise that leaves such forces over.

    Tissues with as much noise again tell how far it spreads the parameters, and how far it shifts them. The shift is
    taken off (simulation and extrapolation), and counts as an error too, since it is known to first order only.
    """
    rng, found = np.random.default_rng(0), fit()
    size = USUAL * tissue.width

    def displaced(tissues: int) -> tuple[Float[np.ndarray, "tissues parts"], float]:
        """Parameters of displaced tissues, and the noise that scales as theirs show."""
        fits = [fit(rng.normal(0, size, tissue.shape)) for _ in range(tissues)]
        more = max(np.mean([one.scale**2 for one in fits]) - found.scale**2, 1e-12 * found.scale**2, 1e-300)
        return np.stack([one.parameters for one in fits]), float(size * found.scale / more**0.5)

    size = np.clip(displaced(FEW)[1], SMALL * tissue.width, LARGE * tissue.width)
    others, noise = displaced(MANY)
    if noise > LARGE * tissue.width:
        told = f"the tissue is far from a minimum: the forces correspond to displacements of {noise / tissue.width:.2g}"
        warnings.warn(f"{told} cell widths; relax the tissue, or anneal it at a low temperature", stacklevel=4)
    share = noise / size
    spread, shift = share * others.std(axis=0, ddof=1), share**2 * (others.mean(axis=0) - found.parameters)
    return found.parameters - shift, np.hypot(spread, shift), noise
