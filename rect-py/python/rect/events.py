"""Reports robots and links that appear and disappear, and the counters of a program."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.choices import EventKind
from rect.errors import TimedOut
from rect.executor import Executor
from rect.receive_queue import DEFAULT_CAPACITY, Ended, ReceiveQueue

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
    #: Method of the path that carries the bulk now: `ble` or `tcp`. `None` unless the path has changed.
    path: str | None = None
    #: Why the path has changed: `ended`, `silent` (without acknowledgements) or `faster`. `None` unless it has.
    reason: str | None = None
    #: Name of the program. `None` unless the event is about one.
    program: str | None = None


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
    #: Messages that had expired on arrival, before the program has read them, or before they could be sent.
    expired: int
    #: Messages of other Zenoh programs that were dropped because their topic is invalid in RECT: it contains control
    #: characters or reserved parts, or is longer than 200 bytes.
    rejected: int
    #: Messages whose payload cannot be decoded, and messages and requests whose value does not fit the type that the
    #: program states.
    problems: int


class Events:
    """Iterates over events: robots, links and the router that appear and disappear. Returned by `Robot.events`.

    The first events report the robots and links that exist already.
    """

    _EXPECTED = "event"
    _HANDLE = "subscription to events"

    def __init__(self, session: Session) -> None:
        self._session = session
        #: Fields of an `Event`.
        self._queue: ReceiveQueue[tuple[Any, ...]] = ReceiveQueue(DEFAULT_CAPACITY, "drop_oldest")
        driver = _rect.observer(session.key_space, session.program.instance, session.is_direct)
        self._executor = Executor(session, driver, self._queue.queue, queue=self._queue, is_passive=True)
        self._executor.start("rect events")
        self._executor.leave_with(self)

    def next(self, timeout: float | None = None) -> Event:
        """Waits for the next event and returns it.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if no event occurs in time, and `Closed` if this object or the robot is closed.
        """
        try:
            return Event(*self._queue.pop(timeout))
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(self._EXPECTED, timeout or 0) from None

    async def next_async(self, timeout: float | None = None) -> Event:
        """Does the same as `next`, for asyncio. Raises `Ended` and `TimeoutError`."""
        return Event(*await self._queue.pop_async(timeout))

    def __iter__(self) -> Iterator[Event]:
        return self

    def __next__(self) -> Event:
        try:
            return Event(*self._queue.pop())
        except Ended:
            raise StopIteration from None

    @property
    def dropped(self) -> int:
        """Number of events dropped because the receive queue was full."""
        return self._queue.dropped

    def close(self) -> None:
        """Ends the subscription to events."""
        self._executor.end()

    def __enter__(self) -> Events:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def follow_links(session: Session) -> _rect.Links:
    """Returns the links of this robot's router, which are kept up to date until the session is closed."""
    links = _rect.Links()
    driver = _rect.router_observer(session.key_space)
    Executor(session, driver, links, is_passive=True).start("rect links")
    return links
