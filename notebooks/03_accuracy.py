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
# # Accuracy of approximate Voronoi cells
#
# Annealing measures cells millions of times. It therefore measures them on a small number of quadrature lines. How
# large is the error, and how much time does this save? This notebook compares three methods: quadrature lines (`draft`,
# `standard`, `fine`), sampled backbones (the method of the paper, `exact_cells`), and counting voxels. The reference
# are sizes from traced edges, which are accurate to about 1e-5 of the mean cell.

# %%
# %matplotlib inline
import time

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxtissue as jt

tube = jt.Tube(length=20, apical_radius=1, basal_radius=10)
positions = tube.random_positions(jax.random.key(0), 100)
truth = jt.find_connectivity(positions, tube).sizes

# %% [markdown]
# ## What is exact
# The distance from a point to a backbone, a segment, has a closed form. On a line parallel to the axis, each cell is
# one interval, and its two ends are computed exactly. The lengths of all cells along a line therefore add up to the
# length of the tube, unless a neighbor is missing. The largest error of this sum is the *tiling defect*.

# %%
measurers = {preset: jt.CellMeasurer(tube, preset) for preset in ("draft", "standard", "fine")}
measurers["draft"].measure(positions)
defect = float(measurers["draft"].neighbors.tiling_defect)
print(f"largest error of that sum, as a fraction of the length: {defect:.1e}")

# %% [markdown]
# ## What is approximated
# Between the lines, sizes are interpolated. The table shows root mean square errors over the cells, as fractions of the
# mean cell, and the time of the fastest of several calls with existing neighbor lists, as during annealing.


# %%
def timed(measure):
    """What a call gives, and the seconds of the fastest of some more."""
    found, seconds, ends = measure(), np.inf, time.perf_counter() + 0.5
    while not seconds < np.inf or time.perf_counter() < ends:
        begin = time.perf_counter()
        measure()
        seconds = min(seconds, time.perf_counter() - begin)
    return found, seconds


def error(found, true):
    return float(np.sqrt(np.mean((np.asarray(found) - true) ** 2)) / true.mean())


def count_voxels(shape):
    """Volumes by counting the voxels of a grid that follows the surfaces."""
    points, volumes = jt.cylindrical_voxels(tube, shape)
    return np.asarray(jt.label_volumes(jt.label_points(points, positions, tube), volumes, 100))


rows = []
for preset, measurer in measurers.items():
    cells, seconds = timed(lambda measurer=measurer: jax.block_until_ready(measurer.measure(positions, check=False)))
    rows.append(
        ("lines", preset, error(cells.volume, truth.volume), error(cells.lateral_area, truth.lateral_area), seconds)
    )
for samples in (4, 10, 25):
    cells, seconds = timed(lambda samples=samples: jt.exact_cells(positions, tube, samples))
    rows.append(
        (
            "samples",
            f"{samples} samples",
            error(cells.volume, truth.volume),
            error(cells.lateral_area, truth.lateral_area),
            seconds,
        )
    )
for shape in ((30, 14, 45), (50, 24, 75)):
    volume, seconds = timed(lambda shape=shape: count_voxels(shape))
    rows.append(("voxels", f"{np.prod(shape) // 100} voxels", error(volume, truth.volume), np.nan, seconds))
print(f"{'':14}{'volume':>10}{'area':>10}{'ms':>10}")
for _, name, volume, area, seconds in rows:
    print(f"{name:14}{volume:10.3%}{area:10.3%}{1000 * seconds:10.1f}")

# %%
LOOKS = {"lines": ("o-", "#0072B2"), "samples": ("s-", "#E69F00"), "voxels": ("^-", "#009E73")}
figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), sharex=True, layout="constrained")
for way, (look, color) in LOOKS.items():
    own = [row for row in rows if row[0] == way]
    for axes, column in zip(panels, (2, 3), strict=True):
        axes.loglog([1000 * row[4] for row in own], [row[column] for row in own], look, color=color, label=way)
panels[0].set(xlabel="milliseconds for 100 cells", ylabel="error / mean cell", title="volume")
panels[1].set(xlabel="milliseconds for 100 cells", title="lateral area")
panels[0].legend(frameon=False)
plt.close(figure)
figure

# %% [markdown] These times were measured on a busy machine. The page on accuracy has times of an idle machine, and the
# errors on eight reference tubes.
#
# `measure_tissue` finds the neighbors, estimates the error of each size, and traces the cells whose error is too large.
# Use `draft` for annealing, where the temperature causes larger differences than these errors, `standard` for tables of
# cells, and tracing (`find_connectivity`) to count neighbors.
