"""Wraps eclipse-zenoh for this package: quality of service, callbacks, and waiting that Ctrl-C interrupts."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from queue import Empty, SimpleQueue
from typing import Any, TypeVar, cast

import zenoh

from rect import _rect
from rect.errors import ZenohError
from rect.waiting import is_main, next_wait

T = TypeVar("T")
_LOG = logging.getLogger("rect")

_PRIORITIES = (
    zenoh.Priority.REAL_TIME,
    zenoh.Priority.INTERACTIVE_HIGH,
    zenoh.Priority.INTERACTIVE_LOW,
    zenoh.Priority.DATA_HIGH,
    zenoh.Priority.DATA,
    zenoh.Priority.DATA_LOW,
    zenoh.Priority.BACKGROUND,
)


@lru_cache
def qos(qos_fields: tuple[int, bool, bool]) -> dict[str, Any]:
    """Converts the quality of service that the core chose into keyword arguments of Zenoh's calls."""
    priority, express, droppable = qos_fields
    congestion = zenoh.CongestionControl.DROP if droppable else zenoh.CongestionControl.BLOCK
    return {"priority": _PRIORITIES[priority - 1], "express": express, "congestion_control": congestion}


def get_arguments(
    selector: str,
    payload: tuple[bytes, str] | None,
    attachment: bytes | None,
    qos_fields: tuple[int, bool, bool],
    is_for_all: bool,
    timeout: float,
) -> tuple[str, dict[str, Any]]:
    """Returns the selector and the keyword arguments of Zenoh's `get` for a query that the core prepared."""
    arguments = {
        **qos(qos_fields),
        "target": zenoh.QueryTarget.ALL if is_for_all else zenoh.QueryTarget.BEST_MATCHING,
        "consolidation": zenoh.ConsolidationMode.NONE,
        "timeout": timeout,
        "attachment": attachment,
    }
    if payload is not None:
        arguments["payload"], arguments["encoding"] = payload
    return selector, arguments


def direct(callback: Callable[[Any], object], drop: Callable[[], object] | None = None) -> Any:
    """Wraps a callback that runs directly on a Zenoh thread. User code never runs there."""
    return zenoh.handlers.Callback(callback, drop, indirect=False)


def zenoh_error(operation: str, error: BaseException) -> ZenohError:
    """Makes a `ZenohError` with the reason on one line."""
    return ZenohError(operation, _rect.on_one_line(str(error)))


def undeclared(declared: Any) -> None:
    """Undeclares a Zenoh declaration, if it has not ended already."""
    try:
        declared.undeclare()
    except zenoh.ZError as error:
        _LOG.debug("the declaration had already ended: %s", error)


def payload_bytes(payload: Any) -> bytes:
    """Returns the bytes of a Zenoh payload; empty if there is none."""
    return b"" if payload is None else cast(bytes, payload.to_bytes())


def call_interruptibly(
    call: Callable[[], T], undo: Callable[[T], object] | None = None, timeout: float | None = None
) -> T:
    """Runs `call()`, which may take long, on a separate thread, so that Ctrl-C ends the wait at once.

    If the wait ends before the call does, `undo` is called with its result. Raises `TimeoutError` after `timeout`
    seconds.
    """
    if timeout is None and not is_main():
        # Only the main thread receives Ctrl-C.
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
        job.abandon()
        raise
    if job.error is not None:
        raise job.error
    return cast(T, job.result)


class _Job:
    """A call on a worker thread, and the wait for its result, which may be abandoned."""

    def __init__(self, call: Callable[[], Any], undo: Callable[[Any], object] | None) -> None:
        self._done: SimpleQueue[None] = SimpleQueue()
        self.result: Any = None
        self.error: BaseException | None = None
        self._call = call
        self._undo = undo
        self._lock = threading.Lock()
        self._is_done = self._is_abandoned = False

    def run(self) -> None:
        try:
            self.result = self._call()
        except BaseException as error:
            self.error = error
        else:
            self._settle(done=True)
        self._done.put(None)

    def wait(self, timeout: float | None) -> None:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            remaining = None if deadline is None else deadline - time.monotonic()
            if remaining is not None and remaining <= 0:
                raise TimeoutError
            with contextlib.suppress(Empty):
                return self._done.get(timeout=next_wait(remaining))

    def abandon(self) -> None:
        self._settle(done=False)

    def _settle(self, done: bool) -> None:
        """Records that the call is done or the wait abandoned. After both, undoes the call."""
        with self._lock:
            is_both = self._is_abandoned if done else self._is_done
            self._is_done, self._is_abandoned = self._is_done or done, self._is_abandoned or not done
        if is_both and self._undo is not None:
            self._undo(self.result)


class _Worker(threading.Thread):
    """A thread that runs jobs one after another."""

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


#: Workers without a job.
_IDLE: deque[_Worker] = deque()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)
