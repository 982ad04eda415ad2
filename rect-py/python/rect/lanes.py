"""Owns the ways of a program to its router, one for each urgency.

What comes over one TCP connection a router takes in as it came: where bulk waits for room on a radio, a stop command
behind it would wait, too. So what is urgent has a session of its own, and so has bulk; each is opened when it is first
needed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import zenoh

from rect import _rect
from rect.errors import RectError

_LOG = logging.getLogger("rect")


class Lanes:
    """Where to speak with which urgency. `open` opens another session; `None`: without a router there is no other."""

    def __init__(self, normal: zenoh.Session, open: Callable[[], zenoh.Session] | None) -> None:
        self._normal = normal
        self._open = open
        self._lock = threading.Lock()
        self._others: dict[str, zenoh.Session] = {}

    def of(self, urgency: str) -> zenoh.Session:
        """Where to speak with that urgency."""
        if self._open is None or not _rect.goes_apart(urgency):
            return self._normal
        with self._lock:
            known = self._others.get(urgency)
            if known is not None:
                return known
            # Nobody is to wait for a router that is not there.
            if self._normal.is_closed() or not self._normal.info.routers_zid():
                return self._normal
            try:
                opened = self._others[urgency] = self._open()
            except RectError as error:
                _LOG.warning("what is %s has no connection of its own with the router: %s", urgency, error)
                return self._normal
            return opened

    def is_open(self, urgency: str) -> bool:
        """Whether speaking so has to wait for no connection."""
        return self._open is None or urgency in self._others or not _rect.goes_apart(urgency)

    def all(self) -> list[zenoh.Session]:
        """All that are open."""
        return [self._normal, *self._others.values()]

    def close(self) -> None:
        """Ends all of them."""
        for session in self.all():
            session.close()
