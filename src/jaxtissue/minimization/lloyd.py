"""Lloyd's method: every backbone moves to the centroid of its cell, over and over.

No energy is involved: cells become compact, and their volumes alike (Lloyd, IEEE Trans. Inf. Theory 28, 129, 1982).
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxtissue.minimization.placed_energy import ITERATIONS, REACH, RELAXED, PlacedEnergy, Stage


def move_to_centroids(
    positions: Float[np.ndarray, "n d"], energy: PlacedEnergy, steps: int, tolerance: float
) -> Iterator[Stage]:
    """The tissue at each check of the lists; relaxed where moves are a part `tolerance` of the first, in the mean."""
    here, first, moved = energy.renewed(energy.placed(positions)), 0.0, np.inf
    for step in range(steps + 1):
        is_relaxed = moved <= tolerance * first
        yield Stage(energy.record(step, here), energy.positions(here.place), RELAXED if is_relaxed else "")
        place = here.place
        for _ in range(ITERATIONS if step < steps else 0):
            before, place = place, energy.centroids(place)
            moved = float(np.sqrt(((place - before) ** 2).mean()))
            first = first or moved
            if moved <= tolerance * first or np.abs(place - here.place).max() >= REACH * energy.width:
                break
        here = energy.renewed(place) if step < steps else here
