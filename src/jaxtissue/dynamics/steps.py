"""One sweep as a pure function of a random key and a state, as a building block for custom dynamics.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxtissue.compilation.batching import Batch
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.dynamics.independent_sets import independent_rounds, padded_orders
from jaxtissue.dynamics.local_updates import Neighborhoods, Scene, TissueState
from jaxtissue.dynamics.metropolis import Order, SweepInfo, sweep
from jaxtissue.dynamics.survey import Tissue, lines_of, survey_together
from jaxtissue.dynamics.sweep_log import shortlist_neighbors
from jaxtissue.energy import Model, check_energy, check_numbers, in_precision
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution


class SweepState(NamedTuple):
    """State of a tissue between two sweeps, from `init` or `step`.

    Attributes:
        tissue: Internal: backbones and geometry of their cells.
        neighbors: Internal: short neighbor lists, valid for about ten sweeps.
        order: Internal: partition of the cells into independent sets.
        lines: Internal: quadrature lines.
    """

    tissue: TissueState
    neighbors: Neighborhoods
    order: Order
    lines: Lines

    @property
    def positions(self) -> Float[Array, "n 2"]:
        """Axial position and angle in radians of each backbone, shape [n, 2]."""
        return jnp.stack([self.tissue.place.axial, self.tissue.place.angle], axis=-1)

    @property
    def cells(self) -> CellGeometry:
        """Geometry of the cells, a `CellGeometry` with the fields that the energy reads."""
        return self.tissue.sizes


@usual_modes()
def init(positions: PositionsLike, model: Model, resolution: Resolution | str = "draft") -> SweepState:
    """Create the state for `step`: cells measured, neighbor lists built, cells partitioned into independent sets.

    Use `init` and `step` to write your own dynamics in JAX; to run a given number of sweeps use `anneal`. `init` runs
    on the host and is not jittable. Neighbor lists stay valid for about ten sweeps, that is, ten calls of `step`; then
    call `init` again with `state.positions`. Nothing checks their validity in between (`anneal` and `Annealer` do).

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        model: Energy model of a `Tube`; see `tube_model`. Other domains are not supported.
        resolution: "draft" (the default), "standard" or "fine", or a `Resolution`.

    Returns:
        The state, with properties `positions` (shape [n, 2]) and `cells` (a `CellGeometry`).

    Raises:
        ValueError: If a position is invalid, if the number of positions does not match the model, if the domain is not
            a `Tube`, or if `cell_energy` does not return one finite value per cell.

    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(length=12, apical_radius=1, basal_radius=3)
    >>> model = tube_model(tube, 40)
    >>> state = init(tube.random_positions(jax.random.key(0), 40), model)
    >>> state.positions.shape, bool(abs(state.cells.volume.sum() / tube.volume - 1) < 0.01)
    ((40, 2), True)
    """
    place = np.asarray(as_positions(positions, model.domain))  # type: ignore[arg-type]  # refused if it is no tube
    n = len(place)
    check_numbers(model, n)
    check_energy(model)
    model = in_precision(model, place.dtype)
    lines = lines_of(model, n, as_resolution(resolution))
    (measured,) = survey_together([Tissue(place, model, lines)], Batch())
    neighbors = shortlist_neighbors(measured.sides, measured.urgency(), 0)
    rounds = independent_rounds("near", place, model, measured.contacts)
    orders = padded_orders([rounds], 1, neighbors)
    order = jax.tree.map(lambda leaf: leaf[0], orders)
    # arrays of JAX, so that a jitted function may close over the state
    tissue, neighbors, order = jax.tree.map(jnp.asarray, (measured.tissue, neighbors, order))
    return SweepState(tissue, neighbors, order, lines[0])


@usual_modes()
def step(
    key: PRNGKeyArray, state: SweepState, model: Model, temperature: float | Float[Array, ""] = 2.0
) -> tuple[SweepState, SweepInfo]:
    """Run one sweep of independent-set Metropolis-Hastings, one proposed move per cell (paper, section 3.3).

    `step` is a pure function: it can be used with `jax.jit`, `jax.lax.scan`, and `jax.vmap` over keys and states. Call
    `init` again about every ten sweeps: `step` does not check its neighbor lists.

    Args:
        key: JAX random key for this sweep.
        state: State from `init` or from the previous `step`.
        model: Energy model, the same as for `init`.
        temperature: Temperature T, in energy units, a scalar. A move with energy difference dE is accepted with
            probability min(1, exp(-dE / T)). Defaults to 2.

    Returns:
        The state after the sweep, and a `SweepInfo` of scalars: `accepted`, the number of accepted moves; `rounds`, the
        number of independent sets of moves; `collisions`, moves deferred to an additional round because they affect a
        cell already affected by an earlier move in their round; `left_cell`, proposals that would move a backbone out
        of its current cell (they are not rejected for that); `energy_change`, the sum of the accepted differences.

    Raises:
        ValueError: If the number of cells differs between the state and the model or its per-cell parameters or cell
            types.
    """
    check_numbers(model, len(state.tissue.place.axial))
    shape, dtype = state.tissue.wide.shape, state.tissue.reach.dtype
    draws = jax.random.uniform(key, (3, *shape), dtype)
    scene = Scene(model, state.neighbors, state.lines)
    tissue, info = sweep(draws, state.tissue, scene, jnp.asarray(temperature, dtype), state.order)
    return state._replace(tissue=tissue), info
