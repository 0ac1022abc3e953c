"""Sampling by the gradient: Langevin moves of the whole tissue, accepted or rejected by its energy (MALA)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, check_energy, check_numbers, in_precision
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import Resolution
from jaxtissue.minimization.lbfgs import Point
from jaxtissue.minimization.placed_energy import PlacedEnergy
from jaxtissue.minimization.tube_energy import TubeEnergy

FIRST = 0.05  # mean cell widths: the length of moves at first
WANTED = 0.574  # acceptance rate at which such moves forget fastest (Roberts and Rosenthal 1998)
LONGEST = 2.0  # drift of one coordinate at most, in lengths of moves


@dataclass(frozen=True, eq=False)
class LangevinResult:
    """Result of Langevin sampling.

    Attributes:
        positions: Positions after the last move, shape [n, 2].
        energies: Energy after each move, shape [moves].
        acceptance: Fraction of the moves that were accepted.
        step: Standard deviation of each coordinate in a move, in length units.
    """

    positions: Float[np.ndarray, "n 2"]
    energies: Float[np.ndarray, " moves"]
    acceptance: float
    step: float

    def __repr__(self) -> str:
        told = f"{len(self.energies)} moves of length {self.step:.3g}, {self.acceptance:.0%} accepted"
        return f"LangevinResult({len(self.positions)} cells, {told})"


@usual_modes()
def sample_langevin(
    positions: Any,
    model: Model,
    temperature: float,
    moves: int = 1000,
    warmup: int = 200,
    step: float | None = None,
    seed: int = 0,
    resolution: Resolution | str = "draft",
    callback: Callable[[float, Float[np.ndarray, "n 2"]], Any] | None = None,
) -> LangevinResult:
    """Sample a tissue in a `Tube` by the Metropolis-adjusted Langevin algorithm (MALA).

    All backbones move at once, x' = x - s^2 / (2 T) dE/dx + s N(0, 1), with the drift of each coordinate cut off at 2
    s. A move is accepted with probability min(1, exp(-(E' - E) / T) q(x' to x) / q(x to x')), with the density q of
    moves, and rejected if it leaves the tube. Energies are measured on complete neighbor lists, so the Boltzmann
    distribution exp(-E / T) is sampled exactly, as by "mh" (Roberts and Tweedie, Bernoulli 2, 341, 1996). Use `anneal`
    for cooling, and `temper` if the tissue must escape from minima.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        model: Energy model of a `Tube`; see `tube_model`.
        temperature: T, in energy units, greater than 0.
        moves: Number of moves after the warm-up. Defaults to 1000.
        warmup: Number of moves before, in which `step` is adjusted to accept 57 % of the moves. Defaults to 200; 0
            keeps `step`.
        step: s, in length units on the surface midway between apical and basal, greater than 0. Defaults to None: 0.05
            mean cell widths.
        seed: Seed of the moves, 0 to 2^32 - 1. Defaults to 0.
        resolution: "draft" (the default), "standard" or "fine", or a `Resolution`.
        callback: Function `callback(energy, positions)` called after each move that follows the warm-up. A true return
            value ends the run. Defaults to None.

    Returns:
        Record with fields `positions` (shape [n, 2]), `energies` (shape [moves]), `acceptance` and `step`.

    Raises:
        ValueError: If a position or the energy is invalid, if the domain is not a `Tube`, or if `temperature`, `step`,
            `moves` or `warmup` is out of range.

    >>> from jaxtissue.energy import tube_model
    >>> sample_langevin([[1.0, 0.0]], tube_model(Tube(2, 1, 2), 1), temperature=0.0)
    Traceback (most recent call last):
    ValueError: temperature=0.0, step=None: give numbers above 0
    """
    if not (math.isfinite(temperature) and temperature > 0) or not (step is None or 0 < step < math.inf):
        raise ValueError(f"temperature={temperature}, step={step}: give numbers above 0")
    if moves < 0 or warmup < 0:
        raise ValueError(f"moves={moves}, warmup={warmup}: give at least 0")
    if not isinstance(model.domain, Tube):
        raise ValueError(f"Langevin moves of a {type(model.domain).__name__} are not supported; use anneal or temper")
    start = np.asarray(as_positions(positions, model.tube))
    check_numbers(model, len(start))
    check_energy(model)
    energy = TubeEnergy(in_precision(model, start.dtype), len(start), resolution)
    most = float(model.tube.length)
    chain = Chain(energy, start * energy.units, temperature, step or FIRST * energy.width, seed, (0.0, most))
    if not np.isfinite(chain.here.energy):
        raise ValueError("the energy is not finite at the start; move apart backbones that coincide")
    energies: list[float] = []
    with tqdm(total=warmup + moves, desc="sampling", unit="move", disable=None) as bar:
        for k in range(warmup + moves):
            if k < warmup:
                chain.adjust(k)
                bar.update()
                continue
            chain.move()
            energies.append(chain.here.energy)
            bar.update()
            if callback is not None and callback(energies[-1], energy.positions(chain.here.place)):
                break
    share = chain.accepted / max(len(energies), 1)
    return LangevinResult(energy.positions(chain.here.place), np.array(energies), share, chain.step)


class Chain:
    """A tissue that moves by Langevin moves.

    Args:
        energy: Its energy and gradient.
        place: Where it begins, in lengths, [n, d].
        temperature: T.
        step: The standard deviation of each coordinate in a move.
        seed: Of the moves.
        limits: Of the first coordinate of each backbone: beyond them there is no tissue.
    """

    def __init__(
        self,
        energy: PlacedEnergy,
        place: np.ndarray,
        temperature: float,
        step: float,
        seed: int,
        limits: tuple[float, float],
    ) -> None:
        self.energy, self.temperature, self.step, self.limits = energy, temperature, step, limits
        self.here, self.accepted = energy.renewed(place), 0
        self._rng = np.random.default_rng(seed)

    def adjust(self, count: int) -> None:
        """Move, and make moves longer or shorter, by less and less as the count of such moves rises."""
        chance = self.move()
        self.step *= math.exp((chance - WANTED) / (1 + count) ** 0.6)
        self.accepted = 0

    def move(self) -> float:
        """Propose a move and decide it; returns its probability."""
        noise, lot = self._rng.normal(size=self.here.place.shape), self._rng.random()
        place = self.here.place + self.drift(self.here) + self.step * noise
        low, high = self.limits
        if (place[:, 0] < low).any() or (place[:, 0] > high).any():
            return 0.0
        there = self.energy.renewed(place)
        chance = math.exp(min(0.0, self.log_ratio(self.here, there)))
        if lot < chance:
            self.here, self.accepted = there, self.accepted + 1
        return chance

    def drift(self, here: Point) -> np.ndarray:
        """The mean of moves: down the gradient, by no more than some lengths of moves."""
        fall = -(self.step**2) / (2 * self.temperature) * here.gradient
        return np.clip(fall, -LONGEST * self.step, LONGEST * self.step)

    def log_ratio(self, here: Point, there: Point) -> float:
        """The logarithm of exp(-(E' - E) / T) q(x' to x) / q(x to x')."""
        if not np.isfinite(there.energy):
            return -math.inf
        way = there.place - here.place
        ahead, back = ((off**2).sum() for off in (way - self.drift(here), -way - self.drift(there)))
        return float((here.energy - there.energy) / self.temperature + (ahead - back) / (2 * self.step**2))
