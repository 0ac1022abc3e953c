"""Energy, gradient and centroids of a tissue in a tube, by lines."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxtissue.energy import Model
from jaxtissue.measurement.centroids import measure_moments
from jaxtissue.measurement.quadrature import Resolution, plan_lines
from jaxtissue.minimization.placed_energy import PlacedEnergy
from jaxtissue.minimization.tissue_energy import energy_on_lines
from jaxtissue.neighbors.neighbor_list import NeighborList, list_neighbors

MARGIN = 0.25  # mean cell widths along the axis by which lists reach to the other side of a cell


@functools.cache
def _differentiating() -> Callable[..., tuple[Any, Any]]:
    return jax.jit(jax.value_and_grad(energy_on_lines))


@functools.cache
def _seeking_centroids() -> Callable[..., Any]:
    return jax.jit(measure_moments)


class TubeEnergy(PlacedEnergy):
    """The energy of a tissue in a tube, as a function of places in lengths.

    Lengths are along the axis, and round it at the mean of both radii; beyond the tube's ends backbones are reflected.
    """

    def __init__(self, model: Model, cells: int, resolution: Resolution | str) -> None:
        tube = model.tube
        units = np.array([1.0, (float(tube.apical_radius) + float(tube.basal_radius)) / 2])
        super().__init__(model, units, (2 * np.pi * units[1] * float(tube.length) / cells) ** 0.5)
        self._lines = plan_lines(tube, cells, resolution, surfaces=model.has_surfaces)
        self._neighbors: NeighborList | None = None

    def positions(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """(axial, angle) of the backbones."""
        return np.asarray(self.model.tube.reflect(jnp.asarray(place / self.units)))

    def renew(self, place: Float[np.ndarray, "n 2"]) -> None:
        """Renew the lists unless they are complete here."""
        positions = self.positions(place)
        if self._neighbors is None or not self._neighbors.covers(positions):
            self._neighbors = list_neighbors(positions, self.model.tube, MARGIN * self.width)

    def measured(self, place: Float[np.ndarray, "n 2"]) -> tuple[Any, Float[np.ndarray, "n 2"]]:
        """Energy and gradient, by places, by the lists renewed last."""
        energy, gradient = self._run(_differentiating(), place, self.model)
        slope = np.asarray(gradient, float) / self.units
        slope[self._is_reflected(place), 0] *= -1
        return energy, slope

    def centroids(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """The centroids of the cells by the lists renewed last: mean axial position, and mean direction from the axis.

        A cell that no line meets is taken to be at its backbone.
        """
        found = self._run(_seeking_centroids(), place, self.model.tube)
        volume, axial, along, across = (np.asarray(moment, float) for moment in found)
        shift = axial / np.where(volume > 0, volume, 1)
        shift[self._is_reflected(place)] *= -1
        return place + np.stack([shift, np.arctan2(across, along)], axis=-1) * self.units

    def _run(self, measure: Callable[..., Any], place: Float[np.ndarray, "n 2"], what: Any) -> Any:
        """What a compiled function finds at a place by the lists renewed last."""
        assert self._neighbors is not None
        lists = self._neighbors.candidates
        positions = jnp.asarray(self.positions(place))
        return self.timed((measure, lists.shape), lambda: measure(positions, what, self._lines, lists))

    def _is_reflected(self, place: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Which backbones point the other way along the axis, since their places are beyond an end of the tube."""
        return np.floor(place[:, 0] / float(self.model.tube.length)) % 2 != 0
