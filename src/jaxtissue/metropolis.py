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
    FAR,
    CellGeometry,
    Posts,
    Survey,
    measure_cells,
    posts,
    see_lines,
    see_rivals,
    survey,
)
from jaxtissue.energy import Model
from jaxtissue.lines import Lines

ITEMS = 64  # changed cells measured at once


class Neighborhoods(NamedTuple):
    """Who may bound whom, as in `candidates.Candidates`; fixed during a sweep."""

    around: Int[Array | np.ndarray, "n candidates"]
    sides: Int[Array | np.ndarray, "n 2 side_candidates"]


class TissueState(NamedTuple):
    """Backbones and what is known of their cells: sizes, and the reaches a move must undercut to matter."""

    place: Posts
    volume: Float[Array, "n"]
    lateral_area: Float[Array, "n"]
    reach: Float[Array, "n lines*2"]


class SweepInfo(NamedTuple):
    """What happened in a sweep; `energy_change` sums the accepted local energy differences."""

    accepted: Int[Array, ""]
    collisions: Int[Array, ""]
    left_cell: Int[Array, ""]
    rounds: Int[Array, ""]
    energy_change: Float[Array, ""]
    overflow: Bool[Array, ""]


class Changes(NamedTuple):
    """The cells a round's moves would change, packed: whose move, which cell, new sizes and reaches."""

    move: Int[Array, "items"]
    cell: Int[Array, "items"]
    total: Int[Array, ""]
    volume: Float[Array, "items"]
    lateral_area: Float[Array, "items"]
    reach: Float[Array, "items lines*2"]
    overflow: Bool[Array, "items"]


def tissue_state(
    positions: Float[Array, "n 2"], model: Model, near: Neighborhoods, lines: Lines
) -> tuple[TissueState, Survey]:
    """Measure a whole tissue afresh."""
    cells, seen = measure_cells(positions, model.tube, lines, near.sides)
    reach = jnp.moveaxis(seen.reach, -1, 0).reshape(len(positions), -1)
    return TissueState(posts(positions), cells.volume, cells.lateral_area, reach), seen


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
        changed = find_changed(movers, state, proposed, near, model, lines)
        collides = find_collisions(changed, movers, near)
        changes = measure_changes(changed & ~collides[:, None], movers, state, proposed, near, (model, lines))
        difference = local_differences(changes, state, model, len(movers))
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
            info.overflow | changes.overflow.any(),
        )
        return number + 1, deferred, apply(changes, accept, movers, proposed, state), info

    zero = jnp.zeros((), jnp.int32)
    nothing = SweepInfo(zero, zero, zero, zero, jnp.zeros((), chance.dtype), jnp.zeros((), bool))
    start = (zero, jnp.zeros(len(chance), bool), state, nothing)
    _, _, state, info = jax.lax.while_loop(unplayed, play, start)
    return state, info


def pick(place: Posts, which: Array) -> Posts:
    """The backbones of the given numbers."""
    return Posts(*(column[which] for column in place))


def find_changed(
    movers: Array, state: TissueState, proposed: Posts, near: Neighborhoods, model: Model, lines: Lines
) -> Bool[Array, "width candidates+1"]:
    """Which of a mover's candidates its move may change, and (last) itself.

    A cell changes where the mover stops it now, or would stop it short of its present reach. The first test
    has a tolerance: a cell more is measured for nothing, a cell less would be a stale one.
    """
    cells = near.around[movers]
    width, candidates = cells.shape
    own = pick(state.place, cells.ravel())
    reach = jnp.moveaxis(state.reach[cells.ravel()].reshape(width * candidates, -1, 2), 0, -1)
    grid = see_lines(lines, model.tube, reach.dtype)
    slack = 1e-5 * (model.tube.length + jnp.abs(reach))

    def undercuts(mover: Posts, slack: Array | float) -> Array:
        rival = Posts(*(jnp.repeat(column, candidates)[None, None] for column in mover))
        rivals, limit = see_rivals(own, rival, jnp.ones((1, 2, width * candidates), bool), model.tube)
        half, cosine, sine = (table[0] for table in rivals)
        z, y = grid.z * cosine + grid.y * sine, grid.y * cosine - grid.z * sine
        foot = jnp.maximum(z, model.tube.apical_radius)
        meets = half + (y * y + (foot - z) ** 2 - grid.square) * jnp.where(half < FAR, 0.25 / half, 0)
        return (meets <= reach + slack).any(axis=(0, 1)) | (limit.min(axis=0) < np.pi * (1 - 1e-6))

    touched = undercuts(pick(state.place, movers), slack) | undercuts(pick(proposed, movers), 0.0)
    changed = touched.reshape(width, candidates) & (cells != movers[:, None])
    return jnp.concatenate([changed, jnp.ones((width, 1), bool)], axis=1) & (movers >= 0)[:, None]


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
    size = -(-changed.size // ITEMS) * ITEMS
    (item,) = jnp.nonzero(changed.ravel(), size=size, fill_value=0)
    move, cell = item // changed.shape[1], members(movers, near).ravel()[item]
    count = changed.sum(dtype=jnp.int32)
    blank = jnp.zeros(size, state.volume.dtype)
    start = Changes(
        move, cell, count, blank, blank, jnp.zeros((size, state.reach.shape[1]), blank.dtype), blank > 0
    )

    def block(number: Array, done: Changes) -> Changes:
        at = number * ITEMS
        which = jax.lax.dynamic_slice_in_dim(cell, at, ITEMS)
        mover = movers[jax.lax.dynamic_slice_in_dim(move, at, ITEMS)]
        rivals = near.sides[which].transpose(2, 1, 0)

        def moved(index: Array) -> Posts:
            return jax.tree.map(
                lambda old, new: jnp.where(index == mover, new[mover], old[index]), state.place, proposed
            )

        cells, seen = survey(moved(which), moved(rivals), rivals != which, model.tube, lines)
        reach = jnp.moveaxis(seen.reach, -1, 0).reshape(ITEMS, -1)
        found = (cells.volume, cells.lateral_area, reach, seen.overflow)
        return done._replace(
            **{
                name: jax.lax.dynamic_update_slice_in_dim(getattr(done, name), value, at, 0)
                for name, value in zip(("volume", "lateral_area", "reach", "overflow"), found, strict=True)
            }
        )

    return jax.lax.fori_loop(0, -(-count // ITEMS), block, start)


def local_differences(
    changes: Changes, state: TissueState, model: Model, width: int
) -> Float[Array, "width"]:
    """Energy difference of each move: the sum over the cells it changes."""
    new = model.cell_energy(CellGeometry(changes.volume, changes.lateral_area), model)
    old = model.cell_energy(CellGeometry(state.volume[changes.cell], state.lateral_area[changes.cell]), model)
    real = jnp.arange(len(new)) < changes.total
    return jax.ops.segment_sum(jnp.where(real, new - old, 0), changes.move, width)


def apply(changes: Changes, accept: Array, movers: Array, proposed: Posts, state: TissueState) -> TissueState:
    """The state after the accepted moves."""
    n = len(state.volume)
    kept = accept[changes.move] & (jnp.arange(len(changes.cell)) < changes.total)
    cell, mover = jnp.where(kept, changes.cell, n), jnp.where(accept, movers, n)
    return TissueState(
        jax.tree.map(lambda old, new: old.at[mover].set(new[movers], mode="drop"), state.place, proposed),
        state.volume.at[cell].set(changes.volume, mode="drop"),
        state.lateral_area.at[cell].set(changes.lateral_area, mode="drop"),
        state.reach.at[cell].set(changes.reach, mode="drop"),
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
