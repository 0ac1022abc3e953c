"""A statement of the paper beside what was found, and the verdict by a criterion stated with it.

A number is met within 20 %, a mean number of neighbors within 5 %, a share of cells within 5 points, similar
energies within the larger of two standard deviations of the seeds' spread and 5 %, words by the inequality
that says the same.
"""

from typing import NamedTuple

import numpy as np

MET, NOT_MET, NOT_COMPARABLE = "met", "not met", "not comparable"
QUICK_SIZES = "the quick plan has fewer cells, sweeps, seeds and ratios; the full one judges it"


class Claim(NamedTuple):
    """One statement of the paper, ours beside it, the verdict, its criterion and its reason."""

    item: str
    says: str
    paper: str
    ours: str
    verdict: str
    criterion: str
    why: str


class Claims(list[Claim]):
    """The statements on one item."""

    def __init__(self, item: str) -> None:
        super().__init__()
        self.item = item

    def add(
        self, says: str, numbers: tuple[str, str], met: bool | np.bool_ | None, criterion: str, why: str = ""
    ) -> None:
        """Add a statement, with the paper's number and ours; `met` is None where no criterion can be put."""
        self.append(Claim(self.item, says, *numbers, judge(met), criterion, why))


def judge(met: bool | np.bool_ | None) -> str:
    """The verdict on a criterion that holds, does not, or (None) can't be put.

    >>> judge(True), judge(False), judge(None)
    ('met', 'not met', 'not comparable')
    """
    return NOT_COMPARABLE if met is None else MET if met else NOT_MET


def near(value: float, target: float, share: float = 0.2) -> bool:
    """Whether a value is within a share of a target.

    >>> near(23, 20), near(25, 20)
    (True, False)
    """
    return bool(abs(value - target) <= share * abs(target))


def listed(values: np.ndarray | list[float], form: str) -> str:
    """Values in a row, in a format.

    >>> listed([1.0, 2.5], ".1f")
    '1.0, 2.5'
    """
    return ", ".join(f"{value:{form}}" for value in values)
