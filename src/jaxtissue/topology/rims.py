"""Sizes from rims alone: what each edge adds to the areas of the faces that meet along it, and to volumes.

The wall of a and b is a graph over the cross-section, x = h(r, t), of area G r dr dt with G = |q_b - q_a| /
|x_b - x_a|, q the feet. On a ray from the axis |q_b - q_a|^2 is quadratic in r between the places where feet
leave the apical ends, so P(r, t), the integral of G r from R_a to r, is closed, and the area is that of P dt
round the rim: no sheet is too steep, folded, or wound round the lumen. Level backbones have the half-planes
midway between them, of area x dr round the rim.

The volume of cell a is the flow of (x - x_a, 0, 0) out of it, through its walls and ends: the sum over its
walls of the integral of (h - x_a) r dr dt, again round their rims, where the integral over r from R_a to r is
a polynomial of r and cos(t - t_a) on either side of the place where a foot leaves its apical end.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.system.cores import in_threads
from jaxtissue.topology.bisectors import BOUNDS, TINY, Bisectors
from jaxtissue.topology.edges import EdgeGraph

SIDES = (
    (0, 1, 1.0),
    (1, 2, 1.0),
    (0, 2, -1.0),
)  # of labels a, b, c: faces ab, bc lie left of the edge, ac right
LEVEL = 1e-5  # of the distance of their apical ends: closer along x are level, to 1e-10 of their wall
BLOCK = 2**12  # segments measured at once: what fits the processor's cache
CLOSE = 1e-5  # of a segment: Newton's next step is its square


def _lobatto() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Five nodes on [0, 1], ends included, their weights, and the matrix that takes values to derivatives."""
    inner = np.sqrt(3 / 7)
    nodes = (1 + np.array([-1, -inner, 0, inner, 1])) / 2
    weights = np.array([9, 49, 64, 49, 9]) / 180
    powers = np.arange(5)
    slopes = powers * nodes[:, None] ** np.maximum(powers - 1, 0)
    return nodes, weights, slopes @ np.linalg.inv(nodes[:, None] ** powers)


NODES, WEIGHTS, SLOPES = _lobatto()


class Rims(NamedTuple):
    """The length of each edge, what it adds to each of its faces, and the volume of each cell.

    For each of its faces, as in SIDES: what the edge adds to the area, and how far the face turns about the axis along
    it.
    """

    length: Float[np.ndarray, " e"]
    area: Float[np.ndarray, "3 e"]
    turn: Float[np.ndarray, "3 e"]
    volume: Float[np.ndarray, " n"]


def measure_rims(graph: EdgeGraph, bisectors: Bisectors) -> Rims:
    """Lengths, areas and volumes by Gauss-Lobatto on every segment, at nodes brought onto the edges."""
    count, cells = len(graph.edge_labels), bisectors.count + BOUNDS
    length, area, turn = np.zeros(count), np.zeros((3, count)), np.zeros((3, count))
    volume = np.zeros(cells)

    def swept(some: slice) -> tuple[np.ndarray, np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
        """Lengths and angles of segments, and for each of SIDES the rows that it bears on and their sums."""
        labels = graph.edge_labels[graph.segment_edge[some]]
        point = nodes_on(graph.points[some], graph.tangents[some], labels, bisectors)
        speed = np.linalg.norm(np.einsum("ij,mjk->mik", SLOPES, point), axis=2) @ WEIGHTS
        angle = np.arctan2(point[..., 2], point[..., 1])
        angle[:, 1:] = np.mod(angle[:, 1:] - angle[:, :1] + np.pi, 2 * np.pi) - np.pi
        start_angle, angle[:, 0] = angle[:, 0].copy(), 0
        sides = []
        for one, two, sign in SIDES:
            kept = np.flatnonzero(labels[:, one] < bisectors.count)
            pair = labels[kept][:, [one, two]]
            sides.append((kept, sign * _swept(point[kept], start_angle[kept], angle[kept], pair, bisectors)))
        return speed, angle[:, -1], sides

    blocks = [slice(start, start + BLOCK) for start in range(0, len(graph.points), BLOCK)]
    for some, (speed, spun, sides) in zip(blocks, in_threads(swept, blocks), strict=True):
        edge = graph.segment_edge[some]
        length += np.bincount(edge, speed, count)
        for side, (kept, sums) in enumerate(sides):
            one, two, sign = SIDES[side]
            area[side] += np.bincount(edge[kept], sums[0], count)
            turn[side] += np.bincount(edge, sign * spun, count)
            pair = graph.edge_labels[edge[kept]][:, [one, two]]
            volume += np.bincount(pair.T.ravel(), sums[1:].ravel(), cells)
    return Rims(length, area, turn, volume[: bisectors.count])


def nodes_on(
    points: Float[np.ndarray, "m 2 3"],
    tangents: Float[np.ndarray, "m 2 3"],
    labels: Int[np.ndarray, "m 3"],
    bisectors: Bisectors,
) -> Float[np.ndarray, "m 5 3"]:
    """The nodes of segments, on their edges."""
    chord = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
    ways = tangents * chord[:, None, None]
    node = np.stack([along(points, ways, share)[0] for share in NODES], axis=1)
    inner = node[:, 1:-1].reshape(-1, 3)
    on, found = bisectors.solve(inner, np.repeat(labels, 3, axis=0), np.repeat(CLOSE * chord, 3))
    node[:, 1:-1] = np.where(found[:, None], on, inner).reshape(-1, 3, 3)
    return node


def along(points: np.ndarray, tangents: np.ndarray, share: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point and derivative, at a share of the way, of the cubic with the given ends and end tangents."""
    s = share
    blend = (1 - s) ** 2 * (1 + 2 * s), s**2 * (3 - 2 * s), s * (1 - s) ** 2, -(s**2) * (1 - s)
    slope = -6 * s * (1 - s), 6 * s * (1 - s), (1 - s) * (1 - 3 * s), s * (3 * s - 2)
    knots = (points[:, 0], points[:, 1], tangents[:, 0], tangents[:, 1])
    at, way = (sum(c * knot for c, knot in zip(w, knots, strict=True)) for w in (blend, slope))
    return np.asarray(at), np.asarray(way)


def _swept(
    point: Float[np.ndarray, "m 5 3"],
    start: Float[np.ndarray, " m"],
    turn: Float[np.ndarray, "m 5"],
    pair: Int[np.ndarray, "m 2"],
    bisectors: Bisectors,
) -> Float[np.ndarray, "3 m"]:
    """The sums over segments that have the face of a pair on their left, seen against the normal to the second label.

    The rows are what they add to its area and to the volumes of the two cells.
    """
    n, swept = bisectors.count, np.zeros((3, len(point)))
    bound, radius = pair[:, 1] - n, np.hypot(point[..., 1], point[..., 2])
    spin, rise = (np.einsum("ij,mj->mi", SLOPES, value) for value in (turn, radius))
    gap = bisectors.axial[pair[:, 1]] - bisectors.axial[pair[:, 0]]
    own, other = (np.stack([bisectors.cosine[k], bisectors.sine[k]]) for k in pair.T)
    level = np.abs(gap) < LEVEL * bisectors.inner * np.linalg.norm(own - other, axis=0)
    walls = np.flatnonzero((bound < 0) & ~level)
    at = radius[walls], start[walls, None] + turn[walls], pair[walls], bisectors
    height = np.stack([np.sign(gap[walls, None]) * primitive(*at), *flow(*at)])
    swept[:, walls] = (height * spin[walls]) @ WEIGHTS
    planes = np.flatnonzero((bound < 0) & level)
    flat = point[planes].reshape(-1, 3)
    foot, next_foot = (bisectors.feet(flat, np.repeat(k, 5)) for k in pair[planes].T)
    way = next_foot - foot
    around = (flat[:, 1] * way[:, 2] - flat[:, 2] * way[:, 1]).reshape(-1, 5)
    lean = gap[planes, None] / np.linalg.norm(way, axis=1).reshape(-1, 5)  # normal along x
    place = point[planes, :, 0]
    near, far = (lean / 2 * (place - bisectors.axial[k, None]) ** 2 for k in pair[planes].T)
    swept[:, planes] = (np.stack([place, near, -far]) * np.sign(around) * rise[planes]) @ WEIGHTS
    for surface, size in ((0, bisectors.inner), (1, -bisectors.outer)):
        here = np.flatnonzero(bound == surface)
        swept[0, here] = size * ((point[here, :, 0] * spin[here]) @ WEIGHTS)
    for end, outward in ((0.0, -0.5), (bisectors.length, 0.5)):
        here = np.flatnonzero(bound == (2 if outward < 0 else 3))
        swept[0, here] = outward * ((radius[here] ** 2 * spin[here]) @ WEIGHTS)
        swept[1, here] = np.abs(end - bisectors.axial[pair[here, 0]]) * swept[0, here]
    return swept


def flow(
    radius: Float[np.ndarray, "m k"],
    angle: Float[np.ndarray, "m k"],
    pair: Int[np.ndarray, "m 2"],
    bisectors: Bisectors,
) -> tuple[Float[np.ndarray, "m k"], Float[np.ndarray, "m k"]]:
    """The integrals of (h - x_a) r dr and of (x_b - h) r dr from R_a to r, h the wall's height.

    h - x_a = gap / 2 + (f_b - f_a) / (2 gap). With c = cos(t - t_j), f_j - r^2 is R_a^2 - 2 R_a r c where the
    foot is at the apical end, and -(r c)^2 beyond.
    """
    gap = (bisectors.axial[pair[:, 1]] - bisectors.axial[pair[:, 0]])[:, None]
    inner, sums = bisectors.inner, []
    for k in pair.T:
        cosine = np.cos(angle) * bisectors.cosine[k, None] + np.sin(angle) * bisectors.sine[k, None]
        leaves = np.clip(inner / np.maximum(cosine, TINY), inner, radius)
        clamped = inner**2 * (leaves**2 - inner**2) / 2 - 2 * inner * cosine * (leaves**3 - inner**3) / 3
        sums.append(clamped - cosine**2 * (radius**4 - leaves**4) / 4)
    half, lead = gap * (radius**2 - inner**2) / 4, (sums[1] - sums[0]) / (2 * gap)
    return half + lead, half - lead


def primitive(
    radius: Float[np.ndarray, "m k"],
    angle: Float[np.ndarray, "m k"],
    pair: Int[np.ndarray, "m 2"],
    bisectors: Bisectors,
) -> Float[np.ndarray, "m k"]:
    """P(r, t), the integral of |q_b - q_a| / |x_b - x_a| r dr from R_a to r."""
    gap = np.abs(bisectors.axial[pair[:, 1]] - bisectors.axial[pair[:, 0]])[:, None]
    heights = [
        np.cos(angle) * bisectors.cosine[k][:, None] + np.sin(angle) * bisectors.sine[k][:, None] for k in pair.T
    ]
    first, last = (
        np.minimum(*heights),
        np.maximum(*heights),
    )  # cosines: the larger leaves its apical end first
    first, last = last, first
    knots = [np.full_like(radius, bisectors.inner)]
    for cosine in (first, last):
        leaves = bisectors.inner / np.maximum(cosine, TINY)
        knots.append(np.clip(leaves, bisectors.inner, radius))
    knots.append(radius)
    across = (
        bisectors.cosine[pair[:, 0]] * bisectors.cosine[pair[:, 1]]
        + bisectors.sine[pair[:, 0]] * bisectors.sine[pair[:, 1]]
    )
    cosine = across[:, None]
    sine = (
        bisectors.cosine[pair[:, 0]] * bisectors.sine[pair[:, 1]]
        - bisectors.sine[pair[:, 0]] * bisectors.cosine[pair[:, 1]]
    )[:, None]
    chord = np.square(bisectors.cosine[pair[:, 0]] - bisectors.cosine[pair[:, 1]])
    chord = (chord + np.square(bisectors.sine[pair[:, 0]] - bisectors.sine[pair[:, 1]]))[:, None]
    both = np.sqrt(1 + bisectors.inner**2 * chord / gap**2) * (knots[1] - knots[0]) * (knots[1] + knots[0]) / 2
    # one foot above its apical end: 1 + (r cos D)^2 ... = (k r - k r0)^2 + rest
    steep = first / gap
    middle = bisectors.inner * cosine / np.where(first > 0, first, 1)
    one = _moment(knots[1] - middle, knots[2] - middle, steep, 1 + (bisectors.inner * sine / gap) ** 2, middle)
    two = _moment(knots[2], knots[3], np.abs(sine) / gap, np.ones_like(gap), 0 * middle)
    return both + one + two


def _moment(low: np.ndarray, high: np.ndarray, steep: np.ndarray, rest: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Integral of (u + shift) sqrt(steep^2 u^2 + rest) du."""
    root_low, root_high = np.sqrt((steep * low) ** 2 + rest), np.sqrt((steep * high) ** 2 + rest)
    cubes = (root_high**2 + root_high * root_low + root_low**2) / (3 * (root_high + root_low))
    size = np.sqrt(rest)
    turn = np.arcsinh(steep * high / size) - np.arcsinh(steep * low / size)
    flat = steep * np.maximum(np.abs(low), np.abs(high)) < 1e-8 * size
    bow = np.where(flat, size * (high - low), rest * turn / np.where(flat, 1, steep))
    return (high - low) * (high + low) * cubes + shift * (high * root_high - low * root_low + bow) / 2
