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
        if self._choose(urgency, is_linked=True) == "normal":
            return self._normal
        with self._lock:
            is_linked = not self._normal.is_closed() and bool(self._normal.info.routers_zid())
            choice = self._choose(urgency, is_linked)
            if choice == "separate":
                return self._others[urgency]
            if choice == "normal" or self._open is None:
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
        return self._choose(urgency, is_linked=True) != "open"

    def _choose(self, urgency: str, is_linked: bool) -> str:
        return _rect.choose_session(urgency, self._open is not None, urgency in self._others, is_linked)

    def all(self) -> list[zenoh.Session]:
        """Returns all open sessions."""
        return [self._normal, *self._others.values()]

    def close(self) -> None:
        """Closes all sessions."""
        for session in self.all():
            session.close()
