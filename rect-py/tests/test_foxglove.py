"""Tests `rect foxglove` with a client of the Foxglove WebSocket protocol: `scripts/test-python -k foxglove`"""

from __future__ import annotations

import base64
import json
import os
import resource
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import pytest
import rect
from conftest import DEADLINE, repeating, until, until_served
from google.protobuf import (  # type: ignore[import-untyped, unused-ignore]
    descriptor_pb2,
    descriptor_pool,
    message_factory,
)
from programs import Routers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

JPEG = b"\xff\xd8" + bytes(2000)
#: The first byte of binary messages: of the server, and of the viewer.
DATA, ANSWER = 1, 3
PUBLISH, CALL = 1, 2


class Viewer:
    """A viewer. `channels` are the offered ones by their topics, as the server last described them."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, int] = {}
        self.status: list[str] = []
        self.parameters: dict[str, Any] = {}
        self._shown: dict[str, int] = {}
        self._next = 1

    def show(self, topic: str) -> None:
        """Shows a topic, as soon as it is offered."""
        self.until_offered(topic)
        self._subscribe(topic)

    def until_offered(self, topic: str) -> None:
        while topic not in self.channels:
            self._receive()

    def hide(self, topic: str) -> None:
        self._send(op="unsubscribe", subscriptionIds=[self._shown.pop(topic)])

    def message(self, topic: str) -> bytes:
        """Returns the next message of a topic that is shown."""
        while True:
            data = self._receive()
            if data and data[0] == DATA and struct.unpack_from("<I", data, 1)[0] == self._shown[topic]:
                return data[13:]

    def value(self, topic: str) -> Any:
        return json.loads(self.message(topic))

    def publish(self, topic: str, text: bytes) -> None:
        self._send(op="advertise", channels=[{"id": 1, "topic": topic, "encoding": "json", "schemaName": ""}])
        self._socket.send(struct.pack("<BI", PUBLISH, 1) + text)
        self._send(op="unadvertise", channelIds=[1])

    def call(self, service: str, text: bytes) -> Any:
        while service not in self.services:
            self._receive()
        self._socket.send(struct.pack("<BIII", CALL, self.services[service], 7, 4) + b"json" + text)
        while True:
            answer = self._receive()
            if answer and answer[0] == ANSWER:
                return json.loads(answer[17:])

    def until_status(self, expected: str) -> None:
        while not any(expected in text for text in self.status):
            self._receive()

    def until_parameter(self, name: str, expected: Callable[[Any], bool]) -> None:
        """Waits for a value of a parameter, of which every change is sent."""
        self._send(op="subscribeParameterUpdates", parameterNames=[name])
        self._send(op="getParameters", parameterNames=[], id="all")
        while not expected(self.parameters.get(name)):
            self._receive()

    def set_parameter(self, name: str, value: Any) -> None:
        self._send(op="setParameters", parameters=[{"name": name, "value": value}], id="set")

    def _subscribe(self, topic: str) -> None:
        number = self._next
        self._next += 1
        self._shown[topic] = number
        self._send(op="subscribe", subscriptions=[{"id": number, "channelId": self.channels[topic]["id"]}])

    def _receive(self) -> bytes:
        """Handles a text message, or returns a binary one."""
        received = self._socket.recv(DEADLINE)
        if isinstance(received, bytes):
            return received
        message = json.loads(received)
        if message["op"] == "serverInfo":
            self.info = message
        elif message["op"] == "advertise":
            for channel in message["channels"]:
                self.channels[channel["topic"]] = channel
                # A viewer shows a topic again whose channel has been replaced.
                if channel["topic"] in self._shown:
                    self._subscribe(channel["topic"])
        elif message["op"] == "advertiseServices":
            self.services |= {service["name"]: service["id"] for service in message["services"]}
        elif message["op"] == "parameterValues":
            self.parameters |= {one["name"]: one["value"] for one in message["parameters"]}
        elif message["op"] in ("status", "serviceCallFailure"):
            self.status.append(message["message"])
        return b""

    def _send(self, **message: Any) -> None:
        self._socket.send(json.dumps(message))


@contextmanager
def serving(routers: Routers, *options: str) -> Iterator[str]:
    """Runs `rect foxglove` at wombat-2, and yields its address."""
    with routers.tool("wombat-2", "foxglove", "--listen", "127.0.0.1:0", *options) as tool:
        yield tool.until("open ws://").split()[2]


@contextmanager
def viewer(address: str) -> Iterator[Viewer]:
    with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as socket:
        yield Viewer(socket)


@contextmanager
def publishing(robot: rect.Robot) -> Iterator[Callable[[], int]]:
    """Publishes a pose, an angle and a picture, again and again, on a thread.

    Yields a function that waits for ten more of each, and returns how many bytes the robot sends to others meanwhile.
    """
    rounds = threading.Semaphore(0)

    def publish() -> None:
        robot.publish("pose", {"at": {"x": 1.5}})
        robot.publish("arm/angle", 12.5)
        robot.publish("camera", rect.Payload(JPEG, "image/jpeg"))
        rounds.release()

    def sent_bytes() -> int:
        sent = [link.sent for link in robot.connections(filter="method=ble")]
        return sum(traffic["bytes"] or 0 for traffic in sent if traffic)

    def sent_meanwhile() -> int:
        before = sent_bytes()
        while rounds.acquire(blocking=False):
            pass
        for _ in range(10):
            assert rounds.acquire(timeout=DEADLINE)
        return sent_bytes() - before

    with repeating(0.1, publish):
        yield sent_meanwhile


def test_viewer_shows_values_and_pictures(routers: Routers) -> None:
    with (
        routers.connect("wombat-1") as robot,
        publishing(robot),
        serving(routers) as address,
        viewer(address) as shown,
    ):
        shown.show("/wombat-1/pose")
        assert shown.value("/wombat-1/pose") == {"at": {"x": 1.5}}
        channel = shown.channels["/wombat-1/pose"]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        assert json.loads(channel["schema"])["properties"]["at"]["properties"] == {"x": {"type": "number"}}

        shown.show("/wombat-1/arm/angle")
        assert shown.value("/wombat-1/arm/angle") == {"value": 12.5}
        schema = json.loads(shown.channels["/wombat-1/arm/angle"]["schema"])
        assert schema == {"type": "object", "properties": {"value": {"type": "number"}}}

        shown.show("/wombat-1/camera")
        picture = decoded(shown.message("/wombat-1/camera"), shown.channels["/wombat-1/camera"])
        assert (picture.data, picture.format) == (JPEG, "jpeg")
        assert shown.info["name"] == "RECT, fleet rect"
        assert "clientPublish" not in shown.info["capabilities"]


def test_new_fields_of_a_topic_are_offered(routers: Routers) -> None:
    with routers.connect("wombat-1") as robot, serving(routers) as address, viewer(address) as shown:
        with repeating(0.1, lambda: robot.publish("found", {"detections": []})):
            shown.show("/wombat-1/found")
            assert shown.value("/wombat-1/found") == {"detections": []}
        assert json.loads(shown.channels["/wombat-1/found"]["schema"])["properties"] == {}
        with repeating(0.1, lambda: robot.publish("found", {"detections": [{"x": 1}], "depth": 1})):
            while "depth" not in json.loads(shown.channels["/wombat-1/found"]["schema"])["properties"]:
                shown.value("/wombat-1/found")
            assert shown.value("/wombat-1/found") == {"detections": [{"x": 1}], "depth": 1}


def decoded(message: bytes, channel: dict[str, Any]) -> Any:
    """Decodes a message with the schema that the server gives for it."""
    assert (channel["encoding"], channel["schemaName"]) == ("protobuf", "foxglove.CompressedImage")
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)  # type: ignore[no-untyped-call, unused-ignore]
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
    return kind.FromString(message)


def test_topic_is_transmitted_only_while_it_is_shown(routers: Routers) -> None:
    pictures = 10 * len(JPEG)
    with routers.connect("wombat-1") as robot, publishing(robot) as sent, serving(routers) as address:
        with viewer(address) as shown:
            shown.show("/wombat-1/arm/angle")
            shown.value("/wombat-1/arm/angle")
            assert sent() < pictures / 2
            shown.show("/wombat-1/camera")
            shown.message("/wombat-1/camera")
            assert sent() >= pictures / 2
            shown.hide("/wombat-1/camera")
            until(lambda: sent() < pictures / 2)
            shown.show("/wombat-1/camera")
            shown.message("/wombat-1/camera")
        # A viewer that leaves shows nothing any more.
        until(lambda: sent() < pictures / 2)


def test_log_is_read_only_while_it_is_shown(routers: Routers) -> None:
    topic = "/wombat-1/@rect/log"
    logged = 0

    def log(*texts: str, **fields: Any) -> None:
        """Gives lines to the router of wombat-1, as a program does."""
        nonlocal logged
        lines = [{"at": 1_795_000_000_123, "level": "warn", "text": text, **fields} for text in texts]
        batch = json.dumps({"run": 7, "first": logged, "lines": lines})
        logged += len(texts)
        robot.zenoh.put("rect/wombat-1/@rect/@set/log/arm", batch)

    with routers.connect("wombat-1") as robot, serving(routers) as address:
        follower: Any = robot.zenoh.declare_publisher("rect/wombat-1/@rect/@log/debug/arm")
        log("one", "two")
        with viewer(address) as shown:
            shown.until_offered(topic)
            assert not follower.matching_status.matching
            shown.show(topic)
            assert shown.channels[topic]["schemaName"] == "foxglove.Log"
            assert [shown.value(topic)["message"] for _ in range(2)] == ["one", "two"]
            log("File\n  arm.py", logger="driver", source="arm.py:7", fields={"angle": 1.5})
            assert shown.value(topic) == {
                "timestamp": {"sec": 1_795_000_000, "nsec": 123_000_000},
                "level": 3,
                "message": "File\n  arm.py",
                "name": "arm/driver",
                "file": "arm.py",
                "line": 7,
                "fields": {"angle": 1.5},
            }
            with viewer(address) as second:
                second.show(topic)
                assert [second.value(topic)["line"] for _ in range(3)] == [0, 0, 7]
            assert follower.matching_status.matching
            shown.hide(topic)
            until(lambda: not follower.matching_status.matching)


def test_viewer_publishes_and_sends_requests_only_if_permitted(routers: Routers) -> None:
    options = ("--publish", "--service", "wombat-1/double")
    with routers.connect("wombat-1") as robot, robot.subscribe("wombat-2/**") as messages:
        with robot.serve("double", lambda request: request.value * 2), serving(routers, *options) as address:
            with routers.connect("wombat-2") as other:
                until_served(other, "wombat-1", "double")
            with viewer(address) as shown:
                shown.publish("/arm/angle", b'{"value": 3}')
                message = messages.next(DEADLINE)
                assert (message.topic, message.value, message.recipient) == ("arm/angle", 3, None)
                shown.publish("/wombat-2/note", b'{"text": "hello"}')
                message = messages.next(DEADLINE)
                assert (message.topic, message.value) == ("note", {"text": "hello"})
                shown.publish("/to/wombat-1/drive", b'{"left": 1}')
                message = messages.next(DEADLINE)
                assert (message.topic, message.value, message.recipient) == ("drive", {"left": 1}, "wombat-1")

                assert shown.call("/wombat-1/double", b'{"value": 21}') == {"value": 42}

                for topic, text, problem in [
                    ("/arm/angle", b"{", "not JSON"),
                    ("/arm/*", b"1", "wildcard"),
                    ("/arm/angle", b'"' + bytes(70_000) + b'"', "too many"),
                ]:
                    shown.publish(topic, text)
                    shown.until_status(problem)
        with serving(routers) as address, viewer(address) as shown:
            shown.publish("/arm/angle", b"1")
            shown.until_status("")
            with routers.connect("wombat-2") as other:
                other.publish("after", "")
            assert messages.next(DEADLINE).topic == "after"


def test_named_connections_are_parameters(routers: Routers) -> None:
    with routers.connect("wombat-2") as robot, serving(routers) as address, viewer(address) as shown:
        robot.add_connection("laptop", "tcp", "127.0.0.1", port=9)
        shown.until_parameter(
            "connections/laptop",
            lambda laptop: laptop is not None
            and (laptop["method"], laptop["address"], laptop["state"]) == ("tcp", "127.0.0.1:9", "connecting")
            and "last_error" in laptop,
        )
        shown.set_parameter("connections/laptop", {"method": "tcp"})
        shown.until_status("rect connect")
        robot.remove_connection("laptop")


def test_parameters_of_programs_are_shown_and_changed_if_permitted(routers: Routers) -> None:
    in_memory = rect.GroupOptions(file=False)
    side, kp = rect.Choice("left", "right"), rect.Number(1.0, min=0, max=10)
    with routers.connect("wombat-1") as robot:
        drive = robot.parameters("drive", in_memory, kp=kp, side=side, steps=3, points=[1.0, 2.5])
        with serving(routers, "--publish") as address, viewer(address) as shown, viewer(address) as other:
            until_all(shown, "wombat-1/drive/kp", 1.0)
            values = {"kp": 1.0, "side": "left", "steps": 3, "points": [1.0, 2.5]}
            assert {
                f"wombat-1/drive/{name}": value for name, value in values.items()
            }.items() <= shown.parameters.items()
            other.until_parameter("wombat-1/drive/kp", lambda value: value == 1.0)
            shown.set_parameter("wombat-1/drive/kp", 2)
            other.until_parameter("wombat-1/drive/kp", lambda value: value == 2.0)
            assert drive.kp == 2.0
            # Several at once are one change.
            shown._send(
                op="setParameters",
                parameters=[
                    {"name": "wombat-1/drive/side", "value": "right"},
                    {"name": "wombat-1/drive/kp", "value": 11},
                ],
                id="set",
            )
            shown.until_status("kp cannot be 11: the maximum is 10")
            assert (drive.kp, drive.side) == (2.0, "left")
            shown.set_parameter("wombat-1/drive/points", [3, 4.5])
            other.until_parameter("wombat-1/drive/points", lambda value: value == [3.0, 4.5])
            # Changes of the program itself arrive without a question.
            other.until_parameter("wombat-1/drive/steps", lambda value: value == 3)
            drive.steps = 5
            while other.parameters["wombat-1/drive/steps"] != 5:
                other._receive()
            for name, value, problem in [
                ("wombat-1/driv/kp", 1, "did you mean drive?"),
                ("wombat-1/drive/kq", 1, "no parameter"),
                ("wombat-1/drive/kp", {"a": 1}, "an object cannot be a value"),
                ("nothing", 1, "rect connect"),
            ]:
                shown.set_parameter(name, value)
                shown.until_status(problem)
        with serving(routers) as address, viewer(address) as shown:
            shown.until_parameter("wombat-1/drive/kp", lambda value: value == 2.0)
            shown.set_parameter("wombat-1/drive/kp", 3)
            shown.until_status("start `rect foxglove` with --publish to permit it")
            assert drive.kp == 2.0
        with serving(routers, "--publish", "wombat-2/**") as address, viewer(address) as shown:
            shown.set_parameter("wombat-1/drive/kp", 3)
            shown.until_status("there is no parameter wombat-1/drive/kp")
            assert drive.kp == 2.0


def until_all(shown: Viewer, name: str, expected: object) -> None:
    """Asks for all parameters until one has a value: its program may not be known yet."""
    while shown.parameters.get(name) != expected:
        shown._send(op="getParameters", parameterNames=[], id="all")
        shown._receive()


def test_groups_of_parameters_are_not_services(routers: Routers) -> None:
    with routers.connect("wombat-1") as robot:
        robot.parameters("drive", rect.GroupOptions(file=False), kp=1.0)
        with (
            robot.serve("double", lambda request: request.value * 2),
            serving(routers, "--service", "*/**") as address,
            viewer(address) as shown,
        ):
            while "/wombat-1/double" not in shown.services:
                shown._receive()
            assert not any("parameters" in service for service in shown.services)


def test_stalled_viewer_does_not_delay_another(routers: Routers) -> None:
    # Together more than the kernel's buffers and those of the stalled viewer hold.
    large = rect.Payload(JPEG + bytes(500_000), "image/jpeg")
    with (
        routers.connect("wombat-2") as robot,
        serving(routers) as address,
        viewer(address) as stalled,
        viewer(address) as other,
    ):
        with publishing(robot):
            for shown in (stalled, other):
                shown.show("/wombat-2/camera")
                shown.message("/wombat-2/camera")
        for _ in range(100):
            robot.publish("camera", large)
            while len(other.message("/wombat-2/camera")) < len(large.bytes):
                pass


def test_viewer_of_another_protocol_is_refused(routers: Routers) -> None:
    with serving(routers) as address, pytest.raises(InvalidStatus):
        connect(address, subprotocols=[Subprotocol("graphql-ws")])


@pytest.mark.parametrize("kind", ["silent", "half a request", "showing nothing"])
def test_connections_that_do_nothing_keep_no_viewer_out(routers: Routers, kind: str) -> None:
    with routers.connect("wombat-1") as robot, publishing(robot), serving(routers) as address, ExitStack() as opened:
        place = address.removeprefix("ws://").split(":")
        for _ in range(100):
            if kind == "showing nothing":
                opened.enter_context(viewer(address))
                continue
            connection = opened.enter_context(socket.create_connection((place[0], int(place[1]))))
            if kind == "half a request":
                # It may have been closed already.
                with suppress(OSError):
                    connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
        with viewer(address) as shown:
            shown.show("/wombat-1/arm/angle")
            assert shown.value("/wombat-1/arm/angle") == {"value": 12.5}


def test_viewers_are_accepted_again_after_file_descriptors_were_exhausted(routers: Routers) -> None:
    with routers.tool("wombat-2", "foxglove", "--listen", "127.0.0.1:0") as tool:
        address = tool.until("open ws://").split()[2]
        pid = tool.process.pid
        place = address.removeprefix("ws://").split(":")
        limits = resource.prlimit(pid, resource.RLIMIT_NOFILE)
        used = {int(number) for number in os.listdir(f"/proc/{pid}/fd")}
        first_free = min(set(range(len(used) + 1)) - used)
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (first_free, limits[1]))
        with socket.create_connection((place[0], int(place[1]))):
            tool.until("cannot accept a viewer")
        resource.prlimit(pid, resource.RLIMIT_NOFILE, limits)
        with viewer(address) as shown:
            while not shown.info:
                shown._receive()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 421),
        ({"Origin": "https://app.foxglove.dev"}, 101),
        ({"Origin": "file://"}, 101),
        ({"Origin": "http://localhost:8080"}, 101),
        ({"Origin": "https://viewer.example.org"}, 101),
        ({"Host": "robots.example.org"}, 101),
    ],
)
def test_pages_of_other_sites_are_refused(routers: Routers, headers: dict[str, str], status: int) -> None:
    options = ("--site", "https://viewer.example.org", "--name", "robots.example.org")
    with serving(routers, *options) as address:
        place = address.removeprefix("ws://").split(":")
        lines = {
            "Host": address.removeprefix("ws://"),
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Protocol": "foxglove.sdk.v1",
            **headers,
        }
        request = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        with socket.create_connection((place[0], int(place[1])), timeout=DEADLINE) as connection:
            connection.sendall(f"GET / HTTP/1.1\r\n{request}\r\n".encode())
            answer = connection.makefile("rb").readline()
        assert answer.split()[1] == str(status).encode()


def test_message_that_is_too_large_ends_the_connection_of_its_viewer_alone(routers: Routers) -> None:
    with serving(routers) as address, viewer(address) as other:
        with viewer(address) as one, pytest.raises(ConnectionClosed):
            one._send(op="x" * 3_000_000)
            while True:
                one._receive()
        other._send(op="getParameters", parameterNames=[], id="all")
        while not other.info:
            other._receive()
