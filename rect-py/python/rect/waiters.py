"""Owns waiting until something can be done: whoever waits does so at a lock of Python's own, which Ctrl-C ends at once.

Nothing is held while one waits, looks, or is woken: a wake-up costs what releasing a lock does.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


#: A Ctrl-C that comes while the main thread is about to wait, but does not yet, ends no wait: so it looks up as often,
#: in seconds. Other threads need not: Ctrl-C is the main thread's.
GLANCE_S = 0.5


def at_once(left: float | None) -> float | None:
    """How long this thread may wait at once, of so many seconds; `None`: for ever."""
    if threading.current_thread() is not threading.main_thread():
        return left
    return GLANCE_S if left is None else min(left, GLANCE_S)


class Waiters:
    """Those who wait for one thing, in their order."""

    def __init__(self) -> None:
        self._locks: deque[threading.Lock] = deque()

    def until(self, look: Callable[[], T | None], timeout: float | None = None) -> T | None:
        """What `look` finds, as soon as that is something; `None` when the time (seconds) is over."""
        found = look()
        if found is not None:
            return found
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if deadline is None else deadline - time.monotonic()
            lock = threading.Lock()
            lock.acquire()
            try:
                self._locks.append(lock)
                # It may have come before this one was known to wait.
                found = look()
                if found is None and (left is None or left > 0):
                    seconds = at_once(left)
                    lock.acquire(timeout=-1 if seconds is None else min(seconds, threading.TIMEOUT_MAX))
                    self._forget(lock)
                    continue
            except BaseException:
                self._pass_on(lock)
                raise
            self._pass_on(lock)
            return found

    def wake(self) -> None:
        """Whoever waits for the longest looks again."""
        try:
            lock = self._locks.popleft()
        except IndexError:
            return
        lock.release()

    def wake_all(self) -> None:
        """All look again."""
        for _ in range(len(self._locks)):
            self.wake()

    def _forget(self, lock: threading.Lock) -> bool:
        try:
            self._locks.remove(lock)
        except ValueError:
            return False
        return True

    def _pass_on(self, lock: threading.Lock) -> None:
        """It does not wait any more. If it was woken meanwhile, the next one is to look instead."""
        if not self._forget(lock):
            self.wake()
