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
# A tube of epithelium in which each cell is given by its *backbone*, a straight segment from the inner (apical) to the
# outer (basal) surface. You will measure the cells, relax the tissue, look at it in three dimensions, and count who
# touches whom. Lengths have the unit of the tube's sizes, here micrometers.

# %%
# %matplotlib inline
import os
import tempfile

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import jaxtissue as jt

os.chdir(tempfile.mkdtemp())  # the commands below leave their files here

tube = jt.Tube(length=16, apical_radius=4, basal_radius=8)
positions = tube.random_positions(jax.random.key(2), 60)  # a row for each cell: position along the axis, angle
print(tube)

# %% [markdown]
# ## Cells
# Each cell is the part of the tissue that is nearer to its backbone than to any other. Together they fill the tube.

# %%
cells = jt.measure_tissue(positions, tube)
print(f"mean volume {cells.volume.mean():.1f}, from {cells.volume.min():.1f} to {cells.volume.max():.1f} µm^3")
print(f"all of them / tube: {cells.volume.sum() / tube.volume:.6f}")

# %% [markdown]
# ## Relaxing the tissue
# Random cells differ a lot. The energy E = sum of K/2 (Vbar - V)^2 + Lambda A asks for equal volumes V and small walls
# A between cells. In each *sweep* every backbone tries one small move, by the rule of Metropolis.

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
# The command `jaxtissue measure` takes a table of backbones and leaves tables and pictures in a folder. Here the tube
# is cut open: the lumen, the small apical surfaces round it, and the large basal surfaces outside.

# %%
np.savetxt("annealed.csv", result.positions, delimiter=",", header="axial,angle", comments="")

# %% language="bash"
# jaxtissue measure annealed.csv --length 16 --apical-radius 4 --basal-radius 8 --out annealed

# %%
Image("annealed/tissue.png", width=600)

# %% [markdown]
# Unrolled, the two surfaces show that cells have other neighbors on the basal surface (top) than on the apical one
# (bottom). Somewhere between they change.

# %%
Image("annealed/surfaces.png", width=700)

# %% [markdown]
# ## A scutoid
# A cell that changes neighbors along its height is a scutoid. Each black ball is a *transition point*, where four cells
# meet: two of them stop touching there, and the other two begin to.

# %%
Image("annealed/scutoid.png", width=600)

# %% [markdown]
# ## Who touches whom
# The same in numbers. Contacts and transition points are traced along the edges of the diagram, in 64 bits. A contact
# reaches both surfaces, only one of them, or none (`internal`).

# %%
tissue = jt.find_connectivity(result.positions, tube)
summary = jt.summarize_connectivity(tissue)
for kind in ("apical_basal", "apical", "basal", "internal"):
    print(f"{kind:13} neighbors of a cell: {summary[f'{kind}_neighbors']:.2f}")
print(f"in all {summary['neighbors']:.2f}; scutoids: {summary['scutoid_fraction']:.0%} of the cells")

# %% [markdown]
# More: `02_scutoids` explains the kinds of neighbors, `05_image_to_model` begins with a segmented image of yours.
