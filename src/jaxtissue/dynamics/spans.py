"""The compiled parts of annealing: the measurement of a whole tissue, and a span of sweeps on its lists."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.dynamics.local_updates import Scene, TissueState, tissue_state
from jaxtissue.dynamics.metropolis import Order, SweepInfo, sweep
from jaxtissue.energy import Model, cell_energies, lateral_tension, volume_elasticity
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines
from jaxtissue.neighbors.search import pad_lists
from jaxtissue.neighbors.shortlists import distances, survey_tissue


class Trail(NamedTuple):
    """The sizes, backbones and counts after each sweep of a span, [sweeps, ...]."""

    sizes: CellGeometry
    positions: Float[Array | np.ndarray, "sweeps n *k d"]
    info: SweepInfo


def survey_state(
    positions: Float[Array, "n 2"],
    model: Model,
    lines: tuple[Lines, Lines],
    sides: Int[Array, "n 2 candidates"],
) -> tuple[TissueState, Float[Array, "n 2 candidates"], Float[Array, "n 2 candidates"]]:
    """The state of a whole tissue, the clearance of each candidate, as in `survey_tissue`, and its distance."""
    seen, clear = survey_tissue(positions, model.tube, lines, sides, model.adhesion)
    return tissue_state(positions, seen, model.has_surfaces), clear, distances(positions, model.tube, sides)


def play(
    draws: Float[Array, "sweeps 3 n"],
    state: TissueState,
    scene: Scene,
    temperatures: Float[Array, "sweeps"],
    orders: Order,
) -> tuple[TissueState, Trail]:
    """Play sweeps one after another; the leaves of `orders` have an axis of sweeps.

    A sweep without rounds does nothing, so fewer sweeps than temperatures need no program of their own.
    """

    def one(state: TissueState, this: tuple) -> tuple[TissueState, Trail]:
        drawn, temperature, order = this
        state, info = sweep(drawn, state, scene, temperature, order)
        positions = jnp.stack([state.place.axial, state.place.angle], axis=-1)
        return state, Trail(state.sizes, positions, info)

    return jax.lax.scan(one, state, (draws, temperatures, orders))


def fit_play(calls: Sequence[tuple], widths: tuple[int, int]) -> tuple[list[tuple], tuple[int, int]]:
    """The arguments of `play` of several replicas, with cells around each cell and rounds padded to the longest.

    They are at least as long as `widths`; the new widths are returned too. Padding does not change the result.
    """
    needs = [(scene.near.around.shape[1], orders.rounds.shape[1]) for _, _, scene, _, orders in calls]
    around, rounds = (max(column) for column in zip(widths, *needs, strict=True))
    fitted = []
    for draws, state, scene, temperatures, orders in calls:
        near = scene.near._replace(around=pad_lists(scene.near.around, around))
        spare = ((0, 0), (0, rounds - orders.rounds.shape[1]), (0, 0))
        orders = orders._replace(rounds=np.pad(orders.rounds, spare, constant_values=-1))
        fitted.append((draws, state, scene._replace(near=near), temperatures, orders))
    return fitted, (around, rounds)


def energy_terms(cells: CellGeometry, model: Model) -> tuple[Array, Array, Array]:
    """The energy of each cell after each sweep, [sweeps, n], and the two terms of the paper's energy."""
    if model.parameters is not None:  # of the cells, the same after every sweep
        energy = jax.vmap(cell_energies, (0, None))(cells, model)
        return energy, volume_elasticity(cells, model), lateral_tension(cells, model)
    return cell_energies(cells, model), volume_elasticity(cells, model), lateral_tension(cells, model)
