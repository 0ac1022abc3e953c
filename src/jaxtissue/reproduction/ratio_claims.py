"""What the paper says of cells against the surface ratio (Figs. 12 to 16), judged as in `claims`."""

from collections.abc import Mapping

import numpy as np

from jaxtissue.laws import fit_neighbor_law
from jaxtissue.reproduction import published
from jaxtissue.reproduction.claims import QUICK_SIZES, Claims, near
from jaxtissue.reproduction.experiments import THRESHOLDS, Plan, Table

_GLAND = "real cells, in glands of many ratios; nothing to be met"


def judge_neighbors(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Mean neighbors in annealed tissue; tables: `fig12`."""
    claims, mean = Claims("fig12"), ratio_means(tables["fig12"])
    for ratio, told in published.NEIGHBORS.items():
        found = at_ratio(mean, ratio, "neighbors")
        met = None if found is None or plan.quick else near(found, told, 0.05)
        why = QUICK_SIZES if met is None else _by_threshold(mean, ratio)
        numbers = f"{told:g} (read off)", _shown(found)
        claims.add(f"mean neighbors at ratio {ratio:g}", numbers, met, "within 5 %", why)
    ratio, most = published.NEIGHBORS_BELOW
    found = at_ratio(mean, ratio, "neighbors")
    met = None if found is None else found < most
    why = (
        QUICK_SIZES
        if found is None
        else f"with every wall the plateau is higher: {_by_threshold(mean, ratio)}"
    )
    claims.add(f"mean neighbors at ratio {ratio:g}", ("below 11", _shown(found)), met, "below 11", why)
    _judge_law(claims, "neighbors grow as a logistic function", mean, "neighbors")
    bounds = [name for name in tables["fig12"] if name.startswith(("lemma", "corollary"))]
    most = {name: float(tables["fig12"][name].max()) for name in bounds}
    ours = ", ".join(f"{name.replace('_', ' ')}: {value:.2g}" for name, value in most.items())
    why = "the largest neighborhood / its bound, over all tissues, random and annealed"
    met = max(most.values()) <= 1 if most else None
    claims.add("Lemmas 1 and 2, Corollary 1 bound it by phi", ("proved", ours), met, "at most 1", why)
    _add_gland(claims, tables["fig12"], "neighbors", published.GLAND.neighbors)
    return claims


def judge_transitions(tables: Mapping[str, Table], plan: Plan) -> Claims:
    """Transition points and scutoids in annealed tissue; tables: `fig13`."""
    claims, mean = Claims("fig13"), ratio_means(tables["fig13"])
    ratio, share = published.SCUTOIDS_ABOVE
    large = mean["ratio"] >= ratio
    least = mean["scutoid_fraction"][large].argmin()
    found, where = mean["scutoid_fraction"][large][least], mean["ratio"][large][least]
    numbers = "over 90 %", f"least {found:.1%}, at ratio {where:g}"
    met, criterion = found > share, "at every such ratio"
    claims.add(f"scutoids at ratios of {ratio:g} and more", numbers, met, criterion)
    _judge_law(claims, "transition points behave as a logistic function too", mean, "transitions")
    turns, neighbors = ((mean[name][0], mean[name][-1]) for name in ("transitions", "neighbors"))
    ours = "{:.2f} to {:.2f}; neighbors {:.2f} to {:.2f}".format(*turns, *neighbors)
    met = turns[0] < neighbors[0] and turns[1] < neighbors[1]
    why = "neighbors = apical degree + transitions / 2, so past twice the degree transitions are more"
    criterion = "smaller at the smallest and at the largest ratio"
    claims.add("they start and end below the neighbors", ("words", ours), met, criterion, why)
    for name in ("transitions", "scutoid_fraction"):
        _add_gland(claims, tables["fig13"], name, getattr(published.GLAND, name))
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
    claims.add(
        "they shrink and are overtaken by the only apical and basal", numbers, met, "at the largest ratio"
    )
    differ = np.abs(apical - basal) / np.maximum((apical + basal) / 2, 1e-9)
    why = "at large ratios cells wrap round the lumen and share fewer walls on the apical surface"
    for name, chosen in (("up to 10", mean["ratio"] <= 10), ("above 10", mean["ratio"] > 10)):
        if chosen.any():
            numbers = "almost identical", f"they differ by {differ[chosen].max():.0%} at most"
            says, met = f"as many only apical as only basal, ratios {name}", (differ[chosen] <= 0.1).all()
            reason = QUICK_SIZES if plan.quick else why if name == "above 10" else ""
            claims.add(says, numbers, None if plan.quick else met, "within 10 % at every ratio", reason)
    _judge_internal(claims, mean, plan)
    return claims


def _judge_internal(claims: Claims, mean: Table, plan: Plan) -> None:
    ratio, told = published.INTERNAL_FRACTION
    share = at_ratio(mean, ratio, "internal_fraction")
    met = None if share is None or plan.quick else abs(share - told) <= 0.05
    why = QUICK_SIZES if met is None else _by_threshold(mean, ratio, "internal_fraction", ".1%")
    numbers = f"{told:.0%}", "-" if share is None else f"{share:.1%}"
    claims.add(f"cells with an internal neighbor at ratio {ratio:g}", numbers, met, "within 5 points", why)
    internal, most = mean["internal_neighbors"], published.INTERNAL_NEIGHBORS
    where = float(mean["ratio"][internal.argmax()])
    numbers = "about 1", f"most {internal.max():.2f}, at ratio {where:g}"
    met, why = internal.max() <= 1.2 * most, _by_threshold(mean, where, "internal_neighbors")
    says = "internal neighbors do not go substantially above one"
    claims.add(says, numbers, met, "at most 1.2 at every ratio", why)


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
    claims.add("cells can touch between the surfaces only", numbers, area.max() > 0.05, criterion)
    return claims


def ratio_means(table: Table, kind: str = "annealed") -> Table:
    """The means over the seeds of all columns for one kind of tissue, a row for each ratio in order."""
    rows = {name: column[table["kind"] == kind] for name, column in table.items() if name != "kind"}
    ratios, at = np.unique(rows["ratio"], return_inverse=True)
    means = {name: np.bincount(at, column) / np.bincount(at) for name, column in rows.items()}
    return means | {"ratio": ratios}


def at_ratio(mean: Table, ratio: float, name: str) -> float | None:
    """A mean at a surface ratio, None where there is none."""
    found = np.flatnonzero(mean["ratio"] == ratio)
    return float(mean[name][found[0]]) if len(found) else None


def _by_threshold(mean: Table, ratio: float, name: str = "neighbors", form: str = ".2f") -> str:
    """How a number falls when small walls are no contacts."""
    endings = [f"_above_{100 * threshold:g}" for threshold in THRESHOLDS[1:]]
    numbers = " / ".join(f"{at_ratio(mean, ratio, name + ending):{form}}" for ending in endings)
    return f"{numbers} if walls below 1 / 2 / 5 % of the mean wall are no contacts"


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
    why += "; its lower end lies at ratios below 1, where there is no tissue" if law.low < 0 else ""
    claims.add(says, ("words", ours), law.r2 >= 0.98, criterion, why)


def _add_gland(claims: Claims, table: Table, name: str, told: float) -> None:
    """What glands have, beside tissue of their ratios."""
    low, high = published.GLAND.ratios
    ours = []
    for kind in ("annealed", "lloyd"):
        mean = ratio_means(table, kind)
        values = mean[name][(mean["ratio"] >= low) & (mean["ratio"] <= high)]
        ours.append(f"{kind} {values.min():.3g} to {values.max():.3g}" if len(values) else f"{kind} -")
    says = f"{name.replace('_', ' ')} in fly glands, ratio 4 to 10 ({published.GLAND_SOURCE})"
    claims.add(says, (f"{told:g} (glands)", "; ".join(ours)), None, "", _GLAND)


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
