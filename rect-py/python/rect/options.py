"""Opens the Zenoh session of a robot: through a router, or directly with other programs."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from rect import _rect
from rect._zenoh import call_interruptibly
from rect.errors import OptionError, RectError

#: Environment variable with the locator of the router for all programs that do not name one.
ROUTER_VARIABLE = _rect.ROUTER_VARIABLE


def default_router() -> str:
    """Returns the router's locator for programs that name none: `RECT_ENDPOINT`, or else `tcp/127.0.0.1:7447`."""
    return _rect.default_router(os.environ.get(ROUTER_VARIABLE))


def default_login_file() -> str:
    """Returns the login file of programs that name none: the value of `RECT_LOGIN`, or else `/etc/rect/users`."""
    return _rect.default_login_file(os.environ.get(_rect.LOGIN_VARIABLE))


@dataclass
class Options:
    """The arguments of `rect.connect`, which documents them."""

    name: str
    fleet: str = "rect"
    router: str | None = None
    endpoints: Sequence[str] = ()
    listen: Sequence[str] = ()
    login: tuple[str, str] | None = None
    login_file: str | Path | None = None
    timeout: float = 5.0
    settings: Mapping[str, Any] = field(default_factory=dict)
    allow_name_mismatch: bool = False
    program: str | None = ""

    def __post_init__(self) -> None:
        for option in ("name", "fleet"):
            text(option, getattr(self, option))
        for option in ("endpoints", "listen"):
            locators = getattr(self, option)
            is_list = isinstance(locators, Sequence) and not isinstance(locators, str)
            if not is_list or not all(isinstance(locator, str) for locator in locators):
                raise TypeError(
                    f"{option} must be a list of locators such as ['tcp/192.168.0.7:7447'], not {locators!r}"
                )
        if self.router is not None:
            text("router", self.router)
        if self.program is not None:
            text("program", self.program)
        if self.login is not None:
            is_pair = isinstance(self.login, (tuple, list)) and len(self.login) == 2
            if not is_pair or not all(isinstance(part, str) for part in self.login):
                raise TypeError("login must be a pair of strings: (user, password)")
        seconds("timeout", self.timeout)

    @property
    def is_direct(self) -> bool:
        """Whether the program connects without a router."""
        return bool(self.endpoints or self.listen)

    def key_space(self) -> _rect.KeySpace:
        return _rect.KeySpace(self.fleet, self.name)

    @property
    def endpoint(self) -> str:
        """Locator of the router."""
        return self.router or default_router()

    def open(self) -> zenoh.Session:
        """Opens the session.

        Raises `NoRouter`, `LoginRefused` and `OptionError`.
        """
        attempts = self._join_attempts()
        if self.is_direct:
            return self._open_directly(attempts)
        began = time.monotonic()
        while True:
            settings = self._settings(attempts.credentials())
            _config(settings)
            cause: zenoh.ZError | None = None
            try:
                return call_interruptibly(
                    lambda settings=settings: _attempt(settings),  # type: ignore[misc]
                    lambda session: session.close(),
                    attempts.limit(time.monotonic() - began),
                )
            except TimeoutError:
                pass
            except zenoh.ZError as error:
                cause = error
            reason = None if cause is None else str(cause)
            try:
                pause = attempts.on_failure(time.monotonic() - began, reason)
            except RectError as error:
                raise error from cause
            time.sleep(pause)

    def _open_directly(self, attempts: _rect.JoinAttempts) -> zenoh.Session:
        config = _config(self._settings(attempts.credentials()))
        try:
            return call_interruptibly(lambda: zenoh.open(config), lambda session: session.close())
        except zenoh.ZError as error:
            locators = " ".join([*self.listen, *self.endpoints])
            raise OptionError("listen or endpoints", locators, _rect.on_one_line(str(error))) from error

    def _join_attempts(self) -> _rect.JoinAttempts:
        file = Path(self.login_file or default_login_file())
        text, unreadable = None, ""
        if self.login is None:
            try:
                text = file.read_text()
            except OSError as error:
                unreadable = error.strerror or str(error)
            except UnicodeDecodeError:
                unreadable = "it is not a text file"
        login = None if self.login is None else (self.login[0], self.login[1])
        return _rect.JoinAttempts(self.endpoint, self.timeout, login, str(file), text, unreadable)

    def _settings(self, credentials: tuple[str, str] | None) -> _Settings:
        added = json.dumps(dict(self.settings))
        return _rect.session_settings(self.endpoint, list(self.endpoints), list(self.listen), credentials, added)


#: Settings of Zenoh: path, value in JSON, and the option with its value that determine it.
_Settings = list[tuple[str, str, str, str]]


def _config(settings: _Settings) -> zenoh.Config:
    """Returns Zenoh's configuration. Raises `OptionError`."""
    config = zenoh.Config()
    for key, value, option, given in settings:
        try:
            config.insert_json5(key, value)
        except zenoh.ZError as error:
            option = "endpoints" if option == "endpoint" else option
            raise OptionError(option, given, _rect.on_one_line(str(error))) from error
    return config


def _attempt(settings: _Settings) -> zenoh.Session:
    """Tries once to open the session. Raises `zenoh.ZError` with the reason."""
    try:
        return zenoh.open(_config(settings))
    except zenoh.ZError:
        config = _config(settings)
        for key, value in _rect.DIAGNOSIS:
            config.insert_json5(key, value)
        # Raises an error with the reason. If it succeeds instead, the router has just started: the error is kept.
        with contextlib.closing(zenoh.open(config)):
            raise


def tokens_of_router(session: zenoh.Session) -> list[str]:
    """Returns the keys of the liveliness tokens that name the robot of the session's router.

    The list is empty if the router serves no robot or does not answer in time. The router answers from its own state:
    nothing is sent over the air.
    """
    router = next(iter(session.info.routers_zid()), None)
    if router is None:
        return []
    key = _rect.robot_of_router(str(router))
    replies = session.liveliness().get(key, timeout=_rect.ROBOT_TIMEOUT_S)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def text(name: str, value: object) -> str:
    """Returns `value` if it is a string. Raises `TypeError`."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a str, not {type(value).__name__}")
    return value


def seconds(name: str, value: object) -> float:
    """Returns `value` as a duration in seconds. Raises `TypeError` and `OptionError`."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{name} must be a number of seconds, not {type(value).__name__}")
    if not 0 <= value <= 1e9:
        raise OptionError(name, value, "it must be 0 to 1e9 seconds")
    return float(value)


def lifetime_of(expires_after: object) -> float | None:
    """Returns the time in seconds after which a message expires, or `None`. Raises `TypeError` and `OptionError`."""
    return None if expires_after is None else seconds("expires_after", expires_after)


def whole(name: str, value: object, minimum: int) -> int:
    """Returns `value` if it is an integer of at least `minimum`. Raises `TypeError` and `OptionError`."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{name} must be an integer, not {type(value).__name__}")
    if not minimum <= value < 2**63:
        raise OptionError(name, value, f"it must be an integer of at least {minimum}")
    return value
