"""Logs what a program reports through Python's `logging`."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from rect import _rect

if TYPE_CHECKING:
    from rect import aio
    from rect.robot import Robot

#: The loggers of RECT and Zenoh. Their lines are not part of the program's log, and could cause further ones.
_SKIPPED = ("rect", "zenoh")
#: The attributes that every record has. Others are fields.
_NOT_FIELDS = frozenset([*vars(logging.makeLogRecord({})), "message", "asctime", "taskName"])


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
