"""Sweeps on any domain, as `metropolis` on tubes: one sweep, several sweeps on the same lists, and a survey."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import take_rows
from jaxtissue.dynamics.domain_places import Place, as_place, as_rows, at, copied, propose
from jaxtissue.dynamics.domain_updates import (
    Scene,
    TissueState,
    apply,
    find,
    find_changed,
    gather_round,
    local_differences,
    measure,
    measure_changes,
)
from jaxtissue.dynamics.local_updates import find_collisions
from jaxtissue.dynamics.metropolis import Order, Outcome, SweepInfo, play_rounds
from jaxtissue.dynamics.spans import Trail
from jaxtissue.sections.cells import cell_sizes, corner_points
from jaxtissue.sections.influence import clearances


class Proposals(NamedTuple):
    """The moves of a sweep: the new places, the numbers drawn for acceptance, Hastings ratios, and the temperature."""

    place: Place
    chance: Float[Array, "n"]
    log_ratio: Float[Array, "n"]
    temperature: Float[Array, ""]


class Survey(NamedTuple):
    """All cells of a tissue as measured on complete lists, or on lists that are to be proved complete.

    Attributes:
        state: The state of the tissue.
        clear: By how much the line of each candidate misses the cell's corners, [n, q], in mean lengths of sections.
        points: Points on the rims of sections, [p, 3].
        is_point: Which of these there are, [p].
        cells: The cells whose rims they are on, [p].
        is_cut: Whether a section reaches the limit of its chart, [n].
    """

    state: TissueState
    clear: Float[Array, "n q"]
    points: Float[Array, "p 3"]
    is_point: Bool[Array, " p"]
    cells: Int[Array, " p"]
    is_cut: Bool[Array, " n"]


def survey_cells(positions: Float[Array, "n *k d"], scene: Scene) -> Survey:
    """Measure all cells on the lists of the scene."""
    place, rivals = as_place(positions, scene.domain), jnp.asarray(scene.near.rivals).T
    numbers = jnp.arange(len(positions))
    owners, copies = jnp.maximum(rivals, 0) % len(positions), jnp.maximum(rivals, 0) // len(positions)
    others = copied(scene.domain, at(place, owners), copies)
    view, polygons = find(place, others, rivals >= 0, scene)
    cells, sections = measure(view, polygons, scene, numbers, owners)
    unit = jnp.sqrt(sections.area.mean(axis=1, keepdims=True))
    points, is_point = corner_points(sections)
    return Survey(
        TissueState(place, cells),
        clearances(view, polygons, unit).T,
        jnp.stack(points, axis=-1).reshape(-1, 3),
        is_point.ravel(),
        jnp.broadcast_to(numbers, is_point.shape).ravel(),
        cell_sizes(scene.domain, sections, scene.layers, len(rivals)).is_cut,
    )


def sweep(
    draws: Float[Array, "rows n"], state: TissueState, scene: Scene, temperature: Float[Array, ""], order: Order
) -> tuple[TissueState, SweepInfo, Bool[Array, ""]]:
    """Play one move for every cell, as drawn, round by round; also whether a cell had more edges than there are slots.

    As on tubes, a move that would change a cell which an earlier move of its round changes too is put off to the
    rounds at the end.
    """
    place, log_ratio = propose(draws, state.place, scene.domain, jnp.asarray(scene.longest, draws.dtype))
    proposals = Proposals(place, draws[2], log_ratio, temperature)

    def play(movers: Array, state: TissueState, lacks: Array) -> tuple[TissueState, Outcome, Array]:
        return play_round(movers, state, proposals, scene, order, lacks)

    return play_rounds(play, state, order, jnp.zeros((), bool), draws)


def play_round(
    movers: Int[Array, "width"],
    state: TissueState,
    proposals: Proposals,
    scene: Scene,
    order: Order,
    lacks_slots: Bool[Array, ""],
) -> tuple[TissueState, Outcome, Bool[Array, ""]]:
    """The state after the moves of one round, all decided at once, their outcome, and whether slots were lacking."""
    place, chance, log_ratio, temperature = proposals
    moves = gather_round(movers, scene.near)
    touched, left_cell = find_changed(moves, state, place, scene)
    collides = find_collisions(touched, moves.members, len(chance))
    touched &= ~collides[:, None]
    crowded = jnp.cumsum(touched.sum(axis=1)) > order.update_capacity
    changes = measure_changes(touched & ~crowded[:, None], moves, state, place, scene)
    put_off = collides | (crowded & (movers >= 0))
    difference = local_differences(changes, state, scene.model, len(movers))
    heat = jnp.maximum(temperature, jnp.finfo(chance.dtype).tiny)
    weight = jnp.exp(jnp.minimum(take_rows(log_ratio, movers) - difference / heat, 0))
    accepted = (movers >= 0) & ~put_off & (take_rows(chance, movers) < weight)
    moved = jnp.where(accepted, movers, len(chance))
    after = apply(changes, changes.is_item & take_rows(accepted, changes.move), moved, place, state)
    lacks_slots |= (changes.is_item & (changes.cells.spare > 0)).any()
    return after, Outcome(accepted, collides, put_off, difference, left_cell), lacks_slots


def play(
    draws: Float[Array, "sweeps rows n"],
    state: TissueState,
    scene: Scene,
    temperatures: Float[Array, "sweeps"],
    orders: Order,
) -> tuple[Trail, Bool[Array, "sweeps"]]:
    """Play sweeps one after another; a sweep without rounds does nothing."""

    def one(state: TissueState, this: tuple) -> tuple[TissueState, tuple[Trail, Array]]:
        drawn, temperature, order = this
        state, info, lacks_slots = sweep(drawn, state, scene, temperature, order)
        return state, (Trail(state.cells.sizes, as_rows(state.place, scene.domain), info), lacks_slots)

    return jax.lax.scan(one, state, (draws, temperatures, orders))[1]
