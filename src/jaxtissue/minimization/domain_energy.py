"""Energy, gradient and centroids of a tissue on any domain, by sections."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.energy import Model
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import bends_of
from jaxtissue.geometry.vectors import components, dot, rows, scale
from jaxtissue.measurement.quadrature import Resolution, section_layers
from jaxtissue.minimization.placed_energy import PlacedEnergy
from jaxtissue.minimization.tissue_energy import energy_on_sections
from jaxtissue.neighbors.moving_lists import MovingLists
from jaxtissue.neighbors.section_neighbors import LAYERS, SectionNeighbors
from jaxtissue.sections.cells import RULE, Layers, cell_view, plan_layers
from jaxtissue.sections.crowd import tell_of_turning
from jaxtissue.sections.smooth_sections import section_moments

NODES = 16  # in each direction, for the mean lengths of coordinates


Placing = tuple[Array, Array, Array | None]  # lengths of coordinates, what turns take off, and the heights of nodes


def reflected(domain: Domain, place: Float[Array, "n *k d"], units: Float[Array, " d"]) -> Float[Array, "n *k d"]:
    """The positions of places, reflected at free ends, with their turns and periods as they are."""
    m, base = components(place / units), domain.base
    return rows(base.reflect(m) if isinstance(base, Rectangle) else base.wrap(m))


def _energy(place: Array, placing: Placing, model: Model, layers: Layers, lists: SectionNeighbors) -> Array:
    units, shift, heights = placing
    positions = reflected(lists.domain, place, units) - shift
    if heights is not None:
        positions = jnp.concatenate([positions, heights], axis=-1)
    return energy_on_sections(positions, model, layers, lists)


def _centroids(place: Array, placing: Placing, layers: Layers, lists: SectionNeighbors) -> Array:
    """The places of centroids: of all points of a cell the mean of the local coordinates round its backbone."""
    domain, rule, (units, shift, _) = lists.domain, RULE._replace(slots=lists.slots), placing
    placed = functools.partial(reflected, domain, units=units)
    heights, candidates = jnp.asarray(layers.heights, place.dtype), jnp.asarray(lists.candidates).T
    found = section_moments(domain, cell_view(domain, placed(place) - shift, candidates, heights), rule)
    volume, *ways = (jnp.asarray(layers.weights[0], place.dtype) @ moment for moment in found)
    y = scale(1 / jnp.where(volume > 0, volume, jnp.inf), tuple(ways))
    if isinstance(domain.base, Rectangle):
        mirrored = jax.jvp(placed, (place,), (jnp.broadcast_to(units, place.shape),))[1]  # 1, or -1 beyond an end
        return place + rows(y) * mirrored * units
    return rows(domain.base.chart(components(placed(place)), y)) * units


@functools.cache
def _placing() -> Callable[..., Any]:
    return jax.jit(reflected)


@functools.cache
def _differentiating() -> Callable[..., tuple[Any, Any]]:
    return jax.jit(jax.value_and_grad(_energy))


@functools.cache
def _seeking_centroids() -> Callable[..., Any]:
    return jax.jit(_centroids)


class DomainEnergy(PlacedEnergy):
    """The energy of a tissue on any domain, as a function of places in lengths.

    On a rectangle places are coordinates times their mean lengths. On a sphere they are vectors of any length, of which
    only the direction counts: so nothing depends on how the sphere is turned. Nodes keep their heights, which places
    are without.
    """

    def __init__(self, model: Model, start: Float[np.ndarray, "n *k d"], resolution: Resolution | str) -> None:
        assert isinstance(model.domain, Domain)
        self.domain = model.domain
        area = (float(self.domain.apical_area) + float(self.domain.basal_area)) / 2
        super().__init__(model, mean_lengths(self.domain, area), (area / len(start)) ** 0.5)
        self._bent = start.ndim == 3
        self._heights = start[..., size:] if start.shape[-1] > (size := len(self.domain.columns)) else None
        self._layers = plan_layers(section_layers(resolution), False, bends_of(start, self.domain))
        self._lists: MovingLists | None = None

    def placed(self, positions: Float[np.ndarray, "n *k d"]) -> Float[np.ndarray, "n *k d"]:
        """The places of positions."""
        return positions[..., : len(self.units)] * self.units

    def positions(self, place: Float[np.ndarray, "n *k d"]) -> Float[np.ndarray, "n *k d"]:
        """Positions of the backbones, within the domain."""
        found = np.asarray(self.domain.reflect(jnp.asarray(place / self.units)))
        return found if self._heights is None else np.concatenate([found, self._heights], axis=-1)

    def renew(self, place: Float[np.ndarray, "n d"]) -> None:
        """Renew the lists unless they are complete here."""
        beyond = np.asarray(_placing()(self.domain, jnp.asarray(place), jnp.asarray(self.units)), float)
        if self._lists is None:
            layers = self._layers if self._bent else LAYERS
            self._lists = MovingLists(self.domain, beyond, self._heights, layers)
        else:
            self._lists.renew(beyond)

    def doubts(self) -> str:
        """Why the energy by the lists renewed last may be wrong, if it may."""
        cells = self._lists.turning_cells() if self._lists is not None and self._bent else np.zeros(0, int)
        return tell_of_turning(cells) if len(cells) else ""

    def measured(self, place: Float[np.ndarray, "n d"]) -> tuple[Any, Float[np.ndarray, "n d"]]:
        """Energy and gradient, by places, by the lists renewed last."""
        energy, gradient = self._run(_differentiating(), place, self.model)
        return energy, np.asarray(gradient, float)

    def centroids(self, place: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """The places of the centroids of the cells, brought along backbones, by the lists renewed last."""
        return np.asarray(self._run(_seeking_centroids(), place), float)

    def _run(self, measure: Callable[..., Any], place: Float[np.ndarray, "n d"], *what: Any) -> Any:
        """What a compiled function finds at a place by the lists renewed last."""
        assert self._lists is not None
        lists, dtype = self._lists.neighbors, jnp.result_type(float)
        given = place, (self.units, self._lists.shift, self._heights)
        point, placing = jax.tree.map(lambda table: jnp.asarray(table, dtype), given)
        program = (measure, lists.candidates.shape, lists.slots)
        return self.timed(program, lambda: measure(point, placing, *what, self._layers, lists))


def mean_lengths(domain: Domain, area: float) -> Float[np.ndarray, " d"]:
    """How long one unit of each coordinate is half way between the surfaces: root mean squares."""
    if not isinstance(domain.base, Rectangle):
        return np.full(3, math.sqrt(area / (4 * math.pi)))
    points, weight = domain.base.nodes(NODES)
    none = jnp.zeros_like(points[0])
    flat = domain.frame(points, (none, none), 0.5 + none)
    squares = [np.average(np.asarray(dot(way, way), float), weights=weight) for way in (flat.first, flat.second)]
    return np.sqrt(np.array(squares))
