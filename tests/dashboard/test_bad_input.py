"""Tests that nothing that a robot, a browser or another site sends harms the dashboard or those who look at it."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
import rect
import websockets.sync.client as client
from conftest import Fleet
from playwright.sync_api import Page, expect
from websockets.exceptions import ConnectionClosed, InvalidStatus

HOSTILE = "<img src=x onerror=alert(1)>\u202etxt.exe\u0007"


def request(url: str, method: str = "GET", data: bytes | None = None, **headers: str) -> tuple[int, str]:
    """Returns the status and the text of an answer. Redirects are not followed."""

    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *_: object) -> None:
            return None

    names = {name.replace("_", "-"): value for name, value in headers.items()}
    asked = urllib.request.Request(url, method=method, data=data, headers=names)
    try:
        with urllib.request.build_opener(Stay).open(asked, timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def socket_of(url: str, **options: object) -> client.ClientConnection:
    options.setdefault("origin", url)
    return client.connect(f"{url.replace('http', 'ws')}/socket", max_size=None, close_timeout=1, **options)


def state(connection: client.ClientConnection, kind: str) -> dict:
    """Returns the next state of a type."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        message = connection.recv(timeout=30)
        assert isinstance(message, bytes)
        if message[0] == 1:
            found = json.loads(message[1:])
            if found["type"] == kind:
                return found
    raise AssertionError(f"there is no state {kind}")


def command(connection: client.ClientConnection, /, **fields: object) -> dict:
    connection.send(json.dumps(fields))
    while True:
        answer = state(connection, "answer")
        if answer["id"] == fields["id"]:
            return answer


def test_values_are_never_interpreted_as_html(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.on("dialog", lambda dialog: pytest.fail(f"a script ran: {dialog.message}"))
    with fleet.program(1) as robot:
        page.goto(f"{dashboard}/#topics/wombat-2%2Fhostile")
        expect(page.get_by_role("heading", name="wombat-2/hostile")).to_be_visible()
        deadline = time.monotonic() + 30
        tree = page.locator(".tree")
        while "onerror" not in tree.inner_text() and time.monotonic() < deadline:
            robot.publish("hostile", {HOSTILE: [HOSTILE, "x" * 65536]})
            page.wait_for_timeout(100)
        expect(tree).to_contain_text("<img src=x onerror=alert(1)>␣txt.exe␣")
        expect(tree).to_contain_text("(65536 characters)")
        assert page.locator("img").count() == 0


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (b"[NaN, Infinity", "14"),
        (rect.Payload(b"\xf9\x7e\x00", "application/cbor"), "NaN"),
        (rect.Payload(b"\x89PNG damaged", "image/png"), "damaged"),
        (rect.Payload(b"[" + b"1," * 5_000_000 + b"1]", "application/json"), "too many to show"),
        (rect.Payload(b"\xff" * 10, "x" * 200), "bytes"),
    ],
)
def test_values_that_cannot_be_shown_are_described(
    page: Page, fleet: Fleet, dashboard: str, value: rect.Payload | bytes, shown: str
) -> None:
    with fleet.program(0) as robot:
        page.goto(f"{dashboard}/#topics/wombat-1%2Fodd")
        deadline = time.monotonic() + 30
        chosen = page.locator(".chosen")
        while shown not in chosen.inner_text() and time.monotonic() < deadline:
            robot.publish("odd", value)
            page.wait_for_timeout(200)
        expect(chosen).to_contain_text(shown)


def test_other_sites_are_rejected(dashboard: str) -> None:
    port = dashboard.rsplit(":", 1)[1]
    assert request(dashboard, Host="evil.example")[0] == 421
    assert request(f"{dashboard}/logout", "POST", b"", Origin="http://evil.example")[0] == 403
    assert request(f"{dashboard}/logout", "POST", b"")[0] == 403
    for origin in ("http://evil.example", f"http://localhost:{port}.evil.example", "null", None):
        with pytest.raises(InvalidStatus, match="403"), socket_of(dashboard, origin=origin):
            pass
    with socket_of(dashboard) as connection:
        assert state(connection, "hello")["robot"] == "wombat-1"


def test_policy_forbids_scripts_and_frames_of_others(dashboard: str) -> None:
    with urllib.request.urlopen(dashboard, timeout=10) as answer:
        policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "script-src 'self'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors http://127.0.0.1:1" in policy
    assert request(f"{dashboard}/assets/..%2f..%2fdashboard.rs")[0] == 404
    assert request(f"{dashboard}/nothing")[0] == 404


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"type":"publish"}', '{"type":"show","topics":true,"x":1}'])
def test_commands_of_another_version_end_the_connection_with_a_reason(dashboard: str, text: str) -> None:
    with socket_of(dashboard) as connection:
        connection.send(text)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                connection.recv(timeout=30)
        assert closed.value.rcvd is not None and "not a command" in closed.value.rcvd.reason
    with socket_of(dashboard) as connection, pytest.raises(ConnectionClosed):
        connection.send("x" * 200_000)
        while True:
            connection.recv(timeout=30)


def test_wrong_names_are_answered_with_their_problem(dashboard: str) -> None:
    with socket_of(dashboard) as connection:
        for number, (fields, problem) in enumerate(
            [
                ({"type": "watch", "topic": "wombat-1/**", "stream": True}, "wildcards"),
                ({"type": "watch", "topic": "\u202e", "stream": False}, "<robot>/<topic>"),
                ({"type": "request", "robot": "a b", "topic": "x", "value": ""}, "a b"),
                ({"type": "publish", "to": None, "topic": "x" * 65536, "value": "", "urgent": False}, "200"),
                ({"type": "disconnect", "robot": "wombat-1", "name": "none"}, "none"),
            ],
            start=1,
        ):
            answer = command(connection, id=number, **fields)
            assert answer["error"] and problem in answer["error"], answer


def test_stalled_browser_costs_little_and_delays_nobody(fleet: Fleet, dashboard: str) -> None:
    with fleet.program(0) as robot, socket_of(dashboard) as reading:
        stalled = raw_socket(dashboard)
        send_frame(stalled, {"type": "watch", "id": 1, "topic": "wombat-1/load", "stream": False})
        reading.send(json.dumps({"type": "watch", "id": 1, "topic": "wombat-1/load", "stream": False}))
        before = 0
        received = 0
        started = time.monotonic()
        sent = 0
        while time.monotonic() - started < 5:
            robot.publish("load", "x" * 20_000)
            sent += 1
            time.sleep(0.01)
            try:
                while True:
                    message = reading.recv(timeout=0)
                    received += message[0] == 2
            except TimeoutError:
                pass
            # The first value shows that both receive.
            if received and not before:
                before = memory_kb()
        # A browser is sent 30 values a second.
        assert received > min(sent, 5 * 30) * 0.8, (received, sent)
        # 3 MB were sent; the stalled browser's values are dropped.
        assert memory_kb() - before < 2000
        stalled.close()


def memory_kb() -> int:
    """Returns the memory that the dashboard of these tests has written to. The pages of its program are not
    counted, as they are private only while no other process runs that program."""
    found = subprocess.run(["pgrep", "-f", "dashboard.*--record"], capture_output=True, text=True, check=True)
    pid = found.stdout.split()[0]
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return int(re.findall(r"Private_Dirty:\s+(\d+)", text)[0])


def raw_socket(url: str) -> socket.socket:
    """Opens a WebSocket that is never read."""
    host = url.removeprefix("http://")
    address, port = host.split(":")
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stalled.connect((address, int(port)))
    lines = [
        "GET /socket HTTP/1.1",
        f"Host: {host}",
        f"Origin: {url}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    ]
    stalled.sendall("".join(f"{line}\r\n" for line in [*lines, ""]).encode())
    assert b"101" in stalled.recv(1000)
    return stalled


def send_frame(connection: socket.socket, fields: dict) -> None:
    text = json.dumps(fields).encode()
    assert len(text) < 126
    # The mask is all zeroes.
    connection.sendall(bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)


def test_stop_is_permitted_while_other_commands_wait(dashboard: str) -> None:
    with socket_of(dashboard) as connection:
        for number in range(1, 20):
            fields = {"type": "request", "id": number, "robot": "nobody", "topic": "x", "value": ""}
            connection.send(json.dumps(fields))
        try:
            assert command(connection, type="stop", id=100)["error"] is None
        finally:
            with socket_of(dashboard) as other:
                assert command(other, type="release_stop", id=1)["error"] is None


def test_flood_of_commands_is_limited(dashboard: str) -> None:
    with socket_of(dashboard) as connection:
        for number in range(1, 200):
            fields = {"type": "request", "id": number, "robot": "nobody", "topic": "x", "value": ""}
            connection.send(json.dumps(fields))
        problems = [state(connection, "answer")["error"] for _ in range(60)]
        assert sum("too many commands" in problem for problem in problems) > 20
        for number in range(300, 400):
            connection.send(
                json.dumps({"type": "watch", "id": number, "topic": f"wombat-1/t{number}", "stream": False})
            )
        while "at most 64 topics" not in state(connection, "answer")["error"]:
            pass


def http(dashboard: str, start: str, *headers: str) -> bytes:
    lines = [f"{start} HTTP/1.1", f"Host: {dashboard.removeprefix('http://')}", *headers, "", ""]
    return "\r\n".join(lines).encode()


@pytest.mark.parametrize("kind", ["silent", "without its body", "not reading"])
def test_connections_that_do_nothing_keep_nobody_out(dashboard: str, kind: str) -> None:
    form = ("Content-Type: application/x-www-form-urlencoded", "Content-Length: 1000")
    sent = {
        "silent": b"",
        "without its body": http(dashboard, "POST /login", f"Origin: {dashboard}", *form),
        "not reading": http(dashboard, "GET /assets/uPlot.iife.min.js") * 100,
    }[kind]
    address, port = dashboard.removeprefix("http://").split(":")
    with ExitStack() as connections:
        for _ in range(200):
            connection = connections.enter_context(socket.create_connection((address, int(port))))
            # It may have been closed already.
            with suppress(OSError):
                connection.sendall(sent)
        assert request(dashboard)[0] == 200
        with socket_of(dashboard) as browser:
            assert state(browser, "hello")["robot"] == "wombat-1"


def test_changes_on_this_computer_require_the_robots_login(page: Page, fleet: Fleet, tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("team:our secret\n")
    with fleet.dashboard("--users", str(users)) as url:
        page.goto(f"{url}/#connections")
        expect(page.locator(".condition")).to_have_text("live")
        form = page.get_by_role("form", name="Add a connection")
        expect(form).to_have_count(0)
        connection = {"name": "base", "method": "tcp", "address": "127.0.0.1", "port": 9}
        with socket_of(url) as browser:
            for number, (fields, problem) in enumerate(
                [
                    ({"type": "publish", "to": None, "topic": "x", "value": "1", "urgent": False}, "require a login"),
                    ({"type": "connect", "robot": "wombat-1", "connection": connection}, "require a login"),
                    ({"type": "disconnect", "robot": "wombat-1", "name": "base"}, "require a login"),
                    ({"type": "stop"}, None),
                    ({"type": "release_stop"}, "require a login"),
                ],
                start=1,
            ):
                error = command(browser, id=number, **fields)["error"]
                assert (problem in error) if problem else error is None, (fields, error)
        page.get_by_role("button", name="Log in").click()
        page.get_by_label("User").fill("team")
        page.get_by_label("Password").fill("our secret")
        page.get_by_role("button", name="Log in").click()
        expect(page.locator(".condition")).to_have_text("live")
        page.goto(f"{url}/#connections")
        expect(form).to_be_visible()
        # The stop shows who is logged in.
        page.get_by_role("button", name="STOP").click()
        area = page.get_by_role("region", name="Stop")
        expect(area).to_contain_text("by wombat-1: team")
        area.get_by_role("button", name="Release…").click()
        area.get_by_role("button", name="Release the stop").click()
        expect(area).to_be_hidden()
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_role("button", name="Log in")).to_be_visible()


def test_login_is_required_limited_and_ends(page: Page, fleet: Fleet, tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("team:our secret\n")
    with fleet.dashboard("--logins", str(users)) as url:
        with pytest.raises(InvalidStatus, match="401"), socket_of(url):
            pass
        page.goto(url)
        page.get_by_label("User").fill("team")
        page.get_by_label("Password").fill("wrong")
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_role("alert")).to_contain_text("wrong")
        page.get_by_label("User").fill("team")
        page.get_by_label("Password").fill("our secret")
        page.get_by_role("button", name="Log in").click()
        expect(page.locator(".condition")).to_have_text("live")
        cookies = page.context.cookies()
        assert [(cookie["httpOnly"], cookie["sameSite"]) for cookie in cookies] == [(True, "Strict")]
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_label("Password")).to_be_visible()
        for _ in range(10):
            status, text = request(f"{url}/login", "POST", b"user=team&password=guess", Origin=url)
        assert status == 429 and "Wait a minute" in text


def test_read_only_page_changes_nothing_except_that_it_stops(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.dashboard("--read-only") as url:
        page.goto(f"{url}/#topics")
        expect(page.locator(".condition")).to_have_text("live")
        expect(page.get_by_role("form", name="Publish and request")).to_have_count(0)
        with socket_of(url) as connection:
            answer = command(connection, type="publish", id=1, to=None, topic="x", value="1", urgent=False)
            assert "--read-only" in answer["error"]
        # It may stop, and somebody else has to release it.
        page.get_by_role("button", name="STOP").click()
        area = page.get_by_role("region", name="Stop")
        expect(area).to_contain_text("This page may not release it.")
        expect(area.get_by_role("button", name="Release…")).to_be_hidden()
        with socket_of(url) as connection:
            assert "--read-only" in command(connection, type="release_stop", id=1)["error"]
        with socket_of(dashboard) as connection:
            while state(connection, "stop")["stop"] is None:
                pass
            assert command(connection, type="release_stop", id=1)["error"] is None
        expect(area).to_be_hidden()


def test_beyond_this_computer_a_login_is_required(fleet: Fleet, tmp_path: Path) -> None:
    command = [os.environ["RECT_TOOL"], "dashboard", "--router", fleet.endpoint(0), "--listen", "0.0.0.0:0"]
    environment = {**os.environ, "RECT_LOGIN": str(tmp_path / "missing")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30)
    assert done.returncode == 1 and "requires a login" in done.stderr, done.stderr


def test_the_option_that_named_a_service_is_refused_with_the_reason(fleet: Fleet) -> None:
    command = [os.environ["RECT_TOOL"], "dashboard", "--router", fleet.endpoint(0), "--stop", "halt"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert done.returncode == 1 and "leave out --stop" in done.stderr and "halt" in done.stderr, done.stderr


def test_page_over_tls(page: Page, fleet: Fleet, tmp_path: Path) -> None:
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost", "-days", "2"]
    subprocess.run([*command, "-keyout", str(key), "-out", str(certificate)], check=True, capture_output=True)
    with fleet.dashboard("--certificate", str(certificate), "--key", str(key)) as url:
        assert url.startswith("https://")
        page.goto(url)
        expect(page.locator(".condition")).to_have_text("live")
