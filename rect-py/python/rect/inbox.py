"""Owns the waiting at a queue: Zenoh's threads put in, the program takes out.

Who waits, waits on Python's own locks, so that Ctrl-C ends it at once and nothing of Zenoh is held up. In the forms for
asyncio nobody waits: the loop is told.
"""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any, Generic, TypeVar, cast

from rect import _rect

T = TypeVar("T")

#: How many may wait, unless told otherwise.
DEFAULT_CAPACITY: int = _rect.DEFAULT_CAPACITY


class Ended(Exception):
    """Nothing comes any more."""


class Inbox(Generic[T]):
    """A queue with somebody at either end."""

    def __init__(self, capacity: int, when_full: str) -> None:
        if isinstance(capacity, bool) or not isinstance(capacity, int):
            raise TypeError(f"capacity is a whole number, not a {type(capacity).__name__}")
        self._queue = _rect.Queue(max(capacity, 1), when_full)
        lock = threading.RLock()
        self._arrived = threading.Condition(lock)
        self._taken = threading.Condition(lock)
        self._closed = False
        self._tasks: list[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = []

    def push(self, item: T) -> bool:
        """Puts one in; where the rule is to wait, once there is room. `False`: refused, or nobody takes any more."""
        with self._arrived:
            while not self._closed:
                kept = self._queue.push(item)
                if kept is not None:
                    self._arrived.notify()
                    self._wake_tasks()
                    return kept
                self._taken.wait()
        return False

    def pop(self, timeout: float | None = None) -> T:
        """Takes the oldest, once there is one. Raises `Ended`, or `TimeoutError`."""
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._arrived:
            while True:
                item = self._take()
                if item is not None:
                    return item
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    raise TimeoutError
                self._arrived.wait(left)

    def try_pop(self) -> T | None:
        """Takes the oldest, if there is one."""
        with self._arrived:
            try:
                return self._take()
            except Ended:
                return None

    async def pop_async(self, timeout: float | None = None) -> T:
        """The same as `pop`, for asyncio."""
        loop = asyncio.get_running_loop()
        deadline = None if timeout is None else loop.time() + timeout
        while True:
            with self._arrived:
                item = self._take()
                if item is not None:
                    return item
                told: asyncio.Future[None] = loop.create_future()
                self._tasks.append((loop, told))
            left = None if deadline is None else deadline - loop.time()
            try:
                if left is not None and left <= 0:
                    raise TimeoutError
                # asyncio's own error was another one before Python 3.11.
                await asyncio.wait([told], timeout=left)
            finally:
                self._leave(loop, told)

    def close(self) -> None:
        """Nothing comes any more; what waits can still be taken."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()
            self._taken.notify_all()
            self._wake_tasks()

    def on_fork(self) -> None:
        """In a child process: whoever had the lock is not there."""
        lock = threading.RLock()
        self._arrived = threading.Condition(lock)
        self._taken = threading.Condition(lock)
        self._closed = True
        self._tasks = []

    @property
    def closed(self) -> bool:
        return self._closed

    @property
    def dropped(self) -> int:
        """How many were dropped so far."""
        return self._queue.dropped

    def __len__(self) -> int:
        return len(self._queue)

    def _take(self) -> T | None:
        item = self._queue.pop()
        if item is not None:
            self._taken.notify()
            return cast(T, item)
        if self._closed:
            raise Ended
        return None

    def _wake_tasks(self) -> None:
        tasks, self._tasks = self._tasks, []
        for loop, told in tasks:
            if not loop.is_closed():
                loop.call_soon_threadsafe(_set, told)

    def _leave(self, loop: asyncio.AbstractEventLoop, told: asyncio.Future[None]) -> None:
        with self._arrived:
            if (loop, told) in self._tasks:
                self._tasks.remove((loop, told))


def _set(told: asyncio.Future[Any]) -> None:
    if not told.done():
        told.set_result(None)
