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
# Why do cells of a curved epithelium change neighbors between their two surfaces? First four cells, where everything is
# known by a formula, then whole tissues.

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
COLORS = np.array([[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167]], np.uint8)

# %% [markdown]
# ## Four cells
# Two backbones lie at angles +a and -a, two others ahead and behind at a distance h along the axis. The first two move
# apart as the tube widens, so the other two come into contact: at the radius h / sin(a) all four meet in one point.

# %%
a, h = 0.6, 0.85
tube = jt.Tube(length=4, apical_radius=1, basal_radius=2)
four = np.array([[2, a], [2, -a], [2 - h, 0], [2 + h, 0]])
tissue = jt.find_connectivity(four, tube)
for place, met in zip(tissue.transitions.points, tissue.transitions.cells, strict=True):
    print(f"cells {met.tolist()} meet at radius {np.hypot(*place[1:]):.6f}; h / sin(a) = {h / np.sin(a):.6f}")

# %% [markdown]
# Sections of the four cells on layers from the apical to the basal surface: blue and orange touch below, green and pink
# above. All four are scutoids.


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
# In a tissue a contact may reach both surfaces, only the apical, only the basal, or neither. The larger the surface
# ratio R_b / R_a, the fewer neighbors a cell keeps from one surface to the other, and the more it has in all. The
# tissues are random, with 100 cells of equal mean volume; cells that touch an end of the tube are left out.

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
# Two cells that touch within the tissue only: on neither surface an observer would call them neighbors. The wall
# between them opens at transition points below and closes at others above, the black balls. The picture is by
# `jaxtissue view`, of the tissue with ratio 5.

# %%
np.savetxt("random.csv", tissues[5], delimiter=",", header="axial,angle", comments="")

# %% language="bash"
# jaxtissue measure random.csv --length 20 --apical-radius 2 --basal-radius 10 --flat --out random
# jaxtissue view random --what internal

# %%
Image("random/internal.png", width=600)
