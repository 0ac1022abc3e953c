"""Annealing in one call, the usual way to begin.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.dynamics.schedules import constant_schedule
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.energy import Model, tube_model
from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Resolution
from jaxtissue.system.frames import as_frame
from jaxtissue.tissue.measurer import measure_tissue

Callback = Callable[[SweepRecord, Float[np.ndarray, "n *k d"]], Any]


@dataclass(frozen=True, eq=False)
class AnnealResult:
    """Result of `anneal`: the final tissue, its cells, and the energies during the run.

    Attributes:
        positions: Axial position and angle in radians of each backbone after the last sweep, shape [n, 2]; on other
            domains coordinates of shape [n, 2] or unit vectors of shape [n, 3], or those of nodes, with one axis more.
        cells: Sizes of the cells after the last sweep with error estimates, a `CellGeometry` measured at "standard".
            Lateral areas are plain areas, also if the model has an `adhesion`.
        records: One `SweepRecord` for the initial state and one after each sweep, sweeps + 1 in total.
        model: Energy model of the run.
    """

    positions: Float[np.ndarray, "n *k d"]
    cells: CellGeometry
    records: list[SweepRecord]
    model: Model

    @property
    def energies(self) -> Float[np.ndarray, "rows"]:
        """Energy before the first sweep and after each, at the resolution of the annealing, shape [sweeps + 1]."""
        return np.array([record.energy for record in self.records])

    def to_pandas(self) -> Any:
        """Convert the records to a pandas `DataFrame` with one row per record. Raises ImportError without pandas."""
        return as_frame({name: [getattr(record, name) for record in self.records] for name in SweepRecord._fields})

    def __repr__(self) -> str:
        first, last = self.records[0].energy, self.records[-1].energy
        return f"AnnealResult({len(self.positions)} cells, {len(self.records) - 1} sweeps, E {first:.6g} -> {last:.6g})"

    def _repr_html_(self) -> str:
        first, last = self.records[0], self.records[-1]
        rows = {
            "cells": len(self.positions),
            "sweeps": len(self.records) - 1,
            "energy": f"{first.energy:.6g} &rarr; {last.energy:.6g}",
            "acceptance of the last sweep": f"{last.acceptance:.2f}",
            "volume": f"{np.mean(self.cells.volume):.4g} &plusmn; {np.std(self.cells.volume):.2g}",
            "lateral area": f"{np.mean(self.cells.lateral_area):.4g} &plusmn; {np.std(self.cells.lateral_area):.2g}",
        }
        body = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows.items())
        return f"<table>{body}</table>"


def anneal(
    positions: PositionsLike,
    domain: Tube | Domain,
    sweeps: int = 100,
    temperature: ArrayLike = 2.0,
    seed: int = 0,
    resolution: Resolution | str = "draft",
    model: Model | None = None,
    callback: Callback | None = None,
) -> AnnealResult:
    """Run Metropolis-Hastings sweeps at constant temperature or with a schedule (paper, sections 3.3 and 4.3).

    Moves of independent sets of backbones are proposed and decided together (IS-MH). To minimize the energy, `relax` is
    much faster; to sample at several temperatures use `temper`; to stop and continue a run use
    `Annealer`. The same positions and seed give the same result as the command `jaxtissue anneal`, bit for bit. A
    progress bar is shown on a terminal.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3].
            On domains other than `Tube` backbones may be tilted or bent: [n, k, 2] or [n, k, 3] for k nodes, as in
            `measure_tissue`. A move then takes one node, drawn at random, to another point of its height.
        domain: The tube or other domain.
        sweeps: Number of sweeps, each with one proposed move per cell. Defaults to 100.
        temperature: Temperature T in energy units, at least 0: one number (default 2), or one per sweep, shape
            [sweeps].
        seed: Seed of the moves, 0 to 2^32 - 1. Defaults to 0.
        resolution: "draft" (the default), "standard" or "fine", or a `Resolution`.
        model: Energy model; see `tube_model`. Defaults to the paper's energy, E = sum of K/2 (Vbar - V_i)^2 + Lambda
            A_i with K = 1 and Lambda = 0.4.
        callback: Function `callback(record, positions)` called after each sweep, with a `SweepRecord` and the positions
            of the given shape. A true return value ends the run; sweeps of the same span that have already
            been computed, at most nine, are then discarded. Defaults to None.

    Returns:
        An `AnnealResult` with fields `positions`, `cells`, `records`, `model` and `energies`.

    Raises:
        ValueError: If a position, `temperature`, `seed`, `sweeps`, `resolution` or the energy are invalid, or if
            `model` is for another domain.

    >>> import jax
    >>> tube = Tube(length=12, apical_radius=1, basal_radius=3)
    >>> result = anneal(tube.random_positions(jax.random.key(0), 40), tube, sweeps=5)
    >>> len(result.energies), bool(result.energies[-1] < result.energies[0])
    (6, True)
    """
    place = as_positions_on(positions, domain, bent=isinstance(domain, Domain))
    model = model if model is not None else tube_model(domain, len(place))
    if not _are_same(model.domain, domain):
        kind = "tube" if isinstance(domain, Tube) else "domain"
        raise ValueError(
            f"the model is for {model.domain}, but the positions are in {domain}; make a model for that {kind}"
        )
    if sweeps < 0:
        raise ValueError(f"sweeps={sweeps} is negative; give at least 0 sweeps")
    given = np.asarray(temperature, float)
    schedule = constant_schedule(given.item(), sweeps) if given.ndim == 0 else given
    if schedule.shape != (sweeps,):
        raise ValueError(
            f"temperature has shape {schedule.shape} for {sweeps} sweeps; give one number, or one per sweep"
        )
    annealer = Annealer(model, resolution, "is-mh", seed, schedule)
    state = annealer.start(place)
    records, last = [annealer.record(state)], state.positions
    ended = False
    with tqdm(total=sweeps, desc="annealing", unit="sweep", disable=None) as bar:
        while state.sweep < sweeps and not ended:
            state, played, trail = annealer.advance(state)
            for record, last in zip(played, trail, strict=True):
                records.append(record)
                bar.update()
                ended = callback is not None and bool(callback(record, last))
                if ended:
                    break
            bar.set_postfix(energy=f"{records[-1].energy:.4g}", acceptance=f"{records[-1].acceptance:.2f}")
    return AnnealResult(np.asarray(last), measure_tissue(jnp.asarray(last), domain), records, model)


def _are_same(first: Tube | Domain, second: Tube | Domain) -> bool:
    """Whether two domains have the same shape and sizes; one may be in single precision."""
    (sizes, shape), (others, other) = jax.tree.flatten(first), jax.tree.flatten(second)
    return shape == other and all(np.allclose(a, b, rtol=1e-6, atol=0) for a, b in zip(sizes, others, strict=True))
