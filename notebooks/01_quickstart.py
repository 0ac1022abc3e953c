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
# # Quickstart: from a random tube to its scutoids
#
# This notebook simulates a tube of epithelium. Each cell is represented by its *backbone*, a straight segment from the
# inner (apical) to the outer (basal) surface. You will measure the cells, relax the tissue, view it in three
# dimensions, and count the neighbors of the cells. All lengths have the unit in which you give the sizes of the tube,
# here micrometers.

# %%
# %matplotlib inline
import os
import tempfile

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import jaxtissue as jt

os.chdir(tempfile.mkdtemp())  # the commands below write their files here

tube = jt.Tube(length=16, apical_radius=4, basal_radius=8)
positions = tube.random_positions(jax.random.key(2), 60)  # a row for each cell: position along the axis, angle
print(tube)

# %% [markdown]
# ## Cells
# Each cell is the part of the tissue that is nearer to its own backbone than to any other. Together the cells fill the
# tube.

# %%
cells = jt.measure_tissue(positions, tube)
print(f"mean volume {cells.volume.mean():.1f}, from {cells.volume.min():.1f} to {cells.volume.max():.1f} µm^3")
print(f"all of them / tube: {cells.volume.sum() / tube.volume:.6f}")

# %% [markdown]
# ## Relaxing the tissue
# The volumes of random cells differ a lot. The energy E = sum of K/2 (Vbar - V)^2 + Lambda A is low if all volumes V
# are equal and the areas A of the walls between cells are small. In each *sweep*, one small move of every backbone is
# proposed, and accepted or rejected by the Metropolis rule.

# %%
result = jt.anneal(positions, tube, sweeps=40, temperature=2.0)
figure, axes = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
axes[0].semilogy(result.energies, color="#0072B2")
axes[0].set(xlabel="sweep", ylabel="energy of the tissue")
bins = np.linspace(0, float(cells.volume.max()), 25)
axes[1].hist([cells.volume, result.cells.volume], bins, color=["0.7", "#0072B2"], label=["random", "annealed"])
axes[1].set(xlabel="cell volume (µm$^3$)", ylabel="cells")
axes[1].legend(frameon=False)
plt.close(figure)
figure

# %% [markdown]
# ## The tissue in three dimensions
# The command `jaxtissue measure` reads a table of backbones and writes tables and pictures to a folder. In the picture,
# the tube is cut open. It shows the lumen, the small apical surfaces of the cells around the lumen, and their large
# basal surfaces on the outside.

# %%
np.savetxt("annealed.csv", result.positions, delimiter=",", header="axial,angle", comments="")

# %% language="bash"
# jaxtissue measure annealed.csv --length 16 --apical-radius 4 --basal-radius 8 --out annealed

# %%
Image("annealed/tissue.png", width=600)

# %% [markdown]
# The two surfaces, unrolled: a cell can have different neighbors on the basal surface (top) and on the apical surface
# (bottom). Between the two surfaces, these cells change neighbors.

# %%
Image("annealed/surfaces.png", width=700)

# %% [markdown]
# ## A scutoid
# A cell that changes neighbors along its height is a scutoid. Each black ball marks a *transition point*, where four
# cells meet: two of them lose contact there, and the other two come into contact.

# %%
Image("annealed/scutoid.png", width=600)

# %% [markdown]
# ## Contacts between cells
# `find_connectivity` finds all contacts and transition points by tracing the edges of the Voronoi diagram in 64 bits. A
# contact reaches both surfaces (`apical_basal`), only one of them (`apical` or `basal`), or neither (`internal`).

# %%
tissue = jt.find_connectivity(result.positions, tube)
summary = jt.summarize_connectivity(tissue)
for kind in ("apical_basal", "apical", "basal", "internal"):
    print(f"{kind:13} neighbors of a cell: {summary[f'{kind}_neighbors']:.2f}")
print(f"in all {summary['neighbors']:.2f}; scutoids: {summary['scutoid_fraction']:.0%} of the cells")

# %% [markdown]
# The notebook `02_scutoids` explains the kinds of neighbors. `05_image_to_model` starts from a segmented image.
