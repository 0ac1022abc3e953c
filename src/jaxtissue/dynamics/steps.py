"""One sweep as a pure function of a key and a state, from which other dynamics can be written."""

from typing import Any, NamedTuple

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
from jaxtissue.energy import Model, check_energy, check_parameters, in_precision
from jaxtissue.geometry.positions import as_positions, check_count
from jaxtissue.measurement.adhesion import check_adhesion
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution


class SweepState(NamedTuple):
    """A tissue between two sweeps: its backbones and cells, and the lists and lines that sweeps use.

    Attributes:
        tissue: The backbones and the sizes of their cells.
        neighbors: The short neighbor lists, which hold for about ten sweeps.
        order: The independent sets of moves.
        lines: The lines on which cells are measured.
    """

    tissue: TissueState
    neighbors: Neighborhoods
    order: Order
    lines: Lines

    @property
    def positions(self) -> Float[Array, "n 2"]:
        """(axial, angle) of each backbone, [n, 2]."""
        return jnp.stack([self.tissue.place.axial, self.tissue.place.angle], axis=-1)

    @property
    def cells(self) -> CellGeometry:
        """The sizes of the cells that the energy reads."""
        return self.tissue.sizes


@usual_modes()
def init(positions: Any, model: Model, resolution: Resolution | str = "draft") -> SweepState:
    """The state before the first sweep: cells measured, neighbor lists allocated, moves cut into independent sets.

    The sets are those of the paper's section 3.3. This runs on the host. Lists hold for about ten sweeps of the default
    moves; then call it again with `state.positions`, as `Annealer` does, which also checks that they have held.

    Args:
        positions: (axial, angle) of each backbone, [n, 2], in any form that `as_positions` takes.
        model: The energy; see `tube_model`.
        resolution: How finely cells are measured: a preset or layers and lines.

    Returns:
        The state for `step`.

    Raises:
        ValueError: If `as_positions` refuses the positions, if their number is not the model's, or if the energy is not
            one finite number for each cell.

    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(length=12, apical_radius=1, basal_radius=3)
    >>> model = tube_model(tube, 40)
    >>> state = init(tube.random_positions(jax.random.key(0), 40), model)
    >>> state.positions.shape, bool(abs(state.cells.volume.sum() / tube.volume - 1) < 0.01)
    ((40, 2), True)
    """
    place = np.asarray(as_positions(positions, model.domain))  # type: ignore[arg-type]  # refused if it is no tube
    tube = model.tube
    n = len(place)
    check_count(n, tube, float(model.mean_volume))
    check_parameters(model.parameters, n)
    check_adhesion(model.adhesion, n)
    check_energy(model)
    model = in_precision(model, place.dtype)
    lines = lines_of(model, n, as_resolution(resolution))
    (measured,) = survey_together([Tissue(place, model, lines)], Batch())
    neighbors = shortlist_neighbors(measured.sides, measured.urgency(), 0)
    rounds = independent_rounds("near", place, model, measured.contacts)
    orders = padded_orders([rounds], 1, neighbors)
    tissue = jax.tree.map(jnp.asarray, measured.tissue)
    return SweepState(tissue, neighbors, jax.tree.map(lambda leaf: leaf[0], orders), lines[0])


@usual_modes()
def step(
    key: PRNGKeyArray, state: SweepState, model: Model, temperature: float | Float[Array, ""] = 2.0
) -> tuple[SweepState, SweepInfo]:
    """One sweep of independent-set Metropolis-Hastings (paper, section 3.3): one move for every cell.

    The function is pure: it may be jitted, scanned, or vmapped over keys and states. `init` has an example.

    Args:
        key: The random key of this sweep.
        state: What `init` or the step before gave.
        model: The energy, the same as for `init`.
        temperature: T, in the unit of the energy; a move that costs dE > 0 is accepted with probability exp(-dE / T).

    Returns:
        The state after the sweep, and its counts: moves accepted, moves put off because they would change a cell that
        an earlier move of their set changes, rounds played, the sum of accepted energy differences.
    """
    shape, dtype = state.tissue.wide.shape, state.tissue.reach.dtype
    draws = jax.random.uniform(key, (3, *shape), dtype)
    scene = Scene(model, state.neighbors, state.lines)
    tissue, info = sweep(draws, state.tissue, scene, jnp.asarray(temperature, dtype), state.order)
    return state._replace(tissue=tissue), info
