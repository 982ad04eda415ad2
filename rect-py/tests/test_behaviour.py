"""Runs the behaviour scenarios in `tests/conformance/behaviour/two_robots.json`, which Rust and C++ run, too.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_behaviour.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import rect
from conftest import DEADLINE, free_port
from programs import Routers

_FILE = Path(__file__).parents[2] / "tests" / "conformance" / "behaviour" / "two_robots.json"
_DOCUMENT = json.loads(_FILE.read_text())
#: The kinds of errors in the scenarios.
_KINDS: dict[type[rect.RectError], str] = {
    rect.Closed: "closed",
    rect.DictionaryError: "dictionary",
    rect.InvalidNameError: "name",
    rect.InvalidTopicError: "topic",
    rect.NotReachable: "not_reachable",
    rect.NoService: "no_service",
    rect.OptionError: "option",
    rect.ServiceError: "service",
    rect.TimedOut: "timed_out",
    rect.TransferRefused: "transfer_refused",
}


def scenarios(network: str) -> list[Any]:
    """Returns the scenarios of a network that apply to Python, as parameters of a test."""
    return [
        pytest.param(scenario["steps"], id=scenario["about"])
        for scenario in _DOCUMENT["scenarios"]
        if network in scenario["networks"] and "python" in scenario.get("languages", ["python"])
    ]


@pytest.mark.parametrize("steps", scenarios("link"))
def test_linked_programs_behave_as_the_scenario_states(steps: list[Any]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-1", listen=[endpoint]) as one, rect.connect("wombat-2", endpoints=[endpoint]) as two:
        run(steps, one, two)


@pytest.mark.parametrize("steps", scenarios("routers"))
def test_programs_at_routers_behave_as_the_scenario_states(steps: list[Any], routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2") as two:
        run(steps, one, two)


def run(steps: list[Any], one: rect.Robot, two: rect.Robot) -> None:
    programs = {"one": Program(one), "two": Program(two)}
    for step in steps:
        name, *arguments = step["do"]
        expected = step["expect"]
        try:
            found = getattr(programs[step["robot"]], name)(*arguments)
        except rect.RectError as error:
            check_error(step["do"], error, expected)
        else:
            assert found == expected, step["do"]


def check_error(call: list[Any], error: rect.RectError, expected: Any) -> None:
    kind = next((kind for error_type, kind in _KINDS.items() if isinstance(error, error_type)), repr(error))
    assert isinstance(expected, dict) and kind == expected.get("error"), (call, error)
    for part in expected.get("text", []):
        assert part in str(error), call
    if "payload" in expected:
        assert isinstance(error, rect.ServiceError)
        assert error.value == expected["payload"], call


class Program:
    """The program of one robot: performs the calls of a scenario, and keeps the objects that they create."""

    def __init__(self, robot: rect.Robot) -> None:
        self._robot = robot
        self._kept: dict[tuple[str, str], Any] = {}

    def wait_for_peer(self, robot: str, timeout_ms: float | None = None) -> None:
        self._robot.wait_for_peer(robot, _seconds(timeout_ms))

    def wait_until_established(self) -> None:
        self._robot.wait_until_established(DEADLINE)

    def peers(self) -> list[str]:
        return self._robot.peers()

    def publish(self, topic: str, value: Any, dictionary: str | None = None) -> None:
        codec = None if dictionary is None else self._kept["dictionary", dictionary]
        self._robot.publish(topic, value, codec=codec)

    def send(self, robot: str, topic: str, value: Any) -> None:
        self._robot.send(robot, topic, value)

    def subscribe(self, pattern: str) -> None:
        self._kept["subscriber", pattern] = self._robot.subscribe(pattern)

    def next(self, pattern: str, timeout_ms: float | None = None) -> list[Any]:
        message = self._kept["subscriber", pattern].next(_seconds(timeout_ms))
        return [message.sender, message.topic, message.value]

    def publisher(self, topic: str) -> None:
        self._kept["publisher", topic] = self._robot.publisher(topic)

    def wait_for_subscriber(self, topic: str, timeout_ms: float | None = None) -> None:
        self._kept["publisher", topic].wait_for_subscriber(_seconds(timeout_ms))

    def serve(self, topic: str, answer: str) -> None:
        self._robot.serve(topic, _ANSWERS[answer])

    def request(self, robot: str, topic: str, value: Any) -> list[Any]:
        reply = self._robot.request(robot, topic, value, timeout=DEADLINE)
        return [reply.sender, reply.value]

    def query_registry(self, question: str, filter: str) -> Any:
        return self._robot.query_registry(question, filter=filter)

    def connections(self, filter: str) -> list[str]:
        return [connection.method for connection in self._robot.connections(filter=filter)]

    def share_dictionary(self, name: str) -> None:
        dictionary = rect.Dictionary(bytes.fromhex(_DOCUMENT["dictionaries"][name]))
        self._kept["dictionary", name] = self._robot.share_dictionary(dictionary)

    def stream(self, topic: str, options: dict[str, Any]) -> None:
        self._robot.stream(topic, **options).close()

    def receive_transfers(self, pattern: str, max_bytes: int) -> None:
        self._kept["transfers", pattern] = self._robot.receive_transfers(pattern, max_bytes=max_bytes)

    def next_transfer(self, pattern: str) -> list[Any]:
        received = self._kept["transfers", pattern].next(DEADLINE)
        return [received.sender, received.topic, received.value]

    def transfer(self, robot: str, topic: str, value: Any) -> None:
        self._robot.transfer(robot, topic, value, timeout=DEADLINE)

    def connect(self, endpoint: str) -> None:
        rect.connect(self._robot.name, endpoints=[endpoint]).close()

    def close(self) -> None:
        self._robot.close()


def _refuse(_: rect.Request) -> None:
    raise rect.Refusal("there are the cells 1 and 2")


#: The services of the scenarios.
_ANSWERS: dict[str, Any] = {
    "echo": lambda request: request.value,
    "double": lambda request: request.value * 2,
    "refuse": _refuse,
}


def _seconds(timeout_ms: float | None) -> float:
    return DEADLINE if timeout_ms is None else timeout_ms / 1000
