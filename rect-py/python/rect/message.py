"""Owns messages as a program gets them."""

from __future__ import annotations

import html
from typing import Any

from rect import _rect
from rect.errors import CodecError
from rect.values import Payload

_UNREAD: Any = object()


class Message:
    """A message from another robot, or another program of this one."""

    __slots__ = ("_said", "_value", "flaw", "over", "payload")

    def __init__(self, said: _rect.Said, payload: Payload, over: str | None = None) -> None:
        self._said = said
        self._value = _UNREAD
        #: What it says, as bytes with an encoding.
        self.payload = payload
        #: By what it came, as `ble`, where its sender has one link with this robot, and that is known.
        self.over = over
        #: Why it is still packed as it came, if it is: it is damaged, or of a codec that is not known here.
        self.flaw: CodecError | None = None

    @property
    def value(self) -> Any:
        """What it says: a dict, text, a numpy array, a `Picture`...; bytes where the encoding is not known here.

        Raises `PayloadError` where the bytes are not what the encoding says.
        """
        if self._value is _UNREAD:
            if self.flaw is not None:
                raise self.flaw
            self._value = self.payload.value
        return self._value

    @property
    def sender(self) -> str:
        """Who sent it."""
        return self._said.sender

    @property
    def from_(self) -> str:
        """The same; `from` is a word of Python's own."""
        return self._said.sender

    @property
    def to(self) -> str | None:
        """To whom alone; `None`: to all."""
        return self._said.to

    @property
    def topic(self) -> str:
        """About what."""
        return self._said.topic

    @property
    def encoding(self) -> str:
        """What its payload is."""
        return self.payload.encoding

    @property
    def urgency(self) -> str:
        """`urgent`, `normal` or `bulk`."""
        return self._said.urgency

    @property
    def sent_at(self) -> float | None:
        """When, by the sender's clock, in seconds since 1970; `None` for one of a stock program.

        A robot without a clock of its own may be years off.
        """
        sent_ms = self._said.sent_ms
        return None if sent_ms is None else sent_ms / 1000

    @property
    def sequence(self) -> int | None:
        """Its number at its publisher; `None` for one of a stock program."""
        return self._said.sequence

    @property
    def missed(self) -> int:
        """So many of its publisher, before it, did not arrive."""
        return self._said.missed

    @property
    def late(self) -> bool:
        """Whether it was overtaken on its way."""
        return self._said.late

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
        picture = getattr(self.value, "_repr_png_", None) if self.flaw is None else None
        if picture is None:
            return f"{head}: <code>{html.escape(self._shown())}</code>"
        import base64

        return f'{head}<br><img src="data:image/png;base64,{base64.b64encode(picture()).decode()}">'
