"""Where cells are measured: lines parallel to the axis, in layers of constant radius."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtissue.tube import Tube


class Resolution(NamedTuple):
    """How finely cells are measured: `layers` in radius, `density` lines per mean cell width."""

    layers: int
    density: float


PRESETS = {"draft": Resolution(3, 3), "standard": Resolution(6, 8), "fine": Resolution(10, 10)}


def resolution_named(name: str) -> Resolution:
    """A preset (`draft`, `standard`, `fine`), or layers and density written as `8x10`.

    >>> resolution_named("8x10")
    Resolution(layers=8, density=10.0)
    >>> resolution_named("sharp")
    Traceback (most recent call last):
    ValueError: unknown resolution 'sharp'; use draft, standard, fine or LAYERSxDENSITY such as 8x10
    """
    if name in PRESETS:
        return PRESETS[name]
    layers, _, density = name.partition("x")
    try:
        resolution = Resolution(int(layers), float(density))
    except ValueError:
        resolution = Resolution(0, 0.0)
    if not (1 <= resolution.layers <= 64 and 1 <= resolution.density <= 64):
        known = ", ".join(PRESETS)
        raise ValueError(f"unknown resolution {name!r}; use {known} or LAYERSxDENSITY such as 8x10")
    return resolution


class Lines(eqx.Module):
    """The lines on which every cell is measured.

    Layer k lies at radius r_k, a Gauss-Legendre node of (R_a, R_b). There, backbone i is given the lines at
    angles t_i + m 2 pi / circle[k] for |m| <= half[k], or all `circle[k]` lines once round, and the first
    again, where that is fewer. So every cell sees its own backbone's line, and what is measured does not
    depend on how the tube is turned. With `surfaces`, two more layers lie on the apical and basal surface.
    Only counts are held here: the radii come from the tube, which may be traced.
    """

    circle: tuple[int, ...] = eqx.field(static=True)
    half: tuple[int, ...] = eqx.field(static=True)
    surfaces: bool = eqx.field(static=True, default=False)

    def _per_layer(self) -> list[tuple[np.ndarray, int, bool]]:
        """Line numbers m, lines once round, and whether the window closes, of each layer."""
        layers = []
        for circle, half in zip(self.circle, self.half, strict=True):
            closed = 2 * half >= circle
            m = np.arange(circle + 1) - circle // 2 if closed else np.arange(-half, half + 1)
            layers.append((m, circle, closed))
        return layers

    @property
    def layer(self) -> np.ndarray:
        """Layer of each line, [lines]."""
        return np.concatenate([np.full(len(m), k) for k, (m, _, _) in enumerate(self._per_layer())])

    @property
    def offset(self) -> np.ndarray:
        """Angle of each line from the backbone's, [lines]."""
        return np.concatenate([2 * math.pi / circle * m for m, circle, _ in self._per_layer()])

    @property
    def step(self) -> np.ndarray:
        """Angle from each line to the next of its layer, 0 at a layer's last, [lines]."""
        return np.concatenate(
            [np.r_[np.full(len(m) - 1, 2 * math.pi / circle), 0.0] for m, circle, _ in self._per_layer()]
        )

    @property
    def edge(self) -> np.ndarray:
        """Whether a line is the outermost of a window that does not close round the lumen, [lines]."""
        return np.concatenate(
            [np.isin(m, [] if closed else [m[0], m[-1]]) for m, _, closed in self._per_layer()]
        )

    @property
    def inner_layers(self) -> int:
        """Number of layers that carry volume."""
        return len(self.circle) - 2 * self.surfaces

    def radii(self, tube: Tube) -> tuple[Float[Array, "layers"], Float[Array, "layers"]]:
        """Radius and Gauss-Legendre weight of each layer; a surface has weight 0."""
        node, weight = np.polynomial.legendre.leggauss(self.inner_layers)
        wall = tube.basal_radius - tube.apical_radius
        radius = tube.apical_radius + wall * jnp.asarray((node + 1) / 2)
        weight = wall * jnp.asarray(weight / 2)
        if self.surfaces:
            ends = jnp.stack([jnp.asarray(tube.apical_radius), jnp.asarray(tube.basal_radius)])
            radius, weight = jnp.concatenate([radius, ends]), jnp.concatenate([weight, jnp.zeros(2)])
        return radius, weight


def plan_lines(
    tube: Tube, cells: int, resolution: Resolution, reach: float = math.inf, surfaces: bool = False
) -> Lines:
    """The lines for a tube of `cells` cells, within `reach` mean cell widths on either side of a backbone.

    The mean cell width at radius r is sqrt(2 pi r L / n). At least 16 lines run once round every layer;
    the two surfaces, which carry no volume, have half as many lines again.
    """
    single = Lines(
        (1,) * (resolution.layers + 2 * surfaces), (1,) * (resolution.layers + 2 * surfaces), surfaces
    )
    radii = np.asarray(single.radii(tube)[0], float)
    round_in_widths = np.sqrt(2 * math.pi * radii * cells / float(tube.length))
    dense = resolution.density * np.where(np.arange(len(radii)) < resolution.layers, 1.0, 1.5)
    circle = tuple(
        math.ceil(max(16, 4 * resolution.density, density * turn))
        for density, turn in zip(dense, round_in_widths, strict=True)
    )
    half = tuple(
        math.ceil(min(c / 2, reach * c / turn)) for c, turn in zip(circle, round_in_widths, strict=True)
    )
    return Lines(circle, half, surfaces)
