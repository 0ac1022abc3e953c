"""Between which heights the corners of sections exist, and what a rule of layers should count them for.

A corner is where an edge of the diagram crosses the layer. The edge ends where a fourth backbone is as near as its
three: there corners come and go, and what is summed over corners jumps. A rule with weights w_1 ... w_L stands for the
parts of the height between W_l = w_1 + ... + w_l. An edge that is seen on layers a to b counts W_b - W_(a-1), but it
lasts from s to t: layer b lacks t - W_b, and layer a lacks W_(a-1) - s. In these parts sizes go on as between the last
two layers with the edge.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxtissue.compilation.fusion import fusion_barrier
from jaxtissue.geometry.domains import Domain, Frame
from jaxtissue.geometry.vectors import Vector, add, dot, scale, subtract
from jaxtissue.sections.cells import Layers
from jaxtissue.sections.half_planes import number_in, take, with_number
from jaxtissue.sections.polygons import Edges, Polygon
from jaxtissue.sections.views import View, between_surfaces, gap

LEVEL = 1e-3  # the sine of the angle of two walls on a layer below which the course of their edge is not known
AGES = 10.0  # of the height of the tissue: for ever


def corner_weights(domain: Domain, view: View, polygon: Polygon, other: Edges, layers: Layers) -> Array:
    """The weight of the end of each edge of a section, as a part of the weight of its layer, [slots, *T].

    Args:
        domain: The tissue.
        view: The cells as seen on the layers.
        polygon: Their sections.
        other: The walls that follow the edges counterclockwise.
        layers: The layers, with the rule of the first row of weights.
    """
    order = jnp.argsort(jnp.asarray(layers.heights))
    height, weight = (jnp.asarray(table, view.height.dtype)[order] for table in (layers.heights, layers.weights[0]))
    inner = between_surfaces((view, polygon, other), len(view.height))  # surfaces have no weight
    above, below = (jnp.pad(span, ((0, 0), (0, 2), (0, 0)))[:, order] for span in _lifespans(domain, *inner))
    h, w, top = (column[:, None] for column in (height, weight, jnp.cumsum(weight)))
    end, begin = h + above, h - below
    late = jnp.where(end < jnp.append(height[1:], 1)[:, None], end - top, 0)
    early = jnp.where(begin > jnp.append(0, height[:-1])[:, None], top - w - begin, 0)
    # the same edge on a layer and on the next one, [slots there, slots here, layers - 1, n]
    ring, lines = polygon.ring, len(view.is_there) + 4
    code = jnp.where(ring.is_edge, ring.line * lines + take(ring.line, ring.after), -1)[:, order]
    same = (code[:, None, 1:] == code[:, :-1]) & (code[:, :-1] >= 0) & ((w[1:] > 0) & (w[:-1] > 0))
    # on straight lines: the last layer counts more, the one before less
    step = jnp.diff(h, axis=0)
    later = same * (late * ((top + end) / 2 - h))[:, None, 1:] / step
    earlier = same * (early * (h - (top - w + begin) / 2))[:, :-1] / step
    lacks = (late + early).at[:, 1:].add((later - earlier).sum(axis=1)).at[:, :-1].add((earlier - later).sum(axis=0))
    return jnp.where(w > 0, 1 + lacks / jnp.where(w > 0, w, 1), 1)[:, jnp.argsort(order)]


def _lifespans(domain: Domain, view: View, polygon: Polygon, other: Edges) -> list[Array]:
    """How far above and below the layer edges last, [slots, *T] each.

    To first order from the corner, and then by one step from where the edge is at the height found so.
    """
    edges, candidates = (polygon.edge, other), len(view.is_there)

    def corners() -> tuple[Vector, Vector, Vector]:
        flat = view.frame(domain, polygon.end)
        return flat.point, *_corner(flat, view, polygon.end, edges)[1:]

    point, drift, course = fusion_barrier(corners, view.anchor)
    mine = view.own.offset(point)
    number = jnp.arange(candidates).reshape(-1, 1, 1)

    def first_ends(corner: tuple[Vector, Vector, Vector, Array, Array]) -> Array:
        point, course, mine, *lines = corner
        theirs = view.rivals.offset(point)
        apart = jnp.maximum(dot(theirs, theirs) - dot(mine, mine), 0)
        rate = 2 * dot(subtract(theirs, mine), course)  # by which it grows with the height
        others = view.is_there & (number != lines[0]) & (number != lines[1])
        time = apart / jnp.where(rate == 0, 1, jnp.abs(rate))
        ends = (jnp.where(others & (sign * rate < 0), time, AGES) for sign in (1, -1))
        return jax.lax.complex(*(with_number(time, number, candidates).min(axis=0) for time in ends))

    ring = polygon.ring
    found = jax.lax.map(first_ends, (point, course, mine, ring.line, take(ring.line, ring.after)))

    def again(sign: int, coded: Array) -> Array:
        time, rival = coded, number_in(coded, candidates)
        near = time < 1
        rise = jnp.where(near, sign * time, 0)
        there = view._replace(height=view.height + rise)
        z = add(polygon.end, scale(rise, drift))
        flat = there.frame(domain, z)
        step, _, course = _corner(flat, there, z, edges)
        left = gap(flat, view.own, view.rivals.take(rival))
        rate = sign * dot(left.pull, course)
        rest = left.value + dot(left.slope, step)
        more = jnp.clip(rest / jnp.where(rate < 0, -rate, jnp.inf), -time / 2, time / 2)
        return jnp.where(near, time + more, time)

    spans = (1, found.real), (-1, found.imag)
    return [fusion_barrier(lambda side=side: again(*side), view.anchor) for side in spans]


def _corner(flat: Frame, view: View, z: Vector, edges: tuple[Edges, Edges]) -> tuple[Vector, Vector, Vector]:
    """The step to the corner of two walls, how far it moves on the layer per height, and its edge in space.

    Where walls are nearly one, the edge goes straight up.
    """
    (a, b, value, up), (c, d, other_value, other_up) = (_slope(flat, view, z, edge) for edge in edges)
    sine = a * d - b * c
    sharp = jnp.abs(sine) > LEVEL * jnp.sqrt((a**2 + b**2) * (c**2 + d**2))
    share = jnp.where(sharp, 1 / jnp.where(sharp, sine, 1), 0)

    def offset(one: Array, other: Array) -> Vector:
        """Where gaps that are so large vanish, to first order."""
        return share * (b * other - d * one), share * (c * one - a * other)

    drift = offset(up, other_up)
    course = add(add(scale(drift[0], flat.first), scale(drift[1], flat.second)), flat.upward)
    return offset(value, other_value), drift, course


def _slope(flat: Frame, view: View, z: Vector, edge: Edges) -> tuple[Array, Array, Array, Array]:
    """How the gap changes with z, the gap, and how it changes with the height; limits go straight up."""
    found, plane = gap(flat, view.own, edge.rivals), edge.plane
    wall = (*found.slope, found.value, dot(found.pull, flat.upward))
    limit = (*plane.normal, dot(plane.normal, z) - plane.offset, jnp.zeros_like(found.value))
    a, b, value, up = (jnp.where(edge.is_wall, one, other) for one, other in zip(wall, limit, strict=True))
    return a, b, value, up
