"""Checks whether the robots are reachable to which a program sends messages."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.errors import NotReachable
from rect.executor import Executor
from rect.waiting import next_wait

if TYPE_CHECKING:
    from rect.session import Session

#: Longest wait for news at a time, in seconds. The core limits the sum.
_MAX_WAIT_S = 1.0


class Recipients:
    """The robots that are reachable. They are observed from the first message to one of them on."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._core = _rect.Recipients(session.key_space)
        self._executor: Executor | None = None
        self._news = threading.Condition()

    def is_reachable(self, robot: str) -> bool:
        """Whether `check` returns at once."""
        is_own = robot == self._session.key_space.robot
        return is_own or (self._executor is not None and self._core.find(robot)[0] == "reachable")

    def check(self, robot: str) -> None:
        """Raises `NotReachable` unless the robot is reachable, `InvalidNameError`, `ZenohError` and `Closed`."""
        if self.is_reachable(robot):
            return
        with self._news:
            if self._executor is None:
                executor = Executor(self._session, self._core.driver(), self._on_news)
                executor.start("rect recipients")
                self._executor = executor
            found, available = self._core.find(robot)
            while found == "unsure":
                self._executor.wake()
                self._news.wait(next_wait(_MAX_WAIT_S))
                self._session.check()
                found, available = self._core.find(robot)
        if found == "unreachable":
            raise NotReachable(robot, available)

    def _on_news(self, _: Any) -> None:
        with self._news:
            self._news.notify_all()
