"""Owns what a program says about one topic: a publisher of Zenoh's, and the numbers of its messages."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from rect import _rect
from rect._zenoh import qos, refused
from rect.values import Payload

_HIGHEST = 2**32


class Publication:
    """Says things, each with its number."""

    def __init__(self, session: zenoh.Session, key: str, urgency: str, check: Callable[[], None]) -> None:
        try:
            self._publisher = session.declare_publisher(key, **qos(_rect.qos(urgency)))
        except zenoh.ZError as error:
            raise refused("the publisher is refused", error) from None
        self._check = check
        self._source = random.getrandbits(16)
        self._next = 0
        self._lock = threading.Lock()
        self._encoding: tuple[str, zenoh.Encoding | None] = ("", None)

    def put(self, payload: Payload) -> None:
        """Says it; waits where the link has no room."""
        # Held while it is sent: two threads' messages go out in the order of their numbers.
        with self._lock:
            self._check()
            attachment = _rect.write_attachment_now(self._source, self._next)
            try:
                self._publisher.put(payload.bytes, encoding=self._as_zenohs(payload.encoding), attachment=attachment)
            except zenoh.ZError as error:
                # It may have been closed meanwhile.
                self._check()
                raise refused("the message is not sent", error) from None
            self._next = (self._next + 1) % _HIGHEST

    def finish(self, timeout: float) -> None:
        """Waits for who is saying something: a thread that Python's end finds in Zenoh ends the process."""
        if self._lock.acquire(timeout=timeout):
            self._lock.release()

    def _as_zenohs(self, encoding: str) -> Any:
        known, made = self._encoding
        if made is None or known != encoding:
            made = zenoh.Encoding(encoding)
            self._encoding = (encoding, made)
        return made
