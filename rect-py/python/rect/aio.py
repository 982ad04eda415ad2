"""The API of `rect` for asyncio, with the same names: calls that wait are awaited, and iterators use `async for`.

    async with rect.aio.connect("wombat-1") as robot:
        await robot.publish("arm/angle", {"degrees": 12.5})
        async for message in robot.subscribe("*/arm/angle"):
            print(message.sender, message.value)

A robot belongs to the event loop in which it was connected. Callbacks and handlers may be plain functions or
`async def`; they run in that loop. The classes of the same names in `rect` document parameters, defaults and errors.
`Robot.outgoing_transfer`, `Robot.record` and `StreamSender.send_with` exist only there.
"""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

import zenoh as stock

from rect import _rect, action_run
from rect import robot as blocking
from rect.action import ActionExecutor
from rect.action_run import Feedback, Following, KnownGoal, Types
from rect.aio_action import Action, AsyncRun, Goal
from rect.aio_safety import Deadman, FleetStop
from rect.alert import Alert
from rect.annotations import complete as _complete_annotations
from rect.choices import Level, Urgency, WhenBusy, WhenFull
from rect.deadline import Deadline
from rect.deadman import DeadmanExecutor
from rect.errors import CodecError, TimedOut
from rect.events import Counters, Event
from rect.events import Events as BlockingEvents
from rect.logs import LogLine
from rect.logs import Logs as BlockingLogs
from rect.message import Message
from rect.options import Options, seconds, text
from rect.parameter_types import Declared
from rect.parameters import GroupExecutor, GroupOptions, OnChangeT, executor_of
from rect.parameters import ParameterGroup as BlockingParameterGroup
from rect.program import Program, ServiceEntry
from rect.publisher import Publisher as BlockingPublisher
from rect.receive_queue import DEFAULT_CAPACITY, Ended
from rect.registry import Connections
from rect.reply import Gathered, Reply
from rect.request import Replies as BlockingReplies
from rect.robot import DEFAULT_TIMEOUT, LOST_AFTER, CodecLike
from rect.service import Request, Requests
from rect.state import Retain
from rect.stop import executor_of as stop_executor_of
from rect.stream import Frame
from rect.stream import StreamSender as BlockingStreamSender
from rect.stream import Watcher as BlockingWatcher
from rect.subscriber import SenderCounts, callable_or_none, undecoded
from rect.subscriber import Subscriber as BlockingSubscriber
from rect.transfer import Progress, Received
from rect.transfer import Transfers as BlockingTransfers
from rect.typed import T
from rect.values import codec_of, payload_of

H = TypeVar("H", bound="_Handle")
_LOG = logging.getLogger("rect")
Handler = Callable[[Request[Any]], Any]
GoalHandler = Callable[[Goal[Any]], Any]

__all__ = [
    "Action",
    "ActionRun",
    "Connecting",
    "Deadman",
    "Events",
    "FleetStop",
    "Goal",
    "GoalHandler",
    "Handler",
    "ParameterGroup",
    "Publisher",
    "Replies",
    "Robot",
    "Service",
    "StreamSender",
    "Subscriber",
    "Subscription",
    "Transfers",
    "Watcher",
    "connect",
]


def connect(
    name: str,
    *,
    fleet: str = "rect",
    router: str | None = None,
    endpoints: Sequence[str] = (),
    listen: Sequence[str] = (),
    login: tuple[str, str] | None = None,
    login_file: str | Path | None = None,
    timeout: float = 5.0,
    zenoh: Mapping[str, Any] | None = None,
    allow_name_mismatch: bool = False,
    program: str | None = "",
) -> Connecting:
    """Connects as `rect.connect` does: `async with connect(...) as robot:`, or `robot = await connect(...)`."""
    settings = zenoh or {}
    options = (fleet, router, endpoints, listen, login, login_file, timeout, settings, allow_name_mismatch, program)
    return Connecting(Options(name, *options))


class Connecting:
    """The result of `connect`: awaiting it, or entering it with `async with`, returns the `Robot`."""

    def __init__(self, options: Options) -> None:
        self._options = options
        self._robot: Robot | None = None

    def __await__(self) -> Generator[Any, None, Robot]:
        return self._connect().__await__()

    async def __aenter__(self) -> Robot:
        self._robot = await self._connect()
        return self._robot

    async def __aexit__(self, *_: object) -> None:
        if self._robot is not None:
            await self._robot.close()

    async def _connect(self) -> Robot:
        return Robot(await asyncio.to_thread(blocking.Robot, self._options))


class Robot:
    """A program of a robot, connected to the other robots of the fleet; see `rect.Robot`."""

    def __init__(self, robot: blocking.Robot) -> None:
        self._robot = robot
        self._session = robot._session
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def name(self) -> str:
        """Name of this robot."""
        return self._robot.name

    @property
    def fleet(self) -> str:
        """Name of the fleet."""
        return self._robot.fleet

    @property
    def zenoh(self) -> stock.Session:
        """Zenoh session of this robot; see `rect.Robot.zenoh`."""
        return self._robot.zenoh

    @property
    def is_closed(self) -> bool:
        """Whether the robot was closed."""
        return self._robot.is_closed

    async def publish(
        self,
        topic: str,
        value: Any,
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
        retained: Retain = False,
    ) -> None:
        """Publishes `value` on `topic` to every subscriber; see `rect.Robot.publish`."""
        await self._publish(topic, None, value, urgency, codec, expires_after, retained)

    async def send(
        self,
        robot: str,
        topic: str,
        value: Any,
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
    ) -> None:
        """Sends `value` on `topic` to one robot only; see `rect.Robot.send`."""
        await self._publish(topic, text("robot", robot), value, urgency, codec, expires_after)

    @overload
    def subscribe(
        self,
        pattern: str,
        type: type[T],
        *,
        callback: None = None,
        capacity: int = DEFAULT_CAPACITY,
        when_full: WhenFull = "drop_oldest",
        max_hz: float | None = None,
        on_change: bool = False,
    ) -> Subscriber[T]: ...
    @overload
    def subscribe(
        self,
        pattern: str,
        type: type[T],
        *,
        callback: Callable[[Message[T]], object],
        capacity: int = DEFAULT_CAPACITY,
        when_full: WhenFull = "drop_oldest",
        max_hz: float | None = None,
        on_change: bool = False,
    ) -> Subscription[Message[T]]: ...
    @overload
    def subscribe(
        self,
        pattern: str,
        type: Any = None,
        *,
        callback: None = None,
        capacity: int = DEFAULT_CAPACITY,
        when_full: WhenFull = "drop_oldest",
        max_hz: float | None = None,
        on_change: bool = False,
    ) -> Subscriber[Any]: ...
    @overload
    def subscribe(
        self,
        pattern: str,
        type: Any = None,
        *,
        callback: Callable[[Message[Any]], object],
        capacity: int = DEFAULT_CAPACITY,
        when_full: WhenFull = "drop_oldest",
        max_hz: float | None = None,
        on_change: bool = False,
    ) -> Subscription[Message[Any]]: ...
    def subscribe(
        self,
        pattern: str,
        type: Any = None,
        *,
        callback: Callable[[Message[Any]], object] | None = None,
        capacity: int = DEFAULT_CAPACITY,
        when_full: WhenFull = "drop_oldest",
        max_hz: float | None = None,
        on_change: bool = False,
    ) -> Subscriber[Any] | Subscription[Message[Any]]:
        """Subscribes to a pattern, for `async for` or a callback; see `rect.Robot.subscribe`."""
        callable_or_none(callback)
        subscribed = self._robot.subscribe(
            pattern, type, capacity=capacity, when_full=when_full, max_hz=max_hz, on_change=on_change
        )
        subscriber = Subscriber(subscribed)
        return subscriber if callback is None else Subscription(self, subscriber, callback, pattern)

    @overload
    async def wait_for_message(self, pattern: str, type: type[T], *, timeout: float | None = None) -> Message[T]: ...
    @overload
    async def wait_for_message(
        self, pattern: str, type: Any = None, *, timeout: float | None = None
    ) -> Message[Any]: ...
    async def wait_for_message(self, pattern: str, type: Any = None, *, timeout: float | None = None) -> Message[Any]:
        """Waits for the next message that matches the pattern; see `rect.Robot.wait_for_message`."""
        if timeout is not None:
            seconds("timeout", timeout)
        with self.subscribe(pattern, type) as subscriber:
            return await subscriber.next(timeout)

    @overload
    async def request(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        returns: type[T],
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        retry: bool = False,
    ) -> Reply[T]: ...
    @overload
    async def request(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        returns: Any = None,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        retry: bool = False,
    ) -> Reply[Any]: ...
    async def request(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        returns: Any = None,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        retry: bool = False,
    ) -> Reply[Any]:
        """Sends a request to a service of `robot`, and returns its first reply; see `rect.Robot.request`."""
        if retry:
            arguments = (robot, topic, value, returns, timeout, urgency, codec)
            retried = await asyncio.to_thread(self._robot._retried_request, *arguments)
            try:
                once = await asyncio.to_thread(retried.run)
            finally:
                retried.stop()
            if once is not None:
                return once
            timeout = retried.remaining
        replies = self._robot._request(text("robot", robot), topic, value, returns, timeout, urgency, codec)
        try:
            reply = await replies.next_async()
        finally:
            replies.leave()
        if reply is None:
            peers = await self.peers()
            raise replies.unanswered(lambda: peers)
        return reply

    @overload
    def request_all(
        self,
        topic: str,
        value: Any = "",
        *,
        returns: type[T],
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
    ) -> Replies[T]: ...
    @overload
    def request_all(
        self,
        topic: str,
        value: Any = "",
        *,
        returns: Any = None,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
    ) -> Replies[Any]: ...
    def request_all(
        self,
        topic: str,
        value: Any = "",
        *,
        returns: Any = None,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
    ) -> Replies[Any]:
        """Sends a request to the services of all robots, for `async for`; see `rect.Robot.request_all`."""
        return Replies(self._robot._request(None, topic, value, returns, timeout, urgency, codec))

    @overload
    def request_stream(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        returns: type[T],
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
    ) -> Replies[T]: ...
    @overload
    def request_stream(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        returns: Any = None,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
    ) -> Replies[Any]: ...
    def request_stream(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        returns: Any = None,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
    ) -> Replies[Any]:
        """Sends a request that gets several replies, for `async for`; see `rect.Robot.request_stream`."""
        robot = text("robot", robot)
        return Replies(self._robot._request(robot, topic, value, returns, timeout, urgency, codec, is_stream=True))

    @overload
    def serve(
        self, topic: str, *, about: str | None = None, allow_several: bool = False
    ) -> Callable[[Handler], Service]: ...
    @overload
    def serve(
        self, topic: str, handler: Handler, *, about: str | None = None, allow_several: bool = False
    ) -> Service: ...
    def serve(
        self, topic: str, handler: Handler | None = None, *, about: str | None = None, allow_several: bool = False
    ) -> Service | Callable[[Handler], Service]:
        """Serves requests with a function or an `async def`; see `rect.Robot.serve`. Both may yield several replies."""
        self._session.check()
        text("topic", topic)
        if handler is None:
            return lambda handler: self.serve(topic, handler, about=about, allow_several=allow_several)
        if not callable(handler):
            raise TypeError(f"handler must be a function, not {type(handler).__name__}")
        return Service(self, topic, handler, about, allow_several)

    async def parameters(
        self, group: str, options: GroupOptions | None = None, /, **parameters: Declared
    ) -> ParameterGroup:
        """Declares a group of parameters; see `rect.Robot.parameters`."""
        executor = await asyncio.to_thread(executor_of, self._session, group, options, parameters)
        return ParameterGroup(self, executor)

    async def set_parameters(
        self,
        robot: str,
        group: str,
        values: Mapping[str, Any] | None = None,
        /,
        *,
        reset: bool | Sequence[str] = False,
        stored: bool = False,
        **more: Any,
    ) -> dict[str, Any]:
        """Changes parameters of a program of `robot`; see `rect.Robot.set_parameters`.

        If the task is cancelled, the parameters may be changed or not.
        """
        values = {**(values or {}), **more}
        return await asyncio.to_thread(
            lambda: self._robot.set_parameters(robot, group, values, reset=reset, stored=stored)
        )

    @overload
    def action(
        self,
        name: str,
        *,
        about: str | None = None,
        when_busy: WhenBusy = "preempt",
        lost_after: float | None = LOST_AFTER,
    ) -> Callable[[GoalHandler], Action]: ...
    @overload
    def action(
        self,
        name: str,
        handler: GoalHandler,
        *,
        about: str | None = None,
        when_busy: WhenBusy = "preempt",
        lost_after: float | None = LOST_AFTER,
    ) -> Action: ...
    def action(
        self,
        name: str,
        handler: GoalHandler | None = None,
        *,
        about: str | None = None,
        when_busy: WhenBusy = "preempt",
        lost_after: float | None = LOST_AFTER,
    ) -> Action | Callable[[GoalHandler], Action]:
        """Declares an action; see `rect.Robot.action`. The handler runs in the event loop, and `await goal.sleep(1)`
        raises `rect.Cancelled` when it should end."""
        if handler is None:
            options: dict[str, Any] = {"about": about, "when_busy": when_busy, "lost_after": lost_after}
            return lambda handler: self.action(name, handler, **options)
        executor = ActionExecutor(self._session, name, handler, about, when_busy, lost_after)
        return Action(self.begin, executor, handler)

    @overload
    async def start(
        self,
        robot: str,
        action: str,
        goal: Any = None,
        *,
        id: str | None = None,
        returns: type[T],
        feedback: Any = None,
        feedback_per_s: float | None = None,
        timeout: float = DEFAULT_TIMEOUT,
    ) -> ActionRun[T]: ...
    @overload
    async def start(
        self,
        robot: str,
        action: str,
        goal: Any = None,
        *,
        id: str | None = None,
        returns: Any = None,
        feedback: Any = None,
        feedback_per_s: float | None = None,
        timeout: float = DEFAULT_TIMEOUT,
    ) -> ActionRun[Any]: ...
    async def start(
        self,
        robot: str,
        action: str,
        goal: Any = None,
        *,
        id: str | None = None,
        returns: Any = None,
        feedback: Any = None,
        feedback_per_s: float | None = None,
        timeout: float = DEFAULT_TIMEOUT,
    ) -> ActionRun[Any]:
        """Starts a goal of an action of `robot`; see `rect.Robot.start`.

        If the task is cancelled, the goal may have begun.
        """
        arguments = (robot, action, goal, id, feedback_per_s, timeout, Types(returns, feedback))
        return ActionRun(self, await asyncio.to_thread(action_run.start, self._session, *arguments))

    @overload
    async def find(
        self, robot: str, action: str, id: str, *, returns: type[T], feedback: Any = None
    ) -> ActionRun[T]: ...
    @overload
    async def find(
        self, robot: str, action: str, id: str, *, returns: Any = None, feedback: Any = None
    ) -> ActionRun[Any]: ...
    async def find(
        self, robot: str, action: str, id: str, *, returns: Any = None, feedback: Any = None
    ) -> ActionRun[Any]:
        """Returns a goal that this program or another one has started; see `rect.Robot.find`."""
        types = Types(returns, feedback)
        return ActionRun(self, await asyncio.to_thread(action_run.find, self._session, robot, action, id, types))

    async def goals(self, robot: str = "*") -> list[KnownGoal]:
        """Returns the goals that a robot, or all robots (`*`), know; see `rect.Robot.goals`."""
        return await asyncio.to_thread(self._robot.goals, robot)

    async def deadman(
        self,
        pattern: str,
        drive: Callable[[Message[Any]], object],
        *,
        within: float,
        on_lost: Callable[[str], object],
        type: Any = None,
    ) -> Deadman:
        """Carries out commands in the event loop while they arrive; see `rect.Robot.deadman`.

        `on_lost` is a plain function, and is called on the thread of the switch rather than in the event loop, so that
        a loop that is busy does not delay it.
        """
        if inspect.iscoroutinefunction(on_lost):
            raise TypeError("on_lost must be a plain function, since the event loop may be busy when it is called")
        arguments = (self._session, pattern, drive, within, on_lost, type)
        executor = await asyncio.to_thread(DeadmanExecutor, *arguments)
        switch = Deadman(executor, drive)
        Subscription(self, Subscriber(executor.subscriber), switch.on_message, pattern)
        return switch

    async def fleet_stop(self, on_change: Callable[[FleetStop], object] | None = None) -> FleetStop:
        """Takes part in the stop of the fleet; see `rect.Robot.fleet_stop`. `on_change` is called in the event loop."""
        callable_or_none(on_change)
        executor = await asyncio.to_thread(stop_executor_of, self._session)
        stop = FleetStop(executor)
        if on_change is not None:
            changes = executor.changes()
            changes.stop = stop
            source: _Source[FleetStop] = _Source(changes, "change", changes.next_async)
            Subscription(self, source, on_change, "changes of the stop")
        return stop

    def stream(self, topic: str, **options: Any) -> StreamSender:
        """Opens a stream for sending frames; see `rect.Robot.stream`."""
        return StreamSender(self._robot.stream(topic, **options))

    @overload
    def watch(
        self,
        stream: str,
        *,
        callback: None = None,
        capacity: int = 1,
        when_full: WhenFull = "drop_oldest",
        decode: bool = True,
    ) -> Watcher: ...
    @overload
    def watch(
        self,
        stream: str,
        *,
        callback: Callable[[Frame], object],
        capacity: int = 1,
        when_full: WhenFull = "drop_oldest",
        decode: bool = True,
    ) -> Subscription[Frame]: ...
    def watch(
        self,
        stream: str,
        *,
        callback: Callable[[Frame], object] | None = None,
        capacity: int = 1,
        when_full: WhenFull = "drop_oldest",
        decode: bool = True,
    ) -> Watcher | Subscription[Frame]:
        """Receives a stream, for `async for` or a callback; see `rect.Robot.watch`."""
        callable_or_none(callback)
        received = self._robot.watch(stream, capacity=capacity, when_full=when_full, decode=decode)
        watcher = Watcher(received)
        return watcher if callback is None else Subscription(self, watcher, callback, stream)

    async def transfer(
        self,
        robot: str,
        topic: str,
        data: Any,
        *,
        name: str | None = None,
        timeout: float | None = None,
        on_progress: Callable[[Progress], object] | None = None,
    ) -> None:
        """Transfers a file or bytes of any size to one robot; see `rect.Robot.transfer`.

        Cancelling the task stops the transfer.
        """
        loop = asyncio.get_running_loop()
        report = on_progress and (lambda progress: loop.call_soon_threadsafe(on_progress, progress))
        outgoing = await asyncio.to_thread(self._robot.outgoing_transfer, robot, topic, data, name, timeout, report)
        try:
            await asyncio.to_thread(outgoing.run)
        finally:
            outgoing.stop()

    def receive_transfers(self, pattern: str, **options: Any) -> Transfers:
        """Accepts the transfers that match a pattern, for `async for`; see `rect.Robot.receive_transfers`."""
        return Transfers(self._robot.receive_transfers(pattern, **options))

    def share_dictionary(self, dictionary: _rect.Dictionary) -> _rect.Codec:
        """Shares a dictionary with all robots, and returns its codec; see `rect.Robot.share_dictionary`."""
        return self._robot.share_dictionary(dictionary)

    @overload
    def publisher(
        self,
        topic: str,
        type: type[T],
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
        retained: Retain = False,
    ) -> Publisher[T]: ...
    @overload
    def publisher(
        self,
        topic: str,
        type: Any = None,
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
        retained: Retain = False,
    ) -> Publisher[Any]: ...
    def publisher(
        self,
        topic: str,
        type: Any = None,
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
        retained: Retain = False,
    ) -> Publisher[Any]:
        """Returns a publisher of `topic`, which can wait for a subscriber; see `rect.Robot.publisher`."""
        options: dict[str, Any] = {"urgency": urgency, "codec": codec, "expires_after": expires_after}
        return Publisher(self._robot.publisher(topic, type, **options, retained=retained))

    @overload
    async def latest(self, robot: str, topic: str, type: type[T]) -> Message[T] | None: ...
    @overload
    async def latest(self, robot: str, topic: str, type: Any = None) -> Message[Any] | None: ...
    async def latest(self, robot: str, topic: str, type: Any = None) -> Message[Any] | None:
        """Returns the last value of a retained topic of `robot`, if it has one; see `rect.Robot.latest`."""
        return await asyncio.to_thread(self._robot.latest, robot, topic, type)

    async def forget(self, topic: str) -> None:
        """Forgets a retained topic of this robot; see `rect.Robot.forget`."""
        await asyncio.to_thread(self._robot.forget, topic)

    def log(
        self,
        text: str,
        level: Level = "info",
        *,
        logger: str = "",
        fields: Mapping[str, Any] | None = None,
        source: str = "",
        private: bool = False,
    ) -> None:
        """Logs a line, without waiting; see `rect.Robot.log`."""
        self._robot.log(text, level, logger=logger, fields=fields, source=source, private=private)

    def logs(
        self,
        robot: str = "*",
        *,
        program: str | None = None,
        level: Level = "debug",
        last: int = 100,
        follow: bool = False,
        timeout: float = 10.0,
    ) -> Logs:
        """Reads the log of a robot, or of all robots, for `async for`; see `rect.Robot.logs`."""
        return Logs(self._robot.logs(robot, program=program, level=level, last=last, follow=follow, timeout=timeout))

    async def alert(self, text: str, level: Level = "warn", *, name: str | None = None) -> None:
        """Raises an alert; see `rect.Robot.alert`."""
        await asyncio.to_thread(lambda: self._robot.alert(text, level, name=name))

    async def clear_alert(self, name_or_text: str) -> None:
        """Clears an alert; see `rect.Robot.clear_alert`."""
        await asyncio.to_thread(self._robot.clear_alert, name_or_text)

    async def alerts(self, robot: str = "*") -> list[Alert]:
        """Returns the alerts that are raised now; see `rect.Robot.alerts`."""
        return await asyncio.to_thread(self._robot.alerts, robot)

    async def wait_for_peer(self, robot: str, timeout: float) -> None:
        """Waits until `robot` is reachable; see `rect.Robot.wait_for_peer`."""
        await asyncio.to_thread(self._robot.wait_for_peer, robot, timeout)

    async def wait_until_established(self, timeout: float) -> None:
        """Waits until the other robots know this program's subscriptions; see `rect.Robot.wait_until_established`."""
        await asyncio.to_thread(self._robot.wait_until_established, timeout)

    async def peers(self) -> list[str]:
        """Returns the names of the other robots of the fleet that are reachable now; see `rect.Robot.peers`."""
        return await asyncio.to_thread(self._robot.peers)

    async def connections(self, robot: str | None = None, filter: str = "") -> Connections:
        """Returns the connections of the router of `robot`; see `rect.Robot.connections`."""
        return await asyncio.to_thread(self._robot.connections, robot, filter)

    async def add_connection(self, name: str, method: str, address: str, **options: Any) -> None:
        """Adds a named connection to the router of a robot; see `rect.Robot.add_connection`."""
        await asyncio.to_thread(lambda: self._robot.add_connection(name, method, address, **options))

    async def remove_connection(self, name: str, *, robot: str | None = None) -> None:
        """Removes a named connection from the router of a robot; see `rect.Robot.remove_connection`."""
        await asyncio.to_thread(lambda: self._robot.remove_connection(name, robot=robot))

    async def programs(self, robot: str | None = None) -> list[Program]:
        """Returns the programs of a robot, with their services; see `rect.Robot.programs`."""
        return await asyncio.to_thread(self._robot.programs, robot)

    async def services(self, robot: str | None = None) -> list[ServiceEntry]:
        """Returns what the programs of a robot serve; see `rect.Robot.services`."""
        return await asyncio.to_thread(self._robot.services, robot)

    async def query_registry(self, question: str, *, robot: str | None = None, filter: str = "") -> Any:
        """Sends a question to the registry of a router, and returns its answer; see `rect.Robot.query_registry`."""
        return await asyncio.to_thread(lambda: self._robot.query_registry(question, robot=robot, filter=filter))

    def events(self) -> Events:
        """Returns the events of robots, links and the router, for `async for`; see `rect.Robot.events`."""
        return Events(self._robot.events())

    def on_event(self, callback: Callable[[Event], object]) -> Subscription[Event]:
        """Calls `callback` for each event; see `rect.Robot.on_event`."""
        callable_or_none(callback)
        return Subscription(self, self.events(), callback, "events")

    def counters(self) -> Counters:
        """Returns the counts of messages that this program has sent and received; see `rect.Robot.counters`."""
        return self._robot.counters()

    async def close(self) -> None:
        """Closes the session and everything that belongs to it, and waits until running callbacks and handlers end."""
        await asyncio.to_thread(self._robot.close)
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def __aenter__(self) -> Robot:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return repr(self._robot)

    def begin(self, work: Awaitable[None]) -> asyncio.Task[None]:
        """Starts a task; `close` waits for it."""
        task = asyncio.ensure_future(work)
        assert isinstance(task, asyncio.Task)
        self._tasks.add(task)
        task.add_done_callback(self._on_done)
        return task

    def _on_done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        error = None if task.cancelled() else task.exception()
        # asyncio itself raises `SystemExit` from the running loop.
        if isinstance(error, Exception):
            _LOG.error("a task of %r failed", self, exc_info=error)

    async def _publish(
        self,
        topic: str,
        recipient: str | None,
        value: Any,
        urgency: str,
        codec: CodecLike,
        expires_after: float | None,
        retained: Retain = False,
    ) -> None:
        self._session.check()
        payload = payload_of(value, codec_of(codec))
        # The router answers when it keeps a value.
        is_small = len(payload.bytes) < _rect.LARGE_BYTES and not retained
        is_open = self._session.urgency_sessions.is_open(urgency)
        if is_small and is_open and (recipient is None or self._session.recipients.is_reachable(recipient)):
            self._robot._publish(topic, recipient, payload, urgency, None, expires_after)
        else:
            arguments = (topic, recipient, payload, urgency, None, expires_after, retained)
            await asyncio.to_thread(self._robot._publish, *arguments)


class _Handle:
    """Wraps a handle of `rect` that is to be closed."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle

    def close(self) -> None:
        """Closes the handle; see the class of the same name in `rect`."""
        self._handle.close()

    async def __aenter__(self: H) -> H:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class Publisher(_Handle, Generic[T]):
    """Publishes on one topic, and reports whether there are subscribers; see `rect.Publisher`."""

    def __init__(self, publisher: BlockingPublisher[T]) -> None:
        super().__init__(publisher)
        self._publisher = publisher

    @property
    def topic(self) -> str:
        """Topic of the messages."""
        return self._publisher.topic

    @property
    def has_subscribers(self) -> bool:
        """Whether at least one subscriber of another program receives the messages."""
        return self._publisher.has_subscribers

    async def publish(self, value: T) -> None:
        """Publishes `value` to every subscriber; see `rect.Publisher.publish`."""
        await asyncio.to_thread(self._publisher.publish, value)

    async def wait_for_subscriber(self, timeout: float) -> None:
        """Waits until a subscriber receives the messages; see `rect.Publisher.wait_for_subscriber`."""
        await asyncio.to_thread(self._publisher.wait_for_subscriber, timeout)


class _Source(_Handle, Generic[T]):
    """Iterates over items with `async for`. `pop` waits for the next item, or raises `Ended` or `TimeoutError`."""

    def __init__(self, handle: Any, expected: str, pop: Callable[[float | None], Awaitable[T]]) -> None:
        super().__init__(handle)
        self._expected = expected
        self._pop = pop

    async def _next(self, timeout: float | None) -> T:
        try:
            return await self._pop(timeout)
        except Ended:
            raise self._handle._session.closed_error(self._handle._HANDLE) from None
        except TimeoutError:
            raise TimedOut(self._expected, timeout or 0) from None

    def __aiter__(self: H) -> H:
        return self

    async def __anext__(self) -> T:
        try:
            return await self._pop(None)
        except Ended:
            raise StopAsyncIteration from None


class Subscriber(_Source[Message[T]], Generic[T]):
    """Receives the messages of a pattern, for `async for`; see `rect.Subscriber`."""

    def __init__(self, subscriber: BlockingSubscriber[T]) -> None:
        super().__init__(subscriber, f"message {subscriber._description}", self._take)
        self._subscriber = subscriber

    async def next(self, timeout: float | None = None) -> Message[T]:
        """Waits for the next message and returns it; see `rect.Subscriber.next`."""
        return await self._next(timeout)

    @property
    def dropped(self) -> int:
        """Number of messages dropped because the receive queue was full."""
        return self._subscriber.dropped

    @property
    def counts_by_sender(self) -> dict[str, SenderCounts]:
        """Numbers of received and missed messages, by sender."""
        return self._subscriber.counts_by_sender

    def __enter__(self) -> Subscriber[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    async def _take(self, timeout: float | None) -> Message[T]:
        deadline = Deadline(timeout)
        while True:
            message: Message[T] = undecoded(await self._subscriber._queue.pop_async(deadline.remaining()))
            if not message.is_expired and not (await self._decoded(message)).is_expired:
                return message
            self._subscriber._session.counters.on_expired()

    async def _decoded(self, message: Message[T]) -> Message[T]:
        decoder = self._subscriber._session.decoder
        try:
            message.payload = decoder.payload_now(message.sender, message.payload)
        except CodecError as error:
            if error.dictionary is None:
                message.problem = error
            else:
                # Fetching the dictionary blocks, so it happens on another thread.
                return await asyncio.to_thread(self._subscriber._decoded, message)
        return self._subscriber.fitted(message)


class Events(_Source[Event]):
    """Iterates over events with `async for`; see `rect.Events`."""

    counts_by_sender: Mapping[str, SenderCounts] = {}

    def __init__(self, events: BlockingEvents) -> None:
        super().__init__(events, events._EXPECTED, events.next_async)
        self._events = events

    async def next(self, timeout: float | None = None) -> Event:
        """Waits for the next event and returns it; see `rect.Events.next`."""
        return await self._next(timeout)

    @property
    def dropped(self) -> int:
        """Number of events dropped because the receive queue was full."""
        return self._events.dropped


class Logs(_Source[LogLine]):
    """Iterates over lines of logs with `async for`; see `rect.Logs`."""

    def __init__(self, logs: BlockingLogs) -> None:
        super().__init__(logs, logs._expected, logs.next_async)
        self._logs = logs

    async def next(self, timeout: float | None = None) -> LogLine:
        """Waits for the next line and returns it; see `rect.Logs.next`."""
        return await self._next(timeout)

    @property
    def robots(self) -> list[str]:
        """Names of the robots that have answered so far; see `rect.Logs.robots`."""
        return self._logs.robots

    @property
    def missed(self) -> int:
        """How often new lines were missed; see `rect.Logs.missed`."""
        return self._logs.missed


class Subscription(Generic[T]):
    """Calls a callback for each item of a subscriber, watch or event source, one call at a time, in the event loop.

    It ends when it or the robot is closed. An exception of the callback is logged (`logging.getLogger("rect")`), and
    the callback is called again for the next item.
    """

    def __init__(self, robot: Robot, source: Any, callback: Callable[[T], object], about: str) -> None:
        self._source = source
        self._callback = callback
        self._about = about
        self._task = robot.begin(self._run())

    @property
    def dropped(self) -> int:
        """Number of messages, frames or events dropped because the receive queue was full."""
        return int(self._source.dropped)

    @property
    def counts_by_sender(self) -> dict[str, SenderCounts]:
        """Number of received and missed messages by sender. Empty for frames and events."""
        return dict(self._source.counts_by_sender)

    def close(self) -> None:
        """Ends the subscription. Does not wait for a running callback."""
        self._source.close()

    def __repr__(self) -> str:
        return f"Subscription({self._about})"

    async def _run(self) -> None:
        async for item in self._source:
            try:
                result = self._callback(item)
                if inspect.isawaitable(result):
                    await result
            except Exception:
                _LOG.exception("the callback for %s raised an exception", self._about)


class ParameterGroup(BlockingParameterGroup):
    """A group of parameters of this program, which are its attributes; see `rect.ParameterGroup`.

    The functions that check a change are called in the event loop, too. They are plain functions.
    """

    __slots__ = ("_robot",)
    _robot: Robot

    def __init__(self, robot: Robot, executor: GroupExecutor) -> None:
        super().__init__(executor)
        self._robot = robot
        robot.begin(executor.serve_async())

    def on_change(self, callback: OnChangeT) -> OnChangeT:
        """Calls `callback` after each change, in the event loop; see `rect.ParameterGroup.on_change`."""
        changes = self._executor.changes(callback)
        source = _Source(changes, "change", changes.queue.pop_async)
        Subscription(self._robot, source, callback, f"changes of {self._executor.name}")
        return callback

    async def __aenter__(self) -> ParameterGroup:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class ActionRun(AsyncRun[T]):
    """A goal that this program has started or found; see `rect.ActionRun`.

    `async for feedback in run` iterates over the feedback until the goal ends.
    """

    def __init__(self, robot: Robot, following: Following) -> None:
        super().__init__(following)
        self._robot = robot

    def on_feedback(self, callback: Callable[[Feedback], object]) -> Subscription[Feedback]:
        """Calls `callback` with each `Feedback` in the event loop; see `rect.ActionRun.on_feedback`."""
        if not callable(callback):
            raise TypeError(f"callback must be a function, not {type(callback).__name__}")
        feed = self._following.feed(self)
        source = _Source(feed, "feedback", feed.queue.pop_async)
        return Subscription(self._robot, source, callback, f"feedback of {self.action}")

    async def __aenter__(self) -> ActionRun[T]:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class StreamSender(_Handle):
    """Sends the frames of a stream; see `rect.StreamSender`."""

    def __init__(self, stream: BlockingStreamSender) -> None:
        super().__init__(stream)
        self._stream = stream

    async def send(self, frame: Any) -> int:
        """Sends a frame if a receiver is due for one; see `rect.StreamSender.send`. Another thread encodes pictures."""
        return await asyncio.to_thread(self._stream.send, frame)

    @property
    def status(self) -> dict[str, Any]:
        """State of the stream; see `rect.StreamSender.status`."""
        return self._stream.status


class Watcher(_Source[Frame]):
    """Receives the frames of a stream, for `async for`; see `rect.Watcher`."""

    counts_by_sender: Mapping[str, SenderCounts] = {}

    def __init__(self, watch: BlockingWatcher) -> None:
        super().__init__(watch, f"frame of {watch._name}", watch.next_async)
        self._watch = watch

    async def next(self, timeout: float | None = None) -> Frame:
        """Waits for a frame that was not returned yet and returns it; see `rect.Watcher.next`."""
        return await self._next(timeout)

    def ask_for_key_frame(self) -> None:
        """Asks the sender of a video for a key frame; see `rect.Watcher.ask_for_key_frame`."""
        self._watch.ask_for_key_frame()

    @property
    def dropped(self) -> int:
        """Number of frames dropped because the receive queue was full; see `rect.Watcher.dropped`."""
        return self._watch.dropped

    @property
    def round_trip(self) -> float | None:
        """Round trip of a small message to the sender, in seconds. `None` until it is measured."""
        return self._watch.round_trip


class Transfers(_Source[Received]):
    """Iterates over the transfers that ended, with `async for`; see `rect.Transfers`."""

    def __init__(self, transfers: BlockingTransfers) -> None:
        super().__init__(transfers, f"transfer {transfers._pattern}", transfers.next_async)

    async def next(self, timeout: float | None = None) -> Received:
        """Waits until a transfer ends and returns it; see `rect.Transfers.next`."""
        return await self._next(timeout)


class Replies(_Handle, Generic[T]):
    """Iterates over the replies to one request, with `async for`; see `rect.Replies`."""

    def __init__(self, replies: BlockingReplies[T]) -> None:
        super().__init__(replies)
        self._replies = replies

    def __aiter__(self) -> AsyncIterator[Reply[T]]:
        return self

    async def __anext__(self) -> Reply[T]:
        reply = await self._replies.next_async()
        if reply is None:
            raise StopAsyncIteration
        return reply

    async def gather(self) -> Gathered[T]:
        """Waits for the outcomes of all robots that serve the topic; see `rect.Replies.gather`."""
        return await self._replies.gather_async()


class Service:
    """Answers the requests to a topic by calling a function; see `rect.Service`."""

    def __init__(self, robot: Robot, topic: str, handler: Handler, about: str | None, allow_several: bool) -> None:
        self._topic = topic
        self._handler = handler
        self._robot = robot
        self._requests = Requests(robot._session, topic, handler, about, allow_several)
        self._room = asyncio.Semaphore(_rect.MAX_CONCURRENT)
        self._task = robot.begin(self._run())

    def close(self) -> None:
        """Ends the service. Requests that are being handled are still answered."""
        self._requests.close()

    def __call__(self, request: Request[Any]) -> Any:
        """Calls the handler, so that a function decorated by `@robot.serve` remains callable."""
        return self._handler(request)

    def __repr__(self) -> str:
        return f"Service({self._topic})"

    async def _run(self) -> None:
        while True:
            await self._room.acquire()
            try:
                request = await self._requests.next_async()
            except Ended:
                return
            self._robot.begin(self._answer(request))

    async def _answer(self, request: Request[Any]) -> None:
        try:
            try:
                result = self._handler(request)
                if inspect.isasyncgen(result):
                    async for value in result:
                        request.reply(value)
                        if request.has_left:
                            break
                    request.finish()
                    return
                if inspect.isgenerator(result):
                    request.reply_all(result)
                    return
                request.reply(await result if inspect.isawaitable(result) else result)
                request.finish()
            except Exception as error:
                request.refuse_for(error)
            except asyncio.CancelledError:
                request.refuse("the service was closed")
                raise
            except BaseException as error:
                # `sys.exit` ends the loop. The requester is informed first.
                request.refuse_for(error)
                raise
        except Exception as error:
            _LOG.warning("cannot send a reply: %s", error)
        finally:
            request.close()
            self._room.release()


_complete_annotations({})
