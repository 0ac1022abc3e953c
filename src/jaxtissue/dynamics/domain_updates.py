"""The changes of a round of moves on any domain: which cells change, their new sizes, and the energy differences.

A move changes the cells of which the mover is a side before it or after it, as `sections.influence` says. These are
measured anew, each as if its one move were made.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.compilation.fusion import SCATTER, take_rows
from jaxtissue.dynamics.domain_places import Place, at, centers, copied, segments, with_moved
from jaxtissue.dynamics.local_updates import pack, update_capacity
from jaxtissue.energy import Model, cell_energies
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.vectors import dot
from jaxtissue.measurement.cell_geometry import CellGeometry
from jaxtissue.sections.cells import Layers
from jaxtissue.sections.half_planes import take
from jaxtissue.sections.influence import Trace, sides, trace_of, would_be_side
from jaxtissue.sections.polygons import Polygons, Rule, find_polygons
from jaxtissue.sections.sizes import Sections, measure_polygons
from jaxtissue.sections.views import View, look

BLOCK = 32  # cells measured together: more would often be empty


class Surroundings(NamedTuple):
    """The cells that may bound each other during a sweep, by their numbers in the crowd, see `sections.crowd`."""

    rivals: Int[Array | np.ndarray, "n q"]  # -1 where there are no more
    around: Int[Array | np.ndarray, "n around"]  # cells on whose list the cell is; itself where there are no more
    slots: Int[Array | np.ndarray, "n around"]  # where on their list
    first: Int[Array | np.ndarray, "n around"]  # the first column with the same cell: copies may be on one list


class Scene(eqx.Module):
    """The data that stay the same during a sweep."""

    model: Model
    near: Surroundings
    layers: Layers
    longest: Float[Array | np.ndarray, ""]  # move
    rule: Rule = eqx.field(static=True)

    @property
    def domain(self) -> Domain:
        """The tissue's domain."""
        return self.model.domain  # type: ignore[return-value]


class Cells(NamedTuple):
    """What is known of measured cells; all tables have the cells first."""

    sizes: CellGeometry  # those that the energy may read
    sides: Bool[Array, "n q"]
    trace: Trace
    spare: Int[Array, "n"]  # edges that found no slot; 0 or less where all did


class TissueState(NamedTuple):
    """Backbones and cells. Places go on beyond periods and turns, as lists hold copies by their numbers."""

    place: Place
    cells: Cells


class Round(NamedTuple):
    """The moves of one round: the movers, and the cells around them with (last) themselves."""

    movers: Int[Array, "width"]  # padded with -1
    members: Int[Array, "width around+1"]


class Changes(NamedTuple):
    """The cells that a round's moves would change, packed: their move, their numbers, and the cells anew."""

    move: Int[Array, "items"]
    cell: Int[Array, "items"]
    is_item: Bool[Array, "items"]
    cells: Cells


def find(own: Place, rivals: Place, is_there: Bool[Array, "q cells"], scene: Scene) -> tuple[View, Polygons]:
    """The view of cells at places [cells] with rivals at places [q, cells], and their polygons, pass by pass."""
    domain, heights = scene.domain, heights_for(own, scene)
    middle = centers(domain, own, heights)
    view = look(domain, middle, heights, segments(domain, own), segments(domain, rivals), is_there)
    return view, find_polygons(domain, view, scene.rule)


def heights_for(place: Place, scene: Scene) -> Float[Array, " layers"]:
    """The heights of the layers, in the precision of places."""
    return jnp.asarray(scene.layers.heights, jax.tree.leaves(place)[0].dtype)


def measure(
    view: View, polygons: Polygons, scene: Scene, numbers: Int[Array, "cells"], rivals: Int[Array, "q cells"]
) -> tuple[Cells, Sections]:
    """The sizes of cells by their polygons, with the numbers of the cells and of their rivals."""
    last = jax.tree.map(lambda table: table[-1], polygons.passes)
    sections = measure_polygons(scene.domain, view, scene.rule, last)
    wall, weights = sections.wall, jnp.asarray(scene.layers.weights, sections.wall.dtype)[0]
    if scene.model.adhesion is not None:
        worth = scene.model.adhesion.between(numbers, rivals)[:, None]
        wall = wall * take(worth, jnp.minimum(sections.line, len(rivals) - 1))
    surfaces = [*sections.area[-2:], *sections.length.sum(axis=0)[-2:]]
    sizes = CellGeometry(weights @ sections.volume, weights @ wall.sum(axis=0), *surfaces * scene.model.has_surfaces)
    trace = jax.tree.map(lambda table: jnp.moveaxis(table, -1, 0), trace_of(polygons))
    spare = polygons.passes.spare.max(axis=(0, 1))
    return Cells(sizes, sides(polygons, len(rivals)).T, trace, spare), sections


def gather_round(movers: Int[Array, "width"], near: Surroundings) -> Round:
    """The moves of one round."""
    return Round(movers, jnp.concatenate([take_rows(near.around, movers), movers[:, None]], axis=1))


def find_changed(
    moves: Round, state: TissueState, proposed: Place, scene: Scene
) -> tuple[Bool[Array, "width around+1"], Int[Array, ""]]:
    """Which of the cells around a mover, and (last) the mover itself, its move changes; how many leave their cell."""
    domain, near, (n, q) = scene.domain, scene.near, state.cells.sides.shape
    cells, slots = moves.members[:, :-1], take_rows(near.slots, moves.movers)
    cell, entry = cells.ravel(), (cells * q + slots).ravel()
    copy = take_rows(jnp.asarray(near.rivals).ravel(), entry) // n
    mover = jnp.broadcast_to(moves.movers[:, None], cells.shape).ravel()
    old, new = (segments(domain, copied(domain, at(place, mover), copy)) for place in (state.place, proposed))
    place, heights = at(state.place, cell), heights_for(state.place, scene)
    middle, own, there = centers(domain, place, heights), segments(domain, place), jnp.ones((1, len(cell)), bool)
    view = look(domain, middle, heights, own, jax.tree.map(lambda part: part[None], new), there)
    trace = jax.tree.map(lambda table: jnp.moveaxis(take_rows(table, cell), 0, -1), state.cells.trace)
    touched = take_rows(state.cells.sides.ravel(), entry) | would_be_side(domain, view, trace)
    is_move = (moves.movers >= 0)[:, None]
    real = (cells != moves.movers[:, None]) & is_move
    row = jnp.arange(len(cells))[:, None]
    touched = (
        jnp.zeros_like(real)
        .at[row, take_rows(near.first, moves.movers)]
        .max(touched.reshape(cells.shape) & real, **SCATTER)
    )
    before = jax.tree.map(lambda part: part[None], old).on_layers()
    nearer, stays = view.own.offset(view.rivals.apical), before.offset(view.rivals.apical)
    left = (dot(nearer, nearer) < dot(stays, stays)).reshape(cells.shape) & real
    return jnp.concatenate([touched, is_move], axis=1), left.any(axis=1).sum(dtype=jnp.int32)


def measure_changes(
    changed: Bool[Array, "width around+1"], moves: Round, state: TissueState, proposed: Place, scene: Scene
) -> Changes:
    """Measure every changed cell as if its one move were made, in as many blocks as it takes."""
    domain, near, n = scene.domain, scene.near, len(state.cells.spare)
    size = update_capacity(len(moves.movers), near)
    block = min(BLOCK, size)
    size = -(-size // block) * block
    item, total = pack(changed, jnp.zeros_like(changed), size), changed.sum(dtype=jnp.int32)
    move, cell = item // changed.shape[1], take_rows(moves.members.ravel(), item)
    mover = take_rows(moves.movers, move)
    blank = jax.tree.map(lambda table: jnp.zeros((size, *table.shape[1:]), table.dtype), state.cells)

    def some(carry: tuple[Array, Cells]) -> tuple[Array, Cells]:
        begin, done = carry
        which, its_mover = (jax.lax.dynamic_slice_in_dim(table, begin, block) for table in (cell, mover))
        to, rivals = at(proposed, its_mover), take_rows(near.rivals, which).T
        numbers = jnp.where(rivals < 0, which, rivals % n)

        def moved(number: Array) -> Place:
            return with_moved(at(state.place, number), to, number == its_mover)

        others = copied(domain, moved(numbers), jnp.maximum(rivals, 0) // n)
        view, polygons = find(moved(which), others, rivals >= 0, scene)
        found = measure(view, polygons, scene, which, numbers)[0]
        done = jax.tree.map(
            lambda table, part: jax.lax.dynamic_update_slice_in_dim(table, part, begin, axis=0), done, found
        )
        return begin + block, done

    zero = jnp.zeros((), jnp.int32)
    _, found = jax.lax.while_loop(lambda carry: carry[0] < total, some, (zero, blank))
    return Changes(move, cell, jnp.arange(size) < total, found)


def local_differences(changes: Changes, state: TissueState, model: Model, width: int) -> Float[Array, "width"]:
    """Energy difference of each move: the sum over the cells it changes."""
    model = model.of(changes.cell)
    new = cell_energies(changes.cells.sizes, model)
    old = cell_energies(jax.tree.map(lambda size: take_rows(size, changes.cell), state.cells.sizes), model)
    return jnp.zeros(width, new.dtype).at[changes.move].add(jnp.where(changes.is_item, new - old, 0), **SCATTER)


def apply(
    changes: Changes, accepted: Bool[Array, "items"], movers: Int[Array, "width"], proposed: Place, state: TissueState
) -> TissueState:
    """The state after the accepted moves, with the changes that belong to them."""
    cell = jnp.where(accepted, changes.cell, len(state.cells.spare))

    def moved(old: Array, new: Array) -> Array:
        return old.at[movers].set(take_rows(new, movers), **SCATTER)

    cells = jax.tree.map(lambda old, new: old.at[cell].set(new, **SCATTER), state.cells, changes.cells)
    return TissueState(jax.tree.map(moved, state.place, proposed), cells)
