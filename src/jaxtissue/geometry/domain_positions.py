"""The gate for positions on any domain: input of any form becomes one array of floats, or is refused in one line."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float
from numpy.typing import DTypeLike
from scipy.spatial import KDTree

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.positions import BACKBONES, ROUNDING, SAME, X64, Rows, as_numbers, as_positions
from jaxtissue.geometry.tube import Tube

SHORT = 0.1  # the least length of a vector that is a direction


def column_names(domain: Tube | Domain) -> tuple[str, ...]:
    """The names of the coordinates of a position, as in tables of backbones."""
    return domain.columns if isinstance(domain, Domain) else ("axial", "angle")


def as_positions_on(
    positions: Any,
    domain: Tube | Domain,
    dtype: DTypeLike | None = None,
    rows: Rows = BACKBONES,
    sizes: bool = True,
) -> Float[np.ndarray, "n d"]:
    """Positions on a tube or any other domain, by `as_positions` or `as_domain_positions`."""
    if isinstance(domain, Domain):
        return as_domain_positions(positions, domain, dtype, rows)
    return as_positions(positions, domain, dtype, rows, sizes)


@usual_modes()
def as_domain_positions(
    positions: Any, domain: Domain, dtype: DTypeLike | None = None, rows: Rows = BACKBONES
) -> Float[np.ndarray, "n d"]:
    """Positions on a domain as an array of floats, [n, d], within it: unit vectors normalized, periods taken off.

    The input may be anything that NumPy reads as real numbers, and tables with the domain's columns.

    Raises:
        ValueError: If the input holds no real numbers or has another shape, if numbers are not finite or outside the
            domain, if a vector has no direction, or if two backbones are one in this precision.

    >>> from jaxtissue.geometry.shapes import Sphere
    >>> as_domain_positions([[0, 0, 2], [3, 0, 0]], Sphere(1, 2)).tolist()
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    """
    columns = domain.columns
    if isinstance(positions, Tracer):
        return positions  # type: ignore[return-value]
    given = as_numbers(positions, columns)
    if given.ndim != 2 or given.shape[1] != len(columns) or not len(given):
        wanted = f"give ({', '.join(columns)}) rows, [n, {len(columns)}], n >= 1"
        raise ValueError(f"positions of shape {given.shape}: {wanted}")
    for row, column in np.argwhere(~np.isfinite(given)).tolist():
        raise ValueError(f"{rows.one(row)}: {columns[column]}={given[row, column]} is not a finite number; correct it")
    place = _within(given, domain, rows)
    rounded = place.astype(np.dtype(jnp.result_type(float) if dtype is None else dtype))
    _refuse_same(rounded, domain, rows)
    return rounded


def _within(given: np.ndarray, domain: Domain, rows: Rows) -> np.ndarray:
    place, base = given.copy(), domain.base
    if not isinstance(base, Rectangle):
        size = np.linalg.norm(given, axis=1)
        for row in np.flatnonzero(~(size > SHORT)).tolist():
            raise ValueError(f"{rows.one(row)}: {tuple(given[row])} has no direction; give a unit vector")
        return place / size[:, None]
    for k, (extent, direction) in enumerate(zip(base.extent, base.directions, strict=True)):
        length = float(extent)
        if direction != "free":
            place[:, k] = np.mod(place[:, k], length) % length
            continue
        half = length / 2
        for row in np.flatnonzero(np.abs(given[:, k] - half) > half * (1 + ROUNDING)).tolist():
            told = f"{domain.columns[k]}={given[row, k]} is outside the tissue; give 0 to {length:g}"
            raise ValueError(f"{rows.one(row)}: {told}")
        place[:, k] = np.clip(place[:, k], 0, length)
    return place


def _refuse_same(place: np.ndarray, domain: Domain, rows: Rows) -> None:
    with double_precision():
        ends = np.asarray(_embed(in_doubles(domain), jnp.asarray(place, float)))
    size = np.ptp(ends, axis=0).max()
    for i, j in sorted(KDTree(ends).query_pairs(SAME * float(np.finfo(place.dtype).eps) * max(size, 1e-300))):
        same = f"are the same backbone, {', '.join(f'{v:.7g}' for v in place[i])}; remove one"
        raise ValueError(f"{rows.two(i, j)} {same}" + f" (or {X64})" * (place.dtype == np.float32))


@jax.jit
def _embed(domain: Domain, positions: jax.Array) -> jax.Array:
    return domain.embed(positions).basal
