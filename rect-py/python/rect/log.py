"""Logs lines of this program, which the router of its robot keeps."""

from __future__ import annotations

import contextlib
import logging
import random
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.errors import RectError
from rect.executor import Executor
from rect.options import text

if TYPE_CHECKING:
    from rect.session import Session

#: How long the end of a session waits for the last lines at most, in seconds.
_LAST_LINES_S = 1.0
#: How long the last lines wait for a router that has just started, in seconds.
_FIRST_ANSWER_S = 0.15
_LOG = logging.getLogger("rect")


class ProgramLog:
    """The lines of this program that the router does not have yet. Their driver runs from the first line on."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._core = _rect.LogOutbox(session.key_space, session.program.name, session.program.instance)
        self._executor: Executor | None = None
        self._starting = threading.Lock()
        #: Whether the last lines were sent; `flush` clears it.
        self._sent = threading.Event()
        session.before_close.append(self.flush)
        if session.is_direct:
            keeper = _rect.log_keeper(session.key_space, random.getrandbits(32))
            Executor(session, keeper).start("rect log keeper")

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
        """Logs a line. A closed session ignores it. Raises `OptionError` if there is no such level."""
        # After a fork, a thread of the parent may have held the lock of the lines.
        if self._session.is_closed:
            return
        polls = self._core.log(at_ms, level, logger, text, dict(fields or {}), source, private)
        executor = self._executor or self._start()
        if polls and executor is not None:
            executor.wake()

    def flush(self) -> None:
        """Waits until the last lines were sent, for a moment at most."""
        executor = self._executor
        if executor is None or self._session.is_closed:
            return
        self._sent.clear()
        self._core.flush(_FIRST_ANSWER_S)
        executor.wake()
        self._sent.wait(_LAST_LINES_S)

    def _start(self) -> Executor | None:
        # The thread gets the lines that other threads have added meanwhile, too.
        if not self._starting.acquire(blocking=False):
            return self._executor
        try:
            if self._executor is None:
                executor = Executor(self._session, self._core.driver(), before_poll=self._before_poll)
                self._session.start("rect log", lambda: self._run(executor))
                self._executor = executor
            return self._executor
        except RectError as error:
            # The next line tries again.
            _LOG.debug("cannot send lines: %s", error)
            return None
        finally:
            self._starting.release()

    def _before_poll(self) -> None:
        if self._core.is_empty:
            self._sent.set()

    @staticmethod
    def _run(executor: Executor) -> None:
        # The session was closed.
        with contextlib.suppress(RectError):
            executor.run()


def log(
    session: Session, line: str, level: str, logger: str, fields: Mapping[str, Any] | None, source: str, private: bool
) -> None:
    """Logs a line with the time of now. Raises `OptionError`, and `TypeError` for arguments of another type."""
    texts = [text(name, value) for name, value in (("text", line), ("level", level), ("logger", logger))]
    session.log.log(
        time.time_ns() // 1_000_000, texts[1], texts[2], texts[0], fields, text("source", source), bool(private)
    )
