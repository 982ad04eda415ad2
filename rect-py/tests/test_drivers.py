"""Runs the scenarios of the core's drivers, which Rust runs, too (`cargo test -p rect-core`), in the native module.

pytest rect-py/tests/test_drivers.py
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rect import _rect

_FOLDER = Path(__file__).parents[2] / "tests" / "conformance" / "drivers"
#: Calls of the driver itself. Others are calls of the object that owns it.
_DRIVER_CALLS = frozenset(name for name in dir(_rect.Driver) if not name.startswith("_"))
#: The length from which bytes that are all zero are described by it.
_LONG = 1000


def scenarios() -> list[Any]:
    """Returns all scenarios, as parameters of a test."""
    files = sorted(_FOLDER.glob("*.json"))
    assert len(files) >= 10
    return [
        pytest.param(scenario, id=f"{file.stem}: {scenario['about']}")
        for file in files
        for scenario in json.loads(file.read_text())["scenarios"]
    ]


@pytest.mark.parametrize("scenario", scenarios())
def test_driver_acts_as_the_scenario_states(scenario: dict[str, Any]) -> None:
    subject = Subject(scenario["driver"])
    for step in scenario["steps"]:
        name, *arguments = step["do"]
        assert subject.call(name, *map(_argument, arguments)) == step["expect"], step["do"]


class Subject:
    """The driver of a scenario, and the object that owns it."""

    def __init__(self, driver: dict[str, Any]) -> None:
        self._place = _rect.KeySpace("rect", "wombat-1")
        make: Callable[[dict[str, Any]], Any] = getattr(self, "_" + driver["kind"])
        made = make(driver)
        self._owner: Any = None if isinstance(made, _rect.Driver) else made
        self._driver: _rect.Driver = made if isinstance(made, _rect.Driver) else made.driver()
        self._now = 0.0
        self._driver.set_time(0)

    def call(self, name: str, *arguments: Any) -> Any:
        if name == "poll_all":
            steps: list[Any] = []
            while not steps or steps[-1][0] not in ("wait", "finished"):
                step = self._driver.poll()
                if isinstance(self._owner, Program) and step[0] == "deliver":
                    step = ("deliver", self._owner.received(step[1]))
                steps.append(_described(step))
            return steps
        if name == "send":
            payload, encoding = arguments
            jobs = self._owner.offer(len(payload))
            return [_described(self._owner.frame(job, payload, encoding)) for job in jobs]
        target = self._driver if name in _DRIVER_CALLS else self._owner
        return _described(getattr(target, name)(*arguments))

    def _peers_query(self, _: dict[str, Any]) -> _rect.Driver:
        return _rect.peers_query(self._place)

    def _recipients(self, _: dict[str, Any]) -> _rect.Recipients:
        return _rect.Recipients(self._place)

    def _peer_wait(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.peer_wait(self._place, of["robot"], of["timeout_s"])

    def _established_wait(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.established_wait(self._place, of["timeout_s"])

    def _direct_presence(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.direct_presence(self._place, of["id"], of["unix_ms"])

    def _registry_query(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.registry_query(self._place, of["robot"], of["question"], of["filter"])

    def _registry_change(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.registry_change(self._place, of["robot"], of["action"], of["argument"])

    def _observer(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.observer(self._place, 0, of["is_direct"])

    def _router_observer(self, _: dict[str, Any]) -> _rect.Driver:
        return _rect.router_observer(self._place)

    def _dictionary_fetch(self, of: dict[str, Any]) -> _rect.Driver:
        driver = _rect.Decoder(self._place).fetch(of["sender"], of["id"])
        assert driver is not None
        return driver

    def _stream_watch(self, of: dict[str, Any]) -> _rect.StreamWatch:
        return _rect.StreamWatch(self._place, f"{of['robot']}/{of['topic']}", of["id"])

    def _stream_publish(self, of: dict[str, Any]) -> _rect.StreamPublish:
        publish = (self._place, of["topic"], "normal", of["mode"], of["source"])
        return _rect.StreamPublish(*publish, unix_ms=of["unix_ms"])

    def _state_keeper(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.state_keeper(self._place, of["run"])

    def _program_state(self, of: dict[str, Any]) -> Program:
        return Program(self._place, of["run"])

    def _retain(self, of: dict[str, Any]) -> _rect.Driver:
        state = _rect.ProgramState(self._place, of["run"])
        value = (_argument(of["bytes"]), of["encoding"], "normal", False, of["unix_ms"])
        return state.set(of["topic"], *value).driver(self._place)

    def _latest(self, of: dict[str, Any]) -> _rect.Driver:
        return _rect.latest(self._place, of["robot"], of["topic"], of["timeout_s"])

    def _transfer_push(self, of: dict[str, Any]) -> _rect.TransferPush:
        return _push(self._place, of["recipient"], of)

    def _transfer_pull(self, of: dict[str, Any]) -> _rect.TransferPull:
        # An offer is accepted after the robot that it names has confirmed it.
        sender = _push(_rect.KeySpace("rect", of["sender"]), "wombat-1", of).driver()
        steps = iter(sender.poll, None)
        offer = next(step for step in steps if step[0] == "get")[3][0]
        reception = _rect.TransferReception(self._place, "*/**", 1000, 1, None).driver()
        reception.on_query(0, 1, offer, "zenoh/bytes")
        question = next(step for step in iter(reception.poll, None) if step[0] == "get")[1]
        reception.on_reply(question, "k", offer, "zenoh/bytes")
        delivered = next(step for step in iter(reception.poll, None) if step[0] == "deliver")
        return _rect.TransferPull(self._place, delivered[1][1], None, of["timeout_s"])

    def _transfer_reception(self, of: dict[str, Any]) -> _rect.TransferReception:
        return _rect.TransferReception(self._place, of["pattern"], of["max_bytes"], 2, None)


class Program:
    """A program with subscriptions, which receive what its driver delivers."""

    def __init__(self, place: _rect.KeySpace, run: int) -> None:
        self._place = place
        self._state = _rect.ProgramState(place, run)
        self._queue = _rect.Queue(100, "drop_oldest")

    def driver(self) -> _rect.Driver:
        return self._state.driver()

    def subscribe(self, pattern: str) -> int:
        inbound = _rect.Inbound(self._place, pattern)
        return self._state.subscribe(_rect.OnMessage(self._queue, inbound, _rect.AtomicCounters(), None, 0))

    def publish(self, topic: str, bytes: bytes, encoding: str, unix_ms: int, kept: bytes) -> None:
        """Publishes a value, which the router keeps with this answer."""
        order = self._state.set(topic, bytes, encoding, "normal", False, unix_ms)
        retain = order.driver(self._place)
        question = retain.poll()[1]
        retain.on_reply(question, "k", kept, "application/cbor")
        self._state.on_kept(order, retain.poll()[1][1])

    def received(self, arrival: _rect.StateArrival) -> list[Any]:
        """Delivers something from the router. Returns the messages of the subscriptions."""
        self._state.deliver(arrival)
        messages = []
        while len(self._queue) > 0:
            item = self._queue.pop()
            assert item is not None
            metadata, bytes, encoding, _method = item
            messages.append(_message(metadata, (bytes, encoding)))
        return messages


def _message(metadata: _rect.MessageMetadata, value: Any) -> list[Any]:
    return [metadata.sender, metadata.topic, value, metadata.retained]


def _push(place: _rect.KeySpace, recipient: str, of: dict[str, Any]) -> _rect.TransferPush:
    content = _argument(of["bytes"])
    return _rect.TransferPush(
        place, recipient, of["topic"], content, of["call"], name=of["name"], timeout_s=of.get("timeout_s")
    )


def _argument(value: Any) -> Any:
    """Returns an argument of a call. Bytes are described as `text`, `hex`, the length of `zeros`, or `cbor`."""
    if isinstance(value, list):
        return [_argument(part) for part in value]
    if not isinstance(value, dict):
        return value
    if len(value) == 1:
        form, content = next(iter(value.items()))
        if form == "text":
            return content.encode()
        if form == "hex":
            return bytes.fromhex(content)
        if form == "zeros":
            return bytes(content)
        if form == "cbor":
            return _rect.write_value(_argument(content), True)[0]
    return {name: _argument(part) for name, part in value.items()}


def _described(value: Any) -> Any:
    """Returns what a call returns in the form of the scenarios."""
    if isinstance(value, (tuple, list)):
        encodings = [*value[1:], None]
        return [
            {"cbor": _described(_rect.read_value(part, encoding))}
            if isinstance(part, bytes) and encoding == "application/cbor"
            else _described(part)
            for part, encoding in zip(value, encodings)
        ]
    if isinstance(value, dict):
        return {name: _described(part) for name, part in value.items()}
    if isinstance(value, bytes):
        if len(value) > _LONG and not any(value):
            return {"zeros": len(value)}
        text = value.decode(errors="replace")
        return {"text": text} if text.isprintable() and "\ufffd" not in text else {"hex": value.hex()}
    if isinstance(value, _rect.RetainedValue):
        return _described(_message(*value.message()))
    if isinstance(value, _rect.KeptValue):
        return value.warning
    return value if value is None or isinstance(value, (bool, int, float, str)) else repr(value)
