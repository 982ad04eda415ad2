"""Owns receiving: the messages of a pattern, one after another, for a callback, or just the next one."""

from __future__ import annotations

import logging
import threading
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar, Union

import zenoh

from rect import _rect
from rect._zenoh import direct, refused
from rect.errors import CodecError, TimedOut
from rect.inbox import Ended, Inbox
from rect.message import Message
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

T = TypeVar("T")
#: What a message says of itself, its payload, its encoding, and by what it came, where that is known.
_Heard = tuple[_rect.Said, bytes, str, Union[str, None]]
_LOG = logging.getLogger("rect")


@dataclass(frozen=True)
class Tally:
    """What arrived of one robot."""

    #: Messages that arrived.
    received: int
    #: Messages that did not, by their numbers.
    missed: int


class Subscriber:
    """The messages of a pattern, as they come: an iterator that waits for the next, and ends when the session is
    closed.

    It ends when it is closed, when its `with` ends, or when nobody has it any more.
    """

    def __init__(self, session: Session, pattern: str, capacity: int, when_full: str) -> None:
        self._session = session
        self._pattern = pattern
        self._inbox: Inbox[_Heard] = Inbox(capacity, when_full)
        self._inbound = _rect.Inbound(session.place)
        keys = session.place.subscriptions(pattern)
        links = None if session.known is None else session.known.links
        self._declared = Declared(session, self._inbox)
        for key, directed in zip(keys, (False, True)):
            heard = _rect.OnMessage(self._inbox.queue, self._inbound, session.counting, links, directed)
            try:
                self._declared.add(session.zenoh.declare_subscriber(key, direct(heard)))
            except zenoh.ZError as error:
                self._declared.end()
                raise refused("the subscription is refused", error) from None
        weakref.finalize(self, self._declared.leave).atexit = False

    def next(self, timeout: float | None = None) -> Message:
        """The next message, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        try:
            return self._unpacked(as_it_came(self._inbox.pop(timeout)))
        except Ended:
            raise self._session.closed_error() from None
        except TimeoutError:
            raise TimedOut(f"message {self._pattern}", timeout or 0) from None

    def __iter__(self) -> Iterator[Message]:
        return self

    def __next__(self) -> Message:
        try:
            return self._unpacked(as_it_came(self._inbox.pop()))
        except Ended:
            raise StopIteration from None

    @property
    def dropped(self) -> int:
        """How many were dropped because the program did not take them in time."""
        return self._inbox.dropped

    @property
    def tallies(self) -> dict[str, Tally]:
        """How many came of each robot, and how many of its did not."""
        return {robot: Tally(received, missed) for robot, received, missed in self._inbound.tallies()}

    def close(self) -> None:
        """Ends it."""
        self._declared.end()

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Subscriber({self._pattern}, dropped={self.dropped})"

    def _unpacked(self, message: Message) -> Message:
        """The message as it was said. What can't be undone stays as it came, with what is wrong with it."""
        try:
            message.payload = self._session.decoder.payload(message.sender, message.payload)
        except CodecError as flaw:
            message.flaw = flaw
        return message


def as_it_came(heard: _Heard) -> Message:
    """The message, still packed."""
    said, payload, encoding, over = heard
    return Message(said, Payload(payload, encoding), over)


class Declared:
    """What is declared at Zenoh for one handle, and the inbox that it fills; ends once."""

    def __init__(self, session: Session, inbox: Inbox[Any] | None = None) -> None:
        self._session = session
        self._inbox = inbox
        self._declared: list[Any] = []
        session.handles.add(self)

    def add(self, declared: Any) -> None:
        self._declared.append(declared)

    def end(self) -> None:
        """Nothing more comes; what waits can still be taken."""
        # First, since one of Zenoh's threads may wait for room.
        if self._inbox is not None:
            self._inbox.close()
        self._session.handles.discard(self)
        declared, self._declared = self._declared, []
        for one in declared:
            if not self._session.is_closed:
                undeclared(one)

    def on_fork(self) -> None:
        """In a child process: what is declared belongs to the parent's threads."""
        for one in self._declared:
            _rect.forget(one)
        if self._inbox is not None:
            self._inbox.on_fork()

    def leave(self) -> None:
        """Nobody has the handle any more. Called where nothing may wait: the session ends it a little later."""
        if self._inbox is not None:
            self._inbox.close()
        self._session.left.append(self)


def undeclared(declared: Any) -> None:
    """Ends what is declared; when it has ended already, that is as good."""
    try:
        declared.undeclare()
    except zenoh.ZError as error:
        _LOG.debug("it had ended already: %s", error)


class Subscription(Generic[T]):
    """A callback that is called for each of what comes, one after another, until this is closed, or the robot is.

    A callback that raises is reported (`logging.getLogger("rect")`), and called again for the next.
    """

    def __init__(self, source: Any, callback: Callable[[T], object], about: str) -> None:
        self._source = source
        self._about = about
        self._callback = callback
        self._thread = threading.Thread(target=self._run, name=f"rect {about}", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """How many were dropped because the callback was not done in time."""
        return int(self._source.dropped)

    @property
    def tallies(self) -> dict[str, Tally]:
        """How many came of each robot, and how many of its did not."""
        tallies: dict[str, Tally] = self._source.tallies
        return tallies

    def close(self) -> None:
        """Ends it. A call that runs is not waited for."""
        self._source.close()

    def __enter__(self) -> Subscription[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Subscription({self._about})"

    def _run(self) -> None:
        for what in self._source:
            try:
                self._callback(what)
            except BaseException:
                # `sys.exit` too: on a thread it would end nothing but the callback, and without a word.
                _LOG.exception("the callback for %s raised", self._about)


def callable_or_none(callback: object) -> None:
    """Raises unless it can be called."""
    if callback is not None and not callable(callback):
        raise TypeError(f"callback is a function, not a {type(callback).__name__}")
