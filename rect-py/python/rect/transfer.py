"""Sends and receives transfers: files and bytes of any size. The core makes the decisions.

Each incoming transfer has a separate thread, because files and congested links block it. An outgoing transfer runs on
the thread of its caller.
"""

from __future__ import annotations

import logging
import os
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import call_interruptibly, direct, payload_bytes, zenoh_error
from rect.errors import Closed, TimedOut, TransferError, TransferFailed
from rect.receive_queue import Ended, ReceiveQueue
from rect.subscriber import Declared
from rect.values import Payload, payload_of
from rect.waiting import next_wait

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")
#: Number of requests and replies that may wait for the thread of a transfer. Any further one is dropped and repeated.
_WAITING = 256
#: Maximum number of answers from the programs of a robot to one offer.
_MAX_ANSWERS = 16
#: Maximum number of queries that stay open until the transfer ends.
_MAX_HELD = 16
#: Number of offers that may wait for an answer.
_OFFERS = 64
#: Minimum interval between two calls of a progress callback, in seconds.
_PROGRESS_INTERVAL_S = 0.1
#: Interval for checking whether the session was closed, in seconds.
_CHECK_INTERVAL_S = 1.0
#: Timeout for informing the sender of the end of a transfer, in seconds.
_ENDED_TIMEOUT_S = 3.0


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
        self._recipient = recipient
        self._progress = _ProgressThrottle(on_progress)
        call = random.getrandbits(64)
        self._core = call_interruptibly(
            lambda: _rect.TransferSender(
                session.key_space, recipient, topic, source, call, name=name, encoding=encoding, timeout_s=timeout
            )
        )
        self._events: SimpleQueue[tuple[str, Any, Any]] = SimpleQueue()
        #: Queries that stay open until the offer of that number has been answered.
        self._held: list[tuple[int, zenoh.Query]] = []

    def stop(self) -> None:
        """Stops the transfer: `run` raises `Closed`. If the receiver stores files, a later transfer continues it."""
        self._events.put(("stop", None, None))

    def run(self) -> None:
        """Runs the transfer until the data has arrived and is verified.

        Raises `TransferRefused`, `TransferFailed`, `TimedOut` and `Closed`.
        """
        session, key_space = self._session, self._session.key_space
        key = key_space.own(key_space.robot, self._core.key)
        session.close_callbacks.append(self.stop)
        declared = Declared(session)
        try:
            # The session may have been closed before the line above.
            session.check()
            on_query = direct(lambda query: self._push(("query", query, None)))
            declared.add(session.zenoh.declare_queryable(key, on_query, complete=True))
            self._run(key)
        except zenoh.ZError as error:
            session.check()
            raise zenoh_error("cannot offer the transfer", error) from None
        finally:
            declared.end()
            session.close_callbacks.remove(self.stop)
            self._end_queries()

    def _run(self, key: str) -> None:
        number, answers = 0, list[bytes]()
        while True:
            self._progress.report(self._core.progress())
            step, seconds = self._core.poll()
            if step == "done":
                self._progress.report(self._core.progress(), last=True)
                return
            if step == "offer":
                number, answers = number + 1, []
                self._offer(number, seconds)
                continue
            try:
                what, about, answer = self._events.get(timeout=next_wait(max(seconds, 0)))
            except Empty:
                self._session.check()
                continue
            if what == "query":
                self._serve(key, about)
            elif what == "answer" and about == number and len(answers) < _MAX_ANSWERS:
                answers.append(answer)
            elif what == "answered" and about == number:
                self._core.on_answers(answers)
                self._release(number)
            elif what == "stop":
                self._session.check()
                raise Closed("the transfer was stopped")

    def _push(self, event: tuple[str, Any, Any]) -> None:
        if self._events.qsize() < _WAITING:
            self._events.put(event)
        elif event[0] == "query":
            event[1].drop()

    def _offer(self, number: int, timeout: float) -> None:
        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                self._push(("answer", number, payload_bytes(reply.ok.payload)))

        # If there is no receiver, Zenoh calls this at once, on this thread. It contains no Python code, since a Ctrl-C
        # in it would be lost inside Zenoh.
        on_end = partial(self._events.put, ("answered", number, None))
        key = self._session.key_space.own(self._recipient, _rect.TRANSFER_OFFERS)
        _query(self._session, key, self._core.offer, timeout, on_reply, on_end, zenoh.QueryTarget.ALL)

    def _serve(self, key: str, query: zenoh.Query) -> None:
        """Answers a request of the receiver. An invalid one gets no reply."""
        answer = self._core.on_request(payload_bytes(query.payload))
        if answer is not None and answer[1] is None and len(self._held) < _MAX_HELD:
            self._held.append((answer[2], query))
            return
        with query:
            if answer is None or answer[1] is None:
                return
            is_valid, reply, _ = answer
            try:
                if is_valid:
                    query.reply(key, reply)
                else:
                    query.reply_err(reply)
            except zenoh.ZError as error:
                _LOG.debug("cannot send a piece: %s", error)

    def _release(self, number: int | None = None) -> None:
        """Ends the queries that wait for the answers to this offer, or with `None` all queries."""
        held, self._held = self._held, []
        for after, query in held:
            if number is not None and after > number:
                self._held.append((after, query))
            else:
                query.drop()

    def _end_queries(self) -> None:
        """Ends all remaining queries without a reply."""
        self._release()
        while not self._events.empty():
            what, about, _ = self._events.get()
            if what == "query":
                about.drop()


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
        self._admission = _rect.Admission(session.key_space, pattern, max_bytes, max_concurrent, self._folder)
        self._key = session.key_space.own(session.key_space.robot, _rect.TRANSFER_OFFERS)
        self._lock = threading.Lock()
        self._running: dict[str, SimpleQueue[tuple[str, int, bytes]]] = {}
        self._is_stopped = False
        #: `offer` with a query, `confirmed` with a question and the reply, `no_reply` with a question, or `end`.
        self._events: SimpleQueue[tuple[str, Any, bytes]] = SimpleQueue()
        #: Free places for transfers that ended and that the program has not read yet.
        self._room = threading.Semaphore(max(max_concurrent, 1))
        session.close_callbacks.append(self.stop)
        session.start("rect transfers", self._handle_events)
        self._declared = Declared(session)
        try:
            self._declared.add(session.zenoh.declare_queryable(self._key, direct(self._on_query)))
        except zenoh.ZError as error:
            self.stop()
            raise zenoh_error("cannot receive transfers", error) from None

    def stop(self) -> None:
        """Refuses further transfers, and interrupts those in progress."""
        self._end()
        self._declared.end()

    def leave_with(self, handle: object) -> None:
        """Stops without blocking when `handle` is garbage-collected without having been closed."""
        self._declared.leave_with(handle, self._leave)

    def _leave(self) -> None:
        self._end()
        self._declared.leave()

    def _end(self) -> None:
        self._is_stopped = True
        self.ended.close()
        for events in list(self._running.values()):
            events.put(("stop", 0, b""))
        self._events.put(("end", None, b""))

    def take(self, received: Received) -> Received:
        """Frees the place of a transfer that the program has read."""
        self._room.release()
        return received

    def _on_query(self, query: zenoh.Query) -> None:
        if self._events.qsize() < _OFFERS:
            self._events.put(("offer", query, b""))
        else:
            query.drop()

    def _handle_events(self) -> None:
        while True:
            try:
                what, about, reply = self._events.get(timeout=self._query_senders())
            except Empty:
                continue
            if what == "offer":
                with about:
                    try:
                        about.reply(self._key, self._on_offer(payload_bytes(about.payload)))
                    except zenoh.ZError as error:
                        _LOG.debug("cannot answer an offer: %s", error)
            elif what == "confirmed":
                self._on_confirmed(about, reply)
            elif what == "no_reply":
                self._admission.on_no_reply(about)
            else:
                return

    def _query_senders(self) -> float | None:
        """Asks the robots named in offers to confirm them. Returns the time until the next call, in seconds."""
        while True:
            question, seconds = self._admission.poll()
            if question is None:
                return None if seconds is None else next_wait(max(seconds, 0))
            self._query_sender(question)

    def _query_sender(self, question: _rect.Question) -> None:
        answered: list[bool] = []

        def on_reply(reply: zenoh.Reply) -> None:
            # Only one reply per question counts: more would fill the memory.
            if reply.ok is not None and not answered:
                answered.append(True)
                self._events.put(("confirmed", question, payload_bytes(reply.ok.payload)))

        on_end = partial(self._events.put, ("no_reply", question, b""))
        key = self._session.key_space.own(question.robot, question.key)
        target = zenoh.QueryTarget.BEST_MATCHING
        _query(self._session, key, question.payload, question.timeout, on_reply, on_end, target)

    def _on_offer(self, offer: bytes) -> bytes:
        answer, running = self._admission.on_offer(offer)
        self._notify_offered(running)
        return answer

    def _on_confirmed(self, question: _rect.Question, reply: bytes) -> None:
        offered, running = self._admission.on_confirmed(question, reply)
        self._notify_offered(running)
        if offered is None:
            return
        if self._is_stopped:
            self._admission.on_stopped(offered)
            return
        events: SimpleQueue[tuple[str, int, bytes]] = SimpleQueue()
        self._running[offered.id] = events
        self._session.start("rect transfer", lambda: self._pull(offered, events))

    def _notify_offered(self, id: str | None) -> None:
        events = None if id is None else self._running.get(id)
        if events is not None:
            events.put(("offered", 0, b""))

    def _pull(self, offered: _rect.Offered, events: SimpleQueue[tuple[str, int, bytes]]) -> None:
        about = Received(offered.sender, offered.topic, offered.name, offered.encoding, offered.size_bytes)
        key = self._session.key_space.own(offered.sender, offered.key)
        pull = _rect.Pull(offered, self._folder, self._timeout)
        throttle = _ProgressThrottle(None)
        if self._on_progress is not None:
            on_progress = self._on_progress
            throttle = _ProgressThrottle(lambda progress: on_progress(about, progress))
        while True:
            step, ticket, payload, seconds = pull.poll()
            self._admission.on_received_bytes(offered, pull.progress()[0])
            if step == "finished":
                break
            if step == "request" and payload is not None:
                self._query(key, ticket, payload, seconds, events)
                continue
            self._wait(pull, events, min(max(seconds, 0), _CHECK_INTERVAL_S))
            throttle.report(pull.progress())
        throttle.report(pull.progress(), last=True)
        self._over(offered, pull, about, key)

    def _wait(self, pull: _rect.Pull, events: SimpleQueue[tuple[str, int, bytes]], seconds: float) -> None:
        try:
            what, ticket, bytes_ = events.get(timeout=seconds)
        except Empty:
            what, ticket, bytes_ = "", 0, b""
        if what == "reply":
            pull.on_reply(ticket, bytes_)
        elif what == "error":
            pull.on_error(ticket, bytes_)
        elif what == "end":
            pull.on_end(ticket)
        elif what == "offered":
            pull.on_offered()
        if what == "stop" or self._session.is_closed:
            pull.stop()

    def _query(
        self, key: str, ticket: int, payload: bytes, timeout: float, events: SimpleQueue[tuple[str, int, bytes]]
    ) -> None:
        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                events.put(("reply", ticket, payload_bytes(reply.ok.payload)))
            elif reply.err is not None:
                events.put(("error", ticket, payload_bytes(reply.err.payload)))

        def on_end() -> None:
            events.put(("end", ticket, b""))

        # A late reply is useful, too.
        _query(self._session, key, payload, timeout * 2, on_reply, on_end, zenoh.QueryTarget.BEST_MATCHING)

    def _over(self, offered: _rect.Offered, pull: _rect.Pull, about: Received, key: str) -> None:
        # A transfer is done when the program has read it or will read it. A slow program makes this wait.
        has_room = not pull.is_stopped and self._wait_for_room()
        self._admission.on_ended(offered, pull, has_room or pull.is_stopped)
        self._running.pop(offered.id, None)
        # Inform the sender first: the program may exit as soon as it has read the transfer.
        if not self._session.is_closed:
            informed = threading.Event()
            ended = _rect.transfer_ended()
            _query(self._session, key, ended, _ENDED_TIMEOUT_S, _ignored, informed.set, zenoh.QueryTarget.BEST_MATCHING)
            informed.wait(_ENDED_TIMEOUT_S)
        if has_room:
            self.ended.push(_received(about, pull))

    def _wait_for_room(self) -> bool:
        """Waits until the program can read one more transfer. Returns `False` if it has stopped."""
        while not self._is_stopped:
            if self._room.acquire(timeout=_CHECK_INTERVAL_S):
                return True
        return False


def _received(about: Received, pull: _rect.Pull) -> Received:
    fields = (about.sender, about.topic, about.name, about.encoding, about.size_bytes)
    try:
        content = pull.content()
    except TransferFailed as error:
        return Received(*fields, error)
    return Received(*fields, None, Path(content) if isinstance(content, str) else content)


class _ProgressThrottle:
    """Reports progress to a callback: each change once, and at most ten times a second."""

    def __init__(self, callback: OnProgress | None) -> None:
        self._callback = callback
        self._reported: tuple[int, int] | None = None
        self._reported_at = 0.0

    def report(self, progress: tuple[int, int], last: bool = False) -> None:
        now = time.monotonic()
        is_due = self._reported is None or last or now - self._reported_at >= _PROGRESS_INTERVAL_S
        if self._callback is None or not is_due or progress == self._reported:
            return
        self._reported, self._reported_at = progress, now
        try:
            self._callback(Progress(*progress))
        except Exception:
            _LOG.exception("the progress callback of a transfer raised an exception")


def _query(
    session: Session,
    key: str,
    payload: bytes,
    timeout: float,
    on_reply: Callable[[zenoh.Reply], object],
    on_end: Callable[[], object],
    target: zenoh.QueryTarget,
) -> None:
    """Sends a query that is reliable and overtaken by all other messages. `on_end` is called after the last reply."""
    try:
        session.zenoh.get(
            key,
            direct(on_reply, on_end),
            payload=payload,
            target=target,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=zenoh.Priority.BACKGROUND,
            congestion_control=zenoh.CongestionControl.BLOCK,
            timeout=timeout,
        )
    except zenoh.ZError as error:
        _LOG.debug("cannot query %s: %s", key, error)


def _ignored(*_: object) -> None:
    pass
