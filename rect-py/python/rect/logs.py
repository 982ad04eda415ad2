"""Reads the logs of robots."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.choices import Level
from rect.deadline import Deadline
from rect.errors import TimedOut
from rect.executor import Executor
from rect.message import utc
from rect.options import seconds, text, whole
from rect.receive_queue import Ended, ReceiveQueue

if TYPE_CHECKING:
    from rect.session import Session

#: The name that stands for all robots.
ALL = "*"
#: The number of parts of logs that wait for the program; beyond it the oldest ones are dropped.
_CAPACITY = 1024


@dataclass(frozen=True)
class LogLine:
    """A line of a log."""

    #: Name of the robot.
    robot: str
    #: Name of the program; `unnamed` if it has none.
    program: str
    #: Number of the line at this run of the robot's router, beginning with 1.
    number: int
    #: When it was logged, by the clock of the robot, in UTC. The clock of a robot without a real-time clock may be
    #: years off.
    at: datetime
    #: How important it is.
    level: Level
    #: The part of the program; `stdout` or `stderr` for its output. Empty if it is not known.
    logger: str
    #: The text, which may have several lines, such as those of a traceback.
    text: str
    #: Values with names: numbers, texts, booleans and `None`.
    fields: dict[str, Any] = field(hash=False)
    #: The place in the source code, such as `arm.py:12`. Empty if it is not known.
    source: str


class Logs:
    """Iterates over lines of logs. Returned by `Robot.logs`.

    The first lines are those that were logged before. They arrive once all routers have answered: the lines of each
    robot in their order, and those of several robots by their time. The iteration ends then, or with `follow` when this
    object or the robot is closed.
    """

    _HANDLE = "reader of logs"

    def __init__(
        self, session: Session, robot: str, program: str | None, level: str, last: int, follow: bool, timeout: float
    ) -> None:
        self._session = session
        self._expected = "line" if robot == ALL else f"line of {robot}"
        self._lines = _Lines()
        self._queue: ReceiveQueue[tuple[Any, ...]] = ReceiveQueue(_CAPACITY, "drop_oldest")
        driver = _rect.log_reader(
            session.key_space,
            None if text("robot", robot) == ALL else robot,
            None if program is None else text("program", program),
            text("level", level),
            whole("last", last, 0),
            bool(follow),
            seconds("timeout", timeout),
        )
        self._executor = Executor(session, driver, self._queue.queue, queue=self._queue)
        self._executor.start("rect logs", self._queue.close)
        self._executor.leave_with(self)

    def next(self, timeout: float | None = None) -> LogLine:
        """Waits for the next line and returns it.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if there is no line in time, and `Closed` after the last line.
        """
        try:
            return self._take(timeout)
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(self._expected, timeout or 0) from None

    async def next_async(self, timeout: float | None = None) -> LogLine:
        """Does the same as `next`, for asyncio. Raises `Ended` and `TimeoutError`."""
        deadline = Deadline(timeout)
        while not self._lines.ready:
            try:
                self._lines.on_item(await self._queue.pop_async(deadline.remaining()))
            except Ended:
                if not self._lines.on_end():
                    raise
        return self._lines.ready.popleft()

    def __iter__(self) -> Iterator[LogLine]:
        return self

    def __next__(self) -> LogLine:
        try:
            return self._take(None)
        except Ended:
            raise StopIteration from None

    @property
    def robots(self) -> list[str]:
        """Names of the robots that have answered so far, also of those without lines, in alphabetical order."""
        return sorted(self._lines.robots)

    @property
    def missed(self) -> int:
        """How often new lines were missed: they were logged faster than the link carries them, or this program reads
        them."""
        return self._lines.missed + self._queue.dropped

    def close(self) -> None:
        """Ends the reading. Lines that have arrived can still be read."""
        self._executor.end()

    def __enter__(self) -> Logs:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Logs({', '.join(self.robots)})"

    def _take(self, timeout: float | None) -> LogLine:
        deadline = Deadline(timeout)
        while not self._lines.ready:
            try:
                self._lines.on_item(self._queue.pop(deadline.remaining()))
            except Ended:
                if not self._lines.on_end():
                    raise
        return self._lines.ready.popleft()


class _Lines:
    """Puts the items of the reader into the order in which a person reads the lines."""

    def __init__(self) -> None:
        #: The lines that the program has not read.
        self.ready: deque[LogLine] = deque()
        #: The robots that have answered.
        self.robots: set[str] = set()
        self.missed = 0
        #: The lines of each robot that were logged before, until all routers have answered.
        self._before: dict[str, deque[LogLine]] | None = {}
        #: Those that are new meanwhile.
        self._new: list[LogLine] = []

    def on_item(self, item: tuple[Any, ...]) -> None:
        kind, robot, is_new, parts = item
        if kind == "complete":
            self.on_end()
            return
        self.robots.add(robot)
        if kind == "missed":
            self.missed += 1
            return
        lines = [_line(robot, *line) for line in parts]
        if self._before is None:
            self.ready.extend(lines)
        elif is_new:
            self._new.extend(lines)
        else:
            # Newer pages arrive first.
            self._before.setdefault(robot, deque()).extendleft(reversed(lines))

    def on_end(self) -> bool:
        """Handles that no further lines arrive that were logged before. Returns whether some are ready now."""
        if self._before is None:
            return False
        self.ready.extend(heapq.merge(*self._before.values(), key=lambda line: line.at))
        self.ready.extend(self._new)
        self._before, self._new = None, []
        return bool(self.ready)


def _line(
    robot: str,
    number: int,
    program: str,
    at_ms: int,
    level: Level,
    logger: str,
    text: str,
    fields: dict[str, Any],
    source: str,
) -> LogLine:
    return LogLine(robot, program, number, utc(at_ms / 1000), level, logger, text, fields, source)
