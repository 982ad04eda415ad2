"""The programs of robots and what they serve, and the presence of this one."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rect import _rect, registry
from rect.errors import RectError, ServiceRefused
from rect.executor import Executor
from rect.parameter_types import Parameter, parameters_of

if TYPE_CHECKING:
    from rect.session import Session


@dataclass(frozen=True)
class ServiceEntry:
    """A service in the catalogue of a robot."""

    #: Topic of the service.
    topic: str
    #: The words of its program; empty if there are none.
    about: str
    #: Whether other programs of the robot may serve the same topic. Then each of them answers.
    several: bool


@dataclass(frozen=True)
class Program:
    """A program of a robot."""

    #: Name of the program. `None` if it has none.
    name: str | None
    #: Distinguishes this run of the program from all others: 8 hexadecimal digits.
    instance: str
    #: Its services, in alphabetical order.
    services: tuple[ServiceEntry, ...]
    #: The parameters of each of its groups, by their names.
    parameters: dict[str, dict[str, Parameter]] = field(default_factory=dict, hash=False)
    #: The descriptions of its actions, by their names.
    actions: dict[str, str] = field(default_factory=dict, hash=False)


def name_of_script() -> str | None:
    """Returns the value of the environment variable `RECT_PROGRAM`, or else the name of the script that runs.

    `None` for tests, notebooks and `python -c`.
    """
    if name := os.environ.get("RECT_PROGRAM"):
        return name
    return _rect.program_name(sys.argv[0]) if sys.argv else None


def programs_of(session: Session, robot: str) -> list[Program]:
    """Returns the programs of a robot. Raises the errors of `registry.answer`, and `PayloadError`."""
    query = session.catalogues.query(session.key_space, robot)
    catalogue = registry.answer(session, robot, query).bytes
    return [
        Program(
            name,
            instance,
            tuple(ServiceEntry(*parts) for parts in services),
            {group: parameters_of(parameters) for group, parameters in groups},
            dict(actions),
        )
        for name, instance, services, groups, actions in _rect.read_catalogue(catalogue)
    ]


def names_of(session: Session, robot: str, names: Callable[[Program], Iterable[str]]) -> list[str]:
    """Returns what the programs of a robot list under these names; nothing if the robot does not answer."""
    try:
        return [name for program in programs_of(session, robot) for name in names(program)]
    except RectError:
        return []


class Presence:
    """The presence of this program: its name, and what it serves."""

    def __init__(self, session: Session, name: str | None) -> None:
        self._session = session
        self.name = name
        #: Distinguishes this run of the program from all others.
        self.instance = random.getrandbits(32)
        #: The requests that this program carries out at most once.
        self.once = _rect.Once(session.key_space.robot, self.instance)
        self.request_ids = _rect.RequestIds(self.instance, name is not None)
        self._core = _rect.ProgramPresence(session.key_space, name, self.instance, session.is_direct)
        self._executor = Executor(session, self._core.driver(), session.warn)
        self._executor.start("rect program")

    def serve(
        self,
        topic: str | _rect.InternalTopic,
        about: str,
        allow_several: bool,
        parameters: _rect.ParameterDeclaration | None = None,
    ) -> None:
        """Announces a service, or a group of parameters, which is then declared.

        Raises `ServiceRefused` and `Closed`.
        """
        offered = self._core.offer(topic, about, allow_several, parameters)
        outcome, detail = "unanswered", None
        if not self._session.is_direct:
            outcome, detail = Executor(self._session, self._core.registration(self._session.key_space, offered)).run()
            if outcome == "refused":
                self._core.on_ended(topic)
                raise ServiceRefused(detail)
            self._session.check()
        self._core.on_served(offered, outcome == "accepted", detail)
        self._executor.wake()

    def is_taken_over(self, topic: str | _rect.InternalTopic) -> bool:
        """Returns whether the router refuses to register a service again, because another program serves its topic."""
        outcome, _ = Executor(self._session, self._core.renewal(self._session.key_space)).run()
        if outcome != "refused":
            return False
        self._core.on_taken_over(topic)
        self._executor.wake()
        return True

    def end(self, topic: str | _rect.InternalTopic) -> None:
        """Announces the end of a service."""
        self._core.on_ended(topic)
        self._executor.wake()
