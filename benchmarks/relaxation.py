"""Minimizers and Metropolis: seconds until a tissue is within 1 % of the best energy known, on tubes, sphere and slab.

    python benchmarks/relaxation.py [--cells 500] [--seeds 3] [--sweeps 1000] [--sweeps-on-domains 100] [--steps 40]
    python benchmarks/relaxation.py --first 3 --seeds 5 [--tissues sphere slab]
    python benchmarks/relaxation.py --again

Writes benchmarks/results/relaxation.json and docs/relaxation.png; with --first or --keep the results that are there
stay, and more are added, with --again only the table and the picture of them are made. From each random start all
methods run one after the other. Compiling is apart: each method runs a little once before it is timed. Results are
written after each tissue. Pin it to one core: `taskset -c 0`.
"""

import json
import os
import time
from pathlib import Path
from typing import Any

import common
import jax
import numpy as np
from matplotlib.figure import Figure

import jaxtissue as jt

# one after another, with the most steps of all but the last
METHODS: tuple[dict[str, int], ...] = ({"lloyd": 0}, {"fire": 0}, {"lbfgs": 0}, {"lloyd": 5, "lbfgs": 0})
METROPOLIS = "is-mh"
SCHEDULES = {"T = 2": (2.0, 2.0), "T = 0": (0.0, 0.0), "annealed": (100.0, 0.05)}  # from first to last temperature
WITHIN = 0.01  # of the best energy known


def tissues(cells: int) -> dict[str, Any]:
    """The domains; on the sphere and the slab the cells are columns three times as high as wide."""
    side = cells**0.5
    return {
        "tube, R_a = 1": jt.Tube(cells / 5, 1, 10),
        "tube, R_a = 5": jt.Tube(cells / 5, 5, 10),
        "sphere": jt.Sphere(side / 3, side / 3 + 3),
        "slab": jt.Slab(side, side, 3.0),
    }


Curve = list[tuple[float, float]]  # seconds and energy


def metropolis(place: np.ndarray, domain: Any, ends: tuple[float, float], sweeps: int) -> Curve:
    """Seconds and energy after every span of sweeps, at one temperature or as it falls by equal ratios."""
    first, last = ends
    temperatures = np.full(sweeps, first) if first == last else jt.geometric_schedule(first, last, sweeps)
    model = jt.tube_model(domain, len(place))
    annealer = jt.Annealer(model, "draft", METROPOLIS, 0, temperatures)
    state = annealer.start(place)
    curve, seconds = [(0.0, annealer.record(state).energy)], 0.0
    while state.sweep < sweeps:
        begin, compiled = time.perf_counter(), annealer.compile_seconds
        state, records, _ = annealer.advance(state)
        seconds += time.perf_counter() - begin - (annealer.compile_seconds - compiled)
        curve.append((seconds, records[-1].energy))
    return curve


def relaxed(place: np.ndarray, model: jt.Model, methods: dict[str, int]) -> tuple[Curve, int, str]:
    """Seconds and energy after every step, by methods one after another, each with its most steps; evaluations."""
    curve, evaluations, message = [], 0, ""
    for method, steps in methods.items():
        found = jt.relax(place, model, method, steps=steps)
        before = curve[-1][0] if curve else 0.0
        curve += [(before + record.seconds, record.energy) for record in found.history]
        place, message = found.positions, found.message
        evaluations += found.history[-1].evaluations
    return curve, evaluations, message


def reached(curve: Curve, energy: float) -> float | None:
    """The seconds until a curve is at an energy."""
    return next((seconds for seconds, there in curve if there <= energy), None)


def rows_of(name: str, domain: Any, seed: int, options: Any) -> list[dict[str, Any]]:
    """All methods from one start."""
    place = np.asarray(domain.random_positions(jax.random.key(seed), options.cells))
    model, rows = jt.tube_model(domain, options.cells), []
    sweeps = options.sweeps if isinstance(domain, jt.Tube) else options.sweeps_on_domains
    for schedule, ends in SCHEDULES.items():
        if seed == options.first:
            metropolis(place, domain, ends, min(20, sweeps // 10))
        curve = metropolis(place, domain, ends, sweeps)
        rows.append({"method": f"{METROPOLIS}, {schedule}", "curve": curve, "sweeps": sweeps})
    for methods in METHODS:
        if seed == options.first:
            relaxed(place, model, dict.fromkeys(methods, 2))
        curve, evaluations, message = relaxed(place, model, methods | {list(methods)[-1]: options.steps})
        row = {"method": " + ".join(methods), "curve": curve, "evaluations": evaluations, "message": message}
        rows.append(row | {"seconds_to_energy_of_sweeps": reached(curve, rows[0]["curve"][-1][1])})
    for row in rows:
        row |= {"tissue": name, "seed": seed}
        print(name, seed, row["method"], [f"{value:.6g}" for value in row["curve"][-1]], flush=True)
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Energy over seconds, a panel for each tissue."""
    names = list(dict.fromkeys(row["tissue"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(3.2 * max(2, len(names)), 3.8), layout="constrained")
    for panel, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        best = min(energy for row in rows if row["tissue"] == name for _, energy in row["curve"])
        for row in (row for row in rows if row["tissue"] == name):
            seconds, energy = np.array(row["curve"]).T
            label = row["method"] if row["seed"] == 0 else None
            over = np.maximum(energy / best - 1, 1e-4)
            panel.plot(np.maximum(seconds, 1e-2), over, color=f"C{methods.index(row['method'])}", label=label, lw=1)
        panel.axhline(WITHIN, color="black", ls=":")
        panel.set(xscale="log", yscale="log", xlabel="seconds, one core", title=name)
        panel.grid(color="0.9")
    figure.axes[0].set_ylabel("energy above the best known")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=120)


def table(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each tissue and method: how many starts came within 1 % of the best energy, and the median seconds."""
    found = []
    for name in dict.fromkeys(row["tissue"] for row in rows):
        of_tissue = [row for row in rows if row["tissue"] == name]
        best = min(energy for row in of_tissue for _, energy in row["curve"])
        for method in dict.fromkeys(row["method"] for row in of_tissue):
            curves = [row["curve"] for row in of_tissue if row["method"] == method]
            times = [reached(curve, (1 + WITHIN) * best) for curve in curves]
            there = [seconds for seconds in times if seconds is not None]
            lowest = [min(energy for _, energy in curve) / best - 1 for curve in curves]
            row = {"tissue": name, "method": method, "starts": len(curves), "reached": len(there), "best": best}
            row |= {"median_seconds": float(np.median(there)) if there else None}
            row |= {"median_above_best": float(np.median(lowest)), "seconds": [curve[-1][0] for curve in curves]}
            found.append(row)
            print(row, flush=True)
    return found


def main() -> None:
    """Run all methods on all tissues, write the table, and draw it."""
    parser = common.options((__doc__ or "").split("\n")[0], "relaxation")
    for name, value in {
        "cells": 500,
        "seeds": 3,
        "sweeps": 1000,
        "sweeps-on-domains": 100,
        "steps": 40,
        "first": 0,
    }.items():
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--picture", type=Path, default=common.HERE.parent / "docs" / "relaxation.png")
    parser.add_argument("--tissues", nargs="+", choices=list(tissues(500)), help="these only")
    parser.add_argument("--keep", action="store_true", help="add to the results that are there")
    parser.add_argument("--again", action="store_true", help="tabulate and draw the results that are there")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.again or options.first or options.keep:
        rows = json.loads(options.out.read_text())["rows"]
    if options.again:
        table(rows)
        draw(rows, options.picture)
        return
    sizes = {name: getattr(options, name) for name in ("cells", "sweeps", "sweeps_on_domains", "steps")}
    for seed in range(options.first, options.first + options.seeds):
        for name, domain in tissues(options.cells).items():
            if options.tissues and name not in options.tissues:
                continue
            rows += rows_of(name, domain, seed, options)
            load = {"load_average": os.getloadavg(), "cores": len(os.sched_getaffinity(0)), "seeds": seed + 1}
            common.write(options.out, sizes | load | {"table": table(rows), "rows": rows})
        draw(rows, options.picture)


if __name__ == "__main__":
    main()
