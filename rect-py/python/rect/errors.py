"""Defines the exceptions of the package. Their texts match those of the Rust library."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from rect import _rect

if TYPE_CHECKING:
    from rect.choices import Phase


class RectError(Exception):
    """Base class of all errors of RECT. The text says what happened and what to do."""

    def __reduce__(self) -> tuple[Any, ...]:
        # By default, `pickle` and `copy` would call the class with the text alone.
        state = dict(self.__dict__)
        if isinstance(self, OSError):
            state["errno"] = self.errno
        return _restored, (type(self), self.args), state


class InvalidNameError(RectError, ValueError):
    """The name of a robot or fleet is invalid. Choose another name."""


class InvalidTopicError(RectError, ValueError):
    """A topic or pattern is invalid. The text says which part is wrong."""


class OptionError(RectError, ValueError):
    """An argument has a value that is not allowed."""

    def __init__(self, option: str, value: object, reason: str) -> None:
        super().__init__(f"the option {option} cannot be {_quoted(value)}: {reason}")


class PayloadError(RectError, ValueError):
    """A value cannot be encoded, or a payload cannot be decoded."""

    def __init__(self, text: str, kind: str = "other") -> None:
        super().__init__(text)
        #: `write` (the value cannot be encoded), `read` (the bytes do not match the encoding), `encoding` (the encoding
        #: is invalid), `other` (the payload has another type), `mismatch` for a `MismatchError`, or the kind of a
        #: `CodecError`.
        self.kind = kind


class CodecError(PayloadError):
    """A codec does not suit the value, or a compressed payload is damaged.

    `kind` is `unknown`, `option`, `kind`, `damaged`, `too large`, `dictionary` or `failed`.
    """

    def __init__(self, text: str, kind: str, dictionary: int | None = None) -> None:
        super().__init__(text, kind)
        #: Id of the missing dictionary, if `kind` is `dictionary`; otherwise `None`.
        self.dictionary = dictionary


class MismatchError(PayloadError):
    """A value does not fit the type that the program has stated for it."""

    def __init__(self, field: str, expected: str, found: str) -> None:
        place = f"field {field}: " if field else ""
        super().__init__(f"{place}expected {expected}, found {found}", "mismatch")
        #: The path to the part of the value that does not fit, such as `cells[2].volt`. Empty: the value itself.
        self.field = field
        #: The description of the values that the type allows.
        self.expected = expected
        #: The description of the value in its place.
        self.found = found


class DictionaryError(RectError, ValueError):
    """A dictionary cannot be trained from these samples, or the bytes are not a zstd dictionary."""


class RecordingError(RectError):
    """A recording cannot be written, or is damaged or not there. The text names the file."""


class NoRouter(RectError, ConnectionError):
    """No router answers at the endpoint. Start one, or select another one."""

    def __init__(self, endpoint: str, reason: str) -> None:
        super().__init__(
            f"no router answers at {endpoint}: {reason}. "
            + _rect.router_advice(endpoint, reason, "python -m rect router")
        )
        #: Locator of the router.
        self.endpoint = endpoint


class LoginRefused(RectError, ConnectionError):
    """The router requires a login, and the login of this program is missing or wrong.

    Select the team's login file with the option `login_file` or the environment variable `RECT_LOGIN`.
    """

    def __init__(self, text: str, endpoint: str) -> None:
        super().__init__(text)
        #: Locator of the router.
        self.endpoint = endpoint


class WrongRobot(RectError):
    """The router belongs to another robot. Connect under the router's name, or to the right router."""

    def __init__(self, text: str, serves: str) -> None:
        super().__init__(text)
        #: Name of the robot that the router serves.
        self.serves = serves


class NotReachable(RectError, ConnectionError):
    """The robot to which a message is sent is not reachable. Check its name, or wait for it (`Robot.wait_for_peer`)."""

    def __init__(self, robot: str, available: list[str]) -> None:
        super().__init__(_rect.not_reachable(robot, available))
        #: Name of the robot.
        self.robot = robot
        #: Names of the robots that are reachable.
        self.available = available


class NotRetained(RectError, ValueError):
    """A message is not retained, so that programs that start later do not get it. The text states what to do."""

    def __init__(self, topic: str, reason: str) -> None:
        super().__init__(f"{topic} is not retained: {reason}")
        #: Topic of the message.
        self.topic = topic
        #: Why it is not retained.
        self.reason = reason


class NoService(RectError, LookupError):
    """No program of the robot, or of the fleet, serves the topic. Is the robot reachable, and its program running?"""

    def __init__(self, robot: str | None, topic: str, available: list[str]) -> None:
        super().__init__(_rect.no_service(robot, topic, available))
        #: Names of the robots that are reachable.
        self.available = available


class ServiceRefused(RectError):
    """The program cannot serve a topic: another program of this robot serves it already."""


class ParameterError(RectError, ValueError):
    """A declaration of parameters is invalid, or one of this program's own values is refused. The text says why."""


class NoParameters(RectError, LookupError):
    """No program of the robot has the group of parameters. Is its program running?

    A robot that was configured by an earlier version lacks the rule for `@rect/@set/parameters/**` in its access
    control.
    """

    def __init__(self, robot: str, group: str, available: list[str]) -> None:
        super().__init__(_rect.no_parameters(robot, group, available))
        #: Name of the robot.
        self.robot = robot
        #: Name of the group.
        self.group = group
        #: Names of the groups that the robot has.
        self.available = available


class NoAction(RectError, LookupError):
    """No program of the robot has the action. Is its program running?

    A robot that was configured by an earlier version lacks the rule for `@rect/@set/actions/**` in its access control.
    """

    def __init__(self, robot: str, action: str, available: list[str]) -> None:
        super().__init__(_rect.no_action(robot, action, available))
        #: Name of the robot.
        self.robot = robot
        #: Name of the action.
        self.action = action
        #: Names of the actions that the robot has.
        self.available = available


class NoGoal(RectError, LookupError):
    """The robot does not know the goal: it never began, or ended more than ten minutes ago."""

    def __init__(self, robot: str, action: str, goal: str) -> None:
        super().__init__(
            f"{robot} does not know the goal {goal} of the action {action}: it never began, or ended more than 10 "
            "minutes ago"
        )
        #: Name of the robot.
        self.robot = robot
        #: Name of the action.
        self.action = action
        #: Id of the goal.
        self.goal = goal


class ActionError(RectError):
    """A goal was not carried out, or not to its end: `phase` and `reason` say how it ended.

    If the phase is `done`, it was carried out, and its result of more than 48 kB cannot be received.
    """

    def __init__(self, phase: Phase, reason: str, result: Any = None) -> None:
        super().__init__(_rect.goal_ended(phase, reason))
        #: How the goal has ended: `refused`, `failed`, `cancelled`, `preempted` or `lost`; `done` if its result was
        #: lost.
        self.phase: Phase = phase
        #: Why; empty if that is clear.
        self.reason = reason
        #: The result that the handler has returned although it was asked to end; `None` if there is none.
        self.result = result


class Cancelled(RectError):
    """The handler of an action should end. Raised by `Goal.sleep` and `Goal.check`."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"cancelled: {reason}")
        #: Why.
        self.reason = reason


class NotStored(RectError):
    """The values are in force, but are lost when the program of the robot ends. The text names the file, if any."""

    def __init__(self, robot: str, reason: str) -> None:
        super().__init__(f"{robot} uses the values, and has not stored them: {reason}")
        #: Name of the robot.
        self.robot = robot


class Interrupted(RectError, ConnectionError):
    """A request may have been carried out, and no reply follows: the service's program, a router or the link ended.

    Ask the robot before you repeat a request that must not be carried out twice.
    """

    def __init__(self, robot: str | None, topic: str) -> None:
        super().__init__(_rect.interrupted(robot, topic))


class TimedOut(RectError, TimeoutError):
    """The timeout has expired. Try again, allow more time, or check the link (`python -m rect connections`)."""

    def __init__(self, expected: str, timeout: float) -> None:
        super().__init__(f"no {expected} within {_seconds(timeout)}")
        #: Duration of the wait, in seconds.
        self.timeout = timeout


class ServiceError(RectError):
    """The service replied with an error."""

    def __init__(self, robot: str | None, value: Any, text: str) -> None:
        super().__init__(f"{robot or 'the service'} replied with an error: {text[:500]}")
        #: Name of the robot that replied. `None` if its program does not use RECT.
        self.robot = robot
        #: The decoded error that the service sent, or its bytes if they cannot be decoded.
        self.value = value


class ZenohError(RectError):
    """Zenoh reported an error."""

    def __init__(self, operation: str, reason: str) -> None:
        super().__init__(f"{operation}: {reason}")


class ThreadError(RectError, RuntimeError):
    """A thread cannot be started. Has the computer too many processes, or too little memory?"""

    def __init__(self, reason: str) -> None:
        super().__init__(f"cannot start a thread: {reason}")


class TransferError(RectError):
    """A transfer cannot be offered or completed."""


class TransferRefused(TransferError):
    """The receiver refused the transfer. The call of `receive_transfers` on that robot defines what is accepted."""


class TransferFailed(TransferError):
    """A transfer ended before it was complete. The reason in the text shows whether to send it again."""


class FileError(RectError, OSError):
    """A file or folder of a transfer cannot be used."""

    def __init__(self, text: str, errno: int | None = None) -> None:
        super().__init__(text)
        self.errno = errno


class Closed(RectError):
    """The robot or the handle is closed, or the transfer was stopped.

    Also raised for a robot of the parent process after a fork.
    """

    def __init__(self, text: str = "the session is closed") -> None:
        super().__init__(text)


def _restored(cls: type[RectError], args: tuple[Any, ...]) -> RectError:
    """Returns the error that `RectError.__reduce__` has described, without its attributes."""
    error = cls.__new__(cls)
    error.args = args
    return error


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def _seconds(seconds: float) -> str:
    """Formats a duration with the same rounding as the Rust library: `2 s`, `4.2 s`, `500 ms`."""
    if 0 < seconds < 0.9995:
        return f"{seconds * 1000:.{int(seconds < 0.001)}f} ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s".replace(".0 s", " s")
    if seconds < 119.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7170 else f"{seconds / 3600:.0f} h"
