"""Owns serving: the requests that come to a service of this program, and their answers."""

from __future__ import annotations

import inspect
import logging
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, refused
from rect.errors import CodecError, RectError
from rect.inbox import Ended, Inbox
from rect.subscriber import Declared
from rect.values import Payload, payload_of

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")
#: How many requests wait for the program; more are answered with an error at once.
_WAITING = 256
#: How many are worked on at a time.
AT_A_TIME = 16


class Refusal(Exception):
    """Raised by a handler: the asker gets the value as the error, and nothing is logged here."""

    def __init__(self, value: Any) -> None:
        super().__init__(value)
        self.value = value


class Request:
    """A request. Closed without an answer it tells the asker that there is none."""

    __slots__ = ("_key", "_me", "_query", "deadline", "payload", "sender")

    def __init__(self, query: zenoh.Query, me: str, key: str, ago: float = 0) -> None:
        attachment = query.attachment
        asking = None if attachment is None else _rect.read_asking(attachment.to_bytes())
        sender, timeout_ms = asking or (None, _rect.DEFAULT_TIMEOUT_MS)
        encoding = query.encoding
        self._query = query
        self._me = me
        self._key = key
        #: Who asks, as the program says of itself; `None`: a stock program, which does not say. Zenoh does not verify
        #: it: do not let permissions depend on it.
        self.sender = sender
        #: What is asked, as bytes with an encoding.
        self.payload = Payload(payload_bytes(query.payload), "zenoh/bytes" if encoding is None else str(encoding))
        #: Until when an answer is of use, by `time.monotonic()`.
        self.deadline = time.monotonic() - ago + timeout_ms / 1000

    @property
    def value(self) -> Any:
        """What is asked; see `Message.value`."""
        return self.payload.value

    @property
    def from_(self) -> str | None:
        """Who asks; `from` is a word of Python's own."""
        return self.sender

    @property
    def topic(self) -> str:
        """Which service is asked."""
        return self._key.split("/", 2)[2]

    @property
    def remaining(self) -> float:
        """How long an answer is of use still, in seconds."""
        return max(self.deadline - time.monotonic(), 0)

    def reply(self, value: Any) -> None:
        """Answers; several answers are several calls. Raises `PayloadError`, `ZenohError`."""
        payload = payload_of(value)
        try:
            self._query.reply(self._key, payload.bytes, encoding=payload.encoding)
        except zenoh.ZError as error:
            raise refused("the answer is not sent", error) from None

    def refuse(self, error: Any) -> None:
        """Answers with an error, which the asker gets as `ServiceError`."""
        payload = payload_of(error)
        encoding = _rect.error_encoding(self._me, payload.encoding)
        try:
            self._query.reply_err(payload.bytes, encoding=encoding)
        except zenoh.ZError as refusal:
            raise refused("the answer is not sent", refusal) from None

    def close(self) -> None:
        """No more answers come."""
        self._query.drop()

    def refuse_for(self, error: BaseException) -> None:
        """Answers with what a handler raised."""
        if isinstance(error, Refusal):
            self.refuse(error.value)
            return
        if not isinstance(error, RectError):
            _LOG.error("the service %s raised", self.topic, exc_info=error)
        self.refuse(shown(error))

    def __repr__(self) -> str:
        return f"Request({self.sender}, {self.topic})"


class Requests:
    """The requests to a service, as they come."""

    def __init__(self, session: Session, topic: str) -> None:
        self._session = session
        self._inbox: Inbox[tuple[zenoh.Query, _rect.Moment]] = Inbox(_WAITING, "oldest wins")
        self._key = session.place.publication(topic)
        on_request = _rect.OnRequest(self._inbox.queue, _busy(session.place.robot, self._key))
        self._declared = Declared(session, self._inbox)
        try:
            self._declared.add(session.zenoh.declare_queryable(self._key, direct(on_request), complete=True))
        except zenoh.ZError as error:
            self._declared.end()
            raise refused("the service is refused", error) from None

    def next(self) -> Request:
        """The next request that is of use. Raises `Ended`."""
        while True:
            request = self._request(*self._inbox.pop())
            if self._is_of_use(request):
                return request

    async def next_async(self) -> Request:
        """The same for asyncio."""
        while True:
            request = self._request(*await self._inbox.pop_async())
            if self._is_of_use(request):
                return request

    def _request(self, query: zenoh.Query, came: _rect.Moment) -> Request:
        return Request(query, self._session.place.robot, self._key, came.ago())

    def _is_of_use(self, request: Request) -> bool:
        """Unpacks it; one that can't be unpacked is answered with that error, and one too late is left."""
        if request.remaining == 0:
            request.close()
            return False
        try:
            sender = request.sender or self._session.place.robot
            request.payload = self._session.decoder.payload(sender, request.payload)
        except CodecError as error:
            request.refuse(str(error))
            request.close()
            return False
        return True

    def close(self) -> None:
        self._declared.end()


class Service:
    """A service that answers by a function, until this is closed, or the robot is. Up to 16 requests at a time."""

    def __init__(self, session: Session, topic: str, handler: Callable[[Request], Any]) -> None:
        self._topic = topic
        self._handler = handler
        self._lock = threading.Lock()
        self._workers = 0
        self._idle = 0
        self._requests = Requests(session, topic)
        self._see_to_the_next()

    def close(self) -> None:
        """Ends it. What is worked on is still answered."""
        self._requests.close()

    def __enter__(self) -> Service:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, request: Request) -> Any:
        """The function itself, so that what `@robot.serve` decorates stays one."""
        return self._handler(request)

    def __repr__(self) -> str:
        return f"Service({self._topic})"

    def _see_to_the_next(self) -> None:
        """Somebody waits for the next request, unless all that may work do."""
        with self._lock:
            if self._idle or self._workers >= AT_A_TIME:
                return
            self._idle += 1
            self._workers += 1
        threading.Thread(target=self._work, name=f"rect {self._topic}", daemon=True).start()

    def _work(self) -> None:
        while True:
            try:
                request = self._requests.next()
            except Ended:
                return
            with self._lock:
                self._idle -= 1
            self._see_to_the_next()
            answer(request, self._handler)
            with self._lock:
                self._idle += 1


def shown(error: BaseException) -> str:
    """What an asker is told of what a handler raised."""
    if isinstance(error, SystemExit):
        return f"the service called sys.exit({'' if error.code is None else repr(error.code)})"
    return str(error) or type(error).__name__


def _busy(me: str, key: str) -> Callable[[zenoh.Query], None]:
    def refuse(query: zenoh.Query) -> None:
        request = Request(query, me, key)
        request.refuse(f"{_WAITING} requests wait already: ask later")
        request.close()

    return refuse


def answer(request: Request, handler: Callable[[Request], Any]) -> None:
    """Answers by what the handler returns, yields or raises."""
    try:
        try:
            said = handler(request)
            if inspect.isgenerator(said):
                for one in said:
                    request.reply(one)
            else:
                request.reply(said)
        except BaseException as error:
            # `sys.exit` too: it would end this thread alone, and the requester would be told that nobody serves.
            request.refuse_for(error)
    except Exception as error:
        _LOG.warning("an answer was not sent: %s", error)
    finally:
        request.close()
