"""Tests that all programs have the last values at rest, each once and none older after a newer one, while the program
that publishes them is killed again and again, the link is cut, and routers are killed.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest -s rect-py/tests/test_state_killed.py
"""

from __future__ import annotations

import random
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
import rect
from conftest import until
from programs import Routers, linked_routers

SEED = 58
RUNS = 50
TOPICS = 20
#: The time from the first change of a run until its fault, at most, in seconds.
LATEST_FAULT = 0.3
#: The faults of the runs that have one besides the kill of the program.
FAULTS = {
    8: "cut",
    16: "router of the publisher",
    24: "router of the subscriber",
    32: "cut",
    40: "both",
    48: "router of the publisher",
}

#: Changes topics at random until it is killed. Prints the number of each change before and after it.
_PUBLISHER = """
import random, sys, rect
router, number, seed, topics = sys.argv[1], *map(int, sys.argv[2:])
chance = random.Random(seed)
with rect.connect("wombat-1", router=router, program="publisher") as robot:
    while True:
        number += 1
        topic = f"state/{chance.randrange(topics)}"
        print(number, topic, "begins", flush=True)
        try:
            robot.publish(topic, number, retained=True)
            print(number, topic, "kept", flush=True)
        except rect.NotRetained as error:
            print(number, topic, error, flush=True)
        if sys.stdin in __import__("select").select([sys.stdin], [], [], chance.random() / 100)[0]:
            sys.stdin.readline()
            print(0, "", "done", flush=True)
            sys.stdin.readline()
            break
"""


class Seen:
    """The values that one subscription has received, which it checks."""

    def __init__(self, robot: rect.Robot) -> None:
        self.last: dict[str, int] = {}
        self.highest: Counter[str] = Counter()
        self.wrong: list[str] = []
        self.count = 0
        self._lock = threading.Lock()
        self._subscription = robot.subscribe("wombat-1/state/*", int, callback=self._on_message, when_full="block")

    def _on_message(self, message: rect.Message[int]) -> None:
        topic, value = message.topic, message.value
        with self._lock:
            self.count += 1
            if value is None:
                if self.last.pop(topic, None) is None:
                    self.wrong.append(f"{topic} is forgotten twice")
                return
            if value <= self.highest[topic]:
                self.wrong.append(f"{topic}: {value} after {self.highest[topic]}")
            self.highest[topic] = value
            self.last[topic] = value

    def close(self) -> None:
        self._subscription.close()


class Publisher:
    """The program that publishes."""

    def __init__(self, router: str, number: int, seed: int) -> None:
        arguments = [sys.executable, "-c", _PUBLISHER, router, str(number), str(seed), str(TOPICS)]
        self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.number = number
        self.kept: dict[str, int] = {}
        self.begun: dict[str, int] = {}
        self.is_idle = threading.Event()
        self.has_begun = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            # The kill may cut the last line.
            if not line.endswith("\n"):
                continue
            number, topic, outcome = line.rstrip("\n").split(" ", 2)
            if outcome == "done":
                self.is_idle.set()
                continue
            self.number = max(self.number, int(number))
            self.has_begun.set()
            self.begun[topic] = int(number)
            if outcome == "kept":
                self.kept[topic] = int(number)

    def pause(self) -> None:
        """Lets it end the change in progress, and waits for that."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        assert self.is_idle.wait(30)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        assert self._process.stdin is not None
        self._process.stdin.close()


@contextmanager
def fault(routers: Routers, kind: str | None) -> Iterator[None]:
    """Causes a fault, and ends it afterwards."""
    if kind == "cut":
        with routers.without_link():
            yield
        return
    if kind in ("router of the publisher", "both"):
        routers.restart("wombat-1")
    if kind in ("router of the subscriber", "both"):
        routers.restart("wombat-2")
    yield


def test_all_programs_have_the_last_values(tmp_path_factory: pytest.TempPathFactory) -> None:
    chance = random.Random(SEED)
    with ExitStack() as stack:
        routers = stack.enter_context(linked_routers(tmp_path_factory.mktemp("killed")))
        one = stack.enter_context(routers.connect("wombat-1"))
        two = stack.enter_context(routers.connect("wombat-2"))
        seen = {"wombat-1": Seen(one), "wombat-2": Seen(two)}
        number = 0
        for run in range(RUNS):
            publisher = Publisher(routers.endpoints["wombat-1"], number, chance.randrange(1 << 30))
            try:
                assert publisher.has_begun.wait(30)
                time.sleep(chance.random() * LATEST_FAULT)
                with fault(routers, FAULTS.get(run)):
                    if run % 2 == 0:
                        publisher.kill()
                if run % 2 == 1:
                    publisher.pause()
                check(run, one, two, seen, publisher)
            finally:
                publisher.kill()
            number = publisher.number
        changes = {robot: one.count for robot, one in seen.items()}
        print(f"\n{RUNS} runs, {number} changes, messages received: {changes}")
        for one_seen in seen.values():
            one_seen.close()


def check(run: int, one: rect.Robot, two: rect.Robot, seen: dict[str, Seen], publisher: Publisher) -> None:
    """Waits until all have the values that the router of the publisher has."""

    def kept() -> dict[str, int]:
        with one.subscribe("wombat-1/state/*", int) as late:
            found: dict[str, int] = {}
            while True:
                try:
                    message: rect.Message[Any] = late.next(0.2)
                except rect.TimedOut:
                    return found
                found[message.topic] = message.value

    expected: dict[str, int] = {}

    def is_same() -> bool:
        nonlocal expected
        expected = kept()
        return all(one_seen.last == expected for one_seen in seen.values())

    until(is_same, lambda: (run, expected, {robot: one_seen.last for robot, one_seen in seen.items()}))
    assert [one_seen.wrong for one_seen in seen.values()] == [[], []], run
    for topic, value in publisher.kept.items():
        # The one that had begun when the program was killed may be kept, or not.
        assert expected.get(topic) in (value, publisher.begun[topic]) or FAULTS.get(run) is not None, (run, topic)
