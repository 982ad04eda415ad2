"""Owns what all of one program's handles share: the session below, how it ends, and what a fork makes of it."""

from __future__ import annotations

import atexit
import contextlib
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect, state
from rect._zenoh import patiently, refused
from rect.decoder import Decoder
from rect.errors import Closed
from rect.inbox import Inbox
from rect.lanes import Lanes
from rect.options import Options, tokens_of_router
from rect.publication import Publication
from rect.request import Replies
from rect.state import Known
from rect.subscriber import Declared, undeclared

if TYPE_CHECKING:
    from rect.stream import Stream

#: The most topics whose publishers are kept; of more, they are declared anew when one speaks about them again.
_MAX_PUBLICATIONS = 256


class Session:
    """What all of one program's handles share: the session below, and what has to end with it."""

    def __init__(self, options: Options) -> None:
        if _FORKED:
            raise Closed(_AFTER_FORK)
        self.place = options.place()
        self.is_direct = options.is_direct
        _ONCE_OPEN[:] = [True]
        self.zenoh = options.open()
        self.lanes = Lanes(self.zenoh, None if self.is_direct else options.open)
        self.decoder = Decoder(self.zenoh, self.place)
        self.counting = _rect.Counting()
        #: Whatever is declared, until it ends.
        self.handles: set[Declared] = set()
        #: What nobody has any more, and is to be ended where that may take a moment.
        self.left: deque[Declared | Replies] = deque()
        #: Where somebody waits for answers.
        self.inboxes: set[Inbox[Any]] = set()
        #: Called when it closes, before Zenoh does.
        self.endings: list[Callable[[], object]] = []
        #: What sends frames.
        self.streams: weakref.WeakSet[Stream] = weakref.WeakSet()
        self._threads: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._why_closed: str | None = None
        self._publications: dict[tuple[str, str | None, str], Publication] = {}
        self.known: Known | None = None
        self._presence: zenoh.LivelinessToken | None = None
        _OPEN.add(self)
        try:
            if self.is_direct:
                self._presence = state.say_there(self.zenoh, self.place)
            else:
                if not options.allow_name_mismatch:
                    _rect.check_router(self.place, options.endpoint, tokens_of_router(self.zenoh))
                self.known = Known(self)
        except BaseException:
            self.close()
            raise

    @property
    def is_closed(self) -> bool:
        return self._why_closed is not None

    def closed_error(self) -> Closed:
        return Closed(self._why_closed or "the session is closed")

    def check(self) -> None:
        """Raises if it is closed; ends what nobody has any more."""
        if self._why_closed is not None:
            raise self.closed_error()
        while self.left:
            with contextlib.suppress(IndexError):
                self.left.popleft().end()

    def publication(self, topic: str, to: str | None, urgency: str) -> Publication:
        spoken = (topic, to, urgency)
        known = self._publications.get(spoken)
        if known is not None:
            return known
        place = self.place
        key = place.publication(topic) if to is None else place.message(to, topic)
        made = Publication(self.lanes.of(urgency), key, urgency, self.check)
        with self._lock:
            if len(self._publications) >= _MAX_PUBLICATIONS:
                self._publications.clear()
            return self._publications.setdefault(spoken, made)

    def close(self) -> None:
        with self._lock:
            if self._why_closed is not None:
                return
            self._why_closed = "the session is closed"
        for ending in list(self.endings):
            ending()
        for handle in list(self.handles):
            handle.end()
        for inbox in list(self.inboxes):
            inbox.close()
        if self._presence is not None:
            undeclared(self._presence)
        _OPEN.discard(self)
        try:
            patiently(self.lanes.close)
        except zenoh.ZError as error:
            raise refused("the session does not close", error) from None
        finally:
            self._finish()

    def start(self, name: str, run: Callable[[], object]) -> None:
        """Runs something on a thread of its own, which ends soon after the session does."""
        thread = threading.Thread(target=run, name=name, daemon=True)
        self._threads.add(thread)
        thread.start()

    def _finish(self) -> None:
        """Waits for what is in Zenoh still: where Python ends, nobody may be."""
        with self._lock:
            publications = list(self._publications.values())
        for publication in publications:
            publication.finish(_FINISH_S)
        for stream in list(self.streams):
            stream.finish(_FINISH_S)
        for thread in list(self._threads):
            if thread is not threading.current_thread():
                thread.join(_FINISH_S)

    def on_fork(self) -> None:
        """In a child process, where Zenoh's threads are not: nothing of it may be touched, not even to end it."""
        self._why_closed = _AFTER_FORK
        # With it all of Zenoh's that it leads to: their ends would wait for locks that the parent's threads held.
        _rect.forget(self)
        for inbox in list(self.inboxes):
            inbox.on_fork()
        for handle in list(self.handles):
            handle.on_fork()


#: How long the end waits for one that is in Zenoh still, in seconds.
_FINISH_S = 1.0
_AFTER_FORK = (
    "Zenoh does not work in a process that was forked from one where it ran: fork before rect.connect, or start "
    'processes by multiprocessing.get_context("spawn")'
)
#: Whether a robot was joined in the process that this one was forked from.
_FORKED: list[bool] = []
#: Whether one was joined in this process.
_ONCE_OPEN: list[bool] = []
#: All that are open: they end before Python does, whose threads Zenoh's would wait for.
_OPEN: weakref.WeakSet[Session] = weakref.WeakSet()


def _close_all() -> None:
    for session in list(_OPEN):
        with contextlib.suppress(Exception):
            session.close()
    _rect.settle(_FINISH_S)


def _on_fork() -> None:
    _rect.forget_work()
    if _ONCE_OPEN:
        _FORKED[:] = [True]
    for session in list(_OPEN):
        session.on_fork()
        _OPEN.discard(session)


atexit.register(_close_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_on_fork)
