"""Checks of positions on any domain: input in any form is converted to one array of floats, or rejected."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float
from numpy.typing import DTypeLike
from scipy.spatial import KDTree

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.backbones import Backbones
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.nodes import ENDS, as_domain, as_nodes, domain_of, has_nodes, heights_of, node_points
from jaxtissue.geometry.positions import AXES, BACKBONES, ROUNDING, SAME, STRAIGHT, X64, Rows, as_numbers, as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.geometry.vectors import rows as as_rows

SHORT = 0.1  # the least length of a vector that is a direction


def column_names(domain: Tube | Domain) -> tuple[str, ...]:
    """The names of the coordinates of a position, as in tables of backbones."""
    return domain.columns if isinstance(domain, Domain) else AXES


def as_positions_on(
    positions: PositionsLike,
    domain: Tube | Domain,
    dtype: DTypeLike | None = None,
    rows: Rows = BACKBONES,
    sizes: bool = True,
    bent: bool = False,
) -> Float[np.ndarray, "n d"]:
    """Positions on a tube or any other domain, by `as_positions` or `as_domain_positions`."""
    domain = domain_of(domain, positions) if bent else domain
    if isinstance(domain, Domain):
        return as_domain_positions(positions, domain, dtype, rows, bent)
    return as_positions(positions, domain, dtype, rows, sizes)


def ends_in_space(
    positions: Float[np.ndarray, "n d"], domain: Tube | Domain
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """The apical and basal ends of straight backbones in Cartesian coordinates, in float64; on the host."""
    with usual_modes(), double_precision():
        ends = _embed_ends(in_doubles(domain), jnp.asarray(np.asarray(positions, float)))
    return np.asarray(ends.apical), np.asarray(ends.basal)


def nodes_in_space(
    positions: Float[np.ndarray, "n d"] | Float[np.ndarray, "n k d"], domain: Tube | Domain
) -> Float[np.ndarray, "n k 3"]:
    """The nodes of backbones in Cartesian coordinates, in float64; of straight ones both ends."""
    if not has_nodes(positions):
        return np.stack(ends_in_space(positions, domain), axis=1)
    with usual_modes(), double_precision():
        return np.asarray(_embed_nodes(in_doubles(as_domain(domain)), jnp.asarray(np.asarray(positions, float))))


def place_columns(positions: Float[np.ndarray, "n d"], domain: Tube | Domain) -> dict[str, np.ndarray]:
    """The coordinates of backbones by names of columns, with the end before those of tilted and bent ones."""
    names = column_names(domain)
    if positions.ndim == 2:
        return dict(zip(names, positions.T, strict=True))
    ends = zip(ENDS, (positions[:, 0], positions[:, -1]), strict=True)
    return {f"{end}_{name}": place[:, k] for end, place in ends for k, name in enumerate(names)}


@usual_modes()
def as_domain_positions(
    positions: PositionsLike, domain: Domain, dtype: DTypeLike | None = None, rows: Rows = BACKBONES, bent: bool = False
) -> Float[np.ndarray, "n *k d"]:
    """Positions on a domain as an array of floats, [n, d], within it: unit vectors normalized, periods taken off.

    The input may be anything that NumPy reads as real numbers, and tables with the domain's columns. With `bent` it may
    be that of tilted and bent backbones too, [n, k, d] or [n, k, d + 1], as `geometry.nodes` has them.

    Raises:
        ValueError: If the input holds no real numbers or has another shape, if numbers are not finite or outside the
            domain, if a vector has no direction, if two backbones are one in this precision or meet at a node, or if
            heights of nodes don't rise from 0 to 1.

    >>> from jaxtissue.geometry.shapes import Sphere
    >>> as_domain_positions([[0, 0, 2], [3, 0, 0]], Sphere(1, 2)).tolist()
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    """
    columns = domain.columns
    if isinstance(positions, Tracer):
        return positions  # type: ignore[return-value]
    given = as_numbers(positions, columns)
    if has_nodes(given):
        if not bent:
            raise ValueError(f"positions have shape {given.shape}: {STRAIGHT}")
        return _with_nodes(given, domain, dtype, rows)
    if given.ndim != 2 or given.shape[1] != len(columns) or not len(given):
        wanted = f"give shape [n, {len(columns)}] with n >= 1 and rows ({', '.join(columns)})"
        raise ValueError(f"positions have shape {given.shape}; {wanted}")
    _refuse_infinite(given, columns, rows)
    place = _within(given, domain, rows)
    rounded = place.astype(np.dtype(jnp.result_type(float) if dtype is None else dtype))
    _refuse_same(rounded, domain, rows)
    return rounded


def _with_nodes(
    given: Float[np.ndarray, "n k d"], domain: Domain, dtype: DTypeLike | None, rows: Rows
) -> Float[np.ndarray, "n k d"]:
    """The same for positions of nodes."""
    columns, (n, k, size) = domain.columns, given.shape
    d = len(columns)
    if not n or k < 2 or size not in (d, d + 1):
        wanted = f"give ({', '.join(columns)}) for k >= 2 nodes per backbone, shape [n, k, {d}]"
        wanted += f", or also the height of each node, shape [n, k, {d + 1}]"
        raise ValueError(f"positions have shape {given.shape}; {wanted}")
    nodes = rows.of_nodes(n, k)
    _refuse_infinite(given.reshape(n * k, size), (*columns, "height"), nodes)
    height = heights_of(given, domain)
    falls = (height[:, 0] != 0) | (height[:, -1] != 1) | ~(np.diff(height, axis=1) > 0).all(axis=1)
    for row in np.flatnonzero(falls).tolist():
        told = ", ".join(f"{value:g}" for value in height[row])
        raise ValueError(f"{nodes.one(row * k)}: the node heights {told} do not increase from 0 to 1; correct them")
    place = given.copy()
    place[..., :d] = _within(given[..., :d].reshape(n * k, d), domain, nodes).reshape(n, k, d)
    rounded = place.astype(np.dtype(jnp.result_type(float) if dtype is None else dtype))
    with double_precision():
        points = np.asarray(_embed_nodes(in_doubles(domain), jnp.asarray(rounded, float))).reshape(n * k, 3)
    for i, j in _same(points, rounded.dtype):
        told = (
            f"have the same position, {', '.join(f'{v:.7g}' for v in place.reshape(n * k, size)[i])}; move one of them"
        )
        raise ValueError(f"{nodes.two(i, j)} {told}")
    return rounded


def _refuse_infinite(given: Float[np.ndarray, "n d"], columns: tuple[str, ...], rows: Rows) -> None:
    for row, column in np.argwhere(~np.isfinite(given)).tolist():
        raise ValueError(f"{rows.one(row)}: {columns[column]}={given[row, column]} is not a finite number; correct it")


def _within(given: np.ndarray, domain: Domain, rows: Rows) -> np.ndarray:
    place, base = given.copy(), domain.base
    if not isinstance(base, Rectangle):
        size = np.linalg.norm(given, axis=1)
        for row in np.flatnonzero(~(size > SHORT)).tolist():
            raise ValueError(
                f"{rows.one(row)}: {tuple(given[row])} has no direction because its length is 0; give a unit vector"
            )
        return place / size[:, None]
    for k, (extent, direction) in enumerate(zip(base.extent, base.directions, strict=True)):
        length = float(extent)
        if direction != "free":
            place[:, k] = np.mod(place[:, k], length) % length
            continue
        half = length / 2
        for row in np.flatnonzero(np.abs(given[:, k] - half) > half * (1 + ROUNDING)).tolist():
            told = f"{domain.columns[k]}={given[row, k]} is outside the tissue; give a value from 0 to {length:g}"
            raise ValueError(f"{rows.one(row)}: {told}")
        place[:, k] = np.clip(place[:, k], 0, length)
    return place


def _refuse_same(place: np.ndarray, domain: Domain, rows: Rows) -> None:
    with double_precision():
        ends = np.asarray(_embed(in_doubles(domain), jnp.asarray(place, float)))
    for i, j in _same(ends, place.dtype):
        same = f"are the same backbone, {', '.join(f'{v:.7g}' for v in place[i])}; remove one of them"
        raise ValueError(f"{rows.two(i, j)} {same}" + f" (or {X64})" * (place.dtype == np.float32))


def _same(points: Float[np.ndarray, "p 3"], dtype: np.dtype) -> list[tuple[int, int]]:
    """The pairs of points that are one in this precision."""
    size = np.ptp(points, axis=0).max()
    return sorted(KDTree(points).query_pairs(SAME * float(np.finfo(dtype).eps) * max(size, 1e-300)))


@jax.jit
def _embed(domain: Domain, positions: jax.Array) -> jax.Array:
    return domain.embed(positions).basal


@jax.jit
def _embed_nodes(domain: Domain, positions: jax.Array) -> jax.Array:
    return as_rows(node_points(as_nodes(positions, domain), domain))


@jax.jit
def _embed_ends(domain: Tube | Domain, positions: jax.Array) -> Backbones:
    return domain.embed(positions)
