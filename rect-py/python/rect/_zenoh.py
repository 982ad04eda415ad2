"""Owns how this package calls eclipse-zenoh: quality of service, callbacks, and waiting that Ctrl-C ends."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, TypeVar, cast

import zenoh

from rect import _rect
from rect.errors import ZenohError
from rect.waiting import at_once, is_main

T = TypeVar("T")

_PRIORITIES = (
    zenoh.Priority.REAL_TIME,
    zenoh.Priority.INTERACTIVE_HIGH,
    zenoh.Priority.INTERACTIVE_LOW,
    zenoh.Priority.DATA_HIGH,
    zenoh.Priority.DATA,
    zenoh.Priority.DATA_LOW,
    zenoh.Priority.BACKGROUND,
)
#: Payloads larger than this may have to wait for room, and do so on a thread of their own.
LARGE_BYTES = 16 * 1024


def qos(treated: tuple[int, bool, bool]) -> dict[str, Any]:
    """The arguments of Zenoh's calls for what the core says."""
    priority, express, droppable = treated
    congestion = zenoh.CongestionControl.DROP if droppable else zenoh.CongestionControl.BLOCK
    return {"priority": _PRIORITIES[priority - 1], "express": express, "congestion_control": congestion}


def direct(callback: Callable[[Any], object], drop: Callable[[], object] | None = None) -> Any:
    """A callback on Zenoh's own thread, which nothing of a program's runs on."""
    return zenoh.handlers.Callback(callback, drop, indirect=False)


def refused(what: str, error: BaseException) -> ZenohError:
    """What Zenoh says, in one line."""
    return ZenohError(what, _rect.in_words(str(error)))


def payload_bytes(payload: Any) -> bytes:
    """The bytes of what Zenoh delivers, where there are any."""
    return b"" if payload is None else cast(bytes, payload.to_bytes())


def patiently(call: Callable[[], T], undo: Callable[[T], object] | None = None, timeout: float | None = None) -> T:
    """The same as `call()`, which may take long: on a thread of its own, so that Ctrl-C ends the wait at once.

    `undo` is given the result if nobody waits for it any more. Raises `TimeoutError` after `timeout` seconds.
    """
    if timeout is None and not is_main():
        # Ctrl-C is the main thread's.
        return call()
    try:
        worker = _IDLE.pop()
    except IndexError:
        worker = _Worker()
    job = _Job(call, undo)
    worker.jobs.put(job)
    try:
        job.wait(timeout)
    except BaseException:
        job.leave()
        raise
    if job.error is not None:
        raise job.error
    return cast(T, job.result)


class _Job:
    """A call that somebody waits for, as long as they like."""

    def __init__(self, call: Callable[[], Any], undo: Callable[[Any], object] | None) -> None:
        self._done: SimpleQueue[None] = SimpleQueue()
        self.result: Any = None
        self.error: BaseException | None = None
        self._call = call
        self._undo = undo
        self._lock = threading.Lock()
        self._is_made = self._is_left = False

    def run(self) -> None:
        try:
            self.result = self._call()
        except BaseException as error:
            self.error = error
        else:
            self._either(made=True)
        self._done.put(None)

    def wait(self, timeout: float | None) -> None:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0:
                raise TimeoutError
            with contextlib.suppress(Empty):
                return self._done.get(timeout=at_once(left))

    def leave(self) -> None:
        self._either(made=False)

    def _either(self, made: bool) -> None:
        with self._lock:
            other = self._is_left if made else self._is_made
            self._is_made, self._is_left = self._is_made or made, self._is_left or not made
        if other and self._undo is not None:
            self._undo(self.result)


class _Worker(threading.Thread):
    """Makes calls, one after another."""

    def __init__(self) -> None:
        super().__init__(name="rect call", daemon=True)
        self.jobs: SimpleQueue[_Job] = SimpleQueue()
        self.start()

    def run(self) -> None:
        while True:
            job = self.jobs.get()
            job.run()
            del job
            _IDLE.append(self)


#: Those that wait for a call.
_IDLE: deque[_Worker] = deque()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)
