"""Images of our own tissues, measured and fitted back: how near the backbones come, and how many voxels are the same.

Two relaxed tubes are drawn as label images, upright and turned in space, with cubic and with flat voxels, with 5 % of
the voxels relabeled by the label of a neighbor or 0, with 10 % of the cells missing, and with both. Beside the fit
stands what the model of the cells' centroids alone would give.
"""

import time
from typing import Any

import common
import jax
import numpy as np
from scipy.spatial.transform import Rotation

import jaxtissue as jt
from jaxtissue.images.drawing import draw_labels, draw_turned
from jaxtissue.images.frame import Frame

TISSUES = {"R_b/R_a = 3, 100 cells": (jt.Tube(20, 2, 6), 100), "R_b/R_a = 1.5, 80 cells": (jt.Tube(16, 4, 6), 80)}
TURNED = Rotation.from_euler("zyx", [33, -21, 50], degrees=True).as_matrix()
CUBIC, FLAT = (0.15, 0.15, 0.15), (0.24, 0.12, 0.12)
CASES: dict[str, tuple[tuple[float, ...], np.ndarray, float, float]] = {  # spacing, axes, noise, missing
    "upright": (CUBIC, np.eye(3), 0, 0),
    "turned": (CUBIC, TURNED, 0, 0),
    "turned, voxels 2:1:1": (FLAT, TURNED, 0, 0),
    "turned, voxels 2:1:1, 5 % noise": (FLAT, TURNED, 0.05, 0),
    "turned, voxels 2:1:1, 10 % missing": (FLAT, TURNED, 0, 0.1),
    "turned, voxels 2:1:1, 5 % noise, 10 % missing": (FLAT, TURNED, 0.05, 0.1),
}


def relaxed(tube: jt.Tube, cells: int) -> np.ndarray:
    """A tissue annealed for 60 sweeps, in units of the mean cell."""
    positions = tube.random_positions(jax.random.key(0), cells)
    model = jt.tube_model(tube, cells, tension=0.1, relative=True)
    return np.asarray(jt.anneal(positions, tube, sweeps=60, temperature=0.002, model=model).positions)


def spoil(image: np.ndarray, noise: float, missing: float, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image with cells missing and voxels relabeled by that of a neighbor or 0, and the missing labels."""
    rng, labels = np.random.default_rng(0), np.unique(image[image > 0])
    gone = rng.choice(labels, round(missing * len(labels)), replace=False)
    spoiled = np.where(np.isin(image, gone), 0, image)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    others = {label: np.append(np.setdiff1d(both[both[:, 0] == label, 1], gone), 0) for label in labels.tolist()}
    at = np.argwhere((rng.random(image.shape) < noise) & (spoiled > 0))
    spoiled[tuple(at.T)] = [rng.choice(others[label]) for label in spoiled[tuple(at.T)].tolist()]
    return spoiled, gone


def apart(
    tube: jt.Tube, positions: np.ndarray, frame: Frame, true: tuple[jt.Tube, np.ndarray, Frame], step: float
) -> np.ndarray:
    """The distances of the ends of backbones from the true ones in the image, in voxels, the larger of the two."""
    ends = []
    for domain, place, at in ((tube, positions, frame), true):
        backbones = domain.embed(np.asarray(place))
        ends.append([at.to_image(np.asarray(end, float)) for end in (backbones.apical, backbones.basal)])
    return np.linalg.norm(np.subtract(*ends), axis=2).max(axis=0) / step


def from_centroids(fit: jt.TissueFit, sizes: np.ndarray, image: np.ndarray, pairs: set[tuple[int, int]]) -> dict:
    """What backbones through the cells' centroids would give, in the same tube."""
    place = fit.frame.to_domain(fit.cells.centroid)
    angle = np.mod(np.arctan2(place[:, 2], place[:, 1]), 2 * np.pi)
    positions = np.stack([np.clip(place[:, 0], 0, fit.domain.length), angle], axis=-1)
    voxels, _ = draw_labels(fit.domain, positions, fit.labels, fit.frame, sizes, image.shape)
    tissue = jt.find_connectivity(positions, fit.domain)
    mine = {tuple(pair) for pair in fit.labels[tissue.contacts.pairs].tolist()}
    ratio = tissue.sizes.volume / fit.cells.volume
    return {
        "voxels_same": float((voxels == image)[image > 0].mean()),
        "neighbors_in_common": len(mine & pairs) / len(mine | pairs),
        "volume_ratio_mean": float(ratio.mean()),
        "volume_ratio_sd": float(ratio.std()),
    }


def measured(image: np.ndarray, spacing: tuple[float, ...], traced: jt.Connectivity) -> dict[str, float]:
    """How well the image alone gives sizes and neighbors."""
    seen, sizes, contacts = jt.measure_labels(image, spacing), traced.sizes, traced.contacts
    area = dict(zip(map(tuple, (contacts.pairs + 1).tolist()), contacts.area, strict=True))
    found = dict(zip(map(tuple, seen.pairs.tolist()), seen.wall_area, strict=True))
    large = [pair for pair, size in area.items() if size > 0.05 * contacts.area.mean()]
    off = np.array([found.get(pair, 0) - area[pair] for pair in area])
    return {
        "volume_rms": common.rms(seen.volume, sizes.volume),
        "lateral_area_rms": common.rms(seen.lateral_area, sizes.lateral_area),
        "lateral_area_total": float(seen.lateral_area.sum() / sizes.lateral_area.sum() - 1),
        "wall_area_rms": float(np.sqrt((off**2).mean()) / contacts.area.mean()),
        "walls_found": len(set(area) & set(found)) / len(area),
        "walls_found_above_5_percent": len(set(large) & set(found)) / len(large),
        "walls_that_are_none": len(set(found) - set(area)) / len(found),
    }


def one(tube: jt.Tube, positions: np.ndarray, case: str) -> dict[str, Any]:
    """The figures of one case."""
    spacing, axes, noise, missing = CASES[case]
    sizes = np.array(spacing)[::-1]
    image, frame = draw_turned(tube, positions, spacing, axes)
    traced = jt.find_connectivity(positions, tube)
    pairs = traced.contacts.pairs + 1
    given, gone = spoil(image, noise, missing, pairs)
    begun = time.perf_counter()
    fit = jt.fit_tissue(given, spacing)
    seconds = time.perf_counter() - begun
    true = positions[fit.labels - 1]
    off = apart(fit.domain, fit.positions, fit.frame, (tube, true, frame), float(np.prod(sizes) ** (1 / 3)))
    fair = (image > 0) & ~np.isin(image, gone)
    result = {
        "image": list(image.shape),
        "voxels_per_cell": float((image > 0).sum() / len(positions)),
        "ends_off_rms_voxels": float(np.sqrt((off**2).mean())),
        "ends_off_max_voxels": float(off.max()),
        "cells_within_half_a_voxel": float((off < 0.5).mean()),
        "voxels_same_as_clean": float((fit.voxels == image)[fair].mean()),
        "seconds": seconds,
        "report": fit.report,
    }
    if not noise and not missing:
        result["measured"] = measured(image, spacing, traced)
        result["centroids"] = from_centroids(fit, sizes, image, {tuple(pair) for pair in pairs.tolist()})
    return result


def main() -> None:
    """Fit every case and write the figures."""
    out, results = common.output(__doc__, "image_fit"), {}
    for name, (tube, cells) in TISSUES.items():
        positions = relaxed(tube, cells)
        for case in CASES:
            results[f"{name}; {case}"] = found = one(tube, positions, case)
            same, most = found["voxels_same_as_clean"], found["ends_off_max_voxels"]
            print(f"{name}; {case}: {same:.4f} of the voxels, ends off by {most:.2f} voxels", flush=True)
    common.write(out, {"cases": results})


if __name__ == "__main__":
    main()
