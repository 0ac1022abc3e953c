"""Parameters found again from relaxed tissues, without noise and with positions off by 1 % of the mean cell width.

    python benchmarks/inference.py [--tissues 4] [--noises 25]

Random tissues of 40 cells in a thin tube are relaxed in 64 bits, with one target volume and with two. Writes
benchmarks/results/inference.json: what is found without noise, and with noise how many of the trials have the true
tension within two standard errors.
"""

from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt

CELLS, NOISE = 40, 0.01
TUBE = jt.Tube(10.0, 4.0, 5.0)
MEAN = TUBE.volume / CELLS
TENSION = 0.1 * MEAN ** (4 / 3)  # 0.1 without a unit; K = 1
SIZES = np.array([0.8, 1.2])  # target volumes of two types, in mean volumes


def relaxed(seed: int, share: np.ndarray) -> np.ndarray:
    """Positions at a minimum: L-BFGS by lines, and then by traced edges."""
    place = np.asarray(TUBE.random_positions(jax.random.key(seed), CELLS))
    model = jt.tube_model(TUBE, CELLS, 1.0, TENSION, own_targets, parameters=share * MEAN)
    for resolution in ("standard", "traced"):
        place = jt.relax(place, model, steps=80, resolution=resolution).positions
    return place


def own_targets(cells: jt.CellGeometry, model: jt.Model) -> jax.Array:
    """The paper's energy with a target volume of its own for each cell."""
    return model.modulus / 2 * (model.parameters - cells.volume) ** 2 + model.tension * cells.lateral_area


def found(place: np.ndarray, **known: Any) -> dict[str, Any]:
    """What is inferred, in parts of the true tension and of the mean volume."""
    result = jt.infer_parameters(place, TUBE, **known)
    row = {"tension": result.tension / TENSION, "tension_error": result.tension_error / TENSION}
    row |= {"volumes": (result.target_volumes / MEAN).tolist(), "noise": result.noise}
    return row | {"volume_errors": (result.target_volume_errors / MEAN).tolist()}


def main() -> None:
    """Relax the tissues, infer, and write the table."""
    parser = common.options((__doc__ or "").split("\n")[0], "inference")
    parser.add_argument("--tissues", type=int, default=4)
    parser.add_argument("--noises", type=int, default=25)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    radius = float(TUBE.apical_radius + TUBE.basal_radius) / 2
    width = (2 * np.pi * radius * TUBE.length / CELLS) ** 0.5
    exact: list[dict[str, Any]] = []
    noisy: list[dict[str, Any]] = []
    for seed in range(1, options.tissues + 1):
        place, rng = relaxed(seed, np.ones(CELLS)), np.random.default_rng(seed)
        exact.append(found(place) | {"tissue": seed, "kind": "one target volume"})
        print(exact[-1], flush=True)
        for _ in range(options.noises):
            off = rng.normal(0, NOISE * width, place.shape) / [1, radius]
            noisy.append(found(np.asarray(TUBE.reflect(place + off))) | {"tissue": seed})
        off, error = (np.array([row[name] for row in noisy]) for name in ("tension", "tension_error"))
        print(f"{(np.abs(off - 1) < 2 * error).sum()} of {len(noisy)} within two errors", flush=True)
        types = np.random.default_rng(seed).permutation(CELLS) // (CELLS // 2)
        place = relaxed(seed, SIZES[types])
        exact.append(found(place, types=types) | {"tissue": seed, "kind": "two target volumes"})
        print(exact[-1], flush=True)
    sizes = {"cells": CELLS, "noise": NOISE, "true_volumes": SIZES.tolist()}
    covered = {"trials": len(noisy), "within_two_errors": int((np.abs(off - 1) < 2 * error).sum())}
    covered |= {"mean_tension": float(off.mean()), "spread": float(off.std()), "mean_error": float(error.mean())}
    common.write(options.out, sizes | {"covered": covered, "exact": exact, "noisy": noisy})


if __name__ == "__main__":
    main()
