"""Defines `connect` and `Robot`, the blocking API of the package."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, Union, overload

import zenoh

from rect import _rect, action_run, advice, registry
from rect import log as program_log
from rect.action import Action, ActionExecutor, Goal
from rect.action_run import ActionRun, KnownGoal, Types
from rect.alert import Alert, alerts, clear_alert, raise_alert
from rect.choices import Level, LossyFormat, StreamMode, Urgency, WhenBusy, WhenFull
from rect.deadman import Deadman, DeadmanExecutor
from rect.errors import OptionError
from rect.events import Counters, Event, Events
from rect.logs import Logs
from rect.message import Message
from rect.opening import open_session
from rect.options import Options, lifetime_of, seconds, text, whole
from rect.parameter_orders import set_parameters
from rect.parameter_types import Declared
from rect.parameters import GroupOptions, ParameterGroup, executor_of
from rect.program import Program, ServiceEntry, programs_of
from rect.publisher import Publisher
from rect.receive_queue import DEFAULT_CAPACITY
from rect.recording import Recorder
from rect.registry import Connections
from rect.reply import Reply
from rect.request import Replies, RetriedRequest
from rect.service import Request, Service
from rect.single_request import SingleRequest
from rect.state import Retain, retention
from rect.stop import FleetStop, fleet_stop
from rect.stream import Frame, StreamSender, Watcher
from rect.subscriber import Subscriber, Subscription, callable_or_none, decoded
from rect.transfer import OnProgress, OutgoingTransfer, Progress, Received, Transfers
from rect.typed import T, converter_of
from rect.values import codec_of, payload_of

#: Default timeout of a request, in seconds.
DEFAULT_TIMEOUT: float = _rect.DEFAULT_TIMEOUT_S

#: Default time for which the client of a goal has to be unreachable until the goal is cancelled, in seconds.
LOST_AFTER: float = _rect.ACTION_LOST_AFTER_S

#: Default maximum size of a transfer that is accepted, in bytes.
DEFAULT_MAX_BYTES = 64 << 20

Handler = Callable[[Request[Any]], Any]
GoalHandler = Callable[[Goal[Any]], Any]
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
    program: str | None = "",
) -> Robot:
    """Connects to the router of this computer as a program of the robot `name`.

    - `fleet`: name of the team's fleet. Default: `rect`.
    - `router`: locator of another router, such as `tcp/192.168.0.7:7447`. Default: the value of the environment
      variable `RECT_ENDPOINT`, or else `tcp/127.0.0.1:7447`.
    - `endpoints`: locators that the program dials directly, without a router, until they are reachable, such as
      `["tcp/192.168.0.7:7447"]`. This function does not wait for the links. A `ble/` locator raises `OptionError`: a
      Python program uses Bluetooth through a router.
    - `listen`: locators at which the program accepts direct links, without a router, such as `["tcp/0.0.0.0:7447"]`.
    - `login`: user and password. Default: the first line of `login_file`, `user:password`, if it can be read.
    - `login_file`: path of the login file. Default: the value of the environment variable `RECT_LOGIN`, or else
      `/etc/rect/users`.
    - `timeout`: time to wait for the router, in seconds, so that a program can be started together with it. Default: 5.
    - `zenoh`: settings of Zenoh's configuration by their paths, such as `{"scouting/multicast/enabled": True}`. They
      override the settings of this package.
    - `allow_name_mismatch`: connects even if the router serves another robot, for a program that uses another name on
      purpose. A router with the access control that `rect-router init` writes drops what such a program publishes.
      Default: `False`.
    - `program`: name under which this program is known in the fleet; `None` leaves it without one. Default: the name of
      the script, except for tests, notebooks and `python -c`.

    Raises `NoRouter`, `LoginRefused`, `WrongRobot`, `InvalidNameError` and `OptionError`.

    >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
    ...     robot.publish("greeting", "hello")
    """
    settings = zenoh or {}
    options = (fleet, router, endpoints, listen, login, login_file, timeout, settings, allow_name_mismatch, program)
    return Robot(Options(name, *options))


class Robot:
    """A program of a robot, connected to the other robots of the fleet.

    Returned by `connect`. It may be used from several threads. After `close`, every method except `log`, `counters`
    and `close` raises `Closed`. A call that Zenoh rejects for another reason raises `ZenohError`.
    """

    def __init__(self, options: Options) -> None:
        self._session = open_session(options)

    def __reduce__(self) -> NoReturn:
        raise TypeError("a Robot belongs to the process that has connected it: call rect.connect in the other process")

    @property
    def name(self) -> str:
        """Name of this robot."""
        return self._session.key_space.robot

    @property
    def fleet(self) -> str:
        """Name of the fleet."""
        return self._session.key_space.fleet

    @property
    def zenoh(self) -> zenoh.Session:
        """Zenoh session of this robot, for features of Zenoh that this package does not cover.

        With a router, urgent and bulk messages use separate sessions.
        """
        session: zenoh.Session = self._session.zenoh
        return session

    @property
    def is_closed(self) -> bool:
        """Whether the robot was closed."""
        return self._session.is_closed

    def publish(
        self,
        topic: str,
        value: Any,
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
        retained: Retain = False,
    ) -> None:
        """Publishes `value` on `topic` to every subscriber.

        - `value`: text, bytes, a picture, a numpy array, or a value that JSON can represent: dicts, lists, numbers,
          dataclasses and so on. A `Cbor` or a `Payload` selects another encoding.
        - `urgency`: `urgent` overtakes all other messages, and `bulk` is overtaken by them. Default: `normal`.
        - `codec`: codec that compresses the value: a name such as `zstd:9` or `jpeg:60`, a `Codec`, or the result of
          `share_dictionary`. Default: no compression.
        - `expires_after`: time in seconds after which the message is dropped rather than delivered late, for commands
          such as steering. Where another message would wait for room, this one is dropped. A receiver drops it if it
          was on the way for longer, or has waited for longer in the receive queue, and counts it (`counters`). Default:
          the message never expires.
        - `retained`: whether this robot's router keeps the value as the last one of its topic. Programs that start
          later, or whose link was interrupted, receive it; none receives a value twice, or an older one after a newer
          one (`Message.retained`). It stays when this program ends. `"disk"`: it also survives a restart of the robot,
          and is written before it is published. A value has 64 kB at most, and those of a robot 256 kB. Default:
          `False`.

        Raises `InvalidTopicError`, `PayloadError`, `CodecError`, `OptionError`, `Closed`, and `NotRetained` if the
        message was published and is not kept.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     robot.publish("arm/angle", {"degrees": 12.5}, urgency="urgent")
        ...     robot.publish("drive", [0.5, 0.5], expires_after=0.2)
        ...     robot.publish("mode", "auto", retained=True)
        """
        self._publish(topic, None, value, urgency, codec, expires_after, retained)

    def send(
        self,
        robot: str,
        topic: str,
        value: Any,
        *,
        urgency: Urgency = "normal",
        codec: CodecLike = None,
        expires_after: float | None = None,
    ) -> None:
        """Sends `value` on `topic` to one robot only.

        Nothing confirms that a program of that robot has received it; use `request` if a reply is needed.

        Raises `NotReachable` if that robot is not reachable now: the first time after up to half a second, later at
        once. A program that sends to a robot which comes and goes catches it, and one that has just started waits first
        (`wait_for_peer`). Otherwise raises the same errors as `publish`, and `InvalidNameError`.
        """
        self._publish(topic, text("robot", robot), value, urgency, codec, expires_after)

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
        """Subscribes to the messages that match a pattern and are published to all robots, or sent to this one.

        A pattern is `<robot>/<topic>`. Both parts may contain wildcards: `*/arm/*`. Without a callback, this method
        returns a `Subscriber` to iterate over. With a callback, it calls the callback for each message, one call at a
        time, on a separate thread.

        - `type`: type of the values, such as a dataclass or `list[float]`: docs/reference/python.md lists the possible
          ones. A message whose value does not fit has a `problem` and no `value`. Default: any values.
        - `capacity`: number of messages that may wait for the program, at least 1. Default: 256.
        - `when_full`: `drop_oldest` (default) drops the message that has waited longest, `drop_newest` drops the
          message that arrived last, and `block` makes the sender wait.
        - `max_hz`: the largest number of messages of each topic per second, 0.01 to 1000. Default: all. The newest
          one wins. The router of the robot that publishes leaves out the others, so that they cost nothing on the air;
          they count as `Message.skipped`, and not as missed. Messages that are sent to this robot alone, and retained
          ones, arrive as they are sent.
        - `on_change`: whether to receive only messages whose value differs from the last one. Default: no.

        Raises `InvalidTopicError`, `InvalidNameError`, `OptionError`, `Closed`, and `TypeError` if values cannot be
        converted to the type. Example:

            @dataclass
            class Battery:
                percent: float

            for message in robot.subscribe("*/battery", Battery):
                print(message.sender, message.value.percent)
        """
        callable_or_none(callback)
        self._session.check()
        converter = converter_of(type)
        inbound = _rect.Inbound(self._session.key_space, text("pattern", pattern), max_hz, on_change)
        advice.on_pattern(self._session, pattern)
        subscriber = Subscriber(self._session, inbound, pattern, converter, capacity, when_full)
        return subscriber if callback is None else Subscription(subscriber, callback, pattern)

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
        """Returns a publisher of `topic`, which knows whether there are subscribers and can wait for one.

        - `type`: class of the values; `Publisher.publish` raises `TypeError` for others. Default: any values.
        - `urgency`, `codec`, `expires_after`, `retained`: see `publish`.

        Raises `InvalidTopicError`, `CodecError`, `OptionError`, `Closed`, and `TypeError` if the type is not possible.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     angles = robot.publisher("arm/angle")
        ...     angles.has_subscribers
        False
        """
        self._session.check()
        lifetime = lifetime_of(expires_after)
        converter = converter_of(type)
        arguments = (text("urgency", urgency), codec_of(codec), lifetime, retention(retained, lifetime))
        return Publisher(self._session, text("topic", topic), converter, *arguments)

    @overload
    def latest(self, robot: str, topic: str, type: type[T]) -> Message[T] | None: ...
    @overload
    def latest(self, robot: str, topic: str, type: Any = None) -> Message[Any] | None: ...
    def latest(self, robot: str, topic: str, type: Any = None) -> Message[Any] | None:
        """Returns the last value of a retained topic of `robot`. `None` if it retains none, or is not reachable.

        At once if a program of this robot subscribes to the topic; otherwise the other robot's router is asked.
        `type`: see `subscribe`.

        Raises `InvalidNameError`, `InvalidTopicError`, `Closed`, and `TypeError` if values cannot be converted to the
        type.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     robot.publish("mode", "auto", retained=True)
        ...     robot.latest("wombat-1", "mode").value
        'auto'
        """
        self._session.check()
        converter = converter_of(type)
        found = self._session.state.latest(text("robot", robot), text("topic", topic))
        return None if found is None else decoded(self._session, Message(*found), converter)

    def forget(self, topic: str) -> None:
        """Forgets a retained topic of this robot. Subscribers receive that as a message with the value `None`.

        Nothing happens if it has no value.

        Raises `InvalidTopicError`, `Closed`, and `NotRetained` if no router keeps values.
        """
        self._session.check()
        self._session.state.forget(text("topic", topic))

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
        """Logs a line, which the router of this robot keeps: `rect log` shows it, also after this program has ended.

        It never waits for the network, and does nothing once the robot is closed. A router keeps the last 1,000 lines
        of each program, and 2 MB in all. A program that logs faster than lines can be sent loses some, which are
        counted in the log. `LogHandler` logs what the program reports through Python's `logging`.

        - `text`: may have several lines, such as those of a traceback. It has 8 kB at most; a longer one is cut.
        - `level`: `debug`, `info`, `warn` or `error`. Default: `info`.
        - `logger`: part of the program.
        - `fields`: values with names: numbers, texts and booleans; anything else becomes text.
        - `source`: place in the source code, such as `arm.py:12`.
        - `private`: whether the line stays on this robot: access control does not let other robots read it. For what
          may contain paths or passwords. Default: `False`.

        Raises `OptionError` if there is no such level.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     robot.log("the gripper is slow", "warn", fields={"angle": 12.5})
        """
        program_log.log(self._session, text, level, logger, fields, source, private)

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
        """Reads the log of a robot, or of all robots (`*`), and returns an iterator of its lines.

        The lines of each robot arrive in their order, and those of several robots by their time, once all routers have
        answered. A robot that is not reachable has no lines; `Logs.robots` names those that have answered. Private
        lines are read only if `robot` is the name of this robot.

        - `program`: only the lines of one program. Default: all programs.
        - `level`: this level and more important ones. Default: all levels.
        - `last`: maximum number of lines of each robot that were logged before, 10,000 at most. Default: 100.
        - `follow`: whether new lines follow, until the iterator or the robot is closed. They cross the link, in the
          background, while somebody follows. Default: `False`.
        - `timeout`: how long the router of a robot may take to answer, in seconds. Default: 10.

        Raises `InvalidNameError`, `OptionError` and `Closed`. Example:

            for line in robot.logs("wombat-2", level="warn"):
                print(line.at, line.program, line.text)
        """
        self._session.check()
        return Logs(self._session, robot, program, level, last, follow, timeout)

    def alert(self, text: str, level: Level = "warn", *, name: str | None = None) -> None:
        """Raises an alert: something is wrong with this robot until `clear_alert` ends it. `rect status`, the page and
        recordings show it.

        It is a retained message (`publish`) on the topic `alerts/<name>`. It stays when the program ends. The same
        alert again replaces the first one.

        - `text`: what is wrong.
        - `level`: `debug`, `info`, `warn` or `error`. Default: `warn`.
        - `name`: name of the alert, for a text that changes: `battery` with the text `battery at 12 %`. Default: the
          text in words: `battery low` has the topic `alerts/battery-low`.

        Raises `InvalidTopicError` if the name has neither a letter nor a digit, `OptionError`, `Closed`, and
        `NotRetained` if no router keeps it.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     robot.alert("battery low")
        ...     [alert.text for alert in robot.alerts()]
        ['battery low']
        """
        raise_alert(self._session, text, level, name)

    def clear_alert(self, name_or_text: str) -> None:
        """Clears the alert of this robot with this name or text. Nothing happens if it was not raised.

        Raises `InvalidTopicError`, `Closed`, and `NotRetained` if no router keeps values.
        """
        clear_alert(self._session, name_or_text)

    def alerts(self, robot: str = "*") -> list[Alert]:
        """Returns the alerts of a robot, or of all robots (`*`), that are raised now.

        Those of each robot are in the order of their levels, and then of their age. A robot that is not reachable, or
        does not answer within 5 s, is left out. A subscription to `*/alerts/*` receives changes.

        Raises `InvalidNameError` and `Closed`.
        """
        return alerts(self._session, robot)

    def wait_for_peer(self, robot: str, timeout: float) -> None:
        """Waits until `robot` is reachable. Returns at once if it is. `timeout` is in seconds.

        A robot is reachable while its router, or a program without a router, is connected with this one. Its programs
        may start later: `Publisher.wait_for_subscriber` waits for one that subscribes.

        Raises `TimedOut`, which names the reachable robots, `InvalidNameError`, `OptionError` and `Closed`.
        """
        self._session.check()
        timeout = seconds("timeout", timeout)
        driver = _rect.peer_wait(self._session.key_space, text("robot", robot), timeout)
        advice.on_robot(self._session, robot)
        registry.wait(self._session, driver, lambda: _rect.expected_connection(robot, self.peers()), timeout)

    def wait_until_established(self, timeout: float) -> None:
        """Waits until every reachable router knows the subscriptions and services of this program.

        Messages and requests that other robots send from then on arrive. Declarations reach the other robots a moment
        after the calls that made them, later over a slow link. Programs without a router answer themselves.
        `timeout` is in seconds.

        Raises `TimedOut` if a router does not answer in time, `OptionError` and `Closed`.
        """
        self._session.check()
        timeout = seconds("timeout", timeout)
        driver = _rect.established_wait(self._session.key_space, timeout)
        registry.wait(self._session, driver, lambda: "answer of every router", timeout)

    @overload
    def wait_for_message(self, pattern: str, type: type[T], *, timeout: float | None = None) -> Message[T]: ...
    @overload
    def wait_for_message(self, pattern: str, type: Any = None, *, timeout: float | None = None) -> Message[Any]: ...
    def wait_for_message(self, pattern: str, type: Any = None, *, timeout: float | None = None) -> Message[Any]:
        """Waits for the next message that matches the pattern and returns it.

        Messages that were sent before this call are not received, except the last value of a retained topic. `timeout`
        is in seconds; `None`, the default, waits without limit. For `type` see `subscribe`.

        Raises `TimedOut`, `InvalidNameError`, `InvalidTopicError`, `OptionError`, `Closed` and `TypeError`.
        """
        if timeout is not None:
            seconds("timeout", timeout)
        with self.subscribe(pattern, type) as subscriber:
            return subscriber.next(timeout)

    @overload
    def request(
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
    def request(
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
    def request(
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
        """Sends a request to a service of `robot`, and returns its first reply.

        - `value`: payload of the request. Default: an empty text.
        - `returns`: type of the reply's value; see `subscribe`. Default: any value.
        - `timeout`: time to wait for the reply, in seconds. Default: 10.
        - `urgency`, `codec`: see `publish`.
        - `retry`: whether the request is repeated while the link or a router is interrupted. For requests that must not
          be carried out twice, such as "grab": it names the run of the program that serves the topic, which carries it
          out once and repeats its first reply. A program that was restarted refuses it, and `Interrupted` is raised.
          The timeout is at most 10 minutes then. The service keeps its replies to the last 64 such requests of this
          program, at most 1 MB in all, until 60 s and the longest timeout have passed since the last one. A service of
          stock Zenoh is asked once.

        Raises `ServiceError` if the service replies with an error, `NoService` if no program of that robot serves the
        topic (its text lists the reachable robots), `Interrupted` if one may have received the request and does not
        reply because it ended, or a router or link did, `TimedOut`, `InvalidNameError`, `InvalidTopicError`,
        `PayloadError`, `OptionError` and `Closed`.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     service = robot.serve("double", lambda request: request.value * 2)
        ...     robot.request("wombat-1", "double", 21).value
        42
        """
        if retry:
            retried = self._retried_request(robot, topic, value, returns, timeout, urgency, codec)
            once = retried.run()
            if once is not None:
                return once
            timeout = retried.remaining
        session = self._session
        session.check()
        converter = converter_of(returns)
        payload = payload_of(value, codec_of(codec))
        timeout = seconds("timeout", timeout)
        robot, topic = text("robot", robot), text("topic", topic)
        text("urgency", urgency)
        destination = session.destination(robot, topic, urgency)
        if destination.served.is_served:
            return SingleRequest(session, destination, payload, timeout).run(converter)
        replies = Replies(session, robot, topic, payload, urgency, timeout, converter)
        try:
            for reply in replies:
                return reply
        finally:
            replies.leave()
        raise replies.unanswered(self.peers)

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
        """Sends a request to the services of all robots that serve `topic`, and returns an iterator of their replies.

        The iteration ends when all services have replied; `Replies` lists its errors. `gather` waits for all of them,
        and also names the robots that did not reply. For the parameters see `request`.
        """
        return self._request(None, topic, value, returns, timeout, urgency, codec)

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
        """Sends a request to a service of `robot` that sends several replies, and returns an iterator of them.

        The iteration ends only after all replies. It raises `Interrupted` if the program, a router or the link ended
        midway, and the other errors of `request`. All replies have to arrive within `timeout`. Closing the iterator
        ends the request, which its service learns (`Request.is_wanted`).

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     service = robot.serve("count", lambda request: (n for n in range(request.value)))
        ...     [reply.value for reply in robot.request_stream("wombat-1", "count", 3)]
        [0, 1, 2]
        """
        robot = text("robot", robot)
        return self._request(robot, topic, value, returns, timeout, urgency, codec, is_stream=True)

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
        """Serves requests on `topic` by calling `handler` with each `Request`.

        The return value of the handler is sent as the reply; a generator sends several replies. If the handler raises
        an exception, the requester receives a `ServiceError`, and the exception is logged here unless it is a `Refusal`
        or a `RectError`. Without `handler`, this method is a decorator:

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     @robot.serve("double")
        ...     def double(request):
        ...         return request.value * 2
        ...     robot.request("wombat-1", "double", 21).value
        42

        A handler whose parameter is annotated with `rect.Request[Grab]` receives values of the type `Grab` (see
        `subscribe`). A request with another value is answered with an error that names the field.

        - `about`: what the service does, for `rect service list` and the dashboard. Default: the first line of the
          handler's docstring.
        - `allow_several`: whether other programs of the robot may serve the same topic, which then have to allow it,
          too. Each of them answers every request.

        Raises `ServiceRefused` if a program of this robot serves the topic already, `InvalidTopicError`, `Closed`, and
        `TypeError` if values cannot be converted to that type.
        """
        self._session.check()
        text("topic", topic)
        if handler is None:
            return lambda handler: self.serve(topic, handler, about=about, allow_several=allow_several)
        if not callable(handler):
            raise TypeError(f"handler must be a function, not {type(handler).__name__}")
        return Service(self._session, topic, handler, about, allow_several)

    def parameters(self, group: str, options: GroupOptions | None = None, /, **parameters: Declared) -> ParameterGroup:
        """Declares a group of parameters: values of this program that people tune while it runs, such as a gain.

        They are set with `set_parameters`, `rect param`, and on the dashboard, and kept in a file, so that they survive
        a restart. In the program they are attributes of the group.

        - `options`: a `GroupOptions` with the purpose of the group, and the file.
        - `parameters`: the parameters with their types: a `Number`, `Integer`, `Choice`, `Text`, `Bool` or `Numbers`. A
          value alone declares one with that default and any range.

        Raises `ParameterError` if the declaration is invalid, `ServiceRefused` if a program of this robot has a group
        of that name already, `Closed`, and `TypeError`. A file that cannot be read or does not fit is logged as a
        warning.

        >>> import rect
        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     gain = rect.Number(1.0, min=0, max=10, unit="1/s", about="gain of the heading")
        ...     side = rect.Choice("left", "right")
        ...     in_memory = rect.GroupOptions(file=False)
        ...     drive = robot.parameters("drive", in_memory, kp=gain, side=side, turbo=False)
        ...     drive.kp = 2.0
        ...     drive.kp, drive.side, drive.turbo
        (2.0, 'left', False)
        """
        executor = executor_of(self._session, group, options, parameters)
        executor.serve()
        return ParameterGroup(executor)

    def set_parameters(
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
        """Changes parameters of a program of `robot`: all or none.

        Returns those that the call names, with the values that are in force now. Access control may permit it to some
        only (`@rect/@set/parameters/**`). An order that ends without a reply in the first second, for example because
        the program has just begun, is sent again: one that is carried out twice leaves the same values, unless somebody
        else changes them in between.

        - `values`, and keywords: the new values, by the names of the parameters.
        - `reset`: a list of the parameters that get their defaults, or `True` for all except for those that are
          read-only.
        - `stored`: whether to wait until the values are stored. Default: until they are in force, which is up to a
          second earlier.

        Raises `ServiceError` with the reason if the program refuses a value, `NoParameters` if the robot has no such
        group, `NotStored` if the values are in force and its program cannot store them, `ParameterError` if a value is
        of a type that no parameter has, and the other errors of `request`.

        >>> import rect
        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     drive = robot.parameters("drive", rect.GroupOptions(file=False), kp=1.0)
        ...     robot.set_parameters("wombat-1", "drive", kp=2.0)
        {'kp': 2.0}
        """
        self._session.check()
        asked = text("robot", robot), text("group", group)
        return set_parameters(self._session, *asked, {**(values or {}), **more}, reset, stored)

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
        """Declares an action: a task that takes a while, with progress, cancel and one end.

        `handler` is called with each `Goal`, on a thread of its own, for one goal at a time. It returns the
        result, of at most 16 MB; this program keeps one of more than 48 kB for its clients, while it runs. If the
        handler raises an exception, the goal has failed, with the text of the exception as the reason; the exception is
        logged unless it is a `Refusal` or a `RectError`. The handler should end soon after `goal.cancelled` has become
        true; `goal.sleep` raises `Cancelled` then. Without `handler`, this method is a decorator:

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     @robot.action("dig")
        ...     def dig(goal):
        ...         for scoop in range(goal.value):
        ...             goal.feedback(f"scoop {scoop + 1}", progress=(scoop + 1) / goal.value)
        ...             goal.sleep(0.01)
        ...         return "dug"
        ...     robot.start("wombat-1", "dig", 3).result(timeout=20)
        'dug'

        A handler whose parameter is annotated with `rect.Goal[Target]` receives values of the type `Target` (see
        `subscribe`). A goal with another value is refused with an error that names the field.

        - `name`: 1 to 40 letters, digits, `_`, `-` and `.`.
        - `about`: what the action does, for `rect action list` and the dashboard. Default: the first line of the
          handler's docstring.
        - `when_busy`: whether a new goal preempts (`"preempt"`, the default) the one that runs, which is asked to end
          first, or is refused (`"refuse"`).
        - `lost_after`: how long the client of a goal has to be unreachable until the goal is cancelled, in seconds: its
          program has ended, or its robot cannot be reached. Default: 5. `None`: never.

        A stop of the fleet (`fleet_stop`) cancels all goals, and new ones are refused until it is released.

        Raises `ServiceRefused` if another program of this robot has an action of that name, `InvalidTopicError` if the
        name is invalid, `OptionError`, `Closed`, and `TypeError` if values cannot be converted to the type.
        """
        if handler is None:
            options: dict[str, Any] = {"about": about, "when_busy": when_busy, "lost_after": lost_after}
            return lambda handler: self.action(name, handler, **options)
        return Action(ActionExecutor(self._session, name, handler, about, when_busy, lost_after), handler)

    @overload
    def start(
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
    def start(
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
    def start(
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
        """Starts a goal of an action of `robot`, and returns as soon as it is accepted or refused, which is its end.

        - `goal`: any value that `publish` accepts, of at most 48 kB. Default: none.
        - `id`: id of the goal, 1 to 40 letters, digits, `_`, `-` and `.`. Default: a random one. A goal that is started
          again with the same id runs once.
        - `returns`, `feedback`: types of the result and of the values of feedback; see `subscribe`. Default: any value.
        - `feedback_per_s`: how often feedback is sent at most, per second, 0.1 to 50. Default: 10.
        - `timeout`: how long the robot may take to accept the goal, in seconds. Default: 10.

        Raises `NoAction` if no program of the robot has the action, `TimedOut` or `Interrupted` if the robot did not
        answer: the goal may have begun, and it is safe to start it again with the same id, or to `find` it;
        `InvalidNameError`, `InvalidTopicError`, `OptionError`, `PayloadError` and `Closed`.
        """
        types = Types(returns, feedback)
        return ActionRun(action_run.start(self._session, robot, action, goal, id, feedback_per_s, timeout, types))

    @overload
    def find(self, robot: str, action: str, id: str, *, returns: type[T], feedback: Any = None) -> ActionRun[T]: ...
    @overload
    def find(
        self, robot: str, action: str, id: str, *, returns: Any = None, feedback: Any = None
    ) -> ActionRun[Any]: ...
    def find(self, robot: str, action: str, id: str, *, returns: Any = None, feedback: Any = None) -> ActionRun[Any]:
        """Returns a goal that this program or another one has started, such as an earlier run of this program.

        `returns` and `feedback`: see `start`.

        Raises `NoGoal` if the robot does not know the goal, `NotReachable`, `TimedOut` if the robot does not answer
        within 5 s, `InvalidTopicError`, `InvalidNameError` and `Closed`.
        """
        return ActionRun(action_run.find(self._session, robot, action, id, Types(returns, feedback)))

    def goals(self, robot: str = "*") -> list[KnownGoal]:
        """Returns the goals that a robot, or all robots (`*`), know: those that have not ended, and of each action the
        16 that have ended last, for 10 minutes.

        A robot that is not reachable, or does not answer within 5 s, is left out.

        Raises `InvalidNameError` and `Closed`.
        """
        return action_run.goals(self._session, robot)

    @overload
    def deadman(
        self,
        pattern: str,
        drive: Callable[[Message[T]], object],
        *,
        within: float,
        on_lost: Callable[[str], object],
        type: type[T],
    ) -> Deadman: ...
    @overload
    def deadman(
        self,
        pattern: str,
        drive: Callable[[Message[Any]], object],
        *,
        within: float,
        on_lost: Callable[[str], object],
        type: Any = None,
    ) -> Deadman: ...
    def deadman(
        self,
        pattern: str,
        drive: Callable[[Message[Any]], object],
        *,
        within: float,
        on_lost: Callable[[str], object],
        type: Any = None,
    ) -> Deadman:
        """Carries out commands while they arrive: calls `drive` for each message that matches the pattern, and
        `on_lost`, which stops the motors, when none arrives.

        - `within`: time in seconds without another command after which the commander is lost, 0.02 to 60.
        - `on_lost`: called with the reason, once for each loss: before the first command, when none has arrived for
          `within`, when the robot of the last one cannot be reached, while the fleet is stopped (`fleet_stop`), and
          when the switch ends. The next command resumes.
        - `type`: type of the values; see `subscribe`.

        After a stop of the fleet, the first command that counts is neutral: all its numbers are 0. Retained and
        replayed messages never count. Neither do messages without a value, and those that have waited for `within`
        because `drive` took too long.

        `drive` is called on one thread and `on_lost` on another, which is native, so that a thread that sleeps or waits
        does not delay it. A thread that computes in Python does, since Python switches threads every 5 ms: `on_lost`
        came 9 ms late (median) and 30 ms at most, rather than 1 ms and 5 ms (docs/how-to/stop.md). Native code that
        holds Python's lock delays it for as long.
        If the commander is lost while `drive` is running, `on_lost` is called at once, and again after `drive`; no call
        of `drive` begins before `on_lost` has returned. If this program itself hangs, nothing stops its motors: use the
        watchdog of the motor controller as well.

        Raises `InvalidTopicError`, `InvalidNameError`, `OptionError`, `ThreadError`, `Closed` and `TypeError`. Example:

            def drive(message):
                set_motors(message.value["left"], message.value["right"])

            def stop_motors(reason):
                set_motors(0, 0)
                print("stopped:", reason)

            robot.deadman("laptop/drive", drive, within=0.3, on_lost=stop_motors)
        """
        return Deadman(DeadmanExecutor(self._session, pattern, drive, within, on_lost, type), drive)

    def fleet_stop(self, on_change: Callable[[FleetStop], object] | None = None) -> FleetStop:
        """Takes part in the stop of the fleet: with it, this program stops all robots that take part, learns of a stop,
        and confirms it.

        A stop holds until somebody releases it. The robots remember it, on their disks as well, and pass it on: one
        that was out of reach learns of it when it returns, and a program that starts again before this method returns.
        The motors are up to the program; `deadman` handles stops, and nothing moves at the release.

        - `on_change`: called with the `FleetStop` after each stop, release and confirmation, one call at a time, on a
          separate thread. Several changes may be one call.

        Raises `ZenohError`, `ThreadError` and `Closed`.

        >>> with connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        ...     stop = robot.fleet_stop()
        ...     stop.press("smoke")
        ...     stop.pressed[0].reason
        ...     stop.release()
        ...     stop.is_stopped
        'smoke'
        False
        """
        return fleet_stop(self._session, on_change)

    def stream(
        self,
        topic: str,
        *,
        mode: StreamMode | None = None,
        codec: CodecLike = None,
        max_frames_per_s: float | None = None,
        min_frames_per_s: float | None = None,
        max_bytes_per_s: float | None = None,
        feedback_interval: float | None = None,
        lossy_format: LossyFormat = "jpeg",
        urgency: Urgency = "normal",
    ) -> StreamSender:
        """Opens a stream for sending frames. A slow link drops the frames for which it has no room.

        - `mode`: `adaptive` sends pictures at the size, quality and rate that the link allows (the default without a
          codec); `video` sends pictures as video, in which each frame contains only what differs from the one before:
          more and better pictures for the same bytes; `fixed` sends frames unchanged, at most `max_frames_per_s` (the
          default with a codec); `sensor` sends every value and receives no feedback.
        - `codec`: compresses each frame; see `publish`.
        - `max_frames_per_s`: maximum rate of frames, 0.01 to 1 million. Default: 15, or 1 million for `sensor`.
        - `min_frames_per_s`: rate that an adaptive stream maintains by reducing the size and quality of pictures.
          Default: 5.
        - `max_bytes_per_s`: maximum rate of bytes of an adaptive stream. Default: 20 million.
        - `feedback_interval`: interval at which receivers report what arrives, in seconds: 0 (never), or 0.2 to 10.
          Default: 0.5 for `adaptive` and `video`, 2 for `fixed`, 0 for `sensor`.
        - `lossy_format`: format of an adaptive stream's lossy pictures: `jpeg` (default), or `webp`, which is smaller
          and takes longer to encode.
        - `urgency`: see `publish`.

        docs/concepts/streams.md describes streams in detail.

        Raises `InvalidTopicError`, `OptionError`, `CodecError` and `Closed`. Example:

            camera = robot.stream("camera")
            camera.send(numpy.zeros((240, 320, 3), numpy.uint8))
        """
        self._session.check()
        codec = codec_of(codec)
        return StreamSender(
            self._session,
            text("topic", topic),
            text("mode", mode or ("adaptive" if codec is None else "fixed")),
            codec,
            lossy_format,
            text("urgency", urgency),
            max_frames_per_s=max_frames_per_s,
            min_frames_per_s=min_frames_per_s,
            max_bytes_per_s=max_bytes_per_s,
            feedback_interval_s=feedback_interval,
        )

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
        """Receives a stream, `<robot>/<topic>`.

        Without a callback, this method returns a `Watcher` to iterate over. With a callback, it calls the callback for
        each frame, one call at a time, on a separate thread.

        - `capacity`: number of frames that may wait for the program. Default: 1, so only the newest frame waits. To
          receive all values of a sensor, choose a larger number.
        - `when_full`: see `subscribe`.
        - `decode`: whether the frames of a video are decoded into pictures, which is the default. With `False`, the
          payloads are the frames as they were sent, from a key frame on, with the encoding `video/h264`. A program that
          saves or forwards them needs them all, and so a larger `capacity`.

        Raises `InvalidNameError`, `InvalidTopicError`, `OptionError` and `Closed`. Example:

            for frame in robot.watch("wombat-1/camera"):
                print(frame.number, frame.age, frame.value)
        """
        callable_or_none(callback)
        self._session.check()
        watcher = Watcher(self._session, text("stream", stream), capacity, when_full, decode)
        return watcher if callback is None else Subscription(watcher, callback, stream)

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
        """Transfers a file or bytes of any size to one robot, and waits until the data has arrived and is verified.

        All other messages overtake a transfer. A transfer resumes after the link was interrupted or either program was
        restarted.

        - `data`: the path of a file (text or `Path`), bytes, or any other value that `publish` accepts, except text.
        - `name`: file name for the receiver. Default: the name of the file.
        - `timeout`: longest time, in seconds, without an answer from the receiver, or in which its program takes none
          of the transfers that have arrived. Default: no limit, so the receiver may be unreachable for any time.
        - `on_progress`: called with a `Progress`, at most ten times a second.

        Raises `TransferRefused`, `TransferFailed`, `TransferError` if `name` is not a valid file name, `TimedOut`,
        `FileError`, `PayloadError`, `InvalidNameError`, `InvalidTopicError`, `OptionError` and `Closed`. Example:

            robot.transfer("wombat-2", "maps", "kitchen.pcd", on_progress=print)
        """
        self.outgoing_transfer(robot, topic, data, name, timeout, on_progress).run()

    def outgoing_transfer(
        self,
        robot: str,
        topic: str,
        data: Any,
        name: str | None = None,
        timeout: float | None = None,
        on_progress: OnProgress | None = None,
    ) -> OutgoingTransfer:
        """Prepares a transfer without starting it, so that the program can run it on another thread and stop it.

        For the parameters and errors see `transfer`.
        """
        callable_or_none(on_progress)
        self._session.check()
        if timeout is not None:
            seconds("timeout", timeout)
        robot, topic = text("robot", robot), text("topic", topic)
        return OutgoingTransfer(self._session, robot, topic, data, name=name, timeout=timeout, on_progress=on_progress)

    def receive_transfers(
        self,
        pattern: str,
        *,
        folder: str | os.PathLike[str] | None = None,
        max_bytes: int = DEFAULT_MAX_BYTES,
        max_concurrent: int = 4,
        timeout: float = 600.0,
        on_progress: Callable[[Received, Progress], object] | None = None,
    ) -> Transfers:
        """Accepts the transfers that match a pattern such as `*/maps/*`, and returns an iterator of those that ended.

        A robot refuses all transfers that none of its programs accepts. When the iterator is closed, this program
        accepts no further transfers.

        - `folder`: folder in which transfers are stored as files, in one subfolder per sender, so that they resume
          after a restart of the program. Default: they are kept in memory.
        - `max_bytes`: maximum size of a transfer, in bytes. Larger ones are refused. Default: 64 MiB.
        - `max_concurrent`: number of transfers received concurrently; further ones wait. One sender may use at most
          half of them, rounded up. Default: 4.
        - `timeout`: time after which a transfer fails if nothing of it arrives, in seconds. Default: 600.
        - `on_progress`: called with the transfer and its `Progress`, at most ten times a second.

        Raises `InvalidTopicError`, `InvalidNameError`, `FileError`, `OptionError` and `Closed`. Example:

            for received in robot.receive_transfers("*/maps", folder="maps"):
                print(received.error or received.content)
        """
        callable_or_none(on_progress)
        self._session.check()
        return Transfers(
            self._session,
            text("pattern", pattern),
            folder=folder,
            max_bytes=whole("max_bytes", max_bytes, 0),
            max_concurrent=whole("max_concurrent", max_concurrent, 1),
            timeout=seconds("timeout", timeout),
            on_progress=on_progress,
        )

    def record(
        self,
        path: str | os.PathLike[str],
        *patterns: str,
        keep: float | None = None,
        split_after: float | None = None,
        split_bytes: int | None = None,
        logs: bool = True,
    ) -> Recorder:
        """Records the messages that match the patterns to an MCAP file, until the returned `Recorder` is closed.

        The events of this robot, the requests to its services, the lines that programs log and, once a second, the
        state of its router's links are recorded, too.

        - `path`: the file, such as `match.mcap`.
        - `patterns`: for example `wombat-1/arm/*`. Default: everything that this robot publishes, and everything that
          it sends to one robot or that is sent to it. Messages of other robots travel over their links to this robot
          only because they are recorded.
        - `keep`: only about this many seconds of the past are kept. Default: everything.
        - `split_after`, `split_bytes`: the recording continues in another file, whose name has a number, after this
          many seconds, or when the file has that number of bytes. Default: never.
        - `logs`: whether the lines that the programs of the recorded robots log are recorded. Those of other robots
          travel over the links, in the background, only because they are recorded. Private lines never are.

        Raises `RecordingError` if there is a recording of that name or the folder cannot be written,
        `InvalidTopicError`, `OptionError` and `Closed`. Example:

            with robot.record("match.mcap", "wombat-1/**", "*/stop"):
                drive()
        """
        self._session.check()
        return Recorder(self._session, path, patterns, keep, split_after, split_bytes, bool(logs))

    def share_dictionary(self, dictionary: _rect.Dictionary) -> _rect.Codec:
        """Shares a dictionary with all robots, and returns the codec that compresses with it.

        Pass the codec to `publish` or `send`. A receiver fetches the dictionary once, on the first message that needs
        it. Small JSON messages compress well only with a dictionary.

        Raises `DictionaryError` if this program shares another dictionary with the same id, `ZenohError` and `Closed`.
        Example:

            codec = robot.share_dictionary(rect.Dictionary.train(samples, 4096))
            robot.publish("telemetry", {"angle_deg": 3}, codec=codec)
        """
        self._session.check()
        self._session.decoder.serve(dictionary)
        return _rect.Codec(dictionary)

    def peers(self) -> list[str]:
        """Returns the names of the other robots of the fleet that are reachable now, in alphabetical order."""
        self._session.check()
        return registry.peers(self._session)

    def connections(self, robot: str | None = None, filter: str = "") -> Connections:
        """Returns the connections of the router of `robot`. Default: this robot.

        `filter` selects some of them, such as `method=ble` or `peer=wombat-2;state=connected`
        (docs/reference/registry.md).

        Raises `NoService` if no router with a registry answers, `ServiceError` if the filter is invalid, `TimedOut` if
        no reply arrives within 5 s, and `Closed`.
        """
        self._session.check()
        return registry.connections(self._session, robot or self.name, filter)

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
        """Adds a named connection to the router of `robot`. Default: this robot.

        The new connection replaces one of the same name. The router keeps it connected, also after a restart.

        - `method`: `ble`, `tcp` or `udp`.
        - `address`: a host, or for `ble` a robot's name or Bluetooth address.
        - `port`, `psm`: port of the host, or PSM of the Bluetooth channel; 0 to 65535. Default: that of the method.
        - `options`: options of the method's locator, such as `{"mtu": 512}`.

        Raises `ServiceError` if the connection is invalid (its text says why), `NoService` if the router's settings
        name no connections file or its access control forbids the change, `TimedOut` if no reply arrives within 5 s,
        `OptionError` and `Closed`.
        """
        self._session.check()
        encoded_options = _rect.write_value(dict(options or {}))[0]
        arguments = (text("name", name), text("method", method), text("address", address))
        for option, number in (("port", port), ("psm", psm)):
            if number is not None and not 0 <= whole(option, number, 0) < 2**16:
                raise OptionError(option, number, "it must be an integer from 0 to 65535")
        connection = _rect.named_connection(*arguments, port, psm, encoded_options)
        registry.configure(self._session, robot or self.name, _rect.ADD, connection)

    def remove_connection(self, name: str, *, robot: str | None = None) -> None:
        """Removes a named connection from the router of `robot`, and closes its link. Default: this robot.

        Raises `ServiceError` if there is no connection of that name, `NoService` if the router's settings name no
        connections file or its access control forbids the change, `TimedOut` if no reply arrives within 5 s, and
        `Closed`.
        """
        self._session.check()
        registry.configure(self._session, robot or self.name, _rect.REMOVE, text("name", name))

    def programs(self, robot: str | None = None) -> list[Program]:
        """Returns the programs of `robot` that have a name or serve something, with their services.

        `robot` defaults to this robot. An answer is kept until the robot's programs announce a change (at most once a
        second), so that asking again costs nothing on the air.

        Raises `NoService` if no router with a catalogue answers, `TimedOut` if no reply arrives within 5 s,
        `PayloadError` if the answer is not a catalogue, and `Closed`.
        """
        self._session.check()
        return programs_of(self._session, robot or self.name)

    def services(self, robot: str | None = None) -> list[ServiceEntry]:
        """Returns what the programs of `robot` serve, in alphabetical order of the topics.

        `programs` also states which program serves what, and lists the errors. `robot` defaults to this robot.
        """
        services = [service for program in self.programs(robot) for service in program.services]
        return sorted(services, key=lambda service: service.topic)

    def query_registry(self, question: str, *, robot: str | None = None, filter: str = "") -> Any:
        """Sends a question such as `connections/count` or `status` to the registry of a router, and returns its answer.

        docs/reference/registry.md lists the questions and filters. `robot` defaults to this robot.

        Raises `NoService` if no router with a registry answers the question, `ServiceError` if the filter is invalid,
        `TimedOut` if no reply arrives within 5 s, and `Closed`.
        """
        self._session.check()
        return registry.query(self._session, robot or self.name, text("question", question), filter)

    def events(self) -> Events:
        """Returns an iterator of events: robots, programs, links and the router that appear and disappear.

        The first events report the robots, named programs and links that exist already. Example:

            for event in robot.events():
                print(event.kind, event.robot)
        """
        self._session.check()
        return Events(self._session)

    def on_event(self, callback: Callable[[Event], object]) -> Subscription[Event]:
        """Calls `callback` for each event, one call at a time, on a separate thread; see `events`."""
        callable_or_none(callback)
        return Subscription(self.events(), callback, "events")

    def counters(self) -> Counters:
        """Returns the counts of messages that this program has sent and received since it connected."""
        return Counters(*self._session.counters.read())

    def close(self) -> None:
        """Closes the session and everything that belongs to it. Closing the robot again has no effect."""
        self._session.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Robot({self.fleet}/{self.name}{', closed' if self.is_closed else ''})"

    def _publish(
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
        lifetime = lifetime_of(expires_after)
        disk = retention(retained, lifetime)
        if disk is not None:
            self._session.state.retain(text("topic", topic), payload, text("urgency", urgency), disk)
            return
        self._session.publish(text("topic", topic), recipient, payload, text("urgency", urgency), lifetime)

    def _retried_request(
        self, robot: str, topic: str, value: Any, returns: Any, timeout: float, urgency: str, codec: CodecLike
    ) -> RetriedRequest[Any]:
        self._session.check()
        converter = converter_of(returns)
        payload = payload_of(value, codec_of(codec))
        asked = text("robot", robot), text("topic", topic)
        timeout = seconds("timeout", timeout)
        return RetriedRequest(self._session, *asked, payload, text("urgency", urgency), timeout, converter)

    def _request(
        self,
        robot: str | None,
        topic: str,
        value: Any,
        returns: Any,
        timeout: float,
        urgency: str,
        codec: CodecLike,
        is_stream: bool = False,
    ) -> Replies[Any]:
        self._session.check()
        converter = converter_of(returns)
        payload = payload_of(value, codec_of(codec))
        timeout = seconds("timeout", timeout)
        topic, urgency = text("topic", topic), text("urgency", urgency)
        return Replies(self._session, robot, topic, payload, urgency, timeout, converter, is_stream)
