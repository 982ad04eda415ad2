"""Two that do the same by turns, and the ratio of what they did."""

import os
import statistics
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
#: Whether time passes by what the processor does, in the VM (`tests/vm/run --steady`).
IS_STEADY = "RECT_STEADY" in os.environ
#: What its processor is.
STEADY_PROCESSOR = "one emulated processor of 1000 million instructions a second, about a core of a Pi 3B"


def rounds(usual: int) -> int:
    """So many, and fewer where they are all alike."""
    return min(usual, 4) if IS_STEADY else usual


def by_turns(rounds: int, ours: Callable[[], T], others: Callable[[], T]) -> tuple[list[T], list[T]]:
    """What each of the two measures, round by round."""
    found: tuple[list[T], list[T]] = ([], [])
    for n in range(rounds):
        # By turns in going first: whoever does may find a cooler or a hotter machine.
        for index in (0, 1) if n % 2 else (1, 0):
            found[index].append((ours, others)[index]())
    return found


def ratio(ours: list[float], others: list[float], digits: int = 2) -> str:
    """The median of the rounds' own ratios, its middle half in brackets."""
    quantiles = statistics.quantiles([one / other for one, other in zip(ours, others, strict=True)], n=4)
    low, middle, high = (f"{quantile:.{digits}f}" for quantile in quantiles)
    return f"{middle} ({low} to {high})"
