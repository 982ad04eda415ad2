"""Counts the threads that are inside Zenoh, so that Python does not exit while one is there."""

from __future__ import annotations

import threading
from collections.abc import Callable


class ZenohCalls:
    """A context manager around each call of Zenoh that a program's own threads make.

    If Python exits during such a call, the thread never returns to Python; it keeps Zenoh's locks, and Python waits
    for these for ever.
    """

    def __init__(self, closed_error: Callable[[], Exception]) -> None:
        self._closed_error = closed_error
        # The lock itself is faster than the condition.
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._count = 0
        self._has_ended = False

    def __enter__(self) -> None:
        """Begins a call. Raises `Closed` if the session is closed."""
        with self._lock:
            if self._has_ended:
                raise self._closed_error()
            self._count += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._count -= 1
            if self._has_ended:
                self._changed.notify_all()

    def end(self, timeout: float) -> None:
        """Allows no more calls, and waits until none is in progress, for at most `timeout` seconds."""
        with self._changed:
            self._has_ended = True
            self._changed.wait_for(lambda: self._count == 0, timeout)
