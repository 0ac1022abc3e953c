"""The report: what the paper says beside what was found, as Markdown."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from jaxtissue.reproduction.claims import MET, NOT_COMPARABLE, NOT_MET, Claim
from jaxtissue.reproduction.experiments import Plan, Table
from jaxtissue.reproduction.ratio_claims import (
    judge_kinds,
    judge_neighbors,
    judge_pair,
    judge_scutoid,
    judge_transitions,
)
from jaxtissue.reproduction.run_claims import (
    judge_cell,
    judge_runs,
    judge_surfaces,
    judge_times,
    judge_volumes,
)

JUDGES: dict[str, Callable[[Mapping[str, Table], Plan], list[Claim]]] = {
    "table1": judge_times,
    "fig5": judge_cell,
    "fig9": judge_surfaces,
    "fig10": judge_runs,
    "fig11": judge_volumes,
    "fig12": judge_neighbors,
    "fig13": judge_transitions,
    "fig14": judge_scutoid,
    "fig15": judge_kinds,
    "fig16": judge_pair,
}
_INTRODUCTION = """\
Buceta, Funke, Storandt, *Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone Spreads*,
GRAPP 2025, sections 4 and 5, beside jaxtissue. The paper's numbers are from its text, or read off the axes of
its figures where it says so. A verdict follows from the tables in this folder by the criterion beside it.
Nothing was adjusted to meet the paper; but the criteria were written knowing a table of values measured while
this evaluation was designed, so they are no blind test. `not comparable` means that no criterion can be put:
another machine, a quantity that the paper does not define, a number that is not the paper's, or one that this
plan leaves out.
"""
_QUICK = """
**This is a `--quick` run**: {cells} cells on a tube of length {length:g} (the paper: 500 on 100), {sweeps}
sweeps (100), {seeds} seeds (10), {ratios} surface ratios; {cells} cells in Figs. 7 to 9 (1000). It shows that
everything works, no more: the short tube has more cells at its ends, and few sweeps relax less. Judge by the
full run.
"""


def judge_items(tables: Mapping[str, Table], plan: Plan, items: list[str]) -> list[Claim]:
    """All claims on the given items, in order."""
    return [claim for item in items if item in JUDGES for claim in JUDGES[item](tables, plan)]


def write_report(claims: list[Claim], plan: Plan, items: Mapping[str, Mapping[str, Any]]) -> str:
    """The report as Markdown; `items` are the finished ones with their seconds."""
    parts = ["# The paper's evaluation, beside ours\n", _INTRODUCTION]
    if plan.quick:
        sizes = {name: getattr(plan, name) for name in ("cells", "length", "sweeps", "seeds")}
        parts.append(_QUICK.format(**sizes, ratios=len(plan.ratios)))
    else:
        parts.append(f"\nMeans over {plan.seeds} seeds; {plan.cells} cells, {plan.sweeps} sweeps.\n")
    count = Counter(claim.verdict for claim in claims)
    parts.append(f"\n{count[MET]} met, {count[NOT_MET]} not met, {count[NOT_COMPARABLE]} not comparable.\n")
    for item in items:
        seconds = items[item]["seconds"]
        parts.append(f"\n## {title(item)}\n\n![{title(item)}]({item}.png)\n")
        rows = [claim for claim in claims if claim.item == item]
        parts.append(_table(rows) if rows else "\nA picture of our own tissue; the paper gives no number.\n")
        parts.append(f"\nComputed in {seconds:.0f} s, what it shares with others counted once.\n")
    return "".join(parts)


def title(item: str) -> str:
    """The name of an item as the paper prints it.

    >>> title("fig5"), title("table1")
    ('Fig. 5', 'Table 1')
    """
    return item.replace("fig", "Fig. ").replace("table", "Table ")


def _table(claims: list[Claim]) -> str:
    lines = ["\n| the paper says | paper | ours | verdict | criterion, and why |", "|---|---|---|---|---|"]
    for claim in claims:
        reason = "; ".join(part for part in (claim.criterion, claim.why) if part)
        cells = (claim.says, claim.paper, claim.ours, f"**{claim.verdict}**", reason)
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
