"""The report: statements of the paper compared with the results here, as Markdown."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxtissue.reproduction.claims import ENERGIES, MET, NOISY, NOT_COMPARABLE, VERDICTS, Claim
from jaxtissue.reproduction.experiments import Plan, Table
from jaxtissue.reproduction.ratio_claims import (
    explain_plateau,
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
    judge_volumes,
)
from jaxtissue.reproduction.time_claims import judge_times, write_times

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
DETAILS: dict[str, Callable[[Mapping[str, Table]], str]] = {"table1": write_times, "fig12": explain_plateau}
_INTRODUCTION = f"""
## How it is judged

This report compares jaxtissue with sections 4 and 5 of the paper: Buceta, Funke, Storandt, *Efficient
Modeling of 3D Epithelial Cell Structure Dynamics via Backbone Spreads*, GRAPP 2025. The numbers of the paper
come from its text, or were read off the axes of its figures ("read off"). Each verdict follows from the
tables in this folder and from the criterion in the last column:

- A mean over the runs is judged by its 95 % confidence interval (Student's t). A time is judged by its
  smallest and largest value over repetitions in which all algorithms are timed in turn; on a CPU it is
  processor time. If such an interval includes the limit of the criterion, the verdict is `{NOISY}`. Times in
  parentheses are the smallest and the largest value.
- Energies at the start and at the end have to agree within {100 * ENERGIES:g} %. At the end, the 95 %
  confidence interval of the ratio IS-MH / MH over the seeds is judged. At the start, the paper shows a mean
  of 10 runs in a figure, which is read off as a range. It is compared with the 95 % interval in which the
  mean of 10 such runs lies here.
- The paper gives phi without its method of measurement. By Definition 1 of the paper it is the covering
  radius (the largest distance of a point of the tissue to its nearest backbone) in units of the separation
  (the smallest distance of two backbones), here called tightness. The covering radius and the tightness are
  both judged.
- `{NOT_COMPARABLE}` means that no criterion applies: another machine, another method of measurement, a
  number that the paper does not give, or a number that this run does not compute.

No parameter was adjusted to reproduce the paper. The criteria were written with a table of measured values
at hand, so they are not a blind test.
"""
_NOISE = "the results of different runs or repetitions are on both sides of the limit"
_QUICK = """
**This is a `--quick` run**: {cells} cells on a tube of length {length:g} (the paper: 500 on 100), {sweeps}
sweeps (100), {seeds} seeds (10), {ratios} surface ratios; {cells} cells in Figs. 7 to 9 (1000). It only checks
that everything works: a larger fraction of the cells is at the ends of the short tube, and the tissues are
relaxed by fewer sweeps. Use the full run to judge the results.
"""


def judge_items(tables: Mapping[str, Table], plan: Plan, items: list[str]) -> list[Claim]:
    """All claims on the given items, in order."""
    return [claim for item in items if item in JUDGES for claim in JUDGES[item](tables, plan)]


def write_report(
    claims: list[Claim], plan: Plan, items: Mapping[str, Mapping[str, Any]], tables: Mapping[str, Table]
) -> str:
    """The report as Markdown; `items` are the finished ones with their seconds."""
    parts = ["# The paper's evaluation, compared with jaxtissue\n", summarize(claims)]
    if plan.quick:
        sizes = {name: getattr(plan, name) for name in ("cells", "length", "sweeps", "seeds")}
        parts.append(_QUICK.format(**sizes, ratios=len(plan.ratios)))
    else:
        parts.append(f"\nMeans over {plan.seeds} seeds; {plan.cells} cells, {plan.sweeps} sweeps.\n")
    parts.append(_INTRODUCTION)
    for item in items:
        seconds = items[item]["seconds"]
        parts.append(f"\n## {title(item)}\n\n![{title(item)}]({item}.png)\n")
        parts.append(DETAILS[item](tables) if item in DETAILS else "")
        rows = [claim for claim in claims if claim.item == item]
        parts.append(_table(rows) if rows else "\nA picture of a tissue of jaxtissue; the paper gives no number.\n")
        parts.append(f"\nComputed in {seconds:.0f} s; computations shared with other items are counted once.\n")
    return "".join(parts)


def summarize(claims: Sequence[Claim]) -> str:
    """The claims that are met, and those that are not and why; claims with one verdict and reason are merged."""
    count = Counter(claim.verdict for claim in claims)
    counted = [f"{count[verdict]} {'is' if count[verdict] == 1 else 'are'} {verdict}" for verdict in VERDICTS]
    told = "{}, {}, {}, and {}".format(*counted)
    lines = [f"\n{len(claims)} statements of the paper are compared with the results of jaxtissue: {told}.\n"]
    for verdict in VERDICTS:
        groups: dict[str, list[str]] = {}
        for claim in claims:
            if claim.verdict == verdict:
                reason = {MET: "", NOISY: _NOISE}.get(verdict, claim.why)
                groups.setdefault(reason, []).append(claim.says)
        for reason, statements in groups.items():
            why = f" ({reason})" if reason else ""
            lines.append(f"- **{verdict.capitalize()}:** {'; '.join(_merged(statements))}{why}.")
    return "\n".join(lines) + "\n"


def _merged(statements: Sequence[str]) -> list[str]:
    """Statements on one R_a each, those that say the same merged.

    >>> _merged(["it falls, R_a = 1", "it falls, R_a = 5", "it ends"])
    ['it falls (R_a = 1 and 5)', 'it ends']
    """
    radii: dict[str, list[str]] = {}
    for statement in statements:
        says, _, radius = statement.partition(", R_a = ")
        radii.setdefault(says, []).extend([radius] if radius else [])
    return [f"{says} (R_a = {' and '.join(some)})" if some else says for says, some in radii.items()]


def title(item: str) -> str:
    """The name of an item as the paper prints it.

    >>> title("fig5"), title("table1")
    ('Fig. 5', 'Table 1')
    """
    return item.replace("fig", "Fig. ").replace("table", "Table ")


def _table(claims: list[Claim]) -> str:
    lines = [
        "\n| statement of the paper | paper | jaxtissue | verdict | criterion and reason |",
        "|---|---|---|---|---|",
    ]
    for claim in claims:
        reason = "; ".join(part for part in (claim.criterion, claim.why) if part)
        cells = (claim.says, claim.paper, claim.ours, f"**{claim.verdict}**", reason)
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
