"""Checks of positions: input in any form is converted to one array of floats, or rejected."""

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import DTypeLike
from scipy.spatial import KDTree

from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.tube import Tube

AXES = "axial", "angle"  # on a tube
ROUNDING = 1e-6  # of the length: what single precision may put an end beyond the tube, rounded up
SAME = 8  # roundings of the angle by which a full turn more or less may be off
NEAR = 100  # roundings, in units of R_b and of the angle: nearer, volumes err by 1 % of a cell and more
FEW = 4  # nearest backbones, itself included, that are looked at
TILT = 0.1  # radians by which rounding of two places may turn the wall between them
NO_NUMBERS = str | bytes | bool | None  # though Python makes floats of some
STRAIGHT = (
    "tilted and bent backbones can only be measured (measure, compare), drawn and exported (view, export)"
    " and, on domains other than Tube, annealed and relaxed; give straight ones here, or for a tube a RoundTube"
    " (in domain files the shape round_tube)"
)
X64 = "use 64 bits (--x64, jax_enable_x64)"


class Rows(NamedTuple):
    """The names of rows of positions in messages: `prefix`, the noun for a row, and its number."""

    prefix: str = ""
    noun: str = "backbone"
    numbers: Sequence[int | str] | None = None

    def one(self, row: int) -> str:
        """The name of one row."""
        return f"{self.prefix}{self.noun} {self._number(row)}"

    def two(self, first: int, second: int) -> str:
        """The name of two rows."""
        return f"{self.prefix}{self.noun}s {self._number(first)} and {self._number(second)}"

    def of_nodes(self, count: int, nodes: int) -> "Rows":
        """The names of the nodes of so many backbones, where these have no numbers of their own."""
        if self.numbers is not None and len(self.numbers) == count * nodes:
            return self
        numbers = [f"{self._number(row)} (node {node})" for row in range(count) for node in range(nodes)]
        return self._replace(numbers=numbers)

    def _number(self, row: int) -> int | str:
        return row if self.numbers is None else self.numbers[row]


BACKBONES = Rows()


def as_positions(
    positions: PositionsLike, tube: Tube, dtype: DTypeLike | None = None, rows: Rows = BACKBONES, sizes: bool = True
) -> Float[np.ndarray, "n 2"]:
    """Positions as an array of floats, [n, 2], (axial, angle), with the axial position within the tube.

    The input may be anything that NumPy reads as real numbers: lists, arrays of any byte order and precision, whole
    numbers, and tables with the columns `axial` and `angle`, such as a pandas DataFrame, a dictionary or a structured
    array. It is converted once, to `dtype`, by default the precision that JAX works in. Axial positions beyond an end
    by a rounding of single precision are put on it, and angles of more than a turn are brought within one. Traced
    positions come back as they are. Where `sizes` are measured, warns of backbones so near each other that this
    precision gets volumes wrong by 1 % of a cell.

    Raises:
        ValueError: If the input holds no real numbers, masked or missing values, or another shape, if numbers are not
            finite or outside the tube, or if two backbones are one in this precision, also a full turn apart.

    >>> as_positions([[5, 0], [7, 1]], Tube(10, 1, 2))
    array([[5., 0.],
           [7., 1.]], dtype=float32)
    >>> as_positions([[5, 0], [11, 1]], Tube(10, 1, 2))
    Traceback (most recent call last):
    ValueError: backbone 1: axial=11.0 is outside the tube; give a value from 0 to 10.0
    """
    require_tube(tube)
    if isinstance(positions, Tracer):
        _check_shape(positions.shape)
        return positions  # type: ignore[return-value]
    given = as_numbers(positions)
    _check_shape(given.shape)
    for row, column in np.argwhere(~np.isfinite(given)).tolist():
        raise ValueError(f"{rows.one(row)}: {AXES[column]}={given[row, column]} is not a finite number; correct it")
    precision = np.dtype(jnp.result_type(float) if dtype is None else dtype)
    known = tube.length, tube.basal_radius
    if any(isinstance(size, Tracer) for size in known):
        return given.astype(precision)
    length, radius = map(float, known)
    half, axial = length / 2, given[:, 0]
    for row in np.flatnonzero(np.abs(axial - half) > half * (1 + ROUNDING)).tolist():
        raise ValueError(f"{rows.one(row)}: axial={axial[row]} is outside the tube; give a value from 0 to {length}")
    angle = given[:, 1]
    turned = np.where(np.abs(angle) > 2 * math.pi, np.mod(angle, 2 * math.pi), angle)  # lest digits be lost
    place = np.stack([np.clip(axial, 0, length), turned], axis=-1)
    rounded = place.astype(precision)
    near = _near_pairs(place, rounded, radius)
    _refuse_same(place, rounded, near, rows)
    if sizes and rounded.dtype == np.float32:
        _warn_of_near(place, rounded, near, rows)
    return rounded


def require_tube(domain: Any) -> None:
    """Raise `ValueError` for other domains than tubes, where only tubes are known."""
    if not isinstance(domain, Tube):
        told = f"a {type(domain).__name__} is not supported here"
        raise ValueError(f"{told}; give a Tube, or measure the cells with measure_tissue")


def as_numbers(positions: Any, names: tuple[str, ...] = AXES) -> Float[np.ndarray, "..."]:
    """Real numbers of any kind in double precision; those of tables by the names of columns, in any case."""
    if columns := _columns(positions, names):
        return np.stack([as_numbers(positions[name]) for name in columns], axis=-1)
    try:
        if np.ma.is_masked(positions):
            raise ValueError("some are masked")
        given = np.asarray(positions)
        if given.dtype == object:
            others = {type(value).__name__ for value in given.flat if isinstance(value, NO_NUMBERS)}
            if others:
                raise TypeError(f"some are of type {', '.join(sorted(others))}")
        elif not (jnp.issubdtype(given.dtype, np.integer) or jnp.issubdtype(given.dtype, np.floating)):
            raise TypeError(f"they are of type {given.dtype}")
        return given.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"positions must be real numbers ({reason}); give rows ({', '.join(names)})") from error


def _columns(positions: Any, names: tuple[str, ...]) -> list[str]:
    """The columns of a table that have the names; none of what is no table, or has numbers for names."""
    fields = getattr(getattr(positions, "dtype", None), "names", None)
    given = positions.keys() if isinstance(positions, Mapping) else fields or getattr(positions, "columns", ())
    known = {name.strip().lower(): name for name in given if isinstance(name, str)}
    if known and not set(names) <= set(known):
        raise ValueError(f"positions have the columns {', '.join(known)}; rename the columns to {', '.join(names)}")
    return [known[name] for name in names] if known else []


def _check_shape(shape: tuple[int, ...]) -> None:
    if len(shape) == 3:
        raise ValueError(f"positions have shape {shape}: {STRAIGHT}")
    if len(shape) != 2 or shape[1] != 2 or not shape[0]:
        raise ValueError(f"positions have shape {shape}; give shape [n, 2] with n >= 1 and rows (axial, angle)")


class _Near(NamedTuple):
    """Pairs of backbones i < j, in order, their distances as rounded, and how far rounding moved them."""

    pairs: Int[np.ndarray, "m 2"]
    apart: Float[np.ndarray, " m"]  # on the basal surface, in units of R_b
    moved: Float[np.ndarray, " m"]
    level: Bool[np.ndarray, " m"]


def _near_pairs(place: Float[np.ndarray, "n 2"], rounded: Float[np.ndarray, "n 2"], radius: float) -> _Near:
    """The pairs that rounding may make one, or whose wall it may turn.

    Each backbone is paired with its nearest ones; of backbones exactly at one place only neighbors in the order.
    """
    axial, angle = rounded[:, 0].astype(float) / radius, rounded[:, 1].astype(float)
    shift = (np.abs(rounded - place) * [1 / radius, 1]).max(axis=1)
    within = max(NEAR * float(np.finfo(rounded.dtype).eps), shift.max() / TILT)
    pairs = np.empty((0, 2), int)
    if (np.diff(np.sort(axial)) <= within).any():  # seldom
        order = np.lexsort((angle, axial))
        once = np.append(True, (np.diff(rounded[order], axis=0) != 0).any(axis=1))
        pairs = np.stack([order[:-1], order[1:]], axis=1)[~once[1:]]
        order = order[once]
        close = np.diff(axial[order]) <= within
        some = order[np.append(close, False) | np.append(False, close)]
        if len(some):
            ring = np.stack([axial[some], np.cos(angle[some]), np.sin(angle[some])], axis=-1)
            found = np.asarray(KDTree(ring).query(ring, FEW, distance_upper_bound=within)[1])
            row, column = np.nonzero(found < len(some))
            pairs = np.concatenate([pairs, np.stack([some[row], some[found[row, column]]], axis=1)])
        pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    first, second = pairs.T
    chord = 2 * np.sin((angle[first] - angle[second]) / 2)
    apart = np.hypot(axial[first] - axial[second], chord)
    return _Near(pairs, apart, np.maximum(shift[first], shift[second]), axial[first] == axial[second])


def _refuse_same(place: Float[np.ndarray, "n 2"], rounded: Float[np.ndarray, "n 2"], near: _Near, rows: Rows) -> None:
    """Raise `ValueError` for two backbones that are one as rounded."""
    limits = np.finfo(rounded.dtype)
    for i, j in near.pairs[near.level & (near.apart <= SAME * float(limits.eps))].tolist():
        same = f"are the same backbone, axial={place[i, 0]}, angle={place[i, 1]}; remove one of them"
        digits = f" (or {X64} if they differ beyond {limits.precision + 1} digits)"
        raise ValueError(f"{rows.two(i, j)} {same}{digits if rounded.dtype == np.float32 else ''}")


def _warn_of_near(place: Float[np.ndarray, "n 2"], rounded: Float[np.ndarray, "n 2"], near: _Near, rows: Rows) -> None:
    """Warn of backbones so near that this precision cannot measure their cells."""
    first, second = near.pairs.T
    # walls between backbones that stand level are radial: rounding does not tilt them
    tilted = ~(near.level & (place[first, 0] == place[second, 0]))
    least = np.maximum(NEAR * float(np.finfo(rounded.dtype).eps), near.moved / TILT)
    told = np.flatnonzero(tilted & (near.apart < least))
    if len(told):
        pair = told[near.apart[told].argmin()]
        more = f" (and {len(told) - 1} more pairs)" if len(told) > 1 else ""
        found = f"{rows.two(first[pair], second[pair])}{more} are too close to each other for {rounded.dtype}"
        warnings.warn(f"{found}: the sizes of their cells may be wrong by 1 % or more; {X64}", stacklevel=4)


def as_rows(positions: Any, names: tuple[str, ...], cells: int, bent: bool = False) -> Any:
    """Positions, traced or not, as floats with a row for each of the `cells` that lists or a state were made for.

    Floats that JAX holds keep their precision. Where backbones stand is not looked at. With `bent` they may be nodes.

    >>> as_rows([[5, 0], [7, 1]], ("axial", "angle"), 3)
    Traceback (most recent call last):
    ValueError: 2 positions for neighbor lists of 3 cells; allocate new neighbor lists
    """
    precision = jnp.result_type(float)
    if not isinstance(positions, Array):
        positions = as_numbers(positions, names).astype(precision)
    elif not jnp.issubdtype(positions.dtype, np.floating) or positions.dtype.itemsize < 4:
        positions = positions.astype(precision)
    has_nodes = bent and positions.ndim == 3 and positions.shape[2] in (len(names), len(names) + 1)
    if not has_nodes and (positions.ndim != 2 or positions.shape[1] != len(names)):
        raise ValueError(
            f"positions have shape {positions.shape}; give shape [n, {len(names)}] with rows ({', '.join(names)})"
        )
    if len(positions) != cells:
        raise ValueError(f"{len(positions)} positions for neighbor lists of {cells} cells; allocate new neighbor lists")
    return positions


def check_count(cells: int, domain: Any, mean_volume: Any, within: float = 0.01) -> None:
    """Raise `ValueError` unless that number of cells of the mean volume fills the tube or other domain.

    The number may be off by `within`. Of sizes that are traced nothing is known.

    >>> check_count(25, Tube(10, 1, 2), Tube(10, 1, 2).volume / 20)
    Traceback (most recent call last):
    ValueError: 25 backbones for a model of 20 cells; make the model with tube_model(tube, 25)
    """
    total = domain.volume
    if isinstance(total, Tracer) or isinstance(mean_volume, Tracer):
        return
    fitting = float(total) / float(mean_volume)
    if not math.isclose(fitting, cells, rel_tol=1e-5, abs_tol=within):  # sizes may be single precision
        raise ValueError(
            f"{cells} backbones for a model of {fitting:.6g} cells; make the model with tube_model(tube, {cells})"
        )
