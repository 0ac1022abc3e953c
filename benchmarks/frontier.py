"""The picture of error against time per diagram."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxtissue as jt

STYLES = {
    ("kept", "whole"): ("#0072B2", "o", "ours, lists kept"),
    ("kept", "one"): ("#56B4E9", "o", "ours, lists kept, one core"),
    ("scratch", "whole"): ("#009E73", "s", "ours, lists found anew"),
    ("voxels", "whole"): ("#999999", "v", "voxels counted"),
    ("exact", "one"): ("#CC79A7", "D", "exact path, one core"),
    ("peer", "one"): ("#D55E00", "^", "C++ peer (CGAL), one thread"),
}


def draw(rows: list[dict[str, Any]], cases: tuple[str, ...]) -> Figure:
    """Log-log, a panel for V and one for A in each case; presets and numbers of samples labelled."""
    figure = Figure(figsize=(11, 4.6 * len(cases)), layout="constrained")
    grid = figure.subplots(len(cases), 2, squeeze=False)
    for case, pair in zip(cases, grid, strict=True):
        for key, name, axes in zip(("volume", "lateral_area"), ("V", "A"), pair, strict=True):
            for style in STYLES:
                some = [row for row in rows if row["case"] == case and (row["kind"], row["threads"]) == style]
                _series(axes, [row for row in some if row[key]], key, style)
            axes.set(xscale="log", yscale="log", xlabel="milliseconds per diagram of 500 cells")
            axes.set(
                ylabel=f"error of {name}, % of the mean cell",
                title=f"${case}$: {name}",
            )
            axes.grid(alpha=0.3)
            axes.margins(0.18, 0.12)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def _series(axes: Axes, rows: list[dict[str, Any]], key: str, style: tuple[str, str]) -> None:
    """One kind: its points, a line through those that none beats in both, and labels."""
    color, marker, label = STYLES[style]
    if not rows:
        return
    time, error = (np.array([scale * row[name] for row in rows]) for scale, name in ((1e3, "seconds"), (100, key)))
    order = np.argsort(time)
    best = order[error[order] <= np.minimum.accumulate(error[order])]
    axes.plot(time, error, marker, ms=4, color=color, alpha=0.35)
    axes.plot(time[best], error[best], marker + "-", ms=4, color=color, label=label, lw=1)
    for row, x, y in zip(rows, time, error, strict=True):
        text = _text(row, style)
        if text:
            # presets stand where nothing is, since nothing beats them in both
            where = {"xytext": (-16, -20), "ha": "right"} if row["kind"] == "kept" else {"xytext": (5, 5)}
            line = {"arrowstyle": "-", "color": color, "lw": 0.7} if row["kind"] == "kept" else None
            look = {"textcoords": "offset points", "fontsize": 8, "color": color, "arrowprops": line}
            axes.annotate(text, (x, y), **where, **look)


def _text(row: dict[str, Any], style: tuple[str, str]) -> str:
    if style == ("kept", "whole"):
        known = {tuple(size): name for name, size in jt.PRESETS.items()}
        return known.get(tuple(row["size"]), "")
    return f"s = {row['size']}" if row["kind"] in ("exact", "peer") else ""
