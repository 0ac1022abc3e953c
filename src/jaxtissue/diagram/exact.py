"""Reference measurement of cells in float64 from Voronoi diagrams of sampled backbones (Qhull), clipped to the tube.

Each backbone of a tube is sampled at equally spaced points, both ends included. The Voronoi facets between samples of
different backbones tile the walls of the cells; they are clipped in closed form. For other domains see `layer_cuts`.
Slow and accurate: for tests and for checks of the fast measurement, not for dynamics. "The paper" is Buceta, Funke,
Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone Spreads", GRAPP 2025.
"""

from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree, Voronoi

from jaxtissue.diagram.facet_moments import Clip, Edges, at, clipped_moments, straight_moments, take
from jaxtissue.diagram.layer_cuts import measure_layers
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube

LONGEST = 1e4  # basal radii
UNFILLED = 1e-6  # of the tube, by which volumes may differ in sum
A_LAYER = 3  # samples of a backbone for each layer, and for each triangle across a cell, on other domains


class ExactDiagram(NamedTuple):
    """Cells of a tissue and the walls between them, as returned by `exact_cells`.

    Attributes:
        volume: V_i, volume of each cell, in cubed length units, shape [n].
        lateral_area: A_i, area of the walls that each cell shares with other cells, in squared length units, shape [n].
        pairs: Indices a < b of the two cells of each wall, sorted by a and then by b, shape [m, 2].
        wall_area: Area of each wall, in squared length units, shape [m].
    """

    volume: Float64[np.ndarray, " n"]
    lateral_area: Float64[np.ndarray, " n"]
    pairs: Int64[np.ndarray, "m 2"]
    wall_area: Float64[np.ndarray, " m"]


class _Backbones(NamedTuple):
    axial: Float64[np.ndarray, " n"]  # from the middle of the tube
    direction: Float64[np.ndarray, "n 2"]
    apical: float
    basal: float


class _Planes(NamedTuple):
    tilt: Float64[np.ndarray, "2 f"]  # n_x and n_r of the unit normal n
    across: Float64[np.ndarray, "2 f"]  # m
    offset: Float64[np.ndarray, " f"]  # n . p for every p in the plane


class _Facets(NamedTuple):
    """Voronoi facets between cells a < b, n pointing from a to b; a ghost has the number of cells."""

    cells: Int64[np.ndarray, "2 f"]
    planes: _Planes
    first: Int64[np.ndarray, " f"]  # the facet's first edge
    facet: Int64[np.ndarray, " e"]  # the edge's facet
    edges: Edges  # counterclockwise around n


def exact_cells(positions: PositionsLike, domain: Tube | Domain, samples: int = 50) -> ExactDiagram:
    """Measure cells by an independent reference method: a Voronoi diagram of sampled backbones (paper, section 4.1).

    Use it to check `measure_tissue`, which is much faster. In a `Tube`, each backbone is replaced by equally spaced
    points, and the Voronoi diagram of all points (Qhull, float64) is clipped exactly to the tube. By the divergence
    theorem, V_a = int (x - x_a) n_x dA over the walls of cell a + (L - x_a) (area of its face at x = L) + x_a (area of
    its face at x = 0). The facets zigzag around the true wall, so the area of a wall is computed as the flux through
    its facets of the unit vector N = (q_b - q_a) / |q_b - q_a|, with the nearest points q_a and q_b of the two
    backbones. The volumes sum to the volume of the tube for any number of samples; errors decrease with the square of
    the number of samples.

    On other domains backbones are not sampled. Layers of constant height at `samples` / 3 Gauss-Legendre nodes are
    divided into triangles, about `samples` / 3 across a mean cell, whose vertices are labeled by the nearest backbone;
    triangles are then cut along the walls. Errors decrease with the square of `samples` here too.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3],
            or those of the nodes of tilted and bent backbones, as `measure_tissue` takes them.
        domain: The tube or other domain.
        samples: Number of sample points per backbone, both ends included, at least 2. Defaults to 50.

    Returns:
        An `ExactDiagram` with fields `volume` and `lateral_area` (shape [n]), `pairs` (shape [m, 2]) and `wall_area`
        (shape [m]).

    Raises:
        ValueError: If a position is not finite or lies outside the domain, if two backbones nearly coincide, if
            `samples` is less than 2, or if the length of the tube exceeds 10,000 R_b, beyond which Qhull is not precise
            enough.

    >>> tube = Tube(length=10, apical_radius=1, basal_radius=2)
    >>> exact = exact_cells([[2, 0], [5, 2], [8, 4]], tube)
    >>> exact.pairs.tolist(), bool(abs(exact.volume.sum() / tube.volume - 1) < 1e-6)
    ([[0, 1], [1, 2]], True)
    """
    if samples < 2:
        raise ValueError(f"samples={samples} is too small; give at least 2, the two ends of a backbone")
    domain = domain_of(domain, positions)
    if isinstance(domain, Domain):
        parts, place = max(2, round(samples / A_LAYER)), as_domain_positions(positions, domain, np.float64, bent=True)
        return _walled(*measure_layers(place, domain, parts, parts))
    tube = domain
    radii = float(tube.length / tube.basal_radius)
    if radii > LONGEST:
        message = f"length={tube.length} is {radii:.3g} times basal_radius"
        raise ValueError(f"{message}; give a tube of at most {LONGEST:.0f} basal radii, where Qhull is precise enough")
    half, apical, basal = float(tube.length) / 2, float(tube.apical_radius), float(tube.basal_radius)
    positions = as_positions(positions, tube, np.float64)
    backbones = _backbones(positions, half, apical, basal)
    facets = _dual_facets(backbones, half, samples)
    inner, outer = Clip(apical, half), Clip(basal, half)
    moments = _facet_moments(facets, outer) - _facet_moments(facets, inner)
    left, right = (_patches_at(end, facets, outer) - _patches_at(end, facets, inner) for end in (-half, half))
    n_x, n_r = facets.planes.tilt
    n, (a, b) = len(backbones.axial), facets.cells
    # each cell seen from its own backbone: seen from afar errors of areas would grow with the way
    gain_a, gain_b = (
        n_x * ((n_x * facets.planes.offset - own) * moments[0] + n_r * moments[1])
        + (half - own) * right
        + (half + own) * left
        for own in np.append(backbones.axial, 0)[facets.cells]
    )
    volume = (np.bincount(a, gain_a, n + 1) - np.bincount(b, gain_b, n + 1))[:n]
    _require_filled(volume, tube)

    # facets of the size of roundoff are no walls
    real = np.flatnonzero((b < n) & (moments[0] > 1e-14 * basal**2))
    keys, wall = np.unique(a[real] * n + b[real], return_inverse=True)
    pairs = np.stack(np.divmod(keys, n), axis=1)
    wall_area = np.zeros(len(keys))
    moments, planes = moments[:, real], take(facets.planes, real)
    np.add.at(wall_area, wall, moments[0] * _cosine(planes, facets.cells[:, real], moments, backbones))
    return _walled(volume, pairs, wall_area)


def _walled(volume: np.ndarray, pairs: np.ndarray, wall_area: np.ndarray) -> ExactDiagram:
    """The cells with the areas of their walls."""
    lateral_area = np.zeros(len(volume))
    np.add.at(lateral_area, pairs, wall_area[:, None])
    return ExactDiagram(volume, lateral_area, pairs, wall_area)


def _backbones(positions: Float64[np.ndarray, "n 2"], half: float, apical: float, basal: float) -> _Backbones:
    positions = np.asarray(positions, dtype=np.float64)
    axial, angle = positions.T
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.concatenate([axial[:, None], apical * direction], axis=1)
    closest = 1e-9 * max(half, basal)  # below, Qhull merges them
    for i, j in sorted(KDTree(ends).query_pairs(closest)):
        raise ValueError(f"backbones {i} and {j} coincide (they are closer than {closest:.1e}); move one of them")
    return _Backbones(axial - half, direction, apical, basal)


def _dual_facets(backbones: _Backbones, half: float, samples: int) -> _Facets:
    """Voronoi facets between samples of different backbones, and between samples and far ghosts."""
    axial, direction, apical, basal = backbones
    points = np.empty((len(axial), samples, 3))
    points[..., 0] = axial[:, None]
    points[..., 1:] = np.linspace(apical, basal, samples)[:, None] * direction[:, None]
    # two diameters away: ghosts bound every cell but own no point of the tissue
    ghosts = 4 * np.hypot(half, basal) * np.concatenate([np.eye(3), -np.eye(3)])
    sites = np.concatenate([points.reshape(-1, 3), ghosts])
    # from the middle of the backbones: seen from afar Qhull would lose digits by the square of the way
    middle = np.array([np.ptp(axial) / 2 + axial.min(), 0, 0])
    diagram = Voronoi(sites - middle)
    owner = np.minimum(np.arange(len(sites)) // samples, len(axial))
    cells = owner[diagram.ridge_points]
    chosen = np.flatnonzero(cells[:, 0] != cells[:, 1])
    order = np.argsort(cells[chosen], axis=1)
    planes = _bisectors(*sites[np.take_along_axis(diagram.ridge_points[chosen], order, axis=1).T])

    rings = [diagram.ridge_vertices[i] for i in chosen]
    size = np.fromiter(map(len, rings), np.int64, len(rings))
    corners = diagram.vertices[np.fromiter(chain.from_iterable(rings), np.int64, size.sum())] + middle
    first, facet = np.cumsum(size) - size, np.repeat(np.arange(len(size)), size)
    edges = _ring_edges(corners, first, facet, planes)
    return _Facets(np.sort(cells[chosen].T, axis=0), planes, first, facet, edges)


def _bisectors(start: Float64[np.ndarray, "f 3"], stop: Float64[np.ndarray, "f 3"]) -> _Planes:
    normal = (stop - start) / np.linalg.norm(stop - start, axis=1, keepdims=True)
    n_x, n_y, n_z = normal.T
    n_r = np.hypot(n_y, n_z)
    # any m does where the plane is square to the axis
    across = np.where(n_r > 0, [n_y, n_z], [[1], [0]]) / np.where(n_r > 0, n_r, 1)
    return _Planes(np.stack([n_x, n_r]), across, np.sum(normal * (start + stop), axis=1) / 2)


def _ring_edges(corners: np.ndarray, first: np.ndarray, facet: np.ndarray, planes: _Planes) -> Edges:
    """Edges of each facet, counterclockwise, from its corners in cyclic order."""
    (n_x, n_r), (m_y, m_z), offset = take(planes, facet)
    x, y, z = corners.T
    u = m_y * z - m_z * y
    v = n_r * x - n_x * (m_y * y + m_z * z)
    tail, head = np.arange(len(corners)), np.arange(1, len(corners) + 1)
    head[np.append(first[1:], len(corners)) - 1] = first
    clockwise = np.add.reduceat(u * v[head] - u[head] * v, first)[facet] < 0
    ends = np.where(clockwise, [head, tail], [tail, head])
    u, v = u[ends], v[ends]
    # x and w from the plane, not from Qhull's corner: exactly linear in v
    return Edges(u, v, n_r * offset - n_x * v, n_x * offset + n_r * v)


def _facet_moments(facets: _Facets, clip: Clip) -> Float64[np.ndarray, "6 f"]:
    """The integrals of (1, v, u, v^2, u v, u^2) dA over each clipped facet."""
    _, _, first, facet, ((u, _), _, (w, _), (x, _)) = facets
    low, high = np.minimum.reduceat(x, first), np.maximum.reduceat(x, first)
    farthest = np.maximum.reduceat(u * u + w * w, first)
    # no corner reaches the disc in the direction of their mean: neither does the facet
    mean = np.stack([np.add.reduceat(u, first), np.add.reduceat(w, first)])
    mean = (mean / np.maximum(np.hypot(*mean), 1e-300))[:, facet]
    nearest = np.minimum.reduceat(u * mean[0] + w * mean[1], first)
    within = (low >= -clip.half) & (high <= clip.half) & (farthest <= clip.radius**2)
    crossed = (low < clip.half) & (high > -clip.half) & (nearest < clip.radius) & ~within

    whole, part = np.flatnonzero(within[facet]), np.flatnonzero(crossed[facet])
    lines, crossing = take(facets.edges, whole), take(facets.edges, part)
    swept = np.append(straight_moments(lines), clipped_moments(crossing, clip), axis=1)
    return np.stack([np.bincount(facet[np.append(whole, part)], row, len(first)) for row in swept])


def _require_filled(volume: Float64[np.ndarray, " n"], tube: Tube) -> None:
    """Raise `ValueError` where the volumes do not add up to the tube's."""
    filled = float(volume.sum() / tube.volume)
    if not abs(filled - 1) < UNFILLED:
        told = f"the cell volumes add up to {filled:.9g} times the volume of the tube"
        raise ValueError(f"{told}; change the number of samples, or separate backbones that nearly coincide")


def _patches_at(end: float, facets: _Facets, clip: Clip) -> Float64[np.ndarray, " f"]:
    """The area that each facet adds to a's patch of the disc at x = end, and takes from b's."""
    tail, head = facets.edges.x > end
    # a ring crosses the plane upwards as often as downwards
    crossing = np.stack([np.flatnonzero(head & ~tail), np.flatnonzero(tail & ~head)])
    edges, facet = take(facets.edges, crossing), facets.facet[crossing[0]]
    u, _, w, _ = at(edges, (end - edges.x[0]) / (edges.x[1] - edges.x[0]))
    u, w = np.where(u[0] < u[1], [u, w], [u[::-1], w[::-1]])
    m_y, m_z = facets.planes.across[:, facet]
    y, z = m_y * w - m_z * u, m_z * w + m_y * u
    swept = clipped_moments(Edges(y, z, z, np.zeros_like(z)), clip)
    return np.bincount(facet, swept[0], len(facets.first))


def _cosine(planes: _Planes, cells: np.ndarray, moments: np.ndarray, backbones: _Backbones) -> np.ndarray:
    """Mean of n . N over each facet (N the normal of the true wall), from four points with its moments.

    One standard deviation from its center each way: Gauss-Legendre nodes on a strip, as most facets are.
    """
    (n_x, n_r), across, offset = planes
    v, u, vv, uv, uu = moments[1:] / moments[0]
    spread_u = np.sqrt(np.maximum(uu - u * u, 0))
    lean = np.divide(uv - u * v, spread_u, out=np.zeros_like(u), where=spread_u > 0)
    spread_v = np.sqrt(np.maximum(vv - v * v - lean * lean, 0))
    total = np.zeros_like(u)
    for i, j in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        point_u, point_v = u + i * spread_u, v + i * lean + j * spread_v
        point = point_u * np.stack([-across[1], across[0]]) + (n_r * offset - n_x * point_v) * across
        foot_a, foot_b = (_foot(backbones, cell, point) for cell in cells)
        gap_x, gap = np.diff(backbones.axial[cells], axis=0)[0], foot_b - foot_a
        slope = n_x * gap_x + n_r * np.sum(across * gap, axis=0)
        total += slope / np.sqrt(gap_x**2 + np.sum(gap * gap, axis=0))
    return total / 4


def _foot(backbones: _Backbones, cell: np.ndarray, point: np.ndarray) -> Float64[np.ndarray, "2 f"]:
    """The nearest points of backbones, seen along the axis."""
    direction = backbones.direction[cell].T
    return np.clip(np.sum(direction * point, axis=0), backbones.apical, backbones.basal) * direction
