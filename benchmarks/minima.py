"""Whether relaxed tissues are at minima: the gradient that is left, or kinks of the energy where walls open and close.

    python benchmarks/minima.py [--cells 100 500] [--tissues sphere slab "tube, R_a = 1" "tube, R_a = 5"]

Random tissues are relaxed by Lloyd's method and then L-BFGS, in 64 bits, in tubes at last by traced edges. The gradient
that is left is given as a part of that of the random tissue, and of that after Lloyd's method. Where it is above a
millionth, the energy may have a kink there, with other gradients on its other sides. Then the tissue is at a minimum if
some mean of the gradients around it is zero (gradient sampling: Burke, Lewis and Overton, SIAM J. Optim. 15, 751,
2005). So the script takes the gradients at random places very near, and finds the norm of their smallest mean, beside
the number of walls that are nearly closed. Writes benchmarks/results/minima.json.
"""

from typing import Any

import common
import jax
import numpy as np
from relaxation import tissues
from scipy.optimize import nnls

import jaxtissue as jt
from jaxtissue.minimization.relaxation import _placed

NEAR = 1e-7  # mean cell widths round the tissue
SAMPLES = 400
SHORT = 1e-3  # of the square of a cell's width
ZERO, TOLERANCE = 1e-6, 1e-7  # of the first gradient: what is none, and where L-BFGS ends, of its own first
WEIGHT = 1e3  # of the condition that a mean's weights add up to 1


def smallest_mean(gradients: np.ndarray) -> float:
    """The least norm of the weighted means of gradients, [samples, n]."""
    size = np.linalg.norm(gradients[0])
    rows = np.vstack([gradients.T / size, np.full(len(gradients), WEIGHT)])
    weights, _ = nnls(rows, np.append(np.zeros(gradients.shape[1]), WEIGHT))
    return float(np.linalg.norm(weights / weights.sum() @ gradients))


def minimum(name: str, domain: Any, cells: int) -> dict[str, Any]:
    """Relax a random tissue, and look round where it ends."""
    model = jt.tube_model(domain, cells)
    resolution = "traced" if isinstance(domain, jt.Tube) else "2x1"  # two layers are enough for walls of columns
    random = np.asarray(domain.random_positions(jax.random.key(0), cells))
    first = jt.relax(random, model, steps=0, resolution=resolution).history[0].gradient
    place = jt.relax(random, model, "lloyd", steps=2).positions
    second = jt.relax(place, model, steps=0, resolution=resolution).history[0].gradient
    if resolution == "traced":
        place = jt.relax(place, model, resolution="standard", steps=40).positions
    found = jt.relax(place, model, resolution=resolution, steps=200, tolerance=TOLERANCE)
    last = found.history[-1]
    row = {
        "tissue": name,
        "cells": cells,
        "steps": last.step,
        "evaluations": last.evaluations,
        "seconds": last.seconds,
        "message": found.message,
        "gradient": last.gradient / first,
        "gradient_after_lloyd": last.gradient / second,
    }
    return row if last.gradient < ZERO * first else row | around(found.positions, model, resolution, first)


def around(positions: Any, model: jt.Model, resolution: str, first: float) -> dict[str, Any]:
    """What the gradients around a relaxed tissue say, as parts of the first one."""
    energy = _placed(model, positions, resolution)  # as `relax` makes it
    here, random = energy.placed(positions), np.random.default_rng(0)
    energy.renew(here)
    places = [here, *(here + NEAR * energy.width * random.normal(size=here.shape) for _ in range(SAMPLES))]
    gradients = np.stack([energy(place).gradient.ravel() for place in places])
    spread = np.linalg.norm(gradients - gradients[0], axis=1).max()
    contacts = jt.find_connectivity(positions, model.domain)
    return {
        "spread": float(spread / first),
        "smallest_mean": smallest_mean(gradients) / first,
        "short_walls": int((np.asarray(contacts.contacts.area) < SHORT * float(model.mean_volume) ** (2 / 3)).sum()),
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = common.options((__doc__ or "").split("\n")[0], "minima")
    parser.add_argument("--cells", type=int, nargs="+", default=[100, 500])
    parser.add_argument("--tissues", nargs="+", default=["sphere", "slab", "tube, R_a = 1", "tube, R_a = 5"])
    options = parser.parse_args()
    rows = []
    for cells in options.cells:
        for name in options.tissues:
            rows.append(minimum(name, tissues(cells)[name], cells))
            print(rows[-1], flush=True)
            common.write(options.out, {"samples": SAMPLES, "near": NEAR, "rows": rows})
