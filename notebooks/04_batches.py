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
# # Many tissues at once
#
# General conclusions need more than one tissue. This notebook anneals a grid of tissues as replicas, which run in one
# compiled program.

# %%
# %matplotlib inline
import os
import tempfile

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

os.chdir(tempfile.mkdtemp())  # the commands below write their files here

# %% [markdown]
# ## A grid from the command line
# Two surface ratios, three temperatures and two seeds give 12 tissues of 30 cells each, one per row of the table. The
# rows are distributed over the processor cores. If the command is stopped, the same command continues with the missing
# rows, and values can be added later.

# %% language="bash"
# jaxtissue grid --ratio 1.5 5 --temperature 1 10 100 --seed 0 1 \
#     --length 8 --basal-radius 6 --cells 30 --sweeps 15 --batch 12 --out grid

# %%
table = pd.read_csv("grid/table.csv")
print(f"{len(table)} rows, {len(table.columns)} columns")
table[["apical_radius", "temperature", "seed", "energy", "neighbors", "scutoid_fraction"]].head()

# %%
figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for ratio, color in zip((1.5, 5), ("#0072B2", "#E69F00"), strict=True):
    own = table[np.isclose(table["ratio"], ratio)]
    for axes, column in zip(panels, ("energy", "neighbors"), strict=True):
        mean = own.groupby("temperature")[column].mean()
        axes.plot(own["temperature"], own[column], ".", color=color)
        axes.plot(mean.index, mean, "-", color=color, label=f"R_b / R_a = {ratio:g}")
        axes.set(xscale="log", xlabel="temperature", ylabel=column.replace("_", " "))
panels[0].set_yscale("log")
panels[0].legend(frameon=False)
plt.close(figure)
figure

# %% [markdown] Each point is one tissue; lines are means over the seeds. At high temperature the volumes remain
# unequal. The number of neighbors depends much more on the surface ratio than on the temperature. The same command with
# `--seed 0 1 2` would anneal only the six new rows.

# %% [markdown]
# ## Replicas of your own
# `jt.step` computes one sweep and is a pure function, so `jax.vmap` can run it for several replicas at once, on CPUs
# and GPUs. In this example, sixteen replicas have different temperatures:
#
# ```python
# states = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (16, *leaf.shape)), jt.init(positions, model))
# sweep = jax.jit(jax.vmap(lambda key, state, T: jt.step(key, state, model, T)))
# states, info = sweep(jax.random.split(jax.random.key(0), 16), states, jnp.geomspace(1, 1000, 16))
# ```
#
# `jt.temper` anneals replicas at several temperatures that exchange their tissues (parallel tempering). On a cluster,
# `jaxtissue grid --slurm` distributes the rows over the jobs of a job array; see the page on grids of tissues.
