"""Sweeps on every domain: local energy differences against the change of the whole, and single against joint moves.

    python benchmarks/domain_dynamics.py [--cells 120] [--out FILE]

In 64 bits, by `draft`: random tissues of straight backbones play three sweeps. The sum of the accepted local
differences is compared with the change of the energy as measured anew, and the same moves are played one by one in the
same order, unless some collided and were put off to the end of their sweep. Takes about half a minute for each domain,
most of it to compile.
"""

import math
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt
from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.domain_runs import domain_run
from jaxtissue.dynamics.independent_sets import independent_rounds
from jaxtissue.energy import in_precision

SWEEPS, TEMPERATURE = 3, 0.05  # T in units of K Vbar^2
DOMAINS: dict[str, Any] = {
    "slab": jt.Slab(12, 5, 1),
    "periodic slab": jt.Slab(10, 6, 1, periodic=(True, True)),
    "tube": jt.RoundTube(8, 1, 2),
    "periodic tube": jt.RoundTube(8, 1, 2, periodic=True),
    "elliptic tube": jt.EllipticTube(8, [1.5, 1], [2.5, 2]),
    "bent tube": jt.BentTube(bend_radius=6, arc=1.5, apical_radius=1, basal_radius=1.5),
    "torus": jt.BentTube(bend_radius=3, arc=2 * math.pi, apical_radius=1, basal_radius=1.5),
    "sphere": jt.Sphere(1, 1.5),
    "ellipsoid": jt.Ellipsoid([2, 1, 1], [2.5, 1.5, 1.5]),
    "fold": jt.Fold(width=12, depth=6, amplitude=0.6, wavelength=6, thickness=0.5),
}


def kept(domain: Any, cells: int) -> dict[str, float | None]:
    """What a few sweeps keep, as parts of the energy."""
    model = in_precision(jt.tube_model(domain, cells, relative=True), np.dtype(float))
    run = domain_run(model, "draft", 5, np.full(SWEEPS, TEMPERATURE))
    positions = np.asarray(domain.random_positions(jax.random.key(3), cells), float)
    before = run.survey(positions, Batch())
    rounds = independent_rounds("near", positions, model, before.contacts)
    played = run.play(before, SWEEPS * [rounds], 0, Batch())
    alone = np.full((cells, rounds.shape[1]), -1, np.int32)
    alone[:, 0] = rounds[rounds >= 0]
    one_by_one = run.play(before, SWEEPS * [alone], 0, Batch())
    first, last = (float(np.sum(model.cell_energy(m.state.cells.sizes, model))) for m in (before, played.measured))
    info, apart = played.trail.info, one_by_one.trail.positions - played.trail.positions
    whole = float(np.sum(np.asarray(before.state.cells.sizes.volume, float)))
    return {
        "volumes_off": whole / float(domain.volume) - 1,
        "sum_of_differences_off": abs(first + float(info.energy_change.sum()) - last) / abs(first),
        "single_moves_off": None if info.collisions.any() else float(np.abs(apart).max()),
        "acceptance": float(info.accepted.mean() / cells),
        "collisions": int(info.collisions.sum()),
    }


def main() -> None:
    """Play a few sweeps on every domain."""
    parser = common.options((__doc__ or "").split("\n")[0], "domain_dynamics")
    parser.add_argument("--cells", type=int, default=120)
    given, results = parser.parse_args(), {}
    jax.config.update("jax_enable_x64", True)
    for name, domain in DOMAINS.items():
        results[name] = kept(domain, given.cells)
        print(name, results[name], flush=True)
        common.write(given.out, {"cells": given.cells, "domains": results})


if __name__ == "__main__":
    main()
