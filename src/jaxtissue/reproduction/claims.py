"""A statement of the paper beside what was found, and the verdict by a criterion stated with it.

A single number is met within 20 %, a mean energy and a mean number of neighbors within 5 %, a share of cells
within 5 points, words by the inequality that says the same. A mean over the seeds counts with its 95 %
interval, a time with its smallest and largest value over the turns: where these lie on both sides of the
criterion, the verdict is "too noisy".
"""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

MET, NOT_MET, NOISY, NOT_COMPARABLE = "met", "not met", "too noisy", "not comparable"
VERDICTS = (MET, NOT_MET, NOISY, NOT_COMPARABLE)
QUICK_SIZES = "--quick has fewer cells, sweeps, seeds and ratios; only the full run is judged"
ENERGIES = 0.05  # mean energies that differ by no more than this share are alike


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
        self,
        says: str,
        numbers: tuple[str, str],
        met: bool | np.bool_ | str | None,
        criterion: str,
        why: str = "",
    ) -> None:
        """Add a statement, with the paper's number and ours; `met` is a verdict, or what `judge` takes."""
        verdict = met if isinstance(met, str) else judge(met)
        self.append(Claim(self.item, says, *numbers, verdict, criterion, why))


def judge(met: bool | np.bool_ | None) -> str:
    """The verdict on a criterion that holds, does not, or (None) can't be put.

    >>> judge(True), judge(False), judge(None)
    ('met', 'not met', 'not comparable')
    """
    return NOT_COMPARABLE if met is None else MET if met else NOT_MET


def judge_range(found: tuple[float, float], least: float = -np.inf, most: float = np.inf) -> str:
    """The verdict on a value known to lie within a range, which must lie between `least` and `most`.

    >>> judge_range((2.0, 3.0), 1.0), judge_range((0.5, 0.9), 1.0), judge_range((0.9, 2.0), 1.0)
    ('met', 'not met', 'too noisy')
    """
    low, high = found
    if least <= low and high <= most:
        return MET
    return NOT_MET if high < least or low > most else NOISY


def judge_ranges(found: list[tuple[float, float]], least: float = -np.inf, most: float = np.inf) -> str:
    """The verdict on values of which all must lie between `least` and `most`: one that does not decides.

    >>> judge_ranges([(2.0, 3.0), (0.5, 1.5)], 1.0), judge_ranges([(0.1, 0.2), (0.5, 1.5)], 1.0)
    ('too noisy', 'not met')
    """
    verdicts = [judge_range(each, least, most) for each in found]
    return next((verdict for verdict in (NOT_MET, NOISY) if verdict in verdicts), MET)


def mean_range(samples: np.ndarray, others: int | None = None) -> tuple[float, float]:
    """The 95 % interval of the mean of the samples, by Student's t; of one sample it is without bounds.

    Given how many `others` a mean of equally scattered samples was taken of, the interval is that of the
    difference, placed around the mean.

    >>> low, high = mean_range(np.array([9.0, 10.0, 11.0]))
    >>> round(low, 2), round(high, 2)
    (7.52, 12.48)
    """
    count, mean = len(samples), float(np.mean(samples))
    if count < 2:
        return -np.inf, np.inf
    share = 1 / count + (1 / others if others else 0)
    half = float(stdtrit(count - 1, 0.975)) * float(np.std(samples, ddof=1)) * share**0.5
    return mean - half, mean + half


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


def spread(values: np.ndarray, form: str = ".3g") -> str:
    """The median of values and, in parentheses, the smallest and the largest.

    >>> spread(np.array([3.0, 1.0, 2.0]))
    '2 (1 to 3)'
    """
    return f"{np.median(values):{form}} ({np.min(values):{form}} to {np.max(values):{form}})"
