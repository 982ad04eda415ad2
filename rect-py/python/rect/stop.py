"""Stops the robots of a fleet, and learns of stops."""

from __future__ import annotations

import contextlib
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.choices import Confirmation
from rect.errors import Closed, RectError, TimedOut
from rect.executor import Executor
from rect.message import Message, utc
from rect.options import text
from rect.receive_queue import DEFAULT_CAPACITY, Ended, ReceiveQueue
from rect.subscriber import Subscriber, Subscription, callable_or_none
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

_TOPIC: str = _rect.STOP_TOPIC


@dataclass(frozen=True)
class Stop:
    """A stop of the fleet that nobody has released."""

    #: The program that pressed it: `<robot>/<program>`, or `<robot>` if it has no name.
    by: str
    #: Why, in that program's words; empty if it did not say.
    reason: str
    #: When, by the clock of that robot, in UTC. The clock of a robot without a real-time clock may be years off.
    at: datetime
    #: The stop in words: `stopped by laptop/page: smoke`.
    in_words: str


class FleetStop:
    """The stop of the fleet, in which this program takes part until the robot is closed. Returned by
    `Robot.fleet_stop`.

    While it takes part, this robot remembers stops, passes them on, and confirms them.
    """

    def __init__(self, executor: StopExecutor) -> None:
        self._executor = executor
        self._changes = executor.changes()

    def press(self, reason: str = "") -> None:
        """Stops the fleet, until somebody releases it.

        Returns when the router of this robot has the stop; `confirmation` tells which robots have it.

        - `reason`: why, in a few words, for people.

        Raises `Closed`, and `NotRetained` if no router keeps the stop: then only robots that are reachable now get it.
        """
        self._executor.press(text("reason", reason))

    def release(self) -> None:
        """Releases all stops that this robot knows. Nothing happens if there is none.

        Nothing moves yet: a dead man's switch (`Robot.deadman`) waits for a neutral command.

        Raises the same errors as `press`.
        """
        self._executor.release()

    @property
    def is_stopped(self) -> bool:
        """Whether the fleet is stopped."""
        return self._executor.core.is_stopped

    @property
    def pressed(self) -> list[Stop]:
        """The stops that nobody has released, the latest first."""
        pressed = self._executor.core.pressed
        return [Stop(by, reason, utc(at_ms / 1000), in_words) for by, reason, at_ms, in_words in pressed]

    def confirmation(self, robot: str) -> Confirmation | None:
        """Returns whether a robot has confirmed the stop, or its release.

        `"confirmed"`: it knows all stops and releases that this program knows. `"waiting"`: it takes part and has not
        confirmed. `"ended"`: its program that took part has ended. `None`: none of its programs takes part, or it is
        not reachable.

        Raises `InvalidNameError`.
        """
        return self._executor.core.confirmation(text("robot", robot))

    def wait_for_change(self, timeout: float | None = None) -> None:
        """Waits until a stop, a release or a confirmation is known that was not when this method was called last, or
        when `Robot.fleet_stop` returned this object. Several are reported as one.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if nothing changes in time, and `Closed`. Example:

            while stop.confirmation("wombat-2") != "confirmed":
                stop.wait_for_change(timeout=5)
        """
        try:
            self._changes.queue.pop(timeout)
        except Ended:
            raise self._executor.closed_error() from None
        except TimeoutError:
            raise TimedOut("change of the stop", timeout or 0) from None

    def __repr__(self) -> str:
        stops = ", ".join(stop.in_words for stop in self.pressed)
        return f"FleetStop({stops or 'not stopped'})"


class StopChanges:
    """The changes for one waiting program or callback. Several that wait are one."""

    dropped = 0

    def __init__(self) -> None:
        self.queue: ReceiveQueue[bool] = ReceiveQueue(1, "drop_newest")
        #: The item of the iterator, for a callback.
        self.stop: Any = None

    def __iter__(self) -> Iterator[Any]:
        with contextlib.suppress(Ended):
            while True:
                self.queue.pop()
                yield self.stop

    async def next_async(self, timeout: float | None = None) -> Any:
        """Does the same, for asyncio. Raises `Ended`."""
        await self.queue.pop_async(timeout)
        return self.stop

    def close(self) -> None:
        """Ends it."""
        self.queue.close()


class StopExecutor:
    """Executes the stop of the core: publishes what this program knows, and takes over what others know."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.core = _rect.FleetStop(session.key_space.robot, session.program.name, session.program.instance)
        self._lock = threading.Lock()
        self._all_changes: weakref.WeakSet[StopChanges] = weakref.WeakSet()
        #: Wakes the thread that publishes and asks.
        self._wake = threading.Event()
        self._publishes = True
        #: The message that was published last, unless this program has learned since that its robot is behind.
        self._published: Payload | None = None
        #: Robots of which a program has ended. It may be the one that takes part, which only their routers know.
        self._asks: set[str] = set()
        self._ended = threading.Event()
        self._last_problem: str | None = None
        observer = _rect.observer(session.key_space, session.program.instance, session.is_direct)
        self._observer = Executor(session, observer, self._on_event, is_passive=True)
        self._subscription: Subscription[Message[Any]] | None = None
        session.handles.add(self)
        try:
            pattern = f"*/{_TOPIC}"
            inbound = _rect.Inbound(session.key_space, pattern)
            subscriber: Subscriber[Any] = Subscriber(session, inbound, pattern, None, DEFAULT_CAPACITY, "drop_oldest")
            self._subscription = Subscription(subscriber, self._on_message, pattern)
            self._observer.start("rect stop events")
            # A program that starts again knows of a stop before it does anything.
            found = session.state.latest(session.key_space.robot, _TOPIC)
            if found is not None:
                self._on_message(Message(*found))
            self._wake.set()
            session.start("rect stop", self._publish_in_background)
        except BaseException:
            self.end()
            raise

    def press(self, reason: str) -> None:
        """Stops the fleet. Raises `NotRetained` and `Closed`."""
        self._session.check()
        self.core.press(reason, time.time_ns() // 1_000_000)
        self._publish()

    def release(self) -> None:
        """Releases all stops. Raises `NotRetained` and `Closed`."""
        self._session.check()
        if self.core.release():
            self._publish()

    def changes(self) -> StopChanges:
        """Returns the changes from now on. Raises `Closed`."""
        changes = StopChanges()
        with self._lock:
            self._all_changes.add(changes)
        if self._ended.is_set():
            raise self.closed_error()
        return changes

    def closed_error(self) -> Closed:
        """Returns the error that this program does not take part any more."""
        return self._session.closed_error("stop of the fleet")

    def end(self) -> None:
        """Ends the part of this program. Its robot still knows what it has published."""
        self._session.handles.discard(self)
        self._ended.set()
        self._wake.set()
        if self._subscription is not None:
            self._subscription.close()
        self._observer.end()
        for changes in self._copy():
            changes.close()

    def on_fork(self) -> None:
        """Ends it in a child process, where nothing arrives."""
        self._ended.set()
        for changes in list(self._all_changes):
            changes.queue.on_fork()

    def _copy(self) -> list[StopChanges]:
        with self._lock:
            return list(self._all_changes)

    def _on_change(self) -> None:
        for changes in self._copy():
            changes.queue.push(True)

    def _on_event(self, event: tuple[Any, ...]) -> None:
        # Events of the router name no robot.
        if event[0] == "program_down":
            timer = threading.Timer(_rect.STOP_MARKED_WITHIN_S, self._ask_soon, (event[1],))
            timer.daemon = True
            timer.start()
        elif self.core.on_event(event):
            self._on_change()

    def _ask_soon(self, robot: str) -> None:
        with self._lock:
            self._asks.add(robot)
        self._wake.set()

    def _on_message(self, message: Message[Any]) -> None:
        if message.problem is not None or message.is_forgotten:
            return
        payload, retained = message.payload, message.retained
        has_ended = retained is not None and retained.has_ended
        is_new, problem = self.core.on_message(message.sender, payload.bytes, payload.encoding, has_ended)
        if problem is not None:
            self._session.warn(f"{message.sender} sends something on {_TOPIC} that is not a stop: {problem}")
        if is_new:
            self._published = None
            self._publish_soon()
        self._on_change()

    def _publish(self) -> None:
        """Publishes at once what this program knows. If that fails, the thread repeats it."""
        self._on_change()
        try:
            self._publish_in_memory()
        finally:
            # The thread puts it on the disk, also if this fails.
            self._publish_soon()

    def _publish_soon(self) -> None:
        self._publishes = True
        self._wake.set()

    def _publish_in_memory(self) -> None:
        """Publishes what this program knows, unless that is published already."""
        message = Payload(*self.core.message())
        if message != self._published:
            self._session.state.retain(_TOPIC, message, "urgent", False)
            self._published = message

    def _publish_in_background(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._ended.is_set():
                return
            try:
                self._ask()
                if self._publishes:
                    self._publishes = False
                    self._publish_in_memory()
                    # The disk takes longer. A program without a router has none.
                    if not self._session.is_direct:
                        self._session.state.retain(_TOPIC, Payload(*self.core.message()), "urgent", True)
                self._last_problem = None
            except Closed:
                return
            except RectError as error:
                if str(error) != self._last_problem:
                    self._last_problem = str(error)
                    self._session.warn(self._last_problem)
                self._ended.wait(_rect.STOP_AGAIN_AFTER_S)
                self._publish_soon()

    def _ask(self) -> None:
        """Asks robots for their state, in which their routers mark that a program has ended. Raises `Closed`."""
        with self._lock:
            asks, self._asks = self._asks, set()
        for robot in asks:
            if self.core.confirmation(robot) is None:
                continue
            found = self._session.state.latest(robot, _TOPIC)
            if found is not None:
                self._on_message(Message(*found))


#: Held while a session begins to take part.
_BEGINNING = threading.Lock()


def executor_of(session: Session) -> StopExecutor:
    """Returns the stop of a session, in which it takes part from the first call on.

    Raises `ZenohError`, `ThreadError` and `Closed`.
    """
    session.check()
    with _BEGINNING:
        if session.fleet_stop is None:
            session.fleet_stop = StopExecutor(session)
        executor: StopExecutor = session.fleet_stop
        return executor


def fleet_stop(session: Session, on_change: Callable[[FleetStop], object] | None) -> FleetStop:
    """Returns a handle of the stop of a session."""
    callable_or_none(on_change)
    stop = FleetStop(executor_of(session))
    if on_change is not None:
        changes = stop._executor.changes()
        changes.stop = stop
        Subscription(changes, on_change, "changes of the stop")
    return stop
