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
# # Scutoids and kinds of neighbors
#
# Why do the cells of a curved epithelium change neighbors between their two surfaces? This notebook first shows four
# cells, for which the transition point is known from a formula, and then whole tissues.

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
COLORS = np.array([[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167]], np.uint8)

# %% [markdown]
# ## Four cells
# Two backbones are at the angles +a and -a. Two others lie between them at angle 0, at a distance h ahead and behind
# along the axis. With increasing radius, the distance between the first two increases, so the other two come into
# contact: at the radius h / sin(a) all four cells meet in one point.

# %%
a, h = 0.6, 0.85
tube = jt.Tube(length=4, apical_radius=1, basal_radius=2)
four = np.array([[2, a], [2, -a], [2 - h, 0], [2 + h, 0]])
tissue = jt.find_connectivity(four, tube)
for place, met in zip(tissue.transitions.points, tissue.transitions.cells, strict=True):
    print(f"cells {met.tolist()} meet at radius {np.hypot(*place[1:]):.6f}; h / sin(a) = {h / np.sin(a):.6f}")

# %% [markdown]
# Sections of the four cells at four radii, from the apical to the basal surface. At small radii the blue and the orange
# cell are in contact, at large radii the green and the pink one. All four cells are scutoids.


# %%
def draw_layer(radius, axes):
    """The cells on the layer of a radius, unrolled and to scale."""
    along, around = np.meshgrid(np.linspace(1, 3, 240), np.linspace(-1.2, 1.2, 240))
    angle = around / radius
    points = np.stack([along, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    cells = jt.label_points(points.reshape(-1, 3), four, tube).reshape(along.shape)
    axes.imshow(COLORS[cells], origin="lower", extent=(1, 3, -1.2, 1.2))
    axes.set(title=f"radius {radius:.2f}", xlabel="along the axis")


figure, panels = plt.subplots(1, 4, figsize=(9, 3.2), sharey=True, layout="constrained")
for radius, axes in zip((1.0, 1.3, h / np.sin(a), 1.95), panels, strict=True):
    draw_layer(radius, axes)
panels[0].set_ylabel("around the axis")
plt.close(figure)
figure

# %% [markdown]
# ## Four kinds of neighbors
# A contact can reach both surfaces, only the apical surface, only the basal surface, or neither. The larger the surface
# ratio R_b / R_a, the fewer contacts reach both surfaces, and the more neighbors a cell has in total. The tissues are
# random, with 100 cells each. Cells that touch an end of the tube are not counted.

# %%
KINDS = {"apical_basal": "#0072B2", "apical": "#E69F00", "basal": "#009E73", "internal": "#CC79A7"}
ratios = (1.25, 2, 5, 10)
rows, tissues = [], {}
for ratio in ratios:
    wall = jt.Tube(length=20, apical_radius=10 / ratio, basal_radius=10)
    tissues[ratio] = wall.random_positions(jax.random.key(1), 100)
    rows.append(jt.summarize_connectivity(jt.find_connectivity(tissues[ratio], wall), inner_only=True))

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
bottom = np.zeros(len(ratios))
for kind, color in KINDS.items():
    mean = np.array([row[f"{kind}_neighbors"] for row in rows])
    axes.bar([f"{ratio:g}" for ratio in ratios], mean, bottom=bottom, color=color, label=kind)
    bottom += mean
axes.set(xlabel="surface ratio R_b / R_a", ylabel="neighbors of a cell")
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.close(figure)
figure

# %%
for ratio, row in zip(ratios, rows, strict=True):
    print(
        f"ratio {ratio:5}: {row['neighbors']:5.2f} neighbors, {row['transitions']:5.2f} transition points a cell, "
        f"{row['scutoid_fraction']:4.0%} scutoids"
    )

# %% [markdown]
# ## An internal pair
# These two cells are in contact only inside the tissue: on both surfaces they are not neighbors. The wall between them
# begins at transition points at a small radius and ends at transition points at a larger radius (black balls). The
# command `jaxtissue view` draws the picture, from the tissue with the ratio 5.

# %%
np.savetxt("random.csv", tissues[5], delimiter=",", header="axial,angle", comments="")

# %% language="bash"
# jaxtissue measure random.csv --length 20 --apical-radius 2 --basal-radius 10 --flat --out random
# jaxtissue view random --what internal

# %%
Image("random/internal.png", width=600)
