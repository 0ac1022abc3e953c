"""Images of closed shells, fitted back: how near the backbones come, and how many voxels are the same.

A hollow sphere and a hollow ellipsoid with 80 cells each are drawn as label images, turned in space, with voxels of
2:1:1, with 5 % of the voxels relabeled, with 10 % of the cells missing, and with both, as in `image_fit.py`.
"""

import time
from typing import Any

import common
import numpy as np
from image_fit import TURNED, apart, spoil

import jaxtissue as jt
from jaxtissue.images.drawing import draw_labels
from jaxtissue.images.frame import Frame

CELLS, SPACING, MARGIN, JITTER = 80, (0.4, 0.2, 0.2), 1.0, 0.12
SHELLS = {"sphere": jt.Sphere(6, 9), "ellipsoid": jt.Ellipsoid([8, 6, 5], [11, 9, 8])}
CASES = {"clean": (0.0, 0.0), "5 % noise": (0.05, 0.0), "10 % missing": (0.0, 0.1), "both": (0.05, 0.1)}


def directions() -> np.ndarray:
    """Unit vectors on a spiral from pole to pole, moved at random."""
    height, turn = 1 - (2 * np.arange(CELLS) + 1) / CELLS, np.pi * (3 - np.sqrt(5)) * np.arange(CELLS)
    across = np.sqrt(1 - height**2)
    place = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
    place += JITTER * np.random.default_rng(0).normal(size=place.shape)
    return place / np.linalg.norm(place, axis=1, keepdims=True)


def one(shape: str, noise: float, missing: float) -> dict[str, Any]:
    """The figures of one case."""
    shell, positions, sizes = SHELLS[shape], directions(), np.array(SPACING)[::-1]
    reach = np.linalg.norm(np.asarray(shell.embed(positions).basal), axis=1).max() + MARGIN
    frame, labels = Frame(np.full(3, reach), TURNED), np.arange(1, CELLS + 1)
    steps = tuple(np.ceil(2 * reach / np.array(SPACING)).astype(int).tolist())
    image = draw_labels(shell, positions, labels, frame, sizes, steps)[0]
    pairs = jt.find_connectivity(positions, shell).contacts.pairs + 1
    given, gone = spoil(image, noise, missing, pairs)
    begun = time.perf_counter()
    fit = jt.fit_tissue(given, SPACING, shape)
    seconds = time.perf_counter() - begun
    true = shell, positions[fit.labels - 1], frame
    off = apart(fit.domain, fit.positions, fit.frame, true, float(np.prod(sizes) ** (1 / 3)))
    fair = (image > 0) & ~np.isin(image, gone)
    return {
        "image": list(image.shape),
        "voxels_per_cell": float((image > 0).sum() / CELLS),
        "ends_off_rms_voxels": float(np.sqrt((off**2).mean())),
        "ends_off_max_voxels": float(off.max()),
        "voxels_same_as_clean": float((fit.voxels == image)[fair].mean()),
        "seconds": seconds,
        "report": fit.report,
    }


def main() -> None:
    """Fit every case and write the figures."""
    out, results = common.output(__doc__ or "", "shell_fit"), {}
    for shape in SHELLS:
        for case, (noise, missing) in CASES.items():
            results[f"{shape}, {case}"] = found = one(shape, noise, missing)
            same, most = found["voxels_same_as_clean"], found["ends_off_max_voxels"]
            kept = found["report"]["neighbors_kept"]
            print(f"{shape}, {case}: {same:.4f} of the voxels, ends off by {most:.2f} voxels, neighbors {kept:.3f}",
                  flush=True)  # fmt: skip
    common.write(out, {"cases": results})


if __name__ == "__main__":
    main()
