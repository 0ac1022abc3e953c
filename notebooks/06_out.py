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
# # Export to Fiji, napari, ParaView and networkx
#
# This notebook exports a tissue to several file formats and reads each file with the library that is commonly used for
# it. It needs the extras `io` and `viz`: `pip install 'jaxtissue[io,viz]'`.

# %%
# %matplotlib inline
import warnings

warnings.filterwarnings("ignore", "IProgress")  # of bars that are not shown here

# %%
import os
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import networkx as nx
import numpy as np
import pandas as pd
import pyvista
import tifffile
import trimesh
from IPython.display import Image

import jaxtissue as jt

os.chdir(tempfile.mkdtemp())  # the commands below write their files here
tube = jt.Tube(length=16, apical_radius=2, basal_radius=6)
random = tube.random_positions(jax.random.key(3), 60)
np.savetxt("cells.csv", random, delimiter=",", header="axial,angle", comments="")

# %% [markdown]
# ## Export
# `--spacing` gives the sides of a voxel along z, y and x. `--unit` gives the unit of length, which is stored in the
# files.

# %% language="bash"
# jaxtissue measure cells.csv --length 16 --apical-radius 2 --basal-radius 6 --flat --out run
# jaxtissue export run --to ome-tiff vtu glb graphml parquet --spacing 0.2 0.1 0.1 --unit um --out out

# %%
for path in sorted(Path("out").iterdir()):
    print(f"{path.name:18}{path.stat().st_size / 1000:9.0f} kB")

# %% [markdown]
# ## Fiji and napari: an image of labels
# The value of a voxel is the number of its cell + 1, and 0 outside the tissue. Open `labels.ome.tif` in Fiji, or as a
# labels layer in napari. The figure shows a slice across the tube and one along it.

# %%
with tifffile.TiffFile("out/labels.ome.tif") as file:
    image = file.asarray()
print(image.shape, image.dtype, len(np.unique(image)) - 1, "cells")
shades = np.random.default_rng(0).permutation(len(random)) % 20
colors = np.vstack([[1, 1, 1, 1], plt.get_cmap("tab20")(shades)])
figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", width_ratios=(12, 16))
panels[0].imshow(colors[image[:, :, image.shape[2] // 2]], extent=(0, 12, 0, 12), origin="lower")
panels[0].set(xlabel="y (µm)", ylabel="z (µm)", title="across the tube")
panels[1].imshow(colors[image[image.shape[0] // 2]], extent=(0, 16, 0, 12), origin="lower")
panels[1].set(xlabel="x (µm)", ylabel="y (µm)", title="along the tube")
plt.close(figure)
figure

# %% [markdown]
# ## ParaView: cells, walls, backbones and transition points
# Open `cells.vtu`, `backbones.vtp` and `transitions.vtp` together in ParaView. Here PyVista reads the first two and
# draws half of the cells, colored by their number of neighbors, and the backbones of the other cells in black.

# %%
solid, lines = pyvista.read("out/cells.vtu"), pyvista.read("out/backbones.vtp")
print(sorted(solid.cell_data))
plotter = pyvista.Plotter(off_screen=True, window_size=(900, 500))
plotter.set_background("white")
behind = lines.cell_centers().points[:, 1] > 0  # one for each cell
half = solid.extract_cells(behind[solid["cell"]])
bar = {
    "color": "black",
    "title": "neighbors",
    "n_labels": 4,
    "fmt": "%.0f",
    "title_font_size": 20,
    "label_font_size": 18,
    "vertical": True,
    "height": 0.6,
    "position_x": 0.85,
    "position_y": 0.2,
}
plotter.add_mesh(half, scalars="neighbors", cmap="viridis", scalar_bar_args=bar)
plotter.add_mesh(lines.extract_cells(~behind), color="black", line_width=3)
plotter.view_vector((0.3, -1, 0.4), viewup=(0, 0, 1))
plotter.camera.zoom(1.4)
plotter.screenshot("cells.png")
plotter.close()
Image("cells.png", width=600)

# %% [markdown]
# ## Blender and 3D printers: closed meshes
# `cells.glb` contains one node per cell; the formats `ply` and `stl` write one file per cell. Neighbors share the
# triangles of their common wall, so the volumes add up to the volume of the tube.

# %%
scene = trimesh.load("out/cells.glb")
volumes = np.array([solid.volume for solid in scene.geometry.values()])
print(f"{len(volumes)} closed: {all(solid.is_watertight for solid in scene.geometry.values())}")
print(f"sum of the volumes / tube: {volumes.sum() / tube.volume:.5f}")

# %% [markdown]
# ## networkx: the contact graph
# The nodes have the columns of the table of cells as attributes, the edges the area and the kind of the contact.
# Contacts that reach neither surface are drawn in red.

# %%
graph = nx.read_graphml("out/graph.graphml")
table = pd.read_parquet("out/cells.parquet")
print(graph, "clustering", round(nx.average_clustering(graph), 3))
place = {node: (table["axial"][i], 4 * table["angle"][i]) for i, node in enumerate(graph)}
colors = {"apical_basal": "0.2", "apical": "#0072B2", "basal": "#E69F00", "internal": "red"}
figure, axes = plt.subplots(figsize=(9, 6), layout="constrained")
near = [(u, v) for u, v in graph.edges if abs(place[u][1] - place[v][1]) < 12]  # not those across the cut
for kind, color in colors.items():
    own = [edge for edge in near if graph.edges[edge]["kind"] == kind]
    nx.draw_networkx_edges(graph, place, own, edge_color=color, width=1.5, ax=axes)
nx.draw_networkx_nodes(graph, place, node_size=60, node_color="white", edgecolors="black", ax=axes)
for kind, color in colors.items():
    axes.plot([], [], color=color, label=kind)
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
axes.tick_params(bottom=True, left=True, labelbottom=True, labelleft=True)
axes.set(xlabel="along the axis (µm)", ylabel="around the axis, at mid-height (µm)", aspect="equal")
plt.close(figure)
figure

# %% [markdown]
# ## pandas
# The table contains sizes, numbers of neighbors and measures of the shapes of the cells.

# %%
table[["volume", "height", "tilt", "sphericity", "solidity", "neighbors", "transitions"]].describe().loc[
    ["mean", "std", "min", "max"]
].round(3)
