"""Observes whether somebody still waits for the reply to a request."""

from __future__ import annotations

import collections
import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING

from rect import _rect
from rect.executor import Executor

if TYPE_CHECKING:
    from rect.session import Session

#: The number of announcements that are kept for requests that still wait for the program.
_MAX_CLOSED = 256


class Waiting:
    """The requester of one request, as long as it waits."""

    def __init__(self, session: Session, requester: _rect.Requester) -> None:
        self._session = session
        self._requester = requester
        self._lock = threading.Lock()
        self._observer: Executor | None = None
        self._is_observed = False
        self._on_left: list[Callable[[], object]] = []
        #: Whether the requester has closed the request, or its program or robot has ended.
        self.has_left = False

    def leave(self) -> None:
        """Handles that the requester does not wait any more."""
        with self._lock:
            self.has_left = True
            callbacks, self._on_left = self._on_left, []
        for callback in callbacks:
            callback()

    def on_left(self, callback: Callable[[], object]) -> None:
        """Calls a function when the requester does not wait any more, on any thread."""
        with self._lock:
            if not self.has_left:
                self._on_left.append(callback)
                return
        callback()

    def observe(self) -> None:
        """Begins to observe the program and the robot of the requester, once."""
        with self._lock:
            if self._is_observed:
                return
            self._is_observed = True
        driver = self._requester.wait(self._session.key_space)
        if driver is not None:
            self._observer = Executor(self._session, driver)
            self._observer.start("rect requester", self.leave)

    def end(self) -> None:
        """Ends the observation."""
        if self._observer is not None:
            self._observer.end()


class OpenRequests:
    """The requests to one service that have not ended, by their ids."""

    def __init__(self) -> None:
        self._open: weakref.WeakValueDictionary[str, Waiting] = weakref.WeakValueDictionary()
        self._closed: collections.deque[str] = collections.deque(maxlen=_MAX_CLOSED)

    def add(self, session: Session, requester: _rect.Requester) -> Waiting | None:
        """Adds a request. Returns nothing if its requester has closed it already."""
        waiting = Waiting(session, requester)
        if requester.id is not None:
            self._open[requester.id] = waiting
            if requester.id in self._closed:
                return None
        return waiting

    def on_closed(self, id: str) -> None:
        """Handles that a requester has closed a request, which may still wait for the program."""
        self._closed.append(id)
        waiting = self._open.get(id)
        if waiting is not None:
            waiting.leave()
