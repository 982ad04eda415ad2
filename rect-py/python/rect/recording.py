"""Records messages in MCAP files, and reads them back."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Union

from rect import _rect
from rect.errors import PayloadError
from rect.message import Message
from rect.options import text
from rect.subscriber import Subscriber, Subscription
from rect.values import Payload

if TYPE_CHECKING:
    import numpy

    from rect.session import Session

_Path = Union[str, "os.PathLike[str]"]
#: How many messages wait for the recorder at most, for each pattern.
_CAPACITY = 4096


class Recorder:
    """Records messages until it is closed. Returned by `Robot.record`.

    Recording never blocks the program: messages that a slow or full disk does not take wait in 8 MB of memory, and are
    then dropped and counted, urgent ones last. Until the recorder is closed, the recording is a folder, in which a file
    is completed every five seconds; `Recording` reads it, too.
    """

    def __init__(self, session: Session, path: _Path, patterns: tuple[str, ...], keep: float | None) -> None:
        place = session.key_space
        patterns = patterns or (f"{place.robot}/**",)
        about = {"robot": place.robot, "fleet": place.fleet, "patterns": " ".join(patterns), "rect": _rect.__version__}
        self._recorder = _rect.Recorder(os.fspath(path), about, keep)
        self._counts = (0, 0)
        try:
            self._subscriptions = [self._subscribe(session, pattern) for pattern in patterns]
        except BaseException:
            self._recorder.finish()
            raise

    def _subscribe(self, session: Session, pattern: str) -> Subscription[Message]:
        subscriber = Subscriber(session, text("pattern", pattern), _CAPACITY, "drop_oldest")
        return Subscription(subscriber, self._add, pattern)

    def _add(self, message: Message) -> None:
        self._recorder.add(message._metadata, message.payload.bytes, message.payload.encoding)

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
        """Stops recording, and makes one file of it.

        Raises `RecordingError` if the disk fails; the parts remain then, and can be read.
        """
        for subscription in self._subscriptions:
            subscription.close()
        self._counts = self._recorder.finish() or self._counts

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _current(self) -> tuple[int, int]:
        progress = self._recorder.progress()
        return progress[0] if progress else self._counts


class RecordedMessage(Message):
    """A message of a recording."""

    __slots__ = ("recorded_at",)

    def __init__(self, metadata: _rect.MessageMetadata, payload: Payload, recorded_at: float) -> None:
        super().__init__(metadata, payload)
        #: When the message was recorded, in seconds since 1970 by the recorder's clock.
        self.recorded_at = recorded_at


class Recording:
    """Reads a recording: an MCAP file, or the folder of one that runs or was interrupted.

    Iterating yields each `RecordedMessage` in the order of recording. Messages of other programs, whose topics do not
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
            metadata, payload, encoding, recorded_at = found
            yield RecordedMessage(metadata, Payload(payload, encoding), recorded_at)

    def numbers(self, pattern: str) -> dict[str, numpy.ndarray[Any, Any]]:
        """Returns the numbers in the messages that match a pattern, as arrays of equal length.

        The array `time_s` has the seconds since the start of the recording. The others are named after the fields of
        the values: `at.x` for `{"at": {"x": 1}}`, and `value` for a value that is a number. A message without a field,
        or without a readable value, has NaN there. `pandas.DataFrame(recording.numbers("wombat-1/arm/angle"))` is a
        table of them.
        """
        import numpy

        rows: list[tuple[float, dict[str, float]]] = []
        started: float | None = None
        for message in self.messages(pattern):
            if started is None:
                started = next(iter(self)).recorded_at
            fields: dict[str, float] = {}
            with contextlib.suppress(PayloadError):
                _collect("", message.value, fields)
            rows.append((message.recorded_at - started, fields))
        names = list(dict.fromkeys(name for _, fields in rows for name in fields))
        columns = {name: numpy.array([fields.get(name, numpy.nan) for _, fields in rows]) for name in names}
        return {"time_s": numpy.array([time_s for time_s, _ in rows]), **columns}


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
