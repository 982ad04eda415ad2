"""Requests from a program to services, and their replies."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Generic

import zenoh

from rect import _rect, registry
from rect._zenoh import direct, get_arguments, zenoh_error
from rect.errors import Closed, Interrupted, NoService, RectError, TimedOut, ZenohError
from rect.executor import Executor
from rect.receive_queue import Ended, ReceiveQueue
from rect.reply import Gathered, Received, Reply, outcomes_of, service_error
from rect.typed import Converter, T
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session


class Replies(Generic[T]):
    """Iterates over the replies to one request. Returned by `Robot.request_all` and `Robot.request_stream`.

    The iteration ends when all services have replied. Each step raises `ServiceError` if a service replied with an
    error (the iteration can be continued after that), `PayloadError` if a reply cannot be decoded, `TimedOut` after the
    timeout, `Interrupted` if a stream ended before its last reply, and `Closed` if the robot is closed. Closing this
    object cancels the request.
    """

    def __init__(
        self,
        session: Session,
        robot: str | None,
        topic: str | _rect.InternalTopic,
        payload: Payload,
        urgency: str,
        timeout: float,
        converter: Converter[T] | None,
        is_stream: bool = False,
    ) -> None:
        self._session = session
        self._converter = converter
        #: The robot that was asked (`None` if all were), and the topic.
        self.asked = robot, str(topic)
        self._is_end_reported = False
        self._inquiry = _rect.Inquiry(session.key_space, robot, topic, timeout, session.program.request_ids, is_stream)
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
        reply = self._reply(self.received())
        if reply is None:
            self._check_end(self._peers)
            raise StopIteration
        return reply

    async def next_async(self) -> Reply[T] | None:
        """Waits for the next reply with asyncio; returns `None` after the last one."""
        reply = self._reply(await self.received_async())
        if reply is None and not self._is_complete():
            peers = await asyncio.to_thread(self._peers)
            self._check_end(lambda: peers)
        return reply

    def received(self) -> Received[T] | None:
        """Waits for the next reply or error; returns `None` after the last one. Raises `TimedOut` and `Closed`."""
        while True:
            try:
                arrived = self._queue.pop(self._remaining())
            except (Ended, TimeoutError) as end:
                self._on_end(end)
                return None
            received = self._received(arrived)
            if received is not None:
                return received

    async def received_async(self) -> Received[T] | None:
        """Does the same as `received`, for asyncio."""
        while True:
            try:
                arrived = await self._queue.pop_async(self._remaining())
            except (Ended, TimeoutError) as end:
                self._on_end(end)
                return None
            received = self._received(arrived)
            if received is not None:
                return received

    def unanswered(self, peers: Callable[[], list[str]]) -> Interrupted | NoService:
        """Returns why the request ended without a reply, or without all replies of a stream."""
        robot, topic = self.asked
        if self._inquiry.is_started or self._served.is_interrupted(self._sent):
            return Interrupted(robot, topic)
        return NoService(robot, topic, peers())

    def _peers(self) -> list[str]:
        return registry.peers(self._session)

    def _is_complete(self) -> bool:
        return self._is_end_reported or self._inquiry.is_complete

    def _check_end(self, peers: Callable[[], list[str]]) -> None:
        """Raises the error of a stream that is not complete, once."""
        if not self._is_complete():
            self._is_end_reported = True
            raise self.unanswered(peers)

    def gather(self) -> Gathered[T]:
        """Waits until all robots have replied that serve the topic, or the time is up. Returns their outcomes.

        An error of one robot does not end the wait. The robots that serve the topic are those whose catalogue lists it
        when this method is called. A missing one has the error `TimedOut`, or `Interrupted` if its program, a router or
        the link ended.

        Raises `NoService` if no program of the fleet serves the topic, `Interrupted` if nobody replied and a program
        has begun, ended or changed its services meanwhile, so that one may have carried the request out, `TimedOut` if
        nobody has replied in time that a catalogue lists, and `Closed`.
        """
        return self._gathered(self._serving(), *self._all())

    async def gather_async(self) -> Gathered[T]:
        """Does the same as `gather`, for asyncio."""
        serving = await asyncio.to_thread(self._serving)
        received: list[Received[T]] = []
        timed_out = None
        try:
            while (one := await self.received_async()) is not None:
                received.append(one)
        except TimedOut as error:
            timed_out = error
        return await asyncio.to_thread(self._gathered, serving, received, timed_out)

    def _all(self) -> tuple[list[Received[T]], TimedOut | None]:
        """Waits for all replies and errors."""
        received: list[Received[T]] = []
        try:
            while (one := self.received()) is not None:
                received.append(one)
        except TimedOut as error:
            return received, error
        return received, None

    def _serving(self) -> _rect.Servers:
        """Returns the robots whose catalogue lists the topic. The replies wait meanwhile."""
        return registry.servers(self._session, self.asked[1])

    def _gathered(self, serving: _rect.Servers, received: list[Received[T]], timed_out: TimedOut | None) -> Gathered[T]:
        topic = self.asked[1]
        gathered = outcomes_of(topic, set(serving.robots), received, timed_out)
        if gathered.outcomes:
            return gathered
        if timed_out is not None:
            raise timed_out
        # A program that served the topic may have ended, whose token ends a moment later.
        if registry.servers(self._session, topic, has_ended=True) == serving:
            raise NoService(None, topic, self._peers())
        raise Interrupted(None, topic)

    def leave(self) -> None:
        """Ignores further replies. If there was none, the request is cancelled later, without blocking now."""
        self._queue.close()
        self._session.receive_queues.discard(self._queue)
        # A request that has a reply ends by itself.
        if not self._queue.queue.is_finished and not self._inquiry.is_started:
            announce_close(self._session, self._inquiry)
            self._session.abandoned.append(self)

    def end(self) -> None:
        """Does the same as `close`."""
        self.close()

    def close(self) -> None:
        """Cancels the request if it has not ended."""
        self._queue.close()
        self._session.receive_queues.discard(self._queue)
        if not self._queue.queue.is_finished and not self._session.is_closed:
            announce_close(self._session, self._inquiry)
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

    def _on_end(self, end: Exception) -> None:
        """Handles that no reply follows. Raises `TimedOut` and `Closed`."""
        if isinstance(end, TimeoutError):
            raise self.timed_out() from None
        if self._session.is_closed:
            raise self._session.closed_error() from None

    def timed_out(self) -> TimedOut:
        self._queue.close()
        return TimedOut(self._inquiry.expected, self._timeout)

    def _reply(self, received: Received[T] | None) -> Reply[T] | None:
        reply = None if received is None else received[1]
        if isinstance(reply, RectError):
            raise reply
        return reply

    def _received(self, reply: zenoh.Reply) -> Received[T] | None:
        """Returns the meaning of what has arrived; `None` for the mark of a stream's end. Raises `TimedOut`."""
        meaning = self._inquiry.on_reply(reply)
        if meaning is None:
            return None
        kind, robot, payload, is_shared = meaning
        if kind == "timed_out":
            raise self.timed_out()
        return received_of(self._session, self._converter, kind, robot, Payload(*payload), is_shared)


class RetriedRequest(Generic[T]):
    """A request to one robot that is repeated until there is a reply, and is carried out at most once."""

    def __init__(
        self,
        session: Session,
        robot: str,
        topic: str | _rect.InternalTopic,
        payload: Payload,
        urgency: str,
        timeout: float,
        converter: Converter[T] | None,
    ) -> None:
        self._session = session
        self._converter = converter
        self._asked = robot, str(topic)
        self._timeout = timeout
        self._deadline = time.monotonic() + timeout
        self._inquiry = _rect.Inquiry(session.key_space, robot, topic, timeout, session.program.request_ids, False)
        self._driver = _rect.retried_request(
            self._inquiry, robot, payload.bytes, payload.encoding, urgency, session.catalogues
        )
        self._executor = Executor(session, self._driver, on=session.urgency_sessions.of(urgency))

    @property
    def remaining(self) -> float:
        """Rest of the timeout, in seconds."""
        return max(self._deadline - time.monotonic(), 0)

    def run(self) -> Reply[T] | None:
        """Returns the reply. `None`: nothing was sent, and an ordinary request may reach a service of stock Zenoh.

        Raises the errors of `Robot.request`.
        """
        kind, robot, payload, is_shared = self._executor.run()
        if kind == "plain":
            return None
        if kind == "interrupted":
            raise Interrupted(*self._asked)
        if kind == "closed":
            self._session.check()
            raise Closed
        if kind == "timed_out":
            raise TimedOut(self._inquiry.expected, self._timeout)
        _, reply = received_of(self._session, self._converter, kind, robot, Payload(*payload), is_shared)
        if isinstance(reply, RectError):
            raise reply
        return reply

    def stop(self) -> None:
        """Ends `run` on another thread. The request is not repeated any more."""
        self._driver.on_closed()
        self._executor.wake()


def announce_close(session: Session, inquiry: _rect.Inquiry) -> bool:
    """Lets the service know that nobody waits. Returns whether it may wait for that, because it has not replied."""
    closing = inquiry.close()
    if closing is None:
        return False
    _, _, *query = closing
    selector, arguments = get_arguments(*query)
    with contextlib.suppress(zenoh.ZError, Closed), session.calls:
        session.zenoh.get(selector, direct(_ignore), **arguments)
    return True


def received_of(
    session: Session,
    converter: Converter[T] | None,
    kind: str,
    robot: str | None,
    payload: Payload,
    is_shared: bool,
) -> Received[T]:
    """Returns the reply or error of a service."""
    if kind == "answer" and robot is not None:
        try:
            decoded = session.decoder.payload(robot, payload)
        except RectError as error:
            return robot, error
        return robot, Reply(robot, decoded, is_shared, converter)
    if kind == "error":
        return robot, service_error(robot, payload)
    return None, ZenohError("the reply has no valid key of a robot", f"its key is {robot!r}")


def _ignore(_: zenoh.Reply) -> None:
    """Does nothing with the reply to an announcement."""
