"""Records messages in MCAP files, and reads them back."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import threading
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any, Union

import zenoh

from rect import _rect, registry
from rect.errors import Closed, NoService, PayloadError, RectError
from rect.events import Event, Events
from rect.executor import Executor
from rect.message import Message, utc
from rect.recording_queries import RecordingQueries
from rect.subscriber import Subscriber, Subscription
from rect.values import Payload

if TYPE_CHECKING:
    import numpy

    from rect.session import Session

_Path = Union[str, "os.PathLike[str]"]


class Recorder:
    """Records messages until it is closed. Returned by `Robot.record`.

    Recording never blocks the program: messages that a slow or full disk does not take wait in 8 MB of memory, and are
    then dropped and counted, urgent ones last. Until the recorder is closed, the recording is a folder, in which a file
    is completed every five seconds; `Recording` reads it, too. Meanwhile, `rect recording fetch` copies parts of it to
    other robots.
    """

    def __init__(
        self,
        session: Session,
        path: _Path,
        patterns: tuple[str, ...],
        keep: float | None,
        split_after: float | None,
        split_bytes: int | None,
        logs: bool,
    ) -> None:
        place = session.key_space
        self._session = session
        self._recorder = _rect.Recorder(os.fspath(path), place, patterns, keep, split_after, split_bytes)
        self._counts = (0, 0)
        self._closing = threading.Event()
        self._logs: list[Executor] = []
        try:
            inbound = _rect.Inbound.of_recorder(place, patterns)
            messages: Subscriber = Subscriber(
                session, inbound, "to record", None, _rect.RECORDER_CAPACITY, "drop_oldest"
            )
            self._subscriptions: list[Subscription[Any]] = [
                Subscription(messages, self._add, "recorder"),
                Subscription(Events(session), self._add_event, "events"),
            ]
            if logs:
                self._record_logs()
            self._queries = RecordingQueries(session, self._recorder)
        except BaseException:
            self._end_logs()
            self._recorder.finish()
            raise
        if not session.is_direct:
            threading.Thread(target=self._record_links, name="rect links", daemon=True).start()

    def _add(self, message: Message) -> None:
        request = self._recorder.add(message._metadata, message.payload.bytes, message.payload.encoding)
        if request is not None:
            # The sender of a video is asked for a key frame; the session may be closing.
            with contextlib.suppress(zenoh.ZError, Closed), self._session.calls:
                self._session.zenoh.put(*request)

    def _add_event(self, event: Event) -> None:
        self._recorder.add_event(self._session.key_space.robot, dataclasses.astuple(event))

    def _record_logs(self) -> None:
        for driver in self._recorder.logs():
            executor = Executor(self._session, driver)
            self._logs.append(executor)
            executor.start("rect logs")

    def _end_logs(self) -> None:
        for executor in self._logs:
            executor.end()

    def _record_links(self) -> None:
        while not self._closing.is_set():
            try:
                self._recorder.add_connections(self._session.key_space.robot, registry.report(self._session))
            except (NoService, Closed):
                # A router without the registry, such as a stock zenohd, has nothing to report.
                return
            except RectError:
                # The router is busy or restarts.
                pass
            self._closing.wait(_rect.LINKS_EVERY_S)

    @property
    def recorded(self) -> int:
        """Number of messages in the recording."""
        return self._current()[0]

    @property
    def dropped(self) -> int:
        """Number of messages that the disk did not take."""
        return self._current()[1]

    @property
    def problem(self) -> str | None:
        """Why the disk takes nothing at the moment. `None` if it does."""
        progress = self._recorder.progress()
        return progress[1] if progress else None

    def close(self) -> None:
        """Stops recording, and makes one file of it, or several if it is split.

        Raises `RecordingError` if the disk fails; the parts remain then, and can be read.
        """
        self._closing.set()
        for subscription in self._subscriptions:
            subscription.close()
        self._end_logs()
        self._queries.close()
        self._counts = self._recorder.finish() or self._counts

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _current(self) -> tuple[int, int]:
        progress = self._recorder.progress()
        return progress[0] if progress else self._counts


class RecordedMessage(Message[Any]):
    """A message of a recording."""

    __slots__ = ("_recorded_s",)

    def __init__(self, metadata: _rect.MessageMetadata, payload: Payload, recorded_s: float) -> None:
        super().__init__(metadata, payload)
        self._recorded_s = recorded_s

    @property
    def recorded_at(self) -> datetime:
        """When the message was recorded, by the recorder's clock, in UTC."""
        return utc(self._recorded_s)


class Recording:
    """Reads a recording: an MCAP file, or the folder of one that runs or was interrupted.

    Iterating yields each `RecordedMessage` in the order of recording, also if another program has written the file in
    another one. Messages of other programs, whose topics do not
    begin with the name of a robot, are skipped. Raises `RecordingError` if the recording is damaged or not there.

        for message in rect.Recording("match.mcap"):
            print(message.recorded_at, message.sender, message.topic, message.value)
    """

    def __init__(self, path: _Path) -> None:
        self._path = os.fspath(path)
        # Fails here rather than in the first iteration.
        _rect.RecordingReader(self._path, [])

    def __iter__(self) -> Iterator[RecordedMessage]:
        return self.messages()

    def messages(self, *patterns: str) -> Iterator[RecordedMessage]:
        """Yields the messages that match one of the patterns, such as `wombat-1/arm/*`. Without patterns, all.

        Raises `InvalidTopicError`, and `RecordingError` at the first damaged place.
        """
        reader = _rect.RecordingReader(self._path, list(patterns))
        while (found := reader.next()) is not None:
            metadata, payload, encoding, recorded_s = found
            yield RecordedMessage(metadata, Payload(payload, encoding), recorded_s)

    def numbers(self, pattern: str) -> dict[str, numpy.ndarray[Any, Any]]:
        """Returns the numbers in the messages that match a pattern, as arrays of equal length.

        The array `time_s` has the seconds since the start of the recording. The others are named after the fields of
        the values: `at.x` for `{"at": {"x": 1}}`, `0`, `1` and so on for a list or an array of numbers, and `value` for
        a value that is a number. A message without a field, or without a readable value, has NaN there.
        `pandas.DataFrame(recording.numbers("wombat-1/arm/angle"))` is a table of them.
        """
        columns = _Columns(self._started())
        for message in self.messages(pattern):
            fields: dict[str, float] = {}
            with contextlib.suppress(PayloadError):
                _collect("", message.value, fields)
            columns.add(message._recorded_s, fields)
        return columns.arrays()

    def links(self) -> dict[tuple[str, str], dict[str, numpy.ndarray[Any, Any]]]:
        """Returns the state of the links over time, by recording robot and the robot at the other end.

        The arrays are like those of `numbers`, with the fields of a connection in the registry
        (docs/reference/registry.md): `rssi_dbm`, `round_trip_ms`, `sent.bytes` and so on.

            signal = rect.Recording("match.mcap").links()["wombat-1", "wombat-2"]
            matplotlib.pyplot.plot(signal["time_s"], signal["rssi_dbm"])
        """
        started = self._started()
        links: dict[tuple[str, str], _Columns] = {}
        for robot, peer, value, recorded_s in self._reports(_rect.RECORDED_LINK):
            fields: dict[str, float] = {}
            _collect("", value, fields)
            links.setdefault((robot, peer), _Columns(started)).add(recorded_s, fields)
        return {ends: columns.arrays() for ends, columns in links.items()}

    def events(self) -> Iterator[RecordedEvent]:
        """Yields the events of the recording robots: robots, links and routers that appeared and disappeared."""
        for robot, _, value, recorded_s in self._reports(_rect.RECORDED_EVENTS):
            known: dict[str, Any] = {field.name: value.get(field.name) for field in dataclasses.fields(Event)}
            yield RecordedEvent(utc(recorded_s), robot, Event(**known))

    def requests(self) -> Iterator[RecordedRequest]:
        """Yields the requests to services of the recording robots."""
        for robot, _, value, recorded_s in self._reports(_rect.RECORDED_REQUESTS):
            asked_by, topic = value.get("sender"), str(value.get("topic"))
            yield RecordedRequest(utc(recorded_s), robot, asked_by, topic, value.get("value"))

    def _reports(self, subject: str) -> Iterator[tuple[str, str, dict[str, Any], float]]:
        """Yields the reports of a subject: the robot, the rest of the subject, the value, and the time of recording."""
        reader = _rect.RecordingReader(self._path, [])
        while (found := reader.next_report()) is not None:
            topic, text, recorded_s = found
            robot, _, of, *rest = [*topic.split("/"), ""]
            # A file of another program may have anything there.
            with contextlib.suppress(ValueError):
                value = json.loads(text)
                if of == subject and isinstance(value, dict):
                    yield robot, rest[0] if rest else "", value, recorded_s

    def _started(self) -> float:
        """Returns when the first message or report was recorded."""
        return _rect.RecordingReader(self._path, []).started() or 0.0


@dataclasses.dataclass(frozen=True)
class RecordedEvent:
    """An event in a recording."""

    #: When it was recorded, by the recorder's clock, in UTC.
    recorded_at: datetime
    #: The robot whose program received the event.
    reporter: str
    #: The event.
    event: Event


@dataclasses.dataclass(frozen=True)
class RecordedRequest:
    """A request in a recording. The replies are not recorded."""

    #: When it arrived, by the recorder's clock, in UTC.
    recorded_at: datetime
    #: The robot that was asked.
    robot: str
    #: The robot that asked. `None` if that program does not use RECT.
    sender: str | None
    #: Topic of the service.
    topic: str
    #: The value. `None` if it is larger than 4 kB, or neither text nor one that JSON can express.
    value: Any


class _Columns:
    """Makes arrays of rows whose fields may differ."""

    def __init__(self, started: float) -> None:
        self._started = started
        self._rows: list[tuple[float, dict[str, float]]] = []

    def add(self, at: float, fields: dict[str, float]) -> None:
        self._rows.append((at - self._started, fields))

    def arrays(self) -> dict[str, numpy.ndarray[Any, Any]]:
        import numpy

        names = dict.fromkeys(name for _, fields in self._rows for name in fields)
        columns = {name: numpy.array([fields.get(name, numpy.nan) for _, fields in self._rows]) for name in names}
        return {"time_s": numpy.array([time_s for time_s, _ in self._rows]), **columns}


def _collect(name: str, value: Any, to: dict[str, float]) -> None:
    """Adds the numbers of a value to `to`, by the names of their fields."""
    if isinstance(value, (bool, int, float)):
        to[name or "value"] = float(value)
    elif isinstance(value, Mapping):
        for field, inner in value.items():
            _collect(f"{name}.{field}" if name else str(field), inner, to)
    elif isinstance(value, (list, tuple)):
        for index, inner in enumerate(value):
            _collect(f"{name}.{index}" if name else str(index), inner, to)
    elif hasattr(value, "tolist"):
        # An array of numpy.
        _collect(name, value.tolist(), to)
