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
# One tissue is an anecdote. Here a grid of tissues is annealed as replicas of one compiled program.

# %%
# %matplotlib inline
import os
import tempfile

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

os.chdir(tempfile.mkdtemp())  # the commands below leave their files here

# %% [markdown]
# ## A grid from the command line
# Two surface ratios, three temperatures and two seeds are 12 tissues of 30 cells. The table grows with new values and
# goes on where it was stopped; rows are spread over the cores of the machine.

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

# %% [markdown]
# Each point is a tissue, lines are means over the seeds. Hot tissues stay far from equal volumes; neighbors depend on
# the surface ratio much more than on the temperature. The same command with `--seed 0 1 2` would anneal the six rows
# that are missing then, and no other.

# %% [markdown]
# ## Replicas of your own
# `jt.step` is one sweep as a pure function, so `vmap` makes replicas of it, on CPUs and GPUs alike: here each of
# sixteen has its own temperature.
#
# ```python
# states = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (16, *leaf.shape)), jt.init(positions, model))
# sweep = jax.jit(jax.vmap(lambda key, state, T: jt.step(key, state, model, T)))
# states, info = sweep(jax.random.split(jax.random.key(0), 16), states, jnp.geomspace(1, 1000, 16))
# ```
#
# `jt.temper` makes replicas at several temperatures that exchange their tissues. On clusters `jaxtissue grid --slurm`
# shares out the rows: see the page on grids of tissues.
