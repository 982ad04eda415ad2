"""Publishes retained messages, and receives them from the router."""

from __future__ import annotations

import random
import threading
from typing import TYPE_CHECKING, Literal, Union

from rect import _rect
from rect.errors import NotRetained, OptionError
from rect.executor import Executor
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

#: Whether the last value of a topic is kept: in the memory of the robot's router, or also on its disk.
Retain = Union[bool, Literal["disk"]]


def retention(retained: Retain, lifetime: float | None) -> bool | None:
    """Returns whether a value is kept on disk, or `None` if it is not retained. Raises `OptionError`."""
    if not isinstance(retained, bool) and retained != "disk":
        raise OptionError("retained", retained, 'it must be True, False or "disk"')
    if not retained:
        return None
    if lifetime is not None:
        raise OptionError("retained", retained, "a message that expires cannot be retained")
    return retained == "disk"


class State:
    """The retained messages of this program. Its driver runs from the first subscription or retained message on."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._core = _rect.ProgramState(session.key_space, session.program.instance)
        self._executor: Executor | None = None
        self._lock = threading.Lock()
        self._last_warning: str | None = None
        if session.is_direct:
            keeper = _rect.state_keeper(session.key_space, random.getrandbits(32))
            Executor(session, keeper, session.warn).start("rect state keeper")

    def _running(self) -> Executor:
        """Starts the driver. Raises `ZenohError` and `Closed`."""
        with self._lock:
            if self._executor is None:
                executor = Executor(self._session, self._core.driver(), self._core.deliver)
                executor.start("rect state")
                self._executor = executor
            return self._executor

    def follow(self, inbound: _rect.Inbound) -> None:
        """Lets a subscription get retained messages through the router alone, if it can."""
        self._core.follow(inbound)

    def receive(self, on_message: _rect.OnMessage) -> Reception:
        """Delivers the retained messages of a subscription to its queue."""
        running = self._running()
        number = self._core.subscribe(on_message)
        running.wake()
        return Reception(self._core, running, number)

    def retain(self, topic: str, payload: Payload, urgency: str, disk: bool) -> None:
        """Publishes a value that the router keeps.

        Raises `NotRetained`, `InvalidTopicError`, `OptionError` and `Closed`.
        """
        self._session.warn(self._session.used_names.on_topic(topic))
        order = self._core.set(topic, payload.bytes, payload.encoding, urgency, disk)
        no_keeper = self._give(topic, order)
        if no_keeper is not None:
            self._session.publish(topic, None, payload, urgency, None)
            raise NotRetained(topic, no_keeper)
        self._session.counters.on_sent(len(payload.bytes))

    def forget(self, topic: str) -> None:
        """Forgets a topic. Raises `NotRetained`, `InvalidTopicError` and `Closed`."""
        no_keeper = self._give(topic, self._core.forget(topic))
        if no_keeper is not None:
            raise NotRetained(topic, no_keeper)

    def _give(self, topic: str, order: _rect.StateOrder) -> str | None:
        """Gives an order to the router. Returns the problem if there is none that keeps values."""
        running = self._running()
        outcome, detail = Executor(self._session, order.driver(self._session.key_space)).run()
        if outcome == "refused":
            raise NotRetained(topic, detail)
        if outcome == "no_keeper":
            return str(detail)
        self._session.check()
        if detail.warning is not None and detail.warning != self._last_warning:
            self._session.warn(detail.warning)
            self._last_warning = detail.warning
        self._core.on_kept(order, detail)
        running.wake()
        return None

    def latest(self, robot: str, topic: str) -> tuple[_rect.MessageMetadata, Payload] | None:
        """Returns the last value of a topic, if there is one.

        Raises `InvalidNameError`, `InvalidTopicError` and `Closed`.
        """
        driver = _rect.latest(self._session.key_space, robot, topic, _rect.QUERY_TIMEOUT_S)
        found = Executor(self._session, driver).run()
        if found is None:
            self._session.check()
            return None
        metadata, (bytes, encoding) = found.message()
        return metadata, Payload(bytes, encoding)


class Reception:
    """The part of a subscription that retained messages go through."""

    def __init__(self, core: _rect.ProgramState, running: Executor, number: int) -> None:
        self._core = core
        self._running = running
        self._number = number

    def undeclare(self) -> None:
        """Ends it."""
        self._core.unsubscribe(self._number)
        self._running.wake()
