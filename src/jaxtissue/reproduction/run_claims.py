"""What the paper says of time, energy and volumes (Table 1, Figs. 5 to 11), judged as in `claims`."""

from collections.abc import Mapping

import numpy as np

from jaxtissue.reproduction import published
from jaxtissue.reproduction.claims import QUICK_SIZES, Claims, listed, near
from jaxtissue.reproduction.experiments import Plan, Table

_MACHINE = "another machine, and a move here measures only the cells that it changes"
_LOCAL = "MH is fast here too: a move measures the few cells that it changes, not the whole tissue"
_RULES = {
    "8_phi": ("8 phi", "the rule that the paper states; 8 covering radii reach past most of the cells"),
    "2_hop": ("2-hop", "cells within two contacts get different rounds; this does not assure independence"),
}


def judge_times(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Table 1, row by row and as a whole; tables: `table1`."""
    table, claims = tables["table1"], Claims("table1")
    for values in zip(*table.values(), strict=True):
        row = dict(zip(table, values, strict=True))
        paper = published.TABLE_1.get((row["apical_radius"], int(row["cells"])))
        if paper is None:
            continue
        at = f"R_a = {row['apical_radius']:g}, n = {row['cells']:g}"
        for name, theirs in (("mh", paper.mh_seconds), ("is_mh", paper.is_mh_seconds)):
            numbers = f"{theirs:g} s", f"{row[f'{name}_seconds']:.3g} s"
            claims.add(f"time of a step, {name.replace('_', '-').upper()}, {at}", numbers, None, "", _MACHINE)
        for rule, (name, why) in _RULES.items():
            found = row[f"rounds_{rule}"]
            numbers = f"{paper.rounds}", f"{found:.0f}"
            claims.add(f"rounds, {name} rule, {at}", numbers, near(found, paper.rounds), "within 20 %", why)
    _judge_speed(claims, table)
    _judge_growth(claims, table)
    return claims


def _judge_speed(claims: Claims, table: Table) -> None:
    ratio = table["mh_seconds"] / table["is_mh_seconds"]
    numbers = "in every row", f"MH / IS-MH: {listed(ratio, '.2g')}"
    claims.add("IS-MH is faster than MH", numbers, (ratio > 1).all(), "every ratio above 1", _LOCAL)
    numbers = "24.3 (R_a = 1, n = 1000)", f"{ratio.max():.2g}"
    met = ratio.max() >= 0.8 * published.SPEED_UP
    claims.add("faster by up to a factor of 25", numbers, met, "largest ratio at least 20", _LOCAL)
    one, five = (table["rounds_2_hop"][table["apical_radius"] == radius] for radius in (1.0, 5.0))
    numbers = "10, 14, 15 and 17, 20, 21", f"2-hop rule: {listed(five, '.0f')} and {listed(one, '.0f')}"
    claims.add("fewer rounds at R_a = 5 than at 1", numbers, (five < one).all(), "at every n")
    one, five = (table["is_mh_seconds"][table["apical_radius"] == radius] for radius in (1.0, 5.0))
    numbers = "10.8 and 15.6 s, ...", f"{listed(five, '.2g')} and {listed(one, '.2g')} s"
    claims.add("IS-MH is faster at R_a = 5 than at 1", numbers, (five < one).all(), "at every n")


def _judge_growth(claims: Claims, table: Table) -> None:
    """How time and rounds grow with n, at R_a = 1; it takes more than one n."""
    one = {name: column[table["apical_radius"] == 1.0] for name, column in table.items()}
    several = len(one["cells"]) > 1
    first, last = one["cells"].argmin(), one["cells"].argmax()
    span = one["cells"][last] / one["cells"][first]
    grow = {name: column[last] / column[first] for name, column in one.items() if column[first] > 0}
    ours = {name: f"x {value:.3g} for x {span:g} cells" if several else "-" for name, value in grow.items()}
    ratio = one["mh_seconds"] / one["is_mh_seconds"]
    missing = "" if several else QUICK_SIZES

    def add(says: str, numbers: tuple[str, str], met: bool, criterion: str, why: str = "") -> None:
        claims.add(says, numbers, met if several else None, criterion, missing or why)

    numbers = "3.0, 12.9, 24.3", listed(ratio, ".2g")
    add("the speed-up grows with n", numbers, bool((np.diff(ratio) > 0).all()), "at every step of n", _LOCAL)
    numbers = "x 1.24 for x 10 cells", ours["rounds_2_hop"]
    add("rounds grow only mildly with n", numbers, grow["rounds_2_hop"] < 2, "2-hop rule, less than twofold")
    numbers = "x 6.6 for x 10 cells", ours["is_mh_seconds"]
    add("the time of IS-MH is at most linear in n", numbers, grow["is_mh_seconds"] <= span, "not above x n")
    numbers = "x 54 for x 10 cells", ours["mh_seconds"]
    met = near(grow["mh_seconds"], span**2, 0.5)
    add("the time of MH is quadratic in n", numbers, met, "within half of the square", _LOCAL)


def judge_cell(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """One cell before and after; tables: `fig5`."""
    before, after = tables["fig5"]["before"], tables["fig5"]["after"]
    claims, mean, cell = Claims("fig5"), before.mean(), before.argmin()
    told = [volume / published.CELL_MEAN for volume in (published.CELL_BEFORE, published.CELL_AFTER)]
    paper = f"{told[0]:.0%} to {told[1]:.0%} of the mean"
    ours = f"{before[cell]:.3g} to {after[cell]:.3g}, mean {mean:.3g}"
    numbers = paper, f"{ours}: {before[cell] / mean:.0%} to {after[cell] / mean:.0%}"
    why = "44 is the mean of neither R_a = 1 (62.2) nor R_a = 5 (47.1), so shares of the mean are compared"
    met = None if plan.quick else near(after[cell], mean, 0.1)
    claims.add("a cell grows from 9 to 40, mean 44", numbers, met, "the smallest ends within 10 %", why)
    small = before < 0.25 * mean
    middle = float(np.median(after[small])) / mean if small.any() else np.nan
    numbers = paper, f"median of {small.sum()} cells: {middle:.0%}" if small.any() else "no such cell"
    met = None if plan.quick or not small.any() else near(middle, 1, 0.1)
    says = "the same for all that begin below a quarter of the mean"
    claims.add(says, numbers, met, "median within 10 %", QUICK_SIZES if plan.quick else "")
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
    energy, other = (by_seed(table, radius, name, "energy") for name in ("is-mh", "mh"))
    mean, at = energy.mean(axis=0), f"R_a = {radius:g}"
    quarter = max(1, (len(mean) - 1) // 4)
    start, spread = energy[:, 0].mean(), _deviation(energy[:, 0])
    low, high = published.START_ENERGY
    met = None if plan.quick else start - spread <= high and start + spread >= low
    why = QUICK_SIZES if plan.quick else "random tissue with the paper's parameters; it has this energy"
    numbers = "300,000 to 350,000 (read off)", f"{start:,.0f}, deviation {spread:,.0f}"
    claims.add(f"energy at the start, {at}", numbers, met, "range within one standard deviation", why)
    fall = mean[0] - mean[-1]
    early, late = (mean[0] - mean[quarter]) / fall, (mean[-1 - quarter] - mean[-1]) / fall
    numbers = "words", f"{early:.0%} of the fall in the first quarter of the sweeps"
    met, why = (None, QUICK_SIZES) if plan.quick else (early >= 0.5, "")
    claims.add(f"a steep decline in early rounds, {at}", numbers, met, "at least half of it", why)
    numbers = "words", f"{late:.1%} of the fall in the last quarter"
    met = None if plan.quick else 0 <= late <= 0.1
    claims.add(f"then slow convergence, {at}", numbers, met, "0 to 10 %", why)
    ends, spread = (energy[:, -1].mean(), other[:, -1].mean()), _spread(energy[:, -1], other[:, -1])
    numbers = "words", f"{ends[0]:,.0f}, MH {ends[1]:,.0f}; deviation {spread:,.0f}"
    met = abs(ends[0] - ends[1]) <= max(2 * spread, 0.05 * ends[1])
    criterion = "means within the larger of two standard deviations of the seeds' spread and 5 %"
    claims.add(f"MH and IS-MH reach similar energies, {at}", numbers, met, criterion)
    spans = [by_seed(table, radius, "is-mh", name)[:, -quarter:] for name in ("covering_radius", "tightness")]
    phi = [float(np.median(span)) for span in spans]
    numbers = "1 to 5", f"covering radius {phi[0]:.3g}, tightness {phi[1]:.3g}"
    least, most = published.TIGHTNESS_RANGE
    met = None if plan.quick else any(least <= value <= most for value in phi)
    criterion = "either reading of phi; median of the last quarter"
    why = why or "this energy evens out volumes and does not part backbones: some pairs stay close"
    claims.add(f"phi soon stays at 1 to 5, {at}", numbers, met, criterion, why)


def judge_volumes(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Volumes after some sweeps; tables: `fig11`, and `fig10` for phi where it is there."""
    claims, table = Claims("fig11"), tables["fig11"]
    sweeps, mean = np.unique(table["sweep"]), table["volume"][table["sweep"] == 0].mean()
    spread = [table["volume"][table["sweep"] == sweep].std() / mean for sweep in sweeps]
    numbers = "words", f"deviation / mean {listed(spread, '.3f')}"
    criterion = f"it falls at every one of sweeps {listed(sweeps, 'g')}"
    claims.add("volumes converge to the mean", numbers, (np.diff(spread) < 0).all(), criterion)
    last = table["sweep"] == sweeps[-1]
    off, ends = np.abs(table["volume"][last] / mean - 1) > 0.2, table["is_end"][last].astype(bool)
    share = ends[off].mean() if off.any() else np.nan
    ours = f"{share:.0%} of the {off.sum()} cells off by over 20 % touch an end; {ends.mean():.0%} of all do"
    met = None if plan.quick or not off.any() else share > 0.5
    why = QUICK_SIZES if plan.quick else ""
    claims.add("most of the rest is close to the tube's ends", ("most", ours), met, "more than half", why)
    if "fig10" in tables:
        names = ("covering_radius", "tightness")
        phi = [float(np.median(by_seed(tables["fig10"], 1.0, "is-mh", name)[:, -1])) for name in names]
        numbers = "3", f"covering radius {phi[0]:.3g}, tightness {phi[1]:.3g}"
        met = None if plan.quick else any(near(value, published.TIGHTNESS) for value in phi)
        why = why or "phi may be either; the tightness hangs on the two nearest of all backbones"
        claims.add(
            "the final tissue has phi around 3", numbers, met, "either within 20 %, in the median", why
        )
    return claims


def by_seed(table: Table, radius: float, algorithm: str, name: str) -> np.ndarray:
    """A column of the runs as [seeds, sweeps]."""
    chosen = (table["apical_radius"] == radius) & (table["algorithm"] == algorithm)
    return table[name][chosen].reshape(len(np.unique(table["seed"][chosen])), -1)


def _spread(first: np.ndarray, second: np.ndarray) -> float:
    """The standard deviation over the seeds within two sets of runs, root of the mean of their variances."""
    return float(np.hypot(_deviation(first), _deviation(second)) / np.sqrt(2))


def _deviation(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0
