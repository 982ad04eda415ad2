"""Tests that each goal of an action begins at most once and has one true end, while the programs of both sides are
killed, the link is cut, and routers are killed.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest -s rect-py/tests/test_actions_killed.py

RECT_KILLED_RUNS=50 makes more runs than one of each fault.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack

import pytest
import rect
from conftest import until
from programs import Routers, linked_routers

SEED = 61
RUNS = int(os.environ.get("RECT_KILLED_RUNS", "10"))
#: How long a client waits for an end at most, in seconds. An end that is lost is known within about 7 s.
WITHIN = 60.0
#: The fault while a goal runs, at a random moment of its first half second.
FAULTS = [
    "none",
    "kill the server",
    "cancel",
    "kill the client",
    "cut",
    "kill the server",
    "kill the router of the server",
    "preempt",
    "kill the router of the client",
    "kill the server and its router",
]

#: Carries out goals, and prints which have begun and ended.
_SERVER = """
import sys, rect
with rect.connect("wombat-1", router=sys.argv[1], program="digger") as robot:
    @robot.action("dig", lost_after=1)
    def dig(goal):
        print("began", goal.id, flush=True)
        for step in range(8):
            goal.feedback(step, progress=step / 8)
            goal.sleep(0.1)
        print("returned", goal.id, flush=True)
        return goal.value
    print("ready", "", flush=True)
    sys.stdin.read()
"""

#: Starts a goal, and waits for its end.
_CLIENT = """
import sys, rect
with rect.connect("wombat-2", router=sys.argv[1], program="foreman") as robot:
    run = robot.start("wombat-1", "dig", 7, id=sys.argv[2])
    print("accepted", flush=True)
    run.result()
"""


class Server:
    """The program that carries out goals."""

    def __init__(self, router: str, began: Counter[str], returned: set[str]) -> None:
        arguments = [sys.executable, "-c", _SERVER, router]
        self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._began, self._returned = began, returned
        self._is_ready = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        assert self._is_ready.wait(WITHIN)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            # The kill may cut the last line.
            word, _, goal = line.rstrip("\n").partition(" ")
            if word == "began":
                self._began[goal] += 1
            elif word == "returned":
                self._returned.add(goal)
            elif word == "ready":
                self._is_ready.set()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()


def end_of(run: rect.ActionRun) -> str:
    """Waits for the end of a goal, and returns its phase."""
    try:
        assert run.result(timeout=WITHIN) == 7
    except rect.ActionError as error:
        return str(error.phase)
    return "done"


def test_each_goal_has_one_true_end(tmp_path_factory: pytest.TempPathFactory) -> None:
    chance = random.Random(SEED)
    began: Counter[str] = Counter()
    returned: set[str] = set()
    ends: Counter[str] = Counter()
    with ExitStack() as stack:
        routers = stack.enter_context(linked_routers(tmp_path_factory.mktemp("killed")))
        two = stack.enter_context(routers.connect("wombat-2", program="base"))
        two.wait_for_peer("wombat-1", WITHIN)
        server = Server(routers.endpoints["wombat-1"], began, returned)
        try:
            for number in range(RUNS):
                fault, goal = FAULTS[number % len(FAULTS)], f"goal-{number}"
                moment = chance.random() / 2
                if fault == "kill the client":
                    run = start_and_kill(routers, two, goal, moment)
                else:
                    run = start(two, goal)
                    time.sleep(moment)
                killed = fault.startswith("kill the server")
                if killed:
                    server.kill()
                if fault == "kill the server and its router" or fault == "kill the router of the server":
                    routers.restart("wombat-1")
                elif fault == "kill the router of the client":
                    routers.restart("wombat-2")
                elif fault == "cancel":
                    run.cancel()
                elif fault == "preempt":
                    start(two, f"newer-{number}")
                elif fault == "cut":
                    with routers.without_link():
                        pass
                end = end_of(run)
                ends[end] += 1
                check(fault, goal, end, began, returned)
                if killed:
                    server = Server(routers.endpoints["wombat-1"], began, returned)
                if fault != "kill the server and its router":
                    # Others learn of the same end, and a start of the same goal does not run it again.
                    assert end_of(two.find("wombat-1", "dig", goal)) == end, fault
                    assert end_of(start(two, goal)) == end, fault
        finally:
            server.kill()
    assert max(began.values()) == 1
    print(f"\n{RUNS} runs: {dict(ends)}")


def start(robot: rect.Robot, goal: str) -> rect.ActionRun:
    """Starts a goal, again and again with the same id until the robot has answered."""
    runs: list[rect.ActionRun] = []
    errors: list[rect.RectError] = []

    def is_started() -> bool:
        try:
            runs.append(robot.start("wombat-1", "dig", 7, id=goal))
        except (rect.NoAction, rect.Interrupted, rect.TimedOut) as error:
            errors.append(error)
            return False
        return True

    until(is_started, lambda: (goal, errors))
    return runs[0]


def start_and_kill(routers: Routers, other: rect.Robot, goal: str, moment: float) -> rect.ActionRun:
    """Starts a goal in a program that is then killed, and returns the goal as another program finds it."""
    arguments = [sys.executable, "-c", _CLIENT, routers.endpoints["wombat-2"], goal]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        assert client.stdout.readline() == "accepted\n"
        run = other.find("wombat-1", "dig", goal)
        time.sleep(moment)
        client.kill()
    return run


def check(fault: str, goal: str, end: str, began: Counter[str], returned: set[str]) -> None:
    """Checks that an end is the true one."""
    possible = {"none": ["done"], "preempt": ["preempted", "done"], "cancel": ["cancelled", "done"]}
    if fault == "kill the client" or fault == "cut" or "router" in fault:
        possible[fault] = ["done", "cancelled"]
    if fault.startswith("kill the server"):
        possible[fault] = ["done", "lost"]
    assert end in possible[fault], (fault, goal, end)
    assert (end == "done") <= (goal in returned), (fault, goal, end)
    assert began[goal] <= 1, (fault, goal)
