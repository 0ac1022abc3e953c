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
# An energy is a Python function of the measured cells. `jt.anneal` accepts any such function. If JAX can differentiate
# it, `jt.relax` can minimize it by its gradient. Lengths are in micrometers.

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
# The target volume of cells of type 1 (orange) is twice that of cells of type 0 (blue). Values that differ between
# cells are stored in the model as `parameters`. With this `Adhesion`, walls between cells of different types have four
# times the weight of other walls in the lateral area.

# %%
share = np.where(types == 1, 2.0, 1.0)
targets = jnp.asarray(share / share.sum() * tube.volume)


def two_types(measured, model):
    return 2 * (measured.volume - model.parameters) ** 2 + 0.4 * measured.lateral_area


adhesion = jt.Adhesion(types, np.array([[1.0, 4.0], [4.0, 1.0]]))
model = jt.tube_model(tube, cells, cell_energy=two_types, parameters=targets, adhesion=adhesion)

# %% [markdown]
# ## Minimization by the gradient
# `jt.tissue_energy` computes the energy of the whole tissue. JAX can differentiate it with respect to the positions,
# the sizes of the tube and the constants of the model. `jt.relax` follows the gradient to a local minimum.

# %%
relaxed = jt.relax(positions, model)
print(relaxed)
for record in relaxed.history[:: max(len(relaxed.history) // 4, 1)]:
    print(
        f"{record.evaluations:4} evaluations: energy {record.energy:8.1f}, norm of the gradient {record.gradient:8.1f}"
    )

# %% [markdown]
# ## Annealing
# At a temperature above 0 the cells can exchange places, and the two types sort. Here the random tissue is cooled from
# T = 20 to T = 0.5.

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
# In the random tissue, half of the total wall area is between cells of different types. Relaxation and annealing reduce
# this fraction, because walls between cells of the same type cost less energy. In a tissue of 400 cells, 2,000 sweeps
# reduce it to 16 % (`benchmarks/two_types.py`). The volumes of the cells come close to their target volumes:

# %%
for title, place in steps.items():
    off = np.asarray(jt.measure_tissue(place, tube).volume) / np.asarray(targets) - 1
    print(f"{title:9} rms of volume / target - 1: {np.sqrt((off**2).mean()):.3f}")
