"""Reports robots and links that appear and disappear, and the counters of a program."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import zenoh

from rect import _rect
from rect._zenoh import call_interruptibly, direct, payload_bytes, zenoh_error
from rect.choices import EventKind
from rect.errors import TimedOut
from rect.receive_queue import DEFAULT_CAPACITY, Ended, ReceiveQueue
from rect.subscriber import Declared

if TYPE_CHECKING:
    from rect.session import Session


@dataclass(frozen=True)
class Event:
    """A change: a robot, a link or the router appeared or disappeared."""

    #: Kind of the event.
    kind: EventKind
    #: Name of the robot. `None` if it is unknown, and for events about the router.
    robot: str | None = None
    #: Method of the link: `ble`, `tcp`, `udp` and so on. `None` unless the event is about a link.
    method: str | None = None
    #: Address of the peer of the link. `None` unless the event is about a link.
    address: str | None = None


@dataclass(frozen=True)
class Counters:
    """Counts of the messages of a program since it connected. Requests and replies are not included."""

    #: Messages published or sent.
    sent: int
    #: Size of their payloads after compression, in bytes.
    sent_bytes: int
    #: Messages received, summed over all subscriptions.
    received: int
    #: Size of their payloads before decompression, in bytes.
    received_bytes: int
    #: Messages that did not arrive, according to the sequence numbers.
    missed: int
    #: Messages of other Zenoh programs that were dropped because their topic is invalid in RECT: it contains control
    #: characters or reserved parts, or is longer than 200 bytes.
    rejected: int


class Events:
    """Iterates over events: robots, links and the router that appear and disappear. Returned by `Robot.events`.

    The first events report the robots and links that exist already.
    """

    _EXPECTED = "event"
    _HANDLE = "subscription to events"

    def __init__(self, session: Session) -> None:
        self._session = session
        self._queue: ReceiveQueue[Event] = ReceiveQueue(DEFAULT_CAPACITY, "drop_oldest")
        self._declared = Declared(session, self._queue)
        key_space, direct_links = session.key_space, session.is_direct
        queue = self._queue

        def on_link(event: zenoh.LinkEvent) -> None:
            is_up = event.kind == zenoh.SampleKind.PUT
            if direct_links:
                queue.push(_link(event.link.dst, is_up))
            else:
                queue.push(Event("router_up" if is_up else "router_down"))

        presence = _rect.Presence()

        def on_presence(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            robot = key_space.robot_of(key)
            if robot is None or robot == key_space.robot:
                return
            id = key.rsplit("/", 1)[-1]
            on_change = presence.on_up if sample.kind == zenoh.SampleKind.PUT else presence.on_down
            event = on_change(robot, id)
            if event is not None:
                queue.push(Event(*event))

        zenoh_session = session.zenoh
        try:
            self._declared.add(zenoh_session.info.declare_link_events_listener(direct(on_link), history=False))
            alive = key_space.own(None, "alive/*")
            # Zenoh calls `on_presence` during the declaration, and ignores a KeyboardInterrupt in it.
            subscriber = call_interruptibly(
                lambda: zenoh_session.liveliness().declare_subscriber(alive, direct(on_presence), history=True),
                lambda subscriber: subscriber.undeclare(),
            )
            self._declared.add(subscriber)
            if not direct_links:
                links = _rect.Links()

                def on_connections(json: bytes) -> None:
                    for event in links.on_connections(json):
                        queue.push(Event(*event))

                self._declared.add(follow(session, on_connections))
        except zenoh.ZError as error:
            self._declared.end()
            raise zenoh_error("cannot subscribe to the presence of robots", error) from None
        self._declared.leave_with(self)

    def next(self, timeout: float | None = None) -> Event:
        """Waits for the next event and returns it.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if no event occurs in time, and `Closed` if this object or the robot is closed.
        """
        try:
            return self._queue.pop(timeout)
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(self._EXPECTED, timeout or 0) from None

    def __iter__(self) -> Iterator[Event]:
        return self

    def __next__(self) -> Event:
        try:
            return self._queue.pop()
        except Ended:
            raise StopIteration from None

    @property
    def dropped(self) -> int:
        """Number of events dropped because the receive queue was full."""
        return self._queue.dropped

    def close(self) -> None:
        """Ends the subscription to events."""
        self._declared.end()

    def __enter__(self) -> Events:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RouterLinks:
    """Keeps track of the links that this robot's router reports."""

    def __init__(self, session: Session) -> None:
        self.links = _rect.Links()
        self._declared = follow(session, self.links.on_connections)


def follow(session: Session, on_connections: Callable[[bytes], object]) -> zenoh.Subscriber[None]:
    """Calls `on_connections` with the connections of this robot's router, now and after each change."""
    key = session.key_space.own(session.key_space.robot, "connections")

    def on_sample(sample: zenoh.Sample) -> None:
        on_connections(payload_bytes(sample.payload))

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            on_connections(payload_bytes(reply.ok.payload))

    try:
        published: zenoh.Subscriber[None] = session.zenoh.declare_subscriber(key, direct(on_sample))
        session.zenoh.get(key, direct(on_reply))
    except zenoh.ZError as error:
        raise zenoh_error("cannot subscribe to the connections of the router", error) from None
    return published


def declare_liveliness(session: zenoh.Session, key_space: _rect.KeySpace) -> zenoh.LivelinessToken:
    """Declares the liveliness token of this robot, if no router does so."""
    key = key_space.own(key_space.robot, f"alive/{session.zid()}")
    try:
        return session.liveliness().declare_token(key)
    except zenoh.ZError as error:
        raise zenoh_error("cannot declare the liveliness of the robot", error) from None


def _link(locator: str, is_up: bool) -> Event:
    method, _, address = locator.partition("/")
    address = address.partition("?")[0].partition("#")[0]
    return Event("link_up" if is_up else "link_down", None, method, address)
