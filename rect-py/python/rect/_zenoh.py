"""Owns how this package calls eclipse-zenoh: quality of service, callbacks, and waiting that Ctrl-C ends."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar, cast

import zenoh

from rect import _rect
from rect.errors import ZenohError

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


def patiently(call: Callable[[], T], undo: Callable[[T], object] | None = None) -> T:
    """The same as `call()`, which may take long: on a thread of its own, so that Ctrl-C ends the wait at once.

    `undo` is given the result if nobody waits for it any more.
    """
    done = threading.Event()
    lock = threading.Lock()
    result: list[T] = []
    failed: list[BaseException] = []
    gone = False

    def run() -> None:
        try:
            made = call()
        except BaseException as error:
            failed.append(error)
        else:
            with lock:
                result.append(made)
                late = gone
            if late and undo is not None:
                undo(made)
        done.set()

    threading.Thread(target=run, name="rect-call", daemon=True).start()
    try:
        done.wait()
    except BaseException:
        with lock:
            gone = True
            made = list(result)
        if made and undo is not None:
            undo(made[0])
        raise
    if failed:
        raise failed[0]
    return result[0]
