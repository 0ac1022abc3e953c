"""Verdicts: the paper's own numbers are met, numbers that contradict it are not, others aren't compared."""

import numpy as np
import pytest

from jaxtissue.laws import NeighborLaw
from jaxtissue.reproduction import published
from jaxtissue.reproduction.claims import MET, NOT_COMPARABLE, NOT_MET, Claims
from jaxtissue.reproduction.experiments import QUICK, THRESHOLDS, Plan
from jaxtissue.reproduction.report import JUDGES, judge_items, title, write_report
from jaxtissue.statistics import KIND_ORDER

FULL = Plan(seeds=3)


def verdicts(item, tables, plan=FULL):
    return {claim.says: claim.verdict for claim in JUDGES[item](tables, plan)}


def times():
    """The paper's Table 1, as if it were ours."""
    rows = [(radius, cells, *timing) for (radius, cells), timing in published.TABLE_1.items()]
    names = ("apical_radius", "cells", "mh_seconds", "is_mh_seconds", "rounds_2_hop")
    table = dict(zip(names, np.array(rows, float).T, strict=True))
    return table | {"rounds_8_phi": table["rounds_2_hop"]}


def runs(start=320_000.0, tightness=3.0):
    """Energy that falls fast, then slowly, equally by both algorithms."""
    sweep, seeds = np.arange(41.0), np.arange(3)
    rows = [(r, a, s) for r in (1.0, 5.0) for a in ("is-mh", "mh") for s in seeds]
    energy = [start * (0.05 + 0.95 * np.exp(-sweep / 5)) * (1 + 0.02 * s) for _, _, s in rows]
    columns = {name: np.repeat([row[i] for row in rows], len(sweep)) for i, name in
               enumerate(("apical_radius", "algorithm", "seed"))}  # fmt: skip
    columns |= {"sweep": np.tile(sweep, len(rows)), "energy": np.concatenate(energy)}
    return columns | {
        name: np.full(len(columns["sweep"]), tightness) for name in ("covering_radius", "tightness")
    }


def ratios(low=5.6, high=10.5, internal=1.0):
    """Tissue that obeys a logistic law, for all kinds of tissue and two seeds."""
    law = NeighborLaw(low, high, 5, 1.5, {}, 0, 1)
    ratio = np.tile(Plan().ratios, 6)
    table = {"ratio": ratio, "kind": np.repeat(["random", "lloyd", "annealed"], 2 * len(Plan().ratios))}
    rise = (law.predict(ratio) - low) / (high - low)
    table |= {"neighbors": law.predict(ratio), "transitions": 1 + 7 * rise, "transitions_max": 3 + 10 * rise}
    table |= {
        "scutoid_fraction": np.where(ratio < 2, 0.5, 0.97),
        "internal_fraction": np.where(ratio == 10, 0.65, rise),
    }
    table |= {"internal_neighbors": internal * rise, "apical_basal_neighbors": 5.5 * (1 - rise) + 1}
    table |= {f"{kind}_neighbors": 0.2 + 4 * rise for kind in ("apical", "basal")}
    table |= {
        f"{bound}_hops_{hops}": 0.1 * hops + 0 * rise for bound, hops in (("lemma_2", 1), ("corollary_1", 2))
    }
    for threshold in THRESHOLDS[1:]:
        for name in ("neighbors", "internal_fraction", *(f"{kind}_neighbors" for kind in KIND_ORDER)):
            table[f"{name}_above_{100 * threshold:g}"] = table[name] * (1 - threshold)
    return table


def test_a_claim_is_judged_by_its_criterion():
    claims = Claims("fig5")
    for met in (True, np.bool_(False), None):
        claims.add("says", ("1", "2"), met, "criterion")
    assert [claim.verdict for claim in claims] == [MET, NOT_MET, NOT_COMPARABLE]


def test_the_papers_table_meets_the_paper():
    found = verdicts("table1", {"table1": times()})
    assert {verdict for says, verdict in found.items() if not says.startswith("time of a step")} == {MET}
    assert {verdict for says, verdict in found.items() if says.startswith("time of a step")} == {
        NOT_COMPARABLE
    }
    slow = times() | {"mh_seconds": times()["is_mh_seconds"]}
    assert verdicts("table1", {"table1": slow})["IS-MH is faster than MH"] == NOT_MET
    one = {name: column[times()["cells"] == 100] for name, column in times().items()}
    assert verdicts("table1", {"table1": one})["the speed-up grows with n"] == NOT_COMPARABLE


def test_energy_and_phi_like_the_papers_meet_it_and_others_do_not():
    assert set(verdicts("fig10", {"fig10": runs()}).values()) == {MET}
    found = verdicts("fig10", {"fig10": runs(start=200_000.0, tightness=30.0)})
    assert found["energy at the start, R_a = 1"] == found["phi soon stays at 1 to 5, R_a = 5"] == NOT_MET
    close = runs()
    close["energy"] = np.where(close["algorithm"] == "mh", 1.06, 1) * close["energy"]
    for seeds, verdict in ((0.0, NOT_MET), (0.05, MET)):  # 6 % apart: alike only where seeds differ as much
        spread = close | {
            "energy": close["energy"] * (1 + seeds * (close["seed"] - 1)) / (1 + 0.02 * close["seed"])
        }
        assert verdicts("fig10", {"fig10": spread})["MH and IS-MH reach similar energies, R_a = 1"] == verdict
    other = runs()
    other["energy"] = np.where(other["algorithm"] == "mh", 2, 1) * other["energy"]
    assert verdicts("fig10", {"fig10": other})["MH and IS-MH reach similar energies, R_a = 1"] == NOT_MET
    slow = runs() | {"energy": 320_000 - 1000 * runs()["sweep"]}
    assert verdicts("fig10", {"fig10": slow})["a steep decline in early rounds, R_a = 1"] == NOT_MET
    quick = verdicts("fig10", {"fig10": runs(start=1.0)}, QUICK)
    assert quick["energy at the start, R_a = 1"] == NOT_COMPARABLE


@pytest.mark.parametrize("off_at_ends", [True, False])
def test_volumes_must_converge_and_the_rest_sit_at_the_ends(off_at_ends):
    rank, ends = np.arange(100), np.arange(100) < 10
    swept = [np.where(rank < 50, -1, 1) * spread for spread in (0.5, 0.3, 0.1)]
    swept[-1] = np.where(ends if off_at_ends else np.roll(ends, 40), 0.4, 0.01) * np.where(rank % 2, 1, -1)
    table = {
        "sweep": np.repeat([0, 1, 5], 100),
        "volume": 60 * (1 + np.concatenate(swept)),
        "is_end": np.tile(ends, 3),
    }
    found = verdicts("fig11", {"fig11": table, "fig10": runs()})
    assert found["volumes converge to the mean"] == found["the final tissue has phi around 3"] == MET
    assert found["most of the rest is close to the tube's ends"] == (MET if off_at_ends else NOT_MET)
    assert "the final tissue has phi around 3" not in verdicts("fig11", {"fig11": table})


def test_a_logistic_tissue_meets_the_papers_figures():
    table = ratios()
    for item in ("fig12", "fig13", "fig15"):
        found = verdicts(item, {item: table})
        assert {verdict for says, verdict in found.items() if "glands" not in says} == {MET}, found
        assert {verdict for says, verdict in found.items() if "glands" in says} <= {NOT_COMPARABLE}


def test_a_tissue_without_plateau_does_not_meet_the_papers_figures():
    table = ratios(high=14.6, internal=6.0)
    assert verdicts("fig12", {"fig12": table})["mean neighbors at ratio 1000"] == NOT_MET
    found = verdicts("fig15", {"fig15": table})
    assert found["internal neighbors do not go substantially above one"] == NOT_MET
    broken = table | {"lemma_2_hops_1": 1.5 + 0 * table["ratio"]}
    assert verdicts("fig12", {"fig12": broken})["Lemmas 1 and 2, Corollary 1 bound it by phi"] == NOT_MET
    few = {name: column[np.isin(table["ratio"], [1.25, 10])] for name, column in table.items()}
    found = verdicts("fig12", {"fig12": few})
    assert (
        found["mean neighbors at ratio 200"]
        == found["neighbors grow as a logistic function"]
        == NOT_COMPARABLE
    )


def test_cells_and_pictures():
    grown = {"before": np.array([9.0, 60, 63]), "after": np.array([40.0, 45, 47])}
    assert set(verdicts("fig5", {"fig5": grown}).values()) == {MET}
    assert set(verdicts("fig5", {"fig5": grown | {"after": grown["before"]}}).values()) == {NOT_MET}
    assert set(verdicts("fig14", {"fig14": {"x": np.zeros(9)}}).values()) == {MET}
    for area, verdict in ((0.9, MET), (0.01, NOT_MET)):
        assert set(verdicts("fig16", {"fig16": {"relative_area": np.array([area])}}).values()) == {verdict}
    flat = {"apical_area": np.array([0.0, 1]), "basal_area": np.ones(2)}
    assert set(verdicts("fig9", {"fig9": flat}).values()) == {NOT_MET}


def test_the_report_says_what_it_is_and_counts_its_verdicts():
    claims = judge_items({"fig12": ratios()}, QUICK, ["fig7", "fig12"])
    items = {item: {"seconds": 2.0} for item in ("fig7", "fig12")}
    text = write_report(claims, QUICK, items)
    assert "`--quick` run" in text and f"{QUICK.cells} cells" in text
    assert f"{sum(claim.verdict == MET for claim in claims)} met" in text
    assert "no blind test" in text and "![Fig. 12](fig12.png)" in text and "the paper gives no number" in text
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in rows}) == 1
    assert "`--quick`" not in write_report(claims, FULL, items)
    assert title("fig16") == "Fig. 16"
