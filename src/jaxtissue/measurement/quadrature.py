"""Quadrature lines on which cells are measured: parallel to the axis, in layers of constant radius."""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from jaxtissue.geometry.tube import Tube


class Resolution(NamedTuple):
    """Number of layers, and density of the lines in them, on which cells are measured.

    In a `Tube`, cells are measured on lines parallel to the axis, arranged in layers (cylinders of constant radius); on
    each line a cell is the interval between two walls. On other domains, cells are measured as polygons on layers of
    constant height, and `density` is not used. Every function with an argument `resolution` accepts a `Resolution`, a
    tuple (layers, density), a string such as "8x12", or the name of a preset. The presets "draft", "standard" and
    "fine" mean 4 x 4, 7 x 8 and 10 x 10 in a `Tube` (`PRESETS`), and 2, 4 and 8 layers on other domains. A
    `Resolution` is used as it is given on every domain. For bent backbones of k nodes, each of the k - 1 parts between
    nodes has its share of the layers, rounded up, and one more.

    On eight reference tubes the root-mean-square errors of volume and lateral area, relative to their means, are at
    most 0.5 % and 3 % for "draft", 0.07 % and 1 % for "standard", and 0.05 % and 0.5 % for "fine".

    Attributes:
        layers: Number of layers between the apical and the basal surface, an integer from 1 to 64.
        density: Number of lines per mean cell width in each layer, from 1 to 64.

    >>> PRESETS["standard"]
    Resolution(layers=7, density=8)
    """

    layers: int
    density: float


REACH = 1.7  # mean cell widths on either side of a backbone that the first window of lines covers
GRAIN = 1.5  # mean cell widths to which layers have whole numbers of lines
INSET = 0.37  # about (sqrt(3) - 1) / 2, of the best rules for natural splines
# Cut from the frontier of error against time: on every reference tube `draft` errs by at most V 0.5 %, A 3 %,
# `standard` by V 0.07 %, A 1 %, `fine` by V 0.05 %, A 0.5 %. These are the bars of the races.
PRESETS = {"draft": Resolution(4, 4), "standard": Resolution(7, 8), "fine": Resolution(10, 10)}
SECTIONS = {"draft": 2, "standard": 4, "fine": 8}  # layers on other domains, cut likewise (benchmarks/domains.py)


def as_resolution(given: str | Resolution | tuple[int, float]) -> Resolution:
    """The resolution that a preset's name (`draft`, `standard`, `fine`), a pair, or a text such as `8x12` stands for.

    Every function that takes a resolution takes any of these.

    Args:
        given: A preset's name, layers and density joined by `x`, or (layers, density).

    Returns:
        The resolution.

    Raises:
        ValueError: If the name is unknown, or if layers or density are not within 1 and 64.

    >>> as_resolution("8x12")
    Resolution(layers=8, density=12.0)
    >>> as_resolution("sharp")
    Traceback (most recent call last):
    ValueError: unknown resolution 'sharp'; use draft, standard, fine or LAYERSxLINES such as 8x12
    """
    if isinstance(given, str) and given in PRESETS:
        return PRESETS[given]
    try:
        layers, density = given.split("x") if isinstance(given, str) else given
        resolution = Resolution(int(layers), float(density))
        whole = isinstance(layers, str) or resolution.layers == layers
    except (TypeError, ValueError):
        resolution, whole = Resolution(0, 0.0), False
    if not (whole and 1 <= resolution.layers <= 64 and 1 <= resolution.density <= 64):
        known = ", ".join(PRESETS)
        raise ValueError(f"unknown resolution {given!r}; use {known} or LAYERSxLINES such as 8x12")
    return resolution


class Lines(eqx.Module):
    """The lines on which every cell is measured.

    Layer k lies at `radius[k]` and counts with `weight[k]`. There, backbone i is given the lines at angles
    t_i + m 2 pi / circle[k], in windows of |m| <= half[k] and, for a cell that goes on beyond, in the windows
    to either side. So every cell sees its own backbone's line, and what is measured depends neither on how
    the tube is turned nor on how wide the windows are. With `surfaces`, two more layers lie on the apical and
    basal surface, of weight 0. The lines are those of one tube; as only the windows' widths are static, those
    of another need no new program, and those of several can be stacked.
    """

    radius: Float[Array | np.ndarray, "layers"]
    weight: Float[Array | np.ndarray, "layers"]
    circle: Float[Array | np.ndarray, "layers"]
    half: tuple[int, ...] = eqx.field(static=True)
    surfaces: bool = eqx.field(static=True, default=False)

    @property
    def number(self) -> np.ndarray:
        """The number m of each line in its window, [lines]."""
        return np.concatenate([np.arange(-half, half + 1) for half in self.half])

    @property
    def layer(self) -> np.ndarray:
        """Layer of each line, [lines]."""
        return np.repeat(np.arange(len(self.half)), 2 * np.array(self.half) + 1)

    @property
    def row(self) -> int:
        """Length of a row of one number a line, padded so that none is left over from vectors of 8."""
        return -(-len(self.number) // 8) * 8

    @property
    def inner_layers(self) -> int:
        """Number of layers that carry volume."""
        return len(self.half) - 2 * self.surfaces

    def offset(self, dtype: DTypeLike) -> Float[Array, "lines"]:
        """Angle of each line from the backbone's, in the middle window."""
        return 2 * math.pi * jnp.asarray(self.number, dtype) / self._circle(dtype)

    def turn(self, dtype: DTypeLike, shift: Int[Array, "cells"]) -> Float[Array, "layers cells"]:
        """Angle of the window `shift` windows onward from the middle one."""
        width = 2 * math.pi * jnp.asarray(2 * np.array(self.half), dtype) / jnp.asarray(self.circle, dtype)
        return width[:, None] * shift

    def step(self, dtype: DTypeLike, shift: Int[Array, "cells"]) -> Float[Array, "lines cells"]:
        """Angle from each line to the next of its layer, 0 where there is none in window and circle."""
        circle, half = self._circle(dtype)[:, None], np.array(self.half)[self.layer][:, None]
        number = jnp.asarray(self.number[:, None] + 2 * half * shift, dtype)
        first = -jnp.floor(circle / 2)
        within = (number >= first) & (number < first + circle) & (self.number[:, None] < half)
        return jnp.where(within, 2 * math.pi / circle, 0)

    def _circle(self, dtype: DTypeLike) -> Float[Array, "lines"]:
        return jnp.asarray(self.circle, dtype)[jnp.asarray(self.layer)]


def section_layers(resolution: Resolution | str) -> int:
    """The number of layers on which cells of domains other than tubes are measured; lines mean nothing there."""
    if isinstance(resolution, str) and resolution in SECTIONS:
        return SECTIONS[resolution]
    return as_resolution(resolution).layers


def plan_lines(
    tube: Tube, cells: int, resolution: Resolution | str, reach: float = REACH, surfaces: bool = False
) -> Lines:
    """Plan the quadrature lines for a tube of `cells` cells.

    The mean cell width at radius r is sqrt(2 pi r L / n). Layers have about 0.65 to 1.35 times `density` lines per mean
    cell width, more at larger radii, where cells are larger and errors weigh more. The two surfaces, which carry no
    volume, have 1.5 times `density`. At least 16 lines are placed around the outermost layer and around each surface.

    Args:
        tube: The tube; its dimensions must not be traced.
        cells: Number of cells n.
        resolution: "draft", "standard" or "fine", or a `Resolution`.
        reach: Half-width of the first window of lines around each backbone, in mean cell widths.
        surfaces: Whether to add lines on the apical and basal surface. Defaults to False.

    Returns:
        The lines.
    """
    resolution = as_resolution(resolution)
    radius, weight = layer_rule(tube, resolution.layers)
    if surfaces:
        ends = float(tube.apical_radius), float(tube.basal_radius)
        radius, weight = np.append(radius, ends), np.append(weight, [0.0, 0.0])
    turn = np.sqrt(2 * math.pi * radius * cells / float(tube.length))  # the circle in mean cell widths
    dense, circle = _density(turn, weight == 0, resolution)
    half = np.ceil(reach * dense)
    return Lines(radius, weight, circle, tuple(half.astype(int).tolist()), surfaces)


def trace_lines(tube: Tube, cells: int, resolution: Resolution, surfaces: bool = False) -> Lines:
    """The same lines for a tube whose sizes are traced: radii and weights have derivatives."""
    inner, outer = jnp.asarray(tube.apical_radius), jnp.asarray(tube.basal_radius)
    radius, weight = _spline_rule(inner, outer, resolution.layers)
    if surfaces:
        radius, weight = jnp.append(radius, jnp.stack([inner, outer])), jnp.append(weight, jnp.zeros(2))
    turn = jax.lax.stop_gradient(jnp.sqrt(2 * math.pi * radius * cells / tube.length))
    on_surface = np.arange(len(radius)) >= resolution.layers
    dense, circle = _density(turn, on_surface, resolution)
    return Lines(radius, weight, circle, tuple(np.ceil(REACH * dense).astype(int).tolist()), surfaces)


def _density(turn: Any, on_surface: np.ndarray, resolution: Resolution) -> tuple[np.ndarray, Any]:
    """The lines per mean cell width of each layer, and the lines once round it, which has so many widths."""
    surfaces, xp = on_surface.any(), jnp if isinstance(turn, jax.Array) else np
    depth = (np.arange(resolution.layers) + 0.5) / resolution.layers
    share = np.append(0.65 + 0.7 * depth, (1.5, 1.5) if surfaces else ())
    whole = np.diff(np.round(np.cumsum(GRAIN * resolution.density * share)), prepend=0)
    dense = np.maximum(1, whole) / GRAIN
    fewest = max(16, 4 * resolution.density)
    round_once = dense * turn * xp.maximum(1, fewest / (dense * turn)[resolution.layers - 1])
    return dense, xp.ceil(xp.where(on_surface, xp.maximum(round_once, fewest), round_once))


def layer_rule(tube: Tube, layers: int) -> tuple[Float[np.ndarray, "layers"], Float[np.ndarray, "layers"]]:
    """Radii and weights of the layers: the integral over (R_a, R_b) of the natural cubic spline through them.

    A cell's section S(r) is no polynomial: its second derivative jumps wherever the cell changes neighbors,
    and most often near the lumen. So layers are equally spaced in sqrt(r), the first and last INSET of a
    spacing from the surfaces. Exact for what is linear in r, such as the sum over all cells.

    >>> radius, weight = layer_rule(Tube(1, 1, 4), 3)
    >>> radius.round(2).tolist(), round(float(weight @ radius), 9)  # (4^2 - 1^2) / 2
    ([1.29, 2.25, 3.48], 7.5)
    """
    radius, weight = _layer_rule(float(tube.apical_radius), float(tube.basal_radius), layers)
    return radius.copy(), weight.copy()


@functools.lru_cache(256)
def _layer_rule(inner: float, outer: float, layers: int) -> tuple[np.ndarray, np.ndarray]:
    return _spline_rule(inner, outer, layers, np)


def _spline_rule(inner: Any, outer: Any, layers: int, xp: Any = jnp) -> tuple[Any, Any]:
    """The rule in arrays of `xp`, for radii that may be traced: the spline's second derivatives by one linear solve."""
    if layers == 1:
        return xp.asarray(inner + outer)[None] / 2, xp.asarray(outer - inner)[None]
    share = (xp.arange(layers) + INSET) / (layers - 1 + 2 * INSET)
    radius = (xp.sqrt(inner) + (xp.sqrt(outer) - xp.sqrt(inner)) * share) ** 2
    gap, values = xp.diff(radius), xp.eye(layers)
    slope = xp.diff(values, axis=0) / gap[:, None]
    bend = xp.zeros((layers, layers))  # second derivatives, 0 at the ends
    if layers > 2:
        inside = xp.diag((gap[:-1] + gap[1:]) / 3) + xp.diag(gap[1:-1] / 6, 1) + xp.diag(gap[1:-1] / 6, -1)
        solved = xp.linalg.solve(inside, xp.diff(slope, axis=0))
        bend = xp.concatenate([bend[:1], solved, bend[:1]])
    weight = (gap[:, None] * (values[:-1] + values[1:]) / 2 - gap[:, None] ** 3 * (bend[:-1] + bend[1:]) / 24).sum(
        axis=0
    )
    low, high = radius[0] - inner, outer - radius[-1]  # beyond its knots it is straight
    first, last = slope[0] - gap[0] * bend[1] / 6, slope[-1] + gap[-1] * bend[-2] / 6
    return radius, weight + low * (values[0] - low / 2 * first) + high * (values[-1] + high / 2 * last)
