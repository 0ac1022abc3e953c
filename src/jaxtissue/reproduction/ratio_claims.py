"""The paper's statements on cells against the surface ratio (Figs. 12 to 16), judged as in `claims`."""

from collections.abc import Mapping

import numpy as np

from jaxtissue.reproduction import published
from jaxtissue.reproduction.claims import (
    MET,
    QUICK_SIZES,
    Claims,
    judge,
    judge_range,
    judge_ranges,
    mean_range,
)
from jaxtissue.reproduction.experiments import THRESHOLDS, Plan, Table
from jaxtissue.topology.neighbor_law import fit_neighbor_law

_GLAND = "real cells in glands with many ratios; for comparison only"
_PLATEAU = "every wall is counted as a contact here, and their number keeps growing with the ratio; see Fig. 12"
_SMALL = "every wall is counted as a contact here; without the smallest walls the fraction is lower"
_LUMEN = "at large ratios cells wrap around the lumen and share fewer walls on the apical surface"
_DEGREE = "it equals the number of apical neighbors, almost 6, + half the number of transition points"
_EXPLANATION = """
**The plateau.** The paper's curve levels off below 11 neighbors, about one of them internal. Here, where
every wall is counted as a contact, an annealed cell has {every:.1f} neighbors on average at ratio {ratio:g},
{inner:.1f} of them internal. Tissue relaxed by Lloyd's method has {lloyd:.1f} neighbors at this ratio, and
random tissue {random:.1f}: the number depends more on the geometry of radial backbones than on annealing.
It also depends on which walls are counted. Without walls smaller than 1 / 2 / 5 % of the mean wall, a cell
has {fewer} neighbors, {fewer_inner} of them internal. The paper does not say whether it excludes small
walls. All verdicts count every wall, and no threshold was chosen to reproduce the paper.
"""


def judge_neighbors(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Mean neighbors in annealed tissue; tables: `fig12`."""
    claims, table = Claims("fig12"), tables["fig12"]
    for ratio, told in published.NEIGHBORS.items():
        says = f"cells have {told:g} neighbors on average at ratio {ratio:g}", f"{told:g} (read off)"
        wanted = 0.95 * told, 1.05 * told, "within 5 %"
        why = _PLATEAU if ratio > 10 else _DEGREE
        _add_mean(claims, says, (table, ratio, "neighbors"), wanted, plan.quick, why)
    ratio, most = published.NEIGHBORS_BELOW
    says = f"cells have fewer than {most:g} neighbors on average even at ratio {ratio:g}", f"below {most:g}"
    _add_mean(claims, says, (table, ratio, "neighbors"), (0, most, f"below {most:g}"), plan.quick, _PLATEAU)
    mean = ratio_means(table)
    _judge_law(claims, "the number of neighbors grows as a logistic function", mean, "neighbors")
    bounds = [name for name in table if name.startswith(("lemma", "corollary"))]
    most = max((float(table[name].max()) for name in bounds), default=np.nan)
    phi = (f"{name.replace('_', ' ')} {table[name].min():.3g} to {table[name].max():.3g}"
           for name in ("tightness", "covering_radius"))  # fmt: skip
    ours = f"at most {most:.0%} of the bound; {', '.join(phi)}"
    why = "phi is the tightness here; where it is large, as in annealed tissues, the bounds are weak"
    says = "Lemmas 1 and 2 and Corollary 1 bound the numbers of neighbors by phi"
    claims.add(says, ("proved", ours), most <= 1 if bounds else None, "in every tissue, annealed or not", why)
    _add_gland(claims, table, "neighbors", published.GLAND.neighbors)
    return claims


def explain_plateau(tables: Mapping[str, Table]) -> str:
    """The dependence of the number of neighbors at large ratios, in words; tables: `fig12`."""
    table = tables["fig12"]
    means = {kind: ratio_means(table, kind) for kind in ("annealed", "lloyd", "random")}
    mean = means["annealed"]
    ratio = mean["ratio"][-1]
    every, lloyd, random = (means[kind]["neighbors"][-1] for kind in means)
    fewer = [f"{mean[f'neighbors_above_{100 * share:g}'][-1]:.1f}" for share in THRESHOLDS[1:]]
    inner = mean["internal_neighbors"][-1]
    fewer_inner = [f"{mean[f'internal_neighbors_above_{100 * share:g}'][-1]:.1f}" for share in THRESHOLDS[1:]]
    return _EXPLANATION.format(
        ratio=ratio, every=every, lloyd=lloyd, random=random, fewer=" / ".join(fewer), inner=inner,
        fewer_inner=" / ".join(fewer_inner),
    )  # fmt: skip


def judge_transitions(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Transition points and scutoids in annealed tissue; tables: `fig13`."""
    claims, table = Claims("fig13"), tables["fig13"]
    mean = ratio_means(table)
    ratio, share = published.SCUTOIDS_ABOVE
    large = mean["ratio"][mean["ratio"] >= ratio]
    found = [mean_range(at_ratio(table, at, "scutoid_fraction")) for at in large]
    least = int(np.argmin([low for low, _ in found]))
    shown = at_ratio(table, large[least], "scutoid_fraction").mean()
    numbers = "over 90 %", f"smallest {shown:.1%}, at ratio {large[least]:g}"
    verdict, why = (judge(None), QUICK_SIZES) if plan.quick else (judge_ranges(found, share), "")
    says = f"over 90 % of the cells are scutoids at ratios of {ratio:g} and more"
    claims.add(says, numbers, verdict, "at every such ratio, by the 95 % interval", why)
    _judge_law(claims, "the number of transition points grows as a logistic function", mean, "transitions")
    turns, neighbors = ((mean[name][0], mean[name][-1]) for name in ("transitions", "neighbors"))
    ours = "{:.2f} to {:.2f} (neighbors {:.2f} to {:.2f})".format(*turns, *neighbors)
    met = turns[0] < neighbors[0] and turns[1] < neighbors[1]
    why = "neighbors = apical neighbors + transition points / 2, so above some number there are more transition points"
    criterion = "fewer at both ratios"
    claims.add(
        "there are fewer transition points than neighbors at the smallest and the largest ratio",
        ("words", ours),
        met,
        criterion,
        why,
    )
    for name in ("transitions", "scutoid_fraction"):
        _add_gland(claims, table, name, getattr(published.GLAND, name))
    return claims


def judge_kinds(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Neighbors by kind in annealed tissue; tables: `fig15`."""
    claims, mean = Claims("fig15"), ratio_means(tables["fig15"])
    apical, basal, both = (mean[f"{kind}_neighbors"] for kind in ("apical", "basal", "apical_basal"))
    first = both[0] / mean["neighbors"][0]
    numbers = "almost all", f"{first:.0%} at ratio {mean['ratio'][0]:g}"
    claims.add("at small ratios neighbors touch on both surfaces", numbers, first >= 0.8, "at least 80 %")
    met = both[-1] < min(apical[-1], basal[-1], both[0])
    numbers = "words", f"{both[0]:.2f} to {both[-1]:.2f}; only apical {apical[-1]:.2f}, basal {basal[-1]:.2f}"
    says = "with increasing ratio, neighbors on both surfaces become fewer than only apical or only basal neighbors"
    claims.add(says, numbers, met, "at the largest ratio")
    differ = np.abs(apical - basal) / np.maximum((apical + basal) / 2, 1e-9)
    for name, chosen in (("up to 10", mean["ratio"] <= 10), ("above 10", mean["ratio"] > 10)):
        if chosen.any():
            numbers = "almost identical", f"they differ by {differ[chosen].max():.0%} at most"
            says, met = (
                f"there are as many only apical as only basal neighbors, ratios {name}",
                differ[chosen].max() <= 0.1,
            )
            reason = QUICK_SIZES if plan.quick else _LUMEN if name == "above 10" else ""
            claims.add(says, numbers, None if plan.quick else met, "within 10 % at every ratio", reason)
    peaks = [float(mean["ratio"][kind.argmax()]) for kind in (apical, basal)]
    numbers = "words", f"only apical up to ratio {peaks[0]:g}, only basal up to ratio {peaks[1]:g}"
    met, why = (None, QUICK_SIZES) if plan.quick else (min(peaks) == mean["ratio"][-1], _LUMEN)
    says = "the numbers of only apical and of only basal neighbors grow with the ratio"
    claims.add(says, numbers, met, "up to the largest ratio", why)
    _judge_internal(claims, tables["fig15"], plan)
    return claims


def _judge_internal(claims: Claims, table: Table, plan: Plan) -> None:
    ratio, told = published.INTERNAL_FRACTION
    says = f"{told:.0%} of the cells have an internal neighbor at ratio {ratio:g}", f"{told:.0%}"
    wanted = (told - 0.05, told + 0.05, "within 5 points")
    _add_mean(claims, says, (table, ratio, "internal_fraction"), wanted, plan.quick, _SMALL)
    mean = ratio_means(table)
    where = float(mean["ratio"][mean["internal_neighbors"].argmax()])
    wanted = (0, 1.2 * published.INTERNAL_NEIGHBORS, f"at most 1.2, at every ratio (most: {where:g})")
    says = "the mean number of internal neighbors does not substantially exceed one", "about 1"
    _add_mean(claims, says, (table, where, "internal_neighbors"), wanted, plan.quick, _PLATEAU)


def _add_mean(
    claims: Claims,
    says: tuple[str, str],
    column: tuple[Table, float, str],
    wanted: tuple[float, float, str],
    quick: bool,
    why: str,
) -> None:
    """Judge a mean over the seeds of annealed tissue at a ratio, by its 95 % interval.

    `says` is the statement and its number, `column` is of (table, ratio, name), `wanted` the least and the
    most that meet the paper, and the criterion. Beside the mean stand those without small walls.
    """
    table, ratio, name = column
    values, form = at_ratio(table, ratio, name), ".1%" if name.endswith("fraction") else ".2f"
    ours = f"{values.mean():{form}} ({_by_threshold(table, ratio, name, form)})" if len(values) else "-"
    if quick or not len(values):
        claims.add(says[0], (says[1], ours), None, wanted[2], QUICK_SIZES)
        return
    verdict = judge_range(mean_range(values), *wanted[:2])
    why = "" if verdict == MET else why
    claims.add(says[0], (says[1], ours), verdict, f"{wanted[2]}, by the 95 % interval", why)


def judge_scutoid(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """That scutoids with many transition points exist; tables: `fig14`."""
    claims, count = Claims("fig14"), len(tables["fig14"]["x"])
    numbers = "a picture", f"one with {count}"
    claims.add("there are scutoids with several transition points", numbers, count >= 2, "at least 2")
    return claims


def judge_pair(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """That internal neighbors exist; tables: `fig16`."""
    claims, area = Claims("fig16"), tables["fig16"]["relative_area"]
    numbers = "a picture", f"{len(area)} pairs in a tissue; largest wall {area.max():.0%} of the mean wall"
    criterion = "a wall above 5 % of the mean wall"
    claims.add("cells can be in contact only between the surfaces", numbers, area.max() > 0.05, criterion)
    return claims


def ratio_means(table: Table, kind: str = "annealed") -> Table:
    """The means over the seeds of all columns for one kind of tissue, a row for each ratio in order."""
    rows = {name: column[table["kind"] == kind] for name, column in table.items() if name != "kind"}
    ratios, at = np.unique(rows["ratio"], return_inverse=True)
    means = {name: np.bincount(at, column) / np.bincount(at) for name, column in rows.items()}
    return means | {"ratio": ratios}


def at_ratio(table: Table, ratio: float, name: str) -> np.ndarray:
    """The values of the seeds of annealed tissue at a surface ratio; empty where the plan leaves it out."""
    return table[name][(table["kind"] == "annealed") & (table["ratio"] == ratio)]


def _by_threshold(table: Table, ratio: float, name: str, form: str) -> str:
    """The fall of a mean when small walls are no contacts."""
    endings = [f"_above_{100 * threshold:g}" for threshold in THRESHOLDS[1:]]
    numbers = " / ".join(f"{at_ratio(table, ratio, name + ending).mean():{form}}" for ending in endings)
    return f"{numbers} without walls below 1 / 2 / 5 % of the mean wall"


def _judge_law(claims: Claims, says: str, mean: Table, name: str) -> None:
    """A logistic function of ln(ratio) must explain 98 % of the variance; four points fit any."""
    criterion, why = "R^2 of at least 0.98", "logistic in ln(R_b / R_a)"
    if len(mean["ratio"]) < 6:
        numbers = "words", f"{len(mean['ratio'])} ratios"
        claims.add(says, numbers, None, criterion, "too few ratios for a law of four parameters")
        return
    try:
        law = fit_neighbor_law(mean["ratio"], mean[name])
    except ValueError as error:
        claims.add(says, ("words", "no fit"), False, criterion, str(error))
        return
    ours = f"R^2 {law.r2:.4f}; {law.low:.2f} to {law.high:.2f}, half way at {law.middle:.3g}"
    why += "; its lower limit is reached only at ratios below 1, which do not exist" if law.low < 0 else ""
    claims.add(says, ("words", ours), law.r2 >= 0.98, criterion, why)


def _add_gland(claims: Claims, table: Table, name: str, told: float) -> None:
    """The values of glands, beside tissue of their ratios."""
    low, high = published.GLAND.ratios
    ours = []
    for kind in ("annealed", "lloyd"):
        mean = ratio_means(table, kind)
        values = mean[name][(mean["ratio"] >= low) & (mean["ratio"] <= high)]
        ours.append(f"{kind} {values.min():.3g} to {values.max():.3g}" if len(values) else f"{kind} -")
    says = f"{name.replace('_', ' ')} in fly glands, ratio 4 to 10 ({published.GLAND_SOURCE})"
    claims.add(says, (f"{told:g} (glands)", "; ".join(ours)), None, "", _GLAND)
