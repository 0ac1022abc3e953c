# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Your own energy, its gradient, and two cell types
#
# An energy is a Python function of the measured cells. Annealing takes any; where JAX can differentiate it, a tissue
# can also relax down its gradient. Lengths are in micrometers.

# %%
# %matplotlib inline
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxtissue as jt

tube = jt.Tube(length=9, apical_radius=2, basal_radius=4)
cells = 36
positions = tube.random_positions(jax.random.key(0), cells)
types = np.random.default_rng(0).integers(0, 2, cells)

# %% [markdown]
# ## The energy
# Cells of type 1 (orange) want to be twice as large as those of type 0 (blue). What differs from cell to cell travels
# with the model as `parameters`. With an `Adhesion`, walls between unlike cells count four times in the lateral area.

# %%
share = np.where(types == 1, 2.0, 1.0)
targets = jnp.asarray(share / share.sum() * tube.volume)


def two_types(measured, model):
    return 2 * (measured.volume - model.parameters) ** 2 + 0.4 * measured.lateral_area


adhesion = jt.Adhesion(types, np.array([[1.0, 4.0], [4.0, 1.0]]))
model = jt.tube_model(tube, cells, cell_energy=two_types, parameters=targets, adhesion=adhesion)

# %% [markdown]
# ## Down its gradient
# `jt.tissue_energy` is the energy of the whole tissue as a function that JAX differentiates, by positions, sizes of the
# tube and constants. `jt.relax` goes down its gradient to the next minimum.

# %%
relaxed = jt.relax(positions, model)
print(relaxed)
for record in relaxed.history[:: max(len(relaxed.history) // 4, 1)]:
    print(
        f"{record.evaluations:4} evaluations: energy {record.energy:8.1f}, norm of the gradient {record.gradient:8.1f}"
    )

# %% [markdown]
# ## Annealing
# At a temperature cells can pass each other, and the two types sort. Here the random tissue is cooled from T = 20 to T
# = 0.5.

# %%
sweeps = 80
schedule = jt.geometric_schedule(20.0, 0.5, sweeps)
annealed = jt.anneal(positions, tube, sweeps=sweeps, temperature=schedule, model=model)
print(f"random {relaxed.history[0].energy:.0f}, relaxed {relaxed.energy:.0f}, annealed {annealed.energies[-1]:.0f}")


# %%
def unlike(place):
    """The part of all wall area that lies between unlike cells."""
    contacts = jt.find_contacts(place, tube)
    apart = types[contacts.pairs[:, 0]] != types[contacts.pairs[:, 1]]
    return contacts.area[apart].sum() / contacts.area.sum()


def surface(place, title, axes):
    """The unrolled basal surface, to scale, in the colors of the types."""
    x, angle = np.meshgrid(np.linspace(0.02, tube.length - 0.02, 250), np.linspace(0, 2 * np.pi, 570))
    radius = tube.basal_radius
    points = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    labels = jt.label_points(points.reshape(-1, 3), place, tube).reshape(x.shape)
    image = np.array([[0.0, 0.45, 0.70], [0.90, 0.62, 0.0]])[types[labels]]
    wall = (labels != np.roll(labels, 1, axis=0)) | (labels != np.roll(labels, 1, axis=1))
    wall[:, 0] = False
    image[wall] = 0.15
    axes.imshow(image, origin="lower", extent=(0, tube.length, 0, 2 * np.pi * radius))
    axes.set(title=f"{title}:\n{unlike(place):.0%} of wall unlike", xlabel="along the axis (µm)")


figure, axes = plt.subplots(1, 3, figsize=(8, 7), sharey=True, layout="constrained")
steps = {"random": positions, "relaxed": relaxed.positions, "annealed": annealed.positions}
for panel, (title, place) in zip(axes, steps.items(), strict=True):
    surface(place, title, panel)
axes[0].set_ylabel("around the tube (µm)")
plt.close(figure)
figure

# %% [markdown]
# Unlike cells share half of the wall at first, and much less when relaxed or annealed: neighbors of one type stay
# together. In 400 cells 2,000 sweeps bring it down to 16 % (`benchmarks/two_types.py`). And each cell has nearly the
# volume that it wants:

# %%
for title, place in steps.items():
    off = np.asarray(jt.measure_tissue(place, tube).volume) / np.asarray(targets) - 1
    print(f"{title:9} rms of volume / target - 1: {np.sqrt((off**2).mean()):.3f}")
