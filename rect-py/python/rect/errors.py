"""Owns what can go wrong, with what to do about it. The words are those of the Rust library."""

from __future__ import annotations

import json
from typing import Any


class RectError(Exception):
    """Something did not work. Each text says what to do."""


class InvalidNameError(RectError, ValueError):
    """The name of a robot or fleet. Choose another."""


class InvalidTopicError(RectError, ValueError):
    """A topic or pattern. Write it as the text says."""


class OptionError(RectError, ValueError):
    """An argument that can't be what it was given as."""

    def __init__(self, what: str, value: object, reason: str) -> None:
        super().__init__(f"the option {what} can't be {_quoted(value)}: {reason}")


class PayloadError(RectError, ValueError):
    """A value that can't be sent, or read as asked for.

    `kind`: `write`, `read`, `other` (the payload is something else), or that of a `CodecError`.
    """

    def __init__(self, text: str, kind: str = "other") -> None:
        super().__init__(text)
        self.kind = kind


class CodecError(PayloadError):
    """A codec that does not fit, or a payload that is damaged.

    `kind`: `unknown`, `option`, `kind`, `damaged`, `too large`, `dictionary` (then `dictionary` is its id), `failed`.
    """

    def __init__(self, text: str, kind: str, dictionary: int | None = None) -> None:
        super().__init__(text, kind)
        self.dictionary = dictionary


class DictionaryError(RectError, ValueError):
    """No dictionary can be made or read of this."""


class NoRouter(RectError, ConnectionError):
    """No router. Start one, or name another."""

    def __init__(self, endpoint: str, reason: str) -> None:
        super().__init__(
            f"no router answers at {endpoint}: {reason}. `python -m rect router -l tcp/127.0.0.1:7447` starts one "
            "here; another one is named by the option `router`, or by RECT_ENDPOINT"
        )
        self.endpoint = endpoint


class LoginRefused(RectError, ConnectionError):
    """The router asks for a login, and this program's is missing or wrong. Name the team's login file."""

    def __init__(self, text: str, endpoint: str) -> None:
        super().__init__(text)
        self.endpoint = endpoint


class WrongRobot(RectError):
    """The router serves another robot (`serves`) than the program joins as. Join under that name, or at the right
    router."""

    def __init__(self, text: str, serves: str) -> None:
        super().__init__(text)
        self.serves = serves


class NoService(RectError, LookupError):
    """Nobody has that service. Is the robot there, and does its program run? `there`: the robots that are."""

    def __init__(self, robot: str, topic: str, there: list[str]) -> None:
        names = ", ".join(there) or "none"
        super().__init__(f"nobody serves {topic} at {robot}; robots there: {names}")
        self.there = there


class TimedOut(RectError, TimeoutError):
    """It took too long. Ask again, allow more time, or look at the link (`python -m rect connections`)."""

    def __init__(self, what: str, after_s: float) -> None:
        super().__init__(f"no {what} within {_seconds(after_s)}")
        self.after_s = after_s


class ServiceError(RectError):
    """The service answered with an error.

    `robot`: who (`None`: a stock program, which does not say); `value`: the error.
    """

    def __init__(self, robot: str | None, value: Any, said: str) -> None:
        super().__init__(f"{robot or 'the service'} answers with an error: {said[:500]}")
        self.robot = robot
        self.value = value


class ZenohError(RectError):
    """Zenoh refuses."""

    def __init__(self, what: str, reason: str) -> None:
        super().__init__(f"{what}: {reason}")


class TransferError(RectError):
    """A transfer that does not get there."""


class TransferRefused(TransferError):
    """A transfer is not taken there. Who is to receive it says what it takes (`receive_transfers`)."""


class TransferFailed(TransferError):
    """A transfer began and ended before all was there. The reason says whether to send it again."""


class FileError(RectError, OSError):
    """A file or folder of a transfer can't be used."""

    def __init__(self, text: str, errno: int | None = None) -> None:
        super().__init__(text)
        self.errno = errno


class Closed(RectError):
    """The session was closed, or is of another process (after a fork)."""

    def __init__(self, text: str = "the session is closed") -> None:
        super().__init__(text)


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def _seconds(seconds: float) -> str:
    """A duration, rounded as Rust rounds it for people: `2 s`, `4.2 s`, `500 ms`."""
    if 0 < seconds < 0.9995:
        return f"{seconds * 1000:.{int(seconds < 0.001)}f} ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s".replace(".0 s", " s")
    if seconds < 119.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7170 else f"{seconds / 3600:.0f} h"
