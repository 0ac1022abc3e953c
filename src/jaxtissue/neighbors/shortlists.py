"""Shortlists: the candidates that can come to bound a cell within a span of sweeps.

Whether they were enough shows afterwards: a backbone that bounds a cell then must have been listed.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import sparse

from jaxtissue.compilation.fusion import fusion_barrier, larger, smaller, take_rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.adhesion import Adhesion
from jaxtissue.measurement.axial_lines import (
    FAR,
    BackboneCoords,
    LineFrame,
    backbone_coords,
    crossing,
    lines_in_frame,
    pick,
    relative_coords,
    turn_between,
)
from jaxtissue.measurement.cells import BLOCK, Survey, measure_cells
from jaxtissue.measurement.quadrature import Lines, Resolution, as_resolution, plan_lines
from jaxtissue.neighbors.search import lowest_columns, pad_lists, spacing_at, symmetric_graph

CANDIDATES = 22  # on each side of a cell: three times as many as bound it
FEW = 500  # cells for which these are enough; of more cells, one lacks a candidate as seldom if all have more
SIGHT_LINES = 5.0  # lines per mean cell width on which clearances are measured
SIGHT = 2.0  # mean cell widths to either side in which they are
TINY = 1e-20
TOUCHES = 0.0  # clearance of a candidate that touches the cell
STAYS = 0.1  # weight of how far a candidate is from where the cell stops now: a neighbor may go on to
ACROSS = 0.4  # weight of how far along the axis it is from the side on which it is listed
STOPS = 1e-25  # of one that stops it on a line that bears no part of it, below that of all others


def sight_lines(tube: Tube, cells: int, resolution: Resolution | str) -> Lines:
    """The lines of `clearance` for tissue measured at a resolution: on as many layers, farther out."""
    return plan_lines(tube, cells, Resolution(as_resolution(resolution).layers, SIGHT_LINES), SIGHT)


def clearance(
    positions: Float[Array, "n 2"], tube: Tube, lines: Lines, sides: Int[Array, "n 2 candidates"]
) -> Float[Array, "n 2 candidates"]:
    """How far each candidate would have to move on the apical surface to stop the cell on a line, squared.

    To first order: d_j^2 - d_i^2 where the second in line would stop the cell, over its derivative,
    2 sqrt((x - x_j)^2 + (r s sin(t - t_j) / R_a)^2). Infinite where there is none; TINY at least.

    To that are added the squares of how far the cell is from the line without the backbones that stop it, since it may
    get there, and, at a weight of STAYS, of how far the candidate is from where the cell stops now. Candidates on the
    side where they are not yet are taken at the mirrored place, farther by the way to that side, at a weight of ACROSS.
    A backbone far from stopping a cell now stays so for a while.
    """
    n, dtype = len(positions), positions.dtype
    width = min(n, BLOCK)
    blocks = -(-n // width)
    place, lists = backbone_coords(positions), jnp.pad(sides, ((0, blocks * width - n), (0, 0), (0, 0)))
    grid = jax.tree.map(lambda column: column[:, 0], lines_in_frame(lines, dtype))

    def block(start: Array) -> Array:
        which = start + jnp.arange(width)
        those = take_rows(lists, which).transpose(2, 1, 0)
        own, others = pick(place, which), pick(place, those)
        ends, truth = jnp.stack([own.axial, tube.length - own.axial]), own.axial[0] > -1
        rivals, is_ahead = fusion_barrier(lambda: relative_coords(own, others, those < which, tube), truth)
        here = fusion_barrier(lambda: jnp.where(is_ahead == jnp.array([False, True])[:, None], 0.0, FAR), truth)

        def nearer(closest: Array, at: LineFrame) -> tuple[Array, None]:
            meets = fusion_barrier(lambda: crossing(at, rivals, tube), truth)

            first = fusion_barrier(lambda: lowest_above(-jnp.inf, meets, here, ends), truth)
            second = fusion_barrier(lambda: lowest_above(first, meets, here, ends), truth)

            def nearest() -> Array:
                z, y = at.radius - at.sagitta_from(rivals), at.across(rivals)
                around = larger(z, tube.apical_radius) * y / tube.apical_radius
                speed = (second - 2 * rivals.half) ** 2 + around**2
                lacking = larger(-(second[0] + second[1]), 0.0)
                past = larger(meets - second, 0.0) ** 2 + STAYS * (meets - first) ** 2 + lacking**2
                return smaller(past * (2 * rivals.half) ** 2 / larger(speed, TINY), closest)

            return fusion_barrier(nearest, truth), None

        closest, _ = jax.lax.scan(nearer, jnp.full(rivals.half.shape, jnp.inf, dtype), grid)
        beyond = larger(jnp.array([[1], [-1]]) * (others.axial - own.axial), 0.0)  # not yet on that side
        closest = jnp.maximum(closest + ACROSS * beyond**2, TINY)
        return jnp.where(rivals.half < FAR, closest, jnp.inf).transpose(2, 1, 0)

    closest = jax.lax.map(block, width * jnp.arange(blocks))
    return closest.reshape(blocks * width, *sides.shape[1:])[:n]


def lowest_above(above: Array | float, meets: Array, here: Array, ends: Array) -> Array:
    """The lowest of the reaches on their sides; 8 by 8, as a reduction takes twice as long."""
    reaches = [meets[k::8] + here[k::8] for k in range(min(8, len(meets)))]
    reaches = [jnp.where(h > above, h, FAR) for h in reaches]
    whole = functools.reduce(smaller, [h[: len(meets) // 8] for h in reaches])
    rest = [h[-1] for h in reaches if len(h) > len(whole)]
    return functools.reduce(smaller, [*rest, *whole], ends)


def distances(
    positions: Float[Array, "n 2"], tube: Tube, sides: Int[Array, "n 2 candidates"]
) -> Float[Array, "n 2 candidates"]:
    """The distances from each backbone to its candidates, as `search.spacing`, not squared; never 0."""
    place = backbone_coords(positions)
    own, others = BackboneCoords(*(column[:, None, None] for column in place)), pick(place, sides)
    cosine = 1 - turn_between(own, others)[0]
    radii = tube.apical_radius, tube.basal_radius
    return jnp.sqrt(spacing_at(others.axial - own.axial, cosine, *radii, xp=jnp) + TINY)


def shortlist_length(cells: int) -> int:
    """The number of candidates on each side of a cell during a span: 22, and 5 more for each tenfold of cells.

    If one cell lacks one, the sweeps of all are played again: with five more, about ten times as seldom.

    >>> shortlist_length(500), shortlist_length(50_000)
    (22, 32)
    """
    return CANDIDATES + 5 * max(0, math.ceil(math.log10(cells / FEW)))


def nearest_sides(
    sides: Int[np.ndarray, "n 2 candidates"], clear: Float[np.ndarray, "n 2 candidates"], count: int
) -> Int[np.ndarray, "n 2 count"]:
    """The `count` candidates with the least clearance on each side, by number as on long lists."""
    kept = lowest_columns(clear, count)
    sides, clear = (np.take_along_axis(table, kept, axis=2) for table in (sides, clear))
    own = np.arange(len(sides), dtype=sides.dtype)[:, None, None]
    return pad_lists(np.sort(np.where(np.isfinite(clear), sides, own), axis=2), count)


def mutual_entries(sides: Int[np.ndarray, "n 2 candidates"]) -> Int[np.ndarray, "2 pairs"]:
    """The flat places in `sides` of the two entries of each pair that list each other, and agree on which is ahead.

    Pair, order, list and place in it are one integer, since sorting those is fast.
    """
    n, row = len(sides), sides[0].size
    own, lists, place = np.arange(n, dtype=np.int32)[:, None], sides.reshape(n, row), np.arange(row)
    bits = (row - 1).bit_length()
    is_low = own < lists
    coded = np.maximum(own, lists).astype(np.int64)
    coded *= n
    coded += np.minimum(own, lists)
    coded <<= bits + 2
    coded |= (is_low == (place >= row // 2)).astype(np.int32) << bits + 1 | is_low.astype(np.int32) << bits
    coded |= place
    coded = np.sort(coded[lists != own])
    pair = coded >> bits + 1
    first = np.flatnonzero(pair[1:] == pair[:-1])
    cells = np.divmod(pair[first] >> 1, n)  # the high one, whose view comes first, and the low one
    places = coded[first], coded[first + 1]
    return np.stack([cell * row + (at & (1 << bits) - 1) for cell, at in zip(cells, places, strict=True)])


def survey_tissue(
    positions: Float[Array, "n 2"],
    tube: Tube,
    lines: tuple[Lines, Lines],
    sides: Int[Array, "n 2 candidates"],
    adhesion: Adhesion | None = None,
) -> tuple[Survey, Float[Array, "n 2 candidates"]]:
    """Measure a whole tissue, and the clearance of each candidate on `sight_lines`.

    A candidate that touches the cell, or stops it on any line, has a flag instead of a clearance.
    """
    _, seen = measure_cells(positions, tube, lines[0], sides, adhesion=adhesion)
    clear = clearance(positions, tube, lines[1], sides)
    return seen, jnp.where(seen.touched, TOUCHES, jnp.where(seen.stops, STOPS, clear))


def from_both(
    clear: Float[np.ndarray, "n 2 candidates"], views: Int[np.ndarray, "2 pairs"]
) -> Float[np.ndarray, "n 2 candidates"]:
    """The smaller of the two clearances of each pair, one from each cell, as first orders err on one side.

    `views` are `mutual_entries` of the lists.
    """
    each = clear.reshape(-1)
    first, second = each[views]
    nearer = each.copy()
    nearer[views[0]] = np.minimum(first, np.maximum(second, STOPS))
    nearer[views[1]] = np.minimum(second, np.maximum(first, STOPS))
    return nearer.reshape(clear.shape)


def around(sides: Int[np.ndarray, "n 2 candidates"]) -> Int[np.ndarray, "n around"]:
    """The cells that list each cell as a candidate, and its own candidates; padded with the cell itself."""
    n = len(sides)
    return packed_rows(symmetric_graph(np.repeat(np.arange(n), sides[0].size), sides.reshape(-1), n))


def packed_rows(graph: sparse.csr_array) -> Int[np.ndarray, "n width"]:
    """The columns of each row as a list, padded with the row's own number."""
    sizes = np.diff(graph.indptr)
    lists = np.repeat(np.arange(len(sizes), dtype=np.int32)[:, None], max(sizes.max(initial=0), 2), axis=1)
    rows = np.repeat(np.arange(len(sizes)), sizes)
    lists[rows, np.arange(len(rows)) - np.repeat(graph.indptr[:-1], sizes)] = graph.indices
    return lists


def find_unlisted(
    cells: Int[np.ndarray, "cells"],
    clear: Float[np.ndarray, "n 2 candidates"],
    sides: Int[np.ndarray, "n 2 candidates"],
    few: Int[np.ndarray, "n 2 few"],
) -> Int[np.ndarray, "pairs 2"]:
    """Pairs of a given cell and a cell that touches it without being on its shortlist."""
    row, side, place = np.nonzero(clear[cells] == TOUCHES)
    cell = cells[row]
    rival = sides[cell, side, place]
    listed = (few[cell, side] == rival[:, None]).any(axis=1)
    return np.stack([cell, rival], axis=1)[~listed]


def list_first(
    pairs: Int[np.ndarray, "pairs 2"],
    sides: Int[np.ndarray, "n 2 candidates"],
    clear: Float[np.ndarray, "n 2 candidates"],
) -> bool:
    """Put the cells of pairs first on each other's shortlists, by their clearance; whether any was not there yet.

    Both sides list them, where the other may come to lie, in place of the candidate farthest from stopping the cell.
    """
    news = False
    for pair in pairs:
        for cell, rival in (pair, pair[::-1]):
            for side in np.flatnonzero(~(sides[cell] == rival).any(axis=1)):
                farthest = clear[cell, side].argmax()
                sides[cell, side, farthest], clear[cell, side, farthest] = rival, np.inf
            here = sides[cell] == rival
            news |= bool((clear[cell][here] > TOUCHES).any())
            clear[cell][here] = TOUCHES
    return news
