"""Domains: tissue between two surfaces over a common base surface, F(m, h) = (1 - h) S_a(m) + h S_b(m).

Definition 2 and the sections are those of the paper: Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell
Structure Dynamics via Backbone Spreads", GRAPP 2025.
"""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.backbones import Backbones
from jaxtissue.geometry.base_surfaces import Rectangle, UnitSphere
from jaxtissue.geometry.vectors import Vector, add, components, cross, dot, rows, scale, subtract

NODES = 128  # of the quadrature in each direction
HEIGHTS = ((3 - math.sqrt(3)) / 6, (3 + math.sqrt(3)) / 6)  # exact, as the volume is of the second degree in h


class Frame(NamedTuple):
    """Points of the tissue and how they move with the local coordinates y and the height h."""

    point: Vector
    first: Vector  # dF/dy_1
    second: Vector
    upward: Vector  # dF/dh

    def elements(self) -> tuple[Array, Array]:
        """The volume element det dF, with its sign, and the area element of the layer."""
        normal = cross(self.first, self.second)
        return dot(normal, self.upward), jnp.sqrt(dot(normal, normal))


class Domain(eqx.Module):
    """Base class of domains: tissue between two disjoint surfaces over a common base surface (paper, Definition 2).

    A point of the tissue is F(m, h) = (1 - h) S_a(m) + h S_b(m), where m is a point of the base surface and h is the
    height: 0 on the apical surface, 1 on the basal surface. The backbone at m is the segment from S_a(m) to S_b(m).
    Positions of backbones are points of the base surface: coordinates of shape [n, 2], or unit vectors of shape [n, 3].
    The dimensions of a domain are pytree leaves, so under `jax.jit` they can change without recompilation, and
    `jax.vmap` can map over them. Methods that take single points represent vectors as tuples of their components, each
    an array of any shape.
    """

    @property
    def base(self) -> Rectangle | UnitSphere:
        """Base surface on which the backbones are placed."""
        raise NotImplementedError

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates of a position, used as column names in tables of backbones."""
        return ("u", "v") if isinstance(self.base, Rectangle) else ("nx", "ny", "nz")

    def surfaces(self, m: Vector) -> tuple[Vector, Vector]:
        """Return the points S_a(m) and S_b(m) of the apical and the basal surface, as tuples of components."""
        raise NotImplementedError

    def frame(self, m: Vector, y: Vector, h: Array) -> Frame:
        """Return points and their derivatives at local coordinates y around the base point m, at height h."""

        def place(y: Vector) -> tuple[Vector, Vector]:
            apical, basal = self.surfaces(self.base.chart(m, y))
            upward = subtract(basal, apical)
            return add(apical, scale(h, upward)), upward

        one, none = jnp.ones_like(y[0]), jnp.zeros_like(y[0])
        (point, upward), (first, _) = jax.jvp(place, (y,), ((one, none),))
        _, (second, _) = jax.jvp(place, (y,), ((none, one),))
        return Frame(point, first, second, upward)

    def __repr__(self) -> str:
        return eqx.tree_pformat(self, width=1000, short_arrays=False)

    @usual_modes()
    def embed(self, positions: Float[Array | np.ndarray, "n d"]) -> Backbones:
        """Convert positions to backbones in Cartesian coordinates: segments from the apical to the basal surface.

        Args:
            positions: Positions of the backbones, shape [n, 2], or unit vectors of shape [n, 3]. May be traced.

        Returns:
            Named tuple with fields `apical` and `basal`, the Cartesian end points of the backbones, each of shape [n,
            3].
        """
        return Backbones(*map(rows, self.surfaces(components(jnp.asarray(positions)))))

    @usual_modes()
    def reflect(self, positions: Float[Array | np.ndarray, "n d"]) -> Float[Array, "n d"]:
        """Map positions back onto the base surface: reflect at free ends, wrap in closed and periodic directions.

        Args:
            positions: Positions of the backbones, shape [n, 2], or vectors of shape [n, 3], which are normalized. May
                be traced.

        Returns:
            Positions on the base surface, of the same shape.
        """
        return rows(self.base.wrap(components(jnp.asarray(positions))))

    @property
    def volume(self) -> float | Array:
        """Volume of the tissue in cubed length units, by quadrature of |det dF| to a relative error of about 1e-6."""
        return self._integral("volume")

    @property
    def apical_area(self) -> float | Array:
        """Area of the apical surface in squared length units, by quadrature to a relative error of about 1e-6."""
        return self._integral("apical")

    @property
    def basal_area(self) -> float | Array:
        """Area of the basal surface in squared length units, by quadrature to a relative error of about 1e-6."""
        return self._integral("basal")

    def layer_volume(self, heights: Float[Array, "layers"]) -> Float[Array, "layers"]:
        """Compute the integral of |det dF| over the layer at each of the given heights.

        Args:
            heights: Heights h of the layers, 0 (apical) to 1 (basal), shape [layers].

        Returns:
            One integral per layer, shape [layers]; the integral of these over h is the volume of the tissue.
        """
        return _layer_integral(self, jnp.asarray(heights), "volume")

    def _integral(self, what: str) -> float | Array:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self)):
            return _integral(self, what)
        with jax.ensure_compile_time_eval(), usual_modes(), double_precision():
            total = np.asarray(_compiled_integral(in_doubles(self), what), float)
        return float(total) if total.ndim == 0 else jnp.asarray(total)

    @usual_modes()
    def random_positions(self, key: PRNGKeyArray, count: int) -> Float[Array, "n d"]:
        """Draw positions uniformly with respect to the area of the apical surface (paper, section 4.2).

        Positions are drawn by rejection sampling and sorted by their first coordinate.

        Args:
            key: JAX random key.
            count: Number of backbones n, at least 1.

        Returns:
            Positions, shape [n, 2], or unit vectors of shape [n, 3].

        Raises:
            ValueError: If `count` is less than 1.
        """
        if count < 1:
            raise ValueError(f"count={count}: a tissue has at least one backbone; give at least 1")
        areas = np.asarray(_apical_areas(self, self.base.nodes(32)[0]), float)
        bound = 1.05 * areas.max()  # between the nodes it may be larger
        turns = max(8, math.ceil(20 * bound / areas.mean()))  # all are refused once in 1e9 points
        return _draw(self, key, count, turns, jnp.asarray(bound, jnp.result_type(float)))


def in_doubles(tree: Any) -> Any:
    """The same sizes in double precision, as arrays."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, float)), tree)


def _elements(domain: Domain, m: Vector, h: Array) -> tuple[Array, Array]:
    """Volume and area elements at points [...] of layers, [layers, 1]."""
    shape = jnp.broadcast_shapes(m[0].shape, h.shape)
    place = tuple(jnp.broadcast_to(part, shape) for part in m)
    return domain.frame(place, (jnp.zeros(shape, m[0].dtype),) * 2, h).elements()


def _layer_integral(domain: Domain, heights: Array, what: str) -> Array:
    points, weight = domain.base.nodes(NODES)
    volume, area = _elements(domain, points, heights[:, None])
    return ((jnp.abs(volume) if what == "volume" else area) * weight).sum(axis=-1)


def _integral(domain: Domain, what: str) -> Array:
    heights = {"volume": HEIGHTS, "apical": (0.0,), "basal": (1.0,)}[what]
    return _layer_integral(domain, jnp.array(heights), "volume" if what == "volume" else "area").mean()


_compiled_integral = jax.jit(_integral, static_argnames="what")


@jax.jit
def _apical_areas(domain: Domain, points: Vector) -> Array:
    return _elements(domain, points, jnp.zeros_like(points[0]))[1]


@functools.partial(jax.jit, static_argnames=("count", "turns"))
def _draw(domain: Domain, key: PRNGKeyArray, count: int, turns: int, bound: Array) -> Array:
    """The first proposal of each point that is taken."""
    drawn = jax.random.uniform(key, (3, turns, count))  # at once: each call of it takes a second to compile
    points = domain.base.place((drawn[0], drawn[1]))
    first = jnp.argmax(drawn[2] * bound < _apical_areas(domain, points), axis=0)
    place = rows(tuple(jnp.take_along_axis(part, first[None], axis=0)[0] for part in points))
    return place[jnp.argsort(place[:, 0])]  # neighbors are near in memory too
