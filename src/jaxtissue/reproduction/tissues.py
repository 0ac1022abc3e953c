"""Tissues to look at: annealed ones with their history, and ones relaxed by Lloyd's method."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.anneal import Annealer
from jaxtissue.energy import tube_model
from jaxtissue.lines import PRESETS
from jaxtissue.records import SweepRecord
from jaxtissue.sampling import cylindrical_voxels
from jaxtissue.schedules import constant_schedule
from jaxtissue.tube import Tube
from jaxtissue.voronoi import nearest_backbones

TEMPERATURE = 2.0  # paper, section 4.3
VOXELS = 230  # per cell, for the centroids of Lloyd's method


@dataclass(frozen=True)
class Annealing:
    """How tissues are annealed: random backbones, the paper's energy and temperature, `draft` resolution."""

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


def anneal_histories(annealing: Annealing, seeds: Sequence[int]) -> Iterator[History]:
    """One run for each seed, which gives the random backbones it starts from and its moves; as they end."""
    return (_anneal(annealing, seed) for seed in seeds)


def _anneal(annealing: Annealing, seed: int) -> History:
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
    return tube.random_positions(jax.random.key(seed), cells)


def relax_lloyd(
    positions: Float[Array | np.ndarray, "n 2"], tube: Tube, iterations: int = 30
) -> Float[np.ndarray, "n 2"]:
    """Lloyd's method: every backbone moves to the center of its cell, over and over.

    The center is the mean axial position of the cell's tissue and its mean direction around the axis, the
    angle of sum of v exp(i t), over some 230 voxels a cell of volume v, in 4 layers and square on the basal
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
        labels = np.asarray(nearest_backbones(points, tube.embed(jnp.asarray(place)))[0][:, 0])
        volume, axial, cosine, sine = (np.bincount(labels, moment, n) for moment in moments)
        center = np.stack([axial / np.maximum(volume, 1e-30), np.arctan2(sine, cosine)], axis=-1)
        place = np.where(volume[:, None] > 0, center, place).astype(points.dtype)
    return np.asarray(tube.reflect(jnp.asarray(place)))
