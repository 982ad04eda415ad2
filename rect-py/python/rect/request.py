"""Requests from a program to services, and their replies."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic

import zenoh

from rect import _rect
from rect._zenoh import direct, get_arguments, zenoh_error
from rect.errors import Interrupted, RectError, ServiceError, TimedOut, ZenohError
from rect.receive_queue import Ended, ReceiveQueue
from rect.typed import Converter, T
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session


@dataclass(frozen=True)
class Reply(Generic[T]):
    """A reply to a request. `Reply[Pose]` has a `value` of the type `Pose`."""

    #: Name of the robot that replied.
    sender: str
    #: The payload: bytes with an encoding.
    payload: Payload
    _converter: Converter[T] | None = field(default=None, repr=False, compare=False)

    @property
    def value(self) -> T:
        """The decoded payload, as the type that the request states (`returns`); see `Message.value`.

        Raises `PayloadError` if the bytes do not match the encoding, and `MismatchError` if the value does not fit the
        type.
        """
        value: T = self.payload.value
        return value if self._converter is None else self._converter.convert(value)


class Replies(Generic[T]):
    """Iterates over the replies to one request as they arrive. Returned by `Robot.request_all`.

    The iteration ends when all services have replied. Each step raises `ServiceError` if a service replied with an
    error (the iteration can be continued after that), `PayloadError` if a reply cannot be decoded, `TimedOut` after the
    timeout, and `Closed` if the robot is closed. Closing this object cancels the request.
    """

    def __init__(
        self,
        session: Session,
        robot: str | None,
        topic: str,
        payload: Payload,
        urgency: str,
        timeout: float,
        converter: Converter[T] | None,
    ) -> None:
        self._session = session
        self._converter = converter
        self._asked = robot, topic
        self._inquiry = _rect.Inquiry(session.key_space, robot, topic, timeout, session.program.request_ids)
        self._timeout = timeout
        self._deadline = time.monotonic() + timeout
        self._queue: ReceiveQueue[zenoh.Reply] = ReceiveQueue(_rect.MAX_REPLIES, "block")
        self._cancellation = zenoh.CancellationToken()
        session.receive_queues.add(self._queue)
        _, _, *query = self._inquiry.get(payload.bytes, payload.encoding, urgency)
        selector, arguments = get_arguments(*query)
        querier = session.querier(urgency, selector)
        self._served = querier.served
        unsent = self._served.unsent()
        try:
            with session.calls:
                session.urgency_sessions.of(urgency).get(
                    selector,
                    # Zenoh drops the callback after the last reply.
                    direct(self._queue.queue, self._queue.queue.end),
                    cancellation_token=self._cancellation,
                    **arguments,
                )
        except zenoh.ZError as error:
            raise zenoh_error("cannot send the request", error) from error
        self._sent = unsent.taken(self._queue.queue.is_finished_here, querier.is_served)

    def __iter__(self) -> Iterator[Reply[T]]:
        return self

    def __next__(self) -> Reply[T]:
        try:
            reply = self._queue.pop(self._remaining())
        except Ended:
            self._check_closed()
            raise StopIteration from None
        except TimeoutError:
            raise self.timed_out() from None
        return self._reply(reply)

    async def next_async(self) -> Reply[T] | None:
        """Waits for the next reply with asyncio; returns `None` after the last one."""
        try:
            reply = await self._queue.pop_async(self._remaining())
        except Ended:
            self._check_closed()
            return None
        except TimeoutError:
            raise self.timed_out() from None
        return self._reply(reply)

    def interrupted(self) -> Interrupted | None:
        """Returns the error if the request has ended without a reply, and may have been carried out by the robot."""
        robot, topic = self._asked
        if robot is not None and self._served.is_interrupted(self._sent):
            return Interrupted(robot, topic)
        return None

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
            with self._session.calls:
                self._cancellation.cancel()

    def __enter__(self) -> Replies[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Replies({self._inquiry.expected})"

    def _remaining(self) -> float:
        return max(self._deadline - time.monotonic(), 0)

    def _check_closed(self) -> None:
        if self._session.is_closed:
            raise self._session.closed_error()

    def timed_out(self) -> TimedOut:
        self._queue.close()
        return TimedOut(self._inquiry.expected, self._timeout)

    def _reply(self, reply: zenoh.Reply) -> Reply[T]:
        kind, robot, payload = self._inquiry.on_reply(reply)
        if kind == "answer" and robot is not None:
            return Reply(robot, self._session.decoder.payload(robot, Payload(*payload)), self._converter)
        if kind == "error":
            raise service_error(robot, Payload(*payload))
        if kind == "timed_out":
            raise self.timed_out()
        raise ZenohError("the reply has no valid key of a robot", f"its key is {robot!r}")


def service_error(robot: str | None, payload: Payload) -> ServiceError:
    """Makes a `ServiceError` from the payload of an error reply."""
    try:
        value = payload.value
    except RectError:
        value = payload.bytes
    return ServiceError(robot, value, payload.bytes.decode(errors="replace"))
