"""Owns how a program joins: by which router, or directly, as whom."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from rect import _rect
from rect._zenoh import patiently
from rect.errors import NoRouter, OptionError, RectError

#: Where a robot's router serves its programs unless told otherwise.
DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
#: Where another router is named for all programs that do not name one.
ROUTER_VARIABLE = "RECT_ENDPOINT"
#: Where `rect-router init` puts the logins.
DEFAULT_LOGIN_FILE = "/etc/rect/users"


def default_router() -> str:
    """The router of programs that name none: what the environment's `RECT_ENDPOINT` says, else `tcp/127.0.0.1:7447`."""
    return os.environ.get(ROUTER_VARIABLE) or DEFAULT_ROUTER


@dataclass
class Options:
    """How to join; `rect.connect` says what each is."""

    name: str
    fleet: str = "rect"
    router: str | None = None
    endpoints: Sequence[str] = ()
    listen: Sequence[str] = ()
    login: tuple[str, str] | None = None
    login_file: str | Path = DEFAULT_LOGIN_FILE
    timeout: float = 5.0
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in ("name", "fleet"):
            text(what, getattr(self, what))
        for what in ("endpoints", "listen"):
            given = getattr(self, what)
            if isinstance(given, str) or not all(isinstance(one, str) for one in given):
                raise TypeError(f"{what} is a list of locators such as ['tcp/192.168.0.7:7447'], not {given!r}")
        if self.router is not None:
            text("router", self.router)
        seconds("timeout", self.timeout)

    @property
    def is_direct(self) -> bool:
        """Without a router."""
        return bool(self.endpoints or self.listen)

    def place(self) -> _rect.Place:
        return _rect.Place(self.fleet, self.name)

    def open(self) -> zenoh.Session:
        """Joins. Raises `NoRouter`, `OptionError`."""
        config = self._config()
        try:
            return patiently(lambda: zenoh.open(config), lambda session: session.close())
        except zenoh.ZError as error:
            raise self._refused(_rect.in_words(str(error))) from None

    def _refused(self, reason: str) -> RectError:
        if self.is_direct:
            return OptionError("listen or endpoint", " ".join([*self.listen, *self.endpoints]), reason)
        return NoRouter(self.router or default_router(), reason)

    def _config(self) -> zenoh.Config:
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
                    "connect/endpoints": [self.router or default_router()],
                    "connect/timeout_ms": int(self.timeout * 1000),
                    "connect/retry": _retry(100),
                }
            )
        login = self.login or _first_login(self.login_file)
        if login:
            user, password = login
            settings["transport/auth/usrpwd"] = {"user": user, "password": password}
        config = zenoh.Config()
        for key, value in {**settings, **self.settings}.items():
            value = json.dumps(value)
            try:
                config.insert_json5(key, value)
            except zenoh.ZError as error:
                raise OptionError("of Zenoh", f"{key}: {value}", _rect.in_words(str(error))) from None
        return config


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


def _retry(first_ms: int) -> dict[str, int]:
    return {"period_init_ms": first_ms, "period_max_ms": 1000, "period_increase_factor": 2}


def _first_login(file: str | Path) -> tuple[str, str] | None:
    try:
        return _rect.first_login(Path(file).read_text())
    except (OSError, UnicodeDecodeError):
        return None
