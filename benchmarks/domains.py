"""Errors and times of the sections on domains: where cells are known, against the exact path, and of sweeps.

    python benchmarks/domains.py [--cells 300] [--errors | --times] [--exact] [--peer DIR] [--out FILE]

Errors are root mean squares over the cells as parts of the mean cell; a time is the least of 20 diagrams on kept lists.
Cells are known on reference tubes and on the sphere. On other shapes they are compared with sections of 20 layers,
five passes and three steps of Newton's method, and these, with `--exact`, with the exact path, which takes minutes.
With `--errors` nothing is timed, with `--times` nothing else is done. With the C++ peer, one diagram of the reference
tube of ratio 2 is compared with those of the peer. What is measured is written at once.
"""

import time
import warnings
from typing import Any

import common
import jax
import jax.numpy as jnp
import numpy as np
from peer import Peer, find_peer
from scipy.spatial import SphericalVoronoi

import jaxtissue as jt
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.measurement.quadrature import SECTIONS
from jaxtissue.neighbors.section_lists import find_sections
from jaxtissue.sections.cells import RULE, cell_sections, cell_sizes, plan_layers
from jaxtissue.sections.crowd import as_array

KEPT = 20  # candidates of a cell in lists that are kept
SHAPES = {
    "bent tube": jt.BentTube(bend_radius=8, arc=1, apical_radius=1, basal_radius=1.5),
    "ellipsoid": jt.Ellipsoid(apical_axes=(2, 1, 1), basal_axes=(2.5, 1.5, 1.5)),
    "fold": jt.Fold(width=12, depth=6, amplitude=0.6, wavelength=6, thickness=0.5),
    "sphere": jt.Sphere(1, 1.5),
}
SAMPLES = 24  # of the exact path: 8 triangles across a cell, on 8 layers
CONVERGED = plan_layers(20, check=False), RULE._replace(passes=5, steps=3)


def cases() -> dict[str, tuple[Any, np.ndarray, np.ndarray, np.ndarray]]:
    """Domains and positions with the true volumes and lateral areas."""
    found = {}
    for name in ("thin_1.01", "paper_Ra5"):
        with np.load(common.HERE.parent / "tests" / "data" / f"{name}.npz") as data:
            tube = jt.RoundTube(float(data["L"]), float(data["Ra"]), float(data["Rb"]))
            found[name] = tube, np.stack([data["x"], data["theta"]], axis=-1), data["V"], data["lateral"]
    sphere = jt.Sphere(1, 1.5)
    place = np.asarray(sphere.random_positions(jax.random.key(0), 500), float)
    place /= np.linalg.norm(place, axis=1, keepdims=True)
    diagram = SphericalVoronoi(place, threshold=1e-6)
    diagram.sort_vertices_of_regions()
    rims = []
    for region in diagram.regions:
        corners = diagram.vertices[region]
        rims.append(np.arccos(np.clip((corners * np.roll(corners, 1, axis=0)).sum(axis=1), -1, 1)).sum())
    found["sphere"] = sphere, place, diagram.calculate_areas() * (1.5**3 - 1) / 3, np.array(rims) * (1.5**2 - 1) / 2
    return found


def kept_lists(found: Any) -> np.ndarray:
    """The candidates with an edge on any layer, and the first of the others."""
    line, is_edge = (np.asarray(part) for part in (found.sections.line, found.sections.is_edge))
    q, n = found.lists.shape
    used = np.zeros((q + 4, n), int)
    slot, layer, cell = np.nonzero(is_edge)
    np.add.at(used, (line[slot, layer, cell], cell), 1)
    order = np.argsort(-used[:q] - (found.lists >= 0) / 2, axis=0, kind="stable")[:KEPT]
    return np.take_along_axis(found.lists, order, axis=0)


def measured(domain: Any, positions: np.ndarray, layers: int, volume: np.ndarray, area: np.ndarray) -> dict[str, Any]:
    """Errors of complete lists and the time on kept ones."""
    place = as_domain_positions(positions, domain)
    plan = plan_layers(layers, check=False)
    found = find_sections(domain, place, plan)
    lists = as_array(kept_lists(found))

    @jax.jit
    def again(place: jax.Array, lists: jax.Array) -> Any:
        # the surfaces carry no volume
        heights = jnp.asarray(plan.heights[:-2])
        sections = cell_sections(domain, place, lists, heights, RULE)
        weights = jnp.asarray(plan.weights[:, :-2], sections.volume.dtype)
        return weights @ sections.volume, weights @ sections.wall.sum(axis=0)

    sizes = cell_sizes(domain, found.sections, found.layers, found.lists.shape[0])
    seconds = []
    for _ in range(20):
        begun = time.perf_counter()
        kept = jax.block_until_ready(again(place, lists))
        seconds.append(time.perf_counter() - begun)
    return {
        "layers": layers,
        "volume_rms": common.rms(sizes.volume[0], volume),
        "area_rms": common.rms(sizes.lateral_area[0], area),
        "volume_rms_kept": common.rms(kept[0][0], volume),
        "area_rms_kept": common.rms(kept[1][0], area),
        "volume_sum": float(np.asarray(sizes.volume[0], float).sum() / float(domain.volume)),
        "milliseconds_kept": 1e3 * min(seconds),
    }


def tissue(domain: Any, cells: int, kind: str) -> np.ndarray:
    """Random tissue, relaxed by three steps of Lloyd's method if so named."""
    place = np.asarray(domain.random_positions(jax.random.key(1), cells), float)
    if kind == "relaxed":
        model = jt.tube_model(domain, cells, relative=True)
        place = np.asarray(jt.relax(place, model, method="lloyd", steps=3).positions, float)
    return place


def against_converged(domain: Any, place: np.ndarray, preset: str) -> dict[str, Any]:
    """Errors of `measure_tissue`, and the errors that it states."""
    found, row = find_sections(domain, as_domain_positions(place, domain), *CONVERGED), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of cells with large errors
        cells = jt.measure_tissue(place, domain, preset)
    for name in ("volume", "lateral_area"):
        true, size = (np.asarray(getattr(part, name), float) for part in (found.sizes, cells))
        off = np.abs(size - true[0]) / true.mean()
        told = np.asarray(getattr(cells, f"{name}_error"), float) / true.mean()
        row |= {f"{name}_rms": float(np.sqrt((off**2).mean())), f"{name}_worst": float(off.max())}
        row |= {f"{name}_error_covers": float((told >= off).mean())}
        row |= {f"{name}_error_over_true": float(np.median(told) / max(np.median(off), 1e-12))}
    row["sum"] = float(np.asarray(cells.volume, float).sum() / float(domain.volume) - 1)
    return row


def exact_against_converged(domain: Any, place: np.ndarray) -> dict[str, float]:
    """How far the exact path is from converged sections."""
    found = find_sections(domain, as_domain_positions(place, domain), *CONVERGED)
    true = jt.exact_cells(place, domain, SAMPLES)
    return {
        f"{name}_rms": common.rms(np.asarray(getattr(found.sizes, name)[0], float), getattr(true, name))
        for name in ("volume", "lateral_area")
    }


def seconds_of_sweeps(domain: Any) -> dict[str, float]:
    """Seconds of a sweep of 500 cells by `draft`: the median of the last ten of twenty."""
    place = np.asarray(domain.random_positions(jax.random.key(1), 500), float)
    records = jt.anneal(place, domain, sweeps=20).records
    return {"seconds_of_a_sweep": float(np.median([record.seconds for record in records[-10:]]))}


def growth() -> dict[str, dict[str, float]]:
    """Milliseconds of a diagram by `draft` on kept lists, of spheres with the same cells but more of them."""
    found = {}
    for cells in (500, 2000, 8000, 20_000):
        sphere = jt.Sphere((cells / 500) ** 0.5, (cells / 500) ** 0.5 + 0.5)
        place = np.asarray(sphere.random_positions(jax.random.key(1), cells), float)
        nothing = np.full(cells, np.nan)
        row = measured(sphere, place, SECTIONS["draft"], nothing, nothing)
        found[f"sphere of {cells}"] = {"milliseconds_kept": row["milliseconds_kept"], "volume_sum": row["volume_sum"]}
    return found


def against_peer(peer: Peer) -> dict[str, dict[str, float]]:
    """Errors and milliseconds of one diagram by the peer with more and more samples, on the tube of ratio 2."""
    domain, positions, volume, area = cases()["paper_Ra5"]
    tube, found = jt.Tube(domain.length, domain.apical_radius, domain.basal_radius), {}
    for samples in (6, 8, 12, 20, 30, 40):
        diagram = peer.diagram(positions, tube, samples)
        row = {"volume_rms": common.rms(diagram.volume, volume), "area_rms": common.rms(diagram.lateral_area, area)}
        found[f"paper_Ra5 peer, {samples} samples"] = row | {"milliseconds": 1e3 * diagram.seconds}
    return found


def main() -> None:
    """Measure every case by every preset."""
    parser = common.options(__doc__ or "", "domains", peer=True)
    parser.add_argument("--cells", type=int, default=300, help="cells of the tissues that are compared")
    parser.add_argument("--errors", action="store_true", help="leave out what is timed")
    parser.add_argument("--times", action="store_true", help="leave out what is not timed")
    parser.add_argument("--exact", action="store_true", help="compare converged sections with the exact path too")
    given, results = parser.parse_args(), {}

    def tell(name: str, row: dict[str, Any]) -> None:
        results[name] = row
        print(name, {key: float(f"{value:.3g}") for key, value in row.items()}, flush=True)
        common.write(given.out, results)

    if not given.errors:
        for name, domain in {"sphere": SHAPES["sphere"], "slab": jt.Slab(24, 20, 1, periodic=(True, True))}.items():
            tell(f"{name} sweeps", seconds_of_sweeps(domain))
        for name, (domain, positions, volume, area) in cases().items():
            for preset, layers in SECTIONS.items():
                tell(f"{name} {preset}", measured(domain, positions, layers, volume, area))
        peer = find_peer(given.peer)
        for name, row in (growth() | (against_peer(peer) if peer else {})).items():
            tell(name, row)
    if given.times:
        return
    for kind in ("random", "relaxed"):
        for name, domain in SHAPES.items():
            place = tissue(domain, given.cells, kind)
            for preset in ("standard", "fine"):
                tell(f"{name} {kind} {preset}", against_converged(domain, place, preset))
            if given.exact:
                tell(f"{name} {kind} exact", exact_against_converged(domain, place))


if __name__ == "__main__":
    main()
