"""The share of scutoids over the anisotropy of stretch, on tubes, tori and spheroids: do they lie on one curve?

    python benchmarks/stretch.py [--out FILE]

Cells of random tissues, uniform by apical area, are taken together by their own stretch anisotropy, whatever their
tissue; those that touch an end are left out. Beside the JSON a picture is written.
"""

import math
from itertools import pairwise
from typing import Any

import common
import jax
import numpy as np
from matplotlib.figure import Figure

import jaxtissue as jt

CELLS, SEEDS = 400, (0, 1)
RATIOS = (1.1, 1.25, 1.5, 2.0, 2.5, 3.0)
EDGES = np.array([1, 1.05, 1.1, 1.15, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6, 1.8, 2, 2.5, 3, 3.5])  # of the anisotropy
FEW = 60  # cells, below which a bin is not shown


def shapes() -> dict[str, list[Any]]:
    """The domains of each kind."""
    return {
        "tube, ratio 1.1 to 3": [jt.RoundTube(6, 1, ratio, periodic=True) for ratio in RATIOS],
        "bent tube, 4 round 1 to 2": [jt.BentTube(4, 1.5, 1, 2)],
        "torus, 4 round 1 to 1.3 and 2": [jt.BentTube(4, 2 * math.pi, 1, outer) for outer in (1.3, 2)],
        "spheroid (3, 1, 1), thickness 1": [jt.Ellipsoid([3, 1, 1], [4, 2, 2])],
        "spheroid (1, 1, 0.4), thickness 0.2": [jt.Ellipsoid([1, 1, 0.4], [1.2, 1.2, 0.6])],
    }


def shares(domains: list[Any]) -> list[dict[str, float]]:
    """The share of scutoids in each bin of the anisotropy, with its standard error."""
    stretch, scutoid = [], []
    for domain in domains:
        for seed in SEEDS:
            positions = domain.random_positions(jax.random.key(seed), CELLS)
            try:
                found = jt.find_connectivity(positions, domain)
            except ValueError as error:  # of cells that go round
                print(f"left out, seed {seed}: {error}", flush=True)
                continue
            inner = ~found.is_end
            stretch.append(found.stretch_anisotropy[inner])
            scutoid.append(found.transitions.is_scutoid[inner])
    if not stretch:
        return []
    every, is_scutoid = np.concatenate(stretch), np.concatenate(scutoid)
    rows = []
    for low, high in pairwise(EDGES.tolist()):
        own = (every >= low) & (every < high)
        count, share = int(own.sum()), float(is_scutoid[own].mean()) if own.any() else math.nan
        if count >= FEW:
            error = math.sqrt(max(share * (1 - share), 1 / count) / count)
            rows.append({"anisotropy": float(every[own].mean()), "share": share, "error": error, "cells": count})
    return rows


def off_the_tube(rows: list[dict[str, float]], tube: list[dict[str, float]]) -> dict[str, float]:
    """How far shares are from those of tubes of the same anisotropy, as the mean and in standard errors."""
    place, curve, error = ([row[name] for row in tube] for name in ("anisotropy", "share", "error"))
    place, curve, error = [1.0, *place], [0.0, *curve], [0.0, *error]  # a flat sheet has none
    differences = [row["share"] - float(np.interp(row["anisotropy"], place, curve)) for row in rows]
    noise = [math.hypot(row["error"], float(np.interp(row["anisotropy"], place, error))) for row in rows]
    scores = [off / by for off, by in zip(differences, noise, strict=True)]
    return {
        "mean_difference": float(np.mean(differences)),
        "largest_difference": float(np.max(np.abs(differences))),
        "rms_standard_errors": float(np.sqrt(np.mean(np.square(scores)))),
    }


def main() -> None:
    """Count scutoids on every shape."""
    path = common.output(__doc__ or "", "stretch")
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    table = {name: shares(domains) for name, domains in shapes().items()}
    tube = next(iter(table.values()))
    results: dict[str, Any] = {"cells": CELLS, "seeds": len(SEEDS), "shares": table}
    results["against_tubes"] = {name: off_the_tube(rows, tube) for name, rows in list(table.items())[1:] if rows}
    for marker, (name, rows) in zip("osD^v", table.items(), strict=True):
        columns = [[row[key] for row in rows] for key in ("anisotropy", "share", "error")]
        axes.errorbar(*columns, fmt=marker + ("-" if rows is tube else ""), label=name, capsize=2, markersize=5)
    axes.set(xlabel="anisotropy of stretch", ylabel="share of scutoids", ylim=(0, 1))
    axes.grid(color="0.9")
    axes.legend()
    figure.savefig(path.with_suffix(".png"), dpi=150)
    print(
        {name: {key: round(value, 3) for key, value in row.items()} for name, row in results["against_tubes"].items()}
    )
    common.write(path, results)


if __name__ == "__main__":
    main()
