"""Tissues for figures: annealed tissues with their history, and tissues relaxed by Lloyd's method."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.modes import random_key, usual_modes
from jaxtissue.diagram.labels import nearest_backbones
from jaxtissue.diagram.voxels import cylindrical_voxels
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.dynamics.schedules import constant_schedule
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.energy import tube_model
from jaxtissue.geometry.backbones import Backbones
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import PRESETS

TEMPERATURE = 2.0  # paper, section 4.3
VOXELS = 230  # per cell, for the centroids of Lloyd's method
SLAB = 4096  # voxels labeled at once
LISTED = 96  # backbones compared with them at first


@dataclass(frozen=True)
class Annealing:
    """The annealing of tissues: random backbones, the paper's energy and temperature, `draft` resolution."""

    tube: Tube
    cells: int
    sweeps: int
    algorithm: str = "is-mh"
    conflicts: str = "near"

    @property
    def name(self) -> str:
        """A name for files, which tells apart all that differ."""
        sizes = (self.tube.length, self.tube.apical_radius, self.tube.basal_radius)
        tube = "x".join(f"{float(size):.9g}" for size in sizes)
        return f"{self.algorithm}_{self.conflicts}_tube{tube}_cells{self.cells}_sweeps{self.sweeps}"


class History(NamedTuple):
    """A run from its first row: columns of `SweepRecord`, and the positions after each sweep."""

    records: dict[str, Float[np.ndarray, "rows"]]
    positions: Float[np.ndarray, "rows n 2"]


def anneal_history(annealing: Annealing, seed: int) -> History:
    """The run of a seed, which gives the random backbones it starts from and its moves."""
    model = tube_model(annealing.tube, annealing.cells)
    temperatures = constant_schedule(TEMPERATURE, annealing.sweeps)
    rules = annealing.algorithm, seed, temperatures, annealing.conflicts
    annealer = Annealer(model, PRESETS["draft"], *rules)
    state = annealer.start(random_tissue(annealing.tube, annealing.cells, seed))
    records, positions = [annealer.record(state)], [state.positions]
    while state.sweep < annealing.sweeps:
        state, rows, trail = annealer.advance(state)
        records += rows
        positions += list(trail)
    columns = dict(zip(SweepRecord._fields, np.array(records, float).T, strict=True))
    return History(columns, np.stack(positions))


def random_tissue(tube: Tube, cells: int, seed: int) -> Float[Array, "n 2"]:
    """The random (axial, angle) positions that a run with this seed starts from (paper, section 4.2)."""
    return tube.random_positions(random_key(seed), cells)


@usual_modes()
def relax_lloyd(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, iterations: int = 30
) -> Float[np.ndarray, "n 2"]:
    """Lloyd's method: every backbone moves to the center of its cell, over and over.

    The center is the mean axial position of the cell's tissue and its mean direction around the axis, the
    angle of sum of v exp(i t), over about 230 voxels a cell of volume v, in 4 layers and square on the basal
    surface. No energy is involved: cells become compact, and their volumes alike.

    >>> relax_lloyd(np.array([[1.0, 0.0], [2.0, 0.1]]), Tube(8, 1, 2))[:, 0].round().tolist()
    [2.0, 6.0]
    """
    n, layers = len(positions), 4
    around = float(2 * np.pi * tube.basal_radius)
    width = np.sqrt(around * float(tube.length) * layers / (VOXELS * n))
    shape = (int(np.ceil(float(tube.length) / width)), layers, int(np.ceil(around / width)))
    points, volumes = cylindrical_voxels(tube, shape)
    turn = np.arctan2(points[:, 2], points[:, 1])
    moments = np.stack([np.ones_like(turn), points[:, 0], np.cos(turn), np.sin(turn)]) * np.asarray(volumes)
    place = np.asarray(positions, points.dtype)
    for _ in range(iterations):
        labels = _label(points, place, tube)
        volume, axial, cosine, sine = (np.bincount(labels, moment, n) for moment in moments)
        center = np.stack([axial / np.maximum(volume, 1e-30), np.arctan2(sine, cosine)], axis=-1)
        place = np.where(volume[:, None] > 0, center, place).astype(points.dtype)
    return np.asarray(tube.reflect(jnp.asarray(place)))


def _label(points: Float[Array, "p 3"], place: Float[np.ndarray, "n 2"], tube: Tube) -> Int[np.ndarray, " p"]:
    """The nearest backbone of each point; points come in rising order along the axis.

    About a thousand points at a time are compared with the backbones near them along the axis only, as wide as
    they need: until none is nearer than the nearest backbone left out could be.
    """
    width, backbones = min(LISTED, len(place)), tube.embed(jnp.asarray(place))
    slabs = -(-len(points) // SLAB)
    parts = jnp.pad(points, ((0, slabs * SLAB - len(points)), (0, 0)), mode="edge").reshape(slabs, SLAB, 3)
    axial = np.asarray(parts[:, :, 0])
    low, high = axial[:, :1], axial[:, -1:]
    off = np.maximum(np.maximum(low - place[:, 0], place[:, 0] - high), 0)
    order = np.argsort(off, axis=1, kind="stable")
    while True:
        listed = np.sort(order[:, :width], axis=1)  # of equally near ones the first is taken
        labels, distances = (np.asarray(found) for found in _nearest(parts, listed, backbones))
        left_out = np.take_along_axis(off, order[:, width : width + 1], axis=1)
        if width == len(place) or (distances < left_out).all():
            return labels.ravel()[: len(points)]
        width = min(2 * width, len(place))


@jax.jit
def _nearest(
    parts: Float[Array, "slabs slab 3"], listed: Int[Array, "slabs listed"], backbones: Backbones
) -> tuple[Int[Array, "slabs slab"], Float[Array, "slabs slab"]]:
    """For each slab of points the nearest of its listed backbones, and how far it is."""

    def search(part: Array, some: Array) -> tuple[Array, Array]:
        labels, distances = nearest_backbones(part, jax.tree.map(lambda ends: ends[some], backbones))
        return some[labels[:, 0]], distances[:, 0]

    return lax.map(lambda at: search(*at), (parts, listed))
