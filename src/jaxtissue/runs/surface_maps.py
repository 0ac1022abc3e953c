"""The surfaces of tissues as images of cells: unrolled where the base surface is a rectangle, else from two sides."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.point_location import label_points
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domain_positions import ends_in_space
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import ends_on
from jaxtissue.geometry.tube import Tube

DEGREES = "angle (degrees)"
_TURN = 180 / np.pi
_NAMES = {"axial": "axial position (length units)", "angle": DEGREES}


class SurfaceMap(NamedTuple):
    """A surface as an image.

    Attributes:
        view: From where it is seen; empty where it is unrolled.
        labels: The cell in the middle of each pixel, -1 where there is none, [across, up].
        extent: Left, right, bottom and top, as an axis shows them.
        ends: The ends of the backbones that are seen, [k, 2].
        goes_on: Whether the last pixel across, and up, lies beside the first.
        is_stretched: Whether the two axes have units of their own.
    """

    view: str
    labels: Int[np.ndarray, "across up"]
    extent: tuple[float, float, float, float]
    ends: Float[np.ndarray, "k 2"]
    goes_on: tuple[bool, bool]
    is_stretched: bool


def unrolls(domain: Tube | Domain) -> bool:
    """Whether the surfaces can be laid out on a plane."""
    return isinstance(domain, Tube) or isinstance(domain.base, Rectangle)


def axis_labels(domain: Tube | Domain) -> tuple[str, str]:
    """The names of the axes of a map."""
    names = domain.columns if isinstance(domain, Domain) else ("axial", "angle")
    first, second = names[:2] if unrolls(domain) else ("x", "y")
    return _NAMES.get(first, f"{first} (length units)"), _NAMES.get(second, f"{second} (length units)")


def map_surface(
    positions: Float[np.ndarray, "n d"], domain: Tube | Domain, surface: str, shape: tuple[int, int]
) -> list[SurfaceMap]:
    """The `apical` or `basal` surface: one image of so many pixels if it unrolls, else two square ones."""
    place = np.asarray(positions, float)
    if isinstance(domain, Tube):
        ends = np.stack([place[:, 0], np.degrees(place[:, 1]) % 360], axis=1)
        labels = label_surface(place, domain, surface, shape)
        return [SurfaceMap("", labels, (0, float(domain.length), 0, 360), ends, (False, True), True)]
    if isinstance(domain.base, Rectangle):
        return [_unrolled(place, domain, domain.base, surface, shape)]
    return [_seen(place, domain, surface, min(shape), above) for above in (True, False)]


def _unrolled(
    place: Float[np.ndarray, "n 2"], domain: Domain, base: Rectangle, surface: str, shape: tuple[int, int]
) -> SurfaceMap:
    extent = [float(length) for length in base.extent]
    sides = [(np.arange(count) + 0.5) / count * length for count, length in zip(shape, extent, strict=True)]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
    units = np.array([_TURN if name == "angle" else 1.0 for name in domain.columns])
    right, top = (units * extent).tolist()
    ends = ends_on(place, surface, domain)
    goes_on = base.directions[0] != "free", base.directions[1] != "free"
    return SurfaceMap(
        "", _labels(place, domain, surface, grid), (0, right, 0, top), ends * units, goes_on, bool((units != 1).any())
    )


def _seen(place: Float[np.ndarray, "n 3"], domain: Domain, surface: str, count: int, above: bool) -> SurfaceMap:
    """A closed surface as seen along z, x to the right."""
    side = (2 * np.arange(count) + 1) / count - 1
    x, y = np.meshgrid(side, side, indexing="ij")
    inside, sign = x**2 + y**2 <= 1, 1 if above else -1
    height = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    grid = np.stack([x, sign * y, sign * height], axis=-1)
    labels = _labels(place, domain, surface, grid / np.linalg.norm(grid, axis=-1, keepdims=True))
    rim = _embedded(domain, surface, np.array([[-1.0, 0, 0], [1, 0, 0], [0, -sign, 0], [0, sign, 0]]))
    extent = (*rim[:2, 0].tolist(), *rim[2:, 1].tolist())
    ends = ends_on(place, surface, domain)
    ends = _embedded(domain, surface, ends[sign * ends[:, 2] > 0])[:, :2]
    view = f"from {'above' if above else 'below'}"
    return SurfaceMap(view, np.where(inside, labels, -1), extent, ends, (False, False), False)


def _labels(place: np.ndarray, domain: Domain, surface: str, grid: Float[np.ndarray, "u v d"]) -> np.ndarray:
    points = _embedded(domain, surface, grid.reshape(-1, grid.shape[-1])).reshape(*grid.shape[:2], 3)
    return Crowd(place, domain).nearest_on_grid(points) % len(place)


def _embedded(domain: Domain, surface: str, place: Float[np.ndarray, "p d"]) -> Float[np.ndarray, "p 3"]:
    return ends_in_space(place, domain)[0 if surface == "apical" else 1]


@usual_modes()
def label_surface(
    positions: PositionsLike, tube: Tube, surface: str, shape: tuple[int, int]
) -> Int[np.ndarray, "axial angular"]:
    """The cell that holds the center of each pixel of the unrolled `apical` or `basal` surface of a tube.

    Pixel (i, j) is centered at x = (i + 1/2) L / shape[0] and the angle (j + 1/2) 2 pi / shape[1].
    """
    axial = (np.arange(shape[0]) + 0.5) / shape[0] * float(tube.length)
    angle = (np.arange(shape[1]) + 0.5) / shape[1] * 2 * np.pi
    radius = float(tube.apical_radius if surface == "apical" else tube.basal_radius)
    x, turn = np.meshgrid(axial, angle, indexing="ij")
    points = np.stack([x, radius * np.cos(turn), radius * np.sin(turn)], axis=-1)
    return label_points(points, positions, tube).reshape(shape)
