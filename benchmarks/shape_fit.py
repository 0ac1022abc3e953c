"""Images of flat sheets, closed shells and bent cells, fitted back: how near the backbones come, and equal voxels.

A slab, a hollow sphere and a hollow ellipsoid with 80 cells each are drawn as label images, turned in space, with
voxels of 2:1:1, with 5 % of the voxels relabeled, with 10 % of the cells missing, and with both, as in `image_fit.py`;
and so are a slab and a tube with tilted backbones and with bent ones, of three nodes.
"""

import functools
import time
from typing import Any

import common
import jax.numpy as jnp
import numpy as np
from image_fit import TURNED, spoil

import jaxtissue as jt
from jaxtissue.geometry.nodes import as_nodes, node_points
from jaxtissue.images.drawing import draw_labels
from jaxtissue.images.frame import Frame

CELLS, SPACING, MARGIN, JITTER = 80, (0.4, 0.2, 0.2), 1.0, 0.12
SLAB, TUBE = jt.Slab(20, 16, 5), jt.RoundTube(20, 2.5, 5.5)
SHAPES: dict[str, tuple[Any, str, int]] = {  # domain, shape to be fitted, nodes
    "slab": (SLAB, "slab", 1),
    "sphere": (jt.Sphere(6, 9), "sphere", 1),
    "ellipsoid": (jt.Ellipsoid([8, 6, 5], [11, 9, 8]), "ellipsoid", 1),
    "slab, tilted": (SLAB, "slab", 2),
    "slab, bent": (SLAB, "slab", 3),
    "tube, tilted": (TUBE, "tube", 2),
    "tube, bent": (TUBE, "tube", 3),
}
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


def bend(domain: Any, straight: np.ndarray, nodes: int) -> np.ndarray:
    """Backbones that lean and bow alike by about half a cell, and each for itself by a third of that."""
    rng, height = np.random.default_rng(1), np.linspace(0, 1, nodes)
    lean = [1, 0.5] + 0.3 * rng.normal(size=(CELLS, 2))
    bow = [-0.6, 0.8] + 0.3 * rng.normal(size=(CELLS, 2))
    away = lean[:, None] * (height - 0.5)[:, None] + (nodes > 2) * bow[:, None] * (4 * height * (1 - height))[:, None]
    unit = [1, 1] if domain is SLAB else [1, 0.25]  # radians
    place = straight[:, None] + away * unit
    if domain is SLAB:
        return np.clip(place, 0, [20, 16])
    return np.stack([np.clip(place[..., 0], 0, 20), place[..., 1] % (2 * np.pi)], axis=-1)


def stand(name: str) -> np.ndarray:
    """The positions of a tissue, [n, d] or [n, k, d]."""
    domain, shape, nodes = SHAPES[name]
    straight = directions() if shape in ("sphere", "ellipsoid") else places()
    straight = straight * [1, 2 * np.pi / 16] if shape == "tube" else straight  # as many cells round as in a row
    return straight if nodes == 1 else bend(domain, straight, nodes)


def in_space(domain: Any, positions: np.ndarray) -> np.ndarray:
    """The ends or all nodes of backbones, [n, k, 3]."""
    if positions.ndim == 2:
        straight = domain.embed(positions)
        return np.stack([straight.apical, straight.basal], axis=1).astype(float)
    return np.stack(node_points(as_nodes(jnp.asarray(positions), domain), domain), axis=-1).astype(float)


def apart(domain: Any, positions: np.ndarray, frame: Frame, true: tuple[Any, np.ndarray, Frame]) -> np.ndarray:
    """The distances of ends or nodes from the true ones in the image, in voxels, the largest of each backbone."""
    places = []
    for where, stands, at in ((domain, positions, frame), true):
        nodes = in_space(where, stands)
        places.append(at.to_image(nodes.reshape(-1, 3)).reshape(nodes.shape))
    return np.linalg.norm(places[0] - places[1], axis=2).max(axis=1) / float(np.prod(SPACING) ** (1 / 3))


@functools.cache
def drawn(name: str) -> tuple[np.ndarray, np.ndarray, Frame, np.ndarray]:
    """The image of a tissue, its backbones, where it lies, and the pairs of labels that touch."""
    (domain, shape, nodes), positions, sizes = SHAPES[name], stand(name), np.array(SPACING)[::-1]
    ends = in_space(domain, positions).reshape(-1, 3) @ TURNED
    margin = MARGIN + 2 * (shape in ("slab", "tube"))  # sides and ends reach beyond the backbones
    low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
    frame, steps = Frame(-low, TURNED), np.ceil((high - low)[::-1] / SPACING).astype(int).tolist()
    image = draw_labels(domain, positions, np.arange(1, CELLS + 1), frame, sizes, tuple(steps))[0]
    if nodes > 1:
        return image, positions, frame, jt.measure_labels(image, SPACING).pairs
    return image, positions, frame, jt.find_connectivity(positions, domain).contacts.pairs + 1


def one(name: str, noise: float, missing: float) -> dict[str, Any]:
    """The figures of one case."""
    image, positions, frame, pairs = drawn(name)
    domain, shape, nodes = SHAPES[name]
    given, gone = spoil(image, noise, missing, pairs)
    begun = time.perf_counter()
    fit = jt.fit_tissue(given, SPACING, shape, nodes)
    seconds = time.perf_counter() - begun
    off = apart(fit.domain, fit.positions, fit.frame, (domain, positions[fit.labels - 1], frame))
    fair = (image > 0) & ~np.isin(image, gone)
    result = {
        "image": list(image.shape),
        "voxels_per_cell": float((image > 0).sum() / CELLS),
        "ends_off_rms_voxels": float(np.sqrt((off**2).mean())),
        "ends_off_max_voxels": float(off.max()),
        "voxels_same_as_clean": float((fit.voxels == image)[fair].mean()),
        "seconds": seconds,
        "report": fit.report,
    }
    if nodes > 1 and not noise and not missing:
        straight = jt.fit_tissue(given, SPACING, shape)
        result["voxels_same_of_straight_backbones"] = straight.report["voxels_same"]
    return result


def main() -> None:
    """Fit every case and write the figures."""
    out, results = common.output(__doc__ or "", "shape_fit"), {}
    for name in SHAPES:
        for case, (noise, missing) in CASES.items():
            results[f"{name}, {case}"] = found = one(name, noise, missing)
            same, rms, most = (
                found[key] for key in ("voxels_same_as_clean", "ends_off_rms_voxels", "ends_off_max_voxels")
            )
            kept = found["report"]["neighbors_kept"]
            print(
                f"{name}, {case}: {same:.4f} of the voxels, nodes off by {rms:.2f}, {most:.2f} voxels, "
                f"neighbors {kept:.3f}, {found.get('voxels_same_of_straight_backbones', '')}",
                flush=True,
            )
    common.write(out, {"cases": results})


if __name__ == "__main__":
    main()
