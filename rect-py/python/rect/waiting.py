"""Owns how a thread waits: at a lock of Python's own, which Ctrl-C ends at once."""

from __future__ import annotations

import threading

#: A Ctrl-C that comes while the main thread is about to wait, but does not yet, ends no wait: so it looks up as often,
#: in seconds. Other threads need not: Ctrl-C is the main thread's.
_GLANCE_S = 0.5


def at_once(left: float | None) -> float | None:
    """How long this thread may wait at once, of so many seconds; `None`: for ever."""
    if threading.current_thread() is not threading.main_thread():
        return left
    return _GLANCE_S if left is None else min(left, _GLANCE_S)
