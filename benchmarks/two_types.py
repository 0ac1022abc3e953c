"""Tissue of two types that sorts: walls between unlike cells cost four times as much as others.

Writes how the fraction of wall area between unlike cells falls with the sweeps, beside the same tissue whose walls all
cost the same, and draws the basal surface before and after.
"""

from pathlib import Path

import common
import jax
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import jaxtissue as jt
from jaxtissue.runs.surface_maps import label_surface

TUBE, CELLS, SWEEPS, COST, TEMPERATURE = jt.Tube(40.0, 4.0, 8.0), 400, 2000, 4.0, 2.0
SHOWN = (0, 10, 100, 500, SWEEPS)
PICTURE = Path(__file__).parent.parent / "docs" / "two_types.png"
COLORS = np.array([mpl.colors.to_rgba(color) for color in ("#0072B2", "#E69F00")])
WALL = (0.15, 0.15, 0.15, 1.0)


def unlike(positions: np.ndarray, types: np.ndarray) -> float:
    """The fraction of wall area between cells of unlike types."""
    contacts = jt.find_contacts(positions, TUBE)
    apart = types[contacts.pairs[:, 0]] != types[contacts.pairs[:, 1]]
    return float(contacts.area[apart].sum() / contacts.area.sum())


def anneal(positions: np.ndarray, types: np.ndarray, cost: float) -> dict[int, np.ndarray]:
    """The positions after some of the sweeps, unlike walls at a cost."""
    shown = {0: positions}

    def keep(record: jt.SweepRecord, place: np.ndarray) -> None:
        if record.sweep in SHOWN:
            shown[record.sweep] = np.asarray(place)

    adhesion = jt.Adhesion(types, np.array([[1.0, cost], [cost, 1.0]]))
    model = jt.tube_model(TUBE, CELLS, adhesion=adhesion)
    jt.anneal(positions, TUBE, SWEEPS, TEMPERATURE, model=model, callback=keep)
    return shown


def draw(shown: dict[int, np.ndarray], types: np.ndarray) -> Figure:
    """The unrolled basal surface at first and at last, to scale, a color for each type."""
    around = 2 * np.pi * float(TUBE.basal_radius)
    figure = Figure(figsize=(10, 6.2), layout="constrained")
    for panel, sweep in zip(figure.subplots(1, 2, sharey=True), (0, SWEEPS), strict=True):
        labels = label_surface(shown[sweep], TUBE, "basal", (640, 800))
        image = COLORS[types[labels]]
        wall = labels != np.roll(labels, -1, axis=1)
        wall[:-1] |= labels[:-1] != labels[1:]
        image[wall] = WALL
        panel.imshow(image.swapaxes(0, 1), origin="lower", extent=(0, float(TUBE.length), 0, around))
        panel.set(
            xlabel="axial position", title=f"after {sweep} sweeps: {unlike(shown[sweep], types):.0%} of wall unlike"
        )
        panel.set_ylabel("distance around the tube" if sweep == 0 else "")
    return figure


def main() -> None:
    """Anneal with and without the cost, write the fractions, draw the picture."""
    arguments = common.options(__doc__ or "", "two_types").parse_args()
    positions = np.asarray(TUBE.random_positions(jax.random.key(0), CELLS))
    types = np.random.default_rng(0).integers(0, 2, CELLS)
    rows = {}
    for name, cost in (("unlike cost more", COST), ("all cost the same", 1.0)):
        shown = anneal(positions, types, cost)
        rows[name] = {str(sweep): unlike(place, types) for sweep, place in sorted(shown.items())}
        print(name, " ".join(f"{sweep}: {share:.3f}" for sweep, share in rows[name].items()), flush=True)
        if cost == COST:
            draw(shown, types).savefig(PICTURE, dpi=110)
    common.write(arguments.out, {"cells": CELLS, "cost": COST, "unlike_wall_fraction": rows})


if __name__ == "__main__":
    main()
