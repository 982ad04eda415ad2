"""Replies to requests, and the outcomes of a request to all robots."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, Optional, Union

from rect.errors import Interrupted, RectError, ServiceError, TimedOut
from rect.typed import Converter, T
from rect.values import Payload


@dataclass(frozen=True)
class Reply(Generic[T]):
    """A reply to a request. `Reply[Pose]` has a `value` of the type `Pose`."""

    #: Name of the robot that replied.
    sender: str
    #: The payload: bytes with an encoding.
    payload: Payload
    #: Whether the service shares its topic with other programs of the robot (`allow_several`). They have received the
    #: request, too, and carry it out. `Robot.request` discards their replies; `Robot.request_all` returns them.
    is_shared: bool
    _converter: Converter[T] | None = field(default=None, repr=False, compare=False)

    @property
    def value(self) -> T:
        """The decoded payload, as the type that the request states (`returns`); see `Message.value`.

        Raises `PayloadError` if the bytes do not match the encoding, and `MismatchError` if the value does not fit the
        type.
        """
        value: T = self.payload.value
        return value if self._converter is None else self._converter.convert(value)


#: The robot that a reply comes from, if it is stated, and the reply or an error.
Received = tuple[Optional[str], Union[Reply[T], RectError]]


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """The outcome of a request at one robot: either a reply or an error."""

    #: Name of the robot. `None` if a stock Zenoh program replied with an error, which does not name it.
    robot: str | None
    #: The reply.
    reply: Reply[T] | None
    #: The error.
    error: RectError | None


@dataclass(frozen=True)
class Gathered(Generic[T]):
    """The outcomes of a request to all robots. Returned by `Replies.gather`."""

    #: First the replies and errors in the order of their arrival, and then an error for each missing robot. A robot
    #: whose programs have several services of the topic has one for each of them.
    outcomes: list[Outcome[T]]
    #: Names of the robots that serve the topic: those whose catalogue lists it, and those that replied.
    expected: set[str]
    #: Names of the robots that serve the topic and did not reply.
    missing: set[str]

    @property
    def replies(self) -> list[Reply[T]]:
        """The replies alone."""
        return [outcome.reply for outcome in self.outcomes if outcome.reply is not None]

    @property
    def errors(self) -> dict[str | None, RectError]:
        """The errors, by the names of their robots."""
        return {outcome.robot: outcome.error for outcome in self.outcomes if outcome.error is not None}


def outcomes_of(topic: str, serving: set[str], received: list[Received[T]], timed_out: TimedOut | None) -> Gathered[T]:
    """Returns the outcomes of a request, given the robots whose catalogue lists the topic and what has arrived."""
    outcomes: list[Outcome[T]] = []
    for robot, one in received:
        if isinstance(one, RectError):
            outcomes.append(Outcome(robot, None, one))
        else:
            outcomes.append(Outcome(robot, one, None))
    replied = {robot for robot, _ in received if robot is not None}
    missing = serving - replied
    for robot in sorted(missing):
        outcomes.append(Outcome(robot, None, timed_out or Interrupted(robot, topic)))
    return Gathered(outcomes, serving | replied, missing)


def service_error(robot: str | None, payload: Payload) -> ServiceError:
    """Makes a `ServiceError` from the payload of an error reply."""
    try:
        value = payload.value
    except RectError:
        value = payload.bytes
    return ServiceError(robot, value, payload.bytes.decode(errors="replace"))
