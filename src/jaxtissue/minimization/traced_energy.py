"""Energy of a tissue in a tube from its traced edges: sizes and derivatives are right to 8 digits, in 64 bits.

Edges are traced on the host, in NumPy, which takes some milliseconds per cell. In programs of JAX this is a callback.
"""

import functools
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import float0
from jaxtyping import Array, Float

from jaxtissue.compilation.modes import double_precision
from jaxtissue.energy import Model, cell_energies, in_precision
from jaxtissue.geometry.tube import TUBE_SIZES, Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.minimization.placed_energy import PlacedEnergy
from jaxtissue.topology.contacts import find_contacts
from jaxtissue.topology.traced_slopes import Traced, trace_tissue, traced_slopes

TRACED = "traced"  # the resolution by this name
KEPT = 4  # tissues whose edges are kept, so that a derivative need not trace them again
_known: OrderedDict[bytes, Traced | None] = OrderedDict()


def traced_energy(positions: Float[Array, "n 2"], model: Model) -> Float[Array, ""]:
    """The energy by traced sizes; NaN where edges could not be followed, and derivatives by sizes of the tube."""
    check_traceable(model)
    volume, area = _sizes(positions, model.tube, model.adhesion)
    return cell_energies(CellGeometry(volume, area), model).sum()


def check_traceable(model: Model) -> None:
    """Raise `ValueError` for a model that traced sizes do not serve."""
    if not isinstance(model.domain, Tube):
        raise ValueError(f"resolution='traced' of a {type(model.domain).__name__}; give a preset, or a Tube")
    if model.has_surfaces:
        raise ValueError("resolution='traced' has no derivatives of sizes on the surfaces; give a preset")


Back = Callable[[np.ndarray, np.ndarray], np.ndarray]  # from derivatives by volumes and areas to those by positions


def measured_and_slopes(
    positions: Float[np.ndarray, "n 2"], tube: Tube, adhesion: Adhesion | None
) -> tuple[Float[np.ndarray, "2 n"], Back]:
    """Volumes and lateral areas, and the function that takes derivatives by sizes to those by positions."""
    found, n = _trace(positions, tube), len(positions)
    if found is None:
        return np.full((2, n), np.nan), lambda *_: np.full((n, 2), np.nan)
    graph, area = found.graph, found.sizes.lateral_area
    if adhesion is not None:
        walls = find_contacts(positions, tube, edges=graph)
        worth = np.asarray(adhesion.weights)[tuple(np.asarray(adhesion.types)[walls.pairs.T])]
        area = np.bincount(walls.pairs.T.ravel(), np.tile(worth * walls.area, 2), n)
    sizes = np.stack([found.sizes.volume, area])
    return sizes, lambda volume, area: traced_slopes(graph, volume, area, adhesion)


def _trace(positions: Float[np.ndarray, "n 2"], tube: Tube) -> Traced | None:
    sizes = [float(getattr(tube, name)) for name in TUBE_SIZES]
    key = np.concatenate([np.ravel(positions), sizes]).astype(float).tobytes()
    if key not in _known:
        _known[key] = trace_tissue(positions, Tube(*sizes))
        while len(_known) > KEPT:
            _known.popitem(last=False)
    return _known[key]


@jax.custom_vjp
def _sizes(positions: Array, tube: Tube, adhesion: Adhesion | None) -> tuple[Array, Array]:
    def measure(positions: Any, tube: Tube, adhesion: Adhesion | None) -> np.ndarray:
        return measured_and_slopes(np.asarray(positions, float), tube, adhesion)[0].astype(dtype)

    dtype = positions.dtype
    shape = jax.ShapeDtypeStruct((2, len(positions)), dtype)
    volume, area = jax.pure_callback(measure, shape, positions, tube, adhesion, vmap_method="sequential")
    return volume, area


def _forward(*given: Any) -> tuple[tuple[Array, Array], Any]:
    return _sizes(*given), given


def _backward(given: Any, by: tuple[Array, Array]) -> tuple[Any, ...]:
    def slopes(positions: Any, tube: Tube, adhesion: Adhesion | None, *by: Any) -> np.ndarray:
        back = measured_and_slopes(np.asarray(positions, float), tube, adhesion)[1]
        return back(*(np.asarray(part, float) for part in by)).astype(dtype)

    positions, dtype = given[0], given[0].dtype
    shape = jax.ShapeDtypeStruct(positions.shape, dtype)
    slope = jax.pure_callback(slopes, shape, *given, *by, vmap_method="sequential")
    return slope, *jax.tree.map(_unknown, given[1:])


def _unknown(leaf: Array) -> Any:
    """What no one has derived must not pass for 0."""
    return jnp.full_like(leaf, jnp.nan) if jnp.issubdtype(leaf.dtype, jnp.floating) else np.zeros(leaf.shape, float0)


_sizes.defvjp(_forward, _backward)


@functools.cache
def _by_sizes() -> Callable[..., Any]:
    def energy(sizes: Array, model: Model) -> Array:
        return cell_energies(CellGeometry(sizes[0], sizes[1]), model).sum()

    return jax.jit(jax.value_and_grad(energy))


class TracedEnergy(PlacedEnergy):
    """The energy of a tissue in a tube by traced sizes, as a function of places in lengths, in 64 bits."""

    def __init__(self, model: Model, cells: int) -> None:
        check_traceable(model)
        tube = model.tube
        units = np.array([1.0, (float(tube.apical_radius) + float(tube.basal_radius)) / 2])
        width = (2 * np.pi * units[1] * float(tube.length) / cells) ** 0.5
        super().__init__(in_precision(model, np.float64), units, width)
        self.stalled, self.noise = 1e-13, 1e-9  # whatever the session's precision

    def positions(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """(axial, angle) of the backbones, in 64 bits."""
        length = float(self.model.tube.length)
        axial, angle = (place / self.units).T
        folded = np.mod(axial, 2 * length)
        return np.stack([np.where(folded > length, 2 * length - folded, folded), angle], axis=1)

    def renew(self, place: Float[np.ndarray, "n 2"]) -> None:
        """There are no lists."""

    def measured(self, place: Float[np.ndarray, "n 2"]) -> tuple[Any, Float[np.ndarray, "n 2"]]:
        """Energy and gradient, by places."""
        energy, by_sizes, back = self.by_sizes(place)
        slope = back(*by_sizes) / self.units
        slope[np.floor(place[:, 0] / float(self.model.tube.length)) % 2 != 0, 0] *= -1
        return energy, slope

    def sizes(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 n"]:
        """Volumes and lateral areas."""
        return measured_and_slopes(self.positions(place), self.model.tube, self.model.adhesion)[0]

    def by_sizes(self, place: Float[np.ndarray, "n 2"]) -> tuple[float, np.ndarray, Callable[..., np.ndarray]]:
        """The energy, its derivatives by volumes and areas, and the function that takes these to positions."""
        sizes, back = measured_and_slopes(self.positions(place), self.model.tube, self.model.adhesion)
        with double_precision():
            energy, by = self.timed("sizes", lambda: _by_sizes()(jnp.asarray(sizes), self.model))
        return float(energy), np.asarray(by, float), back
