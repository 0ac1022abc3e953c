"""The changes of a round of moves: the cells that change, their new sizes, the energy differences, and collisions."""

from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import SCATTER, fusion_barrier, take_rows
from jaxtissue.compilation.modes import usual_modes
from jaxtissue.energy import Model, cell_energies
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.axial_lines import (
    LEVEL,
    BackboneCoords,
    RelativeCoords,
    backbone_coords,
    crossing,
    lines_in_frame,
    pick,
    turn_between,
)
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.measurement.cells import BLOCK, Survey, measure_window, through_windows
from jaxtissue.measurement.quadrature import Lines

ROOM = 20  # cells that a move may change, on average over a round: twice as many as it does
SLACK = 1e-5  # of a reach and of R_b, by which a wall may miss a cell and counts as bounding it


class Neighborhoods(NamedTuple):
    """The cells that may bound each other, padded with the cell itself; fixed during a sweep."""

    around: Int[Array | np.ndarray, "n around"]  # cells that list the cell as a candidate, or that it lists
    sides: Int[Array | np.ndarray, "n 2 candidates"]  # candidates behind and ahead


class Scene(NamedTuple):
    """The data that stay the same during a sweep: energy model, cells that may bound each other, and lines."""

    model: Model
    near: Neighborhoods
    lines: Lines


class TissueState(NamedTuple):
    """Backbones and the sizes of their cells, with the reaches that a move must undercut to matter."""

    place: BackboneCoords
    sizes: CellGeometry  # those that the energy may read
    reach: Float[Array, "n 2 row"]  # in the middle window
    wide: Bool[Array, "n"]  # the cell goes on beyond it


class Changes(NamedTuple):
    """The cells that a round's moves would change, packed: the move, the cell, and its new sizes."""

    item: Int[Array, "items"]  # place in the table of movers and cells around them
    move: Int[Array, "items"]
    cell: Int[Array, "items"]
    total: Int[Array, ""]
    sizes: CellGeometry
    reach: Float[Array, "items 2 row"]
    wide: Bool[Array, "items"]


@usual_modes()
def tissue_state(positions: Float[Array, "n 2"], seen: Survey, has_surfaces: bool) -> TissueState:
    """The state of a tissue that was measured."""
    return TissueState(backbone_coords(positions), seen.sizes.of_energy(has_surfaces), seen.reach, seen.wide)


class Round(NamedTuple):
    """The moves of one round: the movers, their places before and after, and the cells around them."""

    movers: Int[Array, "width"]  # padded with -1
    members: Int[Array, "width around+1"]  # the cells around a mover, and (last) itself
    around: BackboneCoords  # the cells around, [width, around]
    before: BackboneCoords  # the movers, [width]
    after: BackboneCoords


def gather_round(movers: Array, place: BackboneCoords, proposed: BackboneCoords, near: Neighborhoods) -> Round:
    """The data of a round's moves, gathered once."""
    truth = movers[0] < len(near.around)
    cells = fusion_barrier(lambda: take_rows(near.around, movers), truth)
    posts_of = fusion_barrier(lambda: (pick(place, cells), pick(place, movers), pick(proposed, movers)), truth)
    return Round(movers, jnp.concatenate([cells, movers[:, None]], axis=1), *posts_of)


def find_changed(
    moves: Round, state: TissueState, scene: Scene
) -> tuple[Bool[Array, "width around+1"], Bool[Array, "width around+1"]]:
    """Find which of the cells around a mover, and (last) the mover itself, its move changes, and which it may change.

    A cell changes where the mover stops it now, or would stop it short of its present reach, with a tolerance: one cell
    too many is measured in vain, one cell too few would be out of date. It is not known of a cell that goes on beyond
    its middle window, nor of one whose wall against the mover is parallel to the axis.
    """
    lines = scene.lines
    tube, cells, own = scene.model.tube, moves.members[:, :-1], moves.around
    reach, spare = take_rows(state.reach, cells.ravel()), (0, lines.row - len(lines.number))
    grid = jax.tree.map(lambda table: jnp.pad(table[:, 0], spare), lines_in_frame(lines, reach.dtype))

    def against(place: BackboneCoords) -> tuple[RelativeCoords, Array, Array]:
        """The movers as rivals of the cells around them, sooner by the tolerance; which are ahead, and which level."""
        mover = jax.tree.map(lambda column: column[:, None], place)
        gap, (versine, sine) = mover.axial - own.axial, turn_between(own, mover)
        floor = LEVEL * tube.apical_radius * jnp.sqrt(2 * versine)
        apart = jnp.maximum(jnp.maximum(jnp.abs(gap), floor), 1e-30)
        rivals = RelativeCoords(apart / 2 - SLACK * tube.basal_radius, 0.5 / apart, versine, sine)
        return rivals, gap > 0, jnp.abs(gap) <= floor

    truth = moves.movers[0] < len(state.wide)
    now, then = (fusion_barrier(lambda at=at: against(at), truth) for at in (moves.before, moves.after))

    def undercuts(rivals: RelativeCoords, is_ahead: Array) -> Array:
        meets = crossing(grid, jax.tree.map(lambda column: column.reshape(-1, 1), rivals), tube)
        is_ahead = is_ahead.reshape(-1, 1)
        return meets - SLACK * jnp.abs(meets) <= jnp.where(is_ahead, reach[:, 1], reach[:, 0])

    touched = (undercuts(*now[:2]) | undercuts(*then[:2])).astype(jnp.int8)
    touched = (touched.max(axis=1) > 0).reshape(cells.shape)
    is_move = (moves.movers >= 0)[:, None]
    real = (cells != moves.movers[:, None]) & is_move
    perhaps = real & ~touched & (take_rows(state.wide, cells) | now[2] | then[2])
    return (
        jnp.concatenate([real & touched, is_move], axis=1),
        jnp.concatenate([perhaps, jnp.zeros_like(is_move)], axis=1),
    )


def count_left(moves: Round, tube: Tube) -> Int[Array, ""]:
    """The number of moves whose apical end lands in another cell (the paper would not propose them)."""

    def square(others: BackboneCoords, to: BackboneCoords) -> Array:
        versine, _ = turn_between(others, to)
        return (to.axial - others.axial) ** 2 + 2 * tube.apical_radius**2 * versine

    nearest = square(moves.around, jax.tree.map(lambda column: column[:, None], moves.after)).min(axis=1)
    left = (nearest < square(moves.before, moves.after)) & (moves.movers >= 0)
    return left.sum(dtype=jnp.int32)


@runtime_checkable
class HasAround(Protocol):
    """Lists of the cells around each cell, [n, around]."""

    @property
    def around(self) -> Array | np.ndarray:
        """The lists."""
        raise NotImplementedError


def update_capacity(width: int, near: HasAround) -> int:
    """The most cells that the moves of a round may change together; at least all cells around one mover."""
    around = near.around.shape[1] + 1
    return min(width * around, max(around, ROOM * width))


def find_collisions(
    changed: Bool[Array, "width around+1"], cells: Int[Array, "width around+1"], n: int
) -> Bool[Array, "width"]:
    """Moves that would change one of the cells, of `n`, which an earlier move of the round changes too."""
    width = len(changed)
    order = jnp.arange(width)[:, None]
    at = jnp.where(changed, cells, n)
    first = jnp.full(n, width).at[at].min(jnp.broadcast_to(order, at.shape), **SCATTER)
    return (changed & (take_rows(first, cells) < order)).any(axis=1)


def pack(chosen: Bool[Array, "..."], early: Bool[Array, "..."], size: int) -> Int[Array, "size"]:
    """The flat places of at most `size` that are chosen, the early ones first.

    Ranks within rows are products with a triangle of ones, of both kinds at once: a third of the time of
    sorting. Stages are `fusion_barrier`, else indices are taken apart by divisions, one by one.
    """
    row = 64  # within which both counts fit into one number
    chosen, early = chosen.ravel(), early.ravel()
    spare = (0, -chosen.size % row)
    kind = fusion_barrier(
        lambda: jnp.pad(jnp.where(chosen, jnp.where(early, 128.0, 1.0), 0.0), spare), chosen[0] <= size
    )
    kind = kind.reshape(-1, row)
    upto = jnp.matmul(kind, jnp.triu(jnp.ones((row, row), kind.dtype)), precision=jax.lax.Precision.HIGHEST)
    last = upto[:, -1].astype(jnp.int32)
    counts = jnp.stack([last // 128, last % 128])
    before = jnp.cumsum(counts, axis=1, dtype=jnp.int32) - counts  # not a product: that would be quadratic in the cells
    before = before.at[1].add(counts[0].sum(dtype=jnp.int32)) - 1

    def ranks() -> Array:
        within = upto.astype(jnp.int32)
        rank = jnp.where(kind > 1, before[0][:, None] + within // 128, before[1][:, None] + within % 128)
        return jnp.where(kind > 0, rank, size)

    places = jnp.arange(kind.size, dtype=jnp.int32)
    return jnp.zeros(size, jnp.int32).at[fusion_barrier(ranks, chosen[0] <= size).ravel()].set(places, **SCATTER)


def measure_changes(
    changed: Array,
    moves: Round,
    state: TissueState,
    proposed: BackboneCoords,
    scene: Scene,
    reach: Array,
) -> Changes:
    """Measure every changed cell as if its one move were made, in as many blocks as it takes.

    The new reaches are written to `reach`, which bounds their number: room used before, as clearing it takes long.
    """
    model, near, lines = scene
    size = len(reach)
    item = pack(changed, take_rows(state.wide, moves.members), size)
    move, cell = item // changed.shape[1], take_rows(moves.members.ravel(), item)
    total = changed.sum(dtype=jnp.int32)
    blank = jax.tree.map(lambda column: jnp.zeros(size, column.dtype), state.sizes)
    start = Changes(item, move, cell, total, blank, reach, jnp.zeros(size, bool))

    def measure(items: Array, shift: Array, done: Changes) -> tuple[Changes, Array]:
        mover, which = take_rows(moves.movers, take_rows(move, items)), take_rows(cell, items)
        rivals, to = take_rows(near.sides, which).transpose(2, 1, 0), pick(proposed, mover)

        def moved(index: Array) -> BackboneCoords:
            here = pick(state.place, index)
            return jax.tree.map(lambda old, new: jnp.where(index == mover, new, old), here, to)

        weights = model.adhesion.between(which, rivals) if model.adhesion is not None else None
        window = measure_window(moved(which), moved(rivals), rivals < which, model.tube, lines, shift, weights)
        at = jnp.where(shift == 0, items, size)
        done = done._replace(
            sizes=jax.tree.map(
                lambda known, more: known.at[items].add(more, **SCATTER),
                done.sizes,
                window.sizes.of_energy(model.has_surfaces),
            ),
            reach=done.reach.at[at].set(window.reaches(lines.row), **SCATTER),
            wide=done.wide.at[at].set(window.onward.any(axis=0), **SCATTER),
        )
        return done, window.onward

    return through_windows(measure, total, size, BLOCK, start)


def drop_unchanged(
    changes: Changes, touched: Bool[Array, "width around+1"], state: TissueState, model: Model
) -> Bool[Array, "items"]:
    """Which measured cells their move changes: the touched ones, and of the others those that differ."""
    tiny = 1000 * jnp.finfo(changes.reach.dtype).eps * model.mean_volume
    differs = jnp.zeros(len(changes.item), bool)
    for new, old in zip(jax.tree.leaves(changes.sizes), jax.tree.leaves(state.sizes), strict=True):
        differs |= jnp.abs(new - take_rows(old, changes.cell)) > tiny
    return (take_rows(touched.ravel(), changes.item) | differs) & (jnp.arange(len(changes.item)) < changes.total)


def local_differences(
    changes: Changes, real: Bool[Array, "items"], state: TissueState, model: Model, width: int
) -> Float[Array, "width"]:
    """Energy difference of each move: the sum over the cells it changes."""
    model = model.of(changes.cell)
    new = cell_energies(changes.sizes, model)
    old = cell_energies(jax.tree.map(lambda size: take_rows(size, changes.cell), state.sizes), model)
    return jnp.zeros(width, new.dtype).at[changes.move].add(jnp.where(real, new - old, 0), **SCATTER)


def apply(
    changes: Changes,
    accepted: Bool[Array, "items"],
    movers: Array,
    proposed: BackboneCoords,
    state: TissueState,
) -> TissueState:
    """The state after the accepted moves, with the changes that belong to them."""
    n = len(state.wide)
    cell = jnp.where(accepted, changes.cell, n)
    return TissueState(
        jax.tree.map(lambda old, new: old.at[movers].set(take_rows(new, movers), **SCATTER), state.place, proposed),
        jax.tree.map(lambda old, new: old.at[cell].set(new, **SCATTER), state.sizes, changes.sizes),
        state.reach.at[cell].set(changes.reach, **SCATTER),
        state.wide.at[cell].set(changes.wide, **SCATTER),
    )
