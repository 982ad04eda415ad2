"""Sends and receives transfers: files and bytes of any size. Their drivers are in the core.

Each incoming transfer has a separate thread, because files and congested links block it. An outgoing transfer runs on
the thread of its caller.
"""

from __future__ import annotations

import contextlib
import logging
import os
import random
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect._zenoh import call_interruptibly
from rect.errors import RectError, TimedOut, TransferError, TransferFailed
from rect.executor import Executor
from rect.receive_queue import Ended, ReceiveQueue
from rect.values import Payload, payload_of

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")
#: Interval for checking whether the session was closed, in seconds.
_CHECK_INTERVAL_S = 1.0


@dataclass(frozen=True)
class Progress:
    """Progress of a transfer."""

    #: Bytes that the receiver has stored.
    received_bytes: int
    #: Size of the transfer, in bytes.
    size_bytes: int

    @property
    def fraction(self) -> float:
        """Share that the receiver has stored: 0 to 1. It is 1 for an empty transfer."""
        return self.received_bytes / self.size_bytes if self.size_bytes else 1.0


@dataclass(frozen=True)
class Received:
    """A received transfer, complete or failed."""

    #: Name of the robot that sent it.
    sender: str
    #: Topic of the transfer.
    topic: str
    #: File name that the sender chose; may be empty.
    name: str
    #: Encoding of the content.
    encoding: str
    #: Size, in bytes.
    size_bytes: int
    #: Why the transfer failed. `None` if it is complete.
    error: TransferError | None = None
    _content: bytes | Path = field(default=b"", repr=False)

    @property
    def content(self) -> bytes | Path:
        """The bytes, or the path of the file. Raises `error` if the transfer failed."""
        if self.error is not None:
            raise self.error
        return self._content

    @property
    def value(self) -> Any:
        """The decoded content; see `Message.value`. Reads the file, if there is one.

        Raises `error` if the transfer failed.
        """
        content = self.content
        return Payload(content.read_bytes() if isinstance(content, Path) else content, self.encoding).value


OnProgress = Callable[[Progress], object]


class OutgoingTransfer:
    """A transfer to one robot. Returned by `Robot.outgoing_transfer`."""

    def __init__(
        self,
        session: Session,
        recipient: str,
        topic: str,
        data: Any,
        *,
        name: str | None,
        timeout: float | None,
        on_progress: OnProgress | None,
    ) -> None:
        encoding = None
        source: Any = data
        if isinstance(data, (str, os.PathLike)):
            source = Path(data)
        elif not isinstance(data, bytes):
            payload = payload_of(data)
            source, encoding = payload.bytes, payload.encoding
        self._session = session
        call = random.getrandbits(64)
        self._core = call_interruptibly(
            lambda: _rect.TransferPush(
                session.key_space, recipient, topic, source, call, name=name, encoding=encoding, timeout_s=timeout
            )
        )
        core = self._core
        self._executor = Executor(
            session, core.driver(), _progress_callback(on_progress), before_poll=core.perform_files
        )

    def stop(self) -> None:
        """Stops the transfer: `run` raises `Closed`. If the receiver stores files, a later transfer continues it."""
        self._core.stop()
        self._executor.wake()

    def run(self) -> None:
        """Runs the transfer until the data has arrived and is verified.

        Raises `TransferRefused`, `TransferFailed`, `TimedOut` and `Closed`.
        """
        session = self._session
        session.close_callbacks.append(self.stop)
        try:
            # The session may have been closed before the line above.
            session.check()
            error = self._core.error(self._executor.run())
        finally:
            self._executor.end()
            session.close_callbacks.remove(self.stop)
        if error is not None:
            session.check()
            raise error


class Transfers:
    """Iterates over the transfers that ended, complete or failed (see `Received.error`).

    Returned by `Robot.receive_transfers`. Closing this object refuses further transfers, and interrupts those in
    progress. With a folder, the parts that were received are kept.
    """

    #: Always 0: a full receive queue makes the transfers wait.
    dropped = 0
    _HANDLE = "transfer receiver"

    def __init__(
        self,
        session: Session,
        pattern: str,
        *,
        folder: str | os.PathLike[str] | None,
        max_bytes: int,
        max_concurrent: int,
        timeout: float,
        on_progress: Callable[[Received, Progress], object] | None,
    ) -> None:
        self._session = session
        self._pattern = pattern
        self._receiver = _TransferReceiver(session, pattern, folder, max_bytes, max_concurrent, timeout, on_progress)
        self._receiver.leave_with(self)

    def next(self, timeout: float | None = None) -> Received:
        """Waits until a transfer ends and returns it.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if no transfer ends in time, and `Closed` if this object or the robot is closed.
        """
        try:
            return self._receiver.take(self._receiver.ended.pop(timeout))
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(f"transfer {self._pattern}", timeout or 0) from None

    def __iter__(self) -> Iterator[Received]:
        return self

    def __next__(self) -> Received:
        try:
            return self._receiver.take(self._receiver.ended.pop())
        except Ended:
            raise StopIteration from None

    async def next_async(self, timeout: float | None = None) -> Received:
        """Does the same as `next`, for asyncio. Raises `Ended` and `TimeoutError`."""
        return self._receiver.take(await self._receiver.ended.pop_async(timeout))

    def close(self) -> None:
        """Refuses further transfers, and interrupts those in progress."""
        self._receiver.stop()

    def __enter__(self) -> Transfers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Transfers({self._pattern})"


class _TransferReceiver:
    """Answers the offers to a program, and receives the accepted transfers."""

    def __init__(
        self,
        session: Session,
        pattern: str,
        folder: str | os.PathLike[str] | None,
        max_bytes: int,
        max_concurrent: int,
        timeout: float,
        on_progress: Callable[[Received, Progress], object] | None,
    ) -> None:
        self.ended: ReceiveQueue[Received] = ReceiveQueue(max_concurrent, "block")
        self._session = session
        self._folder = None if folder is None else Path(folder)
        self._timeout = timeout
        self._on_progress = on_progress
        self._core = _rect.TransferReception(session.key_space, pattern, max_bytes, max_concurrent, self._folder)
        self._running: dict[str, tuple[_rect.TransferPull, Executor]] = {}
        self._is_stopped = False
        #: Free places for transfers that ended and that the program has not read yet.
        self._room = threading.Semaphore(max(max_concurrent, 1))
        session.close_callbacks.append(self._end)
        self._executor = Executor(session, self._core.driver(), self._on_arrival)
        self._executor.start("rect transfers")

    def stop(self) -> None:
        """Refuses further transfers, and interrupts those in progress."""
        self._end()
        self._executor.end()

    def leave_with(self, handle: object) -> None:
        """Stops without blocking when `handle` is garbage-collected without having been closed."""
        self._executor.declarations.leave_with(handle, self._leave)

    def _leave(self) -> None:
        self._end()
        self._executor.declarations.leave()

    def _end(self) -> None:
        self._is_stopped = True
        self._core.stop()
        self.ended.close()
        for pull, executor in list(self._running.values()):
            pull.stop()
            executor.wake()

    def take(self, received: Received) -> Received:
        """Frees the place of a transfer that the program has read."""
        self._room.release()
        return received

    def _on_arrival(self, arrival: tuple[str, Any]) -> None:
        kind, about = arrival
        if kind == "begin":
            self._session.start("rect transfer", lambda: self._receive(about))
        elif about in self._running:
            pull, executor = self._running[about]
            pull.on_offered()
            executor.wake()

    def _receive(self, offered: _rect.OfferedTransfer) -> None:
        """Receives a transfer, from opening its storage to its end."""
        about = Received(offered.sender, offered.topic, offered.name, offered.encoding, offered.size_bytes)
        pull = _rect.TransferPull(self._session.key_space, offered, self._folder, self._timeout)
        self._pull(offered, pull, about)
        # A transfer is done when the program has read it or will read it. A slow program makes this wait.
        self._core.on_untaken(offered)
        has_room = not pull.is_stopped and self._wait_for_room()
        self._core.on_ended(offered, pull, has_room)
        self._running.pop(offered.id, None)
        self._executor.wake()
        # Inform the sender first: the program may exit as soon as it has read the transfer.
        if not self._session.is_closed:
            with contextlib.suppress(RectError):
                Executor(self._session, pull.end_report()).run()
        if has_room:
            self.ended.push(_received(about, pull))

    def _pull(self, offered: _rect.OfferedTransfer, pull: _rect.TransferPull, about: Received) -> None:
        driver = pull.driver()
        if driver is None:
            return
        report = None
        if self._on_progress is not None:
            on_progress = self._on_progress
            report = _progress_callback(lambda progress: on_progress(about, progress))

        def on_progress_of_driver(progress: tuple[int, int]) -> None:
            self._core.on_received_bytes(offered, progress[0])
            if report is not None:
                report(progress)

        executor = Executor(self._session, driver, on_progress_of_driver, before_poll=pull.perform_files)
        self._running[offered.id] = (pull, executor)
        if self._is_stopped:
            pull.stop()
        outcome = None
        with contextlib.suppress(RectError):
            outcome = executor.run()
        warning = pull.conclude(outcome)
        if warning is not None:
            _LOG.warning("%s", warning)

    def _wait_for_room(self) -> bool:
        """Waits until the program can read one more transfer. Returns `False` if it has stopped."""
        while not self._is_stopped:
            if self._room.acquire(timeout=_CHECK_INTERVAL_S):
                return True
        return False


def _received(about: Received, pull: _rect.TransferPull) -> Received:
    fields = (about.sender, about.topic, about.name, about.encoding, about.size_bytes)
    try:
        content = pull.content()
    except TransferFailed as error:
        return Received(*fields, error)
    return Received(*fields, None, Path(content) if isinstance(content, str) else content)


def _progress_callback(callback: OnProgress | None) -> Callable[[tuple[int, int]], None] | None:
    """Returns a function that calls `callback`, and logs its exceptions."""
    if callback is None:
        return None

    def report(progress: tuple[int, int]) -> None:
        try:
            callback(Progress(*progress))
        except Exception:
            _LOG.exception("the progress callback of a transfer raised an exception")

    return report
