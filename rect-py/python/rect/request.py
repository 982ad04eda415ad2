"""Requests from a program to services, and their replies."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, qos, zenoh_error
from rect.errors import RectError, ServiceError, TimedOut, ZenohError
from rect.receive_queue import Ended, ReceiveQueue
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

#: Number of replies that may wait for the program. A service that sends more is blocked.
_REPLIES = 64
#: Payload of the error that Zenoh itself sends when a request times out.
ZENOH_TIMEOUT = b"Timeout"


@dataclass(frozen=True)
class Reply:
    """A reply to a request."""

    #: Name of the robot that replied.
    sender: str
    #: The payload: bytes with an encoding.
    payload: Payload

    @property
    def value(self) -> Any:
        """The decoded payload; see `Message.value`."""
        return self.payload.value


class Replies:
    """Iterates over the replies to one request as they arrive. Returned by `Robot.request_all`.

    The iteration ends when all services have replied. Each step raises `ServiceError` if a service replied with an
    error (the iteration can be continued after that), `PayloadError` if a reply cannot be decoded, `TimedOut` after the
    timeout, and `Closed` if the robot is closed. Closing this object cancels the request.
    """

    def __init__(
        self, session: Session, robot: str | None, topic: str, payload: Payload, urgency: str, timeout: float
    ) -> None:
        self._session = session
        self._robot = robot
        self._expected = f"reply about {topic}"
        self._timeout = timeout
        self._deadline = time.monotonic() + timeout
        self._queue: ReceiveQueue[zenoh.Reply] = ReceiveQueue(_REPLIES, "block")
        self._cancellation = zenoh.CancellationToken()
        header = _rect.write_request_header(session.key_space.robot, min(int(timeout * 1000), 2**32 - 1))
        session.receive_queues.add(self._queue)
        try:
            session.urgency_sessions.of(urgency).get(
                session.key_space.service(robot, topic),
                # Zenoh drops the callback after the last reply.
                direct(self._queue.queue, self._queue.queue.end),
                payload=payload.bytes,
                encoding=payload.encoding,
                attachment=header,
                timeout=timeout,
                cancellation_token=self._cancellation,
                **_get_arguments(urgency),
            )
        except zenoh.ZError as error:
            raise zenoh_error("cannot send the request", error) from None

    def __iter__(self) -> Iterator[Reply]:
        return self

    def __next__(self) -> Reply:
        try:
            reply = self._queue.pop(self._remaining())
        except Ended:
            self._check_closed()
            raise StopIteration from None
        except TimeoutError:
            raise self.timed_out() from None
        return self._reply(reply)

    async def next_async(self) -> Reply | None:
        """Waits for the next reply with asyncio; returns `None` after the last one."""
        try:
            reply = await self._queue.pop_async(self._remaining())
        except Ended:
            self._check_closed()
            return None
        except TimeoutError:
            raise self.timed_out() from None
        return self._reply(reply)

    def leave(self) -> None:
        """Ignores further replies. If the request has not ended, it is cancelled later, without blocking now."""
        self._queue.close()
        self._session.receive_queues.discard(self._queue)
        if not self._queue.queue.is_finished:
            self._session.abandoned.append(self)

    def end(self) -> None:
        """Does the same as `close`."""
        self.close()

    def close(self) -> None:
        """Cancels the request if it has not ended."""
        self._queue.close()
        self._session.receive_queues.discard(self._queue)
        if not self._queue.queue.is_finished and not self._session.is_closed:
            # This waits for a running callback; since the queue is closed, that callback does not block.
            self._cancellation.cancel()

    def __enter__(self) -> Replies:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Replies({self._expected})"

    def _remaining(self) -> float:
        return max(self._deadline - time.monotonic(), 0)

    def _check_closed(self) -> None:
        if self._session.is_closed:
            raise self._session.closed_error()

    def timed_out(self) -> TimedOut:
        self._queue.close()
        return TimedOut(self._expected, self._timeout)

    def _reply(self, reply: zenoh.Reply) -> Reply:
        if reply.ok is None:
            raise self._error(reply)
        key = str(reply.ok.key_expr)
        address = self._session.key_space.address(key)
        if address is None:
            raise ZenohError("the reply does not come from a robot", f"its key is {key!r}")
        sender = address[0]
        payload = Payload(payload_bytes(reply.ok.payload), str(reply.ok.encoding))
        return Reply(sender, self._session.decoder.payload(sender, payload))

    def _error(self, reply: zenoh.Reply) -> RectError:
        error = reply.err
        if error is None:
            return ZenohError("the reply is neither a value nor an error", repr(reply))
        robot, encoding = _rect.error_from(str(error.encoding))
        payload = Payload(payload_bytes(error.payload), encoding)
        if robot is None and payload.bytes == ZENOH_TIMEOUT:
            return self.timed_out()
        # Only the requested robot can reply, so the name in the reply is not trusted.
        return service_error(None if robot is None else self._robot or robot, payload)


@lru_cache
def _get_arguments(urgency: str) -> dict[str, Any]:
    """Returns the arguments of Zenoh's `get` for a request of that urgency."""
    arguments = qos(_rect.qos(urgency))
    del arguments["congestion_control"]
    return {**arguments, "target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}


def service_error(robot: str | None, payload: Payload) -> ServiceError:
    """Makes a `ServiceError` from the payload of an error reply."""
    try:
        value = payload.value
    except RectError:
        value = payload.bytes
    return ServiceError(robot, value, payload.bytes.decode(errors="replace"))
