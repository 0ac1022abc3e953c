"""Errors and warm times of every preset, and of the exact path, on each reference tube."""

import statistics
import time
from pathlib import Path

import common
import jax
import jax.numpy as jnp
import numpy as np

import jaxtissue as jt

SIZES = {
    "volume": "V",
    "lateral_area": "lateral",
    "apical_area": "apical_area",
    "basal_area": "basal_area",
    "apical_perimeter": "apical_perim",
    "basal_perimeter": "basal_perim",
}


def measure_case(path: Path) -> dict:
    """One tube: for each preset errors of every size, of the totals, and seconds; so for the exact path."""
    known = np.load(path)
    tube = jt.Tube(float(known["L"]), float(known["Ra"]), float(known["Rb"]))
    place = np.stack([known["x"], known["theta"]], axis=-1)
    rows = {}
    with jax.enable_x64(path.stem == "near_coincident"):  # its separation is below what float32 resolves
        positions = tube.reflect(jnp.asarray(place, float))
        for name, resolution in jt.PRESETS.items():
            cells = jt.measure_tissue(positions, tube, resolution, refine=False)
            seconds = []
            for _ in range(5):
                begin = time.perf_counter()
                jax.block_until_ready(jt.measure_tissue(positions, tube, resolution, refine=False))
                seconds.append(time.perf_counter() - begin)
            rows[name] = {size: common.rms(getattr(cells, size), known[key]) for size, key in SIZES.items()}
            rows[name] |= {"total_" + size: total(getattr(cells, size), known[SIZES[size]]) for size in list(SIZES)[:2]}
            rows[name] |= {"tiling_defect": float(cells.tiling_defect), "seconds": statistics.median(seconds)}
        rows["covering_radius"] = float(jt.covering_radius(positions, tube)) / float(known["phi"]) - 1
    with jax.enable_x64(True):
        apart = float(jt.separation(jnp.asarray(place), tube))
        rows["separation"] = apart / float(known["min_dist"]) - 1 if len(place) > 1 else 0.0
    for samples in (10, 50):
        begin = time.perf_counter()
        exact = jt.exact_cells(place, tube, samples)
        rows[f"exact_{samples}"] = {
            "volume": common.rms(exact.volume, known["V"]),
            "lateral_area": common.rms(exact.lateral_area, known["lateral"]),
            "seconds": time.perf_counter() - begin,
        }
    return rows


def total(measured: jax.Array, exact: np.ndarray) -> float:
    """Relative error of the sum over cells."""
    return float(np.sum(measured, dtype=float) / exact.sum() - 1) if exact.sum() > 0 else float(np.sum(measured))


def main() -> None:
    """Measure every tube, print a table, write the JSON."""
    path = common.output(__doc__ or "", "accuracy")
    cases = {case.stem: measure_case(case) for case in sorted(common.REFERENCES.glob("*.npz"))}
    print(f"{'tube':18} {'path':9} {'V %':>8} {'A %':>8} {'total V %':>10} {'total A %':>10} {'ms':>8}")
    for name, rows in cases.items():
        for kind, row in rows.items():
            if isinstance(row, dict):
                totals = [f"{100 * row.get('total_' + size, np.nan):10.4f}" for size in ("volume", "lateral_area")]
                print(
                    f"{name:18} {kind:9} {100 * row['volume']:8.4f} {100 * row['lateral_area']:8.4f}",
                    *totals,
                    f"{1e3 * row['seconds']:8.1f}",
                )
    common.write(path, {"cases": cases})


if __name__ == "__main__":
    main()
