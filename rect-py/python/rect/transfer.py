"""Owns the transfers of a session: what a program sends, and what it takes. What is decided, the core decides.

Each transfer that comes has a thread of its own, since files and a full link make it wait; one that is sent has its
caller's.
"""

from __future__ import annotations

import logging
import os
import random
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, patiently, payload_bytes, refused
from rect.errors import Closed, TimedOut, TransferError, TransferFailed
from rect.inbox import Ended, Inbox
from rect.subscriber import Declared
from rect.values import Payload, payload_of
from rect.waiting import at_once

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")
#: How many requests and answers wait for the thread of a transfer. What has no room is lost, and asked for again.
_WAITING = 256
#: How many programs of a robot are heard about one offer.
_MAX_ANSWERS = 16
#: How many receivers' programs are kept waiting for the end of the transfer.
_MAX_HELD = 16
_OFFERS = 64
#: How often progress is told at most.
_PROGRESS_EVERY_S = 0.1
#: How long nobody looks whether the session was closed.
_LOOK_EVERY_S = 1.0
#: How long a sender may take to learn how a transfer ended.
_ENDED_TIMEOUT_S = 3.0


@dataclass(frozen=True)
class Progress:
    """How much of a transfer the receiver holds."""

    #: What it holds.
    held_bytes: int
    #: Of how many.
    size_bytes: int

    @property
    def fraction(self) -> float:
        """0 to 1; of nothing, all is there."""
        return self.held_bytes / self.size_bytes if self.size_bytes else 1.0


@dataclass(frozen=True)
class Received:
    """A transfer that ended."""

    #: Of whom.
    sender: str
    #: About what.
    topic: str
    #: What its sender calls it; may be empty.
    name: str
    #: What it is.
    encoding: str
    #: How long it is.
    size_bytes: int
    #: Why it is not there, if it is not.
    error: TransferError | None = None
    _content: bytes | Path = field(default=b"", repr=False)

    @property
    def content(self) -> bytes | Path:
        """The bytes, or the path of the file. Raises `error`, if it is not there."""
        if self.error is not None:
            raise self.error
        return self._content

    @property
    def value(self) -> Any:
        """What it says, by its encoding; see `Message.value`. A file is read for it."""
        content = self.content
        return Payload(content.read_bytes() if isinstance(content, Path) else content, self.encoding).value


OnProgress = Callable[[Progress], object]


class Sending:
    """A transfer to a robot, from the checksum to the end."""

    def __init__(
        self,
        session: Session,
        to: str,
        topic: str,
        data: Any,
        *,
        name: str | None,
        patience: float | None,
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
        self._to = to
        self._told = _Told(on_progress)
        call = random.getrandbits(64)
        self._core = patiently(
            lambda: _rect.TransferSender(
                session.place, to, topic, source, call, name=name, encoding=encoding, patience_s=patience
            )
        )
        self._events: SimpleQueue[tuple[str, Any, Any]] = SimpleQueue()
        #: Queries that stay open until the offer of that number has been answered.
        self._held: list[tuple[int, zenoh.Query]] = []

    def stop(self) -> None:
        """Ends it. What is there is kept where it is kept in a file."""
        self._events.put(("stop", None, None))

    def run(self) -> None:
        """Until all is there and right."""
        session, place = self._session, self._session.place
        key = place.own(place.robot, self._core.key)
        session.endings.append(self.stop)
        declared = Declared(session)
        try:
            # It may have closed before it knew of this.
            session.check()
            on_query = direct(lambda query: self._push(("query", query, None)))
            declared.add(session.zenoh.declare_queryable(key, on_query, complete=True))
            self._run(key)
        except zenoh.ZError as error:
            session.check()
            raise refused("the transfer can't be served", error) from None
        finally:
            declared.end()
            session.endings.remove(self.stop)
            self._drain()

    def _run(self, key: str) -> None:
        number, answers = 0, list[bytes]()
        while True:
            self._told.tell(self._core.progress())
            step, seconds = self._core.poll()
            if step == "done":
                self._told.tell(self._core.progress(), last=True)
                return
            if step == "offer":
                number, answers = number + 1, []
                self._offer(number, seconds)
                continue
            try:
                what, about, answer = self._events.get(timeout=at_once(max(seconds, 0)))
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

        # Where nobody is there, Zenoh calls it at once, on this thread: without a word of Python, in which a Ctrl-C
        # would be raised, and lost in Zenoh.
        on_end = partial(self._events.put, ("answered", number, None))
        key = self._session.place.own(self._to, _rect.TRANSFER_INBOX)
        _ask(self._session, key, self._core.offer, timeout, on_reply, on_end, zenoh.QueryTarget.ALL)

    def _serve(self, key: str, query: zenoh.Query) -> None:
        """Answers a request; what is no request gets no answer."""
        answer = self._core.on_request(payload_bytes(query.payload))
        if answer is not None and answer[1] is None and len(self._held) < _MAX_HELD:
            self._held.append((answer[2], query))
            return
        with query:
            if answer is None or answer[1] is None:
                return
            is_right, reply, _ = answer
            try:
                if is_right:
                    query.reply(key, reply)
                else:
                    query.reply_err(reply)
            except zenoh.ZError as error:
                _LOG.debug("a piece was not sent: %s", error)

    def _release(self, number: int | None = None) -> None:
        """Ends the queries that waited for the answers to this offer; `None`: all of them."""
        held, self._held = self._held, []
        for after, query in held:
            if number is not None and after > number:
                self._held.append((after, query))
            else:
                query.drop()

    def _drain(self) -> None:
        """Whoever still asks is told at once that there is no answer."""
        self._release()
        while not self._events.empty():
            what, about, _ = self._events.get()
            if what == "query":
                about.drop()


class Transfers:
    """The transfers that come: an iterator of `Received`, of those that failed too (`error`).

    Closed, it takes no more; what came of those that run is kept where it is kept in files.
    """

    dropped = 0

    def __init__(
        self,
        session: Session,
        pattern: str,
        *,
        folder: str | os.PathLike[str] | None,
        max_bytes: int,
        at_once: int,
        patience: float,
        on_progress: Callable[[Received, Progress], object] | None,
    ) -> None:
        self._session = session
        self._pattern = pattern
        self._taking = _Taking(session, pattern, folder, max_bytes, at_once, patience, on_progress)
        weakref.finalize(self, self._taking.leave).atexit = False

    def next(self, timeout: float | None = None) -> Received:
        """The next one that ended, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        try:
            return self._taking.take(self._taking.ended.pop(timeout))
        except Ended:
            raise self._session.closed_error() from None
        except TimeoutError:
            raise TimedOut(f"transfer {self._pattern}", timeout or 0) from None

    def __iter__(self) -> Iterator[Received]:
        return self

    def __next__(self) -> Received:
        try:
            return self._taking.take(self._taking.ended.pop())
        except Ended:
            raise StopIteration from None

    async def next_async(self, timeout: float | None = None) -> Received:
        """The same for asyncio. Raises `Ended`, `TimeoutError`."""
        return self._taking.take(await self._taking.ended.pop_async(timeout))

    def close(self) -> None:
        """Takes no more."""
        self._taking.stop()

    def __enter__(self) -> Transfers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Transfers({self._pattern})"


class _Taking:
    """The offers that come to a program: the thread that answers them, and those that begin."""

    def __init__(
        self,
        session: Session,
        pattern: str,
        folder: str | os.PathLike[str] | None,
        max_bytes: int,
        at_once: int,
        patience: float,
        on_progress: Callable[[Received, Progress], object] | None,
    ) -> None:
        self.ended: Inbox[Received] = Inbox(at_once, "wait")
        self._session = session
        self._folder = None if folder is None else Path(folder)
        self._patience = patience
        self._on_progress = on_progress
        self._inbox = _rect.Inbox(session.place, pattern, max_bytes, at_once, self._folder)
        self._key = session.place.own(session.place.robot, _rect.TRANSFER_INBOX)
        self._lock = threading.Lock()
        self._running: dict[str, SimpleQueue[tuple[str, int, bytes]]] = {}
        self._is_stopped = False
        #: `offer` with a query, `confirmed` with a question and the reply, `silence` with a question, or `end`.
        self._events: SimpleQueue[tuple[str, Any, bytes]] = SimpleQueue()
        #: Places for what ended and the program has not taken yet.
        self._room = threading.Semaphore(max(at_once, 1))
        session.endings.append(self.stop)
        session.start("rect inbox", self._answer_all)
        self._declared = Declared(session)
        try:
            self._declared.add(session.zenoh.declare_queryable(self._key, direct(self._on_query)))
        except zenoh.ZError as error:
            self.stop()
            raise refused("transfers can't be taken", error) from None

    def stop(self) -> None:
        """Nothing more is taken, and what runs ends."""
        self._end()
        self._declared.end()

    def leave(self) -> None:
        """Nobody has the handle any more."""
        self._end()
        self._declared.leave()

    def _end(self) -> None:
        self._is_stopped = True
        self.ended.close()
        for events in list(self._running.values()):
            events.put(("stop", 0, b""))
        self._events.put(("end", None, b""))

    def take(self, received: Received) -> Received:
        """The program has taken it: there is room for another one."""
        self._room.release()
        return received

    def _on_query(self, query: zenoh.Query) -> None:
        if self._events.qsize() < _OFFERS:
            self._events.put(("offer", query, b""))
        else:
            query.drop()

    def _answer_all(self) -> None:
        while True:
            try:
                what, about, reply = self._events.get(timeout=self._ask_senders())
            except Empty:
                continue
            if what == "offer":
                with about:
                    try:
                        about.reply(self._key, self._on_offer(payload_bytes(about.payload)))
                    except zenoh.ZError as error:
                        _LOG.debug("an offer was not answered: %s", error)
            elif what == "confirmed":
                self._on_confirmed(about, reply)
            elif what == "silence":
                self._inbox.on_silence(about)
            else:
                return

    def _ask_senders(self) -> float | None:
        """Asks the robots that offers name whether they make them. How long there is nothing to do after that."""
        while True:
            question, seconds = self._inbox.poll()
            if question is None:
                return None if seconds is None else at_once(max(seconds, 0))
            self._ask_sender(question)

    def _ask_sender(self, question: _rect.Question) -> None:
        answered: list[bool] = []

        def on_reply(reply: zenoh.Reply) -> None:
            # One question, one answer: more would fill the memory.
            if reply.ok is not None and not answered:
                answered.append(True)
                self._events.put(("confirmed", question, payload_bytes(reply.ok.payload)))

        on_end = partial(self._events.put, ("silence", question, b""))
        key = self._session.place.own(question.robot, question.key)
        target = zenoh.QueryTarget.BEST_MATCHING
        _ask(self._session, key, question.payload, question.timeout, on_reply, on_end, target)

    def _on_offer(self, offer: bytes) -> bytes:
        answer, known = self._inbox.on_offer(offer)
        self._tell_offered(known)
        return answer

    def _on_confirmed(self, question: _rect.Question, reply: bytes) -> None:
        offered, known = self._inbox.on_confirmed(question, reply)
        self._tell_offered(known)
        if offered is None:
            return
        if self._is_stopped:
            self._inbox.on_stopped(offered)
            return
        taken: SimpleQueue[tuple[str, int, bytes]] = SimpleQueue()
        self._running[offered.id] = taken
        self._session.start("rect transfer", lambda: self._pull(offered, taken))

    def _tell_offered(self, id: str | None) -> None:
        events = None if id is None else self._running.get(id)
        if events is not None:
            events.put(("offered", 0, b""))

    def _pull(self, offered: _rect.Offered, events: SimpleQueue[tuple[str, int, bytes]]) -> None:
        about = Received(offered.sender, offered.topic, offered.name, offered.encoding, offered.size_bytes)
        key = self._session.place.own(offered.sender, offered.key)
        pull = _rect.Pull(offered, self._folder, self._patience)
        told = _Told(None)
        if self._on_progress is not None:
            on_progress = self._on_progress
            told = _Told(lambda progress: on_progress(about, progress))
        while True:
            step, ticket, payload, seconds = pull.poll()
            self._inbox.on_held(offered, pull.progress()[0])
            if step == "over":
                break
            if step == "ask" and payload is not None:
                self._ask(key, ticket, payload, seconds, events)
                continue
            self._wait(pull, events, min(max(seconds, 0), _LOOK_EVERY_S))
            told.tell(pull.progress())
        told.tell(pull.progress(), last=True)
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

    def _ask(
        self, key: str, ticket: int, payload: bytes, timeout: float, events: SimpleQueue[tuple[str, int, bytes]]
    ) -> None:
        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                events.put(("reply", ticket, payload_bytes(reply.ok.payload)))
            elif reply.err is not None:
                events.put(("error", ticket, payload_bytes(reply.err.payload)))

        def on_end() -> None:
            events.put(("end", ticket, b""))

        # What comes late is of use, too.
        _ask(self._session, key, payload, timeout * 2, on_reply, on_end, zenoh.QueryTarget.BEST_MATCHING)

    def _over(self, offered: _rect.Offered, pull: _rect.Pull, about: Received, key: str) -> None:
        # Only what the program has, or will have, is done. It may be slow: then this waits, and a place stays taken.
        has_room = not pull.is_stopped and self._wait_for_room()
        self._inbox.on_ended(offered, pull, has_room or pull.is_stopped)
        self._running.pop(offered.id, None)
        # First the sender: the program may exit as soon as it has been told.
        if not self._session.is_closed:
            known = threading.Event()
            ended = _rect.transfer_ended()
            _ask(self._session, key, ended, _ENDED_TIMEOUT_S, _ignored, known.set, zenoh.QueryTarget.BEST_MATCHING)
            known.wait(_ENDED_TIMEOUT_S)
        if has_room:
            self.ended.push(_received(about, pull))

    def _wait_for_room(self) -> bool:
        """Waits until the program can take one more; `False`: it takes nothing any more."""
        while not self._is_stopped:
            if self._room.acquire(timeout=_LOOK_EVERY_S):
                return True
        return False


def _received(about: Received, pull: _rect.Pull) -> Received:
    known = (about.sender, about.topic, about.name, about.encoding, about.size_bytes)
    try:
        content = pull.content()
    except TransferFailed as error:
        return Received(*known, error)
    return Received(*known, None, Path(content) if isinstance(content, str) else content)


class _Told:
    """Tells progress: each news once, and not too often."""

    def __init__(self, callback: OnProgress | None) -> None:
        self._callback = callback
        self._told: tuple[int, int] | None = None
        self._at = 0.0

    def tell(self, progress: tuple[int, int], last: bool = False) -> None:
        now = time.monotonic()
        due = self._told is None or last or now - self._at >= _PROGRESS_EVERY_S
        if self._callback is None or not due or progress == self._told:
            return
        self._told, self._at = progress, now
        try:
            self._callback(Progress(*progress))
        except Exception:
            _LOG.exception("the callback for a transfer's progress raised")


def _ask(
    session: Session,
    key: str,
    payload: bytes,
    timeout: float,
    on_reply: Callable[[zenoh.Reply], object],
    on_end: Callable[[], object],
    target: zenoh.QueryTarget,
) -> None:
    """Asks, in no hurry, and dropped nowhere. `on_end` is called once, after the last reply."""
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
        _LOG.debug("%s can't be asked: %s", key, error)


def _ignored(*_: object) -> None:
    pass
