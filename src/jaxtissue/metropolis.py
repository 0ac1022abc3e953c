"""Moves: one sweep of Metropolis-Hastings over independent sets (paper, section 3.3, IS-MH).

Classical MH is the same sweep with one move a round. A move's draws depend on the sweep's key and its cell
alone, so both take the same decisions when they visit the cells in the same order.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxtissue.cells import (
    LEVEL,
    CellGeometry,
    Posts,
    Rivals,
    Survey,
    measure_window,
    meeting,
    note_onward,
    posts,
    see_lines,
    through_windows,
)
from jaxtissue.energy import Model
from jaxtissue.lines import Lines

ITEMS = 72  # changed cells measured at once, 8 times an odd number as in `cells`


class Neighborhoods(NamedTuple):
    """Who may bound whom, padded with the cell itself; fixed during a sweep."""

    around: Int[Array | np.ndarray, "n around"]  # all who have the cell among their candidates, or it has
    sides: Int[Array | np.ndarray, "n 2 candidates"]  # candidates behind and ahead


class TissueState(NamedTuple):
    """Backbones and what is known of their cells: sizes, and the reaches a move must undercut to matter."""

    place: Posts
    volume: Float[Array, "n"]
    lateral_area: Float[Array, "n"]
    reach: Float[Array, "n 2 lines"]  # in the middle window
    wide: Bool[Array, "n"]  # the cell goes on beyond it


class SweepInfo(NamedTuple):
    """What happened in a sweep; `energy_change` sums the accepted local energy differences."""

    accepted: Int[Array, ""]
    collisions: Int[Array, ""]
    left_cell: Int[Array, ""]
    rounds: Int[Array, ""]
    energy_change: Float[Array, ""]


class Changes(NamedTuple):
    """The cells a round's moves would change, packed: whose move, which cell, and what they become."""

    item: Int[Array, "items"]  # place in the table of movers and cells around them
    move: Int[Array, "items"]
    cell: Int[Array, "items"]
    total: Int[Array, ""]
    volume: Float[Array, "items"]
    lateral_area: Float[Array, "items"]
    reach: Float[Array, "items 2 lines"]
    wide: Bool[Array, "items"]
    onward: Bool[Array, "items 2"]


def tissue_state(positions: Float[Array, "n 2"], seen: Survey) -> TissueState:
    """The state of a tissue that was measured."""
    sizes = seen.sizes
    return TissueState(posts(positions), sizes.volume, sizes.lateral_area, seen.reach, seen.wide)


def propose(key: PRNGKeyArray, place: Posts, model: Model) -> Posts:
    """A move for every cell: uniform in an apical disc of radius 0.25 sqrt(A / pi), A the mean apical area
    per cell (paper, section 4.3), reflected at the tube's ends. Both ends of the backbone move together."""
    n, dtype = len(place.axial), place.axial.dtype
    bound = move_bound(model, n)
    share, turn = jax.random.uniform(key, (2, n), dtype)
    distance, direction = bound * jnp.sqrt(share), 2 * np.pi * turn
    axial = place.axial + distance * jnp.cos(direction)
    angle = place.angle + distance * jnp.sin(direction) / model.tube.apical_radius
    return posts(model.tube.reflect(jnp.stack([axial, angle], axis=-1)))


def move_bound(model: Model, cells: int) -> Float[Array, ""]:
    """Longest move on the apical surface, 0.25 sqrt(2 R_a L / n)."""
    return 0.25 * jnp.sqrt(2 * model.tube.apical_radius * model.tube.length / cells)


def sweep(
    key: PRNGKeyArray,
    state: TissueState,
    model: Model,
    temperature: Float[Array, ""],
    near: Neighborhoods,
    rounds: Int[Array, "rounds width"],
    count: Int[Array, ""],
    lines: Lines,
) -> tuple[TissueState, SweepInfo]:
    """One move for every cell, round by round: propose, find what changes, measure it, decide.

    Only the first `count` of the (padded) `rounds` are played. A move that would change a cell which another
    move of its round changes too is put off and played in a round of its own at the end.
    """
    move_key, accept_key = jax.random.split(key)
    proposed = propose(move_key, state.place, model)
    chance = jax.random.uniform(accept_key, state.volume.shape, state.volume.dtype)
    alone = jnp.full(rounds.shape[1], -1, rounds.dtype)

    def unplayed(carry: tuple) -> Array:
        number, deferred = carry[0], carry[1]
        return (number < count) | deferred.any()

    def play(carry: tuple) -> tuple:
        number, deferred, state, info = carry
        planned = number < count
        next_alone = jnp.argmax(deferred).astype(rounds.dtype)
        movers = jnp.where(planned, rounds[jnp.minimum(number, len(rounds) - 1)], alone.at[0].set(next_alone))
        deferred = deferred.at[next_alone].set(deferred[next_alone] & planned)
        touched, perhaps = find_changed(movers, state, proposed, near, (model, lines))
        collides = find_collisions(touched, movers, near)
        measured = (touched | perhaps) & ~collides[:, None]
        changes = measure_changes(measured, movers, state, proposed, near, (model, lines))
        real = drop_unchanged(changes, touched, state, model)
        changed = jnp.zeros(touched.size, bool).at[changes.item].max(real).reshape(touched.shape)
        collides |= find_collisions(changed, movers, near)
        difference = local_differences(changes, real, state, model, len(movers))
        weight = jnp.exp(-jnp.maximum(difference, 0) / jnp.maximum(temperature, jnp.finfo(chance.dtype).tiny))
        accept = (movers >= 0) & ~collides & (chance[movers] < weight)
        n = len(chance)
        deferred = deferred.at[jnp.where(collides, movers, n)].set(True, mode="drop")
        info = SweepInfo(
            info.accepted + accept.sum(dtype=jnp.int32),
            info.collisions + collides.sum(dtype=jnp.int32),
            info.left_cell + count_left(movers, state.place, proposed, near, model),
            info.rounds + 1,
            info.energy_change + jnp.where(accept, difference, 0).sum(),
        )
        return (
            number + 1,
            deferred,
            apply(changes, real & accept[changes.move], jnp.where(accept, movers, n), proposed, state),
            info,
        )

    zero = jnp.zeros((), jnp.int32)
    nothing = SweepInfo(zero, zero, zero, zero, jnp.zeros((), chance.dtype))
    start = (zero, jnp.zeros(len(chance), bool), state, nothing)
    _, _, state, info = jax.lax.while_loop(unplayed, play, start)
    return state, info


def pick(place: Posts, which: Array) -> Posts:
    """The backbones of the given numbers."""
    return Posts(*(column[which] for column in place))


def find_changed(
    movers: Array, state: TissueState, proposed: Posts, near: Neighborhoods, rules: tuple[Model, Lines]
) -> tuple[Bool[Array, "width around+1"], Bool[Array, "width around+1"]]:
    """Which of the cells around a mover, and (last) itself, its move changes, and which else it might.

    A cell changes where the mover stops it now, or would stop it short of its present reach. The first test
    has a tolerance: a cell more is measured for nothing, a cell less would be a stale one. Of a cell that goes
    on beyond its middle window that is not known.
    """
    model, lines = rules
    cells = near.around[movers]
    pairs = cells.ravel()
    own, reach = pick(state.place, pairs[:, None]), state.reach[pairs]
    grid = jax.tree.map(lambda table: table[:, 0], see_lines(lines, model.tube, reach.dtype))
    facing = jnp.where(reach > -jnp.inf, reach + 1e-5 * (model.tube.length + jnp.abs(reach)), reach)

    def undercuts(mover: Posts, facing: Array) -> Array:
        mover = Posts(*(jnp.repeat(column, cells.shape[1])[:, None] for column in mover))
        gap, cosine = mover.axial - own.axial, mover.cosine * own.cosine + mover.sine * own.sine
        sine = mover.sine * own.cosine - mover.cosine * own.sine
        level = LEVEL * model.tube.apical_radius * jnp.sqrt(sine**2 + (1 - cosine) ** 2)
        half = jnp.maximum(jnp.maximum(jnp.abs(gap), level), 1e-30) / 2
        meets = meeting(grid, Rivals(half, 0.25 / half, cosine, sine), model.tube)
        # one that is level may change sides
        both = jnp.abs(gap) <= level
        behind, ahead = facing[:, 0], facing[:, 1]
        return meets <= jnp.where(both, jnp.maximum(behind, ahead), jnp.where(gap > 0, ahead, behind))

    touched = undercuts(pick(state.place, movers), facing) | undercuts(pick(proposed, movers), reach)
    touched = (jnp.where(touched, 1.0, 0.0).max(axis=1) > 0).reshape(cells.shape)
    real = (cells != movers[:, None]) & (movers >= 0)[:, None]
    own = (movers >= 0)[:, None]
    perhaps = real & ~touched & state.wide[cells]
    return tuple(jnp.concatenate(pair, axis=1) for pair in ((real & touched, own), (perhaps, own & False)))


def members(movers: Array, near: Neighborhoods) -> Int[Array, "width candidates+1"]:
    """A mover's candidates, and (last) itself."""
    return jnp.concatenate([near.around[movers], movers[:, None]], axis=1)


def find_collisions(changed: Array, movers: Array, near: Neighborhoods) -> Bool[Array, "width"]:
    """Moves that would change a cell which an earlier move of the round changes too."""
    n, width = len(near.around), len(movers)
    order = jnp.arange(width)[:, None]
    cells = members(movers, near)
    first = (
        jnp.full(n, width)
        .at[jnp.where(changed, cells, n)]
        .min(jnp.broadcast_to(order, cells.shape), mode="drop")
    )
    return (changed & (first[cells] < order)).any(axis=1)


def measure_changes(
    changed: Array,
    movers: Array,
    state: TissueState,
    proposed: Posts,
    near: Neighborhoods,
    rules: tuple[Model, Lines],
) -> Changes:
    """Measure every changed cell as if its one move were made, in as many blocks as it takes."""
    model, lines = rules
    size = changed.size
    item = jnp.minimum(jax.lax.sort(jnp.where(changed.ravel(), jnp.arange(size), size)), size - 1)
    move, cell = item // changed.shape[1], members(movers, near).ravel()[item]
    total = changed.sum(dtype=jnp.int32)
    blank = jnp.zeros(size, state.volume.dtype)
    reach = jnp.zeros((size, *state.reach.shape[1:]), blank.dtype)
    start = Changes(item, move, cell, total, blank, blank, reach, blank > 0, jnp.zeros((size, 2), bool))

    def measure(items: Array, shift: Array, done: Changes) -> Changes:
        mover, which = movers[move[items]], cell[items]
        rivals = near.sides[which].transpose(2, 1, 0)

        def moved(index: Array) -> Posts:
            return jax.tree.map(
                lambda old, new: jnp.where(index == mover, new[mover], old[index]), state.place, proposed
            )

        window = measure_window(moved(which), moved(rivals), rivals < which, model.tube, lines, shift)
        onward = note_onward(items, shift, window, done.onward)
        at = jnp.where(shift == 0, items, size)
        return done._replace(
            volume=done.volume.at[items].add(window.sizes.volume, mode="drop"),
            lateral_area=done.lateral_area.at[items].add(window.sizes.lateral_area, mode="drop"),
            reach=done.reach.at[at].set(jnp.moveaxis(window.reach, -1, 0).swapaxes(1, 2), mode="drop"),
            wide=done.wide.at[at].set(window.onward.any(axis=0), mode="drop"),
            onward=onward,
        )

    return through_windows(measure, total, size, ITEMS, start)


def drop_unchanged(
    changes: Changes, touched: Bool[Array, "width around+1"], state: TissueState, model: Model
) -> Bool[Array, "items"]:
    """Which of the cells measured their move changes: those touched, and of the others those that differ."""
    tiny = 1000 * jnp.finfo(state.volume.dtype).eps * model.mean_volume
    differs = jnp.abs(changes.volume - state.volume[changes.cell]) > tiny
    differs |= jnp.abs(changes.lateral_area - state.lateral_area[changes.cell]) > tiny
    return (touched.ravel()[changes.item] | differs) & (jnp.arange(len(changes.item)) < changes.total)


def local_differences(
    changes: Changes, real: Bool[Array, "items"], state: TissueState, model: Model, width: int
) -> Float[Array, "width"]:
    """Energy difference of each move: the sum over the cells it changes."""
    new = model.cell_energy(CellGeometry(changes.volume, changes.lateral_area), model)
    old = model.cell_energy(CellGeometry(state.volume[changes.cell], state.lateral_area[changes.cell]), model)
    own = changes.move == jnp.arange(width)[:, None]
    return jnp.where(own & real, new - old, 0).sum(axis=1)


def apply(
    changes: Changes, accepted: Bool[Array, "items"], movers: Array, proposed: Posts, state: TissueState
) -> TissueState:
    """The state after the accepted moves, with the changes that belong to them."""
    n = len(state.volume)
    cell = jnp.where(accepted, changes.cell, n)
    return TissueState(
        jax.tree.map(lambda old, new: old.at[movers].set(new[movers], mode="drop"), state.place, proposed),
        state.volume.at[cell].set(changes.volume, mode="drop"),
        state.lateral_area.at[cell].set(changes.lateral_area, mode="drop"),
        state.reach.at[cell].set(changes.reach, mode="drop"),
        state.wide.at[cell].set(changes.wide, mode="drop"),
    )


def count_left(
    movers: Array, place: Posts, proposed: Posts, near: Neighborhoods, model: Model
) -> Int[Array, ""]:
    """Moves whose apical end lands in another cell (the paper would not propose them)."""
    cells = members(movers, near)
    to, posts_around = pick(proposed, movers), pick(place, cells)
    cosine = posts_around.cosine * to.cosine[:, None] + posts_around.sine * to.sine[:, None]
    square = (posts_around.axial - to.axial[:, None]) ** 2 + 2 * model.tube.apical_radius**2 * (1 - cosine)
    left = square[:, :-1].min(axis=1) < square[:, -1]
    return (left & (movers >= 0)).sum(dtype=jnp.int32)
