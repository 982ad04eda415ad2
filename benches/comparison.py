"""Runs candidates alternately, and calculates the ratio of their figures."""

import os
import statistics
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
#: Whether the VM's time follows the instructions of its processor (`tests/vm/run --steady`).
IS_STEADY = "RECT_STEADY" in os.environ
#: The processor of that VM.
STEADY_PROCESSOR = "one emulated processor of 1000 million instructions a second, about a core of a Pi 3B"


def rounds(usual: int) -> int:
    """Returns the number of rounds: `usual`, or fewer in the VM's steady time, where all rounds are alike."""
    return min(usual, 4) if IS_STEADY else usual


def alternate(rounds: int, *candidates: Callable[[], T]) -> tuple[list[T], ...]:
    """Runs all candidates in each round, and returns the figures of each."""
    found: tuple[list[T], ...] = tuple([] for _ in candidates)
    order = list(range(len(candidates)))
    for _ in range(rounds):
        # Another one goes first each time, because the first one may find a cooler or a hotter machine.
        order = [*order[1:], order[0]]
        for index in order:
            found[index].append(candidates[index]())
    return found


def ratio(ours: list[float], others: list[float], digits: int = 2) -> str:
    """Returns the median of the ratios of the rounds, with the range of the middle half in brackets."""
    quantiles = statistics.quantiles([our / other for our, other in zip(ours, others, strict=True)], n=4)
    low, middle, high = (f"{quantile:.{digits}f}" for quantile in quantiles)
    return f"{middle} ({low} to {high})"
