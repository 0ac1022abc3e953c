"""The cells, measured: volume, lateral area, surfaces and perimeters from exact intervals along x.

On a line of constant radius r and angle t the squared distance to backbone j is (x - x_j)^2 + f_j, with
f_j = y^2 + (s - z)^2, z = r cos(t - t_j), y = r sin(t - t_j), s = max(z, R_a) the radius of the foot. So a
cell is one interval on each line; seen from x_i it ends where the nearest rival takes over, at a *reach* of
h = |x_j - x_i| / 2 + (f_j - f_i) / (2 |x_j - x_i|) ahead (x_j > x_i) and behind, two mirrored sides. Between
two lines each side is taken as the two tangents of the walls h(t), whose slope and tilt are closed forms.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxtissue.lines import Lines
from jaxtissue.tube import Tube

LEVEL = 1e-4  # a wall this close to parallel to the axis is taken as exactly radial
T = TypeVar("T")
END, NONE = -1, -2
FAR = 1e30  # beyond any tube, and finite: its lowest bits may be changed
BLOCK = 128  # cells measured at once: what fits the processor's cache


class CellGeometry(eqx.Module):
    """Sizes of each cell; those on the two surfaces only where the lines include the surfaces."""

    volume: Float[Array, "cells"]
    lateral_area: Float[Array, "cells"]
    apical_area: Float[Array, "cells"] | None = None
    basal_area: Float[Array, "cells"] | None = None
    apical_perimeter: Float[Array, "cells"] | None = None
    basal_perimeter: Float[Array, "cells"] | None = None
    touches_end: Bool[Array, "cells"] | None = None


class Survey(NamedTuple):
    """What measuring some cells tells beside their sizes."""

    reach: Float[Array, "lines 2 cells"]  # behind and ahead; -inf on lines that do not bear on the cell
    by: Int[Array, "lines 2 cells"]  # the candidate that stops the cell there; END the tube; NONE none bears
    limit: Float[Array, "2 cells"]  # angles within which level rivals keep the cell, else at least pi
    overflow: Bool[Array, "cells"]  # the cell reaches the edge of its window of lines


class Posts(NamedTuple):
    """Backbones as their axial place, angle, and its cosine and sine, all of one shape."""

    axial: Array
    angle: Array
    cosine: Array
    sine: Array


class Grid(NamedTuple):
    """Lines as seen from a backbone: z, y, own foot s and squared distance f, each [lines, 1, 1 or cells]."""

    radius: Array
    z: Array
    y: Array
    foot: Array
    square: Array


class Rivals(NamedTuple):
    """Each cell against its candidates behind and ahead, [candidates, 2, cells]; half is FAR for no rival."""

    half: Array  # |x_j - x_i| / 2
    cosine: Array  # of t_j - t_i
    sine: Array


class Walls(NamedTuple):
    """The walls that end each cell on each line, behind and ahead, [lines, 2, cells]."""

    reach: Array
    slope: Array  # dh/dt
    area: Array  # wall area per r dr dt; 0 at the tube's end
    edge: Array  # wall length on the layer per r dt


def settled(compute: Callable[[], T], truth: Array) -> T:
    """Compute, behind a branch that is always taken, which XLA's fusion can't cross.

    Else the CPU compiler repeats a stage inside every consumer of the next: 2.5 times slower as measured.
    `truth` is true, but not known to the compiler.
    """
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(compute))
    return jax.lax.cond(truth, compute, lambda: empty)


def posts(positions: Float[Array | np.ndarray, "... 2"]) -> Posts:
    """The backbones at (axial, angle) positions."""
    angle = positions[..., 1]
    return Posts(jnp.asarray(positions[..., 0]), jnp.asarray(angle), jnp.cos(angle), jnp.sin(angle))


def see_lines(lines: Lines, tube: Tube, dtype: np.dtype) -> Grid:
    """The lines round each backbone."""
    radius = lines.radii(tube)[0].astype(dtype)[lines.layer][:, None, None]
    return see_angles(radius, jnp.asarray(lines.offset, dtype)[:, None, None], tube)


def see_angles(radius: Array, offset: Array, tube: Tube) -> Grid:
    """Lines at the given radii and angles from the backbones."""
    z, y = radius * jnp.cos(offset), radius * jnp.sin(offset)
    foot = jnp.maximum(z, tube.apical_radius)
    return Grid(radius, z, y, foot, y * y + (foot - z) ** 2)


def see_rivals(own: Posts, others: Posts, real: Array, tube: Tube) -> tuple[Rivals, Array]:
    """The rivals on either side, and how far in angle level rivals let each cell extend, [2, cells].

    A rival is level if its wall would be parallel to the axis: then the wall is the radial plane half way.
    """
    ahead = (others.axial - own.axial) * jnp.array([-1.0, 1.0], own.axial.dtype)[:, None]
    cosine = others.cosine * own.cosine + others.sine * own.sine
    sine = others.sine * own.cosine - others.cosine * own.sine
    level = real & (ahead**2 <= (LEVEL * tube.apical_radius) ** 2 * (sine**2 + (1 - cosine) ** 2))
    half = jnp.where(real & ~level & (ahead > 0), ahead / 2, FAR)
    turn = others.angle - own.angle
    turn = jnp.where(turn < 0, turn + 2 * np.pi, turn)
    limit = jnp.stack([jnp.where(level, 2 * np.pi - turn, 2 * np.pi), jnp.where(level, turn, 2 * np.pi)])
    return Rivals(half, cosine, sine), limit.min(axis=(1, 2)) / 2


def stop(grid: Grid, rivals: Rivals, ends: Array, tube: Tube, truth: Array) -> tuple[Array, Rivals]:
    """Who stops each cell on each line, behind and ahead, and that rival, [lines, 2, cells]; END: the tube.

    The candidate's number rides in the lowest bits of its reach, so that one minimum finds both (two outputs
    would each repeat the loop). That blurs the choice, not the reach, by about 1e-5.
    """
    candidates, _, cells = rivals.half.shape
    bits = max(candidates - 1, 1).bit_length()
    integer = jnp.int64 if rivals.half.dtype == jnp.float64 else jnp.int32
    recast = jax.lax.bitcast_convert_type

    def least_reach() -> Array:
        line = jax.tree.map(lambda a: a[:, None], grid)
        z = line.z * rivals.cosine + line.y * rivals.sine
        y = line.y * rivals.cosine - line.z * rivals.sine
        foot = jnp.maximum(z, tube.apical_radius)
        slant = jnp.where(rivals.half < FAR, 0.25 / rivals.half, 0)
        reach = rivals.half + (y * y + (foot - z) ** 2 - line.square) * slant
        number = jnp.arange(candidates, dtype=integer)[:, None, None]
        return recast((recast(reach, integer) & (-1 << bits)) | number, reach.dtype).min(axis=1)

    least = settled(least_reach, truth)
    winner = (recast(least, integer) & ((1 << bits) - 1)).astype(jnp.int32)
    # one gather of rows: three gathers along the candidates cost 2.5 times as much
    rows = jnp.stack(rivals, axis=-1).reshape(-1, len(rivals))
    facing = rows[winner * 2 * cells + jnp.arange(2 * cells).reshape(2, cells)]
    return jnp.where(least < ends, winner, END), Rivals(*jnp.moveaxis(facing, -1, 0))


def walls(by: Array, rival: Rivals, ends: Array, grid: Grid, tube: Tube) -> Walls:
    """Reach, slope and tilt of the walls that end each cell, against the rival there."""
    half, cosine, sine = rival
    z, y = grid.z * cosine + grid.y * sine, grid.y * cosine - grid.z * sine
    foot = jnp.maximum(z, tube.apical_radius)
    per_gap = jnp.where(by == END, 0, 0.5 / half)
    reach = half + (y * y + (foot - z) ** 2 - grid.square) * per_gap / 2
    slope = (foot * y - grid.foot * grid.y) * per_gap
    tilt = (foot * z - grid.foot * grid.z) * per_gap
    wall = (by != END).astype(half.dtype)
    area = wall * jnp.sqrt(1 + (slope**2 + tilt**2) / grid.radius**2)
    edge = wall * jnp.sqrt(1 + slope**2 / grid.radius**2)
    return Walls(jnp.where(by == END, ends, reach), slope, area, edge)


def strips(wall: Walls, ends: Array, limit: Array, lines: Lines) -> tuple[Array, Array, Array, Array]:
    """Between each line and the next, per cell: layer area / r, wall area per r dr, wall length per r, and
    the length of radial walls of level rivals."""
    dtype = wall.reach.dtype
    step = jnp.asarray(lines.step, dtype)[:-1, None]
    offset = jnp.asarray(lines.offset, dtype)[:-1, None]
    per_step = jnp.where(step > 0, 1 / jnp.where(step > 0, step, 1), 0)
    low = jnp.clip((-limit[0] - offset) * per_step, 0, 1)
    high = jnp.clip((limit[1] - offset) * per_step, 0, 1)
    before, after = (jax.tree.map(lambda a, c=cut: a[c], wall) for cut in (slice(None, -1), slice(1, None)))
    rise, next_rise = before.slope * step[:, None], after.slope * step[:, None]
    turn = rise - next_rise
    meeting = (after.reach - next_rise - before.reach) / jnp.where(turn == 0, 1, turn)
    bend = jnp.where(turn == 0, 0.5, jnp.clip(meeting, 0, 1))

    def both(sides: Array) -> Array:
        return sides[:, 0] + sides[:, 1]

    def width(at: Array, left: Array) -> Array:
        from_left, from_right = before.reach + rise * at, after.reach - next_rise * (1 - at)
        return both(jnp.minimum(jnp.where(left, from_left, from_right), ends))

    first_bend, last_bend = jnp.minimum(bend[:, 0], bend[:, 1]), jnp.maximum(bend[:, 0], bend[:, 1])
    # two lines outside the cell can only show a phantom of it: every piece holds its backbone's line
    live = jnp.where((both(before.reach) > 0) | (both(after.reach) > 0), step, 0)
    cuts = [jnp.clip(cut, low, high) for cut in (0.0, first_bend, last_bend, 1.0)]
    lefts = (jnp.ones_like(bend, bool), bend >= last_bend[:, None], jnp.zeros_like(bend, bool))
    layer_area = wall_area = wall_length = jnp.zeros_like(low)
    for start, end, left in zip(cuts[:-1], cuts[1:], lefts, strict=True):
        first, last = width(start[:, None], left), width(end[:, None], left)
        filled = jnp.maximum(first, 0) + jnp.maximum(last, 0)
        spread = jnp.abs(first) + jnp.abs(last)
        inside = (end - start) * live * filled / jnp.where(spread > 0, spread, 1)
        layer_area += inside * filled / 2
        wall_area += inside * both(jnp.where(left, before.area, after.area))
        wall_length += inside * both(jnp.where(left, before.edge, after.edge))
    # each end of the limit falls in one strip, half open, even where it falls on a line
    following = jnp.asarray(lines.offset, dtype)[1:, None]
    starts = (limit[0] < np.pi) & (offset <= -limit[0]) & (-limit[0] < following) & (live > 0)
    stops = (limit[1] < np.pi) & (offset <= limit[1]) & (limit[1] < following) & (live > 0)
    radial = jnp.where(starts, jnp.maximum(width(low[:, None], low[:, None] < bend), 0), 0)
    radial += jnp.where(stops, jnp.maximum(width(high[:, None], high[:, None] < bend), 0), 0)
    return layer_area, wall_area, wall_length, radial


def survey(
    own: Posts, others: Posts, real: Bool[Array, "candidates 2 cells"], tube: Tube, lines: Lines
) -> tuple[CellGeometry, Survey]:
    """Measure the cells of the backbones `own`, [cells], among their candidates, [candidates, 2, cells]."""
    dtype = own.axial.dtype
    radius, weight = (table.astype(dtype)[:, None] for table in lines.radii(tube))
    radius, weight = radius[lines.layer[:-1]], weight[lines.layer[:-1]]
    ends = jnp.stack([own.axial, tube.length - own.axial])
    grid = see_lines(lines, tube, dtype)
    truth = own.axial[0] > -1
    rivals, limit = settled(lambda: see_rivals(own, others, real, tube), truth)
    by, rival = settled(lambda: stop(grid, rivals, ends, tube, truth), truth)
    wall = settled(lambda: walls(by, rival, ends, grid, tube), truth)
    layer_area, wall_area, wall_length, radial = strips(wall, ends, limit, lines)
    layer_area, wall_area = layer_area * radius, wall_area * radius + radial
    surfaces = [None] * 4
    if lines.surfaces:
        on = [jnp.asarray(lines.layer[:-1] == lines.inner_layers + k)[:, None] for k in (0, 1)]
        length = wall_length * radius + radial
        surfaces = [jnp.where(at, size, 0).sum(axis=0) for size in (layer_area, length) for at in on]
    inside = wall.reach[:, 0] + wall.reach[:, 1] > 0
    strip = jnp.pad((inside[1:] | inside[:-1]) & (lines.step[:-1, None] > 0), ((1, 1), (0, 0)))
    bears = (strip[1:] | strip[:-1])[:, None]
    at_end = (by == END) & inside[:, None]
    volume, lateral_area = ((size * weight).sum(axis=0) for size in (layer_area, wall_area))
    cells = CellGeometry(volume, lateral_area, *surfaces, touches_end=at_end.any(axis=(0, 1)))
    overflow = (bears[:, 0] & jnp.asarray(lines.edge)[:, None]).any(axis=0)
    return cells, Survey(jnp.where(bears, wall.reach, -jnp.inf), jnp.where(bears, by, NONE), limit, overflow)


def measure_cells(
    positions: Float[Array, "n 2"],
    tube: Tube,
    lines: Lines,
    neighbors: Int[Array | np.ndarray, "n 2 candidates"],
    cells: Int[Array, "cells"] | None = None,
) -> tuple[CellGeometry, Survey]:
    """Measure all cells, or the given ones, against their candidate neighbors behind and ahead.

    Lists are padded with the cell itself. Pure: `jit` it with `lines` static, `vmap` it over replicas;
    positions and the tube's sizes are traced. V_i = integral of the interval's length over r dr dt, A_i =
    integral of the walls' tilt; the errors of the presets stand in `lines`. Paper, section 3.1.
    """
    cells = jnp.arange(len(positions), dtype=jnp.int32) if cells is None else cells
    blocks = -(-len(cells) // BLOCK)
    width = -(-len(cells) // blocks)
    table = posts(positions)

    def block(members: Array) -> tuple[CellGeometry, Survey]:
        rivals = neighbors[members].transpose(2, 1, 0)
        own, others = (Posts(*(column[which] for column in table)) for which in (members, rivals))
        return survey(own, others, rivals != members, tube, lines)

    padded = jnp.pad(cells, (0, blocks * width - len(cells)), mode="edge").reshape(blocks, width)
    measured = jax.lax.map(block, padded)
    return jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], -1)[..., : len(cells)], measured
    )
