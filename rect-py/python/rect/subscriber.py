"""Receives the messages of a pattern, for iteration or for a callback."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Union

import zenoh

from rect import _rect
from rect._zenoh import direct, zenoh_error
from rect.advice import on_problem
from rect.deadline import Deadline
from rect.declared import Declared
from rect.errors import CodecError, TimedOut
from rect.message import Message
from rect.receive_queue import Ended, ReceiveQueue
from rect.typed import Converter, T
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

#: Metadata, payload bytes, encoding, and the method of the link, if it is known.
_Arrived = tuple[_rect.MessageMetadata, bytes, str, Union[str, None]]
_LOG = logging.getLogger("rect")


@dataclass(frozen=True)
class SenderCounts:
    """Counts of the messages from one sender."""

    #: Messages that arrived.
    received: int
    #: Messages that did not arrive, according to the sequence numbers.
    missed: int


class Subscriber(Generic[T]):
    """Receives the messages of a pattern. Returned by `Robot.subscribe`.

    Iterating waits for one message after another, and ends when the subscriber or the robot is closed. The subscription
    ends when the subscriber is closed, leaves its `with` block, or is garbage-collected.

    >>> import rect
    >>> with rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
    ...     with robot.subscribe("*/greeting") as subscriber:
    ...         robot.publish("greeting", "hello")
    ...         print(subscriber.next(timeout=5).value)
    hello
    """

    _HANDLE = "subscriber"

    def __init__(
        self,
        session: Session,
        inbound: _rect.Inbound,
        description: str,
        converter: Converter[T] | None,
        capacity: int,
        when_full: str,
    ) -> None:
        self._session = session
        self._converter = converter
        self._description = description
        self._queue: ReceiveQueue[_Arrived] = ReceiveQueue(capacity, when_full)
        self._inbound = inbound
        self._declared = Declared(session, self._queue)
        session.state.follow(inbound)
        keys = inbound.keys()
        callbacks = [
            _rect.OnMessage(self._queue.queue, inbound, session.counters, session.links, subscription)
            for subscription in range(len(keys))
        ]
        for key, on_message in zip(keys, callbacks):
            try:
                with session.calls:
                    self._declared.add(session.zenoh.declare_subscriber(key, direct(on_message)))
            except zenoh.ZError as error:
                self._declared.end()
                raise zenoh_error("cannot declare the subscriber", error) from error
        token = inbound.token()
        if token is not None:
            with session.calls:
                self._declared.add(session.zenoh.liveliness().declare_token(token))
        # The subscriptions precede it, so that no change is missed between them.
        self._declared.add(session.state.receive(callbacks[0]))
        self._declared.leave_with(self)

    def next(self, timeout: float | None = None) -> Message[T]:
        """Waits for the next message and returns it.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if no message arrives in time, and `Closed` if the subscriber or the robot is closed.
        """
        try:
            return self._take(timeout)
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(f"message {self._description}", timeout or 0) from None

    def __iter__(self) -> Iterator[Message[T]]:
        return self

    def __next__(self) -> Message[T]:
        try:
            return self._take(None)
        except Ended:
            raise StopIteration from None

    @property
    def dropped(self) -> int:
        """Number of messages dropped because the receive queue was full."""
        return self._queue.dropped

    @property
    def counts_by_sender(self) -> dict[str, SenderCounts]:
        """Numbers of received and missed messages, by sender."""
        return {robot: SenderCounts(received, missed) for robot, received, missed in self._inbound.counts_by_sender()}

    def close(self) -> None:
        """Ends the subscription. Messages that are already in the receive queue can still be read."""
        self._declared.end()

    def __enter__(self) -> Subscriber[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Subscriber({self._description}, dropped={self.dropped})"

    def _take(self, timeout: float | None) -> Message[T]:
        """Waits for the next message that has not expired."""
        deadline = Deadline(timeout)
        while True:
            message: Message[T] = undecoded(self._queue.pop(deadline.remaining()))
            # Decoding may wait for a dictionary.
            if not message.is_expired and not self._decoded(message).is_expired:
                return message
            self._session.counters.on_expired()

    def _decoded(self, message: Message[T]) -> Message[T]:
        """Decodes the payload of the message, or sets `problem`."""
        return decoded(self._session, message, self._converter)

    def fitted(self, message: Message[T]) -> Message[T]:
        """Converts the value of a decoded message to the type that the program has stated, or sets `problem`."""
        return fitted(self._session, message, self._converter)


def decoded(session: Session, message: Message[T], converter: Converter[T] | None) -> Message[T]:
    """Decodes the payload of a message and converts its value, or sets `problem`."""
    try:
        message.payload = session.decoder.payload(message.sender, message.payload)
    except CodecError as error:
        message.problem = error
    return fitted(session, message, converter)


def fitted(session: Session, message: Message[T], converter: Converter[T] | None) -> Message[T]:
    """Converts the value of a decoded message to the type that the program has stated, or sets `problem`."""
    if converter is not None and message.problem is None and not message.is_forgotten:
        message.fit(converter)
    if message.problem is not None:
        on_problem(session, message.sender, message.topic, message.problem)
    return message


def undecoded(arrived: _Arrived) -> Message[Any]:
    """Makes a message whose payload is not decoded yet."""
    metadata, payload, encoding, method = arrived
    return Message(metadata, Payload(payload, encoding), method)


class Subscription(Generic[T]):
    """Calls a callback for each item of a subscriber, watch or event source, one call at a time, on a separate thread.

    It ends when it or the robot is closed. An exception of the callback is logged (`logging.getLogger("rect")`), and
    the callback is called again for the next item.
    """

    def __init__(self, source: Any, callback: Callable[[T], object], about: str) -> None:
        self._source = source
        self._about = about
        self._callback = callback
        self._thread = threading.Thread(target=self._run, name=f"rect {about}", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of messages, frames or events dropped because the receive queue was full."""
        return int(self._source.dropped)

    @property
    def counts_by_sender(self) -> dict[str, SenderCounts]:
        """Numbers of received and missed messages, by sender. Empty for frames and events."""
        return self._source.counts_by_sender if isinstance(self._source, Subscriber) else {}

    def close(self) -> None:
        """Ends the subscription. Does not wait for a running callback."""
        self._source.close()

    def __enter__(self) -> Subscription[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Subscription({self._about})"

    def _run(self) -> None:
        for item in self._source:
            try:
                self._callback(item)
            except BaseException:
                # `sys.exit` included: on this thread it would silently end the subscription, and not the program.
                _LOG.exception("the callback for %s raised an exception", self._about)


def callable_or_none(callback: object) -> None:
    """Raises `TypeError` unless the callback is callable or `None`."""
    if callback is not None and not callable(callback):
        raise TypeError(f"callback must be a function, not {type(callback).__name__}")
