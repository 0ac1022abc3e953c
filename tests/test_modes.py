"""A session's settings of JAX, strict or otherwise, neither break the library nor change its results."""

from contextlib import ExitStack

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.compilation.modes import random_key
from jaxtissue.geometry.backbones import distance_between_segments, distance_to_segment
from jaxtissue.neighbors.search import check_angles, find_candidates, tiling_defect
from jaxtissue.runs import plots

STRICT = {
    "numpy_dtype_promotion": "strict",
    "numpy_rank_promotion": "raise",
    "transfer_guard": "disallow",
    "debug_nans": True,
    "debug_infs": True,
    "disable_jit": True,
    "threefry_partitionable": False,
}
CELLS = 16


def results() -> dict[str, np.ndarray]:
    """What a user computes: everything that works with JAX, on one small tissue."""
    tube, draft = jt.Tube(12, 2, 4), jt.PRESETS["draft"]
    place = np.asarray(tube.random_positions(random_key(3), CELLS))
    backbones, voxels = tube.embed(place), jt.cylindrical_voxels(tube, (4, 3, 8))
    ends = np.asarray(backbones.apical)[:4]
    labels, distances = jt.nearest_backbones(voxels[0], backbones)
    sides = find_candidates(place, tube)
    cells = jt.measure_tissue(place, tube, draft)
    model = jt.tube_model(tube, CELLS)
    annealer = jt.Annealer(model, draft, "is-mh", 1, jt.constant_schedule(2.0, 1))
    state = annealer.start(place)
    plots.plot_surfaces(tube, [plots.Tissue("", place, cells.volume)])
    found = {
        "positions": place,
        "volume": cells.volume,
        "lateral area": cells.lateral_area,
        "defect": tiling_defect(place, tube, sides, check_angles(tube, CELLS)),
        "energy": model.cell_energy(cells, model),
        "record": annealer.record(state).energy,
        "annealed": annealer.advance(state)[0].positions,
        "contacts": jt.find_connectivity(place, tube).contacts.area,
        "exact": jt.exact_cells(place, tube, 5).volume,
        "separation": jt.separation(place, tube),
        "covering": jt.covering_radius(place, tube),
        "distances": distances,
        "labeled": jt.label_volumes(labels[:, 0], voxels[1], CELLS),
        "image": jt.label_image(place, tube, 1.0),
        "reflected": tube.reflect(place + 20),
        "to segment": distance_to_segment(*ends[:3]),
        "between segments": distance_between_segments(*ends),
    }
    return {name: np.asarray(value) for name, value in found.items()}


def test_strict_settings_change_no_result() -> None:
    usual = results()
    with ExitStack() as stack:
        for name, value in STRICT.items():
            stack.enter_context(getattr(jax, name)(value))
        strict = results()
    for name, value in usual.items():
        np.testing.assert_array_equal(strict[name], value, name)


@pytest.mark.parametrize("setting", [("jax_default_prng_impl", "rbg"), ("jax_random_seed_offset", 5)])
def test_a_seed_gives_the_same_tissue_by_any_generator(setting) -> None:
    name, value = setting
    before, wanted = getattr(jax.config, name), jax.random.key_data(jax.random.key(7))
    jax.config.update(name, value)
    try:
        assert not np.array_equal(jax.random.key_data(jax.random.key(7)), wanted)
        np.testing.assert_array_equal(jax.random.key_data(random_key(7)), wanted)
    finally:
        jax.config.update(name, before)


def test_sums_over_many_cells_are_right(x64):
    """What jaxlib 0.10.2 adds wrongly unless it is told not to (jax issue 39103): each time, or now and then."""
    many = 16_385
    rows = jnp.stack([jnp.arange(many, dtype=float), *2 * [jnp.zeros(many)]], axis=1)
    squares = jax.jit(jax.vmap(lambda row: ((jnp.eye(3) @ row) ** 2).sum()))(rows)
    np.testing.assert_array_equal(squares, np.arange(many, dtype=float) ** 2)
    slab = jt.Slab(4, 3, 2, periodic=(True, True))
    np.testing.assert_allclose(np.array([float(slab.volume) for _ in range(1500)]), 24, rtol=1e-12)
