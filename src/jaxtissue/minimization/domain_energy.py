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
from jaxtissue.geometry.vectors import components, dot, rows, scale
from jaxtissue.measurement.quadrature import Resolution, section_layers
from jaxtissue.minimization.placed_energy import PlacedEnergy
from jaxtissue.minimization.tissue_energy import energy_on_sections
from jaxtissue.neighbors.moving_lists import MovingLists
from jaxtissue.neighbors.section_neighbors import SectionNeighbors
from jaxtissue.sections.cells import RULE, Layers, cell_view, plan_layers
from jaxtissue.sections.smooth_sections import section_moments

NODES = 16  # in each direction, for the mean lengths of coordinates


def reflected(domain: Domain, place: Float[Array, "n d"], units: Float[Array, " d"]) -> Float[Array, "n d"]:
    """The positions of places, reflected at free ends, with their turns and periods as they are."""
    m, base = components(place / units), domain.base
    return rows(base.reflect(m) if isinstance(base, Rectangle) else base.wrap(m))


def _energy(place: Array, units: Array, shift: Array, model: Model, layers: Layers, lists: SectionNeighbors) -> Array:
    return energy_on_sections(reflected(lists.domain, place, units) - shift, model, layers, lists)


def _centroids(place: Array, units: Array, shift: Array, layers: Layers, lists: SectionNeighbors) -> Array:
    """The places of centroids: of all points of a cell the mean of the local coordinates round its backbone."""
    domain, rule = lists.domain, RULE._replace(slots=lists.slots)
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
    only the direction counts: so nothing depends on how the sphere is turned.
    """

    def __init__(self, model: Model, cells: int, resolution: Resolution | str) -> None:
        assert isinstance(model.domain, Domain)
        self.domain = model.domain
        area = (float(self.domain.apical_area) + float(self.domain.basal_area)) / 2
        super().__init__(model, mean_lengths(self.domain, area), (area / cells) ** 0.5)
        self._layers = plan_layers(section_layers(resolution), check=False)
        self._lists: MovingLists | None = None

    def positions(self, place: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Positions of the backbones, within the domain."""
        return np.asarray(self.domain.reflect(jnp.asarray(place / self.units)))

    def renew(self, place: Float[np.ndarray, "n d"]) -> None:
        """Renew the lists unless they are complete here."""
        beyond = np.asarray(_placing()(self.domain, jnp.asarray(place), jnp.asarray(self.units)), float)
        if self._lists is None:
            self._lists = MovingLists(self.domain, beyond)
        else:
            self._lists.renew(beyond)

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
        arrays = [jnp.asarray(given, dtype) for given in (place, self.units, self._lists.shift)]
        program = (measure, lists.candidates.shape, lists.slots)
        return self.timed(program, lambda: measure(*arrays, *what, self._layers, lists))


def mean_lengths(domain: Domain, area: float) -> Float[np.ndarray, " d"]:
    """How long one unit of each coordinate is half way between the surfaces: root mean squares."""
    if not isinstance(domain.base, Rectangle):
        return np.full(3, math.sqrt(area / (4 * math.pi)))
    points, weight = domain.base.nodes(NODES)
    none = jnp.zeros_like(points[0])
    flat = domain.frame(points, (none, none), 0.5 + none)
    squares = [np.average(np.asarray(dot(way, way), float), weights=weight) for way in (flat.first, flat.second)]
    return np.sqrt(np.array(squares))
