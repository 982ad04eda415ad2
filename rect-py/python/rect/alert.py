"""Raises, clears and lists alerts."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING

from rect import _rect
from rect.choices import Level
from rect.executor import Executor
from rect.logs import ALL
from rect.message import utc
from rect.options import text
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session


@dataclass(frozen=True)
class Alert:
    """Something that is wrong with a robot."""

    #: Name of the robot.
    robot: str
    #: Name of the alert, with which it is cleared.
    name: str
    #: The text, which says what is wrong.
    text: str
    #: How important it is.
    level: Level
    #: Since when, by the clock of the robot, in UTC. The clock of a robot without a real-time clock may be years off.
    since: datetime
    #: Name of the program that has raised it; empty if it has none.
    program: str
    #: Whether that program has ended, so that it does not clear the alert any more.
    program_has_ended: bool


def raise_alert(session: Session, what: str, level: str, name: str | None) -> None:
    """Raises an alert. Raises `OptionError`, `InvalidTopicError`, `NotRetained` and `Closed`."""
    session.check()
    topic = _rect.alert_topic(text("text", what) if name is None else text("name", name))
    now_ms = time.time_ns() // 1_000_000
    payload = Payload(*_rect.write_alert(text("text", what), text("level", level), now_ms, session.program.name))
    session.state.retain(topic, payload, "normal", False)


def clear_alert(session: Session, name_or_text: str) -> None:
    """Clears an alert. Raises `InvalidTopicError`, `NotRetained` and `Closed`."""
    session.check()
    session.state.forget(_rect.alert_topic(text("name_or_text", name_or_text)))


def alerts(session: Session, robot: str) -> list[Alert]:
    """Returns the alerts that are raised now. Raises `InvalidNameError` and `Closed`."""
    session.check()
    asked = None if text("robot", robot) == ALL else robot
    query = _rect.alerts_query(session.key_space, asked, _rect.QUERY_TIMEOUT_S)
    found = Executor(session, query).run()
    if found is None:
        raise session.closed_error()
    return [
        Alert(of, name, what, level, utc(at_ms / 1000), program, has_ended)
        for of, name, what, level, at_ms, program, has_ended in found
    ]
