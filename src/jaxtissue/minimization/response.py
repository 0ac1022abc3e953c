"""How a minimum of the energy moves as parameters change: the implicit derivative of relaxed positions."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.sparse.linalg import LinearOperator, minres

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.energy import Model, cell_energies, in_precision
from jaxtissue.geometry.positions import as_positions
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.minimization.traced_energy import TracedEnergy

MOVE = 1e-4  # mean cell widths, by which backbones are displaced to find products with the Hessian
SOLVED, ENOUGH = 1e-5, 0.01  # relative residuals of the linear solve: wanted, and at most
NOISE = 1e-10  # of the energy per mean cell width, below which a force is taken as round-off


@usual_modes()
def minimum_response(
    positions: Any, model_of: Callable[[Any], Model], parameter: float, tolerance: float = 1e-2
) -> Float[np.ndarray, "n 2"]:
    """Compute the derivative of a relaxed tissue's positions with respect to a parameter of its energy.

    At a minimum x of E(x, p) the gradient vanishes, so dx/dp solves the linear system H dx/dp = -d2E/dx dp with the
    Hessian H = d2E/dx2. The system is solved by MINRES; products with H are central differences of the gradient by
    traced edges, in 64 bits. A rotation of the whole tube costs no energy; the solution contains none.

    Args:
        positions: Axial position and angle in radians of each backbone of a tissue in a `Tube` at a minimum, array-like
            of shape [n, 2]; from `relax` with `resolution="traced"`.
        model_of: Jittable function `model_of(parameter)` that returns the energy model. Its domain must not depend on
            the parameter.
        parameter: Value of the parameter at which `positions` are a minimum.
        tolerance: Largest norm of the gradient at `positions`, as a fraction of d2E/dx dp times `parameter` (or 1, if
            that is 0). Greater than 0; defaults to 1e-2.

    Returns:
        dx/dp: axial position and angle per unit of the parameter, shape [n, 2].

    Raises:
        ValueError: If the tissue is not at a minimum, a position is invalid, or the linear system has no solution of
            the accuracy required.

    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(length=2.0, apical_radius=1.0, basal_radius=2.0)
    >>> minimum_response([[0.5, 0.0], [1.5, 0.0]], lambda tension: tube_model(tube, 2, tension=tension), 0.4).shape
    (2, 2)
    """
    start = np.asarray(as_positions(positions, model_of(parameter).tube, np.float64))
    with double_precision():
        at = jnp.asarray(parameter, float)
        energy = TracedEnergy(in_precision(model_of(at), np.float64), len(start))
        place = start * energy.units
        sizes = energy.sizes(place)

        def by_sizes(parameter: Any) -> Any:
            model = model_of(parameter)
            return jax.grad(lambda sizes: cell_energies(CellGeometry(*sizes), model).sum())(jnp.asarray(sizes))

        change = np.asarray(jax.jvp(by_sizes, (at,), (jnp.ones_like(at),))[1], float)
    total, gradient = energy.measured(place)[:2]
    mixed = energy.by_sizes(place)[2](*change) / energy.units
    noise = NOISE * abs(float(total)) / energy.width
    pull = float(np.linalg.norm(gradient))
    allowed = tolerance * float(np.linalg.norm(mixed)) * (abs(parameter) or 1) + noise
    if not pull <= allowed:
        told = f"the gradient has the norm {pull:.2g}, above {allowed:.2g}: this is not a minimum"
        raise ValueError(f"{told}; relax the tissue with resolution='traced', or allow a larger tolerance")
    turn = np.tile([0.0, 1.0], len(start)) / len(start) ** 0.5

    def product(way: np.ndarray) -> np.ndarray:
        way = way - (way @ turn) * turn
        size = float(np.abs(way).max())
        if size == 0:
            return way
        step = MOVE * energy.width / size * way.reshape(place.shape)
        slopes = [energy.measured(place + sign * step)[1] for sign in (1, -1)]
        bent = (slopes[0] - slopes[1]).ravel() * size / (2 * MOVE * energy.width)
        return bent - (bent @ turn) * turn

    operator: Any = LinearOperator
    hessian = operator((place.size, place.size), matvec=product, dtype=float)
    goal = -mixed.ravel()
    goal = goal - (goal @ turn) * turn
    found, failed = minres(hessian, goal, rtol=SOLVED, maxiter=2 * place.size)
    off = np.linalg.norm(product(found) - goal)
    if failed or not off <= ENOUGH * np.linalg.norm(goal) + noise / (abs(parameter) or 1):
        raise ValueError(f"the linear system is not solved (residual {off:.2g}); the tissue may be at a kink of E")
    return found.reshape(place.shape) / energy.units
