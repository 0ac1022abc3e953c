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
# # The evaluation of the paper on small tissues
#
# Buceta, Funke and Storandt (GRAPP 2025) study how the number of neighbors depends on the surface ratio R_b / R_a of a
# tube. This notebook repeats this study with 100 cells instead of 500. The command `jaxtissue reproduce` repeats the
# whole evaluation of the paper in its original size.

# %%
# %matplotlib inline
import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxtissue as jt

ratios = np.array([1.25, 2, 3, 5, 10, 20, 50, 100, 200])

# %% [markdown]
# ## Neighbors against the surface ratio
# For all cells of a random tissue at each ratio, the table shows the mean number of neighbors in three dimensions, the
# mean number of transition points, the fraction of scutoids, and the fraction of cells with an internal neighbor.

# %%
KINDS = {"apical_basal": "#0072B2", "apical": "#E69F00", "basal": "#009E73", "internal": "#CC79A7"}


def tube_of(ratio):
    return jt.Tube(length=20, apical_radius=10 / ratio, basal_radius=10)


positions = {ratio: tube_of(ratio).random_positions(jax.random.key(int(ratio)), 100) for ratio in ratios}
tissues = {ratio: jt.find_connectivity(positions[ratio], tube_of(ratio)) for ratio in ratios}
rows = [jt.summarize_connectivity(tissue) for tissue in tissues.values()]
print(f"{'ratio':>6}{'neighbors':>11}{'transitions':>13}{'scutoids':>10}{'with internal':>15}")
for ratio, row in zip(ratios, rows, strict=True):
    print(
        f"{ratio:6g}{row['neighbors']:11.2f}{row['transitions']:13.2f}{row['scutoid_fraction']:10.0%}"
        f"{row['internal_fraction']:15.0%}"
    )

# %% [markdown]
# ## The neighbor law
# The paper fits the mean number of neighbors by a logistic function of the logarithm of the ratio ("Flintstones' law").

# %%
neighbors = np.array([row["neighbors"] for row in rows])
law = jt.fit_neighbor_law(ratios, neighbors)
print(f"from {law.low:.1f} to {law.high:.1f} neighbors, half way at ratio {law.middle:.1f}, r2 = {law.r2:.4f}")
figure, panels = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
wide = np.geomspace(1.1, 250, 100)
panels[0].semilogx(wide, law.predict(wide), color="0.6", label="logistic law")
panels[0].semilogx(ratios, neighbors, "o", color="#0072B2", label="random tissues")
panels[0].axhline(10.5, color="#D55E00", ls="--", lw=1, label="the paper at ratio 200")
panels[0].set(xlabel="surface ratio R_b / R_a", ylabel="neighbors of a cell")
panels[0].legend(frameon=False)
for kind, color in KINDS.items():
    panels[1].semilogx(ratios, [row[f"{kind}_neighbors"] for row in rows], "o-", color=color, label=kind)
panels[1].set(xlabel="surface ratio R_b / R_a", ylabel="neighbors of each kind")
panels[1].legend(frameon=False)
plt.close(figure)
figure

# %% [markdown] Up to ratio 10 the results agree with the paper, and from ratio 3 on nearly all cells are scutoids. At
# larger ratios the cells have more neighbors than the 10.5 of the paper. Most of these neighbors are internal.

# %% [markdown]
# ## What counts as a neighbor
# The number of neighbors depends on the smallest wall that is counted as a contact. Without walls below a few percent
# of the mean wall area, the curve levels off near the values of the paper.

# %%
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
for threshold, color in ((0, "#0072B2"), (0.01, "#56B4E9"), (0.02, "#E69F00"), (0.05, "#D55E00")):
    walls = [tissue.contacts.area for tissue in tissues.values()]
    counts = [2 * (area > threshold * area.mean()).sum() / 100 for area in walls]  # each wall has two cells
    axes.semilogx(ratios, counts, "o-", color=color, label=f"walls above {threshold:.0%} of the mean wall")
axes.set(xlabel="surface ratio R_b / R_a", ylabel="neighbors of a cell")
axes.legend(frameon=False)
plt.close(figure)
figure

# %% [markdown]
# ## Upper bounds from the paper
# How many neighbors can a cell have? Lemmas 1 and 2 and Corollary 1 of the paper give upper bounds that depend on the
# tightness phi: the largest distance of a point of the tissue to its nearest backbone, divided by the smallest distance
# of two backbones. The measured numbers are far below these bounds.

# %%
for row in jt.bound_ratios(positions[10], tube_of(10), tissues[10]):
    print(f"{row['bound']:12} within {row['hops']} contacts: at most {row['limit']:9.0f}, found {row['measured']}")
