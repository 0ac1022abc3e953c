"""The paper's statements on cells, energy, volumes and phi (Figs. 5 to 11), judged as in `claims`.

All statements on energies have one criterion: they must agree within `ENERGIES`, by the 95 % interval of the
ratio of MH and IS-MH, or of a mean of as many runs as the paper's, whose range is read off its figure.
"""

from collections.abc import Mapping

import numpy as np

from jaxtissue.reproduction import published
from jaxtissue.reproduction.claims import (
    ENERGIES,
    QUICK_SIZES,
    Claims,
    judge,
    judge_range,
    listed,
    mean_range,
    near,
)
from jaxtissue.reproduction.experiments import Plan, Table

_ENERGY = f"within {ENERGIES:.0%}, by the 95 % interval"
_PAPERS_SEEDS = 10
_SCATTER = "random tissues differ so much that means of 10 runs are not precise enough"
_GEOMETRY = "it is the energy of random tissues with the parameters of the paper, before any move"
_SPREAD = "the energy makes volumes equal but does not distribute the backbones evenly"
_PHI = {
    "covering_radius": f"{_SPREAD}: gaps between them remain",
    "tightness": f"{_SPREAD}: some pairs remain close, and the tightness is divided by the smallest distance",
}
_ENDS = (0.1, 0.15, 0.2, 0.3)  # distances from the mean volume from which a cell counts as off


def judge_cell(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """One cell before and after; tables: `fig5`."""
    before, after = tables["fig5"]["before"], tables["fig5"]["after"]
    claims, mean, cell = Claims("fig5"), before.mean(), before.argmin()
    told = [volume / published.CELL_MEAN for volume in (published.CELL_BEFORE, published.CELL_AFTER)]
    paper = f"{told[0]:.0%} to {told[1]:.0%} of the mean"
    ours = f"{before[cell]:.3g} to {after[cell]:.3g}, mean {mean:.3g}"
    numbers = paper, f"{ours}: {before[cell] / mean:.0%} to {after[cell] / mean:.0%}"
    met = None if plan.quick else near(after[cell], mean, 0.1)
    why = (
        QUICK_SIZES if plan.quick else "" if met else "it is a single cell; the next statement is about all such cells"
    )
    says = "a cell grows from a volume of 9 to 40, with a mean of 44; here the smallest cell of one run"
    claims.add(says, numbers, met, "final volume within 10 % of the mean; 44 is not the mean for R_a = 1 or 5", why)
    small = before < 0.25 * mean
    middle = float(np.median(after[small])) / mean if small.any() else np.nan
    numbers = paper, f"median of {small.sum()} cells: {middle:.0%}" if small.any() else "no such cell"
    met = None if plan.quick or not small.any() else near(middle, 1, 0.1)
    says = "cells that start below a quarter of the mean volume grow to about the mean"
    claims.add(says, numbers, met, "final median within 10 % of the mean", QUICK_SIZES if plan.quick else "")
    return claims


def judge_surfaces(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """The monolayer of Figs. 7 to 9; tables: `fig9`."""
    claims, table = Claims("fig9"), tables["fig9"]
    least = min(table["apical_area"].min(), table["basal_area"].min())
    numbers = "all cells", f"smallest area on a surface: {least:.2g}"
    claims.add("every cell reaches both surfaces", numbers, least > 0, "every area above 0")
    return claims


def judge_runs(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Energy over the sweeps, both algorithms, tightness; tables: `fig10`."""
    claims = Claims("fig10")
    for radius in (1.0, 5.0):
        _judge_run(claims, tables["fig10"], radius, plan)
    return claims


def _judge_run(claims: Claims, table: Table, radius: float, plan: Plan) -> None:
    energy, at = by_seed(table, radius, "is-mh", "energy"), f"R_a = {radius:g}"
    _judge_start(claims, energy[:, 0], at, plan)
    mean = energy.mean(axis=0)
    quarter = max(1, (len(mean) - 1) // 4)
    fall = mean[0] - mean[-1]
    early, late = (mean[0] - mean[quarter]) / fall, (mean[-1 - quarter] - mean[-1]) / fall
    numbers = "words", f"{early:.0%} of the decrease is in the first quarter of the sweeps"
    met, why = (None, QUICK_SIZES) if plan.quick else (early >= 0.5, "")
    claims.add(f"the energy decreases steeply at first, {at}", numbers, met, "at least half of the decrease", why)
    numbers = "words", f"{late:.1%} of the decrease is in the last quarter"
    met = None if plan.quick else 0 <= late <= 0.1
    claims.add(f"the energy decreases slowly at the end, {at}", numbers, met, "0 to 10 % of the decrease", why)
    last, other = energy[:, -1], by_seed(table, radius, "mh", "energy")[:, -1]
    low, high = mean_range(last / other)
    ours = f"IS-MH {last.mean():,.0f}, MH {other.mean():,.0f}; IS-MH / MH of each seed: {low:.3f} to {high:.3f}"
    verdict = judge_range((low, high), 1 - ENERGIES, 1 + ENERGIES)
    claims.add(f"MH and IS-MH reach similar energies, {at}", ("words", ours), verdict, _ENERGY)
    least, most = published.TIGHTNESS_RANGE
    for name, says in (
        ("covering_radius", "phi, as the covering radius,"),
        ("tightness", "phi, as the tightness,"),
    ):
        values = by_seed(table, radius, "is-mh", name)
        phi, begun = float(np.median(values[:, -quarter:])), float(np.median(values[:, 0]))
        met, why = (None, QUICK_SIZES) if plan.quick else (least <= phi <= most, _PHI[name])
        criterion = "the median over the last quarter of the sweeps"
        claims.add(
            f"{says} soon remains between 1 and 5, {at}",
            ("1 to 5", f"{phi:.3g} ({begun:.3g} at the start)"),
            met,
            criterion,
            why,
        )


def _judge_start(claims: Claims, start: np.ndarray, at: str, plan: Plan) -> None:
    """The energy of random tissue; the paper's is a mean of 10 runs, taken to scatter as ours do."""
    low, high = mean_range(start, _PAPERS_SEEDS)
    least, most = published.START_ENERGY
    verdict = judge_range((low, high), (1 - ENERGIES) * least, (1 + ENERGIES) * most)
    ours = f"{start.mean():,.0f}; a mean of 10 such runs is within {low:,.0f} to {high:,.0f} (95 %)"
    why = {"met": "", "too noisy": _SCATTER}.get(verdict, _GEOMETRY)
    if plan.quick:
        verdict, why = judge(None), QUICK_SIZES
    says, numbers = f"the energy starts at 300,000 to 350,000, {at}", ("read off the figure", ours)
    claims.add(says, numbers, verdict, _ENERGY, why)


def judge_volumes(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Volumes after the kept sweeps; tables: `fig11`, and `fig10` for phi where it is there."""
    claims, table = Claims("fig11"), tables["fig11"]
    sweeps, mean = np.unique(table["sweep"]), table["volume"][table["sweep"] == 0].mean()
    spread = [table["volume"][table["sweep"] == sweep].std() / mean for sweep in sweeps]
    numbers = "words", f"standard deviation / mean: {listed(spread, '.3f')}"
    criterion = f"it decreases at each of the sweeps {listed(sweeps, 'g')}"
    claims.add("volumes converge to the mean", numbers, (np.diff(spread) < 0).all(), criterion)
    _judge_ends(claims, table, plan)
    if "fig10" in tables:
        for name, says in (("covering_radius", "covering radius"), ("tightness", "tightness")):
            phi = float(np.median(by_seed(tables["fig10"], 1.0, "is-mh", name)[:, -1]))
            met, why = (None, QUICK_SIZES) if plan.quick else (near(phi, published.TIGHTNESS), _PHI[name])
            says = f"the final tissue has a phi of about 3, as the {says}"
            claims.add(says, ("3", f"{phi:.3g}"), met, "median within 20 %", why)
    return claims


def _judge_ends(claims: Claims, table: Table, plan: Plan) -> None:
    """Whether most cells that are off the mean volume in the end touch an end of the tube."""
    last = table["sweep"] == table["sweep"].max()
    volume, ends = table["volume"][last], table["is_end"][last].astype(bool)
    apart = np.abs(volume / volume.mean() - 1)
    off = {share: apart > share for share in _ENDS if (apart > share).any()}
    shown = (f"{ends[some].mean():.0%} of {some.sum()} (deviation above {share:.0%})" for share, some in off.items())
    numbers = "most", f"{', '.join(shown)}; {ends.mean():.0%} of all cells touch an end"
    met = all(ends[some].mean() > 0.5 for some in off.values()) if off and not plan.quick else None
    why = QUICK_SIZES if plan.quick else "it depends on the deviation above which a cell is counted"
    says = "most cells whose volume remains far from the mean are at the ends of the tube"
    claims.add(says, numbers, met, "more than half, for each deviation", why if not met else "")


def by_seed(table: Table, radius: float, algorithm: str, name: str) -> np.ndarray:
    """A column of the runs as [seeds, sweeps]."""
    chosen = (table["apical_radius"] == radius) & (table["algorithm"] == algorithm)
    return table[name][chosen].reshape(len(np.unique(table["seed"][chosen])), -1)
