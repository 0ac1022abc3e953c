"""Curves of the paper's table and figures beside its numbers; each function returns (figure, axes).

Tables are those of `experiments` and `timings`. Bands are one standard deviation over the seeds.
"""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from jaxtissue.reproduction import published
from jaxtissue.reproduction.experiments import Table
from jaxtissue.reproduction.timings import RULES

# Okabe and Ito's colors, which color-blind readers tell apart; line styles tell them apart too.
_BLUE, _ORANGE, _GREEN, _PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
_RULE_COLORS = (_BLUE, _GREEN, _ORANGE, _PURPLE, "#777777")
_TIMED = (  # column, label, color, marker, and the paper's times it is to be compared with
    ("whole", "MH, whole diagrams (extrapolated)", _PURPLE, "^", "mh_seconds"),
    ("mh", "MH, local", _ORANGE, "s", ""),
    ("near", "IS-MH, near rule", _BLUE, "o", "is_mh_seconds"),
)


def plot_times(table: Table) -> tuple[Figure, np.ndarray]:
    """Seconds per sweep and rounds against the number of cells, beside the paper's (paper, Table 1)."""
    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.subplots(1, 2)
    for radius, dashes, size in ((1.0, "-", 8), (5.0, "--", 5)):
        rows = {name: column[table["apical_radius"] == radius] for name, column in table.items()}
        paper = [published.TABLE_1.get((radius, int(n))) for n in rows["cells"]]
        told = [n for n, row in zip(rows["cells"], paper, strict=True) if row]
        for name, label, color, marker, theirs in _TIMED:
            here = f"{label}, $R_a$ = {radius:g}"
            look: dict[str, Any] = {"marker": marker, "ms": size, "color": color}
            axes[0].plot(rows["cells"], rows[f"{name}_seconds"], dashes, label=here, **look)
            if theirs:
                seconds = [getattr(row, theirs) for row in paper if row]
                here = f"the paper's {label.partition(',')[0]}, $R_a$ = {radius:g}"
                axes[0].plot(told, seconds, dashes, alpha=0.6, mfc="white", label=here, **look)
        for (rule, name), color in zip(RULES.items(), _RULE_COLORS, strict=True):
            label = f"{name.replace('-phi', ' phi')}, $R_a$ = {radius:g}"
            look = {"marker": "o", "ms": size, "color": color}
            axes[1].plot(rows["cells"], rows[f"{rule}_sets"], dashes, label=label, **look)
        look = {"marker": "D", "ms": size, "color": "black", "mfc": "white"}
        rounds = [row.rounds for row in paper if row]
        axes[1].plot(told, rounds, dashes, label=f"paper, $R_a$ = {radius:g}", **look)
    for panel, name in zip(axes, ("seconds per sweep", "rounds per sweep"), strict=True):
        panel.set(xlabel="cells", ylabel=name, xscale="log", yscale="log")
        panel.grid(which="both", color="0.92")
        panel.xaxis.set_major_locator(FixedLocator(np.unique(table["cells"]).tolist()))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    axes[1].yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes[1].yaxis.set_minor_formatter(NullFormatter())
    for axis in (axes[0].yaxis, axes[1].yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[0].set_title("Time (the paper's: a laptop with 4 cores)")
    axes[1].set_title("Sets of independent moves under each rule")
    return figure, axes


def plot_runs(table: Table, as_paper: bool = True) -> tuple[Figure, np.ndarray]:
    """Energy by sweeps and by rounds, MH against IS-MH, covering radius and tightness (paper, Fig. 10).

    The energy at the start that is read off the paper is marked for tissue `as_paper`, of 500 cells.
    """
    figure = Figure(figsize=(12, 8.4), layout="constrained")
    axes = figure.subplots(2, 2)
    for panel in axes[1]:
        panel.set_yscale("log")
    for radius, color in ((1.0, _BLUE), (5.0, _ORANGE)):
        rows = where(table, apical_radius=radius, algorithm="is-mh")
        label = f"$R_a$ = {radius:g}"
        band(axes[0, 0], rows["sweep"], rows["energy"], color, "-", label)
        sweeps, so_far, _ = grouped(rows["sweep"], rows["rounds_so_far"])
        energy = grouped(rows["sweep"], rows["energy"])[1]
        axes[0, 1].plot(
            so_far,
            energy,
            color=color,
            label=f"{label}, {so_far[-1] / max(sweeps[-1], 1):.0f} rounds a sweep",
        )
        for algorithm, dashes in (("is-mh", "-"), ("mh", ":")):
            rows = where(table, apical_radius=radius, algorithm=algorithm)
            band(axes[1, 0], rows["sweep"], rows["energy"], color, dashes, f"{label}, {algorithm.upper()}")
        rows = where(table, apical_radius=radius, algorithm="is-mh")
        band(axes[1, 1], rows["sweep"], rows["covering_radius"], color, "-", f"covering radius, {label}")
        band(axes[1, 1], rows["sweep"], rows["tightness"], color, ":", f"tightness, {label}")
    low, high = published.START_ENERGY
    for panel in axes[0] if as_paper else ():
        panel.axhspan(
            low,
            high,
            facecolor="none",
            edgecolor="0.5",
            hatch="///",
            label="start, read off the paper's Fig. 10",
        )
    axes[1, 1].axhspan(*published.TIGHTNESS_RANGE, color="0.9", label="phi in the paper, 1 to 5")
    titles = ("Energy of the tissue", "The same against rounds, the paper's axis",
              "MH and IS-MH at equal sweeps", "How tight the spread of backbones is")  # fmt: skip
    for panel, title in zip(axes.flat, titles, strict=True):
        panel.set(title=title, xlabel="sweep", ylabel="energy (model units)")
        panel.grid(which="both", color="0.92")
    for panel in axes[0]:
        panel.set_ylim(bottom=0)
    axes[0, 1].set_xlabel("rounds")
    axes[1, 1].set(ylabel="covering radius (length units); tightness (no unit)")
    for panel in axes.flat:
        panel.legend(fontsize=8, loc="lower right" if panel is axes[1, 1] else "upper right")
    return figure, axes


def plot_volume_ranks(table: Table, mean_volume: float, length: float) -> tuple[Figure, np.ndarray]:
    """Sorted volumes after the kept sweeps, mean and spread, and where cells stay off (paper, Fig. 11)."""
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    axes = figure.subplots(1, 2)
    sweeps = np.unique(table["sweep"])
    colors = mpl.colormaps["viridis"](np.linspace(0, 0.9, len(sweeps)))
    for sweep, color in zip(sweeps, colors, strict=True):
        rows = where(table, sweep=sweep)
        label = "start" if sweep == 0 else f"sweep {sweep:g}"
        band(axes[0], rows["rank"], rows["volume"], color, ":" if sweep == 0 else "-", label)
    axes[0].axhline(mean_volume, color="black", ls=":", label=f"mean {mean_volume:.3g}")
    axes[0].set(xlabel="cells, from the smallest to the largest", ylabel="cell volume (length units³)")
    axes[0].set_title("Sorted volumes, mean of the runs")
    axes[0].set_ylim(bottom=0)
    last = where(table, sweep=sweeps[-1])
    off = 100 * np.abs(last["volume"] / mean_volume - 1)
    for ends, color, marker, label in ((0, _BLUE, ".", "inner cells"), (1, _ORANGE, "x", "cells at an end")):
        at = last["is_end"] == ends
        axes[1].plot(last["axial"][at], off[at], marker, color=color, ms=4, alpha=0.6, label=label)
    axes[1].set(xlabel="axial position (length units)", ylabel="distance to the mean volume (%)", xlim=(0, length))
    axes[1].set_title(f"Where volumes are off after {sweeps[-1]:g} sweeps, all runs")
    for panel in axes:
        panel.grid(color="0.92")
        panel.legend(fontsize=8)
    return figure, axes


def where(table: Table, **values: Any) -> Table:
    """The rows of a table that have the given values."""
    chosen = np.all([table[name] == value for name, value in values.items()], axis=0)
    return {name: column[chosen] for name, column in table.items()}


def grouped(place: np.ndarray, value: np.ndarray) -> Sequence[Float[np.ndarray, " groups"]]:
    """The places, and mean and standard deviation of the values at each."""
    places, at = np.unique(place, return_inverse=True)
    count = np.bincount(at)
    mean = np.bincount(at, value) / count
    return places, mean, np.sqrt(np.bincount(at, (value - mean[at]) ** 2) / np.maximum(count - 1, 1))


def band(axes: Axes, place: np.ndarray, value: np.ndarray, color: Any, dashes: str, label: str) -> None:
    """Draw the mean and the spread of the values at each place; on a logarithmic axis those of their logs."""
    logs = axes.get_yscale() == "log"
    places, mean, spread = grouped(place, np.log(value) if logs else value)
    middle, low, high = (np.exp(part) if logs else part for part in (mean, mean - spread, mean + spread))
    marker = "o" if len(places) < 20 else ""
    axes.plot(places, middle, dashes, marker=marker, ms=4, color=color, label=label)
    axes.fill_between(places, low, high, color=color, alpha=0.18, lw=0)
