"""Publishes the messages of one topic, and numbers them."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from rect import _rect
from rect._zenoh import undeclared, zenoh_error
from rect.values import Payload


class Publication:
    """A Zenoh publisher whose messages carry a source and a sequence number."""

    def __init__(self, session: zenoh.Session, key: str, qos: dict[str, Any], check: Callable[[], None]) -> None:
        try:
            #: The publisher of Zenoh.
            self.publisher = session.declare_publisher(key, **qos)
        except zenoh.ZError as error:
            raise zenoh_error("cannot declare the publisher", error) from error
        self._check = check
        self._numbering = _rect.Numbering(random.getrandbits(16))
        self._lock = threading.Lock()
        self._encoding: tuple[str, zenoh.Encoding | None] = ("", None)

    def put(self, payload: Payload, lifetime: float | None) -> None:
        """Publishes a payload, which expires after `lifetime` seconds or never. Waits if the link is congested."""
        # The lock is held while sending, so that messages of several threads are sent in order of their numbers.
        with self._lock:
            self._check()
            attachment = self._numbering.attachment(lifetime)
            try:
                self.publisher.put(payload.bytes, encoding=self._convert(payload.encoding), attachment=attachment)
            except zenoh.ZError as error:
                # The session may have been closed in the meantime.
                self._check()
                raise zenoh_error("cannot send the message", error) from error
            self._numbering.on_sent()

    def undeclare(self) -> None:
        """Undeclares the publisher, unless a message is being sent. Zenoh keeps a session that has publishers."""
        if self._lock.acquire(blocking=False):
            try:
                undeclared(self.publisher)
            finally:
                self._lock.release()

    def finish(self, timeout: float) -> None:
        """Waits for a message that is being sent: Python aborts if a thread is inside Zenoh when it exits."""
        if self._lock.acquire(timeout=timeout):
            self._lock.release()

    def _convert(self, encoding: str) -> Any:
        name, converted = self._encoding
        if converted is None or name != encoding:
            converted = zenoh.Encoding(encoding)
            self._encoding = (encoding, converted)
        return converted
