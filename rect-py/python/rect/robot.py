"""Owns a program's place among the robots: the session, and what it says."""

from __future__ import annotations

import atexit
import contextlib
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Union, overload

import zenoh

from rect import _rect, registry, state
from rect._zenoh import LARGE_BYTES, patiently, refused
from rect.decoder import Decoder
from rect.errors import Closed, NoService
from rect.inbox import DEFAULT_CAPACITY, Inbox
from rect.lanes import Lanes
from rect.message import Message
from rect.options import DEFAULT_LOGIN_FILE, Options, seconds, text
from rect.publication import Publication
from rect.registry import Connections
from rect.request import Replies, Reply
from rect.service import Request, Service
from rect.state import Counters, Counting, Event, Events, Known
from rect.stream import Frame, Stream, Watch
from rect.subscriber import Declared, Subscriber, Subscription, callable_or_none, undeclared
from rect.transfer import OnProgress, Progress, Received, Sending, Transfers
from rect.values import codec_of, payload_of

#: The most topics whose publishers are kept; of more, they are declared anew when one speaks about them again.
_MAX_PUBLICATIONS = 256
#: How long a request waits unless told otherwise, in seconds.
DEFAULT_TIMEOUT: float = _rect.DEFAULT_TIMEOUT_MS / 1000

#: The largest transfer that is taken unless told otherwise.
DEFAULT_MAX_BYTES = 64 << 20

Handler = Callable[[Request], Any]
CodecLike = Union[str, _rect.Codec, None]


def connect(
    name: str,
    *,
    fleet: str = "rect",
    router: str | None = None,
    endpoints: Sequence[str] = (),
    listen: Sequence[str] = (),
    login: tuple[str, str] | None = None,
    login_file: str | Path = DEFAULT_LOGIN_FILE,
    timeout: float = 5.0,
    zenoh: Mapping[str, Any] | None = None,
) -> Robot:
    """Joins as a program of that robot, at the router of this computer.

    - `fleet`: the team's name.
    - `router`: another router, as `tcp/192.168.0.7:7447`; default: what the environment's `RECT_ENDPOINT` says, else
      `tcp/127.0.0.1:7447`.
    - `endpoints`, `listen`: without a router: whom to connect to directly, and where others may connect to this
      program,
      as `["ble/wombat-2"]`, `["tcp/0.0.0.0:7447"]`. They are dialled until they are there; joining does not wait for
      that.
    - `login`: user and password; default: the first line of `login_file`, `user:password`, if it can be read.
    - `timeout`: how long to wait for the router, in seconds, so that a program may be started together with it.
    - `zenoh`: any setting of Zenoh's configuration, by its path; goes before ours.

    Raises `NoRouter`, `InvalidNameError`, `OptionError`.

    >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
    ...     robot.publish("greeting", "hello")
    """
    return Robot(Options(name, fleet, router, endpoints, listen, login, login_file, timeout, zenoh or {}))


class Session:
    """What all of one program's handles share: the session below, and what has to end with it."""

    def __init__(self, options: Options) -> None:
        if _FORKED:
            raise Closed(_AFTER_FORK)
        self.place = options.place()
        self.is_direct = options.is_direct
        _ONCE_OPEN[:] = [True]
        self.zenoh = options.open()
        self.lanes = Lanes(self.zenoh, None if self.is_direct else options.open)
        self.decoder = Decoder(self.zenoh, self.place)
        self.counting = Counting()
        #: Whatever is declared, until it ends.
        self.handles: set[Declared] = set()
        #: What nobody has any more, and is to be ended where that may take a moment.
        self.left: deque[Declared | Replies] = deque()
        #: Where somebody waits for answers.
        self.inboxes: set[Inbox[Any]] = set()
        #: Called when it closes, before Zenoh does.
        self.endings: list[Callable[[], object]] = []
        self._threads: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._why_closed: str | None = None
        self._publications: dict[tuple[str, str | None, str], Publication] = {}
        self.known: Known | None = None
        self._presence: zenoh.LivelinessToken | None = None
        _OPEN.add(self)
        try:
            if self.is_direct:
                self._presence = state.say_there(self.zenoh, self.place)
            else:
                self.known = Known(self)
        except BaseException:
            self.close()
            raise

    @property
    def is_closed(self) -> bool:
        return self._why_closed is not None

    def closed_error(self) -> Closed:
        return Closed(self._why_closed or "the session is closed")

    def check(self) -> None:
        """Raises if it is closed; ends what nobody has any more."""
        if self._why_closed is not None:
            raise self.closed_error()
        while self.left:
            with contextlib.suppress(IndexError):
                self.left.popleft().end()

    def publication(self, topic: str, to: str | None, urgency: str) -> Publication:
        spoken = (topic, to, urgency)
        known = self._publications.get(spoken)
        if known is not None:
            return known
        place = self.place
        key = place.publication(topic) if to is None else place.message(to, topic)
        made = Publication(self.lanes.of(urgency), key, urgency, self.check)
        with self._lock:
            if len(self._publications) >= _MAX_PUBLICATIONS:
                self._publications.clear()
            return self._publications.setdefault(spoken, made)

    def close(self) -> None:
        with self._lock:
            if self._why_closed is not None:
                return
            self._why_closed = "the session is closed"
        for ending in list(self.endings):
            ending()
        for handle in list(self.handles):
            handle.end()
        for inbox in list(self.inboxes):
            inbox.close()
        if self._presence is not None:
            undeclared(self._presence)
        _OPEN.discard(self)
        try:
            patiently(self.lanes.close)
        except zenoh.ZError as error:
            raise refused("the session does not close", error) from None
        finally:
            self._finish()

    def start(self, name: str, run: Callable[[], object]) -> None:
        """Runs something on a thread of its own, which ends soon after the session does."""
        thread = threading.Thread(target=run, name=name, daemon=True)
        self._threads.add(thread)
        thread.start()

    def _finish(self) -> None:
        """Waits for what is in Zenoh still: where Python ends, nobody may be."""
        with self._lock:
            publications = list(self._publications.values())
        for publication in publications:
            publication.finish(_FINISH_S)
        for thread in list(self._threads):
            if thread is not threading.current_thread():
                thread.join(_FINISH_S)

    def on_fork(self) -> None:
        """In a child process, where Zenoh's threads are not: nothing of it may be touched, not even to end it."""
        self._why_closed = _AFTER_FORK
        # With it all of Zenoh's that it leads to: their ends would wait for locks that the parent's threads held.
        _rect.forget(self)
        for inbox in list(self.inboxes):
            inbox.on_fork()
        for handle in list(self.handles):
            handle.on_fork()


#: How long the end waits for one that is in Zenoh still, in seconds.
_FINISH_S = 1.0
_AFTER_FORK = (
    "Zenoh does not work in a process that was forked from one where it ran: fork before rect.connect, or start "
    'processes by multiprocessing.get_context("spawn")'
)
#: Whether a robot was joined in the process that this one was forked from.
_FORKED: list[bool] = []
#: Whether one was joined in this process.
_ONCE_OPEN: list[bool] = []
#: All that are open: they end before Python does, whose threads Zenoh's would wait for.
_OPEN: weakref.WeakSet[Session] = weakref.WeakSet()


def _close_all() -> None:
    for session in list(_OPEN):
        with contextlib.suppress(Exception):
            session.close()


def _on_fork() -> None:
    if _ONCE_OPEN:
        _FORKED[:] = [True]
    for session in list(_OPEN):
        session.on_fork()
        _OPEN.discard(session)


atexit.register(_close_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_on_fork)


class Robot:
    """A program of a robot, joined with the others. Made by `connect`; may be used by several threads."""

    def __init__(self, options: Options) -> None:
        self._session = Session(options)

    @property
    def name(self) -> str:
        """This robot's name."""
        return self._session.place.robot

    @property
    def fleet(self) -> str:
        """The fleet's name."""
        return self._session.place.fleet

    @property
    def zenoh(self) -> zenoh.Session:
        """The session of Zenoh below, for whatever Zenoh can do and this has no word for. What is urgent, and bulk,
        goes over sessions of their own where there is a router."""
        session: zenoh.Session = self._session.zenoh
        return session

    @property
    def is_closed(self) -> bool:
        """Whether it was closed."""
        return self._session.is_closed

    def publish(self, topic: str, value: Any, *, urgency: str = "normal", codec: CodecLike = None) -> None:
        """Says it to all.

        `value`: text, bytes, a picture, a numpy array, or what JSON can say: dicts, lists, numbers, dataclasses...
        `urgency`: `urgent` overtakes everything else, `bulk` is overtaken. `codec`: makes it smaller, as `zstd:9`,
        `jpeg:60` or `packing(dictionary)`.

        Raises `InvalidTopicError`, `PayloadError`, `CodecError`, `Closed`.
        """
        self._say(topic, None, value, urgency, codec)

    def send(self, robot: str, topic: str, value: Any, *, urgency: str = "normal", codec: CodecLike = None) -> None:
        """Says it to one robot alone. Nobody is asked whether it is there: `request` does that.

        Raises as `publish`, and `InvalidNameError`.
        """
        self._say(topic, text("robot", robot), value, urgency, codec)

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
        """The messages of a pattern, `<robot>/<topic>` with wildcards (`*/arm/*`): what those robots say to all, and
        to this one alone. An iterator; or, with a callback, that is called for each, one after another.

        `capacity`: how many wait for the program. `when_full`: `newest wins` (the oldest is dropped), `oldest wins`, or
        `wait` (whoever sends does).

        Raises `InvalidTopicError`, `OptionError`, `Closed`.
        """
        callable_or_none(callback)
        self._session.check()
        subscriber = Subscriber(self._session, text("pattern", pattern), capacity, when_full)
        return subscriber if callback is None else Subscription(subscriber, callback, pattern)

    def listen(self, robot: str, topic: str, timeout: float | None = None) -> Message:
        """The next message of a robot about a topic, to all or to this one alone, that is sent from now on.

        Raises `TimedOut` (seconds), `InvalidNameError`, `InvalidTopicError`, `Closed`.
        """
        if timeout is not None:
            seconds("timeout", timeout)
        with self.subscribe(_rect.pattern_of(text("robot", robot), text("topic", topic))) as subscriber:
            return subscriber.next(timeout)

    def request(
        self,
        robot: str,
        topic: str,
        value: Any = "",
        *,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: str = "normal",
        codec: CodecLike = None,
    ) -> Reply:
        """Asks a service of a robot, and waits for its first answer.

        Raises `ServiceError` (it answers with an error), `NoService` (nobody serves that there; the text says who is
        there), `TimedOut` (seconds), `InvalidNameError`, `InvalidTopicError`, `PayloadError`, `Closed`.
        """
        replies = self._ask(text("robot", robot), topic, value, timeout, urgency, codec)
        try:
            for reply in replies:
                return reply
        finally:
            replies.leave()
        raise NoService(robot, topic, self.peers())

    def request_all(
        self,
        topic: str,
        value: Any = "",
        *,
        timeout: float = DEFAULT_TIMEOUT,
        urgency: str = "normal",
        codec: CodecLike = None,
    ) -> Replies:
        """Asks a service of all robots that have it; answers come until all have answered, or the time is over."""
        return self._ask(None, topic, value, timeout, urgency, codec)

    @overload
    def serve(self, topic: str) -> Callable[[Handler], Service]: ...
    @overload
    def serve(self, topic: str, handler: Handler) -> Service: ...
    def serve(self, topic: str, handler: Handler | None = None) -> Service | Callable[[Handler], Service]:
        """Serves a topic by a function of a `Request`: what it returns is the answer; a generator gives several. What
        it raises arrives at the asker as `ServiceError`, and is logged here unless it is a `Refusal`.

        As a decorator, or called with the function:

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     @robot.serve("double")
        ...     def double(request):
        ...         return request.value * 2
        ...     robot.request("wombat-1", "double", 21).value
        42
        """
        self._session.check()
        text("topic", topic)
        if handler is None:
            return lambda handler: self.serve(topic, handler)
        if not callable(handler):
            raise TypeError(f"handler is a function, not a {type(handler).__name__}")
        return Service(self._session, topic, handler)

    def stream(
        self,
        topic: str,
        *,
        mode: str | None = None,
        codec: CodecLike = None,
        frames_per_s: float | None = None,
        least_frames_per_s: float | None = None,
        most_bytes_per_s: float | None = None,
        feedback: float | None = None,
        photographs: str = "jpeg",
        urgency: str = "normal",
    ) -> Stream:
        """A stream of which the newest frame counts: what is old, a slow link drops.

        `mode`: `adaptive` (pictures at the size, quality and rate that get through; the default without a codec),
        `fixed`
        (frames as they are, at most `frames_per_s`; the default with a codec), `sensor` (values as they come; nothing
        comes
        back). `feedback`: how often receivers say what comes, in seconds. `photographs`: `jpeg`, or `webp`, which is
        smaller and takes longer to write. docs/streams.md tells the rest.

        Raises `InvalidTopicError`, `OptionError`, `CodecError`, `Closed`.
        """
        self._session.check()
        codec = codec_of(codec)
        mode = mode or ("adaptive" if codec is None else "fixed")
        return Stream(
            self._session,
            text("topic", topic),
            text("mode", mode),
            codec,
            photographs,
            text("urgency", urgency),
            frames_per_s=frames_per_s,
            least_frames_per_s=least_frames_per_s,
            most_bytes_per_s=most_bytes_per_s,
            feedback_s=feedback,
        )

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
        """Watches a robot's stream: the newest frame waits until it is taken. An iterator; or, with a callback, that is
        called for each. A program that wants all values of a sensor gives a larger `capacity`.

        Raises `InvalidNameError`, `InvalidTopicError`, `Closed`.
        """
        callable_or_none(callback)
        self._session.check()
        watch = Watch(self._session, text("robot", robot), text("topic", topic), capacity, when_full)
        return watch if callback is None else Subscription(watch, callback, f"{robot}/{topic}")

    def transfer(
        self,
        robot: str,
        topic: str,
        data: Any,
        *,
        name: str | None = None,
        timeout: float | None = None,
        on_progress: OnProgress | None = None,
    ) -> None:
        """Transfers a file (a path, as text or `Path`) or bytes of any size to one robot, and waits until all is there
        and right. Everything else overtakes it. Links may come and go meanwhile, and either side may be restarted.

        `name`: what it is called there; default: the file's. `timeout`: how long nothing may be heard of the receiver,
        in
        seconds; default: it may come back whenever it likes. `on_progress` gets a `Progress` up to ten times a second.

        Raises `TransferRefused`, `TransferFailed`, `TimedOut`, `FileError`, `InvalidNameError`, `InvalidTopicError`.
        """
        self.sending(robot, topic, data, name, timeout, on_progress).run()

    def receive_transfers(
        self,
        pattern: str,
        *,
        folder: str | os.PathLike[str] | None = None,
        max_bytes: int = DEFAULT_MAX_BYTES,
        at_once: int = 4,
        patience: float = 600.0,
        on_progress: Callable[[Received, Progress], object] | None = None,
    ) -> Transfers:
        """Takes the transfers of a pattern (`*/maps/*`) that others send to this robot, until what this returns is
        closed: an iterator of those that ended. Without it none is taken.

        `folder`: they become files there, in a folder for each sender, and go on after a restart; default: in memory.
        `max_bytes`: larger ones are refused. `at_once`: more of them wait. `patience`: how long nothing may come
        before one is given up, in seconds.

        Raises `InvalidTopicError`, `FileError`, `Closed`.
        """
        callable_or_none(on_progress)
        self._session.check()
        return Transfers(
            self._session,
            text("pattern", pattern),
            folder=folder,
            max_bytes=max_bytes,
            at_once=at_once,
            patience=seconds("patience", patience),
            on_progress=on_progress,
        )

    def sending(
        self,
        robot: str,
        topic: str,
        data: Any,
        name: str | None = None,
        timeout: float | None = None,
        on_progress: OnProgress | None = None,
    ) -> Sending:
        """What `transfer` runs, for a program that runs it on a thread of its own and may stop it."""
        callable_or_none(on_progress)
        self._session.check()
        if timeout is not None:
            seconds("timeout", timeout)
        robot, topic = text("robot", robot), text("topic", topic)
        return Sending(self._session, robot, topic, data, name=name, patience=timeout, on_progress=on_progress)

    def share(self, dictionary: _rect.Dictionary) -> _rect.Codec:
        """Gives a dictionary to whoever asks for it. What is said with the codec that this returns is packed with it,
        which small JSON needs to get much smaller; whoever hears it fetches the dictionary once."""
        self._session.check()
        self._session.decoder.share(dictionary)
        return _rect.Codec.packed(dictionary)

    def peers(self) -> list[str]:
        """The other robots of the fleet that are there now, by name."""
        self._session.check()
        return registry.peers(self._session)

    def connections(self, robot: str | None = None, which: str = "") -> Connections:
        """The connections of this robot's router, or another's; those that `which` selects, as `method=ble` or
        `peer=wombat-2;state=connected` (docs/registry.md).

        Raises `NoService` (no router with RECT's registry), `ServiceError`.
        """
        self._session.check()
        return registry.connections(self._session, robot or self.name, which)

    def add_connection(
        self,
        name: str,
        method: str,
        address: str,
        *,
        port: int | None = None,
        psm: int | None = None,
        options: Mapping[str, Any] | None = None,
        robot: str | None = None,
    ) -> None:
        """Gives this robot's router, or another's, a connection, instead of the one of that name if it has one; it is
        dialled from now on, and after a restart.

        `method`: `ble`, `tcp`, `udp`; `address`: a host, for `ble` a robot's name or Bluetooth address; `options` of
        the method's locator, as `{"mtu": 512}`.

        Raises `ServiceError` (it can't be, and why), `NoService` (no router whose settings name a file of connections).
        """
        self._session.check()
        known = _rect.write_value(dict(options or {}))[0]
        given = (text("name", name), text("method", method), text("address", address))
        connection = _rect.named_connection(*given, port, psm, known)
        registry.configure(self._session, robot or self.name, _rect.ADD, connection)

    def remove_connection(self, name: str, *, robot: str | None = None) -> None:
        """Takes a connection from this robot's router, or another's; its link ends.

        Raises `ServiceError` (it has none of that name), `NoService` as `add_connection`.
        """
        self._session.check()
        registry.configure(self._session, robot or self.name, _rect.REMOVE, text("name", name))

    def ask_registry(self, question: str, *, robot: str | None = None, which: str = "") -> Any:
        """Any other question of the registry, as `connections/count` or `status` (docs/registry.md)."""
        self._session.check()
        return registry.ask(self._session, robot or self.name, text("question", question), which)

    @overload
    def on_state(self, callback: None = None) -> Events: ...
    @overload
    def on_state(self, callback: Callable[[Event], object]) -> Subscription[Event]: ...
    def on_state(self, callback: Callable[[Event], object] | None = None) -> Events | Subscription[Event]:
        """What changes about who can be reached: robots that come and go, links and over which radio, and the router
        itself; first of all who is there already. An iterator; or, with a callback, that is called for each."""
        callable_or_none(callback)
        self._session.check()
        events = Events(self._session)
        return events if callback is None else Subscription(events, callback, "state")

    def counters(self) -> Counters:
        """What this program has said and heard."""
        return self._session.counting.read()

    def close(self) -> None:
        """Ends the session, and all that belongs to it. Closed twice is closed."""
        self._session.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Robot({self.fleet}/{self.name}{', closed' if self.is_closed else ''})"

    def _say(self, topic: str, to: str | None, value: Any, urgency: str, codec: CodecLike) -> None:
        session = self._session
        session.check()
        payload = payload_of(value, codec_of(codec))
        publication = session.publication(text("topic", topic), to, text("urgency", urgency))
        if len(payload.bytes) < LARGE_BYTES:
            publication.put(payload)
        else:
            patiently(lambda: publication.put(payload))
        session.counting.on_sent(len(payload.bytes))

    def _ask(
        self, robot: str | None, topic: str, value: Any, timeout: float, urgency: str, codec: CodecLike
    ) -> Replies:
        self._session.check()
        payload = payload_of(value, codec_of(codec))
        timeout = seconds("timeout", timeout)
        return Replies(self._session, robot, text("topic", topic), payload, text("urgency", urgency), timeout)
