"""Computes how long a thread may wait at a time, so that Ctrl-C interrupts the wait."""

from __future__ import annotations

import threading

#: Longest wait of the main thread at a time, in seconds. A Ctrl-C that arrives just before a wait begins does not
#: interrupt it, so the main thread wakes up regularly. Other threads never receive Ctrl-C.
_MAX_WAIT_S = 0.5


def is_main() -> bool:
    """Returns whether this is the main thread."""
    return threading.get_ident() == threading.main_thread().ident


def next_wait(remaining: float | None) -> float | None:
    """Returns how many of the remaining seconds this thread may wait at a time; `None` means without limit."""
    if not is_main():
        return remaining
    return _MAX_WAIT_S if remaining is None else min(remaining, _MAX_WAIT_S)
