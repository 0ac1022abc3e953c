"""Laws of connectivity: number of neighbors as a function of the surface ratio, and the bounds set by the tightness.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.special import expit

from jaxtissue.diagram.spread import covering_radius, neighbor_bound, separation, tube_neighbor_bound
from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.contacts import Contacts
from jaxtissue.topology.statistics import Connectivity

EXTREME = 50.0  # ln of a surface ratio that no tissue has


@dataclass(frozen=True)
class NeighborLaw:
    """Mean number of neighbors as a logistic function of ln s, where s = R_b / R_a is the surface ratio.

    N(s) = low + (high - low) / (1 + exp(-steepness (ln s - ln middle))), called "Flintstones' law" (paper, section 4.4,
    Fig. 12).

    Attributes:
        low: Limit of N for s -> 0.
        high: Limit of N for s -> infinity.
        middle: Surface ratio at which N is halfway between `low` and `high`.
        steepness: Steepness with respect to ln s, dimensionless.
        standard_errors: Standard errors of the four parameters, by name; NaN if only four points were fitted.
        residual: Root-mean-square residual of the fit.
        r2: Coefficient of determination: fraction of the variance explained by the law.

    >>> NeighborLaw(6, 10, 5, 1, {}, 0, 1).predict([5, 1e9]).round(3).tolist()
    [8.0, 10.0]
    """

    low: float
    high: float
    middle: float
    steepness: float
    standard_errors: dict[str, float]
    residual: float
    r2: float

    def predict(self, ratios: ArrayLike) -> Float[np.ndarray, "..."]:
        """Compute the mean number of neighbors at given surface ratios.

        Args:
            ratios: Surface ratios R_b / R_a, greater than 0, of any shape.

        Returns:
            N(s), of the same shape.
        """
        shape = self.low, self.high, math.log(self.middle), self.steepness
        return _logistic(np.log(np.asarray(ratios, float)), *shape)

    __call__ = predict


def fit_neighbor_law(ratios: ArrayLike, neighbors: ArrayLike) -> NeighborLaw:
    """Fit the logistic neighbor law to mean numbers of neighbors by unweighted least squares (paper, Fig. 12).

    Args:
        ratios: Surface ratios R_b / R_a, greater than 0, shape [k], with at least four different values.
        neighbors: Mean number of neighbors at each ratio, shape [k].

    Returns:
        A `NeighborLaw`, N(s) = low + (high - low) / (1 + exp(-steepness (ln s - ln middle))) with s = R_b / R_a. Its
        fields are these four parameters, `standard_errors` (a dict by name), `residual` (root mean square) and `r2`;
        `predict(ratios)` evaluates it.

    Raises:
        ValueError: If there are fewer than four different ratios, if a value is not finite or a ratio is not positive,
            or if no logistic function fits, for example because `neighbors` does not level off.

    >>> law = fit_neighbor_law(ratios=[1, 2, 5, 10, 50], neighbors=[6.667, 7.143, 8.0, 8.667, 9.636])
    >>> round(law.low, 1), round(law.high, 1), round(law.middle, 1), round(law.steepness, 1)
    (6.0, 10.0, 5.0, 1.0)
    >>> law.predict([5, 1e9]).round(2).tolist()
    [8.0, 10.0]
    """
    from scipy.optimize import OptimizeWarning, curve_fit  # takes a fifth of a second to import

    ratio, found = np.asarray(ratios, float), np.asarray(neighbors, float)
    if ratio.shape != found.shape or ratio.ndim != 1 or len(np.unique(ratio)) < 4:
        raise ValueError(
            f"ratios have shape {ratio.shape}, neighbors {found.shape}; give both for at least four different ratios"
        )
    if not (np.isfinite(ratio).all() and np.isfinite(found).all() and (ratio > 0).all()):
        raise ValueError("ratios and neighbors must be finite, and ratios above 0; remove the others")
    place, spread = np.log(ratio), np.ptp(found)
    rising = np.polyfit(place, found, 1)[0] >= 0
    start = found.min(), found.max(), place.mean(), (4 if rising else -4) / np.ptp(place)
    try:
        if spread == 0:
            raise RuntimeError("they are all the same")
        with warnings.catch_warnings():  # of errors that are not numbers, as they are then returned
            warnings.simplefilter("ignore", OptimizeWarning)
            best, covariance = curve_fit(_logistic, place, found, start, maxfev=5_000, xtol=1e-12, ftol=1e-12)
        if abs(best[2]) > EXTREME:
            raise RuntimeError("they do not level off")
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        remedy = "give ratios from near 1 up to where the number of neighbors levels off"
        raise ValueError(f"no logistic function fits the neighbors ({reason}); {remedy}") from error
    low, high, middle, steepness = best.tolist()
    if steepness < 0:  # the same function with its ends exchanged
        low, high, steepness = high, low, -steepness
    error = np.sqrt(np.diag(covariance)) if len(found) > 4 else np.full(4, math.nan)
    error = error[[1, 0, 2, 3]] if best[3] < 0 else error
    off = found - _logistic(place, *best)
    names = ("low", "high", "middle", "steepness")
    errors: dict[str, float] = dict(zip(names, (error * [1, 1, math.exp(middle), 1]).tolist(), strict=True))
    r2 = 1 - (off**2).mean() / found.var()
    return NeighborLaw(low, high, math.exp(middle), steepness, errors, math.sqrt((off**2).mean()), float(r2))


def bound_ratios(
    positions: PositionsLike,
    tube: Tube,
    connectivity: Connectivity,
    hops: Sequence[int] = (1, 2, 3),
) -> list[dict[str, Any]]:
    """Compare a tissue with the bounds of Lemma 1, Lemma 2 and Corollary 1 (paper, section 2).

    The measured value is the maximum, over the cells, of the number of neighbors (Lemmas 1 and 2) or of the number of
    other cells within h contacts (Corollary 1). Corollary 1 gives only the order O(phi^2 h^2); here its limit is 4 (2 h
    phi + 1/2)^2, with the constant of Lemma 2.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`.
        tube: The tube.
        connectivity: Result of `find_connectivity` for this tissue.
        hops: Numbers of contacts h for which to evaluate Corollary 1. Defaults to (1, 2, 3).

    Returns:
        One dictionary per bound, with keys `bound` ("Lemma 1", "Lemma 2" or "Corollary 1"), `hops`, `measured`,
        `limit`, `ratio` (measured / limit, at most 1 if the bound holds) and `tightness` (phi, the covering radius
        divided by the separation; see the glossary).

    Raises:
        ValueError: If a position is not finite, lies outside the tube, or coincides with another.

    >>> from jaxtissue import find_connectivity
    >>> place, tube = [[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2)
    >>> rows = bound_ratios(place, tube, find_connectivity(place, tube), hops=[2])
    >>> [(row["bound"], row["measured"], row["ratio"] < 1) for row in rows]
    [('Lemma 1', 3, True), ('Lemma 2', 3, True), ('Corollary 1', 3, True)]
    """
    place = as_positions(positions, tube, sizes=False)
    apart = float(separation(place, tube))
    phi = float(covering_radius(place, tube)) / apart if apart > 0 else math.inf
    length = float(tube.basal_radius - tube.apical_radius) / apart if apart > 0 else math.inf
    reached = _count_within(connectivity.contacts, max([1, *hops]))
    rows = [("Lemma 1", 1, neighbor_bound(phi, length)), ("Lemma 2", 1, tube_neighbor_bound(phi))]
    rows += [("Corollary 1", hop, tube_neighbor_bound(phi, hop)) for hop in hops]
    return [
        {"bound": name, "hops": hop, "measured": reached[hop], "limit": limit}
        | {"ratio": reached[hop] / limit, "tightness": phi}
        for name, hop, limit in rows
    ]


def _logistic(place: np.ndarray, low: float, high: float, middle: float, steepness: float) -> np.ndarray:
    return low + (high - low) * expit(steepness * (place - middle))


def _count_within(contacts: Contacts, hops: int) -> dict[int, int]:
    """The most other cells that any cell has within 1, 2, ... hops."""
    first, second = contacts.pairs.T
    size = (contacts.cells, contacts.cells)
    half = sparse.coo_array((np.ones(len(first), np.int32), (first, second)), shape=size)
    one = (half + half.T + sparse.eye_array(contacts.cells)).astype(np.int32).tocsr()
    reached, most = one, {}
    for hop in range(1, hops + 1):
        most[hop] = int(np.diff(reached.indptr).max()) - 1
        reached = reached @ one
        reached.data[:] = 1
    return most
