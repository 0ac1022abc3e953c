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
from jaxtyping import Array, Bool, Complex, Float, Int

from jaxtissue.lines import Lines
from jaxtissue.tube import Tube

LEVEL = 1e-3  # slope against the axis of the walls that are taken for those still closer to parallel to it
T = TypeVar("T")
Done = TypeVar("Done")
END, NONE = -1, -2
FAR = 1e30  # beyond any tube, and finite: its lowest bits may be changed
BLOCK = 136  # cells measured at once, 8 times an odd number: at 128 the rows of tables evict each other from cache
CHUNK = 24  # candidates compared in one unrolled loop


class CellGeometry(eqx.Module):
    """Sizes of each cell; those on the two surfaces only where the lines include the surfaces."""

    volume: Float[Array, "cells"]
    lateral_area: Float[Array, "cells"]
    apical_area: Float[Array, "cells"] | None = None
    basal_area: Float[Array, "cells"] | None = None
    apical_perimeter: Float[Array, "cells"] | None = None
    basal_perimeter: Float[Array, "cells"] | None = None
    touches_end: Bool[Array, "cells"] | None = None


class Window(NamedTuple):
    """Cells measured within one window of lines."""

    sizes: CellGeometry
    reach: Float[Array, "lines 2 cells"]  # behind and ahead; -inf on lines that do not bear on the cell
    by: Int[Array, "lines 2 cells"]  # the candidate that stops the cell there; END the tube; NONE none bears
    onward: Bool[Array, "2 cells"]  # the cell goes on before the first lines, or after the last


class Posts(NamedTuple):
    """Backbones as their axial place, angle, and its cosine and sine, all of one shape."""

    axial: Array
    angle: Array
    cosine: Array
    sine: Array


class Grid(NamedTuple):
    """Lines as seen from a backbone, [lines, 1 or cells]."""

    radius: Array
    z: Array
    y: Array
    foot: Array  # radius of the own foot s
    square: Array  # squared distance f to it


class Rivals(NamedTuple):
    """Each cell against its candidates behind and ahead, [candidates, 2, cells]; half is FAR for no rival."""

    half: Array  # |x_j - x_i| / 2
    slant: Array  # 1 / (4 half)
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


def larger(first: Array, second: Array | float) -> Array:
    """The larger of two, in one instruction: `jnp.maximum` takes more to treat what is not a number."""
    return jnp.where(first > second, first, second)


def posts(positions: Float[Array | np.ndarray, "... 2"]) -> Posts:
    """The backbones at (axial, angle) positions."""
    angle = positions[..., 1]
    return Posts(jnp.asarray(positions[..., 0]), jnp.asarray(angle), jnp.cos(angle), jnp.sin(angle))


def see_lines(lines: Lines, tube: Tube, dtype: np.dtype, shift: Array | int = 0) -> Grid:
    """The lines round each backbone."""
    radius = lines.radii(tube)[0].astype(dtype)[lines.layer][:, None]
    return see_angles(radius, lines.offset(dtype, shift)[:, None], tube)


def see_angles(radius: Array, offset: Array, tube: Tube) -> Grid:
    """Lines at the given radii and angles from the backbones."""
    z, y = radius * jnp.cos(offset), radius * jnp.sin(offset)
    foot = jnp.maximum(z, tube.apical_radius)
    return Grid(radius, z, y, foot, y * y + (foot - z) ** 2)


def see_others(own: Posts, others: Posts, first: Array, tube: Tube) -> tuple[Rivals, Array]:
    """The others as rivals, whatever side they are on, and whether each lies ahead.

    No wall may be parallel to the axis: of two backbones at the same height the one that is `first` counts as
    lying behind, and all are taken as LEVEL times their distance apart along the axis.
    """
    cosine = others.cosine * own.cosine + others.sine * own.sine
    sine = others.sine * own.cosine - others.cosine * own.sine
    gap = others.axial - own.axial
    # exactly 0 for the cell itself, which pads the lists
    chord = jnp.sqrt((others.cosine - own.cosine) ** 2 + (others.sine - own.sine) ** 2)
    apart = jnp.maximum(jnp.abs(gap), LEVEL * tube.apical_radius * chord)
    half = jnp.where(apart > 0, apart / 2, FAR)
    return Rivals(half, 0.25 / half, cosine, sine), (gap > 0) | ((gap == 0) & ~first)


def see_rivals(own: Posts, others: Posts, first: Array, tube: Tube) -> Rivals:
    """The rivals among the candidates [candidates, 2, cells], FAR if they lie on the other side."""
    rivals, is_ahead = see_others(own, others, first, tube)
    half = jnp.where(is_ahead == jnp.array([False, True])[:, None], rivals.half, FAR)
    return rivals._replace(half=half, slant=0.25 / half)


def meeting(grid: Grid, rival: Rivals, tube: Tube) -> Array:
    """The reach h = |dx| / 2 + (f_j - f_i) / (2 |dx|) against rivals, on lines."""
    z, y = grid.z * rival.cosine + grid.y * rival.sine, grid.y * rival.cosine - grid.z * rival.sine
    inward = larger(tube.apical_radius - z, 0.0)
    return rival.half + (y * y + inward * inward - grid.square) * rival.slant


def stop(grid: Grid, rivals: Rivals, ends: Array, tube: Tube, truth: Array) -> Int[Array, "lines 2 cells"]:
    """Who stops each cell on each line, behind and ahead; END: the tube.

    The candidate's number rides in the lowest bits of its reach, so that one value is carried along (two
    would each repeat the loop). That blurs the choice, not the reach, by about 1e-5.
    """
    candidates, _, cells = rivals.half.shape
    bits = max(candidates - 1, 1).bit_length()
    integer = jnp.int64 if ends.dtype == jnp.float64 else jnp.int32
    recast = jax.lax.bitcast_convert_type
    line = jax.tree.map(lambda table: table[:, None], grid)

    def nearer(least: Array, among: Rivals, first: Array | int) -> Array:
        for number in range(len(among.half)):
            reach = meeting(line, jax.tree.map(lambda table, at=number: table[at], among), tube)
            coded = recast((recast(reach, integer) & (-1 << bits)) | (first + number), ends.dtype)
            least = jnp.where(coded < least, coded, least)
        return least

    start = jnp.broadcast_to(ends, (len(grid.z), 2, cells))
    if candidates <= CHUNK:
        least = settled(lambda: nearer(start, rivals, 0), truth)
    else:
        chunks = -(-candidates // CHUNK)
        spare = ((0, chunks * CHUNK - candidates), (0, 0), (0, 0))
        nobody = Rivals(FAR, 0.0, 0.0, 0.0)
        tables = jax.tree.map(
            lambda table, no: jnp.pad(table, spare, constant_values=no).reshape(chunks, CHUNK, 2, cells),
            rivals,
            nobody,
        )
        first = CHUNK * jnp.arange(chunks, dtype=integer)
        least, _ = jax.lax.scan(lambda least, some: (nearer(least, *some), None), start, (tables, first))
    winner = (recast(least, integer) & ((1 << bits) - 1)).astype(jnp.int32)
    return jnp.where(least < ends, winner, END)


def walls(by: Array, rivals: Rivals, ends: Array, grid: Grid, tube: Tube, truth: Array) -> Walls:
    """Reach, slope and tilt of the walls that end each cell, against the rival there.

    A rival is e^(i turn) / half, one complex number: gathering three real ones takes 3 times as long.
    """
    cells = by.shape[-1]
    rival = (jax.lax.complex(rivals.cosine, rivals.sine) / rivals.half).ravel()
    at = jnp.maximum(by, 0) * (2 * cells) + jnp.arange(2 * cells, dtype=by.dtype).reshape(2, cells)
    facing = settled(lambda: rival.at[at].get(mode="promise_in_bounds"), truth)

    def wall() -> Walls:
        line, end = jax.tree.map(lambda table: table[:, None], grid), by == END
        real, imaginary = jnp.where(end, 1, facing.real), jnp.where(end, 0, facing.imag)
        half = jax.lax.rsqrt(real**2 + imaginary**2)
        cosine, sine = real * half, imaginary * half
        z, y = line.z * cosine + line.y * sine, line.y * cosine - line.z * sine
        foot, per_gap = larger(z, tube.apical_radius), 0.5 / half
        reach = half + (y * y + (foot - z) ** 2 - line.square) * per_gap / 2
        slope = jnp.where(end, 0, (foot * y - line.foot * line.y) * per_gap)
        tilt = (foot * z - line.foot * line.z) * per_gap
        area = jnp.sqrt(1 + (slope**2 + tilt**2) / line.radius**2)
        edge = jnp.sqrt(1 + slope**2 / line.radius**2)
        return Walls(jnp.where(end, ends, reach), slope, *(jnp.where(end, 0, size) for size in (area, edge)))

    return settled(wall, truth)


def strips(wall: Walls, tilt: Array, step: Array) -> Complex[Array, "strips cells"]:
    """Between each line and the next, per cell: layer area / r + i x the integral of the walls' `tilt` / r.

    Each side is the two walls' tangents up to where they meet. So three pieces, from 0 over the two meeting
    points to 1, each with a width linear from end to end: its positive part is integrated. Two lines outside
    the cell could only show a phantom of it and count nothing. One complex number, as two results would each
    repeat the work.
    """
    step = step[:-1, None]
    reach, tilt = (wall.reach[:-1], wall.reach[1:]), (tilt[:-1], tilt[1:])
    rise = (wall.slope[:-1] * step[:, None], wall.slope[1:] * step[:, None])
    turn = rise[0] - rise[1]
    bend = jnp.clip((reach[1] - rise[1] - reach[0]) / jnp.where(turn == 0, 1e-30, turn), 0, 1)
    early = bend[:, 0] <= bend[:, 1]

    def tangents(pair: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Sums over both sides before any meeting point, between the two, and after both."""
        (behind, ahead), (next_behind, next_ahead) = ((side[:, 0], side[:, 1]) for side in pair)
        between = jnp.where(early, next_behind + ahead, behind + next_ahead)
        return behind + ahead, between, next_behind + next_ahead

    cuts = (0.0, jnp.minimum(bend[:, 0], bend[:, 1]), jnp.maximum(bend[:, 0], bend[:, 1]), 1.0)
    bases, rises, tilts = tangents((reach[0], reach[1] - rise[1])), tangents(rise), tangents(tilt)
    inside = (reach[0][:, 0] + reach[0][:, 1] > 0) | (reach[1][:, 0] + reach[1][:, 1] > 0)
    layer_area = wall_size = jnp.zeros(())
    for start, end, base, slope, leaning in zip(cuts, cuts[1:], bases, rises, tilts, strict=False):
        first, last = base + slope * start, base + slope * end
        spread = jnp.abs(first) + jnp.abs(last)
        filled = (first + last + spread) / 2
        share = (end - start) * filled / jnp.where(spread > 0, spread, 1)
        layer_area += share * filled / 2
        wall_size += share * leaning
    live = jnp.where(inside, step, 0)
    return jax.lax.complex(layer_area * live, wall_size * live)


def measure_window(
    own: Posts, others: Posts, first: Array, tube: Tube, lines: Lines, shift: Array | int = 0
) -> Window:
    """Measure the cells of the backbones `own`, [cells], among their candidates, [candidates, 2, cells].

    `first` tells the candidates with lower numbers than the cell, which settles who is behind at equal heights.
    """
    dtype, truth = own.axial.dtype, own.axial[0] > -1
    ends = jnp.stack([own.axial, tube.length - own.axial])
    grid = settled(lambda: see_lines(lines, tube, dtype, shift), truth)
    rivals = settled(lambda: see_rivals(own, others, first, tube), truth)
    by = stop(grid, rivals, ends, tube, truth)
    wall = walls(by, rivals, ends, grid, tube, truth)
    inside, step = wall.reach[:, 0] + wall.reach[:, 1] > 0, lines.step(dtype, shift)
    strip = jnp.pad((inside[1:] | inside[:-1]) & (step[:-1, None] > 0), ((1, 1), (0, 0)))
    bears = strip[1:] | strip[:-1]
    edges = np.stack([lines.number == sign * np.array(lines.half)[lines.layer] for sign in (-1, 1)])
    at_end = ((by == END) & (inside & bears)[:, None]).any(axis=(0, 1))
    sizes = CellGeometry(*integrate(wall, step, tube, lines, truth), touches_end=at_end)
    # a product, since a reduction would run one number at a time
    onward = jnp.asarray(edges, dtype) @ (inside & bears).astype(dtype) > 0
    seen = (jnp.where(bears[:, None], found, no) for found, no in ((wall.reach, -jnp.inf), (by, NONE)))
    return Window(sizes, *seen, onward)


def integrate(wall: Walls, step: Array, tube: Tube, lines: Lines, truth: Array) -> list[Array | None]:
    """Volume, lateral area and, on surfaces, areas and perimeters: sums over strips.

    Sums are products with the weights of the lines: as reductions they would run one number at a time.
    """
    radius, weight = (table.astype(step.dtype)[lines.layer] for table in lines.radii(tube))

    def summed(rows: slice, weights: Array, tilt: Array) -> tuple[Array, Array]:
        part = jax.tree.map(lambda table: table[rows], wall)
        sizes = settled(lambda: strips(part, tilt[rows], step[rows]), truth)
        weights = (weights * radius)[rows][:-1].astype(sizes.dtype)
        total = jnp.matmul(weights, sizes, precision=jax.lax.Precision.HIGHEST)
        return total.real, total.imag

    inner = int(np.sum(lines.layer < lines.inner_layers))
    volume, area = summed(slice(0, inner), weight, wall.area)
    surfaces: list[Array | None] = [None] * 4
    for k in range(2 if lines.surfaces else 0):
        (rows,) = np.nonzero(lines.layer == lines.inner_layers + k)
        surfaces[k], surfaces[2 + k] = summed(slice(rows[0], rows[-1] + 1), jnp.ones_like(weight), wall.edge)
    return [volume, area, *surfaces]


def through_windows(
    measure: Callable[[Array, Array, Done], Done], count: Array | int, size: int, width: int, done: Done
) -> Done:
    """Measure `count` of at most `size` cells in the middle window, then those that go on beyond it.

    `measure(items, shift, done)` adds to `done` what `width` items (those from `size` on are none) show in a
    window, and notes in `done.onward`, [size, 2], whether they go on beyond it. Windows to the right and to
    the left, further and further, take their turns.
    """

    def turn(state: tuple[Array, Array, Array, Done]) -> tuple[Array, Array, Array, Done]:
        number, order, count, done = state
        shift = jnp.where(number % 2 == 1, 1, -1) * ((number + 1) // 2)

        def block(k: Array, done: Done) -> Done:
            return measure(jax.lax.dynamic_slice_in_dim(order, k * width, width), shift, done)

        done = jax.lax.fori_loop(0, -(-count // width), block, done)
        beyond = jnp.where(number % 2 == 0, done.onward[:, 1], done.onward[:, 0])
        items = jax.lax.sort(jnp.where(beyond, jnp.arange(size), size))
        return number + 1, order.at[:size].set(items), beyond.sum(dtype=jnp.int32), done

    order = jnp.minimum(jnp.arange(size + width), size)
    start = jnp.zeros((), jnp.int32), order, jnp.asarray(count, jnp.int32), done
    return jax.lax.while_loop(lambda state: (state[2] > 0) | state[3].onward.any(), turn, start)[3]


class Survey(NamedTuple):
    """What measuring cells tells beside their sizes."""

    sizes: CellGeometry
    onward: Bool[Array, "cells 2"]  # while measuring: the cell goes on before or after the windows seen
    wide: Bool[Array, "cells"]  # the cell goes on beyond the middle window
    reach: Float[Array, "cells 2 lines"]  # of the middle window
    touched: Bool[Array, "cells 2 candidates"]  # the candidate stops the cell on some line


def measure_cells(
    positions: Float[Array, "n 2"],
    tube: Tube,
    lines: Lines,
    neighbors: Int[Array | np.ndarray, "n 2 candidates"],
    cells: Int[Array, "cells"] | None = None,
) -> tuple[CellGeometry, Survey]:
    """Measure all cells, or the given ones, against their candidate neighbors behind and ahead.

    Lists are padded with the cell itself. Pure: `jit` it, `vmap` it over replicas; positions, the tube's sizes
    and the lines are traced. V_i = integral of the interval's length over r dr dt, A_i = integral of the
    walls' tilt; the errors of the presets stand in `lines`. Paper, section 3.1.
    """
    which = jnp.arange(len(positions), dtype=jnp.int32) if cells is None else jnp.asarray(cells)
    neighbors, table, size = jnp.asarray(neighbors), posts(positions), len(which)
    width = min(size, BLOCK)
    dtype = positions.dtype
    blank = jnp.zeros(size, dtype)
    surfaces = [blank if lines.surfaces else None] * 4
    sizes = CellGeometry(blank, blank, *surfaces, touches_end=blank > 0)
    start = Survey(
        sizes,
        jnp.zeros((size, 2), bool),
        blank > 0,
        jnp.zeros((size, 2, len(lines.number)), dtype),
        jnp.zeros((size, *neighbors.shape[1:]), bool),
    )

    def measure(items: Array, shift: Array, done: Survey) -> Survey:
        members = which[items]
        rivals = neighbors[members].transpose(2, 1, 0)
        own, others = (Posts(*(column[at] for column in table)) for at in (members, rivals))
        window = measure_window(own, others, rivals < members, tube, lines, shift)
        return add_window(items, shift, window, done)

    found = through_windows(measure, size, size, width, start)
    return found.sizes, found


def add_window(items: Array, shift: Array, window: Window, done: Survey) -> Survey:
    """What is known of cells, and what one more window shows of some."""

    def add(known: Array, more: Array) -> Array:
        if known.dtype == bool:
            return known.at[items].max(more, mode="drop")
        return known.at[items].add(more, mode="drop")

    middle = shift == 0
    at, candidate = jnp.where(middle, items, len(done.onward)), window.by.transpose(2, 1, 0)
    side = jnp.arange(2)[:, None]
    touched = done.touched.at[
        items[:, None, None], side, jnp.where(candidate < 0, done.touched.shape[2], candidate)
    ]
    return Survey(
        jax.tree.map(add, done.sizes, window.sizes),
        note_onward(items, shift, window, done.onward),
        done.wide.at[at].set(window.onward.any(axis=0), mode="drop"),
        done.reach.at[at].set(jnp.moveaxis(window.reach, -1, 0).swapaxes(1, 2), mode="drop"),
        touched.set(True, mode="drop"),
    )


def note_onward(
    items: Array, shift: Array, window: Window, known: Bool[Array, "size 2"]
) -> Bool[Array, "size 2"]:
    """Whether cells go on: on both sides of the middle window, else on that side to which a window lies."""
    keep = jnp.stack([shift > 0, shift < 0])
    onward = jnp.where(keep, known[jnp.minimum(items, len(known) - 1)], window.onward.T)
    return known.at[items].set(onward, mode="drop")
