"""Moves: one sweep of Metropolis-Hastings over independent sets (paper, section 3.3, IS-MH).

Classical MH is the same sweep with one move a round. A move's draws depend on seed, sweep and cell alone, so
both take the same decisions when they visit the cells in the same order.
"""

import warnings
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import SCATTER, take_rows
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.dynamics.local_updates import (
    Scene,
    TissueState,
    apply,
    count_left,
    drop_unchanged,
    find_changed,
    find_collisions,
    gather_round,
    local_differences,
    measure_changes,
    update_capacity,
)
from jaxtissue.dynamics.surface_moves import longest_move
from jaxtissue.energy import Model
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import BackboneCoords, backbone_coords

COARSE = 0.02  # of the longest move
State = TypeVar("State")
Scratch = TypeVar("Scratch")


class SweepInfo(NamedTuple):
    """Counts of one sweep, all scalars (paper, section 3.3).

    Attributes:
        accepted: Number of accepted moves.
        collisions: Number of moves deferred to an additional round of the same sweep, because they affect a cell
            already affected by an earlier move in the same round.
        left_cell: Number of proposals that would move the apical end of a backbone outside its current cell.
        rounds: Number of rounds, including the additional ones.
        energy_change: Sum of the energy differences of the accepted moves.
    """

    accepted: Int[Array, ""]
    collisions: Int[Array, ""]
    left_cell: Int[Array, ""]
    rounds: Int[Array, ""]
    energy_change: Float[Array, ""]


class Order(NamedTuple):
    """The rounds of a sweep: the movers of each, padded with -1, and the number of rounds that are played.

    The moves of a round may change at most `update_capacity` cells together, as the function of that name gives, or
    gave before the lists were padded.
    """

    rounds: Int[Array | np.ndarray, "rounds width"]
    played: Int[Array | np.ndarray, ""]
    update_capacity: Int[Array | np.ndarray, ""]


def draw(seed: int, sweep: int, cells: int, dtype: np.dtype, kinds: int = 3) -> Float[np.ndarray, "kinds n"]:
    """Random numbers, uniform in [0, 1), for every cell in a sweep: distance, direction and acceptance of its move.

    A fourth tells which node of its backbone moves, if it has several. They are drawn on the host: a generator would
    be a seventh of what is compiled for sweeps.
    """
    return np.random.default_rng([seed, sweep, 1]).random((kinds, cells), dtype)


def propose(draws: Float[Array, "2 n"], place: BackboneCoords, model: Model) -> BackboneCoords:
    """A move for every cell, uniform in a disc on the apical surface, reflected at the ends (paper, section 4.3).

    The radius of the disc is 0.25 sqrt(A / pi), A the mean apical area per cell. Both ends of the backbone move
    together.
    """
    bound, (share, turn) = move_bound(model, len(place.axial)), draws
    distance, direction = bound * jnp.sqrt(share), 2 * np.pi * turn
    axial = place.axial + distance * jnp.cos(direction)
    angle = place.angle + distance * jnp.sin(direction) / model.tube.apical_radius
    return backbone_coords(model.tube.reflect(jnp.stack([axial, angle], axis=-1)))


def move_bound(model: Model, cells: int) -> float | np.floating | Float[Array, ""]:
    """Longest move on the apical surface, 0.25 sqrt(A / (pi n)), on a tube 0.25 sqrt(2 R_a L / n)."""
    if not isinstance(model.domain, Tube):
        return longest_move(model.domain, cells)
    return 0.25 * (2 * model.tube.apical_radius * model.tube.length / cells) ** 0.5


def warn_of_coarse_places(model: Model, cells: int, dtype: np.dtype) -> None:
    """Warn where axial positions are so far apart in this precision that moves are rounded by COARSE or more.

    Backbones are then rounded by a fourth of that fraction of their mean distance on the apical surface.
    """
    apart, longest = float(np.spacing(dtype.type(model.tube.length))), float(move_bound(model, cells))
    if apart > COARSE * longest:
        told = f"axial positions in {dtype} have steps of {apart:.2g}, too coarse for backbones {4 * longest:.2g} apart"
        warnings.warn(f"{told}; use 64 bits (--x64 or jax_enable_x64)", stacklevel=4)


class Proposals(NamedTuple):
    """The moves of a sweep, one for each cell: the new place, the number drawn for acceptance, and the temperature."""

    place: BackboneCoords
    chance: Float[Array, "n"]
    temperature: Float[Array, ""]


class Outcome(NamedTuple):
    """The outcome of the moves of one round; `left_cell` is a count, the others are one value for each move."""

    accepted: Bool[Array, "width"]
    collides: Bool[Array, "width"]
    put_off: Bool[Array, "width"]
    difference: Float[Array, "width"]
    left_cell: Int[Array, ""]


@usual_modes()
def sweep(
    draws: Float[Array, "3 n"], state: TissueState, scene: Scene, temperature: Float[Array, ""], order: Order
) -> tuple[TissueState, SweepInfo]:
    """Play one move for every cell, as drawn, round by round: propose, find the changed cells, measure them, decide.

    A move that would change a cell which an earlier move of its round changes too is put off to the rounds at the end;
    so are moves that change more cells than there is room for.
    """
    proposals = Proposals(propose(draws[:2], state.place, scene.model), draws[2], temperature)

    def play(movers: Array, state: TissueState, reach: Array) -> tuple[TissueState, Outcome, Array]:
        return play_round(movers, state, proposals, scene, order, reach)

    reach = jnp.zeros((update_capacity(order.rounds.shape[1], scene.near), *state.reach.shape[1:]), draws.dtype)
    state, info, _ = play_rounds(play, state, order, reach, draws)
    return state, info


def play_rounds(
    play_round: Callable[[Array, State, Scratch], tuple[State, Outcome, Scratch]],
    state: State,
    order: Order,
    scratch: Scratch,
    draws: Float[Array, "3 n"],
) -> tuple[State, SweepInfo, Scratch]:
    """Play the rounds of a sweep, and then, in further rounds, the moves that were put off."""
    rounds, count, cells, dtype = order.rounds, order.played, draws.shape[1], draws.dtype

    def unplayed(carry: tuple) -> Array:
        number, deferred = carry[0], carry[1]
        return (number < count) | deferred.any()

    def play(carry: tuple) -> tuple:
        number, deferred, state, info, scratch = carry
        planned = number < count
        # of those put off the first collides with none, so that there are fewer every time
        movers = jax.lax.cond(
            planned,
            lambda: rounds[jnp.minimum(number, len(rounds) - 1)],
            lambda: jnp.nonzero(deferred, size=rounds.shape[1], fill_value=-1)[0].astype(rounds.dtype),
        )
        deferred = deferred.at[jnp.where(planned | (movers < 0), cells, movers)].set(False, **SCATTER)
        state, outcome, scratch = play_round(movers, state, scratch)
        deferred = deferred.at[jnp.where(outcome.put_off, movers, cells)].set(True, **SCATTER)
        info = SweepInfo(
            info.accepted + outcome.accepted.sum(dtype=jnp.int32),
            info.collisions + (outcome.collides & planned).sum(dtype=jnp.int32),
            info.left_cell + outcome.left_cell,
            info.rounds + 1,
            info.energy_change + jnp.where(outcome.accepted, outcome.difference, 0).sum(),
        )
        return number + 1, deferred, state, info, scratch

    zero = jnp.zeros((), jnp.int32)
    nothing = SweepInfo(zero, zero, zero, zero, jnp.zeros((), dtype))
    start = (zero, jnp.zeros(cells, bool), state, nothing, scratch)
    _, _, state, info, scratch = jax.lax.while_loop(unplayed, play, start)
    return state, info, scratch


def play_round(
    movers: Int[Array, "width"],
    state: TissueState,
    proposals: Proposals,
    scene: Scene,
    order: Order,
    reach: Float[Array, "room 2 row"],
) -> tuple[TissueState, Outcome, Float[Array, "room 2 row"]]:
    """The state after the moves of one round, all decided at once, their outcome, and `reach` as used."""
    place, chance, temperature = proposals
    moves = gather_round(movers, state.place, place, scene.near)
    touched, perhaps = find_changed(moves, state, scene)
    collides = find_collisions(touched, moves.members, len(chance))
    measured = (touched | perhaps) & ~collides[:, None]
    crowded = jnp.cumsum(measured.sum(axis=1)) > order.update_capacity
    measured &= ~crowded[:, None]
    changes = measure_changes(measured, moves, state, place, scene, reach)
    real = drop_unchanged(changes, touched, state, scene.model)
    changed = jnp.zeros(touched.size, bool).at[changes.item].max(real, **SCATTER).reshape(touched.shape)
    collides |= find_collisions(changed, moves.members, len(chance))
    put_off = collides | (crowded & (movers >= 0))
    difference = local_differences(changes, real, state, scene.model, len(movers))
    weight = jnp.exp(-jnp.maximum(difference, 0) / jnp.maximum(temperature, jnp.finfo(chance.dtype).tiny))
    accepted = (movers >= 0) & ~put_off & (take_rows(chance, movers) < weight)
    moved = jnp.where(accepted, movers, len(chance))
    after = apply(changes, real & take_rows(accepted, changes.move), moved, place, state)
    outcome = Outcome(accepted, collides, put_off, difference, count_left(moves, scene.model.tube))
    return after, outcome, changes.reach
