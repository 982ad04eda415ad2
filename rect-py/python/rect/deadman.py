"""Carries out commands while they arrive, and stops the motors when they do not."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rect import _rect, advice, stop
from rect.errors import PayloadError
from rect.executor import Executor
from rect.message import Message
from rect.options import seconds, text
from rect.receive_queue import DEFAULT_CAPACITY
from rect.subscriber import Subscriber, Subscription
from rect.typed import converter_of

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")


class Deadman:
    """A dead man's switch. Returned by `Robot.deadman`.

    It ends when it or the robot is closed: `on_lost` is called for the last time, and has returned when `close` does,
    unless it takes longer than a second.
    """

    def __init__(self, executor: DeadmanExecutor, drive: Callable[[Message[Any]], object]) -> None:
        self._executor = executor
        self._drive = drive
        Subscription(executor.subscriber, self._on_message, executor.pattern)

    @property
    def is_following(self) -> bool:
        """Whether the robot follows commands."""
        return self._executor.is_following

    def close(self) -> None:
        """Ends the switch, as a loss."""
        self._executor.end()

    def __enter__(self) -> Deadman:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Deadman({self._executor.pattern}, is_following={self.is_following})"

    def _on_message(self, message: Message[Any]) -> None:
        if self._executor.begin(message):
            try:
                self._drive(message)
            finally:
                self._executor.finish()


class DeadmanExecutor:
    """Executes the switch of the core, whose thread calls `on_lost`."""

    def __init__(
        self,
        session: Session,
        pattern: object,
        drive: object,
        within: object,
        on_lost: Callable[[str], object],
        type: Any,
    ) -> None:
        for name, callback in (("drive", drive), ("on_lost", on_lost)):
            if not callable(callback):
                raise TypeError(f"{name} must be a function, not {callback.__class__.__name__}")
        session.check()
        converter = converter_of(type)
        self.pattern = text("pattern", pattern)
        inbound = _rect.Inbound(session.key_space, self.pattern)
        advice.on_pattern(session, self.pattern)
        self._session = session
        self._on_lost = on_lost
        self._is_ended = False
        self._switch = _rect.DeadmanSwitch(seconds("within", within))
        # It knows of a stop before the first command.
        stop.executor_of(session).core.add(self._switch)
        observer = _rect.observer(session.key_space, session.program.instance, session.is_direct)
        self._observer = Executor(session, observer, self._switch.on_event, is_passive=True)
        session.handles.add(self)
        try:
            self._switch.start(self._lose)
            self._observer.start("rect deadman events")
            arguments = (self.pattern, converter, DEFAULT_CAPACITY, "drop_oldest")
            self.subscriber: Subscriber[Any] = Subscriber(session, inbound, *arguments)
        except BaseException:
            self._end_switch()
            raise

    @property
    def is_following(self) -> bool:
        """Whether the robot follows commands."""
        return not self._is_ended and self._switch.is_following

    def begin(self, message: Message[Any]) -> bool:
        """Returns whether the program may carry out a command. If so, call `finish` afterwards.

        Waits while `on_lost` is running.
        """
        try:
            # A message without a value does not count.
            _ = message.value
        except PayloadError:
            return False
        payload = message.payload
        return self._switch.begin(message._metadata, payload.bytes, payload.encoding)

    def finish(self) -> None:
        """Handles that the program has carried out a command."""
        self._switch.finish()

    def end(self) -> None:
        """Ends the switch. Waits for `on_lost`, for at most a second."""
        if self._is_ended:
            return
        self._end_switch()
        self.subscriber.close()

    def on_fork(self) -> None:
        """Ends the switch in a child process, which has no thread of it: the motors belong to the parent."""
        self._is_ended = True

    def _end_switch(self) -> None:
        self._is_ended = True
        self._session.handles.discard(self)
        self._switch.end()
        self._observer.end()

    def _lose(self, reason: str) -> None:
        try:
            self._on_lost(reason)
        except BaseException:
            _LOG.exception("on_lost of the dead man's switch for %s raised an exception", self.pattern)
