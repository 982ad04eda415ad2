"""Owns a program's place among the robots: everything that it can do there, in blocking form."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Union, overload

import zenoh

from rect import _rect, registry
from rect._zenoh import LARGE_BYTES, patiently
from rect.errors import NoService, OptionError
from rect.inbox import DEFAULT_CAPACITY
from rect.message import Message
from rect.options import Options, seconds, text, whole
from rect.registry import Connections
from rect.request import Replies, Reply
from rect.service import Request, Service
from rect.session import Session
from rect.state import Counters, Event, Events
from rect.stream import Frame, Stream, Watch
from rect.subscriber import Subscriber, Subscription, callable_or_none
from rect.transfer import OnProgress, Progress, Received, Sending, Transfers
from rect.values import codec_of, payload_of

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
    login_file: str | Path | None = None,
    timeout: float = 5.0,
    zenoh: Mapping[str, Any] | None = None,
    allow_name_mismatch: bool = False,
) -> Robot:
    """Joins as a program of that robot, at the router of this computer.

    - `fleet`: the team's name.
    - `router`: another router, as `tcp/192.168.0.7:7447`; default: what the environment's `RECT_ENDPOINT` says, else
      `tcp/127.0.0.1:7447`.
    - `endpoints`, `listen`: without a router: whom to connect to directly, and where others may connect to this
      program, as `["ble/wombat-2"]`, `["tcp/0.0.0.0:7447"]`. They are dialled until they are there; joining does not
      wait for that.
    - `login`: user and password; default: the first line of `login_file`, `user:password`, if it can be read.
    - `login_file`: default: what the environment's `RECT_LOGIN` says, else `/etc/rect/users`.
    - `timeout`: how long to wait for the router, in seconds, so that a program may be started together with it.
    - `zenoh`: any setting of Zenoh's configuration, by its path; goes before ours.
    - `allow_name_mismatch`: joins although the router serves another robot, for a program that uses another name on
      purpose. A router with access control as `rect-router init` writes it drops what such a program publishes.

    Raises `NoRouter`, `LoginRefused`, `WrongRobot`, `InvalidNameError`, `OptionError`.

    >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
    ...     robot.publish("greeting", "hello")
    """
    settings = zenoh or {}
    options = (fleet, router, endpoints, listen, login, login_file, timeout, settings, allow_name_mismatch)
    return Robot(Options(name, *options))


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
        `fixed` (frames as they are, at most `frames_per_s`; the default with a codec), `sensor` (values as they come;
        nothing comes back). `feedback`: how often receivers say what comes, in seconds. `photographs`: `jpeg`, or
        `webp`, which is smaller and takes longer to write. docs/streams.md tells the rest.

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
        in seconds; default: it may come back whenever it likes. `on_progress` gets a `Progress` up to ten times a
        second.

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
        `max_bytes`: larger ones are refused. `at_once`: more of them wait; of one sender, more than half. `patience`:
        how long nothing may come before one is given up, in seconds.

        Raises `InvalidTopicError`, `FileError`, `Closed`.
        """
        callable_or_none(on_progress)
        self._session.check()
        return Transfers(
            self._session,
            text("pattern", pattern),
            folder=folder,
            max_bytes=whole("max_bytes", max_bytes, 0),
            at_once=whole("at_once", at_once, 1),
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
        for what, number in (("port", port), ("psm", psm)):
            if number is not None and not 0 <= whole(what, number, 0) < 2**16:
                raise OptionError(what, number, "it is a whole number from 0 to 65535")
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
        return Counters(*self._session.counting.read())

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
