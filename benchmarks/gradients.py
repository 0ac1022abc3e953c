"""Gradients of volumes and lateral areas against central differences of true sizes, on tubes and other domains.

    python benchmarks/gradients.py

For random directions of all backbones but those next to an end: the cosine of the derivatives by `tissue_energy` and by
differences, of the volume term of the paper's energy and of the sum of all lateral areas. True sizes are those of the
traced edges on reference tubes, of which one is measured as a domain, too, and elsewhere those of sections on 80
layers, five passes and three steps of Newton's method. The steps are short: on a sphere or a slab, neighbors are
exchanged on all layers at once, which gives the area a kink. On tubes also the cosine with the gradient of the traced
edges, over all coordinates. Times are the processor's, so that other work on the machine counts little; those of
"traced" lack the tracing, since edges are kept. Writes benchmarks/results/gradients.json. Pin it to one core:
`taskset -c 0`.
"""

import os
import time
from typing import Any

import common
import jax
import jax.numpy as jnp
import numpy as np
from domains import CONVERGED, SHAPES

import jaxtissue as jt
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.neighbors.section_lists import find_sections
from jaxtissue.sections.cells import plan_layers
from jaxtissue.topology.traced_sizes import trace_sizes

NAMES = ("paper_Ra5", "ratio10_n100", "bluenoise_ratio10")
CELLS = 200  # on other domains
DIRECTIONS, STEP = 8, 2e-4  # a step is a length, of all backbones together
MANY = plan_layers(80, check=False)
ENERGIES = {"volume": jt.volume_elasticity, "lateral_area": jt.lateral_tension}


def tubes() -> dict[str, tuple[jt.Tube, np.ndarray]]:
    """Reference tubes, with their positions."""
    found = {}
    for name in NAMES:
        with np.load(common.HERE.parent / "tests" / "data" / f"{name}.npz") as data:
            tube = jt.Tube(*(float(data[key]) for key in ("L", "Ra", "Rb")))
            found[name] = tube, np.stack([data["x"], data["theta"]], axis=-1)
    return found


def domains() -> dict[str, tuple[Any, np.ndarray]]:
    """Other domains, with random positions."""
    shapes = SHAPES | {"slab": jt.Slab(12, 10, 1, periodic=(True, True))}
    tube, place = tubes()[NAMES[0]]
    found: dict[str, tuple[Any, np.ndarray]] = {
        f"{NAMES[0]}, sections": (jt.RoundTube(tube.length, tube.apical_radius, tube.basal_radius), place)
    }
    for name, shape in shapes.items():
        found[name] = shape, np.asarray(shape.random_positions(jax.random.key(1), CELLS))
    return found


def true_sizes(place: np.ndarray, domain: Any) -> jt.CellGeometry:
    """Volumes and lateral areas, as nearly right as they can be had."""
    if isinstance(domain, jt.Tube | jt.RoundTube):
        sizes = trace_sizes(place, jt.Tube(domain.length, domain.apical_radius, domain.basal_radius))
        assert sizes is not None
        return jt.CellGeometry(jnp.asarray(sizes.volume), jnp.asarray(sizes.lateral_area))
    sizes = find_sections(domain, as_domain_positions(place, domain), MANY, CONVERGED[1]).sizes
    return jt.CellGeometry(jnp.asarray(sizes.volume[0]), jnp.asarray(sizes.lateral_area[0]))


def moved(place: np.ndarray, way: np.ndarray, domain: Any) -> np.ndarray:
    """Positions some way on; unit vectors stay such."""
    there = place + way
    return there / np.linalg.norm(there, axis=1, keepdims=True) if place.shape[1] == 3 else there


def is_inner(place: np.ndarray, domain: Any, length: float) -> np.ndarray:
    """Which backbones stay within the domain, whichever way they go by a step."""
    if place.shape[1] == 3:
        return np.ones(len(place), bool)
    ends = [place + sign * length for sign in (1, -1)]
    return np.all([np.abs(np.asarray(domain.reflect(end)) - end).max(axis=1) < 1e-9 for end in ends], axis=0)


def measured(name: str, domain: Any, place: np.ndarray, resolutions: tuple[str, ...]) -> list[dict[str, Any]]:
    """The cosine for one tissue, by energy and resolution, and the cost of the gradient."""
    neighbors, ways, ends = jt.NeighborList.allocate(place, domain), [], []
    units = np.array([1, float(domain.basal_radius)]) if isinstance(domain, jt.Tube | jt.RoundTube) else 1.0
    inner = is_inner(place, domain, STEP)[:, None]
    for seed in range(DIRECTIONS):
        way = np.where(inner, np.random.default_rng(seed).normal(size=place.shape), 0)
        if place.shape[1] == 3:
            way -= (way * place).sum(axis=1, keepdims=True) * place
        ways.append(way / np.linalg.norm(way) / units)
        ends.append([true_sizes(moved(place, step * ways[-1], domain), domain) for step in (STEP, -STEP)])
    rows = []
    for energy, function in ENERGIES.items():
        model = jt.tube_model(domain, len(place), tension=1.0, cell_energy=function)
        sums = [[float(function(end, model).sum()) for end in pair] for pair in ends]
        expected = [(high - low) / (2 * STEP) for high, low in sums]
        for resolution in resolutions:

            def value(place: jax.Array, model: jt.Model = model, resolution: str = resolution) -> jax.Array:
                return jt.tissue_energy(place, model, neighbors, resolution)

            both = jax.jit(jax.value_and_grad(value))
            gradient = np.asarray(both(jnp.asarray(place))[1])
            found = [(gradient * way).sum() for way in ways]
            row = {"tissue": name, "resolution": resolution, "energy": energy, "cosine": cosine(found, expected)}
            if isinstance(domain, jt.Tube | jt.RoundTube):
                row["cosine_all"] = cosine(gradient / units, traced_gradient(place, domain, function) / units)
            print(row, flush=True)
            times = [median_seconds(function, jnp.asarray(place)) for function in (jax.jit(value), both)]
            rows.append(row | {"energy_seconds": times[0], "with_gradient_seconds": times[1]})
    return rows


def traced_gradient(place: np.ndarray, domain: Any, function: Any) -> np.ndarray:
    """The gradient of an energy of the traced edges."""
    tube = jt.Tube(domain.length, domain.apical_radius, domain.basal_radius)
    model = jt.tube_model(tube, len(place), tension=1.0, cell_energy=function)
    neighbors = jt.NeighborList.allocate(place, tube)
    return np.asarray(jax.grad(lambda x: jt.tissue_energy(x, model, neighbors, "traced"))(jnp.asarray(place)))


def cosine(found: Any, expected: Any) -> float:
    """The cosine of the angle between two arrays."""
    return float(np.sum(np.multiply(found, expected)) / np.linalg.norm(found) / np.linalg.norm(expected))


def median_seconds(function: Any, place: jax.Array) -> float:
    """Median of eleven calls, after one that compiles."""
    jax.block_until_ready(function(place))
    seconds = []
    for _ in range(11):
        begin = time.process_time()
        jax.block_until_ready(function(place))
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds))


if __name__ == "__main__":
    path = common.output((__doc__ or "").split("\n")[0], "gradients")
    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, (tube, place) in tubes().items():
        rows += measured(name, tube, place, ("standard", "fine", "traced"))
    for name, (domain, place) in domains().items():
        rows += measured(name, domain, place, ("standard", "fine"))
    load = {"load_average": os.getloadavg(), "cores": len(os.sched_getaffinity(0))}
    common.write(path, {"directions": DIRECTIONS} | load | {"rows": rows})
