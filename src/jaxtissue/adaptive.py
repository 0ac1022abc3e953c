"""Cells measured one by one to a tolerance: exact sections, integrated over the radius (host, float64).

For cells that fixed lines can't resolve: narrow ones, nearly level ones, those with parts across the lumen.
The radius is cut by adaptive Gauss-Kronrod rules.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.sections import Surroundings, leave_out, measure_sections, surround
from jaxtissue.tube import Tube

HALVINGS = 12  # most of an interval of radii
SAFETY = np.array([[1.0], [2.0]])  # of the difference of rules of 7 and 15 nodes, for volume and lateral area
LEAST = np.array([[1e-6], [1e-4]])  # fractions of the means that are added to the errors

_KRONROD = np.array([
    0.991455371120812639206854697526329, 0.949107912342758524526189684047851,
    0.864864423359769072789712788640926, 0.741531185599394439863864773280788,
    0.586087235467691130294144691693869, 0.405845151377397166906606412076961,
    0.207784955007898467600689403773245, 0.0,
])  # fmt: skip
_WEIGHTS_15 = np.array([
    0.022935322010529224963732008058970, 0.063092092629978553290700663189204,
    0.104790010322250183839876322541518, 0.140653259715525918745189590510238,
    0.169004726639267902826583426598550, 0.190350578064785409913256402421014,
    0.204432940075298892414161999234649, 0.209482141084727828012999174891714,
])  # fmt: skip
NODES = np.concatenate([-_KRONROD, _KRONROD[-2::-1]])
FINE = np.concatenate([_WEIGHTS_15, _WEIGHTS_15[-2::-1]]) / 2
COARSE = np.zeros(15)
COARSE[1::2] = np.polynomial.legendre.leggauss(7)[1] / 2


class AdaptiveCells(NamedTuple):
    """Sizes of some cells, and bounds of the errors of volume and lateral area."""

    volume: Float[np.ndarray, " cells"]
    lateral_area: Float[np.ndarray, " cells"]
    volume_error: Float[np.ndarray, " cells"]
    lateral_area_error: Float[np.ndarray, " cells"]
    apical_area: Float[np.ndarray, " cells"]
    basal_area: Float[np.ndarray, " cells"]
    apical_perimeter: Float[np.ndarray, " cells"]
    basal_perimeter: Float[np.ndarray, " cells"]
    touches_end: Bool[np.ndarray, " cells"]


def measure_adaptively(
    positions: Float[np.ndarray, "n 2"],
    tube: Tube,
    cells: Int[np.ndarray, " cells"],
    rivals: Int[np.ndarray, "cells rivals"],
    tolerance: tuple[float, float],
    mean_area: float | None = None,
) -> AdaptiveCells:
    """Sizes of some cells, their volumes and lateral areas each to a tolerance.

    Tolerances are fractions of the mean volume of the tissue and of its mean lateral area, by default that of
    these cells.

    `rivals` are the backbones that may bound each cell, padded with the cell itself. Sections of a cell are
    integrated over the square root of the radius; an interval whose 7 and 15 nodes differ by more than its
    share of the tolerance is halved. The differences are added up as the error.
    """
    about = leave_out(surround(np.asarray(positions, float), tube, cells, rivals), tube)
    inner, outer = float(tube.apical_radius), float(tube.basal_radius)
    low, high = np.sqrt(inner), np.sqrt(outer)
    count = len(cells)
    total, error = np.zeros((2, count)), np.zeros((2, count))
    touches = np.zeros(count, bool)
    cell = np.arange(count)
    span = np.tile([low, high], (count, 1))
    mean = np.array([float(tube.volume) / len(positions), np.nan if mean_area is None else mean_area])
    for turn in range(HALVINGS + 1):
        value, off, at_end = _integrate(about, cell, span, tube)
        mean[1] = value[1].mean() if np.isnan(mean[1]) else mean[1]
        allowed = (np.array(tolerance) * mean)[:, None]
        np.logical_or.at(touches, cell, at_end)
        share = (span[:, 1] - span[:, 0]) / (high - low)
        enough = (off <= allowed * np.sqrt(share) / 2).all(axis=0) | (turn == HALVINGS)
        for k in (0, 1):
            total[k] += np.bincount(cell[enough], value[k][enough], count)
            error[k] += np.bincount(cell[enough], off[k][enough], count)
        cell, span = cell[~enough], span[~enough]
        if not len(cell):
            break
        middle = span.mean(axis=1)
        cell = np.repeat(cell, 2)
        span = np.stack([span[:, 0], middle, middle, span[:, 1]], axis=1).reshape(-1, 2)
    everyone = np.arange(count)
    surfaces = [measure_sections(about, everyone, np.full(count, radius), tube) for radius in (inner, outer)]
    touches |= surfaces[0].at_end | surfaces[1].at_end
    error += LEAST * mean[:, None]
    apical, basal = surfaces
    return AdaptiveCells(
        volume=total[0],
        lateral_area=total[1],
        volume_error=error[0],
        lateral_area_error=error[1],
        apical_area=inner * apical.length,
        basal_area=outer * basal.length,
        apical_perimeter=inner * apical.edge,
        basal_perimeter=outer * basal.edge,
        touches_end=touches,
    )


def _integrate(
    about: Surroundings, cell: np.ndarray, span: np.ndarray, tube: Tube
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Volumes and lateral areas within spans of the root of the radius, the difference of the two rules, and
    whether the tube's end is touched."""
    width = span[:, 1] - span[:, 0]
    root = span.mean(axis=1)[:, None] + width[:, None] / 2 * NODES
    found = measure_sections(about, np.repeat(cell, 15), (root**2).ravel(), tube)
    jacobian = 2 * root**3 * width[:, None]  # r dr
    parts = np.stack([found.length, found.wall]).reshape(2, -1, 15) * jacobian
    fine, coarse = parts @ FINE, parts @ COARSE
    at_end = np.logical_or.reduce(found.at_end.reshape(-1, 15), axis=1)
    return fine, SAFETY * np.abs(fine - coarse), at_end
