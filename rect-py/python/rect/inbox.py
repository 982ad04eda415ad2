"""Owns the waiting at a queue: Zenoh's threads put in, the program takes out.

Nothing of Zenoh is held up by who waits. In the forms for asyncio nobody waits: the loop is told.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from typing import Any, Generic, TypeVar, cast

from rect import _rect
from rect.waiters import Waiters

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
        self._arrived = Waiters()
        self._taken = Waiters()
        self._closed = False
        self._tasks: deque[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = deque()

    def push(self, item: T) -> bool:
        """Puts one in; where the rule is to wait, once there is room. `False`: refused, or nobody takes any more."""
        kept = self._queue.push(item) if not self._closed else False
        if kept is None:
            kept = self._taken.until(lambda: self._queue.push(item) if not self._closed else False)
        self._arrived.wake()
        if self._tasks:
            self._wake_tasks()
        return bool(kept)

    def pop(self, timeout: float | None = None) -> T:
        """Takes the oldest, once there is one. Raises `Ended`, or `TimeoutError`."""
        item = self._arrived.until(self._take, timeout)
        if item is None:
            raise TimeoutError
        return item

    def try_pop(self) -> T | None:
        """Takes the oldest, if there is one."""
        try:
            return self._take()
        except Ended:
            return None

    async def pop_async(self, timeout: float | None = None) -> T:
        """The same as `pop`, for asyncio."""
        loop = asyncio.get_running_loop()
        deadline = None if timeout is None else loop.time() + timeout
        while True:
            told: asyncio.Future[None] = loop.create_future()
            self._tasks.append((loop, told))
            try:
                item = self._take()
                if item is not None:
                    return item
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
        self._closed = True
        self._arrived.wake_all()
        self._taken.wake_all()
        self._wake_tasks()

    def on_fork(self) -> None:
        """In a child process, where nobody waits, and nothing comes."""
        self._closed = True
        self._arrived = Waiters()
        self._taken = Waiters()
        self._tasks = deque()

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
        if item is None:
            if not self._closed:
                return None
            # It may have come before the end did.
            item = self._queue.pop()
            if item is None:
                raise Ended
        self._taken.wake()
        return cast(T, item)

    def _wake_tasks(self) -> None:
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
