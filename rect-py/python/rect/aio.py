"""The same for asyncio: the names of `rect`, where what waits is awaited, and what iterates goes by `async for`.

    async with rect.aio.connect("wombat-1") as robot:
        await robot.publish("arm/angle", {"degrees": 12.5})
        async for message in robot.subscribe("*/arm/angle"):
            print(message.sender, message.value)

A robot belongs to the loop that it was made in. Callbacks and handlers may be plain functions or `async def`; they run
on the loop.
"""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

import zenoh as stock

from rect import _rect
from rect import robot as blocking
from rect._zenoh import LARGE_BYTES
from rect.errors import CodecError, NoService, TimedOut
from rect.inbox import DEFAULT_CAPACITY, Ended
from rect.message import Message
from rect.options import Options, seconds, text
from rect.registry import Connections
from rect.request import Replies as BlockingReplies
from rect.request import Reply
from rect.robot import DEFAULT_TIMEOUT, CodecLike
from rect.service import AT_A_TIME, Request, Requests
from rect.state import Counters, Event
from rect.state import Events as BlockingEvents
from rect.stream import Frame
from rect.stream import Stream as BlockingStream
from rect.stream import Watch as BlockingWatch
from rect.subscriber import Subscriber as BlockingSubscriber
from rect.subscriber import Tally, as_it_came, callable_or_none
from rect.transfer import Progress, Received
from rect.transfer import Transfers as BlockingTransfers
from rect.values import codec_of, payload_of

T = TypeVar("T")
H = TypeVar("H", bound="_Handle")
_LOG = logging.getLogger("rect")
Handler = Callable[[Request], Any]


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
) -> Connecting:
    """Joins, as `rect.connect`: `async with connect(...) as robot:`, or `robot = await connect(...)`."""
    settings = zenoh or {}
    options = (fleet, router, endpoints, listen, login, login_file, timeout, settings, allow_name_mismatch)
    return Connecting(Options(name, *options))


class Connecting:
    """A robot that is to be awaited."""

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
    """A program of a robot; see `rect.Robot`."""

    def __init__(self, robot: blocking.Robot) -> None:
        self._robot = robot
        self._session = robot._session
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def name(self) -> str:
        """This robot's name."""
        return self._robot.name

    @property
    def fleet(self) -> str:
        """The fleet's name."""
        return self._robot.fleet

    @property
    def zenoh(self) -> stock.Session:
        """The session of Zenoh below."""
        return self._robot.zenoh

    @property
    def is_closed(self) -> bool:
        """Whether it was closed."""
        return self._robot.is_closed

    async def publish(self, topic: str, value: Any, *, urgency: str = "normal", codec: CodecLike = None) -> None:
        """Says it to all; see `rect.Robot.publish`."""
        await self._say(topic, None, value, urgency, codec)

    async def send(
        self, robot: str, topic: str, value: Any, *, urgency: str = "normal", codec: CodecLike = None
    ) -> None:
        """Says it to one robot alone; see `rect.Robot.send`."""
        await self._say(topic, text("robot", robot), value, urgency, codec)

    @overload
    def subscribe(
        self,
        pattern: str,
        callback: None = None,
        *,
        capacity: int = DEFAULT_CAPACITY,
        when_full: str = "newest wins",
    ) -> Subscriber: ...
    @overload
    def subscribe(
        self,
        pattern: str,
        callback: Callable[[Message], object],
        *,
        capacity: int = DEFAULT_CAPACITY,
        when_full: str = "newest wins",
    ) -> Subscription[Message]: ...
    def subscribe(
        self,
        pattern: str,
        callback: Callable[[Message], object] | None = None,
        *,
        capacity: int = DEFAULT_CAPACITY,
        when_full: str = "newest wins",
    ) -> Subscriber | Subscription[Message]:
        """The messages of a pattern, for `async for` or a callback; see `rect.Robot.subscribe`."""
        callable_or_none(callback)
        subscriber = Subscriber(self._robot.subscribe(pattern, capacity=capacity, when_full=when_full))
        return subscriber if callback is None else Subscription(self, subscriber, callback, pattern)

    async def listen(self, robot: str, topic: str, timeout: float | None = None) -> Message:
        """The next message of a robot about a topic; see `rect.Robot.listen`."""
        if timeout is not None:
            seconds("timeout", timeout)
        with self.subscribe(_rect.pattern_of(text("robot", robot), text("topic", topic))) as subscriber:
            return await subscriber.next(timeout)

    async def request(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: str = "normal",
        codec: CodecLike = None,
    ) -> Reply:
        """Asks a service of a robot, and waits for its first answer; see `rect.Robot.request`."""
        replies = self._robot._ask(text("robot", robot), topic, value, timeout, urgency, codec)
        try:
            reply = await replies.next_async()
        finally:
            replies.leave()
        if reply is None:
            raise NoService(robot, topic, await self.peers())
        return reply

    def request_all(
        self,
        topic: str,
        value: Any = "",
        *,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: str = "normal",
        codec: CodecLike = None,
    ) -> Replies:
        """Asks a service of all robots that have it, for `async for`; see `rect.Robot.request_all`."""
        return Replies(self._robot._ask(None, topic, value, timeout, urgency, codec))

    @overload
    def serve(self, topic: str) -> Callable[[Handler], Service]: ...
    @overload
    def serve(self, topic: str, handler: Handler) -> Service: ...
    def serve(self, topic: str, handler: Handler | None = None) -> Service | Callable[[Handler], Service]:
        """Serves a topic by a function or an `async def`, which may yield several answers; see `rect.Robot.serve`."""
        self._session.check()
        text("topic", topic)
        if handler is None:
            return lambda handler: self.serve(topic, handler)
        if not callable(handler):
            raise TypeError(f"handler is a function, not a {type(handler).__name__}")
        return Service(self, topic, handler)

    def stream(self, topic: str, **options: Any) -> Stream:
        """A stream of which the newest frame counts; see `rect.Robot.stream`."""
        return Stream(self._robot.stream(topic, **options))

    @overload
    def watch(
        self, robot: str, topic: str, callback: None = None, *, capacity: int = 1, when_full: str = "newest wins"
    ) -> Watch: ...
    @overload
    def watch(
        self,
        robot: str,
        topic: str,
        callback: Callable[[Frame], object],
        *,
        capacity: int = 1,
        when_full: str = "newest wins",
    ) -> Subscription[Frame]: ...
    def watch(
        self,
        robot: str,
        topic: str,
        callback: Callable[[Frame], object] | None = None,
        *,
        capacity: int = 1,
        when_full: str = "newest wins",
    ) -> Watch | Subscription[Frame]:
        """Watches a robot's stream, for `async for` or a callback; see `rect.Robot.watch`."""
        callable_or_none(callback)
        watch = Watch(self._robot.watch(robot, topic, capacity=capacity, when_full=when_full))
        return watch if callback is None else Subscription(self, watch, callback, f"{robot}/{topic}")

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
        """Transfers a file or bytes of any size to one robot; cancelled, it stops. See `rect.Robot.transfer`."""
        loop = asyncio.get_running_loop()
        told = on_progress and (lambda progress: loop.call_soon_threadsafe(on_progress, progress))
        sending = await asyncio.to_thread(self._robot.sending, robot, topic, data, name, timeout, told)
        try:
            await asyncio.to_thread(sending.run)
        finally:
            sending.stop()

    def receive_transfers(self, pattern: str, **options: Any) -> Transfers:
        """Takes the transfers of a pattern, for `async for`; see `rect.Robot.receive_transfers`."""
        return Transfers(self._robot.receive_transfers(pattern, **options))

    def share(self, dictionary: _rect.Dictionary) -> _rect.Codec:
        """Gives a dictionary to whoever asks for it; see `rect.Robot.share`."""
        return self._robot.share(dictionary)

    async def peers(self) -> list[str]:
        """The other robots of the fleet that are there now, by name."""
        return await asyncio.to_thread(self._robot.peers)

    async def connections(self, robot: str | None = None, which: str = "") -> Connections:
        """The connections of a robot's router; see `rect.Robot.connections`."""
        return await asyncio.to_thread(self._robot.connections, robot, which)

    async def add_connection(self, name: str, method: str, address: str, **options: Any) -> None:
        """Gives a robot's router a connection; see `rect.Robot.add_connection`."""
        await asyncio.to_thread(lambda: self._robot.add_connection(name, method, address, **options))

    async def remove_connection(self, name: str, *, robot: str | None = None) -> None:
        """Takes a connection from a robot's router; see `rect.Robot.remove_connection`."""
        await asyncio.to_thread(lambda: self._robot.remove_connection(name, robot=robot))

    async def ask_registry(self, question: str, *, robot: str | None = None, which: str = "") -> Any:
        """Any other question of the registry; see `rect.Robot.ask_registry`."""
        return await asyncio.to_thread(lambda: self._robot.ask_registry(question, robot=robot, which=which))

    @overload
    def on_state(self, callback: None = None) -> Events: ...
    @overload
    def on_state(self, callback: Callable[[Event], object]) -> Subscription[Event]: ...
    def on_state(self, callback: Callable[[Event], object] | None = None) -> Events | Subscription[Event]:
        """What changes about who can be reached, for `async for` or a callback; see `rect.Robot.on_state`."""
        callable_or_none(callback)
        events = Events(self._robot.on_state())
        return events if callback is None else Subscription(self, events, callback, "state")

    def counters(self) -> Counters:
        """What this program has said and heard."""
        return self._robot.counters()

    async def close(self) -> None:
        """Ends the session, and all that belongs to it."""
        await asyncio.to_thread(self._robot.close)
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def __aenter__(self) -> Robot:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return repr(self._robot)

    def begin(self, work: Awaitable[None]) -> asyncio.Task[None]:
        """A task that lives no longer than the robot."""
        task = asyncio.ensure_future(work)
        assert isinstance(task, asyncio.Task)
        self._tasks.add(task)
        task.add_done_callback(self._on_done)
        return task

    def _on_done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        error = None if task.cancelled() else task.exception()
        # `sys.exit` has ended the loop, and asyncio raises it where the loop runs.
        if isinstance(error, Exception):
            _LOG.error("a task of %r failed", self, exc_info=error)

    async def _say(self, topic: str, to: str | None, value: Any, urgency: str, codec: CodecLike) -> None:
        self._session.check()
        payload = payload_of(value, codec_of(codec))
        if len(payload.bytes) < LARGE_BYTES and self._session.lanes.is_open(urgency):
            self._robot._say(topic, to, payload, urgency, None)
        else:
            await asyncio.to_thread(self._robot._say, topic, to, payload, urgency, None)


class _Handle:
    """What ends when it is closed; see the one of the same name in `rect`, which does it."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle

    def close(self) -> None:
        """Ends it."""
        self._handle.close()

    async def __aenter__(self: H) -> H:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class _Coming(_Handle, Generic[T]):
    """What comes, one after another, for `async for`; `pop` waits for the next, or raises `Ended` or `TimeoutError`."""

    def __init__(self, handle: Any, what: str, pop: Callable[[float | None], Awaitable[T]]) -> None:
        super().__init__(handle)
        self._what = what
        self._pop = pop

    async def _next(self, timeout: float | None) -> T:
        try:
            return await self._pop(timeout)
        except Ended:
            raise self._handle._session.closed_error() from None
        except TimeoutError:
            raise TimedOut(self._what, timeout or 0) from None

    def __aiter__(self: H) -> H:
        return self

    async def __anext__(self) -> T:
        try:
            return await self._pop(None)
        except Ended:
            raise StopAsyncIteration from None


class Subscriber(_Coming[Message]):
    """The messages of a pattern, as they come, for `async for`; see `rect.Subscriber`."""

    def __init__(self, subscriber: BlockingSubscriber) -> None:
        super().__init__(subscriber, f"message {subscriber._pattern}", self._take)
        self._subscriber = subscriber

    async def next(self, timeout: float | None = None) -> Message:
        """The next message, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        return await self._next(timeout)

    @property
    def dropped(self) -> int:
        """How many were dropped because the program did not take them in time."""
        return self._subscriber.dropped

    @property
    def tallies(self) -> dict[str, Tally]:
        """How many came of each robot, and how many of its did not."""
        return self._subscriber.tallies

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    async def _take(self, timeout: float | None) -> Message:
        message = as_it_came(await self._subscriber._inbox.pop_async(timeout))
        decoder = self._subscriber._session.decoder
        try:
            message.payload = decoder.payload_now(message.sender, message.payload)
        except CodecError as error:
            if error.dictionary is None:
                message.flaw = error
            else:
                # The dictionary has to come first; others of the loop go on meanwhile.
                await asyncio.to_thread(self._subscriber._unpacked, message)
        return message


class Events(_Coming[Event]):
    """What changes about who can be reached, for `async for`; see `rect.Events`."""

    dropped = 0
    tallies: Mapping[str, Tally] = {}

    def __init__(self, events: BlockingEvents) -> None:
        super().__init__(events, events._WHAT, events._inbox.pop_async)

    async def next(self, timeout: float | None = None) -> Event:
        """The next one, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        return await self._next(timeout)


class Subscription(Generic[T]):
    """A callback that is called for each of what comes, one after another, until this is closed, or the robot is.

    A callback that raises is reported (`logging.getLogger("rect")`), and called again for the next.
    """

    def __init__(self, robot: Robot, source: Any, callback: Callable[[T], object], about: str) -> None:
        self._source = source
        self._callback = callback
        self._about = about
        self._task = robot.begin(self._run())

    @property
    def dropped(self) -> int:
        """How many were dropped because the callback was not done in time."""
        return int(self._source.dropped)

    @property
    def tallies(self) -> dict[str, Tally]:
        """How many came of each robot, and how many of its did not."""
        return dict(self._source.tallies)

    def close(self) -> None:
        """Ends it. A call that runs is not waited for."""
        self._source.close()

    def __repr__(self) -> str:
        return f"Subscription({self._about})"

    async def _run(self) -> None:
        async for what in self._source:
            try:
                said = self._callback(what)
                if inspect.isawaitable(said):
                    await said
            except Exception:
                _LOG.exception("the callback for %s raised", self._about)


class Stream(_Handle):
    """A stream that this program sends; see `rect.Stream`."""

    def __init__(self, stream: BlockingStream) -> None:
        super().__init__(stream)
        self._stream = stream

    async def send(self, frame: Any) -> int:
        """Sends a frame, if anyone wants one now; pictures are made smaller beside the loop."""
        return await asyncio.to_thread(self._stream.send, frame)

    @property
    def status(self) -> dict[str, Any]:
        """What goes out, what gets through, and why it is as it is."""
        return self._stream.status


class Watch(_Coming[Frame]):
    """A stream that this program watches, for `async for`; see `rect.Watch`."""

    dropped = 0
    tallies: Mapping[str, Tally] = {}

    def __init__(self, watch: BlockingWatch) -> None:
        super().__init__(watch, f"frame of {watch._name}", watch.next_async)
        self._watch = watch

    async def next(self, timeout: float | None = None) -> Frame:
        """The newest frame, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        return await self._next(timeout)

    @property
    def round_trip(self) -> float | None:
        """What a small message takes to the sender and back, in seconds, once it has answered one."""
        return self._watch.round_trip


class Transfers(_Coming[Received]):
    """The transfers that come, for `async for`; see `rect.Transfers`."""

    def __init__(self, transfers: BlockingTransfers) -> None:
        super().__init__(transfers, f"transfer {transfers._pattern}", transfers.next_async)

    async def next(self, timeout: float | None = None) -> Received:
        """The next one that ended, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        return await self._next(timeout)


class Replies(_Handle):
    """The answers to one request, as they come, for `async for`; see `rect.Replies`."""

    def __init__(self, replies: BlockingReplies) -> None:
        super().__init__(replies)
        self._replies = replies

    def __aiter__(self) -> AsyncIterator[Reply]:
        return self

    async def __anext__(self) -> Reply:
        reply = await self._replies.next_async()
        if reply is None:
            raise StopAsyncIteration
        return reply


class Service:
    """A service that answers by a function, until this is closed, or the robot is. Up to 16 requests at a time."""

    def __init__(self, robot: Robot, topic: str, handler: Handler) -> None:
        self._topic = topic
        self._handler = handler
        self._robot = robot
        self._requests = Requests(robot._session, topic)
        self._room = asyncio.Semaphore(AT_A_TIME)
        self._task = robot.begin(self._run())

    def close(self) -> None:
        """Ends it. What is worked on is still answered."""
        self._requests.close()

    def __call__(self, request: Request) -> Any:
        """The function itself, so that what `@robot.serve` decorates stays one."""
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

    async def _answer(self, request: Request) -> None:
        try:
            try:
                said = self._handler(request)
                if inspect.isasyncgen(said):
                    async for one in said:
                        request.reply(one)
                    return
                if inspect.isgenerator(said):
                    for one in said:
                        request.reply(one)
                    return
                request.reply(await said if inspect.isawaitable(said) else said)
            except Exception as error:
                request.refuse_for(error)
            except asyncio.CancelledError:
                request.refuse("the service ends")
                raise
            except BaseException as error:
                # `sys.exit` ends the loop; the requester is told so first.
                request.refuse_for(error)
                raise
        except Exception as error:
            _LOG.warning("an answer was not sent: %s", error)
        finally:
            request.close()
            self._room.release()
