"""Defines the receive queue, which Zenoh's threads fill and the program reads.

A waiting reader blocks no thread of Zenoh. With asyncio no thread waits at all: the queue wakes the event loop.
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
from rect.waiting import next_wait

T = TypeVar("T")

#: Raised when the queue is closed and empty.
Ended = _rect.Ended
#: Default capacity of a subscriber, in messages.
DEFAULT_CAPACITY: int = _rect.DEFAULT_CAPACITY


class ReceiveQueue(Generic[T]):
    """A bounded queue with a rule for what happens when it is full."""

    def __init__(self, capacity: int, when_full: str) -> None:
        #: The native queue. Zenoh's threads call it directly: running Python code there costs more than all the rest.
        self.queue = _rect.Queue(whole("capacity", capacity, 1), text("when_full", when_full))
        self._tasks: deque[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = deque()

    def push(self, item: T) -> bool:
        """Adds an item; with the rule `block`, waits for room first. Returns `False` if it was dropped."""
        return self.queue.push(item)

    def pop(self, timeout: float | None = None) -> T:
        """Waits for an item and removes the oldest one. Raises `Ended`, and `TimeoutError` after `timeout` seconds."""
        lock = threading.Lock()
        lock.acquire()
        deadline = None if timeout is None else time.monotonic() + seconds("timeout", timeout)
        try:
            while True:
                item = self.queue.pop(lock)
                if item is not None:
                    return cast("T", item)
                remaining = None if deadline is None else deadline - time.monotonic()
                if remaining is not None and remaining <= 0:
                    raise TimeoutError
                wait = next_wait(remaining)
                if not lock.acquire(timeout=-1 if wait is None else min(wait, threading.TIMEOUT_MAX)):
                    self.queue.leave(lock)
        except BaseException:
            # This thread no longer waits. If it has been woken in the meantime, it wakes the next one instead.
            if not self.queue.leave(lock):
                self.queue.wake()
            raise

    def try_pop(self) -> T | None:
        """Removes the oldest item, if there is one."""
        try:
            return cast("T | None", self.queue.pop())
        except Ended:
            return None

    async def pop_async(self, timeout: float | None = None) -> T:
        """Does the same as `pop`, for asyncio."""
        loop = asyncio.get_running_loop()
        deadline = None if timeout is None else loop.time() + seconds("timeout", timeout)
        while True:
            woken: asyncio.Future[None] = loop.create_future()
            self._tasks.append((loop, woken))
            self.queue.set_alarm(self._wake_tasks)
            try:
                item = self.queue.pop()
                if item is not None:
                    return cast("T", item)
                remaining = None if deadline is None else deadline - loop.time()
                if remaining is not None and remaining <= 0:
                    raise TimeoutError
                # Before Python 3.11 asyncio had its own timeout error, so `wait_for` is not used.
                await asyncio.wait([woken], timeout=remaining)
            finally:
                with contextlib.suppress(ValueError):
                    self._tasks.remove((loop, woken))

    def close(self) -> None:
        """Closes the queue to new items. Items that are waiting can still be taken."""
        self.queue.close()

    def on_fork(self) -> None:
        """Replaces the queue in a child process, where nothing arrives."""
        _rect.forget(self.queue)
        self.queue = _rect.Queue(1, "drop_newest")
        self.queue.close()
        self._tasks = deque()

    @property
    def dropped(self) -> int:
        """Number of items dropped so far."""
        return self.queue.dropped

    def _wake_tasks(self) -> None:
        self.queue.set_alarm(None)
        for _ in range(len(self._tasks)):
            try:
                loop, woken = self._tasks.popleft()
            except IndexError:
                return
            # If the loop has been closed in the meantime, no task waits.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(_set, woken)


def _set(woken: asyncio.Future[Any]) -> None:
    if not woken.done():
        woken.set_result(None)
