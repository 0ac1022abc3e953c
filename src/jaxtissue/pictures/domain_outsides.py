"""The outside of a tissue on any domain, as faces with an image of the cells on each.

Of closed surfaces a quarter is left out, so that the lumen and the walls within are seen; other domains are whole.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domain_positions import ends_in_space
from jaxtissue.geometry.domains import Domain
from jaxtissue.pictures.outsides import OPEN, PIXELS, Face

KNOTS = 121  # points along a side of a face that may be curved
HEIGHT = 1  # of the three coordinates of a layout, that from the apical (0) to the basal surface (1)
_TURN = 2 * math.pi


class Layout(NamedTuple):
    """A tissue as a box of three coordinates: along the base surface, height, and again along the base surface.

    Attributes:
        low: The least of each coordinate.
        high: The largest.
        sides: The coordinates of which both ends are faces.
        base: The places on the base surface, [..., d], of the first and the last coordinate.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    sides: tuple[int, ...]
    base: Callable[[np.ndarray, np.ndarray], Float[np.ndarray, "... d"]]


def open_domain(positions: Float[np.ndarray, "n d"], domain: Domain, pixels: int = PIXELS) -> list[Face]:
    """The faces of a tissue on a domain, in about so many pixels; see the module.

    >>> from jaxtissue.geometry.shapes import Slab
    >>> faces = open_domain(np.array([[1.0, 1.0], [3.0, 1.0]]), Slab(4, 2, 1), pixels=1000)
    >>> len(faces), faces[2].points[0, 0].tolist(), np.unique(faces[2].cells).tolist()
    (6, [0.0, 0.0, 0.0], [0, 1])
    """
    layout, crowd, faces = lay_out(domain), Crowd(positions, domain), []
    knots = [np.linspace(low, high, 2 if axis == HEIGHT else KNOTS)
             for axis, (low, high) in enumerate(zip(layout.low, layout.high, strict=True))]  # fmt: skip
    sheets = [(axis, _points(domain, layout, [[value] if own == axis else knots[own] for own in range(3)], axis))
              for axis, value in _ends(layout)]  # fmt: skip
    spans = [[float(np.linalg.norm(np.diff(points, axis=turn), axis=2).sum(axis=turn).max()) for turn in (0, 1)]
             for _, points in sheets]  # fmt: skip
    side = math.sqrt(sum(math.prod(span) for span in spans) / pixels)
    for (axis, value), (_, points), span in zip(_ends(layout), sheets, spans, strict=True):
        count = iter(max(2, math.ceil(length / side)) for length in span)
        middles = [np.array([value]) if own == axis else _middles(layout, own, next(count)) for own in range(3)]
        cells = crowd.nearest_on_grid(_points(domain, layout, middles, axis)) % len(positions)
        faces.append(Face(points, cells))
    return faces


def lay_out(domain: Domain) -> Layout:
    """The box of a domain, without a quarter of its first closed direction."""
    if not isinstance(domain.base, Rectangle):  # latitude about the x axis, and longitude
        low, high = (-math.pi / 2, 0.0, OPEN[1]), (math.pi / 2, 1.0, OPEN[0] + _TURN)
        return Layout(low, high, (HEIGHT, 2), lambda north, turn: np.stack(
            [np.sin(north), np.cos(north) * np.cos(turn), np.cos(north) * np.sin(turn)], axis=-1))  # fmt: skip
    extent, directions = [float(length) for length in domain.base.extent], domain.base.directions
    low, high, sides = [0.0, 0.0, 0.0], [extent[0], 1.0, extent[1]], [0, HEIGHT, 2]
    closed = [axis for axis, name in zip((0, 2), directions, strict=True) if name == "closed"]
    for axis in closed[::-1]:
        if axis == closed[-1]:
            low[axis], high[axis] = OPEN[1] / _TURN * high[axis], (OPEN[0] / _TURN + 1) * high[axis]
        else:
            sides.remove(axis)
    return Layout(tuple(low), tuple(high), tuple(sides), lambda u, v: np.stack([u, v], axis=-1))  # type: ignore


def _ends(layout: Layout) -> Iterator[tuple[int, float]]:
    """The coordinate that is the same all over a face, and its value."""
    for axis in layout.sides:
        yield axis, layout.low[axis]
        yield axis, layout.high[axis]


def _middles(layout: Layout, axis: int, count: int) -> Float[np.ndarray, " count"]:
    return layout.low[axis] + (np.arange(count) + 0.5) / count * (layout.high[axis] - layout.low[axis])


def _points(domain: Domain, layout: Layout, values: list, axis: int) -> Float[np.ndarray, "u v 3"]:
    """The points of a grid of coordinates, of which one has a single value."""
    first, height, last = np.meshgrid(*values, indexing="ij")
    place = layout.base(first, last)
    ends = ends_in_space(place.reshape(-1, place.shape[-1]), domain)
    apical, basal = (end.reshape(*first.shape, 3) for end in ends)
    return np.squeeze(apical + height[..., None] * (basal - apical), axis)
