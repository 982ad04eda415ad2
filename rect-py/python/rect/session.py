"""Holds the state that all handles of one robot share, closes it in order, and disables it after a fork."""

from __future__ import annotations

import atexit
import contextlib
import gc
import logging
import os
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import zenoh

from rect import _rect
from rect._zenoh import call_interruptibly, qos, zenoh_error
from rect.errors import Closed, ThreadError
from rect.options import Options
from rect.publication import Publication
from rect.querier import Destination, Querier
from rect.urgency_sessions import UrgencySessions
from rect.values import Payload
from rect.zenoh_calls import ZenohCalls


class Ending(Protocol):
    """A handle, or a request, that ends with the session."""

    def end(self) -> None:
        """Ends it. May block."""


class Waited(Protocol):
    """Something that a call waits for."""

    def close(self) -> None:
        """Ends the wait."""

    def on_fork(self) -> None:
        """Drops what belongs to threads of the parent in a child process."""


class Declaring(Ending, Protocol):
    """A handle with declarations."""

    def on_fork(self) -> None:
        """Drops the declarations in a child process."""


class Presence(Protocol):
    """The presence of this program: its name, and what it serves."""

    name: str | None
    instance: int
    request_ids: _rect.RequestIds
    once: _rect.Once

    def serve(
        self,
        topic: str | _rect.InternalTopic,
        about: str,
        allow_several: bool,
        parameters: _rect.ParameterDeclaration | None = None,
    ) -> None:
        """Announces a service, or a group of parameters, which is then declared."""
        ...

    def is_taken_over(self, topic: str | _rect.InternalTopic) -> bool:
        """Returns whether another program serves a topic now, because this one did not answer."""
        ...

    def end(self, topic: str | _rect.InternalTopic) -> None:
        """Announces the end of a service."""
        ...


class Checking(Protocol):
    """Checks whether the robots are reachable to which a program sends messages."""

    def is_reachable(self, robot: str) -> bool:
        """Whether `check` returns at once."""
        ...

    def check(self, robot: str) -> None:
        """Raises `NotReachable` unless the robot is reachable."""


class Retaining(Protocol):
    """The retained messages of the program."""

    def follow(self, inbound: _rect.Inbound) -> None:
        """Lets a subscription get retained messages through the router alone."""
        ...

    def receive(self, on_message: _rect.OnMessage) -> Any:
        """Delivers the retained messages of a subscription to its queue."""
        ...

    def retain(self, topic: str, payload: Payload, urgency: str, disk: bool) -> None:
        """Publishes a value that the router keeps."""
        ...

    def forget(self, topic: str) -> None:
        """Forgets a topic."""
        ...

    def latest(self, robot: str, topic: str) -> tuple[_rect.MessageMetadata, Payload] | None:
        """Returns the last value of a topic, if there is one."""


class Logging(Protocol):
    """The lines that the program logs."""

    def log(
        self,
        at_ms: int,
        level: str,
        logger: str,
        text: str,
        fields: Mapping[str, Any] | None,
        source: str,
        private: bool,
    ) -> None:
        """Logs a line."""


class Decoding(Protocol):
    """Decodes payloads, with dictionaries that it fetches and serves."""

    def payload(self, sender: str, payload: Payload) -> Payload:
        """Decodes a payload; fetches a missing dictionary first."""
        ...

    def payload_now(self, sender: str, payload: Payload) -> Payload:
        """Decodes a payload with the dictionaries that are present."""
        ...

    def serve(self, dictionary: _rect.Dictionary) -> None:
        """Serves a dictionary."""


_LOG = logging.getLogger("rect")


class Session:
    """The shared state of one robot: its Zenoh sessions, and everything that ends with them."""

    def __init__(self, options: Options) -> None:
        if _FORKED:
            raise Closed(_AFTER_FORK)
        if _CLOSED:
            # A closed session holds Zenoh's memory and open files until the collector frees it. The collector does not
            # know them, and would run too seldom in a program that connects again and again.
            _CLOSED.clear()
            gc.collect()
        self.key_space = options.key_space()
        self.is_direct = options.is_direct
        _ONCE_OPEN[:] = [True]
        self.zenoh = options.open()
        self.urgency_sessions = UrgencySessions(self.zenoh, None if self.is_direct else options.open)
        #: Decodes payloads; set when the session is complete.
        self.decoder: Decoding
        self.counters = _rect.AtomicCounters()
        self.used_names = _rect.UsedNames()
        #: Handles with open declarations.
        self.handles: set[Declaring] = set()
        #: Garbage-collected handles; `check` ends them, since that may block.
        self.abandoned: deque[Ending] = deque()
        #: Queues at which calls wait for replies, and requests that wait for one.
        self.receive_queues: set[Waited] = set()
        #: Functions to call on close, while everything works.
        self.before_close: list[Callable[[], object]] = []
        #: Functions to call on close, before the Zenoh sessions are closed.
        self.close_callbacks: list[Callable[[], object]] = []
        #: Calls of Zenoh that are in progress.
        self.calls = ZenohCalls(self.closed_error)
        self._threads: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._why_closed: str | None = None
        self._publications: dict[tuple[str, str | None, str, bool], Publication] = {}
        self._queriers: dict[tuple[str, str], Querier] = {}
        self._destinations: dict[tuple[str, str, str], Destination] = {}
        #: Last catalogues of robots.
        self.catalogues = _rect.Catalogues()
        #: Presence of this program; set when the session is complete.
        self.program: Presence
        #: Robots to which the program sends messages; set when the session is complete.
        self.recipients: Checking
        #: Retained messages; set when the session is complete.
        self.state: Retaining
        #: Lines that the program logs; set when the session is complete.
        self.log: Logging
        #: The stop of the fleet, once the program takes part in it.
        self.fleet_stop: Any = None
        #: The large results of its actions, once there is one.
        self.results: Any = None
        #: Links of the robot's router; `None` without a router.
        self.links: _rect.Links | None = None
        _OPEN.add(self)

    @property
    def is_closed(self) -> bool:
        return self._why_closed is not None

    def closed_error(self, handle: str = "session") -> Closed:
        """Returns the error that the session is closed, or else that `handle` is."""
        return Closed(self._why_closed or f"the {handle} is closed")

    def check(self) -> None:
        """Raises `Closed` if the session is closed. Ends the garbage-collected handles."""
        if self._why_closed is not None:
            raise self.closed_error()
        while self.abandoned:
            with contextlib.suppress(IndexError):
                self.abandoned.popleft().end()

    def warn(self, text: str | None) -> None:
        """Warns the program, if there is a text."""
        if text is not None:
            _LOG.warning("%s", text)

    def publication(self, topic: str, recipient: str | None, urgency: str, expires: bool) -> Publication:
        """Returns the publisher of a topic, for all robots or one recipient, and declares it if necessary.

        `expires`: whether the messages expire.
        """
        key_parts = (topic, recipient, urgency, expires)
        publication = self._publications.get(key_parts)
        if publication is not None:
            return publication
        self.warn(self.used_names.on_topic(topic))
        key = self.key_space.publication(topic, recipient)
        service = qos(_rect.qos(urgency, expires))
        with self.calls:
            publication = Publication(self.urgency_sessions.of(urgency), key, service, self.check)
        with self._lock:
            if len(self._publications) >= _rect.MAX_DECLARATIONS:
                self._publications.clear()
            return self._publications.setdefault(key_parts, publication)

    def querier(self, urgency: str, key: str) -> Querier:
        """Returns the querier of a key in the session of an urgency, and declares it if necessary."""
        querier = self._queriers.get((urgency, key))
        if querier is not None:
            return querier
        with self.calls:
            querier = Querier(self.urgency_sessions.of(urgency), key)
        removed: list[Querier] = []
        with self._lock:
            if len(self._queriers) >= _rect.MAX_DECLARATIONS:
                removed = list(self._queriers.values())
                self._queriers.clear()
                self._destinations.clear()
            # Another thread may have declared one in the meantime; either will do.
            self._queriers[urgency, key] = querier
        with self.calls:
            for one in removed:
                one.undeclare()
        return querier

    def destination(self, robot: str, topic: str, urgency: str) -> Destination:
        """Returns a service of a robot, and declares its querier if necessary."""
        destination = self._destinations.get((robot, topic, urgency))
        if destination is not None:
            return destination
        destination = Destination(self.key_space, self.program.request_ids, robot, topic, urgency)
        destination.served = self.querier(urgency, destination.key).served
        self._destinations[robot, topic, urgency] = destination
        return destination

    def publish(
        self, topic: str, recipient: str | None, payload: Payload, urgency: str, lifetime: float | None
    ) -> None:
        """Publishes a payload to all robots or one recipient, and counts it. It expires after `lifetime` seconds."""
        called = time.monotonic()
        publication = self.publication(topic, recipient, urgency, lifetime is not None)
        if recipient is not None:
            self.recipients.check(recipient)
        if lifetime is not None:
            # The first message of an urgency waits for its session, and the first one to a robot for its token.
            lifetime -= time.monotonic() - called
            if lifetime <= 0:
                self.counters.on_expired()
                return
        if len(payload.bytes) < _rect.LARGE_BYTES:
            publication.put(payload, lifetime)
        else:
            call_interruptibly(lambda: publication.put(payload, lifetime))
        self.counters.on_sent(len(payload.bytes))

    def close(self) -> None:
        for callback in list(self.before_close):
            callback()
        with self._lock:
            if self._why_closed is not None:
                return
            self._why_closed = "the session is closed"
        for callback in list(self.close_callbacks):
            callback()
        for handle in list(self.handles):
            handle.end()
        for queue in list(self.receive_queues):
            queue.close()
        _OPEN.discard(self)
        try:
            call_interruptibly(self._close_zenoh)
        except zenoh.ZError as error:
            raise zenoh_error("cannot close the session", error) from error
        finally:
            self._finish()
            _CLOSED[:] = [True]

    def _close_zenoh(self) -> None:
        for publication in self._all_publications():
            publication.undeclare()
        with self._lock:
            queriers = list(self._queriers.values())
        for querier in queriers:
            querier.undeclare()
        self.urgency_sessions.close()

    def _all_publications(self) -> list[Publication]:
        with self._lock:
            return list(self._publications.values())

    def start(self, name: str, run: Callable[[], object]) -> None:
        """Runs a function on a new thread, which has to end soon after the session is closed."""
        thread = threading.Thread(target=run, name=name, daemon=True)
        # `close`, on another thread, can only wait for a thread that runs.
        with self._lock:
            try:
                thread.start()
            except RuntimeError as error:
                raise ThreadError(str(error)) from error
            self._threads.add(thread)

    def _finish(self) -> None:
        """Waits for threads that are still inside Zenoh: none may be there when Python exits."""
        for publication in self._all_publications():
            publication.finish(_FINISH_S)
        self.calls.end(_FINISH_S)
        with self._lock:
            threads = list(self._threads)
        for thread in threads:
            if thread is not threading.current_thread():
                thread.join(_FINISH_S)

    def on_fork(self) -> None:
        """Disables the session in a child process, which has no Zenoh threads: it must not even be closed there."""
        self._why_closed = _AFTER_FORK
        # Leak it and all its Zenoh objects: dropping them would wait for locks that threads of the parent held.
        _rect.forget(self)
        for queue in list(self.receive_queues):
            queue.on_fork()
        for handle in list(self.handles):
            handle.on_fork()


#: Longest wait on close for one thread that is still inside Zenoh, in seconds.
_FINISH_S = 1.0
_AFTER_FORK = (
    "Zenoh does not work in a process that was forked from one where it ran: fork before rect.connect, or start "
    'processes with multiprocessing.get_context("spawn")'
)
#: Not empty if this process was forked from one that had used Zenoh.
_FORKED: list[bool] = []
#: Not empty if this process has used Zenoh.
_ONCE_OPEN: list[bool] = []
#: All open sessions. They are closed before Python exits, because Zenoh's threads would wait for Python's.
_OPEN: weakref.WeakSet[Session] = weakref.WeakSet()
#: Not empty if a session was closed since the last one was opened.
_CLOSED: list[bool] = []


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
