"""Tests parameters: values of a program that people tune while it runs.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_parameters.py
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import queue
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import rect
import rect.aio
import zenoh
from conftest import DEADLINE, Pair, until
from programs import Routers, initialised_routers

#: The declaration that most tests use.
DRIVE: dict[str, Any] = {
    "kp": rect.Number(1.0, min=0, max=10, unit="1/s", about="gain of the heading"),
    "steps": rect.Integer(3, max=8),
    "side": rect.Choice("left", "right"),
    "turbo": False,
    "points": [0.0, 1.0],
    "serial": rect.Text("A1", read_only=True),
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RECT_PARAMETERS", str(tmp_path))
    return tmp_path


@pytest.fixture
def robot() -> Iterator[rect.Robot]:
    with rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        yield robot


def set_when_known(robot: rect.Robot, *arguments: Any, **more: Any) -> dict[str, Any]:
    """Changes parameters as soon as the other robot has learned of the group."""
    deadline = time.monotonic() + DEADLINE
    while True:
        try:
            return robot.set_parameters(*arguments, **more)
        except rect.NoParameters:
            assert time.monotonic() < deadline


def until_group(robot: rect.Robot, group: str) -> None:
    """Waits until the robot sees a group in the catalogue of `wombat-1`."""

    def is_listed() -> bool:
        # Its router may not be known yet.
        with contextlib.suppress(rect.NoService):
            return any(group in program.parameters for program in robot.programs("wombat-1"))
        return False

    until(is_listed)


def test_parameters_are_read_and_changed_as_attributes(robot: rect.Robot) -> None:
    drive = robot.parameters("drive", **DRIVE)
    assert drive.values() == {
        "kp": 1.0,
        "steps": 3,
        "side": "left",
        "turbo": False,
        "points": [0.0, 1.0],
        "serial": "A1",
    }
    drive.kp = 2
    assert (drive.kp, type(drive.kp)) == (2.0, float)
    drive.serial = "B2"
    drive.set({"side": "right"}, turbo=True, points=(1, 2.5))
    assert (drive.serial, drive.side, drive.turbo, drive.points) == ("B2", "right", True, [1.0, 2.5])
    drive.reset("kp", "side")
    assert (drive.kp, drive.side, drive.turbo) == (1.0, "left", True)
    drive.reset()
    assert (drive.turbo, drive.serial) == (False, "A1")
    assert {"kp", "serial", "on_change"} <= set(dir(drive))


def test_values_of_numpy_are_converted(robot: rect.Robot) -> None:
    numpy = pytest.importorskip("numpy")
    drive = robot.parameters("drive", points=numpy.zeros(2), gain=numpy.float32(0.5), count=numpy.int64(3))
    drive.points = numpy.array([1, 2])
    assert drive.values() == {"points": [1.0, 2.0], "gain": 0.5, "count": 3}


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("kp", 11, "kp cannot be 11: the maximum is 10 1/s"),
        ("kp", float("nan"), "kp cannot be NaN: it must be finite"),
        ("kp", True, "kp cannot be true: it must be a number, not a bool"),
        ("kp", None, "kp cannot be of the type NoneType"),
        ("kp", {"a": 1}, "kp cannot be of the type dict"),
        ("steps", 2.5, "it must be an integer, not a number"),
        ("steps", 2**70, "steps cannot be of the type int"),
        ("side", "lef", "did you mean left?"),
        ("points", ["a"], "points cannot be of the type list"),
        ("points", [0.0] * 257, "at most 256"),
        ("serial", "x" * (1 << 20), "at most 4096"),
    ],
)
def test_invalid_value_is_refused_with_a_reason(robot: rect.Robot, name: str, value: object, reason: str) -> None:
    drive = robot.parameters("drive", **DRIVE)
    before = drive.values()
    with pytest.raises(rect.ParameterError) as refused:
        setattr(drive, name, value)
    assert reason in str(refused.value)
    with pytest.raises(rect.ParameterError):
        drive.set({"turbo": True, name: value})
    assert drive.values() == before


def test_names_are_checked_with_a_hint(robot: rect.Robot) -> None:
    drive = robot.parameters("drive", **DRIVE)
    with pytest.raises(AttributeError, match="did you mean side"):
        _ = drive.sid
    with pytest.raises(AttributeError, match="did you mean side"):
        drive.sid = "left"
    with pytest.raises(AttributeError, match="is a method"):
        drive.set = 1  # type: ignore[method-assign, assignment]
    with pytest.raises(rect.ParameterError, match="did you mean side"):
        drive.set(sid="left")
    with pytest.raises(rect.ParameterError, match="did you mean side"):
        drive.reset("sid")
    assert not hasattr(drive, "_private")


@pytest.mark.parametrize(
    ("group", "parameters", "reason"),
    [
        ("a/b", {"a": 1}, "cannot be the name of a group"),
        ("drive", {}, "1 to 256 parameters"),
        ("drive", {f"p{n}": n for n in range(10_000)}, "1 to 256 parameters"),
        ("drive", {"kp": rect.Number(11, max=10)}, "the maximum is 10"),
        ("drive", {"kp": rect.Number(1, min=2, max=1)}, "above the maximum"),
        ("drive", {"side": rect.Choice()}, "1 to 64 choices"),
        ("drive", {"side": rect.Choice("left", default="up")}, "one of the choices|choices"),
        ("drive", {"kp": None}, "cannot be of the type NoneType"),
        ("drive", {"a b": 1}, "letters, digits"),
        ("drive", {"close": 1}, "the group has an attribute of that name"),
        ("drive", {"_kp": 1}, "begins with `_`"),
    ],
)
def test_invalid_declaration_is_refused(robot: rect.Robot, group: str, parameters: Any, reason: str) -> None:
    with pytest.raises(rect.ParameterError, match=reason):
        robot.parameters(group, **parameters)
    robot.parameters("drive", kp=1.0)


def test_options_have_types(robot: rect.Robot) -> None:
    options: Any = {"file": None}
    with pytest.raises(TypeError, match=r"rect\.GroupOptions, not dict"):
        robot.parameters("drive", options, kp=1.0)
    drive = robot.parameters("drive", kp=1.0)
    callback: Any = 1
    for register in (drive.check, drive.on_change):
        with pytest.raises(TypeError, match="callback must be a function"):
            register(callback)
    reset: Any = "kp"
    with pytest.raises(TypeError, match="True or a list of names"):
        robot.set_parameters("wombat-1", "drive", reset=reset)


def test_other_robot_changes_parameters(pair: Pair) -> None:
    one, two = pair
    drive = one.parameters("drive", **DRIVE)
    assert set_when_known(two, "wombat-1", "drive", {"kp": 2}, turbo=True) == {"kp": 2.0, "turbo": True}
    assert (drive.kp, drive.turbo) == (2.0, True)
    assert two.set_parameters("wombat-1", "drive", reset=["kp"], side="right") == {"kp": 1.0, "side": "right"}
    assert two.set_parameters("wombat-1", "drive", reset=True)["turbo"] is False
    refused: list[tuple[dict[str, Any], str]] = [
        ({"kp": 2, "side": "up"}, "side cannot be"),
        ({"kp": 2, "serial": "C3"}, "serial is read-only"),
        ({"kp": 2, "kpp": 2}, "did you mean kp?"),
    ]
    for values, reason in refused:
        with pytest.raises(rect.ServiceError, match=reason):
            two.set_parameters("wombat-1", "drive", values)
        assert drive.kp == 1.0
    with pytest.raises(rect.ParameterError, match="kp cannot be of the type NoneType"):
        two.set_parameters("wombat-1", "drive", kp=None)
    with pytest.raises(rect.ParameterError, match="name of a group"):
        two.set_parameters("wombat-1", "a/b", kp=1)


def test_missing_group_is_reported_with_those_that_there_are(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2") as two:
        one.parameters("drive", **DRIVE)
        until_group(two, "drive")
        with pytest.raises(rect.NoParameters, match=r"did you mean drive\?") as missing:
            two.set_parameters("wombat-1", "drives", kp=2)
        assert (missing.value.robot, missing.value.group, missing.value.available) == ("wombat-1", "drives", ["drive"])
        with pytest.raises(rect.NoParameters):
            two.set_parameters("wombat-9", "drive", {"kp": 2}, stored=True)


def test_program_checks_changes(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    drive = one.parameters("drive", **DRIVE)

    @drive.check
    def slow_with_turbo(values: dict[str, Any]) -> str | None:
        if values["turbo"] and values["kp"] > 5:
            return "turbo needs a kp of at most 5"
        if values["steps"] == 5:
            raise rect.Refusal("five steps are unlucky")
        if values["steps"] == 6:
            raise ValueError("a mistake")
        if values["steps"] == 7:
            drive.turbo = False
        return None

    assert slow_with_turbo(drive.values()) is None
    drive.kp = 6.0
    with pytest.raises(rect.ParameterError, match="turbo needs a kp of at most 5"):
        drive.turbo = True
    with pytest.raises(rect.ServiceError, match="turbo needs a kp of at most 5"):
        set_when_known(two, "wombat-1", "drive", turbo=True)
    assert two.set_parameters("wombat-1", "drive", turbo=True, kp=5) == {"turbo": True, "kp": 5.0}
    assert caplog.text == ""
    with pytest.raises(rect.ServiceError, match="five steps are unlucky"):
        two.set_parameters("wombat-1", "drive", steps=5)
    assert caplog.text == ""
    with pytest.raises(rect.ServiceError, match="the check of the program failed: a mistake"):
        two.set_parameters("wombat-1", "drive", steps=6)
    assert "a check of the parameters drive raised an exception" in caplog.text
    with pytest.raises(rect.ParameterError, match="a check cannot change parameters"):
        drive.steps = 7
    with pytest.raises(rect.ParameterError, match="a mistake") as failed:
        drive.steps = 6
    assert isinstance(failed.value.__cause__, ValueError)
    wrong: Any = lambda values: False  # noqa: E731
    drive.check(wrong)
    with pytest.raises(rect.ParameterError, match="a check returns the reason"):
        drive.steps = 4
    assert (drive.steps, drive.turbo) == (3, True)


def test_changes_are_reported_in_order_and_one_at_a_time(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    drive = one.parameters("drive", **DRIVE)
    reported: queue.SimpleQueue[rect.ParameterChange] = queue.SimpleQueue()
    running = threading.Lock()

    @drive.on_change
    def on_change(change: rect.ParameterChange) -> None:
        assert running.acquire(blocking=False)
        reported.put(change)
        if change.changed[0][0] == "steps":
            # A change by the callback is one of the next.
            drive.side = "right"
        running.release()
        if change.changed[0] == ("side", "left", "right"):
            raise ValueError("a mistake")

    def next_change() -> tuple[list[tuple[str, Any, Any]], str]:
        change = reported.get(timeout=DEADLINE)
        return change.changed, change.by

    drive.set(kp=2.0, turbo=True)
    drive.kp = 2.0
    drive.steps = 4
    assert next_change() == ([("kp", 1.0, 2.0), ("turbo", False, True)], "")
    assert next_change() == ([("steps", 3, 4)], "")
    assert next_change() == ([("side", "left", "right")], "")
    set_when_known(two, "wombat-1", "drive", kp=3)
    assert next_change() == ([("kp", 2.0, 3.0)], "wombat-2")
    assert "a mistake" in caplog.text
    for number in range(200):
        drive.kp = number / 100
    values = [next_change()[0][0][2] for _ in range(200)]
    assert values == [number / 100 for number in range(200)]


def test_program_is_named_as_the_one_that_changed(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2", program="page") as two:
        drive = one.parameters("drive", **DRIVE)
        reported: queue.SimpleQueue[str] = queue.SimpleQueue()
        drive.on_change(lambda change: reported.put(change.by))
        set_when_known(two, "wombat-1", "drive", kp=2)
        assert reported.get(timeout=DEADLINE) == "wombat-2/page"


def test_restart_keeps_the_values(folder: Path) -> None:
    file = folder / "wombat-1" / "drive.json"
    with rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        drive = robot.parameters("drive", **DRIVE)
        drive.set(kp=2.0, side="right")
        until(file.exists)
        drive.turbo = True
    # A change just before the end is stored, too.
    assert json.loads(file.read_text()) == {"kp": 2.0, "side": "right", "turbo": True}
    with rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"]) as robot:
        with robot.parameters("drive", **DRIVE) as drive:
            assert (drive.kp, drive.side, drive.turbo) == (2.0, "right", True)
            drive.kp = 1.0
        assert "kp" not in json.loads(file.read_text())
        # The name is free again, and the last values remain visible.
        assert robot.parameters("drive", **DRIVE).side == "right"
        assert drive.side == "right"
        with pytest.raises(rect.Closed, match="the group is closed"):
            drive.kp = 3.0
        with pytest.raises(rect.Closed):
            drive.on_change(print)


def test_exit_of_the_program_stores_the_values_and_a_forked_child_does_not(folder: Path) -> None:
    code = """
import os, rect, sys
drive = rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"]).parameters("drive", kp=1.0)
drive.kp = 5.0
if os.fork() == 0:
    try:
        drive.kp = drive.kp + 1
    except rect.Closed:
        sys.exit(0)
    os._exit(1)
sys.exit(os.wait()[1])
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=DEADLINE)
    assert json.loads((folder / "wombat-1" / "drive.json").read_text()) == {"kp": 5.0}


def test_file_that_does_not_fit_is_reported(robot: rect.Robot, folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = folder / "mine.json"
    file.write_text('{"kp": 99, "old": 1, "side": "right"}')
    drive = robot.parameters("drive", rect.GroupOptions(file=file), **DRIVE)
    assert (drive.kp, drive.side) == (1.0, "right")
    assert "kp cannot be 99" in caplog.text
    assert "no parameters old" in caplog.text
    drive.turbo = True
    drive.close()
    assert json.loads(file.read_text()) == {"kp": 99, "old": 1, "side": "right", "turbo": True}


def test_setter_waits_until_the_values_are_stored(pair: Pair, folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    one.parameters("drive", **DRIVE)
    assert set_when_known(two, "wombat-1", "drive", kp=2, stored=True) == {"kp": 2.0}
    assert json.loads((folder / "wombat-1" / "drive.json").read_text()) == {"kp": 2.0}
    # Also if nothing changes.
    assert two.set_parameters("wombat-1", "drive", kp=2, stored=True) == {"kp": 2.0}
    with pytest.raises(rect.ServiceError, match="the maximum is 10"):
        two.set_parameters("wombat-1", "drive", kp=20, stored=True)

    memory = one.parameters("memory", rect.GroupOptions(file=False), kp=1.0)
    with pytest.raises(rect.NotStored, match="wombat-1 uses the values, and has not stored them: the program"):
        set_when_known(two, "wombat-1", "memory", kp=2, stored=True)
    assert memory.kp == 2.0

    (folder / "blocked").write_text("no folder")
    one.parameters("blocked", rect.GroupOptions(file=folder / "blocked" / "drive.json"), kp=1.0)
    with pytest.raises(rect.NotStored, match="cannot write the parameters"):
        set_when_known(two, "wombat-1", "blocked", kp=2, stored=True)
    assert caplog.text.count("cannot write the parameters") == 1


def test_values_of_a_group_that_ends_are_confirmed_as_stored(pair: Pair, folder: Path) -> None:
    one, two = pair
    drive = one.parameters("drive", **DRIVE)
    set_when_known(two, "wombat-1", "drive", kp=3)
    in_force: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    drive.on_change(lambda _: drive.close())
    setter = threading.Thread(
        target=lambda: in_force.put(two.set_parameters("wombat-1", "drive", {"kp": 2}, stored=True))
    )
    setter.start()
    assert in_force.get(timeout=DEADLINE) == {"kp": 2.0}
    setter.join()
    assert json.loads((folder / "wombat-1" / "drive.json").read_text()) == {"kp": 2.0}


def test_two_programs_cannot_have_one_group(routers: Routers) -> None:
    with routers.connect("wombat-1", program="arm") as one, routers.connect("wombat-1", program="leg") as two:
        drive = one.parameters("drive", **DRIVE)
        with pytest.raises(rect.ServiceRefused, match="arm"):
            two.parameters("drive", kp=1.0)
        with pytest.raises(rect.ServiceRefused):
            one.parameters("drive", kp=1.0)
        drive.close()
        two.parameters("drive", kp=1.0)


def test_catalogue_lists_groups_apart_from_services(routers: Routers) -> None:
    with routers.connect("wombat-1", program="arm") as one, routers.connect("wombat-2") as two:
        one.parameters("drive", rect.GroupOptions(about="how it drives"), **DRIVE)
        one.serve("grab", lambda _: "done")
        until_group(two, "drive")
        (program,) = [program for program in two.programs("wombat-1") if program.name == "arm"]
        assert [service.topic for service in program.services] == ["grab"]
        drive = program.parameters["drive"]
        assert list(drive) == list(DRIVE)
        assert drive["kp"] == DRIVE["kp"]
        assert drive["side"] == rect.Choice("left", "right")
        assert drive["turbo"] == rect.Bool(False)
        assert drive["points"] == rect.Numbers([0.0, 1.0])
        assert isinstance(hash(program), int)


def test_values_are_a_retained_topic(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2", program="page") as two:
        drive = one.parameters("late", **DRIVE)
        with two.subscribe("wombat-1/parameters/late") as subscriber:
            first = subscriber.next(DEADLINE)
            assert first.retained is not None
            assert first.value == {"values": drive.values()}
            two.set_parameters("wombat-1", "late", {"kp": 2}, turbo=True)
            second = subscriber.next(DEADLINE).value
            assert second["values"] == drive.values()
            assert (second["changed"], second["by"]) == (["kp", "turbo"], "wombat-2/page")
            with routers.without_link():
                drive.side = "right"
            assert subscriber.next(DEADLINE).value["values"]["side"] == "right"
        latest = two.latest("wombat-1", "parameters/late")
        assert latest is not None
        assert latest.value["values"]["side"] == "right"


def test_stock_program_changes_parameters_with_json(routers: Routers) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{routers.endpoints["wombat-2"]}"]')
    key = "rect/wombat-1/@rect/@set/parameters/stock"
    with routers.connect("wombat-1") as one, zenoh.open(config) as stock:
        drive = one.parameters("stock", **DRIVE)
        reported: queue.SimpleQueue[str] = queue.SimpleQueue()
        drive.on_change(lambda change: reported.put(change.by))

        def order(payload: str) -> list[Any]:
            return list(stock.get(key, payload=payload, consolidation=zenoh.ConsolidationMode.NONE))

        until(lambda: bool(order('{"set": {"kp": 2}}')))
        assert (drive.kp, reported.get(timeout=DEADLINE)) == (2.0, "a Zenoh program")
        replies = [reply.ok for reply in order('{"set": {"kp": 3}, "stored": true}')]
        assert len(replies) == 2
        assert drive.kp == 3.0
        for wrong, reason in [
            ("fast", "the request must be like"),
            ('{"set": {"kp": null}}', "a bool, number, text or list of numbers"),
            ('{"set": {"kp": 99}}', "the maximum is 10"),
            ('{"set": {"serial": "C3"}}', "serial is read-only"),
            ("x" * 70_000, "70000 bytes, and at most 65536 are allowed"),
        ]:
            (refused,) = order(wrong)
            assert refused.err is not None
            assert reason in refused.err.payload.to_bytes().decode()
        assert drive.kp == 3.0


@pytest.mark.parametrize("stored", [False, True])
def test_order_that_is_interrupted_is_sent_again(routers: Routers, stored: bool) -> None:
    key = f"rect/wombat-1/@rect/@set/parameters/interrupted{stored:d}"
    orders: list[str] = []

    def reply(query: zenoh.Query) -> None:
        """Ends the first order without a reply."""
        orders.append("")
        if len(orders) > 1:
            query.reply(key, '{"values": {"kp": 2.0}}', encoding="application/json")
            if stored:
                query.reply(key, '{"stored": true}', encoding="application/json")

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{routers.endpoints["wombat-1"]}"]')
    with zenoh.open(config) as stock, routers.connect("wombat-2") as two:
        stock.declare_queryable(key, reply, complete=True)
        group = key.rsplit("/", 1)[1]
        assert set_when_known(two, "wombat-1", group, {"kp": 2}, stored=stored) == {"kp": 2.0}
        assert len(orders) == 2


#: The part of a rule that lets other robots of the fleet change parameters.
OTHERS = ', "rect/*/@rect/@set/parameters/**"'


def without_others(configuration: str) -> str:
    assert OTHERS in configuration
    return configuration.replace(OTHERS, "")


def test_robots_that_rect_init_configured_change_parameters_of_each_other(tmp_path: Path) -> None:
    with initialised_routers(tmp_path) as options, ExitStack() as stack:
        one, two = (stack.enter_context(rect.connect(name, **options[name])) for name in options)
        drive = one.parameters("drive", **DRIVE)
        until_group(two, "drive")
        assert set_when_known(two, "wombat-1", "drive", kp=2.0) == {"kp": 2.0}
        assert drive.kp == 2.0


def test_setter_without_the_right_learns_which_rule_is_missing(tmp_path: Path) -> None:
    with initialised_routers(tmp_path, without_others) as options, ExitStack() as stack:
        one, two = (stack.enter_context(rect.connect(name, **options[name])) for name in options)
        drive = one.parameters("drive", **DRIVE)
        until_group(two, "drive")
        with pytest.raises(rect.NoParameters, match=r"access control .*@rect/@set/parameters"):
            two.set_parameters("wombat-1", "drive", kp=2.0)
        # Programs of the robot itself have it.
        with rect.connect("wombat-1", **options["wombat-1"]) as own:
            assert set_when_known(own, "wombat-1", "drive", kp=3.0) == {"kp": 3.0}
        assert drive.kp == 3.0


def test_ordinary_calls_do_not_reach_internal_topics(pair: Pair) -> None:
    one, two = pair
    one.parameters("drive", **DRIVE)
    topic = "@rect/@set/parameters/drive"
    with pytest.raises(rect.InvalidTopicError):
        two.request("wombat-1", topic, {"set": {"kp": 2}})
    with pytest.raises(rect.InvalidTopicError):
        two.serve(topic, lambda _: None)


def test_setting_reaches_the_program_soon(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2") as two:
        drive = one.parameters("soon", **DRIVE)
        reported: queue.SimpleQueue[float] = queue.SimpleQueue()
        drive.on_change(lambda _: reported.put(time.monotonic()))
        set_when_known(two, "wombat-1", "soon", kp=10)
        reported.get(timeout=DEADLINE)
        program_ms, reply_ms = [], []
        for number in range(50):
            began = time.monotonic()
            two.set_parameters("wombat-1", "soon", kp=number / 10)
            reply_ms.append((time.monotonic() - began) * 1000)
            program_ms.append((reported.get(timeout=DEADLINE) - began) * 1000)
        for name, took in (("program", program_ms), ("setter", reply_ms)):
            took.sort()
            print(f"\nsetting to {name}: p50 {statistics.median(took):.1f} ms, p99 {took[-1]:.1f} ms")
        assert statistics.median(program_ms) < 300


def test_flood_of_settings_ends_with_the_last_one(pair: Pair) -> None:
    one, two = pair
    drive = one.parameters("drive", **DRIVE)
    set_when_known(two, "wombat-1", "drive", kp=0)
    busy = []

    def flood(number: int) -> None:
        for step in range(100):
            try:
                two.set_parameters("wombat-1", "drive", kp=(number * 100 + step) / 100)
            except rect.ServiceError as error:
                busy.append(error)

    threads = [threading.Thread(target=flood, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert two.set_parameters("wombat-1", "drive", kp=9.5) == {"kp": 9.5}
    assert drive.kp == 9.5

    def published() -> Any:
        latest = two.latest("wombat-1", "parameters/drive")
        return latest and latest.value["values"]["kp"]

    until(lambda: published() == 9.5, published)


def test_stored_value_survives_kill_9(routers: Routers, folder: Path) -> None:
    code = f"""
import rect
with rect.connect("wombat-1", router={routers.endpoints["wombat-1"]!r}, program="killed") as robot:
    drive = robot.parameters("killed", kp=1.0, other=0)
    print(drive.kp, flush=True)
    input()
"""

    def start() -> subprocess.Popen[str]:
        command = [sys.executable, "-c", code]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def first_line(process: subprocess.Popen[str]) -> str:
        assert process.stdout is not None
        return process.stdout.readline()

    with routers.connect("wombat-2") as two:
        for number in range(5):
            with start() as process:
                assert first_line(process) == f"{number or 1.0:.1f}\n"
                set_when_known(two, "wombat-1", "killed", {"kp": number + 1, "other": number}, stored=True)
                process.kill()
        # A program that ends by itself stores what has changed just before.
        with start() as process:
            assert first_line(process) == "5.0\n"
            set_when_known(two, "wombat-1", "killed", kp=9)
            process.communicate("\n", DEADLINE)
    file = folder / "wombat-1" / "killed.json"
    assert json.loads(file.read_text()) == {"kp": 9.0, "other": 4}


def test_check_of_the_options_is_there_from_the_beginning(robot: rect.Robot) -> None:
    options = rect.GroupOptions(check=lambda values: "too fast" if values["kp"] > 5 else None)
    drive = robot.parameters("drive", options, **DRIVE)
    with pytest.raises(rect.ParameterError, match="too fast"):
        drive.kp = 6.0
    with pytest.raises(TypeError, match="check must be a function"):
        robot.parameters("arm", rect.GroupOptions(check=3), kp=1.0)  # type: ignore[arg-type]


def test_asyncio(routers: Routers, folder: Path) -> None:
    async def run() -> None:
        async with (
            rect.aio.connect("wombat-1", router=routers.endpoints["wombat-1"]) as one,
            rect.aio.connect("wombat-2", router=routers.endpoints["wombat-2"]) as two,
        ):
            drive = await one.parameters("aio", **DRIVE)
            loop = asyncio.get_running_loop()
            reported: asyncio.Queue[rect.ParameterChange] = asyncio.Queue()

            @drive.on_change
            async def on_change(change: rect.ParameterChange) -> None:
                assert asyncio.get_running_loop() is loop
                await reported.put(change)

            @drive.check
            def check(values: dict[str, Any]) -> str | None:
                assert asyncio.get_running_loop() is loop
                return "not so fast" if values["kp"] > 5 else None

            drive.kp = 2.0
            assert (await reported.get()).changed == [("kp", 1.0, 2.0)]
            with pytest.raises(rect.ParameterError, match="not so fast"):
                drive.kp = 6.0
            await one.wait_until_established(DEADLINE)
            in_force = await two.set_parameters("wombat-1", "aio", {"kp": 3}, stored=True)
            assert in_force == {"kp": 3.0}
            assert json.loads((folder / "wombat-1" / "aio.json").read_text()) == {"kp": 3.0}
            assert (await reported.get()).by == "wombat-2"
            with pytest.raises(rect.ServiceError, match="not so fast"):
                await two.set_parameters("wombat-1", "aio", kp=6)
            with pytest.raises(rect.NoParameters):
                await two.set_parameters("wombat-1", "aoi", kp=6)
            with pytest.raises(AttributeError, match="did you mean kp"):
                _ = drive.kpp
            async with await one.parameters("second", kp=1.0) as second:
                second.kp = 2.0
            assert json.loads((folder / "wombat-1" / "second.json").read_text()) == {"kp": 2.0}
            drive.turbo = True
        assert json.loads((folder / "wombat-1" / "aio.json").read_text()) == {"kp": 3.0, "turbo": True}

    asyncio.run(asyncio.wait_for(run(), DEADLINE))
