"""Warns of values that do not fit their type, and of names that nobody has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rect.executor import Executor

if TYPE_CHECKING:
    from rect import _rect
    from rect.session import Session


def on_problem(session: Session, sender: str, topic: str, problem: Exception) -> None:
    """Counts a message or request without a value, and warns of the first one of each sender and topic."""
    session.warn(session.counters.on_problem(sender, topic, str(problem)))


def on_topic(session: Session, topic: str) -> None:
    """Warns of a topic or pattern that is probably misspelled."""
    session.warn(session.used_names.on_topic(topic))


def on_pattern(session: Session, pattern: str) -> None:
    """Warns of a pattern that a program subscribes to if nobody has the name of its robot, within 3 s."""
    on_topic(session, pattern.partition("/")[2])
    _check(session, session.used_names.on_pattern(session.key_space, pattern))


def on_robot(session: Session, robot: str) -> None:
    """Warns of the name of a robot that a program waits for if nobody has it, within 3 s."""
    _check(session, session.used_names.on_robot(session.key_space, robot))


def on_stream(session: Session, stream: str) -> None:
    """Warns of a stream that a program watches if there is none, within 3 s."""
    _check(session, session.used_names.on_stream(session.key_space, stream))


def _check(session: Session, check: _rect.Driver | None) -> None:
    if check is not None:
        Executor(session, check, session.warn).start("rect-name-check")
