"""Backbones and lines relative to a backbone, and the reach of the wall against a rival on a line.

On a line of constant radius r and angle t the squared distance to backbone j is (x - x_j)^2 + f_j, with
f_j = y^2 + (s - z)^2, z = r cos(t - t_j), y = r sin(t - t_j), s = max(z, R_a) the radius of the foot. All is
written in the line's sagitta g = r - z, as f_j = 2 r g - m (2 g - m) with m = r - s = min(g, r - R_a): fewer
operations than in z and y, and no digits are lost where cells are narrow against r.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.fusion import fusion_barrier, larger, smaller, take_rows
from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import Lines

LEVEL = 3e-4  # slope against the axis given to walls closer to parallel to it: the root of float32's rounding
FAR = 1e30  # beyond any tube, and finite: its lowest bits may be changed


class BackboneCoords(NamedTuple):
    """Backbones as their axial place, angle, and its cosine and sine, all of one shape."""

    axial: Array
    angle: Array
    cosine: Array
    sine: Array


class LineFrame(NamedTuple):
    """Lines as seen from a backbone, [lines, 1 or cells]."""

    radius: Array
    turned: Array  # z + i y: one complex table is written in one loop, four real ones in four
    sagitta: Array  # r - z

    @property
    def z(self) -> Array:
        """Component along the backbone."""
        return self.turned.real

    @property
    def y(self) -> Array:
        """Component across it."""
        return self.turned.imag

    def foot_depth(self, tube: Tube) -> Array:
        """The depth of the own foot below the line, m."""
        return smaller(self.sagitta, self.radius - tube.apical_radius)

    def square(self, tube: Tube) -> Array:
        """Squared distance f to it."""
        foot_depth = self.foot_depth(tube)
        return 2 * self.radius * self.sagitta - foot_depth * (2 * self.sagitta - foot_depth)

    def sagitta_from(self, rival: "RelativeCoords") -> Array:
        """The sagitta as seen from rivals."""
        return self.sagitta + self.z * rival.versine - self.y * rival.sine

    def across(self, rival: "RelativeCoords") -> Array:
        """The component across rivals."""
        return self.y - self.y * rival.versine - self.z * rival.sine


class RelativeCoords(NamedTuple):
    """Each cell against its candidates behind and ahead, [candidates, 2, cells]; half is FAR for no rival."""

    half: Array  # |x_j - x_i| / 2
    slant: Array  # 1 / (4 half)
    versine: Array  # 1 - cosine, and sine of t_j - t_i
    sine: Array


def pick(place: BackboneCoords, which: Array) -> BackboneCoords:
    """The backbones of the given numbers."""
    return BackboneCoords(*(take_rows(column, which) for column in place))


def backbone_coords(positions: Float[Array | np.ndarray, "... 2"]) -> BackboneCoords:
    """The backbones at (axial, angle) positions."""
    angle = positions[..., 1]
    return BackboneCoords(jnp.asarray(positions[..., 0]), jnp.asarray(angle), jnp.cos(angle), jnp.sin(angle))


def lines_in_frame(lines: Lines, dtype: np.dtype) -> LineFrame:
    """The lines round each backbone, [lines, 1], in the middle window."""
    radius, offset = jnp.asarray(lines.radius, dtype)[lines.layer][:, None], lines.offset(dtype)[:, None]
    turned = jax.lax.complex(radius * jnp.cos(offset), radius * jnp.sin(offset))
    return LineFrame(radius, turned, sagitta_of(radius, turned))


def window_in_frame(lines: Lines, dtype: np.dtype, shift: Int[Array, "cells"], truth: Array) -> LineFrame:
    """The lines round each backbone, [lines, cells], in windows onward: those of the middle one, turned."""
    middle, turn = lines_in_frame(lines, dtype), lines.turn(dtype, shift)
    onward = fusion_barrier(lambda: jax.lax.complex(jnp.cos(turn), jnp.sin(turn)), truth)
    turned = fusion_barrier(lambda: middle.turned * onward[lines.layer], truth)
    return LineFrame(middle.radius, turned, fusion_barrier(lambda: sagitta_of(middle.radius, turned), truth))


def turned_in_frame(radius: Array, turn: Array, own: BackboneCoords) -> LineFrame:
    """Lines at the given radii, at angles given as e^(i angle), as seen from backbones."""
    turned = radius * (turn * jax.lax.complex(own.cosine, -own.sine))
    return LineFrame(radius, turned, sagitta_of(radius, turned))


def sagitta_of(radius: Array, turned: Array) -> Array:
    """The sagitta r - z of z + i y, without loss of digits where it is small."""
    z, y = turned.real, turned.imag
    return jnp.where(z > 0, y * y / (radius + larger(z, 0.0)), radius - z)


def relative_coords(
    own: BackboneCoords, others: BackboneCoords, first: Array, tube: Tube
) -> tuple[RelativeCoords, Array]:
    """The other backbones as rivals, on either side, and whether each lies ahead.

    No wall may be parallel to the axis: of two backbones at the same height the one that is `first` counts as
    lying behind, and all are taken as LEVEL times their distance apart along the axis.
    """
    gap, (versine, sine) = others.axial - own.axial, turn_between(own, others)
    # exactly 0 for the cell itself, which pads the lists
    apart = jnp.maximum(jnp.abs(gap), LEVEL * tube.apical_radius * jnp.sqrt(2 * versine))
    half = jnp.where(apart > 0, apart / 2, FAR)
    return RelativeCoords(half, 0.25 / half, versine, sine), (gap > 0) | ((gap == 0) & ~first)


def turn_between(own: BackboneCoords, others: BackboneCoords) -> tuple[Array, Array]:
    """Versine (half the squared chord) and sine of the angle from backbones to others."""
    versine = ((others.cosine - own.cosine) ** 2 + (others.sine - own.sine) ** 2) / 2
    return versine, others.sine * own.cosine - others.cosine * own.sine


def coords_by_side(own: BackboneCoords, others: BackboneCoords, first: Array, tube: Tube) -> RelativeCoords:
    """The rivals among the candidates [candidates, 2, cells], FAR if they lie on the other side."""
    rivals, is_ahead = relative_coords(own, others, first, tube)
    half = jnp.where(is_ahead == jnp.array([False, True])[:, None], rivals.half, FAR)
    return rivals._replace(half=half, slant=0.25 / half)


def crossing(grid: LineFrame, rival: RelativeCoords, tube: Tube) -> Array:
    """The reach h = |dx| / 2 + (f_j - f_i) / (2 |dx|) against rivals, on lines."""
    sagitta = grid.sagitta_from(rival)
    foot_depth = smaller(sagitta, grid.radius - tube.apical_radius)
    farther = 2 * grid.radius * sagitta - grid.square(tube) - foot_depth * (2 * sagitta - foot_depth)
    return rival.half + farther * rival.slant
