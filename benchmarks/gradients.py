"""Gradients of volumes and lateral areas against central differences of traced sizes, on reference tubes.

    python benchmarks/gradients.py

For random directions of all backbones: the cosine of the derivatives by `tissue_energy` and by differences, of the
volume term of the paper's energy and of the sum of all lateral areas. Times are the processor's, so that other work on
the machine counts little; those of "traced" lack the tracing, since edges are kept. Writes
benchmarks/results/gradients.json. Pin it to one core: `taskset -c 0`.
"""

import os
import time
from typing import Any

import common
import jax
import jax.numpy as jnp
import numpy as np

import jaxtissue as jt
from jaxtissue.topology.traced_sizes import trace_sizes

NAMES = ("paper_Ra5", "ratio10_n100", "bluenoise_ratio10")
DIRECTIONS, STEP = 8, 5e-3  # the step is a length, of all backbones together
ENERGIES = {"volume": jt.volume_elasticity, "lateral_area": jt.lateral_tension}


def measured(name: str, size: str, energy: str) -> dict[str, Any]:
    """The cosine for one tube, resolution and energy, and the cost of the gradient against that of the energy."""
    with np.load(common.HERE.parent / "tests" / "data" / f"{name}.npz") as file:
        data = dict(file)
    tube = jt.Tube(*(float(data[key]) for key in ("L", "Ra", "Rb")))
    place = np.stack([data["x"], data["theta"]], axis=-1)
    model = jt.tube_model(tube, len(place), tension=1.0, cell_energy=ENERGIES[energy])
    neighbors = jt.NeighborList.allocate(place, tube)

    def value(place: jax.Array) -> jax.Array:
        return jt.tissue_energy(place, model, neighbors, size)

    both = jax.jit(jax.value_and_grad(value))
    gradient = np.asarray(both(jnp.asarray(place))[1])

    def true_energy(place: np.ndarray) -> float:
        sizes = trace_sizes(place, tube)
        assert sizes is not None
        return float(ENERGIES[energy](jt.CellGeometry(sizes.volume, sizes.lateral_area), model).sum())

    units, found, expected = np.array([1, float(tube.basal_radius)]), [], []
    for seed in range(DIRECTIONS):
        way = np.random.default_rng(seed).normal(size=place.shape)
        way /= np.linalg.norm(way) * units
        found.append((gradient * way).sum())
        expected.append((true_energy(place + STEP * way) - true_energy(place - STEP * way)) / (2 * STEP))
    cosine = np.dot(found, expected) / np.linalg.norm(found) / np.linalg.norm(expected)
    times = [median_seconds(function, jnp.asarray(place)) for function in (jax.jit(value), both)]
    row = {"tube": name, "resolution": size, "energy": energy, "cosine": float(cosine)}
    print(row, flush=True)
    return row | {"energy_seconds": times[0], "with_gradient_seconds": times[1]}


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
    rows = [
        measured(name, size, energy) for name in NAMES for size in ("standard", "fine", "traced") for energy in ENERGIES
    ]
    load = {"load_average": os.getloadavg(), "cores": len(os.sched_getaffinity(0))}
    common.write(path, {"directions": DIRECTIONS} | load | {"rows": rows})
