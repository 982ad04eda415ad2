"""Tests connecting to a router: logins, the robot that the router serves, and the timeout.

RECT_ROUTER=target/checked/rect-router pytest rect-py/tests/test_joining.py
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import rect
import zenoh
from conftest import DEADLINE, free_port
from programs import program

Setting = dict[str, object]


@contextmanager
def router(settings: Setting) -> Iterator[str]:
    """Starts a router with these settings and yields its locator."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [program("RECT_ROUTER", "rect-router"), "-l", endpoint, "--no-multicast-scouting"]
    command += [part for key, value in settings.items() for part in ("--cfg", f"{key}:{json.dumps(value)}")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        output, log = process.stdout, ""
        reader = threading.Thread(target=lambda: list(output))
        try:
            for line in output:
                log += line
                if "rect-router is up" in line:
                    break
            else:
                pytest.fail(f"the router does not start: {log}")
            reader.start()
            yield endpoint
        finally:
            process.terminate()
            if reader.ident is not None:
                reader.join()


@pytest.fixture(scope="module")
def router_with_logins(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """Starts a router that requires a login; yields its locator and its login file."""
    users = tmp_path_factory.mktemp("logins") / "users"
    users.write_text("fleet:secret\n")
    with router({"transport/auth/usrpwd/dictionary_file": str(users)}) as endpoint:
        yield endpoint, users


@pytest.fixture(scope="module")
def router_of_wombat_1() -> Iterator[str]:
    """Starts the router of the robot wombat-1."""
    with router({"plugins/rect/robot": "wombat-1"}) as endpoint:
        yield endpoint


def test_missing_login_is_reported_at_once_with_advice(router_with_logins: tuple[str, Path]) -> None:
    endpoint, _ = router_with_logins
    began = time.monotonic()
    with pytest.raises(rect.LoginRefused) as raised:
        rect.connect("wombat-1", router=endpoint, login_file="/none", timeout=20)
    assert time.monotonic() - began < 5
    assert re.search(r"requires a login, but the login file /none cannot be read: No such file", str(raised.value))
    assert "RECT_LOGIN" in str(raised.value) and raised.value.endpoint == endpoint


@pytest.mark.parametrize("login", [("fleet", "guessed"), ("nobody", "secret")])
def test_wrong_login_is_reported_at_once(router_with_logins: tuple[str, Path], login: tuple[str, str]) -> None:
    began = time.monotonic()
    with pytest.raises(rect.LoginRefused, match=f"refused the login of user {login[0]}: "):
        rect.connect("wombat-1", router=router_with_logins[0], login=login, timeout=20)
    assert time.monotonic() - began < 5


def test_environment_variable_selects_login_file(
    router_with_logins: tuple[str, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    endpoint, users = router_with_logins
    monkeypatch.setenv("RECT_LOGIN", str(users))
    with rect.connect("wombat-1", router=endpoint) as robot:
        robot.publish("x", 1, urgency="urgent")
    wrong = tmp_path / "wrong"
    wrong.write_text("fleet:guessed\n")
    monkeypatch.setenv("RECT_LOGIN", str(wrong))
    with pytest.raises(rect.LoginRefused, match=re.escape(f"of user fleet in {wrong}")):
        rect.connect("wombat-1", router=endpoint)
    rect.connect("wombat-1", router=endpoint, login_file=users).close()


def test_login_is_ignored_by_router_without_logins(router_of_wombat_1: str) -> None:
    with rect.connect("wombat-1", router=router_of_wombat_1, login=("fleet", "secret")) as robot:
        robot.publish("x", 1, urgency="urgent")


def test_router_of_another_robot_is_rejected(router_of_wombat_1: str) -> None:
    with pytest.raises(rect.WrongRobot) as raised:
        rect.connect("wombat-7", router=router_of_wombat_1)
    text = str(raised.value)
    assert (
        "serves the robot wombat-1," in text and "joins as the robot wombat-7:" in text and router_of_wombat_1 in text
    )
    assert raised.value.serves == "wombat-1"
    with pytest.raises(rect.WrongRobot, match=r"wombat-1 of the fleet rect, .* wombat-1 of the fleet lions"):
        rect.connect("wombat-1", fleet="lions", router=router_of_wombat_1)
    with rect.connect("wombat-7", router=router_of_wombat_1, allow_name_mismatch=True) as robot:
        robot.publish("x", 1)


def test_router_without_robot_accepts_any_name() -> None:
    with router({}) as endpoint, rect.connect("wombat-7", router=endpoint) as robot:
        robot.publish("x", 1)


def test_stock_router_accepts_any_name() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config), rect.connect("wombat-7", router=endpoint) as robot:
        robot.publish("x", 1)


def test_timeout_applies_if_nothing_listens() -> None:
    began = time.monotonic()
    with pytest.raises(rect.NoRouter, match="Connection refused") as raised:
        rect.connect("wombat-1", router=f"tcp/127.0.0.1:{free_port()}", timeout=1)
    assert 1 <= time.monotonic() - began < 4
    assert isinstance(raised.value.__cause__, zenoh.ZError)


@pytest.mark.parametrize("on", [lambda call: call(), lambda call: in_a_thread(call)], ids=["main", "thread"])
def test_timeout_applies_if_nothing_answers(on: Callable[[Callable[[], None]], None]) -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"

        def connect() -> None:
            began = time.monotonic()
            with pytest.raises(rect.NoRouter, match=r"no answer within 1 s"):
                rect.connect("wombat-1", router=endpoint, timeout=1)
            assert 1 <= time.monotonic() - began < 4

        on(connect)


def in_a_thread(call: Callable[[], None]) -> None:
    failed: list[BaseException] = []

    def run() -> None:
        try:
            call()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(DEADLINE)
    assert not thread.is_alive()
    if failed:
        raise failed[0]


def test_connect_waits_for_router_that_starts_later() -> None:
    port = free_port()
    joined: list[rect.Robot] = []
    waiting = threading.Thread(
        target=lambda: joined.append(rect.connect("wombat-1", router=f"tcp/127.0.0.1:{port}", timeout=DEADLINE))
    )
    waiting.start()
    waiting.join(0.3)
    assert waiting.is_alive()
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        waiting.join(DEADLINE)
        joined[0].close()
