"""Owns the waiting at a queue: Zenoh's threads put in, the program takes out.

Nothing of Zenoh is held up by who waits. In the forms for asyncio nobody waits: the loop is told.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections import deque
from typing import Any, Generic, TypeVar, cast

from rect import _rect
from rect.options import seconds, text, whole
from rect.waiting import at_once

T = TypeVar("T")

#: Nothing comes any more.
Ended = _rect.Ended
#: How many may wait, unless told otherwise.
DEFAULT_CAPACITY: int = _rect.DEFAULT_CAPACITY


class Inbox(Generic[T]):
    """A queue with somebody at either end."""

    def __init__(self, capacity: int, when_full: str) -> None:
        #: Where Zenoh's threads put in, best without a line of Python: it costs a thread of theirs more than all else.
        self.queue = _rect.Queue(whole("capacity", capacity, 1), text("when_full", when_full))
        self._tasks: deque[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = deque()

    def push(self, item: T) -> bool:
        """Puts one in; where the rule is to wait, once there is room. `False`: refused, or nobody takes any more."""
        return self.queue.push(item)

    def pop(self, timeout: float | None = None) -> T:
        """Takes the oldest, once there is one. Raises `Ended`, or `TimeoutError`."""
        lock = threading.Lock()
        lock.acquire()
        deadline = None if timeout is None else time.monotonic() + seconds("timeout", timeout)
        try:
            while True:
                item = self.queue.pop(lock)
                if item is not None:
                    return cast("T", item)
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    raise TimeoutError
                wait = at_once(left)
                if not lock.acquire(timeout=-1 if wait is None else min(wait, threading.TIMEOUT_MAX)):
                    self.queue.leave(lock)
        except BaseException:
            # It does not wait any more. If it was woken meanwhile, the next one is to look instead.
            if not self.queue.leave(lock):
                self.queue.wake()
            raise

    def try_pop(self) -> T | None:
        """Takes the oldest, if there is one."""
        try:
            return cast("T | None", self.queue.pop())
        except Ended:
            return None

    async def pop_async(self, timeout: float | None = None) -> T:
        """The same as `pop`, for asyncio."""
        loop = asyncio.get_running_loop()
        deadline = None if timeout is None else loop.time() + seconds("timeout", timeout)
        while True:
            told: asyncio.Future[None] = loop.create_future()
            self._tasks.append((loop, told))
            self.queue.set_alarm(self._wake_tasks)
            try:
                item = self.queue.pop()
                if item is not None:
                    return cast("T", item)
                left = None if deadline is None else deadline - loop.time()
                if left is not None and left <= 0:
                    raise TimeoutError
                # asyncio's own error was another one before Python 3.11.
                await asyncio.wait([told], timeout=left)
            finally:
                with contextlib.suppress(ValueError):
                    self._tasks.remove((loop, told))

    def close(self) -> None:
        """Nothing comes any more; what waits can still be taken."""
        self.queue.close()

    def on_fork(self) -> None:
        """In a child process, where nobody waits, and nothing comes."""
        _rect.forget(self.queue)
        self.queue = _rect.Queue(1, "oldest wins")
        self.queue.close()
        self._tasks = deque()

    @property
    def dropped(self) -> int:
        """How many were dropped so far."""
        return self.queue.dropped

    def _wake_tasks(self) -> None:
        self.queue.set_alarm(None)
        for _ in range(len(self._tasks)):
            try:
                loop, told = self._tasks.popleft()
            except IndexError:
                return
            # A loop that was closed meanwhile has nobody who waits.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(_set, told)


def _set(told: asyncio.Future[Any]) -> None:
    if not told.done():
        told.set_result(None)
