"""Owns what a program is told about who can be reached, and its counters."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, refused
from rect.errors import TimedOut
from rect.inbox import DEFAULT_CAPACITY, Ended, Inbox
from rect.subscriber import Declared

if TYPE_CHECKING:
    from rect.session import Session


@dataclass(frozen=True)
class Event:
    """Something has changed about who can be reached."""

    #: `peer_up`, `peer_down` (a robot of the fleet), `link_up`, `link_down` (of this robot's router; without a router,
    #: of this program), `router_up`, `router_down` (of this program). `link_up` comes again, with the robot, if
    #: the link turns out to lead to one later on.
    what: str
    #: Which robot, where that is known.
    robot: str | None = None
    #: Of a link: `ble`, `tcp`, `udp`...
    method: str | None = None
    #: Of a link: where it leads.
    address: str | None = None


@dataclass(frozen=True)
class Counters:
    """What a program has said and heard, since it joined."""

    #: Messages said, answers and requests not counted.
    sent: int
    #: Their payloads, in bytes, as they were sent.
    sent_bytes: int
    #: Messages heard, each subscription's.
    received: int
    #: Their payloads, in bytes, as they came.
    received_bytes: int
    #: Messages that did not arrive, by their numbers.
    missed: int
    #: Messages of other Zenoh programs that were dropped because RECT does not allow their topic (control characters,
    #: more than 200 bytes, reserved parts).
    rejected: int


class Events:
    """What changes about who can be reached, as it changes; first of all who is there already. An iterator."""

    dropped = 0
    _WHAT = "news of who can be reached"

    def __init__(self, session: Session) -> None:
        self._session = session
        self._inbox: Inbox[Event] = Inbox(DEFAULT_CAPACITY, "newest wins")
        self._declared = Declared(session, self._inbox)
        place, direct_links = session.place, session.is_direct
        inbox = self._inbox

        def on_link(event: zenoh.LinkEvent) -> None:
            is_up = event.kind == zenoh.SampleKind.PUT
            if direct_links:
                inbox.push(_link(event.link.dst, is_up))
            else:
                inbox.push(Event("router_up" if is_up else "router_down"))

        presence = _rect.Presence()

        def on_presence(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            robot = place.robot_of(key)
            if robot is None or robot == place.robot:
                return
            id = key.rsplit("/", 1)[-1]
            told = presence.on_up if sample.kind == zenoh.SampleKind.PUT else presence.on_down
            event = told(robot, id)
            if event is not None:
                inbox.push(Event(*event))

        zenoh_session = session.zenoh
        try:
            self._declared.add(zenoh_session.info.declare_link_events_listener(direct(on_link), history=False))
            alive = place.own(None, "alive/*")
            heard = zenoh_session.liveliness().declare_subscriber(alive, direct(on_presence), history=True)
            self._declared.add(heard)
            if not direct_links:
                links = _rect.Links()

                def on_connections(json: bytes) -> None:
                    for event in links.on_connections(json):
                        inbox.push(Event(*event))

                self._declared.add(follow(session, on_connections))
        except zenoh.ZError as error:
            self._declared.end()
            raise refused("who is there is not told", error) from None
        weakref.finalize(self, self._declared.leave).atexit = False

    def next(self, timeout: float | None = None) -> Event:
        """The next one, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        try:
            return self._inbox.pop(timeout)
        except Ended:
            raise self._session.closed_error() from None
        except TimeoutError:
            raise TimedOut(self._WHAT, timeout or 0) from None

    def __iter__(self) -> Iterator[Event]:
        return self

    def __next__(self) -> Event:
        try:
            return self._inbox.pop()
        except Ended:
            raise StopIteration from None

    def close(self) -> None:
        """Ends it."""
        self._declared.end()

    def __enter__(self) -> Events:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Known:
    """The links of this robot's router, as far as it tells."""

    def __init__(self, session: Session) -> None:
        self.links = _rect.Links()
        self._declared = follow(session, self.links.on_connections)


def follow(session: Session, on_connections: Callable[[bytes], object]) -> zenoh.Subscriber[None]:
    """Gives what this robot's router says of its connections, now and whenever they change."""
    key = session.place.own(session.place.robot, "connections")

    def on_sample(sample: zenoh.Sample) -> None:
        on_connections(payload_bytes(sample.payload))

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            on_connections(payload_bytes(reply.ok.payload))

    try:
        published: zenoh.Subscriber[None] = session.zenoh.declare_subscriber(key, direct(on_sample))
        session.zenoh.get(key, direct(on_reply))
    except zenoh.ZError as error:
        raise refused("the router's connections are not told", error) from None
    return published


def say_there(session: zenoh.Session, place: _rect.Place) -> zenoh.LivelinessToken:
    """Says that this robot is there, where it has no router that does."""
    key = place.own(place.robot, f"alive/{session.zid()}")
    try:
        return session.liveliness().declare_token(key)
    except zenoh.ZError as error:
        raise refused("the robot can't say that it is there", error) from None


def _link(locator: str, is_up: bool) -> Event:
    method, _, address = locator.partition("/")
    address = address.partition("?")[0].partition("#")[0]
    return Event("link_up" if is_up else "link_down", None, method, address)
