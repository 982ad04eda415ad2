"""Opens a separate Zenoh session with the router for each urgency.

A router reads one TCP connection in order: if bulk data waits for a radio link, a stop command behind it would wait,
too. Urgent and bulk messages therefore use separate sessions, each of which is opened on first use.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import zenoh

from rect import _rect
from rect.errors import RectError

_LOG = logging.getLogger("rect")


class UrgencySessions:
    """The sessions of a program by urgency. `open` opens another one; it is `None` if the program uses no router."""

    def __init__(self, normal: zenoh.Session, open: Callable[[], zenoh.Session] | None) -> None:
        self._normal = normal
        self._open = open
        self._lock = threading.Lock()
        self._others: dict[str, zenoh.Session] = {}

    def of(self, urgency: str) -> zenoh.Session:
        """Returns the session for messages of that urgency, and opens it if necessary."""
        if self._open is None or not _rect.uses_separate_session(urgency):
            return self._normal
        with self._lock:
            session = self._others.get(urgency)
            if session is not None:
                return session
            # Do not wait for a router that is unreachable.
            if self._normal.is_closed() or not self._normal.info.routers_zid():
                return self._normal
            try:
                opened = self._others[urgency] = self._open()
            except RectError as error:
                _LOG.warning(
                    "cannot open a separate session for %s messages: %s. They share the session for normal ones.",
                    urgency,
                    error,
                )
                return self._normal
            return opened

    def is_open(self, urgency: str) -> bool:
        """Whether `of` returns without opening a session."""
        return self._open is None or urgency in self._others or not _rect.uses_separate_session(urgency)

    def all(self) -> list[zenoh.Session]:
        """Returns all open sessions."""
        return [self._normal, *self._others.values()]

    def close(self) -> None:
        """Closes all sessions."""
        for session in self.all():
            session.close()
