"""Keeps the large results of this program's actions, and receives those of others."""

from __future__ import annotations

import contextlib
import threading
import weakref
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.errors import ActionError, RectError
from rect.executor import Executor
from rect.receive_queue import ReceiveQueue
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

_BEGINNING = threading.Lock()


class KeptResults:
    """The large results of a program, of which others request the pieces."""

    def __init__(self, session: Session) -> None:
        self._core = _rect.Results(session.key_space)
        self._executor = Executor(session, self._core.driver())
        self._executor.start("rect results")

    def keep(self, result: _rect.ResultToKeep) -> None:
        """Keeps a result for as long as the robot's router keeps the state of its goal."""
        self._core.keep(result)
        self._executor.wake()


def keep(session: Session, result: _rect.ResultToKeep) -> None:
    """Keeps a large result. Raises `ZenohError`, `ThreadError` and `Closed`."""
    session.check()
    with _BEGINNING:
        if session.results is None:
            session.results = KeptResults(session)
        session.results.keep(result)


class ResultPull:
    """A large result that is being received, on a thread. That goes on when a wait for it has timed out."""

    def __init__(self, session: Session, core: _rect.ResultPull, handle: object) -> None:
        self._session = session
        self._core = core
        #: Closed when the reception has ended.
        self.ended: ReceiveQueue[None] = ReceiveQueue(1, "drop_newest")
        self._outcome: tuple[str, Any] | None = None
        self._executor = Executor(session, core.driver())
        # It ends with the handle of the program, too.
        weakref.finalize(handle, self.stop).atexit = False
        session.start("rect result", self._run)

    @property
    def expected(self) -> str:
        """The description of the result, for the text of a timeout."""
        return self._core.expected

    @property
    def has_failed(self) -> bool:
        """Whether the reception has ended without a result."""
        return self._outcome is not None and self._outcome[0] != "received"

    def value(self) -> Any:
        """Returns the result. Raises `ActionError`, `PayloadError` and `Closed`."""
        outcome: str
        result: Any
        outcome, result = self._outcome or ("closed", None)
        if outcome == "unavailable":
            raise ActionError("done", result)
        if outcome != "received":
            raise self._session.closed_error("run")
        return Payload(*result).value

    def stop(self) -> None:
        """Stops the reception."""
        self._core.stop()
        self._executor.wake()

    def _run(self) -> None:
        outcome = ("closed", None)
        # The session may be closed meanwhile.
        with contextlib.suppress(RectError):
            outcome = self._executor.run()
        self._outcome = outcome
        self.ended.close()
