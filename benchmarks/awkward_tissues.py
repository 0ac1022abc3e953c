"""Errors that no warning tells, on random tissues made to be awkward, against the exact path.

The kinds of `make` are those of the tissues on which earlier versions were wrong; they have up to 40 cells, so all
are traced. Two kinds more, helices and crowded bands, have 96 cells, which are measured on lines. A tissue counts as
silently wrong if a cell is off by more than a limit and no warning was given, and as a false alarm if there was a
warning and no cell is off by more than either limit.
"""

import math
import time
import warnings
from collections import Counter
from multiprocessing import get_context
from multiprocessing.context import TimeoutError
from typing import Any, NamedTuple

import common
import numpy as np

import jaxtissue as jt
from jaxtissue.tissue.refinement import LIMITS

COUNT, OWN = 1000, 40  # tissues of the known kinds, and of each further one
BASE = 77  # of the random numbers
SAMPLES = (50, 200, 800)  # of the exact path: more where it does not agree with what was measured
POINTS = 40_000  # at most, of all samples
SECONDS = 60.0  # for which the exact path is waited for: regular lattices can take Qhull hours
AGREED = 3e-4  # of the mean cell: no finer truth is asked for
NEAR = 0.3  # of the limits: with so small errors the last samples, which may take minutes, are left out
TOLERANCE = 1e-3
CELLS = (1, 2, 3, 4, 5, 6, 8, 11, 15, 20, 28, 40)
SHARES = (0.01, 0.04, 0.08, 0.08, 0.08, 0.1, 0.12, 0.13, 0.12, 0.1, 0.08, 0.06)
KINDS = {"uniform": 0.3, "clumps": 0.2, "rings": 0.12, "columns": 0.12, "half": 0.1, "lattice": 0.06, "pairs": 0.1}
ROWS = {1: 1, 2: 1, 3: 3, 4: 2, 5: 5, 6: 3, 8: 4, 11: 11, 15: 5, 20: 5, 28: 7, 40: 8}  # of lattices
MANY = 96  # cells of the further kinds


class Made(NamedTuple):
    """A tissue and its kind."""

    kind: str
    tube: jt.Tube
    positions: np.ndarray


def make(number: int, base: int = BASE) -> Made:
    """Tissue `number` of the known kinds: one to 40 cells in a thin, usual or thick wall, short or long."""
    draw = np.random.default_rng([base, number])
    n = int(draw.choice(CELLS, p=SHARES))
    wall = draw.random()
    if wall < 0.15:
        ratio = 1 + 10 ** draw.uniform(-3, -0.5)
    else:
        ratio = 10 ** (draw.uniform(0.1, 1.3) if wall < 0.85 else draw.uniform(1.3, 3))
    length = 10.0 * 10 ** draw.uniform(-1.0, 1.7)
    kind = list(KINDS)[int(draw.choice(len(KINDS), p=list(KINDS.values())))]
    place = _scatter(kind, n, draw)
    axial = np.abs(place[:, 0]) % 2
    axial = np.where(axial > 1, 2 - axial, axial)
    positions = np.stack([length * axial, 2 * np.pi * (place[:, 1] % 1)], axis=1)
    return Made(kind, jt.Tube(length, 10.0 / ratio, 10.0), positions)


def _scatter(kind: str, n: int, draw: np.random.Generator) -> np.ndarray:
    """Places in the unit square, which may stand a little beside it."""
    if kind == "uniform":
        return draw.random((n, 2))
    if kind == "clumps":
        middles, spread = draw.random((int(draw.integers(1, 5)), 2)), 10 ** draw.uniform(-3, -0.3)
        place = middles[draw.integers(len(middles), size=n)] + spread * draw.normal(size=(n, 2))
        far = draw.random(n) < 0.2
        place[far] = draw.random((far.sum(), 2))
        return place
    if kind in ("rings", "columns"):
        levels, jitter = draw.random(int(draw.integers(1, 5))), draw.choice([0, 1e-6, 1e-4, 1e-3, 1e-2])
        along = draw.random(n) if kind == "columns" else None
        level = levels[draw.integers(len(levels), size=n)] + jitter * draw.normal(size=n)
        return np.stack([level, draw.random(n)] if along is None else [along, level], axis=1)
    if kind == "half":
        return draw.random((n, 2)) * ([1, 0.5] if draw.random() < 0.5 else [0.5, 1])
    if kind == "lattice":
        i, j = np.divmod(np.arange(n), ROWS[n])
        shift, jitter = draw.choice([0, 0.5]), draw.choice([0, 1e-7, 1e-5, 1e-3, 1e-2])
        even = np.stack([(i + 0.5) / (n // ROWS[n]), (j + shift * (i % 2)) / ROWS[n]], axis=1)
        return even + jitter * draw.normal(size=(n, 2))
    middles, apart = draw.random(((n + 1) // 2, 2)), 10 ** draw.uniform(-5, -1)
    return np.concatenate([middles, middles + apart * draw.normal(size=middles.shape)])[:n]


def helix(number: int, base: int = BASE) -> Made:
    """Cells along a line that winds round the tube one to eight times, a little or much beside it."""
    draw = np.random.default_rng([base, 1, number])
    tube = jt.Tube(10 ** draw.uniform(0.7, 2.3), 10.0 / 10 ** draw.uniform(0.05, 2), 10.0)
    along = np.sort(draw.random(MANY)) if number % 2 else (np.arange(MANY) + 0.5) / MANY
    angle = 2 * np.pi * int(draw.integers(1, 9)) * along + draw.choice([0, 1e-4, 1e-2, 0.1]) * draw.normal(size=MANY)
    return Made("helix", tube, np.stack([float(tube.length) * along, angle % (2 * np.pi)], axis=1))


def bands(number: int, base: int = BASE) -> Made:
    """Cells of which most crowd in one to three bands across the tube, as narrow as a 300th of its length."""
    draw = np.random.default_rng([base, 2, number])
    tube = jt.Tube(10 ** draw.uniform(0.7, 2.3), 10.0 / 10 ** draw.uniform(0.05, 2), 10.0)
    middles, width = draw.random(int(draw.integers(1, 4))), 10 ** draw.uniform(-2.5, -1)
    share = middles[draw.integers(len(middles), size=MANY)] + width * draw.normal(size=MANY)
    free = draw.random(MANY) < 0.15
    share[free] = draw.random(free.sum())
    share = np.abs(share) % 2
    share = np.where(share > 1, 2 - share, share)
    return Made("bands", tube, np.stack([float(tube.length) * share, 2 * np.pi * draw.random(MANY)], axis=1))


def measure(made: Made, tolerance: float | None = None) -> tuple[np.ndarray, int]:
    """Volumes and lateral areas, [2, n], and the number of warnings."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        cells = jt.measure_tissue(made.positions, made.tube, tolerance=tolerance)
    return np.array([cells.volume, cells.lateral_area], float), len(told)


class Truth:
    """The exact path in a process of its own, which is ended when it takes too long."""

    def __init__(self) -> None:
        self.worker: Any = None

    def cells(self, made: Made, samples: int) -> Any:
        """The exact cells of a tissue. Raises `TimeoutError` where they take longer than `SECONDS`."""
        self.worker = self.worker or get_context("spawn").Pool(1)
        try:
            return self.worker.apply_async(jt.exact_cells, (made.positions, made.tube, samples)).get(SECONDS)
        except TimeoutError:
            self.worker.terminate()
            self.worker = None
            raise


TRUTH = Truth()


def errors(found: np.ndarray, made: Made) -> tuple[np.ndarray, int]:
    """The largest errors of V and A, as fractions of the mean cell, and the samples of the exact path; 0 for none."""
    n, off, used = len(made.positions), np.full(2, np.nan), 0
    mean = np.array([float(made.tube.volume) / n, 0.0])
    for samples in SAMPLES:
        if used and samples * n > POINTS:
            break
        try:
            exact = TRUTH.cells(made, samples)
        except (ValueError, RuntimeError):  # backbones that it can't tell apart
            continue
        except TimeoutError:
            break
        mean[1] = exact.lateral_area.mean() or 1.0
        right = np.stack([exact.volume, exact.lateral_area])
        off, used = np.abs(found - right).max(axis=1) / mean, samples
        if (off <= AGREED).all() or (samples >= SAMPLES[1] and (off <= NEAR * np.array(LIMITS)).all()):
            break
    return off, used


class Count:
    """What was found of the tissues of one generator."""

    def __init__(self) -> None:
        self.tissues, self.found, self.kinds = 0, Counter[str](), Counter[str]()
        self.worst: list[dict[str, Any]] = []
        self.agreement: list[float] = []

    def add(self, number: int, made: Made) -> None:
        """Measure a tissue and count what it shows."""
        found, told = measure(made)
        closely, _ = measure(made, TOLERANCE)
        off, samples = errors(found, made)
        close = off if np.array_equal(found, closely) else errors(closely, made)[0]
        self.tissues += 1
        self.kinds[made.kind] += 1
        over = off > LIMITS
        happened = {
            "warned": told > 0,
            "silent_volume": over[0] and not told,
            "silent_area": over[1] and not told,
            "false_alarms": told > 0 and not over.any() and samples > 0,
            "tolerance_met": (close <= TOLERANCE).all(),
            "without_truth": samples == 0,
        }
        self.found.update(name for name, so in happened.items() if so)
        if samples:
            self.agreement.append(float(close.max()))
        if told or over.any() or not (close <= TOLERANCE).all():
            row = {"number": number, "kind": made.kind, "cells": len(made.positions), "warnings": told}
            shown = dict(zip(("volume", "area"), (None if math.isnan(x) else float(x) for x in off), strict=True))
            self.worst.append(row | shown | {"samples": samples})
            print(self.worst[-1], flush=True)

    def told(self) -> dict[str, Any]:
        """The counts as shares of the tissues, and every tissue that was not right without a word."""
        names = ("silent_volume", "silent_area", "false_alarms", "tolerance_met", "warned", "without_truth")
        shares = {name: self.found[name] / max(self.tissues, 1) for name in names}
        quantiles = {f"{q:g}": float(np.quantile(self.agreement, q)) for q in (0.5, 0.95, 0.99)}
        return {"tissues": self.tissues, "shares": shares, "kinds": self.kinds, "agreement": quantiles,
                "not_quite": self.worst}  # fmt: skip


def main() -> None:
    """Count all and write the shares with the limits."""
    parser = common.options((__doc__ or "").split("\n")[0], "awkward_tissues")
    parser.add_argument("--tissues", type=int, default=COUNT, help="of the known kinds")
    parser.add_argument("--first", type=int, default=0, help="number of the first of these: the rest of a count")
    parser.add_argument("--own", type=int, default=OWN, help="of each of the two further kinds")
    arguments = parser.parse_args()
    makers = {"known": (make, arguments.tissues), "helix": (helix, arguments.own), "bands": (bands, arguments.own)}
    results: dict[str, Any] = {"limits": dict(zip(("volume", "area"), LIMITS, strict=True)), "tolerance": TOLERANCE}
    for name, (maker, count) in makers.items():
        begun, counted = time.perf_counter(), Count()
        begin = arguments.first if name == "known" else 0
        for number in range(begin, begin + count):
            counted.add(number, maker(number))
            if counted.tissues % 50 == 0 or counted.tissues == count:
                results[name] = counted.told() | {"seconds": time.perf_counter() - begun}
                print(name, counted.tissues, results[name]["shares"], flush=True)
                common.write(arguments.out, results | {"base": BASE})


if __name__ == "__main__":
    main()
