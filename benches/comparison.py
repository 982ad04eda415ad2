"""Runs two candidates alternately, and calculates the ratio of their figures."""

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


def alternate(rounds: int, ours: Callable[[], T], others: Callable[[], T]) -> tuple[list[T], list[T]]:
    """Runs both candidates in each round, and returns the figures of each."""
    found: tuple[list[T], list[T]] = ([], [])
    for n in range(rounds):
        # The candidates alternate in going first, because the first one may find a cooler or a hotter machine.
        for index in (0, 1) if n % 2 else (1, 0):
            found[index].append((ours, others)[index]())
    return found


def ratio(ours: list[float], others: list[float], digits: int = 2) -> str:
    """Returns the median of the ratios of the rounds, with the range of the middle half in brackets."""
    quantiles = statistics.quantiles([our / other for our, other in zip(ours, others, strict=True)], n=4)
    low, middle, high = (f"{quantile:.{digits}f}" for quantile in quantiles)
    return f"{middle} ({low} to {high})"
