"""Defines `Message`, which subscribers and callbacks receive."""

from __future__ import annotations

import html
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from typing import Any, Generic

from rect import _rect
from rect.choices import Urgency
from rect.errors import PayloadError
from rect.typed import Converter, T
from rect.values import Payload, reduced


class _Unread:
    """In place of a value that nobody has asked for. A class, because `pickle` and `copy` keep its identity."""


UNREAD: Any = _Unread
_1970 = datetime(1970, 1, 1, tzinfo=timezone.utc)


def utc(seconds: float) -> datetime:
    """Returns the time that is `seconds` after 1970. A time after the year 9999 becomes the last one of it."""
    # `datetime.fromtimestamp` raises an error for such times, which a wrong clock of a robot may show.
    try:
        return _1970 + timedelta(seconds=seconds)
    except OverflowError:
        return datetime.max.replace(tzinfo=timezone.utc)


@dataclass(frozen=True)
class Retained:
    """That a message is of a retained topic, and how old its value is."""

    #: How long ago the value was published, in seconds, by the clock of its robot's router.
    age: float
    #: Whether the program that published it has ended.
    has_ended: bool
    #: Whether the robot has forgotten the topic. Then the message has the value `None`.
    is_forgotten: bool


class Message(Generic[T]):
    """A message from another robot, or from another program of this robot.

    `Message[Battery]` has a `value` of the type `Battery`.
    """

    __slots__ = ("_metadata", "_value", "method", "payload", "problem")

    def __init__(self, metadata: _rect.MessageMetadata, payload: Payload, method: str | None = None) -> None:
        self._metadata = metadata
        self._value = UNREAD
        #: The payload: bytes with an encoding.
        self.payload = payload
        #: The method by which the message arrived, such as `ble`. `None` if it is unknown, or if the sender has links
        #: of several methods to this robot.
        self.method = method
        #: Why there is no `value`. A `CodecError`: `payload` could not be decoded and is still compressed, since it is
        #: damaged, its codec is not supported, or the sender did not send the dictionary. A `MismatchError`: the value
        #: does not fit the type that the subscriber states. `None` if there is a value.
        self.problem: PayloadError | None = None

    @property
    def value(self) -> T:
        """The decoded payload, as the type that the subscriber states.

        By default a dict, text, a numpy array, a `Picture` and so on, or bytes if the encoding is unknown. `None` if
        the robot has forgotten the retained topic.

        Raises `PayloadError` if the bytes do not match the encoding, and `problem` if there is one.
        """
        if self._value is UNREAD:
            if self.problem is not None:
                raise self.problem
            self._value = None if self.is_forgotten else self.payload.value
        value: Any = self._value
        return value  # type: ignore[no-any-return, unused-ignore]

    def fit(self, converter: Converter[T]) -> None:
        """Converts the value to the type that the subscriber states, or sets `problem`."""
        try:
            self._value = converter.convert(self.payload.value)
        except PayloadError as problem:
            self.problem = problem

    @property
    def sender(self) -> str:
        """Name of the robot that sent the message."""
        return self._metadata.sender

    @property
    def recipient(self) -> str | None:
        """Name of the robot that the message was sent to. `None` if the message was published to all robots."""
        return self._metadata.recipient

    @property
    def topic(self) -> str:
        """Topic of the message."""
        return self._metadata.topic

    @property
    def encoding(self) -> str:
        """Encoding of the payload, such as `application/json`."""
        return self.payload.encoding

    @property
    def urgency(self) -> Urgency:
        """Urgency with which the message was sent."""
        return self._metadata.urgency

    @property
    def sent_at(self) -> datetime | None:
        """Time of sending by the sender's clock, in UTC. `None` if the sender does not use RECT.

        The clock of a robot without a real-time clock may be years off.
        """
        sent_at_ms = self._metadata.sent_at_ms
        return None if sent_at_ms is None else utc(sent_at_ms / 1000)

    @property
    def sequence(self) -> int | None:
        """Sequence number of the message at its source, modulo 2**32. `None` if the sender does not use RECT."""
        return self._metadata.sequence

    @property
    def missed(self) -> int:
        """Number of messages of the same source, directly before this one, that did not arrive."""
        return self._metadata.missed

    @property
    def skipped(self) -> int:
        """Number of messages of the same source, directly before this one, that were left out because the subscription
        asks for fewer (`max_hz`, `on_change`)."""
        return self._metadata.skipped

    @property
    def late(self) -> bool:
        """Whether a message of the same source with a higher sequence number arrived before this one."""
        return self._metadata.late

    @property
    def replayed(self) -> bool:
        """Whether the message repeats one of a recording (`rect replay`). `sent_at` is the time of that one."""
        return self._metadata.replayed

    @property
    def retained(self) -> Retained | None:
        """That the topic is retained, and how old this value of it is. `None`: the topic is not retained."""
        retained = self._metadata.retained
        return None if retained is None else Retained(*retained)

    @property
    def is_forgotten(self) -> bool:
        """Whether the robot has forgotten the retained topic. Then `value` is `None`."""
        retained = self._metadata.retained
        return retained is not None and retained[2]

    @property
    def is_expired(self) -> bool:
        """Whether the message is older than the sender's `expires_after` by now. It was not when it was delivered."""
        return self._metadata.is_expired

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def __repr__(self) -> str:
        return f"Message({self.sender}/{self.topic}, {self._shown()})"

    def _shown(self) -> str:
        try:
            shown = repr(self.value)
        except Exception as error:
            shown = f"{self.encoding}: {error}"
        return shown if len(shown) <= 200 else shown[:199] + "…"

    def _repr_html_(self) -> str:
        head = f"<b>{html.escape(self.sender)}</b>/{html.escape(self.topic)}"
        try:
            picture = getattr(self.value, "_repr_png_", None)
        except PayloadError:
            picture = None
        if picture is None:
            return f"{head}: <code>{html.escape(self._shown())}</code>"
        import base64

        return f'{head}<br><img src="data:image/png;base64,{base64.b64encode(picture()).decode()}">'
