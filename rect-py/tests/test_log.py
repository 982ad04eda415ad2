"""Tests logs and alerts, between the programs of two robots whose routers are linked on the simulated air.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_log.py
"""

from __future__ import annotations

import asyncio
import enum
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
import rect
import rect.aio
from conftest import DEADLINE, Pair, repeating, until
from programs import Routers, initialised_routers, linked_routers

#: The lines that a router keeps of one program.
KEPT = 1000
#: How long nothing may arrive after which nothing is expected any more, in seconds.
QUIET = 0.5


@pytest.fixture(scope="module")
def log_routers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Routers]:
    with linked_routers(tmp_path_factory.mktemp("log")) as routers:
        yield routers


@pytest.fixture
def logger(request: pytest.FixtureRequest) -> Iterator[logging.Logger]:
    """A logger of its own, so that pytest's handlers do not matter."""
    logger = logging.getLogger(f"test.{request.node.name}")
    logger.setLevel(1)
    logger.propagate = False
    yield logger
    logger.handlers.clear()


def read(robot: rect.Robot, of: str, program: str, **options: Any) -> list[rect.LogLine]:
    """Returns the lines of a program of a robot."""
    with robot.logs(of, program=program, **options) as logs:
        return list(logs)


def until_read(robot: rect.Robot, of: str, program: str, expected: list[str], **options: Any) -> list[rect.LogLine]:
    """Waits until a program has these lines, and returns them."""
    lines: list[rect.LogLine] = []

    def found() -> bool:
        lines[:] = read(robot, of, program, **options)
        return texts(lines) == expected

    until(found, lambda: texts(lines))
    return lines


def texts(lines: list[rect.LogLine]) -> list[str]:
    return [line.text for line in lines]


def cut(letter: str, length: int, limit: int) -> str:
    """Returns a text of that many letters as it is kept, with room for a note that it was cut."""
    return letter * (limit - 32) + f"… ({length} bytes)"


def run(code: str, endpoint: str, program: str) -> subprocess.CompletedProcess[str]:
    """Runs a program of wombat-1 to its end."""
    connected = f"import rect\nrobot = rect.connect('wombat-1', router={endpoint!r}, program={program!r})\n"
    command = [sys.executable, "-c", connected + code]
    return subprocess.run(command, text=True, capture_output=True, timeout=DEADLINE)


@pytest.mark.parametrize(
    ("name", "ending"),
    [("ends", "robot.close()"), ("exits", ""), ("raises", "raise SystemExit(3)"), ("fails", "1 / 0")],
)
def test_last_lines_are_read_from_the_other_robot_after_the_program_has_ended(
    log_routers: Routers, name: str, ending: str
) -> None:
    for _ in range(3):
        run(f"robot.log('last words', 'error')\n{ending}", log_routers.endpoints["wombat-1"], name)
    before = datetime.now(timezone.utc)
    with log_routers.connect("wombat-2") as two:
        lines = until_read(two, "wombat-1", name, ["last words"] * 3)
    assert {(line.robot, line.program, line.level) for line in lines} == {("wombat-1", name, "error")}
    assert all(0 <= (before - line.at).total_seconds() < DEADLINE for line in lines)
    assert [line.number for line in lines] == sorted({line.number for line in lines})


def test_line_arrives_with_everything_that_belongs_to_it(log_routers: Routers) -> None:
    class Colour(enum.Enum):
        RED = "red"

    class Broken:
        def __str__(self) -> str:
            raise ValueError

    with log_routers.connect("wombat-1", "whole") as one, log_routers.connect("wombat-2") as two:
        fields = {
            "angle": 12.5,
            "count": 3,
            "is_on": True,
            "nothing": None,
            "colour": Colour.RED,
            "list": [1, 2],
            "nan": float("nan"),
            "bytes": b"x",
            "broken": Broken(),
            "surrogate": "\ud800",
            "large": 10**30,
        }
        one.log("the gripper\nis slow", "warn", logger="arm.gripper", fields=fields, source="arm.py:12")
        (line,) = until_read(two, "wombat-1", "whole", ["the gripper\nis slow"])
    assert (line.level, line.logger, line.source) == ("warn", "arm.gripper", "arm.py:12")
    assert line.fields == {
        "angle": 12.5,
        "count": 3,
        "is_on": True,
        "nothing": None,
        "colour": "red",
        "list": "[1,2]",
        "nan": "nan",
        "bytes": "b'x'",
        "broken": "Broken",
        "surrogate": "\ufffd\ufffd\ufffd",
        "large": "1" + "0" * 30,
    }


def test_level_and_program_are_selected(log_routers: Routers) -> None:
    with ExitStack() as stack:
        one, other = (stack.enter_context(log_routers.connect("wombat-1", name)) for name in ("chosen", "other"))
        two = stack.enter_context(log_routers.connect("wombat-2"))
        levels: list[Any] = ["debug", "info", "warn", "error", "WARNING", "critical"]
        for level in levels:
            one.log(level, level)
        other.log("of another program", "error")
        until_read(two, "wombat-1", "other", ["of another program"])
        until_read(two, "wombat-1", "chosen", levels)
        assert texts(read(two, "wombat-1", "chosen", level="warn")) == levels[2:]
        assert texts(read(two, "wombat-1", "chosen", level="error", last=1)) == ["critical"]
        assert read(two, "wombat-1", "chosen", last=0) == []
        assert {line.program for line in two.logs("wombat-1", last=10_000)} >= {"chosen", "other"}


def test_logs_of_all_robots_are_merged_by_time(log_routers: Routers) -> None:
    with ExitStack() as stack:
        connect = log_routers.connect
        one, two = (stack.enter_context(connect(name, "merged")) for name in ("wombat-1", "wombat-2"))
        expected = []
        for number in range(6):
            robot = (one, two)[number % 2]
            expected.append(str(number))
            robot.log(str(number))
            time.sleep(0.05)
        until(lambda: texts(list(two.logs(program="merged"))) == expected)
        with two.logs(program="merged") as logs:
            list(logs)
            assert logs.robots == ["wombat-1", "wombat-2"]
            assert logs.missed == 0


def test_new_lines_follow(log_routers: Routers) -> None:
    with log_routers.connect("wombat-1", "followed") as one, log_routers.connect("wombat-2") as two:
        one.log("before")
        until_read(two, "wombat-1", "followed", ["before"])
        with two.logs("*", program="followed", level="info", follow=True) as logs:
            assert logs.next(DEADLINE).text == "before"
            one.log("skipped", "debug")
            for number in range(5):
                one.log(str(number))
            assert [logs.next(DEADLINE).text for _ in range(5)] == list("01234")
            with pytest.raises(rect.TimedOut, match=r"no line within 500 ms"):
                logs.next(QUIET)
        with pytest.raises(rect.Closed, match="the reader of logs is closed"):
            logs.next(1)


def test_lines_of_a_cut_follow_after_it(log_routers: Routers) -> None:
    with ExitStack() as stack:
        one = stack.enter_context(log_routers.connect("wombat-1", "cut"))
        two = stack.enter_context(log_routers.connect("wombat-2"))
        logs = stack.enter_context(two.logs("wombat-1", program="cut", follow=True))
        one.log("before")
        assert logs.next(DEADLINE).text == "before"
        with log_routers.without_link():
            one.log("during")
            assert read(two, "wombat-1", "cut") == []
        # A line that the link carries shows that others are missing.
        with repeating(0.2, lambda: one.log("after")):
            assert [logs.next(DEADLINE).text for _ in range(2)] == ["during", "after"]


def test_handler_logs_traceback_fields_and_place(log_routers: Routers, logger: logging.Logger) -> None:
    with log_routers.connect("wombat-1", "handler") as one, log_routers.connect("wombat-2") as two:
        logger.addHandler(rect.LogHandler(one))
        logging.getLogger("rect.x").addHandler(rect.LogHandler(one))
        logging.getLogger("rect.x").error("skipped")
        logging.getLogger("rect.x").handlers.clear()
        logger.warning("%s of %d", "one", 2, extra={"angle": 12.5, "place": Path("a")})
        try:
            raise ValueError("slow")
        except ValueError:
            logger.exception("the gripper has failed")
        # A mistake in the program does not lose the line.
        logger.info("%d", "x")
        logger.log(5, "trace")
        lines: list[rect.LogLine] = []

        def arrived() -> bool:
            lines[:] = read(two, "wombat-1", "handler")
            return len(lines) == 4

        until(arrived, lambda: texts(lines))
    first, failed, mistake, trace = lines
    assert (first.text, first.level, first.logger) == ("one of 2", "warn", logger.name)
    assert first.fields == {"angle": 12.5, "place": "a"}
    assert first.source.startswith("test_log.py:")
    assert failed.level == "error"
    assert failed.text.startswith("the gripper has failed\nTraceback (most recent call last):\n")
    assert failed.text.endswith("\nValueError: slow")
    assert mistake.text.startswith("%d (cannot be formatted with ('x',): ")
    assert (trace.text, trace.level) == ("trace", "debug")


def test_flood_never_blocks_and_losses_are_counted(log_routers: Routers) -> None:
    with log_routers.connect("wombat-1", "flood") as one, log_routers.connect("wombat-2") as two:
        longest = 0.0
        began = time.monotonic()
        for number in range(10_000):
            called = time.monotonic()
            one.log(f"{number} {'x' * 200}")
            longest = max(longest, time.monotonic() - called)
        took = time.monotonic() - began
        print(f"\n10,000 lines: {took * 1e6 / 10_000:.0f} us for each, {longest * 1000:.1f} ms at most")
        assert took < 5
        one.log("last")
        lines: list[rect.LogLine] = []

        def arrived() -> bool:
            lines[:] = read(two, "wombat-1", "flood", last=10_000)
            return bool(lines) and lines[-1].text == "last"

        until(arrived, lambda: texts(lines)[-2:])
        assert len(lines) == KEPT
        # Each line that is missing is counted, as far as the router keeps that line.
        numbers: list[int] = []
        lost = 0
        for line in lines[:-1]:
            if line.logger == "rect":
                lost += int(line.text.split(" lines were lost")[0])
            else:
                numbers.append(int(line.text.split()[0]))
        assert numbers == sorted(set(numbers))
        first = numbers[0] - (lost if lines[0].logger == "rect" else 0)
        assert numbers[-1] - first + 1 <= len(numbers) + lost


def test_several_threads_log(log_routers: Routers) -> None:
    with log_routers.connect("wombat-1", "threads") as one, log_routers.connect("wombat-2") as two:

        def log(name: int) -> None:
            for number in range(50):
                one.log(f"{name} {number}")

        threads = [threading.Thread(target=log, args=(name,)) for name in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        until(lambda: len(read(two, "wombat-1", "threads", last=1000)) == 400)
        found = texts(read(two, "wombat-1", "threads", last=1000))
        for name in range(8):
            assert [text for text in found if text.startswith(f"{name} ")] == [f"{name} {n}" for n in range(50)]


def test_text_is_made_safe(log_routers: Routers) -> None:
    given = ["\x1b[31mred\x1b[0m\x00", "\ud800", "x" * 1_000_000, "日本\r\nnext\n", ""]
    expected = ["red\ufffd", "\ufffd\ufffd\ufffd", cut("x", 1_000_000, 8192), "日本\nnext", ""]
    with log_routers.connect("wombat-1", "hostile") as one, log_routers.connect("wombat-2") as two:
        for text in given:
            one.log(text)
        one.log("fields", fields={"\x1b[2J": "\x07", "long": "y" * 5000}, logger="a\nb", source="\x1b]0;x\x07c")
        *_, line = until_read(two, "wombat-1", "hostile", [*expected, "fields"])
        assert (line.logger, line.source) == ("a b", "c")
        assert line.fields == {"": "\ufffd", "long": cut("y", 5000, 1024)}


def test_invalid_arguments_are_errors_with_a_hint(log_routers: Routers) -> None:
    hint = 'the option level cannot be "warm": it must be "debug", "info", "warn" or "error"'
    wrong: Any = "warm"
    with log_routers.connect("wombat-1") as one:
        calls: list[Callable[[], object]] = [
            lambda: one.log("x", wrong),
            lambda: one.logs(level=wrong),
            lambda: one.alert("x", wrong),
        ]
        for call in calls:
            with pytest.raises(rect.OptionError) as raised:
                call()
            assert str(raised.value) == hint
        number: Any = 5
        with pytest.raises(TypeError, match="text must be a str, not int"):
            one.log(number)
        with pytest.raises(rect.InvalidNameError):
            one.logs("wombat 1")
        with pytest.raises(rect.OptionError, match="the option last cannot be -1"):
            one.logs(last=-1)
        with pytest.raises(rect.InvalidTopicError, match="an alert is a text with letters or digits"):
            one.alert("?!")


def test_session_without_a_router_keeps_its_lines(pair: Pair) -> None:
    one, two = pair
    one.log("kept", "warn")
    one.log("private", private=True)
    assert texts(until_read(two, "wombat-1", "unnamed", ["kept"])) == ["kept"]
    assert texts(until_read(one, "wombat-1", "unnamed", ["kept", "private"])) == ["kept", "private"]
    with two.logs("wombat-1", follow=True) as logs:
        assert logs.next(DEADLINE).text == "kept"
        one.log("new")
        assert logs.next(DEADLINE).text == "new"
    one.alert("battery low")
    until(lambda: [alert.text for alert in two.alerts()] == ["battery low"])
    with two.logs("wombat-9") as logs:
        assert list(logs) == []
        assert logs.robots == []


def test_closed_session_ignores_lines(logger: logging.Logger, capfd: pytest.CaptureFixture[str]) -> None:
    robot = rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"])
    logger.addHandler(rect.LogHandler(robot))
    logs = robot.logs(follow=True)
    robot.log("last")
    robot.close()
    robot.log("ignored")
    logger.error("ignored")
    assert "ignored" not in [line.text for line in logs]
    with pytest.raises(rect.Closed, match="the session is closed"):
        logs.next(1)
    calls: list[Callable[[], object]] = [
        robot.logs,
        robot.alerts,
        lambda: robot.alert("x"),
        lambda: robot.clear_alert("x"),
    ]
    for call in calls:
        with pytest.raises(rect.Closed):
            call()
    assert "Logging error" not in capfd.readouterr().err


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_child_process_ignores_lines() -> None:
    code = """
import logging, os, rect
robot = rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"])
logging.getLogger().addHandler(rect.LogHandler(robot))
for _ in range(100):
    robot.log("parent")
child = os.fork()
if child == 0:
    robot.log("child")
    logging.error("child")
    os._exit(7)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=DEADLINE)


def test_lines_that_no_router_gets_delay_the_end_for_a_moment_only(log_routers: Routers) -> None:
    with log_routers.connect("wombat-1", "silent") as one:
        log_routers.robots["wombat-1"].kill()
        try:
            for number in range(1000):
                one.log(f"{number} {'x' * 1000}")
            began = time.monotonic()
            one.close()
            assert time.monotonic() - began < 3
        finally:
            log_routers.robots["wombat-1"].start()


def test_alerts_are_raised_shown_and_cleared(log_routers: Routers) -> None:
    endpoint = log_routers.endpoints["wombat-1"]
    run("robot.alert('Battery low!', 'error')\nrobot.alert('12 %', name='battery level')", endpoint, "alerting")
    with log_routers.connect("wombat-2", "dim") as two, log_routers.connect("wombat-1") as one:
        two.alert("dark", "info")

        def found() -> list[tuple[str, str, str, str, str, bool]]:
            return [
                (alert.robot, alert.name, alert.text, alert.level, alert.program, alert.program_has_ended)
                for alert in two.alerts()
            ]

        expected = [
            ("wombat-1", "battery-low", "Battery low!", "error", "alerting", True),
            ("wombat-1", "battery-level", "12 %", "warn", "alerting", True),
            ("wombat-2", "dark", "dark", "info", "dim", False),
        ]
        until(lambda: found() == expected, found)
        assert [alert.name for alert in two.alerts("wombat-2")] == ["dark"]
        assert two.alerts("wombat-9") == []
        (alert,) = two.alerts("wombat-2")
        assert 0 <= (datetime.now(timezone.utc) - alert.since).total_seconds() < DEADLINE
        one.clear_alert("battery low")
        one.clear_alert("battery-level")
        one.clear_alert("never raised")
        two.clear_alert("dark")
        until(lambda: found() == [], found)


def test_private_lines_stay_on_the_robot(tmp_path: Path) -> None:
    with initialised_routers(tmp_path) as options, ExitStack() as stack:
        one, two = (stack.enter_context(rect.connect(name, program="secret", **options[name])) for name in options)
        two.wait_for_peer("wombat-1", DEADLINE)
        logger = logging.getLogger("test.private")
        logger.propagate = False
        logger.addHandler(rect.LogHandler(one, private=True))
        one.log("open")
        one.log("password", private=True)
        logger.error("path")
        one.log("open again")
        until_read(one, "wombat-1", "secret", ["open", "password", "path", "open again"])
        until_read(two, "wombat-1", "secret", ["open", "open again"])
        with two.logs("wombat-1", follow=True, last=1) as logs:
            assert logs.next(DEADLINE).text == "open again"
            one.log("token", private=True)
            one.log("new")
            assert logs.next(DEADLINE).text == "new"
        # The keys themselves.
        for key in ("rect/*/@rect/@log/@private", "rect/wombat-1/@rect/@log/@private"):
            assert [reply for reply in two.zenoh.get(key) if reply.ok is not None] == []
        one.alert("battery low")
        until(lambda: [alert.text for alert in two.alerts()] == ["battery low"])


def test_aio_has_the_same(log_routers: Routers) -> None:
    async def main() -> None:
        router = log_routers.endpoints
        async with (
            rect.aio.connect("wombat-1", router=router["wombat-1"], program="async") as one,
            rect.aio.connect("wombat-2", router=router["wombat-2"]) as two,
        ):
            one.log("first", "warn", fields={"n": 1})
            logging.getLogger("test.aio").addHandler(rect.LogHandler(one))
            logging.getLogger("test.aio").error("second")
            logging.getLogger("test.aio").handlers.clear()
            async with two.logs("wombat-1", program="async", follow=True) as logs:
                received = []
                async for line in logs:
                    received.append(line.text)
                    if len(received) == 2:
                        break
                assert received == ["first", "second"]
                one.log("third")
                assert (await logs.next(DEADLINE)).text == "third"
                assert logs.robots == ["wombat-1"]
                with pytest.raises(rect.TimedOut):
                    await logs.next(0.1)
            assert [line.text async for line in two.logs(program="async")] == ["first", "second", "third"]
            await one.alert("hot", name="motor")
            assert [alert.name for alert in await one.alerts("wombat-1")] == ["motor"]
            await one.clear_alert("motor")
            assert await one.alerts("wombat-1") == []

    asyncio.run(main())
