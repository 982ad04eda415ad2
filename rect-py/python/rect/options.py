"""Owns how a program joins: by which router, or directly, as whom."""

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
from rect._zenoh import patiently
from rect.errors import OptionError

#: Where a robot's router serves its programs unless told otherwise.
DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
#: Where another router is named for all programs that do not name one.
ROUTER_VARIABLE = "RECT_ENDPOINT"
#: What Zenoh needs to report why it can't connect: as a client it reports only that it could not.
_DIAGNOSIS: dict[str, Any] = {
    "mode": "peer",
    "connect/exit_on_failure": True,
    "listen/endpoints": [],
    "scouting/gossip/enabled": False,
    "open/return_conditions/connect_scouted": False,
}


def default_router() -> str:
    """The router of programs that name none: what the environment's `RECT_ENDPOINT` says, else `tcp/127.0.0.1:7447`."""
    return os.environ.get(ROUTER_VARIABLE) or DEFAULT_ROUTER


def default_login_file() -> str:
    """The login file of programs that name none: what the environment's `RECT_LOGIN` says, else `/etc/rect/users`."""
    return _rect.default_login_file(os.environ.get(_rect.LOGIN_VARIABLE))


@dataclass
class Options:
    """How to join; `rect.connect` says what each is."""

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

    def __post_init__(self) -> None:
        for what in ("name", "fleet"):
            text(what, getattr(self, what))
        for what in ("endpoints", "listen"):
            given = getattr(self, what)
            is_list = isinstance(given, Sequence) and not isinstance(given, str)
            if not is_list or not all(isinstance(one, str) for one in given):
                raise TypeError(f"{what} is a list of locators such as ['tcp/192.168.0.7:7447'], not {given!r}")
        if self.router is not None:
            text("router", self.router)
        if self.login is not None:
            is_pair = isinstance(self.login, (tuple, list)) and len(self.login) == 2
            if not is_pair or not all(isinstance(one, str) for one in self.login):
                raise TypeError("login is (user, password), two texts")
        seconds("timeout", self.timeout)

    @property
    def is_direct(self) -> bool:
        """Without a router."""
        return bool(self.endpoints or self.listen)

    def place(self) -> _rect.Place:
        return _rect.Place(self.fleet, self.name)

    @property
    def endpoint(self) -> str:
        """The router, where there is one."""
        return self.router or default_router()

    def open(self) -> zenoh.Session:
        """Joins. Raises `NoRouter`, `LoginRefused`, `OptionError`."""
        joining = self._joining()
        if self.is_direct:
            return self._open_directly(joining)
        began = time.monotonic()
        while True:
            settings = self._settings(joining.credentials())
            _config(settings)
            reason: str | None
            try:
                return patiently(
                    lambda settings=settings: _attempt(settings),  # type: ignore[misc]
                    lambda session: session.close(),
                    joining.limit(time.monotonic() - began),
                )
            except TimeoutError:
                reason = None
            except zenoh.ZError as error:
                reason = str(error)
            time.sleep(joining.on_failure(time.monotonic() - began, reason))

    def _open_directly(self, joining: _rect.Joining) -> zenoh.Session:
        config = _config(self._settings(joining.credentials()))
        try:
            return patiently(lambda: zenoh.open(config), lambda session: session.close())
        except zenoh.ZError as error:
            locators = " ".join([*self.listen, *self.endpoints])
            raise OptionError("listen or endpoint", locators, _rect.in_words(str(error))) from None

    def _joining(self) -> _rect.Joining:
        file = Path(self.login_file or default_login_file())
        text, unreadable = None, ""
        if self.login is None:
            try:
                text = file.read_text()
            except OSError as error:
                unreadable = error.strerror or str(error)
            except UnicodeDecodeError:
                unreadable = "it is not text"
        login = None if self.login is None else (self.login[0], self.login[1])
        return _rect.Joining(self.endpoint, self.timeout, login, str(file), text, unreadable)

    def _settings(self, credentials: tuple[str, str] | None) -> dict[str, Any]:
        settings: dict[str, Any] = {
            # Identical robots in one network are told apart by their links, not by who hears whose multicast.
            "scouting/multicast/enabled": False,
            # What does not fit into a slow link waits, and does not cost the link (config/README.md).
            "transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000,
        }
        if self.is_direct:
            settings.update(
                {
                    "mode": "peer",
                    "connect/endpoints": list(self.endpoints),
                    "connect/timeout_ms": -1,
                    "connect/exit_on_failure": False,
                    "connect/retry": _retry(200),
                    "listen/endpoints": list(self.listen),
                    "listen/exit_on_failure": True,
                    "scouting/gossip/enabled": False,
                }
            )
        else:
            settings.update(
                {
                    "mode": "client",
                    "connect/endpoints": [self.endpoint],
                    # One attempt: `open` decides about more. The pauses are those of reconnecting.
                    "connect/timeout_ms": 0,
                    "connect/retry": _retry(100),
                }
            )
        if credentials is not None:
            user, password = credentials
            settings["transport/auth/usrpwd"] = {"user": user, "password": password}
        return {**settings, **self.settings}


def _config(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        value = json.dumps(value)
        try:
            config.insert_json5(key, value)
        except zenoh.ZError as error:
            raise OptionError("of Zenoh", f"{key}: {value}", _rect.in_words(str(error))) from None
    return config


def _attempt(settings: Mapping[str, Any]) -> zenoh.Session:
    """One attempt to join. Raises `zenoh.ZError` with the reason."""
    try:
        return zenoh.open(_config(settings))
    except zenoh.ZError:
        # Raises the reason; where this succeeds, the router has come up just now.
        with contextlib.closing(zenoh.open(_config({**settings, **_DIAGNOSIS}))):
            raise


def tokens_of_router(session: zenoh.Session) -> list[str]:
    """The keys of the liveliness tokens that name the robot of the session's router; none where it serves no robot, or
    does not answer in time. The router answers by itself: nothing goes over the air."""
    router = next(iter(session.info.routers_zid()), None)
    if router is None:
        return []
    key = _rect.robot_of_router(str(router))
    replies = session.liveliness().get(key, timeout=_rect.ROBOT_TIMEOUT_S)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def text(what: str, value: object) -> str:
    """The argument, if it is text."""
    if not isinstance(value, str):
        raise TypeError(f"{what} is text, not a {type(value).__name__}")
    return value


def seconds(what: str, value: object) -> float:
    """The argument, if it is a length of time."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{what} is a number of seconds, not a {type(value).__name__}")
    if not 0 <= value <= 1e9:
        raise OptionError(what, value, "it is a number of seconds, not below 0")
    return float(value)


def whole(what: str, value: object, least: int) -> int:
    """The argument, if it is a whole number from `least` on."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{what} is a whole number, not a {type(value).__name__}")
    if not least <= value < 2**63:
        raise OptionError(what, value, f"it is a whole number from {least} on")
    return value


def _retry(first_ms: int) -> dict[str, int]:
    return {"period_init_ms": first_ms, "period_max_ms": 1000, "period_increase_factor": 2}
