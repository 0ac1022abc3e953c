"""Annealing in one call, the usual way to begin."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float
from tqdm import tqdm

from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.dynamics.schedules import constant_schedule
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.energy import Model, tube_model
from jaxtissue.geometry.domain_positions import as_positions_on
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.quadrature import Resolution
from jaxtissue.system.frames import as_frame
from jaxtissue.tissue.measurer import measure_tissue

Callback = Callable[[SweepRecord, Float[np.ndarray, "n d"]], Any]


@dataclass(frozen=True, eq=False)
class AnnealResult:
    """The result of annealing (paper, section 4.3).

    Attributes:
        positions: (axial, angle) of each backbone after the last sweep, [n, 2], or what positions on the domain are.
        cells: The sizes of the cells after it, with bounds of their errors, measured at `standard`. Lateral areas are
            those of the walls themselves, without the weights of an adhesion.
        records: A record of the initial state and one of each sweep.
        model: The energy of the annealing.
    """

    positions: Float[np.ndarray, "n d"]
    cells: CellGeometry
    records: list[SweepRecord]
    model: Model

    @property
    def energies(self) -> Float[np.ndarray, "rows"]:
        """The energy before the first sweep and after each, [sweeps + 1], at the resolution of the annealing."""
        return np.array([record.energy for record in self.records])

    def to_pandas(self) -> Any:
        """The records as a pandas `DataFrame`, a row for each sweep; raises `ImportError` without pandas."""
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
    positions: Any,
    domain: Tube | Domain,
    sweeps: int = 100,
    temperature: float | Float[ArrayLike, "sweeps"] = 2.0,
    seed: int = 0,
    resolution: Resolution | str = "draft",
    model: Model | None = None,
    callback: Callback | None = None,
) -> AnnealResult:
    """Relax a tissue by independent-set Metropolis-Hastings sweeps (paper, sections 3.3 and 4.3).

    Shows a progress bar on a terminal. The same positions and seed give what `jaxtissue anneal` gives, to the bit.

    Args:
        positions: (axial, angle) of each backbone, [n, 2], or what positions on the domain are, in any form that
            `as_positions` takes.
        domain: The tube or other domain that they stand in.
        sweeps: Number of sweeps; in each, every cell makes one move.
        temperature: T, in the unit of the energy: one number, or one for each sweep, [sweeps].
        seed: The seed of the moves, 0 to 2^32 - 1.
        resolution: How finely cells are measured during the sweeps: a preset or layers and lines.
        model: The energy; the paper's by default, E = sum of K/2 (Vbar - V)^2 + Lambda A with K = 1, Lambda = 0.4.
        callback: Called as `callback(record, positions)` after each sweep; ends the run if it returns a true value.
            Sweeps are played up to ten at a time, so that up to nine more may have been played by then; they are left
            out.

    Returns:
        The positions and cells after the last sweep, and a record of each sweep.

    Raises:
        ValueError: If the positions, the temperature, the seed, or the energy are refused; the message names the
            value and the remedy.

    >>> import jax
    >>> tube = Tube(length=12, apical_radius=1, basal_radius=3)
    >>> result = anneal(tube.random_positions(jax.random.key(0), 40), tube, sweeps=5)
    >>> len(result.energies), bool(result.energies[-1] < result.energies[0])
    (6, True)
    """
    place = as_positions_on(positions, domain)
    model = model if model is not None else tube_model(domain, len(place))
    if not _are_same(model.domain, domain):
        kind = "tube" if isinstance(domain, Tube) else "domain"
        raise ValueError(
            f"the model is of {model.domain}, and the positions stand in {domain}; make one for that {kind}"
        )
    if sweeps < 0:
        raise ValueError(f"sweeps={sweeps} is below 0; give a number of sweeps")
    given = np.asarray(temperature, float)
    schedule = constant_schedule(given.item(), sweeps) if given.ndim == 0 else given
    if schedule.shape != (sweeps,):
        raise ValueError(f"{schedule.shape} temperatures for {sweeps} sweeps; give one, or one for each sweep")
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
