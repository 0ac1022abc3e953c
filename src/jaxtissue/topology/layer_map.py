"""The map of a layer's cells, from the polygons of its sections: which cells meet at which junction.

Two cells are taken to touch where the polygons of both say so. Walking round from cell to cell gives the junctions;
where walls too short to be sure of are left out, more than three cells meet, and any of their diagonals is taken: the
junctions are put right afterwards, by flips. Where walls bend so much that their polygons make up no surface,
`sampled_map` finds the map.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.geometry.base_surfaces import Rectangle, UnitSphere
from jaxtissue.topology.junctions import Junctions, joined
from jaxtissue.topology.layer_gaps import LayerGaps
from jaxtissue.topology.layer_polygons import Polygons, complete_polygons
from jaxtissue.topology.sampled_map import sampled_map

Base = Rectangle | UnitSphere
SHORTEST = (0.0, 1e-6, 1e-4, 1e-2, 0.05)  # in mean widths: shorter walls are left out, until the map is one
PASSES = (3, 2, 5, 8)  # of the polygons: long cells on narrow tubes may come out well by some of them alone


def first_map(gaps: LayerGaps, positions: Float[np.ndarray, "n d"], height: float) -> Junctions:
    """The junctions of a layer, near to where they are. Raises `ValueError` where the cells make up no surface."""
    junctions = _map_of_polygons(gaps, positions, height) or sampled_map(gaps, height)
    junctions.at[:], junctions.since[:] = height, height
    return junctions


def _map_of_polygons(gaps: LayerGaps, positions: Float[np.ndarray, "n d"], height: float) -> Junctions | None:
    """The junctions of the polygons of a layer; None where these make up no surface."""
    for passes in PASSES:
        found, lists = complete_polygons(gaps, positions, height, passes)
        if _meets_itself(gaps.base, lists, found):  # after other passes it may be a cell like others
            continue
        n = len(lists)
        # what lies behind each line: the number of a backbone or of a copy, and -1 .. -4 for the limits
        names = np.concatenate([lists, np.tile(-1 - np.arange(4), (n, 1))], axis=1)
        for shortest in SHORTEST:
            junctions = _walk(gaps.base, found, names, shortest * gaps.width)
            if junctions is not None:
                return junctions
    return None


def _meets_itself(base: Base, lists: Int[np.ndarray, "n q"], found: Polygons) -> bool:
    """Whether a cell reaches where it meets itself, round the tissue or a period away."""
    n, q = lists.shape
    goes_round = found.is_edge[:, q:] & ~np.asarray(base.is_end())
    return bool(goes_round.any() or (found.is_edge[:, :q] & (lists % n == np.arange(n)[:, None])).any())


class _Ways(NamedTuple):
    """The ways from a label to those that it touches; a wall between two cells is a way and a way back."""

    start: list[int]
    goal: list[int]
    corner: list[np.ndarray | None]  # where the way's edge ends, for those that start in a cell
    twin: dict[int, int]
    before: dict[int, int]  # the way before it, clockwise round the start
    after: dict[int, int]


def _walk(base: Base, found: Polygons, lines: np.ndarray, shortest: float) -> Junctions | None:
    """The junctions of a map of the walls that are not below a length; None where they make up no surface."""
    ways, rows_of, numbers, places, seen = _find_ways(base, found, lines, shortest), [], [], [], set()
    fresh = len(ways.start)
    for first in range(len(ways.start)):
        if first in seen or first not in ways.after:
            continue
        names, face = _face(ways, first)
        if len(names) < 3:
            return None
        seen.update(face)
        at = next(ways.corner[way] for way in face if way >= 0 and ways.corner[way] is not None)
        back = face[0]
        for k in range(1, len(names) - 1):
            last = k == len(names) - 2
            rows_of.append((names[0], names[k], names[k + 1]))
            numbers.append((back, face[k], face[-1] if last else fresh))
            places.append(at)
            if not last:
                back = fresh + 1
                ways.twin.update({fresh: fresh + 1, fresh + 1: fresh})
                fresh += 2
    if not rows_of:
        return None
    junctions = joined(np.array(rows_of), np.array(numbers), ways.twin)
    junctions.place = np.array(places, float)
    return junctions if _is_surface(base, junctions, len(lines)) else None


def _face(ways: _Ways, first: int) -> tuple[list[int], list[int]]:
    """The labels that meet at the end of a way's edge, counterclockwise, and the ways from each to the next."""
    face = [first]
    while True:
        following = ways.before.get(ways.twin[face[-1]], -1)
        if following < 0:  # the corner of a sheet
            last = ways.after[first]
            return [ways.start[first], ways.goal[first], ways.goal[last]], [first, -1, ways.twin[last]]
        if following == first or len(face) > len(ways.start):
            return [ways.start[way] for way in face], face
        face.append(following)


def _find_ways(base: Base, found: Polygons, lines: np.ndarray, shortest: float) -> _Ways:
    """All ways along which both cells see each other, and those to limits."""
    n = len(lines)
    shifts = base.images()
    opposite = [int(np.abs(shifts + shift).sum(axis=1).argmin()) for shift in shifts]
    rings: dict[int, list[tuple[int, int, int]]] = {}
    for cell in range(n):
        slots = np.flatnonzero(found.is_edge[cell] & (found.length[cell] >= shortest))
        slots = slots[np.argsort(found.turn[cell, slots])]
        rings[cell] = [(line % n, line // n, slot) if line >= 0 else (n - 1 - line, -1, slot)
                       for slot, line in zip(slots.tolist(), lines[cell, slots].tolist(), strict=True)]  # fmt: skip
    known = {(cell, goal, copy): 0 for cell, ring in rings.items() for goal, copy, _ in ring}
    ways = _Ways([], [], [], {}, {}, {})
    ends: dict[int, list[tuple[float, int]]] = {}
    for cell, ring in rings.items():
        own = []
        for goal, copy, slot in ring:
            if copy >= 0 and (goal, cell, opposite[copy]) not in known:
                continue
            own.append(len(ways.start))
            known[cell, goal, copy] = own[-1]
            _add(ways, cell, goal, found.corner[cell, slot])
            if copy < 0:
                ends.setdefault(goal, []).append((_along(base, found.corner[cell, slot], goal - n), own[-1]))
        _link(ways, own, True)
    for (cell, goal, copy), way in known.items():
        if copy >= 0 and (goal, cell, opposite[copy]) in known:
            ways.twin[way] = known[goal, cell, opposite[copy]]
    for goal, touching in ends.items():
        ring = []
        for _, way in sorted(touching):
            ring.append(len(ways.start))
            ways.twin.update({way: ring[-1], ring[-1]: way})
            _add(ways, goal, ways.start[way], None)
        _link(ways, ring, not base.is_end()[1 - (goal - n) % 2])
    return ways


def _along(base: Any, corner: np.ndarray, limit: int) -> float:
    """The coordinate along a limit, rising counterclockwise as seen from beyond it."""
    way = 1 - limit % 2
    at = corner[way] if base.is_end()[way] else np.mod(corner[way], float(base.extent[way]))
    return float(at if limit in (0, 3) else -at)


def _add(ways: _Ways, start: int, goal: int, corner: np.ndarray | None) -> None:
    ways.start.append(start)
    ways.goal.append(goal)
    ways.corner.append(corner)


def _link(ways: _Ways, ring: list[int], is_closed: bool) -> None:
    for first, second in zip(ring, ring[1:] + ring[:1] if is_closed else ring[1:], strict=False):
        ways.after[first], ways.before[second] = second, first


def _is_surface(base: Base, junctions: Junctions, n: int) -> bool:
    """Whether all cells are there and junctions - edges + labels is that of the base surface (Euler)."""
    labels = np.unique(junctions.labels)
    open_ = int((junctions.beside < 0).sum())
    free = int(base.is_end().sum()) // 2 if isinstance(base, Rectangle) else 1
    euler = len(labels) - (junctions.labels.size + open_) // 2 + len(junctions.labels)
    return np.array_equal(labels[:n], np.arange(n)) and euler == (0, 2, 1)[free] and open_ == (0, 0, 4)[free]
