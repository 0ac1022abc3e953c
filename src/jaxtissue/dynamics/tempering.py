"""Parallel tempering (replica exchange): replicas at different temperatures exchange configurations."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from jaxtissue.dynamics.annealer import Annealer, AnnealState, advance_together, record_together
from jaxtissue.dynamics.sweep_log import SweepRecord
from jaxtissue.energy import Model
from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.measurement.quadrature import Resolution

Callback = Callable[[Sequence[SweepRecord], Float[np.ndarray, "replicas n d"]], Any]


@dataclass(frozen=True, eq=False)
class TemperResult:
    """Result of parallel tempering.

    Attributes:
        temperatures: Temperature of each replica, in increasing order, shape [replicas].
        positions: Positions at each temperature after the last sweep, shape [replicas, n, 2]; on other domains
            [replicas, n, d].
        energies: Energy at each temperature before the first sweep and after each sweep, shape [sweeps + 1, replicas].
        origins: Trajectories through the temperatures, shape [sweeps + 1, replicas]: `origins[k, i]` is the initial
            replica whose tissue is at temperature i after sweep k.
        swaps: Acceptance rate of the exchanges between each temperature and the next, shape [replicas - 1].
    """

    temperatures: Float[np.ndarray, "replicas"]
    positions: Float[np.ndarray, "replicas n d"]
    energies: Float[np.ndarray, "rows replicas"]
    origins: Int[np.ndarray, "rows replicas"]
    swaps: Float[np.ndarray, "pairs"]

    def __repr__(self) -> str:
        replicas, cells = self.positions.shape[:2]
        low, high = self.temperatures[0], self.temperatures[-1]
        told = f"T {low:g} to {high:g}, {np.mean(self.swaps):.0%} of the exchanges accepted"
        return f"TemperResult({replicas} replicas of {cells} cells, {len(self.energies) - 1} sweeps, {told})"


def temper(
    positions: PositionsLike,
    model: Model,
    temperatures: ArrayLike,
    sweeps: int = 100,
    seed: int = 0,
    resolution: Resolution | str = "draft",
    algorithm: str = "mh",
    callback: Callback | None = None,
) -> TemperResult:
    """Sample a tissue at several temperatures at once by parallel tempering (replica exchange).

    Each replica samples the Boltzmann distribution exp(-E / T) at its temperature. After every span of up to ten
    sweeps, replicas at adjacent temperatures exchange their tissues with probability min(1, exp((1/T_i - 1/T_j) (E_i -
    E_j))), alternating even and odd pairs (Swendsen and Wang, Phys. Rev. Lett. 57, 2607, 1986), so that cold replicas
    can escape from local minima. To minimize the energy, use `relax`; for a single temperature or a cooling schedule,
    use `anneal`.

    On a `Tube` all replicas run in one compiled program. The same arguments give the same result bit for bit. A
    progress bar is shown on a terminal.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2], used as the initial
            state of every replica, or one initial state per replica, shape [replicas, n, 2]. On other domains
            coordinates [n, 2] or unit vectors [n, 3].
        model: Energy model; see `tube_model`.
        temperatures: Temperature T of each replica, in energy units, at least two positive values in increasing order,
            shape [replicas]. For a reasonable exchange rate, space temperatures geometrically with ratio about 1 + 2 /
            sqrt(n).
        sweeps: Number of sweeps of each replica. Defaults to 100.
        seed: Seed of moves and exchanges, 0 to 2^32 - 1. Defaults to 0.
        resolution: "draft" (the default), "standard" or "fine", or a `Resolution`.
        algorithm: "mh" (the default), one move at a time in random order, or "is-mh", in which independent moves are
            decided together. "is-mh" is faster for more than about 50 cells, but samples exp(-E / T) only
            approximately, because the partition into independent sets depends on the tissue at the start of each span.
        callback: Function `callback(records, positions)` called after each sweep, with a list of one `SweepRecord` per
            replica and the positions of shape [replicas, n, 2] (or [replicas, n, d]), both in order of temperature. A
            true return value ends the run. Defaults to None.

    Returns:
        Record with fields `temperatures` (shape [replicas]), `positions` (shape [replicas, n, 2]), `energies` and
        `origins` (shape [sweeps + 1, replicas]) and `swaps` (acceptance rate of exchanges between adjacent
        temperatures, shape [replicas - 1]). `origins[k, i]` is the initial replica whose tissue is at temperature i
        after sweep k.

    Raises:
        ValueError: If a position, the temperatures, `sweeps`, `seed`, `algorithm` or the energy are invalid.

    >>> import jaxtissue as jt
    >>> model = jt.tube_model(jt.Tube(length=12, apical_radius=1, basal_radius=3), 2)
    >>> temper([[3.0, 0.0], [9.0, 0.0]], model, [2.0, 1.0])
    Traceback (most recent call last):
    ValueError: temperatures=[2.0, 1.0] is invalid; give at least two, above 0 and increasing
    """
    heat = np.atleast_1d(np.asarray(temperatures, float))
    if heat.ndim > 1 or len(heat) < 2 or not (np.isfinite(heat).all() and heat[0] > 0 and (np.diff(heat) > 0).all()):
        raise ValueError(f"temperatures={temperatures} is invalid; give at least two, above 0 and increasing")
    if sweeps < 0 or not 0 <= seed < 2**32:
        raise ValueError(f"sweeps={sweeps}, seed={seed}: give at least 0 sweeps, and a seed from 0 to 2^32 - 1")
    given: Any = positions
    starts = list(given) if np.ndim(given) == 3 else [given] * len(heat)
    if len(starts) != len(heat):
        raise ValueError(
            f"{len(starts)} initial tissues for {len(heat)} temperatures; give one, or one per temperature"
        )
    plans = zip(np.random.SeedSequence(seed).generate_state(len(heat)).tolist(), heat, strict=True)
    runs = [Annealer(model, resolution, algorithm, number, np.full(sweeps, value)) for number, value in plans]
    states = [run.start(start) for run, start in zip(runs, starts, strict=True)]
    ladder = _Ladder(runs, states, heat, seed)
    energies, origins = [[record.energy for record in record_together(runs, states)]], [ladder.origin.copy()]
    positions, ended = np.stack([state.positions for state in states]), False
    with tqdm(total=sweeps, desc="tempering", unit="sweep", disable=None) as bar:
        while len(energies) <= sweeps and not ended:
            if len(energies) > 1:
                ladder.exchange(energies[-1])
            for records, positions in ladder.advance():
                energies.append([record.energy for record in records])
                origins.append(ladder.origin.copy())
                bar.update()
                ended = callback is not None and bool(callback(records, positions))
                if ended:
                    break
    swaps = ladder.accepted / np.maximum(ladder.tried, 1)
    return TemperResult(heat, positions, np.array(energies), np.stack(origins), swaps)


def exchange_chance(energies: Sequence[float] | np.ndarray, temperatures: Sequence[float] | np.ndarray) -> float:
    """The probability that two replicas exchange their tissues, min(1, exp((1/T_i - 1/T_j) (E_i - E_j))).

    >>> exchange_chance([3.0, 2.0], [1.0, 2.0]), round(exchange_chance([2.0, 3.0], [1.0, 2.0]), 4)
    (1.0, 0.6065)
    """
    gain = (1 / temperatures[0] - 1 / temperatures[1]) * (energies[0] - energies[1])
    return math.exp(min(0.0, gain))


class _Ladder:
    """Replicas from low to high temperature, with the tissues that stand at each."""

    def __init__(
        self, runs: list[Annealer], states: list[AnnealState], temperatures: Float[np.ndarray, "replicas"], seed: int
    ) -> None:
        self._runs, self._states, self._temperatures, self._seed = runs, states, temperatures, seed
        self._turn = 0
        self.origin = np.arange(len(runs))
        self.tried, self.accepted = np.zeros((2, len(runs) - 1), int)

    def advance(self) -> Iterator[tuple[list[SweepRecord], Float[np.ndarray, "replicas n d"]]]:
        """Play a span of sweeps of all replicas: the records and positions after each sweep."""
        advances = advance_together(self._runs, self._states)
        self._states = [state for state, _, _ in advances]
        for k in range(len(advances[0][1])):
            yield [records[k] for _, records, _ in advances], np.stack([trail[k] for _, _, trail in advances])

    def exchange(self, energies: Sequence[float]) -> None:
        """Exchange tissues of given energies between even places and the next, or the next time between odd ones."""
        lots = np.random.default_rng([self._seed, self._states[0].sweep, 2]).random(len(self.tried))
        for low in range(self._turn % min(2, len(self.tried)), len(self.tried), 2):
            pair = [low, low + 1]
            self.tried[low] += 1
            if lots[low] < exchange_chance(*([table[k] for k in pair] for table in (energies, self._temperatures))):
                self.accepted[low] += 1
                for column in (self._states, self.origin):
                    column[low], column[low + 1] = column[low + 1], column[low]
                first, second = (self._runs[k] for k in pair)
                first._last, second._last = second._last, first._last
        self._turn += 1
