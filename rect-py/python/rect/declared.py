"""Holds the Zenoh declarations of one handle, and ends them."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect._zenoh import undeclared
from rect.receive_queue import ReceiveQueue

if TYPE_CHECKING:
    from rect.session import Session


class Declared:
    """The Zenoh declarations of one handle, and the receive queue that they fill."""

    def __init__(
        self,
        session: Session,
        queue: ReceiveQueue[Any] | None = None,
        on_end: Callable[[], object] | None = None,
    ) -> None:
        self._session = session
        self._queue = queue
        self._on_end = on_end
        self._declared: list[Any] = []
        self._kept: object = None
        self._finalizer: weakref.finalize[..., Any] | None = None
        session.handles.add(self)

    def add(self, declared: Any) -> None:
        self._declared.append(declared)

    def remove(self, declared: Any) -> bool:
        """Removes a declaration that the caller ends. Returns `False` if `end` ends it, on another thread."""
        try:
            self._declared.remove(declared)
        except ValueError:
            return False
        return True

    def keep(self, kept: object) -> None:
        """Keeps an object in a child process after a fork, since it refers to threads of the parent."""
        self._kept = kept

    def leave_with(self, handle: object, leave: Callable[[], None] | None = None) -> None:
        """Calls `leave`, by default this object's, when `handle` is garbage-collected without having been closed."""
        self._finalizer = weakref.finalize(handle, leave or self.leave)
        self._finalizer.atexit = False

    def end(self) -> None:
        """Undeclares everything and closes the queue. Items that are waiting can still be taken."""
        # A closed handle needs no finaliser. Python ignores a KeyboardInterrupt that is raised in one.
        if self._finalizer is not None:
            self._finalizer.detach()
        # The queue comes first, since a thread of Zenoh may be waiting for room in it.
        if self._queue is not None:
            self._queue.close()
        if self._on_end is not None:
            self._on_end()
        self._session.handles.discard(self)
        declared, self._declared = self._declared, []
        for one in declared:
            if not self._session.is_closed:
                with self._session.calls:
                    undeclared(one)

    def on_fork(self) -> None:
        """Drops the declarations in a child process: they belong to threads of the parent."""
        for one in [*self._declared, self._kept]:
            _rect.forget(one)
        if self._queue is not None:
            self._queue.on_fork()

    def leave(self) -> None:
        """Schedules `end` for a handle that was garbage-collected. Does not block: the session calls `end` later."""
        if self._queue is not None:
            self._queue.close()
        self._session.abandoned.append(self)
