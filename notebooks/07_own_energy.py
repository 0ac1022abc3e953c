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
# can also relax down its gradient.

# %%
# %matplotlib inline
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxtissue as jt

tube = jt.Tube(length=11, apical_radius=2, basal_radius=4)
cells = 48
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
# ## Its gradient
# `tissue_energy` is the energy of the tissue as a function that JAX differentiates. A finite difference along the
# steepest way up checks it.

# %%
neighbors = jt.NeighborList.allocate(positions, tube)


@jax.jit
def energy_and_gradient(place):
    return jax.value_and_grad(jt.tissue_energy)(place, model, neighbors, "draft")


energy, gradient = energy_and_gradient(positions)
slope, step = jnp.linalg.norm(gradient), 2e-3
up, down = (float(energy_and_gradient(positions + side * step * gradient / slope)[0]) for side in (1, -1))
print(f"energy {energy:.1f}, slope {slope:.1f}, by differences {(up - down) / (2 * step):.1f}")

# %% [markdown]
# ## Down the gradient, and on by annealing
# `relax` ends in the next minimum. Annealing at a temperature takes the tissue out of it: now cells can pass each
# other, and the two types sort.

# %%
relaxed = jt.relax(positions, model)
print(relaxed)
annealed = jt.anneal(relaxed.positions, tube, sweeps=150, temperature=2.0, model=model)
print(f"relaxed {relaxed.energy:.1f}, annealed {annealed.energies[-1]:.1f}")


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
    axes.set(title=f"{title}:\n{unlike(place):.0%} of wall unlike", xlabel="axial position")


figure, axes = plt.subplots(1, 3, figsize=(9, 7), sharey=True, layout="constrained")
steps = {"random": positions, "relaxed": relaxed.positions, "annealed": annealed.positions}
for panel, (title, place) in zip(axes, steps.items(), strict=True):
    surface(place, title, panel)
axes[0].set_ylabel("distance around the tube")
plt.close(figure)
figure

# %% [markdown]
# And each cell has nearly the volume that it wants:

# %%
for title, place in steps.items():
    off = np.asarray(jt.measure_tissue(place, tube).volume) / np.asarray(targets) - 1
    print(f"{title:9} rms of volume / target - 1: {np.sqrt((off**2).mean()):.3f}")
