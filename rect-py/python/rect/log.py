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
    from rect import aio
    from rect.robot import Robot
    from rect.session import Session

#: How long the end of a session waits for the last lines, in seconds.
_LAST_LINES_S = 0.2
#: The loggers of RECT and Zenoh. Their lines are not part of the program's log, and could cause further ones.
_SKIPPED = ("rect", "zenoh")
#: The attributes that every record has. Others are fields.
_NOT_FIELDS = frozenset([*vars(logging.makeLogRecord({})), "message", "asctime", "taskName"])
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
        self._core.flush()
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


class LogHandler(logging.Handler):
    """A handler of Python's `logging` that logs each record to the router of this robot, as `Robot.log` does.

    It logs the level, the name of the logger, the text with the traceback, the `extra` fields, and the place in the
    source. The lines of RECT and Zenoh themselves are skipped. It never waits for the network, never raises, and does
    nothing once the robot is closed.

    - `private`: whether the lines stay on this robot. Default: `False`.
    - `level`: the least level. Default: that of the logger.

    Example:

        logging.getLogger().addHandler(rect.LogHandler(robot))
        logging.warning("the gripper is slow", extra={"angle": 12.5})
    """

    def __init__(self, robot: Robot | aio.Robot, private: bool = False, level: int | str = logging.NOTSET) -> None:
        super().__init__(level)
        self._log = robot._session.log
        self._private = bool(private)

    def emit(self, record: logging.LogRecord) -> None:
        """Logs a record."""
        if record.name.partition(".")[0] in _SKIPPED:
            return
        try:
            fields = {name: value for name, value in vars(record).items() if name not in _NOT_FIELDS}
            self._log.log(
                max(0, int(record.created * 1000)),
                _rect.level_of_logging(record.levelno),
                record.name,
                self._text(record),
                fields,
                f"{record.filename}:{record.lineno}",
                self._private,
            )
        except Exception:
            self.handleError(record)

    def _text(self, record: logging.LogRecord) -> str:
        try:
            return self.format(record)
        except Exception as error:
            # The text is more useful than a traceback on standard error, where a robot has nobody who reads it.
            return f"{record.msg} (cannot be formatted with {record.args!r}: {error})"


def log(
    session: Session, line: str, level: str, logger: str, fields: Mapping[str, Any] | None, source: str, private: bool
) -> None:
    """Logs a line with the time of now. Raises `OptionError`, and `TypeError` for arguments of another type."""
    texts = [text(name, value) for name, value in (("text", line), ("level", level), ("logger", logger))]
    session.log.log(
        time.time_ns() // 1_000_000, texts[1], texts[2], texts[0], fields, text("source", source), bool(private)
    )
