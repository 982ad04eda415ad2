"""Owns asking a service, and its answers."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, qos, refused
from rect.errors import RectError, ServiceError, TimedOut, ZenohError
from rect.inbox import Ended, Inbox
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

#: How many answers wait for the program; a service that sends more waits.
_REPLIES = 64
#: Zenoh's own, when the time is over.
_TIMEOUT = b"Timeout"


@dataclass(frozen=True)
class Reply:
    """An answer."""

    #: Who answers.
    sender: str
    #: What it says, as bytes with an encoding.
    payload: Payload

    @property
    def value(self) -> Any:
        """What it says; see `Message.value`."""
        return self.payload.value

    @property
    def from_(self) -> str:
        """Who answers; `from` is a word of Python's own."""
        return self.sender


class Replies:
    """The answers to one request, as they come: an iterator that waits for the next. Closing it cancels the request.

    An error of a service is raised by the `next` that would have given its answer; the one after goes on.
    """

    def __init__(
        self, session: Session, robot: str | None, topic: str, payload: Payload, urgency: str, timeout: float
    ) -> None:
        self._session = session
        self._robot = robot
        self._what = f"answer about {topic}"
        self._timeout = timeout
        self._deadline = time.monotonic() + timeout
        self._inbox: Inbox[zenoh.Reply] = Inbox(_REPLIES, "wait")
        self._cancellation = zenoh.CancellationToken()
        asking = _rect.write_asking(session.place.robot, min(int(timeout * 1000), 2**32 - 1))
        session.inboxes.add(self._inbox)
        try:
            session.lanes.of(urgency).get(
                session.place.service(robot, topic),
                # Zenoh drops the callback when the last answer has come.
                direct(self._inbox.queue, self._inbox.queue.end),
                payload=payload.bytes,
                encoding=payload.encoding,
                attachment=asking,
                timeout=timeout,
                cancellation_token=self._cancellation,
                **_asked(urgency),
            )
        except zenoh.ZError as error:
            raise refused("the request is not sent", error) from None

    def __iter__(self) -> Iterator[Reply]:
        return self

    def __next__(self) -> Reply:
        try:
            reply = self._inbox.pop(self._left())
        except Ended:
            self._check_closed()
            raise StopIteration from None
        except TimeoutError:
            raise self.timed_out() from None
        return self._reply(reply)

    async def next_async(self) -> Reply | None:
        """The next answer, for asyncio; `None`: there are no more."""
        try:
            reply = await self._inbox.pop_async(self._left())
        except Ended:
            self._check_closed()
            return None
        except TimeoutError:
            raise self.timed_out() from None
        return self._reply(reply)

    def leave(self) -> None:
        """No more answers are taken; what still runs of the request is cancelled a little later, if it does then."""
        self._inbox.close()
        self._session.inboxes.discard(self._inbox)
        if not self._inbox.queue.is_over:
            self._session.left.append(self)

    def end(self) -> None:
        """As `close`."""
        self.close()

    def close(self) -> None:
        """Cancels the request, if it has not ended."""
        self._inbox.close()
        self._session.inboxes.discard(self._inbox)
        if not self._inbox.queue.is_over and not self._session.is_closed:
            # Waits for a callback that is running, which, once the inbox is closed, waits for nobody.
            self._cancellation.cancel()

    def __enter__(self) -> Replies:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Replies({self._what})"

    def _left(self) -> float:
        return max(self._deadline - time.monotonic(), 0)

    def _check_closed(self) -> None:
        if self._session.is_closed:
            raise self._session.closed_error()

    def timed_out(self) -> TimedOut:
        self._inbox.close()
        return TimedOut(self._what, self._timeout)

    def _reply(self, reply: zenoh.Reply) -> Reply:
        if reply.ok is None:
            raise self._error(reply)
        key = str(reply.ok.key_expr)
        address = self._session.place.address(key)
        if address is None:
            raise ZenohError("the answer is none of a robot", f"its key is {key!r}")
        sender = address[0]
        payload = Payload(payload_bytes(reply.ok.payload), str(reply.ok.encoding))
        return Reply(sender, self._session.decoder.payload(sender, payload))

    def _error(self, reply: zenoh.Reply) -> RectError:
        answer = reply.err
        if answer is None:
            return ZenohError("the answer is neither an answer nor an error", repr(reply))
        robot, encoding = _rect.error_from(str(answer.encoding))
        payload = Payload(payload_bytes(answer.payload), encoding)
        if robot is None and payload.bytes == _TIMEOUT:
            return self.timed_out()
        # Only the robot that was asked can answer, whatever name the answer has.
        return service_error(None if robot is None else self._robot or robot, payload)


@lru_cache
def _asked(urgency: str) -> dict[str, Any]:
    """How Zenoh is to treat a request of that urgency."""
    treated = qos(_rect.qos(urgency))
    del treated["congestion_control"]
    return {**treated, "target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}


def service_error(robot: str | None, payload: Payload) -> ServiceError:
    """An error that came as an answer."""
    try:
        value = payload.value
    except RectError:
        value = payload.bytes
    return ServiceError(robot, value, payload.bytes.decode(errors="replace"))
