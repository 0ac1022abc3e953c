"""The energy of a whole tissue as a differentiable function."""

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, cell_energies
from jaxtissue.geometry.positions import require_tube
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution, plan_lines, trace_lines
from jaxtissue.measurement.smooth_sizes import find_windows, smooth_sizes
from jaxtissue.neighbors.neighbor_list import NeighborList


@usual_modes()
def tissue_energy(
    positions: Float[Array, "n 2"], model: Model, neighbors: NeighborList, resolution: Resolution | str = "standard"
) -> Float[Array, ""]:
    """The energy of a tissue, E = sum of E_i (paper, section 3.1), as a pure function that JAX can differentiate.

    `jax.grad`, `jax.jvp`, `jax.jit` and `jax.vmap` accept it, for positions, for the sizes of the tube and for all
    other leaves of the model. The derivative is that of the energy as measured at this resolution. Volumes have the
    derivatives of true volumes; the derivative of a single lateral area is noisier, as edges cross the layers on which
    cells are measured.

    Args:
        positions: (axial, angle) of each backbone, [n, 2]; floats.
        model: The energy; see `tube_model`.
        neighbors: Neighbor lists that hold for these positions; see `NeighborList.covers`.
        resolution: How finely cells are measured: a preset or layers and lines.

    Returns:
        The energy, one number; not a number where cells reach so far round the tube that there is no room for them.

    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> tube = Tube(length=12.0, apical_radius=1.0, basal_radius=3.0)
    >>> positions = tube.random_positions(jax.random.key(0), 40)
    >>> neighbors = NeighborList.allocate(positions, tube)
    >>> slope = jax.jit(jax.grad(tissue_energy), static_argnames="resolution")
    >>> slope(positions, tube_model(tube, 40), neighbors, resolution="draft").shape
    (40, 2)
    """
    require_tube(model.domain)
    tube, resolution = model.tube, as_resolution(resolution)
    is_traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tube))
    plan = trace_lines if is_traced else plan_lines
    lines = plan(tube, len(positions), resolution, surfaces=model.has_surfaces)
    return energy_on_lines(positions, model, lines, neighbors.candidates)


def energy_on_lines(
    positions: Float[Array, "n 2"], model: Model, lines: Lines, candidates: Int[Array | np.ndarray, "n 2 k"]
) -> Float[Array, ""]:
    """The same on given lines and lists."""
    windows = find_windows(positions, model.tube, lines, candidates)
    cells = smooth_sizes(positions, model.tube, lines, windows, model.adhesion)
    return cell_energies(cells, model).sum()
