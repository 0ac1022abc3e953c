"""Measurement of whole tissues: once (`measure_tissue`), or repeatedly while backbones move (`CellMeasurer`).

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

import functools
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from jaxtissue.compilation.fusion import options
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution, plan_lines
from jaxtissue.neighbors.neighbor_list import NeighborList, list_neighbors
from jaxtissue.neighbors.search import TILES, find_defect
from jaxtissue.neighbors.shortlists import (
    CANDIDATES,
    STOPS,
    from_both,
    mutual_entries,
    nearest_sides,
    shortlist_length,
    sight_lines,
    survey_tissue,
)
from jaxtissue.tissue.domain_tissue import measure_domain_tissue
from jaxtissue.tissue.refinement import (
    FEW_CELLS,
    LIMITS,
    SUMS,
    Tissue,
    measure_refined,
    measuring,
    mesh,
    over_limits,
    plain,
)
from jaxtissue.topology.traced_sizes import trace_sizes


@usual_modes()
def measure_tissue(
    positions: PositionsLike,
    domain: Tube | Domain,
    resolution: Resolution | str = "standard",
    surfaces: bool = True,
    tolerance: float | None = None,
    refine: bool = True,
) -> CellGeometry:
    """Measure volume, areas and perimeters of every cell of a tissue, with estimated errors (paper, section 3.1).

    In a `Tube` cells are measured by quadrature on lines parallel to the axis, at two resolutions whose difference
    gives the error estimates. Cells whose estimated error exceeds 1 % of the mean volume or 5 % of the mean lateral
    area (or `tolerance`) are measured again by tracing the edges of the Voronoi diagram in float64, to a relative error
    of about 1e-5. Tissues of up to 64 cells are always traced completely, and so are all tissues if `tolerance` is
    below 0.01; this takes about 1 ms per cell. On other domains cells are measured as polygons on layers of constant
    height. Errors there are estimated from a second quadrature rule with one layer less, from the corners and edges of
    the polygons, and from the median over the cells.

    Neighbor lists are built on the host, so this function is not jittable; see `tissue_energy` for a jittable function.
    A warning lists the worst cells if errors above the limits remain, or if the volumes do not add up to the volume of
    the domain.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3].
            Tilted and bent backbones have one axis more, [n, k, 2] or [n, k, 3], for k nodes at equally spaced heights
            from the apical to the basal end; or one coordinate more too, the height of each node, from 0 to 1.
        domain: The tube or other domain.
        resolution: "draft", "standard" (the default) or "fine", or a `Resolution`.
        surfaces: Whether to measure areas and perimeters on the apical and basal surface. Defaults to True.
        tolerance: Largest acceptable error, as a fraction of the mean volume and of the mean lateral area; only for a
            `Tube`. Defaults to None, which means 0.01 for volumes and 0.05 for lateral areas.
        refine: Whether to estimate errors and to measure again the cells that exceed the limits. Defaults to True. With
            False, cells are measured at `resolution` only, faster, without error estimates or warnings.

    Returns:
        A `CellGeometry` with arrays of shape [n]. `volume_error` and `lateral_area_error` are None if `refine` is
        False. `tiling_defect` is 0 if the whole tissue was traced.

    Raises:
        ValueError: If a position is not finite, lies outside the domain or coincides with another, if `tolerance` is
            not positive, or if it is given for a domain other than `Tube`.

    >>> tube = Tube(length=12, apical_radius=1, basal_radius=3)
    >>> cells = measure_tissue(tube.random_positions(jax.random.key(0), 40), tube)
    >>> bool(abs(cells.volume.sum() / tube.volume - 1) < 1e-4), cells.apical_perimeter.shape
    (True, (40,))
    """
    if tolerance is not None and not tolerance > 0:
        raise ValueError(f"tolerance={tolerance} is not positive; give a fraction of the mean cell, such as 0.001")
    domain = domain_of(domain, positions)
    if isinstance(domain, Domain):
        if tolerance is not None:
            raise ValueError(f"tolerance={tolerance} is available for tubes only; give a finer resolution instead")
        return measure_domain_tissue(positions, domain, resolution, surfaces, refine)
    given, resolution = as_positions(positions, domain, float), as_resolution(resolution)
    limits, defect, n = as_limits(tolerance), 0.0, len(given)
    closely = refine and (n <= FEW_CELLS or min(limits) < min(LIMITS))
    traced = trace_sizes(given, domain) if closely else None
    if traced is not None:
        cells = plain(traced._asdict(), jnp.result_type(float), surfaces)
    else:
        place = as_positions(positions, domain, sizes=not refine)
        neighbors = list_neighbors(place, domain)
        defect = neighbors.tiling_defect
        if not refine:
            lines = plan_lines(domain, n, resolution, surfaces=surfaces)
            measured = _measure(place, jax.tree.map(np.asarray, (domain, lines, neighbors.candidates)))
            return replace(measured, tiling_defect=jnp.asarray(defect))
        cells = measure_refined(Tissue(place, given, neighbors), resolution, surfaces, limits)
    for message in doubts(cells, domain, limits):
        warnings.warn(message, stacklevel=3)
    return replace(cells, tiling_defect=jnp.asarray(defect, cells.volume.dtype))


def as_limits(tolerance: float | None) -> tuple[float, float]:
    """The limits of the errors of volume and lateral area, as fractions of their means, for a tolerance."""
    return (min(tolerance, LIMITS[0]), min(tolerance, LIMITS[1])) if tolerance else LIMITS


def doubts(cells: CellGeometry, tube: Tube, limits: tuple[float, float]) -> Iterator[str]:
    """The warnings about sizes that cannot be trusted; there is none where their errors are below the limits.

    The limits are fractions of the mean volume and of the mean lateral area.
    """
    for limit, told in over_limits(cells, limits):
        cure = "use 64 bits (--x64 or jax_enable_x64), separate backbones that nearly coincide"
        cure += ", or give a larger tolerance" if limit < min(LIMITS) else ""
        yield f"{told}; {cure}"
    total, error = (np.asarray(c, float).sum() for c in (cells.volume, cells.volume_error))
    lost = total - float(tube.volume)
    if not abs(lost) <= error + SUMS * float(tube.volume) / len(cells.volume):
        share = lost / float(tube.volume)
        yield f"the cell volumes add up to {1 + share:.6f} times the tube volume: cells are incomplete or overlap"


class Kept(NamedTuple):
    """The data that a `CellMeasurer` keeps: a short neighbor list, and all but the positions on every device."""

    neighbors: NeighborList
    placed: tuple[Tube, Lines, Array]


class CellMeasurer:
    """Measure the cells of a tube repeatedly while backbones move, reusing short neighbor lists.

    Use `CellMeasurer` in a simulation loop; for a single measurement with error estimates use `measure_tissue`. Each
    cell is compared only with the 22 candidates on either side (a few more in tissues of more than 500 cells) that are
    closest to bounding it. The lists are rebuilt when a check shows that a neighbor is missing.

    Args:
        tube: The tube.
        resolution: "draft", "standard" (the default) or "fine", or a `Resolution`.
        surfaces: Whether to measure areas and perimeters on the apical and basal surface. Defaults to False.

    Attributes:
        num_rebuilds: Number of times that the neighbor lists were built, including the first.

    >>> tube = Tube(length=12, apical_radius=1, basal_radius=3)
    >>> positions = tube.random_positions(jax.random.key(0), 40)
    >>> measurer = CellMeasurer(tube, "draft")
    >>> first = measurer.measure(positions)
    >>> turned = measurer.measure(positions + np.array([0, 0.01], np.float32))
    >>> measurer.num_rebuilds, bool(abs(turned.volume - first.volume).max() < 1e-3)
    (1, True)
    """

    def __init__(self, tube: Tube, resolution: Resolution | str = "standard", surfaces: bool = False) -> None:
        self.tube, self.resolution, self.surfaces = tube, as_resolution(resolution), surfaces
        self.num_rebuilds = 0
        self._kept: Kept | None = None

    @usual_modes()
    def measure(self, positions: PositionsLike, check: bool = True) -> CellGeometry:
        """Measure all cells at the given positions. Not jittable.

        Args:
            positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
                columns `axial` and `angle`.
            check: Whether to test that no neighbor is missing, and to rebuild the neighbor lists if one is. Defaults to
                True. With False, the caller must ensure that backbones have moved only a little since the last check.

        Returns:
            A `CellGeometry` with arrays of shape [n], without error estimates.

        Raises:
            ValueError: If a position is not finite, lies outside the tube, or coincides with another.
        """
        positions = as_positions(positions, self.tube)
        kept, lacks = self._kept, True
        if kept and len(kept.neighbors) == len(positions):
            lacks = check and not kept.neighbors.covers(positions)
        if lacks or not kept:
            kept = self._renew(positions)
        return _measure(positions, kept.placed)

    @property
    def neighbors(self) -> NeighborList | None:
        """The current short neighbor list, or None before the first measurement."""
        return self._kept.neighbors if self._kept else None

    def _renew(self, positions: Float[np.ndarray, "n 2"]) -> Kept:
        """Find complete lists, measure how far each candidate is from bounding the cell, and keep the nearest."""
        n, tube = len(positions), self.tube
        # as wide on both sides as the mean cell at the apical surface: candidates that level may change sides
        margin = math.sqrt(2 * float(tube.apical_radius) * float(tube.length) / n)
        neighbors = list_neighbors(positions, tube, margin)
        sides = np.asarray(neighbors.candidates)
        lines = plan_lines(tube, n, self.resolution, surfaces=self.surfaces)
        looked_at = lines, sight_lines(tube, n, self.resolution)
        _, clear = _seeing()(positions, tube, looked_at, sides)
        views = mutual_entries(sides)  # while the device measures
        clear = from_both(np.asarray(clear), views)
        # all candidates that stop a cell, as the check's lines might miss one; in steps, so that shapes are few
        bounding = int((clear <= STOPS).sum(axis=2).max())
        count = min(max(shortlist_length(n), -(-bounding // CANDIDATES) * CANDIDATES), sides.shape[2])

        def shorter(count: int) -> NeighborList:
            few = nearest_sides(sides, clear, count)
            return replace(neighbors, candidates=few, tiling_defect=np.asarray(find_defect(positions, tube, few)))

        few = shorter(count)
        while count < sides.shape[2] and few.tiling_defect >= TILES:  # a cell may need more
            count = min(2 * count, sides.shape[2])
            few = shorter(count)
        self.num_rebuilds += 1
        everywhere = NamedSharding(mesh(tuple(jax.local_devices())), PartitionSpec())
        self._kept = Kept(few, jax.device_put((tube, lines, few.candidates), everywhere))
        return self._kept


def _measure(positions: Float[np.ndarray, "n 2"], rest: tuple[Tube, Lines, Array | np.ndarray]) -> CellGeometry:
    """The sizes of all cells, measured on all devices of this process, an equal share on each."""
    devices, n = tuple(jax.local_devices()), len(positions)
    cells = np.minimum(np.arange(-(-n // len(devices)) * len(devices)), n - 1)  # the last may be one
    found, _ = measuring(devices)(cells.astype(np.int32), np.asarray(positions), *rest)
    return jax.tree.map(lambda column: column[:n], found)


@functools.cache
def _seeing() -> Callable[..., tuple[Any, Array]]:
    return jax.jit(survey_tissue, compiler_options=options(light=True))
