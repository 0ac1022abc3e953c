"""Energy of a whole tissue as a differentiable function.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, cell_energies, check_numbers
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import bends_of
from jaxtissue.geometry.positions import as_rows
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution, plan_lines, section_layers, trace_lines
from jaxtissue.measurement.smooth_sizes import find_windows, smooth_sizes
from jaxtissue.minimization.traced_energy import TRACED, traced_energy
from jaxtissue.neighbors.section_neighbors import SectionNeighbors
from jaxtissue.sections.cells import RULE, Layers, cell_sizes, plan_layers
from jaxtissue.sections.half_planes import take
from jaxtissue.sections.smooth_sections import smooth_sections

HALF = 0.5  # of a cell, by which the mean volume may differ from that of a domain whose sizes are varied


@usual_modes()
def tissue_energy(
    positions: PositionsLike, model: Model, neighbors: Any, resolution: Resolution | str = "standard"
) -> Float[Array, ""]:
    """Compute the energy of a tissue, E = sum of E_i, as a differentiable pure function (paper, section 3.1).

    Differentiable with respect to `positions` and every leaf of `model`, including the dimensions of the domain, and
    compatible with `jax.grad`, `jax.jvp`, `jax.jit` and `jax.vmap`. Under `jax.jit`, `resolution` must be static.
    In a `Tube`, derivatives are the exact derivatives of the discretized energy. Those of volumes agree with the true
    ones to about 2 % of the length of the gradient. Those of lateral areas are much less accurate: the error of the
    discretized area is small, but it changes within the distance of two lines. Use `resolution="traced"` if they
    matter. On other domains derivatives are those of the true walls, as far as their sections show them: also those of
    areas agree with the true ones to a few percent. To minimize the energy, use `relax`.

    Args:
        positions: Axial position and angle in radians of each backbone, floats, shape [n, 2]; on other domains
            coordinates of shape [n, 2] or unit vectors of shape [n, 3], or those of the nodes of tilted and bent
            backbones, as in `measure_tissue`. Derivatives by heights of nodes and along unit vectors are 0.
        model: Energy model; see `tube_model`.
        neighbors: Neighbor list valid for `positions`, from `NeighborList.allocate`.
        resolution: "draft", "standard" (the default) or "fine", or a `Resolution`; in a `Tube` also "traced". Then the
            energy is computed from the traced edges of the diagram, in 64 bits on the host, and reverse-mode
            derivatives with respect to positions are those of the true volumes and areas, to about 6 digits, or 3
            where neighbors are at the same axial position. This takes some milliseconds per cell. `neighbors` is not
            used, forward mode is not supported, and derivatives with respect to dimensions of the tube and weights of
            adhesion are NaN.

    Returns:
        Energy of the tissue, a scalar. NaN if cells extend too far around the domain for the fixed size of the work
        arrays.

    Raises:
        TypeError: If `neighbors` was allocated for a `Tube` and the domain of `model` is not one, or vice versa.
        ValueError: If the number of positions differs from the number of cells of `neighbors` or of `model`, or from
            the number of rows of its `parameters` or types, or if `resolution` is "traced" and the domain is not a
            `Tube` or the energy depends on the surfaces.

    >>> from jaxtissue.energy import tube_model
    >>> from jaxtissue.geometry.tube import Tube
    >>> from jaxtissue.neighbors.neighbor_list import NeighborList
    >>> tube = Tube(length=12.0, apical_radius=1.0, basal_radius=3.0)
    >>> positions = tube.random_positions(jax.random.key(0), 40)
    >>> neighbors = NeighborList.allocate(positions, tube)
    >>> slope = jax.jit(jax.grad(tissue_energy), static_argnames="resolution")
    >>> slope(positions, tube_model(tube, 40), neighbors, resolution="draft").shape
    (40, 2)
    """
    if isinstance(model.domain, Domain) != isinstance(neighbors, SectionNeighbors):
        given, kind = type(neighbors).__name__, type(model.domain).__name__
        raise TypeError(
            f"neighbors of type {given} do not match a {kind}; use NeighborList.allocate(positions, domain)"
        )
    bent = isinstance(model.domain, Domain)
    place = jnp.asarray(as_rows(positions, column_names(model.domain), len(neighbors), bent))
    check_numbers(model, len(place), HALF)
    if resolution == TRACED:
        return traced_energy(place, model)
    if isinstance(model.domain, Domain):
        layers = plan_layers(section_layers(resolution), False, bends_of(place, model.domain))
        return energy_on_sections(place, model, layers, neighbors)
    tube, resolution = model.tube, as_resolution(resolution)
    is_traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tube))
    plan = trace_lines if is_traced else plan_lines
    lines = plan(tube, len(place), resolution, surfaces=model.has_surfaces)
    return energy_on_lines(place, model, lines, neighbors.candidates)


def energy_on_lines(
    positions: Float[Array, "n 2"], model: Model, lines: Lines, candidates: Int[Array | np.ndarray, "n 2 k"]
) -> Float[Array, ""]:
    """The same on given lines and lists."""
    windows = find_windows(positions, model.tube, lines, candidates)
    cells = smooth_sizes(positions, model.tube, lines, windows, model.adhesion)
    return cell_energies(cells, model).sum()


def energy_on_sections(
    positions: Float[Array, "n *k d"], model: Model, layers: Layers, neighbors: SectionNeighbors
) -> Float[Array, ""]:
    """The same on given layers of any domain."""
    domain, lists = model.domain, jnp.asarray(neighbors.candidates).T
    assert isinstance(domain, Domain)
    rule = RULE._replace(slots=neighbors.slots)
    sections = smooth_sections(positions, domain, lists, jax.tree.map(jnp.asarray, layers), rule)
    if model.adhesion is not None:
        worth = model.adhesion.between(jnp.arange(lists.shape[1]), lists % lists.shape[1])[:, None]
        sections = sections._replace(wall=sections.wall * take(worth, jnp.minimum(sections.line, len(lists) - 1)))
    sizes = cell_sizes(domain, sections, layers, len(lists))
    surfaces = [*sizes.areas, *sizes.perimeters] if model.has_surfaces else []
    cells = CellGeometry(sizes.volume[0], sizes.lateral_area[0], *surfaces)
    return jnp.where(sizes.is_cut.any(), jnp.nan, cell_energies(cells, model).sum())
