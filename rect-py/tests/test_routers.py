"""Tests two routers that are linked on the simulated air. A Python program uses one router. The `rect` tool, which uses
the Rust library, or another Python program uses the other.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_routers.py
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy
import pytest
import rect
from conftest import DEADLINE, repeating, until, until_served, until_subscribed
from programs import Routers, program


def test_python_receives_messages_of_rust_with_method(routers: Routers) -> None:
    publish = ("pub", "arm/angle", '{"degrees": 12.5}', "--codec", "zstd", "--every", "100ms")
    with (
        routers.connect("wombat-1") as robot,
        robot.subscribe("wombat-2/arm/*") as subscriber,
        routers.tool("wombat-2", *publish),
    ):
        message = subscriber.next(DEADLINE)
        assert (message.value, message.sender, message.urgency) == ({"degrees": 12.5}, "wombat-2", "normal")
        while message.method is None:
            message = subscriber.next(DEADLINE)
        assert message.method == "ble"
        assert message.missed == 0


def test_rust_receives_messages_of_python(routers: Routers) -> None:
    subscribe = ("sub", "wombat-1/**", "--json", "--count", "2")
    with routers.tool("wombat-2", *subscribe) as tool, routers.connect("wombat-1") as robot:
        until_subscribed(robot, "arm/angle")
        until_subscribed(robot, "to/wombat-2/note")
        robot.publish("arm/angle", {"degrees": 1.0}, codec="zstd")
        robot.send("wombat-2", "note", "psst", urgency="urgent")
        lines = [json.loads(tool.until("{")) for _ in range(2)]
    messages = {line["topic"]: line for line in lines}
    assert messages["arm/angle"]["value"] == {"degrees": 1.0}
    assert messages["note"]["value"] == "psst"
    assert messages["note"]["urgency"] == "urgent"


def test_python_requests_service_of_rust(routers: Routers) -> None:
    with routers.connect("wombat-1") as robot:
        with routers.tool("wombat-2", "serve", "echo", "--about", "repeats", "--allow-several", "--", "cat"):
            until_served(robot, "wombat-2", "echo")
            assert robot.request("wombat-2", "echo", "hello", timeout=DEADLINE).value == "hello"
            assert robot.services("wombat-2") == [rect.ServiceEntry("echo", "repeats", True)]
        with routers.tool("wombat-2", "serve", "fail", "--", "sh", "-c", "echo on purpose >&2; exit 1"):
            until_served(robot, "wombat-2", "fail")
            with pytest.raises(rect.ServiceError, match=r"wombat-2 replied with an error: .*on purpose"):
                robot.request("wombat-2", "fail", timeout=DEADLINE)


def test_rust_requests_service_of_python(routers: Routers) -> None:
    def battery(request: rect.Request) -> dict[str, Any]:
        if request.value != {"cell": 1}:
            raise rect.Refusal("the cell must be 1")
        return {"requester": request.sender, "volt": 3.6}

    with routers.connect("wombat-1") as robot, routers.connect("wombat-2") as other:
        robot.serve("battery", battery)
        until_served(other, "wombat-1", "battery")
        with routers.tool("wombat-2", "request", "wombat-1", "battery", '{"cell": 1}', "--timeout", "20s") as tool:
            assert "3.6" in tool.until("wombat-2")
            assert tool.ends() == 0
        with routers.tool("wombat-2", "request", "wombat-1", "battery", "9", "--timeout", "20s") as tool:
            tool.until("the cell must be 1")
            assert tool.ends() != 0


def test_transfers_in_both_directions(routers: Routers, tmp_path: Path) -> None:
    source = tmp_path / "map.bin"
    source.write_bytes(os.urandom(60_000))
    with routers.connect("wombat-1") as robot:
        with robot.receive_transfers("*/**") as files:
            with routers.tool("wombat-2", "transfer", "send", "wombat-1", str(source)) as tool:
                received = files.next(DEADLINE)
                assert tool.ends() == 0
            assert received.content == source.read_bytes()
            topic = received.topic
        folder = tmp_path / "in"
        with routers.tool("wombat-2", "transfer", "receive", "--folder", str(folder)):
            robot.transfer("wombat-2", topic, source, timeout=DEADLINE)
        assert (folder / "wombat-1" / "map.bin").read_bytes() == source.read_bytes()


def test_stream_from_rust_to_python(routers: Routers, tmp_path: Path) -> None:
    picture = rect.Picture(numpy.full((48, 64, 3), 90, numpy.uint8))
    file = tmp_path / "frame.png"
    file.write_bytes(picture._repr_png_())
    with (
        routers.connect("wombat-1") as robot,
        robot.watch("wombat-2/camera") as watch,
        routers.tool("wombat-2", "stream", "send", "camera", str(file)),
    ):
        frame = watch.next(DEADLINE)
        while frame.number < 3:
            frame = watch.next(DEADLINE)
        assert isinstance(frame.value, rect.Picture)
        assert frame.age is not None


def test_stream_from_python_to_rust(routers: Routers) -> None:
    picture = numpy.full((48, 64, 3), 90, numpy.uint8)
    stop = threading.Event()
    with (
        routers.connect("wombat-1") as robot,
        robot.stream("camera") as camera,
        routers.tool("wombat-2", "stream", "watch", "wombat-1/camera") as tool,
    ):

        def send_frames() -> None:
            while not stop.wait(0.05):
                camera.send(picture)

        sending = threading.Thread(target=send_frames)
        sending.start()
        try:
            lines = [tool.line() for _ in range(3)]
        finally:
            stop.set()
            sending.join()
    assert any("64x48" in line for line in lines), lines


def test_two_python_programs_communicate_over_bluetooth(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2") as two:
        one.serve("double", lambda request: request.value * 2)
        subscriber = two.subscribe("wombat-1/count")
        until_subscribed(one, "count")
        for number in range(20):
            one.publish("count", number)
        assert [subscriber.next(DEADLINE).value for _ in range(20)] == list(range(20))
        until_served(two, "wombat-1", "double")
        assert two.request("wombat-1", "double", 21, timeout=DEADLINE).value == 42
        assert two.peers() == ["wombat-1"]


def test_registry_queries(routers: Routers) -> None:
    with routers.connect("wombat-1") as robot:
        linked = robot.connections(filter="method=ble;state=connected")
        assert [(row.method, row.state, row.robot) for row in linked] == [("ble", "connected", "wombat-2")]
        assert "<td>wombat-2</td>" in linked._repr_html_()
        assert [row.robot for row in robot.connections("wombat-2", "method=ble;state=connected")] == ["wombat-1"]
        count = robot.query_registry("connections/count", filter="state=connected")
        assert count["methods"]["ble"]["connected"] == 1
        with pytest.raises(rect.ServiceError, match="state"):
            robot.connections(filter="state=nonsense")
        with pytest.raises(rect.NoService, match="no program serves the registry"):
            robot.connections("wombat-9")


def until_named(robot: rect.Robot, name: str, addresses: list[str]) -> None:
    """Waits until the connections of that name have these addresses.

    A removed connection is listed until its dialling has ended.
    """
    deadline = time.monotonic() + DEADLINE
    while [row.address for row in robot.connections(filter=f"name={name}")] != addresses:
        assert time.monotonic() < deadline


def test_connections_are_added_and_removed(routers: Routers) -> None:
    with routers.connect("wombat-1") as robot:
        robot.add_connection("base", "tcp", "127.0.0.1", port=9)
        until_named(robot, "base", ["127.0.0.1:9"])
        robot.remove_connection("base")
        until_named(robot, "base", [])
        with pytest.raises(rect.ServiceError, match="base"):
            robot.remove_connection("base")
        with pytest.raises(rect.ServiceError, match="a method is any, ble, tcp, udp"):
            robot.add_connection("base", "nonsense", "127.0.0.1")


def test_urgent_and_bulk_messages_use_separate_sessions(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2") as two:
        subscriber = two.subscribe("wombat-1/x")
        until_subscribed(one, "x")
        urgencies: tuple[rect.Urgency, ...] = ("normal", "urgent", "bulk")
        for urgency in urgencies:
            one.publish("x", urgency, urgency=urgency)
        assert {(message.value, message.urgency) for message in (subscriber.next(DEADLINE) for _ in range(3))} == {
            (urgency, urgency) for urgency in urgencies
        }
        assert len(one._session.urgency_sessions.all()) == 3
        assert len(two._session.urgency_sessions.all()) == 1


def test_events_report_robots_and_links(routers: Routers) -> None:
    with routers.connect("wombat-1") as robot, robot.events() as events:
        seen: dict[str, rect.Event] = {}
        while not {"peer_up", "link_up"} <= seen.keys() or seen["link_up"].method != "ble":
            event = events.next(DEADLINE)
            seen[event.kind] = event
        assert seen["peer_up"].robot == "wombat-2"


def test_recording_has_events_and_links(routers: Routers, tmp_path: Path) -> None:
    file = tmp_path / "match.mcap"
    with routers.connect("wombat-1") as robot, robot.record(file), repeating(0.02, lambda: robot.publish("pose", 1)):
        # The file is read while it grows.
        folder = file.with_suffix(".segments")
        ends = time.monotonic() + DEADLINE
        while time.monotonic() < ends:
            with contextlib.suppress(rect.RecordingError):
                if len(rect.Recording(folder).links().get(("wombat-1", "wombat-2"), {"time_s": []})["time_s"]) > 1:
                    break
            time.sleep(0.2)
    recording = rect.Recording(file)
    link = recording.links()["wombat-1", "wombat-2"]
    assert {"time_s", "up_s", "sent.bytes", "received.bytes"} <= link.keys()
    assert 0.5 < link["time_s"][1] - link["time_s"][0] < 5
    assert link["up_s"][1] > link["up_s"][0]
    events = [(event.reporter, event.event.kind, event.event.robot) for event in recording.events()]
    assert ("wombat-1", "peer_up", "wombat-2") in events
    assert {message.topic for message in recording} == {"pose"}


def test_module_runs_router_named_by_environment() -> None:
    environment = {**os.environ, "RECT_ROUTER": program("RECT_ROUTER", "rect-router")}
    for arguments in (["router", "--version"], ["--help"]):
        command = [sys.executable, "-m", "rect", *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "router" in done.stdout


def test_missing_router_error_says_what_to_do(tmp_path: Path) -> None:
    code = f"import rect.__main__ as m; from pathlib import Path; m._BIN = Path({str(tmp_path)!r}); m.router()"
    environment = {"PATH": "/nowhere", "HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "does not contain the program rect-router: install a wheel that contains it" in done.stderr


def test_program_that_connects_again_and_again_keeps_no_files_open(routers: Routers) -> None:
    """Zenoh keeps a session that has publishers, and Python's collector does not know what a closed session holds."""

    def run_program() -> None:
        with routers.connect("wombat-1") as robot, robot.subscribe("*/arm/*"), robot.serve("sum", lambda _: 1):
            robot.publish("arm/angle", 12.5)
            robot.publish("stop", "", urgency="urgent")
            robot.publisher("arm/state").publish("ready")

    def open_files() -> int:
        return len(os.listdir("/proc/self/fd"))

    run_program()
    first = open_files()
    for _ in range(5):
        run_program()
    # Zenoh closes a socket a moment after its session.
    until(lambda: open_files() <= first, open_files)
