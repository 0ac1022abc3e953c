"""Parsers of option values, which reject values out of range with a one-line message."""

import argparse
import math
from collections.abc import Callable

from jaxtissue.measurement.quadrature import as_resolution


def number_of(low: float, above: bool = False) -> Callable[[str], float]:
    """A reader of finite numbers of at least `low`, or above it."""

    def number(text: str) -> float:
        value = float(text)
        if not (math.isfinite(value) and (value > low if above else value >= low)):
            bound = f"above {low:g}" if above else f"of at least {low:g}"
            raise argparse.ArgumentTypeError(f"{text} is out of range; give a finite number {bound}")
        return value

    return number


def count_of(low: int, high: int = 10**9) -> Callable[[str], int]:
    """A reader of whole numbers from `low` to `high`."""

    def integer(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            bounds = f"from {low} to {high}"
            raise argparse.ArgumentTypeError(f"{text} is out of range; give a whole number {bounds}")
        return value

    return integer


def part_of(text: str) -> tuple[int, int]:
    """K/N as the number of a part, counted from 0, and how many there are."""
    first, slash, second = text.partition("/")
    if not (slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
        raise argparse.ArgumentTypeError(f"{text!r} is invalid; give K/N with K from 1 to N, such as 2/8")
    return int(first) - 1, int(second)


def resolution_of(text: str) -> str:
    """A resolution that exists, as its text."""
    try:
        as_resolution(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text
