"""Tests actions: goals that take a while, with feedback, cancel and one true end, between the programs of robots whose
routers are linked on the simulated air.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_actions.py
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
import rect
import rect.aio
from conftest import DEADLINE, Pair, until
from programs import Routers

#: Carries out goals that last until they are cancelled, and prints which begin.
_SERVER = """
import sys, threading, rect
with rect.connect("wombat-2", router=sys.argv[1], program="digger") as robot:
    @robot.action(sys.argv[2])
    def dig(goal):
        print(goal.id, flush=True)
        goal.feedback(progress=0.5)
        goal.sleep(600)
    print("ready", flush=True)
    threading.Event().wait()
"""

#: Starts a goal, and follows it.
_CLIENT = """
import sys, rect
with rect.connect("wombat-1", router=sys.argv[1], program="scout") as robot:
    run = robot.start("wombat-2", sys.argv[2], id="of-scout")
    print(run.phase, flush=True)
    run.result()
"""


class Handler:
    """A handler that reports the goals that begin, and returns when the test says so."""

    def __init__(self) -> None:
        self.begun: list[rect.Goal[Any]] = []
        self.returns = threading.Event()

    def wait(self, goal: rect.Goal[Any]) -> str:
        """Does not notice that it should end."""
        self.begun.append(goal)
        assert self.returns.wait(DEADLINE)
        return "dug"

    def sleep(self, goal: rect.Goal[Any]) -> str:
        """Ends as soon as it should, or the test says so."""
        self.begun.append(goal)
        while not self.returns.is_set():
            goal.sleep(0.01)
        return "dug"


class Robots:
    """A program of `wombat-1`, which starts goals, and one of `wombat-2`, which carries them out."""

    def __init__(self, routers: Routers) -> None:
        self.routers = routers
        self.client = routers.connect("wombat-1", program="base")
        self.server = routers.connect("wombat-2", program="digger")

    def start(self, action: str, goal: Any = None, **options: Any) -> rect.ActionRun[Any]:
        return start(self.client, action, goal, **options)


def start(robot: rect.Robot, action: str, goal: Any = None, **options: Any) -> rect.ActionRun[Any]:
    """Starts a goal as soon as the robot has learned of the action."""
    deadline = time.monotonic() + DEADLINE
    while True:
        try:
            return robot.start("wombat-2", action, goal, **options)
        except rect.NoAction:
            assert time.monotonic() < deadline


def end_of(run: rect.ActionRun[Any]) -> tuple[str, str]:
    """Returns how a goal ends that is not done, and why."""
    with pytest.raises(rect.ActionError) as ended:
        run.result(DEADLINE)
    assert run.has_ended
    assert (run.phase, run.reason) == (ended.value.phase, ended.value.reason)
    return ended.value.phase, ended.value.reason


def until_phase(run: rect.ActionRun[Any], phase: str) -> None:
    until(lambda: run.phase == phase, lambda: (run.phase, run.reason))


@contextmanager
def process(code: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Runs a program, which is killed at the end."""
    with subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True) as program:
        try:
            yield program
        finally:
            program.kill()


def line(program: subprocess.Popen[str]) -> str:
    """Returns the next line that a program prints."""
    assert program.stdout is not None
    return program.stdout.readline().strip()


@pytest.fixture
def robots(routers: Routers) -> Iterator[Robots]:
    robots = Robots(routers)
    with robots.client, robots.server:
        yield robots


def test_done_with_feedback_and_result(robots: Robots) -> None:
    seen = threading.Event()
    feedback: list[rect.Feedback] = []

    @robots.server.action("dig")
    def dig(goal: rect.Goal[Any]) -> dict[str, Any]:
        # The link may lose feedback.
        while not seen.is_set():
            goal.feedback({"scoop": 1}, progress=0.5)
            goal.sleep(0.1)
        return {"by": goal.by, "value": goal.value}

    run = robots.start("dig", {"depth": 3})

    def on_feedback(one: rect.Feedback) -> None:
        feedback.append(one)
        seen.set()

    run.on_feedback(on_feedback)
    assert run.result(DEADLINE) == {"by": "wombat-1/base", "value": {"depth": 3}}
    assert (run.phase, run.reason, run.progress, run.has_ended) == ("done", "", 0.5, True)
    assert feedback[-1] == rect.Feedback({"scoop": 1}, 0.5) == run.feedback
    assert run.unreachable_for is None
    # The result can be asked for again, and there is nothing to cancel.
    assert run.result(0)["by"] == "wombat-1/base"
    run.cancel()
    # The newest feedback comes first, also afterwards.
    assert list(run) == feedback[-1:]


def test_feedback_that_a_busy_link_blocks_delays_nothing(robots: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked, continues = threading.Event(), threading.Event()

    def publish(*_: Any) -> None:
        blocked.set()
        assert continues.wait(DEADLINE)

    monkeypatch.setattr(robots.server._session, "publish", publish)

    @robots.server.action("chatty")
    def chatty(goal: rect.Goal[Any]) -> str:
        while not blocked.is_set():
            goal.feedback("x" * 40_000)
            goal.sleep(0.01)
        return "dug"

    assert robots.start("chatty").result(DEADLINE) == "dug"
    continues.set()


def test_newer_goal_is_refused_by_an_action_that_is_busy(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("refusing", handler.wait, when_busy="refuse")
    first = robots.start("refusing")
    second = robots.start("refusing")
    assert end_of(second) == ("refused", "busy with a goal of wombat-1/base: cancel it, or wait for its end")
    handler.returns.set()
    assert first.result(DEADLINE) == "dug"
    assert len(handler.begun) == 1


def test_newer_goal_preempts_the_older_one(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("preempting", handler.sleep)
    first = robots.start("preempting")
    second = robots.start("preempting")
    assert end_of(first) == ("preempted", "by a newer goal of wombat-1/base")
    handler.returns.set()
    assert second.result(DEADLINE) == "dug"


def test_exception_of_the_handler_is_the_reason_of_a_failure(robots: Robots, caplog: pytest.LogCaptureFixture) -> None:
    errors: list[BaseException] = [ValueError("no shovel"), rect.Refusal("it rains"), SystemExit(3), KeyError()]

    @robots.server.action("failing")
    def failing(_: rect.Goal[Any]) -> None:
        raise errors[0]

    with caplog.at_level(logging.ERROR, "rect"):
        reasons = []
        for _ in list(errors):
            reasons.append(end_of(robots.start("failing")))
            errors.pop(0)
    expected = ["no shovel", "it rains", "the handler called sys.exit(3)", "KeyError"]
    assert reasons == [("failed", reason) for reason in expected]
    assert caplog.text.count("the handler of the action failing raised an exception") == 3


def test_feedback_is_sent_as_often_as_the_client_asks(robots: Robots) -> None:
    received = threading.Event()

    @robots.server.action("rare")
    def rare(goal: rect.Goal[Any]) -> None:
        goal.feedback(progress=0.1)
        assert received.wait(DEADLINE)
        goal.feedback(progress=0.2)
        # Long enough for the default rate, and short beside the pause of 10 s that the client asks for.
        goal.sleep(1)

    run = robots.start("rare", feedback_per_s=0.1)
    until(lambda: run.progress == 0.1)
    received.set()
    assert run.result(DEADLINE) is None
    assert run.progress == 0.1


def test_cancel_ends_a_handler_that_notices_it(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("noticing", handler.sleep)
    run = robots.start("noticing")
    until(lambda: handler.begun)  # type: ignore[arg-type, return-value]
    run.cancel()
    assert end_of(run) == ("cancelled", "by wombat-1/base")
    assert (handler.begun[0].cancelled, handler.begun[0].cancel_reason) == (True, "by wombat-1/base")


def test_handler_that_does_not_notice_the_cancel_is_done(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("ignoring", handler.wait)
    run = robots.start("ignoring")
    run.cancel()
    until_phase(run, "cancelling")
    with pytest.raises(rect.TimedOut, match=r"no end of ignoring of wombat-2 \(cancelling for .*\) within 10 ms"):
        run.result(0.01)
    assert run.phase_for < DEADLINE
    handler.returns.set()
    assert run.result(DEADLINE) == "dug"


def test_result_of_a_handler_that_returns_because_of_the_cancel(robots: Robots) -> None:
    @robots.server.action("returning")
    def returning(goal: rect.Goal[Any]) -> str:
        until(lambda: goal.cancelled)
        return "half a hole"

    run = robots.start("returning")
    run.cancel()
    with pytest.raises(rect.ActionError) as ended:
        run.result(DEADLINE)
    assert (ended.value.phase, ended.value.result) == ("cancelled", "half a hole")


def test_goal_is_lost_when_its_program_is_killed_and_never_runs_again(robots: Robots) -> None:
    arguments = (robots.routers.endpoints["wombat-2"], "dying")
    with process(_SERVER, *arguments) as server:
        assert line(server) == "ready"
        run = robots.start("dying", id="g1")
        assert line(server) == "g1"
        until(lambda: run.progress == 0.5)
        server.kill()
        assert end_of(run) == ("lost", "the program that carried it out has ended")
    known = [goal for goal in robots.client.goals("wombat-2") if goal.action == "dying"]
    assert [(goal.id, goal.phase) for goal in known] == [("g1", "lost")]
    # The next run of the program says the same, and does not carry it out.
    with process(_SERVER, *arguments) as server:
        assert line(server) == "ready"
        assert end_of(robots.client.find("wombat-2", "dying", "g1"))[0] == "lost"
        assert end_of(robots.start("dying", id="g1"))[0] == "lost"
        other = robots.start("dying", id="g2")
        assert line(server) == "g2"
        other.cancel()
        assert end_of(other)[0] == "cancelled"


def test_goal_is_cancelled_when_its_client_is_killed(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("orphaned", handler.sleep, lost_after=0.3)
    with process(_CLIENT, robots.routers.endpoints["wombat-1"], "orphaned") as client:
        until(lambda: handler.begun or client.poll() is not None)  # type: ignore[arg-type, return-value]
        assert client.poll() is None
        assert line(client) in ("waiting", "running")
        # Another program finds the goal.
        run = robots.client.find("wombat-2", "orphaned", "of-scout")
        client.kill()
        phase, reason = end_of(run)
    assert phase == "cancelled"
    assert "wombat-1/scout" in reason


def test_goal_is_carried_out_without_its_client_if_the_action_allows_that(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("faithful", handler.sleep, lost_after=None)
    with robots.routers.connect("wombat-1", program="scout") as scout, robots.server.events() as events:
        start(scout, "faithful", id="g1")
        scout.close()
        while (event := events.next(DEADLINE)).kind != "program_down" or event.program != "scout":
            pass
    run = robots.client.find("wombat-2", "faithful", "g1")
    assert run.phase == "running"
    handler.returns.set()
    assert run.result(DEADLINE) == "dug"


def test_cut_is_not_an_end(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("distant", handler.sleep, lost_after=None)
    run = robots.start("distant")
    until_phase(run, "running")
    with robots.routers.without_link():
        until(lambda: run.unreachable_for is not None)
        assert (run.phase, run.is_reachable) == ("running", False)
        with pytest.raises(rect.TimedOut, match="wombat-2 cannot be reached for"):
            run.result(0.01)
        handler.returns.set()
        until(lambda: [goal.phase for goal in robots.server.goals("wombat-2") if goal.id == run.id] == ["done"])
        assert run.phase == "running"
    assert run.result(DEADLINE) == "dug"


def test_goal_goes_on_while_routers_restart(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("steady", handler.sleep, lost_after=None)
    run = robots.start("steady")
    until_phase(run, "running")
    robots.routers.restart("wombat-2")
    handler.returns.set()
    assert run.result(DEADLINE) == "dug"


def test_goal_that_is_started_again_with_its_id_runs_once(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("once", handler.sleep)
    runs = [robots.start("once", id="g1") for _ in range(3)]
    handler.returns.set()
    runs.append(robots.start("once", id="g1"))
    assert [run.result(DEADLINE) for run in runs] == ["dug"] * 4
    assert robots.start("once", id="g1").result(DEADLINE) == "dug"
    assert len(handler.begun) == 1


def test_another_program_finds_a_goal(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("shared", handler.sleep)
    run = robots.start("shared", [1, 2])
    until_phase(run, "running")
    with robots.routers.connect("wombat-1", program="watcher") as watcher:
        [known] = [goal for goal in watcher.goals() if goal.action == "shared"]
        assert (known.robot, known.id, known.by, known.program) == ("wombat-2", run.id, "wombat-1/base", "digger")
        assert (known.phase, known.goal, known.result, known.ended) == ("running", [1, 2], None, None)
        # Its age grows while the state stays the same.
        until(lambda: next(goal.age for goal in watcher.goals() if goal.id == run.id) > known.age + 0.01)
        found = watcher.find("wombat-2", "shared", run.id)
        assert found.phase == "running"
        found.cancel()
        assert end_of(found) == ("cancelled", "by wombat-1/watcher")
        assert end_of(run) == ("cancelled", "by wombat-1/watcher")
        # One that has ended already, too.
        assert end_of(watcher.find("wombat-2", "shared", run.id))[0] == "cancelled"
        with pytest.raises(rect.NoGoal, match="wombat-2 does not know the goal g9 of the action shared"):
            watcher.find("wombat-2", "shared", "g9")
        with pytest.raises(rect.NotReachable, match="wombat-9"):
            watcher.find("wombat-9", "shared", "g9")


def test_stop_of_the_fleet_cancels_goals_and_refuses_new_ones(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("stoppable", handler.sleep)
    run = robots.start("stoppable")
    stop = robots.client.fleet_stop()
    try:
        stop.press("smoke")
        reason = "stopped by wombat-1/base: smoke"
        assert end_of(run) == ("cancelled", reason)
        assert end_of(robots.start("stoppable")) == ("refused", reason)
        # An action that is declared afterwards knows of it, too.
        robots.server.action("late", handler.sleep)
        assert end_of(robots.start("late")) == ("refused", reason)
    finally:
        stop.release()
    handler.returns.set()
    released = robots.server.fleet_stop()
    while released.is_stopped:
        released.wait_for_change(DEADLINE)

    def is_accepted() -> bool:
        again = robots.start("stoppable")
        with contextlib.suppress(rect.ActionError):
            return bool(again.result(DEADLINE) == "dug")
        return False

    until(is_accepted)


def test_unknown_action_is_reported_with_a_hint(robots: Robots) -> None:
    robots.server.action("drive_to", Handler().sleep)
    until(lambda: any("drive_to" in program.actions for program in robots.client.programs("wombat-2")))
    with pytest.raises(rect.NoAction) as unknown:
        robots.client.start("wombat-2", "drive_too")
    assert "did you mean drive_to" in str(unknown.value)
    assert (unknown.value.robot, unknown.value.action) == ("wombat-2", "drive_too")
    assert "drive_to" in unknown.value.available
    with pytest.raises(rect.NoAction, match="is the robot reachable, and its program running"):
        robots.client.start("wombat-9", "drive_to")


def test_value_that_is_too_large_is_refused_with_advice(robots: Robots) -> None:
    with pytest.raises(rect.PayloadError, match="send larger ones as a transfer"):
        robots.start("large", "x" * (50 << 10))


def test_result_of_maximum_size_arrives(robots: Robots) -> None:
    robots.server.action("maximal", lambda goal: goal.value)
    value = b"x" * (48 << 10)
    assert robots.start("maximal", value).result(DEADLINE) == value


@dataclass
class Target:
    x: float
    y: float = 0.0


def test_goal_result_and_feedback_have_types(robots: Robots) -> None:
    @robots.server.action("typed")
    def typed(goal: rect.Goal[Target]) -> Target:
        while not seen.is_set():
            goal.feedback(goal.value, progress=2)
            goal.sleep(0.1)
        return goal.value

    seen = threading.Event()
    run = robots.start("typed", {"x": 1}, returns=Target, feedback=Target)
    for feedback in run:
        assert feedback == rect.Feedback(Target(1.0), 1.0)
        seen.set()
    assert run.result(DEADLINE) == Target(1.0)
    refused = end_of(robots.start("typed", {"x": "far"}))
    assert refused == ("refused", "typed: field x: expected a number, found the text 'far'")
    with pytest.raises(rect.MismatchError):
        robots.start("typed", {"x": 1}, returns=list[float]).result(DEADLINE)


def test_wrong_arguments_are_refused(robots: Robots) -> None:
    server, wrong = robots.server, "must|cannot|has 1 to 40"
    queue: Any = "queue"
    with pytest.raises(rect.OptionError, match=wrong):
        server.action("wrong", Handler().sleep, when_busy=queue)
    with pytest.raises(rect.OptionError, match=wrong):
        server.action("wrong", Handler().sleep, lost_after=-1)
    with pytest.raises(rect.InvalidTopicError, match="cannot be the name of an action"):
        server.action("a/b", Handler().sleep)
    number: Any = 3
    with pytest.raises(TypeError, match="handler must be a function"):
        server.action("wrong", number)
    with pytest.raises(TypeError, match="action must be a str"):
        server.action(number, Handler().sleep)
    with pytest.raises(rect.OptionError, match=wrong):
        robots.client.start("wombat-2", "dig", id="a b")
    with pytest.raises(rect.InvalidTopicError):
        robots.client.start("wombat-2", "a/b")
    server.action("unique", Handler().sleep)
    with pytest.raises(rect.ServiceRefused):
        server.action("unique", Handler().sleep)
    server.close()
    with pytest.raises(rect.Closed):
        server.action("closed", Handler().sleep)


def test_end_of_the_action_or_its_program_cancels_goals(robots: Robots) -> None:
    handler = Handler()
    action = robots.server.action("ending", handler.sleep)
    run = robots.start("ending")
    action.close()
    assert end_of(run) == ("cancelled", "the action has ended")
    # It can be declared again, and knows the goals of before.
    robots.server.action("ending", handler.sleep)
    assert end_of(robots.start("ending", id=run.id))[0] == "cancelled"
    run = robots.start("ending")
    until_phase(run, "running")
    robots.server.close()
    assert end_of(run) == ("cancelled", "the action has ended")


def test_closed_client_ends_the_wait(robots: Robots) -> None:
    handler = Handler()
    robots.server.action("waiting", handler.sleep)
    run = robots.start("waiting")
    closing = threading.Timer(0.1, robots.client.close)
    closing.start()
    with pytest.raises(rect.Closed):
        run.result(DEADLINE)
    closing.join()


def test_asyncio(routers: Routers) -> None:
    async def main() -> None:
        one = rect.aio.connect("wombat-1", router=routers.endpoints["wombat-1"], program="base")
        two = rect.aio.connect("wombat-2", router=routers.endpoints["wombat-2"], program="digger")
        async with one as client, two as server:

            @server.action("async_dig")
            async def dig(goal: rect.aio.Goal[int]) -> str:
                for scoop in range(goal.value):
                    goal.feedback(scoop, progress=scoop / goal.value)
                    await goal.sleep(0.2)
                return "dug"

            async def begin(scoops: int) -> rect.aio.ActionRun[Any]:
                while True:
                    with contextlib.suppress(rect.NoAction):
                        return await client.start("wombat-2", "async_dig", scoops)

            run = await asyncio.wait_for(begin(4), DEADLINE)
            received: list[rect.Feedback] = []
            run.on_feedback(received.append)
            feedback = [one async for one in run]
            assert await run.result(DEADLINE) == "dug"
            # The newest counts, so that some may be missing.
            assert set(feedback) <= {rect.Feedback(scoop, scoop / 4) for scoop in range(4)}
            assert received == feedback
            run = await begin(400)
            with pytest.raises(rect.TimedOut):
                await run.result(0.01)
            await run.cancel()
            with pytest.raises(rect.ActionError) as ended:
                await run.result(DEADLINE)
            assert (ended.value.phase, ended.value.reason) == ("cancelled", "by wombat-1/base")
            found = await client.find("wombat-2", "async_dig", run.id)
            assert found.phase == "cancelled"
            assert run.id in [goal.id for goal in await client.goals("wombat-2")]
            run = await begin(400)
            await server.close()
            with pytest.raises(rect.ActionError, match="the action has ended"):
                await run.result(DEADLINE)

    asyncio.run(main())


def test_without_routers(pair: Pair) -> None:
    client, server = pair
    handler = Handler()
    server.action("direct", handler.sleep)
    run = start(client, "direct", 3)
    until_phase(run, "running")
    assert [goal.goal for goal in client.goals()] == [3]
    assert client.find("wombat-2", "direct", run.id).phase == "running"
    handler.returns.set()
    assert run.result(DEADLINE) == "dug"
    # A program can start its own goals.
    assert start(server, "direct").result(DEADLINE) == "dug"
