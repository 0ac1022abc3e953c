"""Images of flat sheets and closed shells, fitted back: how near the backbones come, and how many voxels are the same.

A slab, a hollow sphere and a hollow ellipsoid with 80 cells each are drawn as label images, turned in space, with
voxels of 2:1:1, with 5 % of the voxels relabeled, with 10 % of the cells missing, and with both, as in `image_fit.py`.
"""

import functools
import time
from typing import Any

import common
import numpy as np
from image_fit import TURNED, apart, spoil

import jaxtissue as jt
from jaxtissue.images.drawing import draw_labels
from jaxtissue.images.frame import Frame

CELLS, SPACING, MARGIN, JITTER = 80, (0.4, 0.2, 0.2), 1.0, 0.12
SHAPES = {"slab": jt.Slab(20, 16, 5), "sphere": jt.Sphere(6, 9), "ellipsoid": jt.Ellipsoid([8, 6, 5], [11, 9, 8])}
CASES = {"clean": (0.0, 0.0), "5 % noise": (0.05, 0.0), "10 % missing": (0.0, 0.1), "both": (0.05, 0.1)}


def directions() -> np.ndarray:
    """Unit vectors on a spiral from pole to pole, moved at random."""
    height, turn = 1 - (2 * np.arange(CELLS) + 1) / CELLS, np.pi * (3 - np.sqrt(5)) * np.arange(CELLS)
    across = np.sqrt(1 - height**2)
    place = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
    place += JITTER * np.random.default_rng(0).normal(size=place.shape)
    return place / np.linalg.norm(place, axis=1, keepdims=True)


def places() -> np.ndarray:
    """Points of the slab in rows, every second one shifted, moved at random."""
    row, column = np.divmod(np.arange(CELLS), 8)
    shift = np.random.default_rng(0).uniform(-0.35, 0.35, (CELLS, 2))
    return 2 * (np.column_stack([row, column + 0.25 * (row % 2) - 0.12]) + 0.5 + shift)


@functools.cache
def drawn(shape: str) -> tuple[np.ndarray, np.ndarray, Frame, np.ndarray]:
    """The image of a tissue, its backbones, where it lies, and the pairs of labels that touch."""
    domain, sizes = SHAPES[shape], np.array(SPACING)[::-1]
    positions = places() if shape == "slab" else directions()
    backbones = domain.embed(positions)
    ends = np.concatenate([np.asarray(end, float) for end in (backbones.apical, backbones.basal)]) @ TURNED
    margin = MARGIN + 2 * (shape == "slab")  # its sides reach beyond its backbones
    low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
    frame, steps = Frame(-low, TURNED), np.ceil((high - low)[::-1] / SPACING).astype(int).tolist()
    image = draw_labels(domain, positions, np.arange(1, CELLS + 1), frame, sizes, tuple(steps))[0]
    return image, positions, frame, jt.find_connectivity(positions, domain).contacts.pairs + 1


def one(shape: str, noise: float, missing: float) -> dict[str, Any]:
    """The figures of one case."""
    image, positions, frame, pairs = drawn(shape)
    domain, sizes = SHAPES[shape], np.array(SPACING)[::-1]
    given, gone = spoil(image, noise, missing, pairs)
    begun = time.perf_counter()
    fit = jt.fit_tissue(given, SPACING, shape)
    seconds = time.perf_counter() - begun
    true = domain, positions[fit.labels - 1], frame
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
    out, results = common.output(__doc__ or "", "shape_fit"), {}
    for shape in SHAPES:
        for case, (noise, missing) in CASES.items():
            results[f"{shape}, {case}"] = found = one(shape, noise, missing)
            same, most = found["voxels_same_as_clean"], found["ends_off_max_voxels"]
            kept = found["report"]["neighbors_kept"]
            print(f"{shape}, {case}: {same:.4f} of the voxels, ends off by {most:.2f} voxels, neighbors {kept:.3f}",
                  flush=True)  # fmt: skip
    common.write(out, {"cases": results})


if __name__ == "__main__":
    main()
