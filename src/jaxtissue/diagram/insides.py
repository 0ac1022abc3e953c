"""Which points lie in a domain, and the box round it (host, float64)."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float
from scipy.spatial import KDTree

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.base_surfaces import Rectangle, UnitSphere
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.shapes import BentTube, Ellipsoid, EllipticTube, RoundTube, Slab, Sphere
from jaxtissue.geometry.tube import Tube
from jaxtissue.geometry.vectors import Vector, add, components, cross, dot, rows, scale, subtract

NODES, LEVELS = 128, (0.0, 0.25, 0.5, 0.75, 1.0)  # samples of a domain from which its points are found
GAP = 1.6  # between Gauss-Legendre nodes, in units of the mean distance, at most
TURNS = 12  # of Newton's method
STARTS = 4  # nearest samples that it is started from, one after the other
FAR = 4  # distances between samples: the longest step within the base surface
MISS = 1e-9  # of the domain's size, within which a point is reached
CHUNK = 2**15  # points looked at together
ZOOMS, ACROSS = 40, np.linspace(-1, 1, 9)  # of the search for the farthest points

Points = Float[np.ndarray, "p 3"]


def contains(points: Points, domain: Tube | Domain) -> Bool[np.ndarray, " p"]:
    """Whether points lie in a domain or on its surface; in one period where it is periodic.

    Where the domain has no closed form, a point lies in it if Newton's method finds a place (m, h) with F(m, h) there.

    >>> contains(np.array([[0.0, 0.0, 1.5], [0.0, 0.5, 0.5]]), Sphere(1, 2)).tolist()
    [True, False]
    """
    if isinstance(domain, Tube):
        return _in_tube(domain, points)
    closed = _CLOSED.get(type(domain))
    return closed(domain, points) if closed else _search(domain, points)


def bounding_box(domain: Tube | Domain) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """The least and the largest x, y and z in a domain; in one period where it is periodic.

    As points move on straight lines with the height, these are on one of the surfaces.
    """
    if isinstance(domain, Tube):
        length, radius = float(domain.length), float(domain.basal_radius)
        return np.array([0, -radius, -radius]), np.array([length, radius, radius])
    with usual_modes(), double_precision():
        ends = np.asarray(_farthest(in_doubles(domain)))
    return -ends[1], ends[0]


def _in_tube(tube: Tube | RoundTube, points: Points) -> Bool[np.ndarray, " p"]:
    radius = np.hypot(points[:, 1], points[:, 2])
    between = (radius >= float(tube.apical_radius)) & (radius <= float(tube.basal_radius))
    return between & _spans(points[:, 0], tube.length)


def _in_slab(slab: Slab, points: Points) -> Bool[np.ndarray, " p"]:
    sides = zip(points.T, (slab.width, slab.depth, slab.thickness), strict=True)
    return np.logical_and.reduce([_spans(place, size) for place, size in sides])


def _in_bent_tube(tube: BentTube, points: Points) -> Bool[np.ndarray, " p"]:
    x, y, z = points.T
    away = np.hypot(np.hypot(x, y) - float(tube.bend_radius), z)
    between = (away >= float(tube.apical_radius)) & (away <= float(tube.basal_radius))
    return between & (tube.is_torus | (np.mod(np.arctan2(y, x), 2 * np.pi) <= tube.arc))


def _between(points: Points, apical: Any, basal: Any) -> Bool[np.ndarray, " p"]:
    """Not within the ellipsoid or elliptic cylinder of the first semi-axes, but in that of the others."""
    above, below = (((points / np.asarray(axes, float)) ** 2).sum(axis=1) for axes in (apical, basal))
    return (above >= 1) & (below <= 1)


def _spans(place: Float[np.ndarray, " p"], size: Any) -> Bool[np.ndarray, " p"]:
    return (place >= 0) & (place <= float(size))


_CLOSED: dict[type, Callable[[Any, Points], Bool[np.ndarray, " p"]]] = {
    RoundTube: _in_tube,
    Slab: _in_slab,
    BentTube: _in_bent_tube,
    EllipticTube: lambda tube, points: (
        _between(points[:, 1:], tube.apical_axes, tube.basal_axes) & _spans(points[:, 0], tube.length)
    ),
    Sphere: lambda shell, points: _between(points, shell.apical_radius, shell.basal_radius),
    Ellipsoid: lambda shell, points: _between(points, shell.apical_axes, shell.basal_axes),
}


def _search(domain: Domain, points: Points) -> Bool[np.ndarray, " p"]:
    with usual_modes(), double_precision():
        domain = in_doubles(domain)
        place, height, samples, reach = (np.asarray(part) for part in _sample(domain))
    tree, size = KDTree(samples), float(np.ptp(samples, axis=0).max())
    query: Any = tree.query(points, STARTS, distance_upper_bound=float(reach))
    near, found = query
    within = np.zeros(len(points), bool)
    for turn in range(STARTS):
        left = np.flatnonzero(~within & np.isfinite(near[:, turn]))
        for first in range(0, len(left), CHUNK):
            some = left[first : first + CHUNK]
            padded = np.append(some, np.repeat(some[-1:], CHUNK - len(some)))
            start = found[padded, turn]
            with usual_modes(), double_precision():
                off = np.asarray(_invert(domain, points[padded], place[start], height[start]))
            within[some] = off[: len(some)] <= MISS * size
    return within


def _steps(base: Rectangle | UnitSphere) -> tuple[Any, Any]:
    """The distance between samples in both directions of a chart, at most."""
    if isinstance(base, Rectangle):
        return base.extent[0] * GAP / NODES, base.extent[1] * GAP / NODES
    return np.pi * GAP / NODES, np.pi * GAP / NODES


@jax.jit
def _sample(domain: Domain) -> tuple[Array, Array, Array, Array]:
    """Places, heights and points of samples, and how far any point of the domain is from one of them at most."""
    points, _ = domain.base.nodes(NODES)
    levels = jnp.asarray(LEVELS)
    height = jnp.repeat(levels, points[0].size)
    place = tuple(jnp.tile(part, levels.size) for part in points)
    frame = domain.frame(place, (jnp.zeros_like(height),) * 2, height)
    sizes = [jnp.sqrt(dot(way, way)) for way in (frame.first, frame.second, frame.upward)]
    first, second = _steps(domain.base)
    reach = (sizes[0] * first + sizes[1] * second + sizes[2] * (LEVELS[1] - LEVELS[0])).max()
    return rows(place), height, rows(frame.point), reach


@jax.jit
def _invert(domain: Domain, points: Array, place: Array, height: Array) -> Array:
    """How near to points F comes by Newton's method from starts in the domain, in which it stays."""
    target, steps = components(points), _steps(domain.base)

    def turn(_: int, state: tuple[Vector, Array]) -> tuple[Vector, Array]:
        m, h = state
        frame = domain.frame(m, (jnp.zeros_like(h),) * 2, h)
        miss, across = subtract(target, frame.point), cross(frame.first, frame.second)
        element = dot(across, frame.upward)
        moves = dot(miss, cross(frame.second, frame.upward)), dot(miss, cross(frame.upward, frame.first))
        y = tuple(jnp.clip(move / element, -FAR * s, FAR * s) for move, s in zip(moves, steps, strict=True))
        return _clipped(domain.base, domain.base.chart(m, y)), jnp.clip(h + dot(miss, across) / element, 0, 1)

    m, h = lax.fori_loop(0, TURNS, turn, (components(place), height))
    apical, basal = domain.surfaces(m)
    miss = subtract(target, add(scale(1 - h, apical), scale(h, basal)))
    return jnp.sqrt(dot(miss, miss))


def _clipped(base: Rectangle | UnitSphere, m: Vector) -> Vector:
    """The point brought back to the ends of the rectangle, and to those of a period."""
    if not isinstance(base, Rectangle):
        return m
    sides = zip(m, base.extent, base.directions, strict=True)
    return tuple(part if direction == "closed" else jnp.clip(part, 0, extent) for part, extent, direction in sides)


@jax.jit
def _farthest(domain: Domain) -> Array:
    """The largest x, y and z, and the largest -x, -y and -z, [2, 3]: grids that shrink round the best place."""
    base = domain.base

    def look(m: Vector) -> Array:
        """The coordinates on the farther of both surfaces, and their opposites, [2, 3, ...]."""
        ends = [jnp.stack(surface) for surface in domain.surfaces(m)]
        return jnp.stack([jnp.maximum(*ends), jnp.maximum(-ends[0], -ends[1])])

    points, _ = base.nodes(NODES)
    best = look(points).reshape(6, -1).argmax(axis=1)
    s, t = (jnp.asarray(table.ravel()) for table in np.meshgrid(ACROSS, ACROSS))
    own = jnp.arange(6)

    def zoom(turn: int, m: Vector) -> Vector:
        share = 0.6**turn
        y = tuple(share * step * way[None] * jnp.ones((6, 1)) for step, way in zip(_steps(base), (s, t), strict=True))
        tried = _clipped(base, base.chart(tuple(part[:, None] for part in m), y))
        chosen = look(tried).reshape(6, 6, -1)[own, own].argmax(axis=1)
        return tuple(jnp.broadcast_to(part, (6, len(s)))[own, chosen] for part in tried)

    m = lax.fori_loop(0, ZOOMS, zoom, tuple(part[best] for part in points))
    return look(m).reshape(6, 6)[own, own].reshape(2, 3)
