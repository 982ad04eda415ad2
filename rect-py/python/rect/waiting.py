"""Owns how a thread waits: at a lock of Python's own, which Ctrl-C ends at once."""

from __future__ import annotations

import threading

#: A Ctrl-C that comes while the main thread is about to wait, but does not yet, ends no wait: so it looks up as often,
#: in seconds. Other threads need not: Ctrl-C is the main thread's.
_GLANCE_S = 0.5


def is_main() -> bool:
    """Whether this is the main thread."""
    return threading.get_ident() == threading.main_thread().ident


def at_once(left: float | None) -> float | None:
    """How long this thread may wait at once, of so many seconds; `None`: for ever."""
    if not is_main():
        return left
    return _GLANCE_S if left is None else min(left, _GLANCE_S)
