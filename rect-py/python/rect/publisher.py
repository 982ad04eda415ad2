"""Defines `Publisher`, which publishes on one topic and knows whether there are subscribers."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any, Generic

import zenoh

from rect._zenoh import direct, zenoh_error
from rect.declared import Declared
from rect.errors import TimedOut
from rect.options import seconds
from rect.typed import Converter, T
from rect.values import payload_of
from rect.waiting import next_wait

if TYPE_CHECKING:
    from rect import _rect
    from rect.session import Session


class Publisher(Generic[T]):
    """Publishes on one topic, and reports whether subscribers receive the messages. Returned by `Robot.publisher`.

    `Robot.publish` needs no publisher. A publisher is for programs that wait until a subscriber is there, or that skip
    work while nobody subscribes.
    """

    def __init__(
        self,
        session: Session,
        topic: str,
        converter: Converter[T] | None,
        urgency: str,
        codec: _rect.Codec | None,
        lifetime: float | None,
        disk: bool | None,
    ) -> None:
        self._session = session
        self._converter = converter
        self._topic = topic
        self._urgency = urgency
        self._codec = codec
        self._lifetime = lifetime
        self._disk = disk
        matching = self._matching = _Matching()
        self._declared = Declared(session, on_end=matching.close)
        publisher = session.publication(topic, None, urgency, lifetime is not None).publisher
        try:
            with session.calls:
                # It never publishes: the subscribers of this program match the other publisher, too.
                observer = session.zenoh.declare_publisher(
                    publisher.key_expr, allowed_destination=zenoh.Locality.REMOTE
                )
                self._declared.add(observer)
                listener = observer.declare_matching_listener(direct(lambda status: matching.set(status.matching)))
                self._declared.add(listener)
                # This is a `MatchingStatus`; the stubs of eclipse-zenoh 1.10 are wrong here.
                status: Any = observer.matching_status
        except zenoh.ZError as error:
            self._declared.end()
            raise zenoh_error("cannot observe the subscribers", error) from error
        matching.set_first(status.matching)
        self._declared.leave_with(self)

    @property
    def topic(self) -> str:
        """Topic of the messages."""
        return self._topic

    @property
    def has_subscribers(self) -> bool:
        """Whether at least one subscriber of another program receives the messages, on this or another robot."""
        return self._matching.is_set

    def publish(self, value: T) -> None:
        """Publishes `value` to every subscriber; see `Robot.publish`.

        Raises `TypeError` if the value does not have the type that the publisher states, `PayloadError`, `CodecError`
        and `Closed`.
        """
        self._session.check()
        if self._converter is not None:
            self._converter.check(value)
        payload = payload_of(value, self._codec)
        if self._disk is None:
            self._session.publish(self._topic, None, payload, self._urgency, self._lifetime)
        else:
            self._session.state.retain(self._topic, payload, self._urgency, self._disk)

    def wait_for_subscriber(self, timeout: float) -> None:
        """Waits until a subscriber receives the messages. `timeout` is in seconds.

        Raises `TimedOut` if there is none in time, `OptionError` and `Closed`.
        """
        timeout = seconds("timeout", timeout)
        if not self._matching.wait(timeout):
            self._session.check()
            raise TimedOut(f"subscriber of {self._topic}", timeout)

    def close(self) -> None:
        """Stops observing the subscribers."""
        self._declared.end()

    def __enter__(self) -> Publisher[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Publisher({self._topic}, has_subscribers={self.has_subscribers})"


class _Matching:
    """Whether a publisher has subscribers, as reported by Zenoh's threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._matching: bool | None = None
        self._is_closed = False

    @property
    def is_set(self) -> bool:
        return self._matching is True

    def set(self, matching: bool) -> None:
        with self._changed:
            self._matching = matching
            self._changed.notify_all()

    def set_first(self, matching: bool) -> None:
        """Sets the initial state, unless the listener has reported a newer one."""
        if self._matching is None:
            self.set(matching)

    def close(self) -> None:
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def wait(self, timeout: float) -> bool:
        """Waits until there is a subscriber. Returns `False` after the timeout, and when this is closed."""
        deadline = time.monotonic() + timeout
        with self._changed:
            while not self.is_set and not self._is_closed:
                remaining = deadline - time.monotonic()
                if remaining <= 0:
                    return False
                self._changed.wait(next_wait(remaining))
        return self.is_set
