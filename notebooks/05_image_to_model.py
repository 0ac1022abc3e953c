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
# # From a segmented image to a model
#
# This notebook obtains volumes, neighbors and scutoids from a label image, first directly from the voxels, then from a
# model that is fitted to the image. The image is computed from a simulated tissue, so the correct results are known. To
# use your own image, read it with `image = tifffile.imread("labels.tif")` and set `spacing` to the sides of its voxels.

# %%
# %matplotlib inline
import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxtissue as jt

tube = jt.Tube(length=12, apical_radius=2, basal_radius=5)
start = tube.random_positions(jax.random.key(4), 40)
truth = jt.anneal(start, tube, sweeps=30, temperature=2.0).positions
spacing = (0.25, 0.2, 0.2)  # sides of a voxel along z, y and x, in micrometers
image = np.pad(jt.label_image(truth, tube, spacing), 3)  # order (z, y, x), 0 outside
print(image.shape, image.dtype, len(np.unique(image)) - 1, "cells")

# %% [markdown]
# ## What the image shows
# Each color is one cell. The left slice is along the tube, the right one across it, with the lumen in the center.


# %%
def show(labels, title):
    """A slice along the axis and one across it."""
    shades = np.random.default_rng(1).permutation(labels.max()) % 20
    colors = np.vstack([[1, 1, 1, 1], plt.get_cmap("tab20")(shades)])
    figure, axes = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained", width_ratios=(12, 10))
    middle = np.array(labels.shape) // 2
    axes[0].imshow(colors[labels[middle[0] + 12]], aspect=spacing[1] / spacing[2], origin="lower")
    axes[0].set(xlabel="x (voxels)", ylabel="y (voxels)", title=f"{title}, along the tube")
    axes[1].imshow(colors[labels[:, :, middle[2]]], aspect=spacing[0] / spacing[1], origin="lower")
    axes[1].set(xlabel="y (voxels)", ylabel="z (voxels)", title=f"{title}, across the tube")
    plt.close(figure)
    return figure


show(image, "image")

# %% [markdown]
# ## Measuring the voxels
# `measure_labels` counts voxels and their faces. It needs no model for volumes, contacts and scutoids.

# %%
seen = jt.measure_labels(image, spacing)
print(seen)
print(f"neighbors {seen.neighbors.mean():.2f}, scutoids {seen.is_scutoid.mean():.0%}")

# %% [markdown]
# ## Fitting the tissue
# `fit_tissue` finds the tube and the backbones whose Voronoi cells agree best with the cells of the image. The report
# shows how well they agree. Check `voxels_same` first, the fraction of voxels that have the same label in both.

# %%
fit = jt.fit_tissue(image, spacing)
print(fit.domain)
for name, value in fit.report.items():
    print(f"{name:18}{value:.4g}")

# %% [markdown]
# The voxels whose label differs between model and image are located at the walls.

# %%
show(np.where(fit.voxels == image, 0, image), "voxels that differ")

# %% [markdown]
# ## What the model adds to the image
# The walls of the model are traced along all their edges, so its contacts and transition points are exact. They are
# compared with those of the tissue from which the image was computed.

# %%
for name, tissue in (("drawn from", jt.find_connectivity(truth, tube)), ("fitted", fit.connectivity)):
    summary = jt.summarize_connectivity(tissue)
    told = ", ".join(f"{key} {summary[key]:.2f}" for key in ("neighbors", "transitions", "scutoid_fraction"))
    print(f"{name:11}{told}")

# %%
figure, axes = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
axes.axline((0, 0), slope=1, color="0.7")
axes.plot(fit.cells.volume, fit.connectivity.sizes.volume, ".", color="#0072B2")
axes.set(
    xlabel="volume in the image (µm$^3$)", ylabel="volume of the model's cell (µm$^3$)", xlim=(0, None), ylim=(0, None)
)
plt.close(figure)
figure

# %% [markdown]
# The fitted tissue can be simulated further, for example with `jt.anneal(fit.positions, fit.domain)`. The command
# `jaxtissue fit labels.tif --out fitted` performs all these steps and writes the results to a folder.
