"""Tests the view of logs, and alerts, in Chromium, with lines that routers of simulated robots keep."""

from __future__ import annotations

import json
import random
import re
import time
from typing import Any

import pytest
import rect
import zenoh
from conftest import DEADLINE_MS, Fleet
from playwright.sync_api import Locator, Page, expect

PYTHON = """Traceback (most recent call last):
  File "arm.py", line 12, in <module>
    move(200)
  File "arm.py", line 7, in move
    raise ValueError("angle")
ValueError: angle"""
RUST = """thread 'main' panicked at src/main.rs:4:5:
the gripper is stuck
stack backtrace:
   0: arm::grip
             at ./src/main.rs:4:5
   1: arm::main"""
CPP = (
    "terminate called after throwing an instance of 'std::out_of_range'\n  what():  vector::_M_range_check\n#1\tmain ()"
)
HOSTILE = "<img src=x onerror=alert(1)>\u202etxt.exe\u0007"


class Program:
    """A program that gives lines to the router of its robot."""

    def __init__(self, robot: rect.Robot, name: str) -> None:
        self._robot = robot
        self._key = f"rect/{robot.name}/@rect/@set/log/{name}"
        self._run = random.randrange(2**32)
        self._logged = 0

    def log(self, *texts: str, level: str = "info", **fields: Any) -> None:
        at = fields.pop("at", round(time.time() * 1000))
        lines = [{"at": at, "level": level, "text": text, **fields} for text in texts]
        batch = {"run": self._run, "first": self._logged, "lines": lines}
        self._logged += len(lines)
        self._robot.zenoh.put(self._key, json.dumps(batch), encoding=zenoh.Encoding.APPLICATION_JSON)


def console(page: Page) -> Locator:
    return page.get_by_role("log", name="Lines")


def line(page: Page, text: str) -> Locator:
    return page.locator(".entry").filter(has_text=text)


def open_log(page: Page, url: str, part: str = "") -> None:
    page.goto(f"{url}/#log{part}")
    expect(page.get_by_label("Level")).to_be_visible()
    expect(page.locator(".condition")).to_have_text("live")


def test_lines_of_all_programs_are_shown_and_filtered(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.program(1) as second, fleet.program(2) as third:
        arm, drive = Program(second, "arm"), Program(third, "drive")
        arm.log("before the page")
        open_log(page, dashboard)
        expect(line(page, "before the page")).to_contain_text("wombat-2/arm")
        drive.log("too fast", level="warn", logger="motor", fields={"speed": 3.5}, source="drive.cpp:8")
        expect(line(page, "too fast")).to_contain_text("wombat-3/drive")
        expect(line(page, "too fast")).to_contain_text("motor  speed=3.5  drive.cpp:8")
        page.get_by_label("fields and source").uncheck()
        expect(line(page, "too fast").locator(".extra")).to_be_hidden()

        page.get_by_label("Robot").select_option("wombat-3")
        expect(line(page, "before the page")).to_have_count(0)
        expect(line(page, "too fast")).to_have_count(1)
        page.get_by_label("Robot").select_option("")
        page.get_by_label("Program").select_option("arm")
        expect(line(page, "before the page")).to_have_count(1)
        expect(line(page, "too fast")).to_have_count(0)
        page.get_by_label("Program").select_option("")
        page.get_by_label("Filter lines").fill("FAST motor")
        expect(line(page, "too fast")).to_have_count(1)
        expect(line(page, "before the page")).to_have_count(0)
        page.get_by_label("Filter lines").fill("")

        arm.log("a detail", level="debug")
        arm.log("after the detail")
        expect(line(page, "after the detail")).to_have_count(1)
        expect(line(page, "a detail")).to_have_count(0)
        page.get_by_label("Level").select_option("debug")
        expect(line(page, "a detail")).to_have_count(1)
        page.get_by_label("Level").select_option("error")
        expect(page.locator("#content")).to_contain_text("No line matches the filters.")
        arm.log("broken", level="error")
        expect(line(page, "broken")).to_have_count(1)

        page.goto(f"{dashboard}/#fleet")
        page.get_by_role("link", name="Log of wombat-3").click()
        expect(page.get_by_label("Robot")).to_have_value("wombat-3")
        expect(line(page, "too fast")).to_have_count(1)
        expect(line(page, "before the page")).to_have_count(0)


def test_lines_cross_the_links_only_while_a_page_shows_them(page: Page, fleet: Fleet) -> None:
    with fleet.dashboard() as url, fleet.program(1) as robot:

        def until(level: str, is_followed: bool) -> None:
            follower = robot.zenoh.declare_publisher(f"rect/wombat-2/@rect/@log/{level}/arm")
            deadline = time.monotonic() + DEADLINE_MS / 1000
            while follower.matching_status.matching != is_followed:
                assert time.monotonic() < deadline, (level, is_followed)
                page.wait_for_timeout(50)
            follower.undeclare()

        page.goto(url)
        expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("✓ reachable")
        until("info", False)
        open_log(page, url)
        until("info", True)
        page.get_by_label("Level").select_option("warn")
        until("warn", True)
        until("info", False)
        other = page.context.new_page()
        open_log(other, url)
        until("info", True)
        other.close()
        until("info", False)
        until("warn", True)
        page.goto(f"{url}/#fleet")
        until("warn", False)


def test_console_pauses_while_it_is_scrolled_up(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.program(1) as robot:
        arm = Program(robot, "scrolling")
        arm.log(*(f"early {number}" for number in range(100)))
        open_log(page, dashboard, "/wombat-2")
        page.get_by_label("Program").select_option("scrolling")
        expect(line(page, "early 99")).to_be_in_viewport()
        expect(console(page)).to_have_attribute("aria-live", "polite")
        arm.log("follows")
        expect(line(page, "follows")).to_be_in_viewport()
        console(page).focus()
        page.keyboard.press("Home")
        expect(page.get_by_role("button", name="Continue")).to_be_visible()
        expect(console(page)).to_have_attribute("aria-live", "off")
        arm.log("waits 1", "waits 2")
        expect(page.get_by_role("button", name="Continue: 2 new lines")).to_be_visible()
        expect(line(page, "waits")).to_have_count(0)
        expect(line(page, "early 0")).to_be_in_viewport()
        page.get_by_role("button", name="Continue").click()
        expect(line(page, "waits 2")).to_be_in_viewport()
        expect(console(page)).to_have_attribute("aria-live", "polite")
        page.get_by_role("button", name="Pause").click()
        arm.log("waits 3")
        expect(page.get_by_role("button", name="Continue: 1 new line")).to_be_visible()
        page.keyboard.press("Enter")
        expect(line(page, "waits 3")).to_be_in_viewport()


def test_stack_traces_keep_their_lines_and_indentation(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.program(1) as robot:
        crash = Program(robot, "crash")
        crash.log(PYTHON, RUST, CPP, level="error", logger="stderr")
        open_log(page, dashboard, "/wombat-2")
        page.get_by_label("Program").select_option("crash")
        expect(page.locator(".entry")).to_have_count(3)
        for index, trace in enumerate((PYTHON, RUST, CPP)):
            shown = page.locator(".entry .text").nth(index)
            assert shown.evaluate("element => element.firstChild.data") == trace
            # The text that is copied has them, too.
            assert trace.split("\n")[1] in shown.inner_text()
            style = shown.evaluate(
                "element => [getComputedStyle(element).whiteSpace, getComputedStyle(element).fontFamily]"
            )
            assert style[0] == "pre-wrap" and "monospace" in style[1]


def test_lines_are_never_interpreted_as_html(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.on("dialog", lambda dialog: pytest.fail(f"a script ran: {dialog.message}"))
    with fleet.program(1) as robot:
        hostile = Program(robot, "hostile")
        open_log(page, dashboard)
        hostile.log(HOSTILE, logger=HOSTILE, source=HOSTILE, fields={HOSTILE: HOSTILE, "__proto__": {"x": 1}})
        hostile.log("years off", at=2**63)
        hostile.log("long " + "x" * 7000)
        robot.publish("alerts/hostile", {"text": HOSTILE, "level": "error", "at": 5, "program": HOSTILE}, retained=True)
        expect(line(page, "<img src=x onerror=alert(1)>")).to_be_visible()
        expect(line(page, "years off")).to_contain_text("unknown time")
        expect(line(page, "long ")).to_be_visible()
        page.goto(f"{dashboard}/#fleet")
        card = page.get_by_role("region", name="wombat-2", exact=True)
        expect(card).to_contain_text("<img src=x onerror=alert(1)>")
        assert page.locator("img").count() == 0
        robot.forget("alerts/hostile")
        expect(card).not_to_contain_text("onerror")


def test_many_lines_are_bounded(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.program(0) as robot:
        loud = Program(robot, "loud")
        open_log(page, dashboard)
        expect(page.get_by_label("Robot")).to_contain_text("wombat-1")
        for first in range(0, 8000, 100):
            loud.log(*(f"line {number}" for number in range(first, first + 100)))
            page.wait_for_timeout(20)
        expect(line(page, "line 7999")).to_be_in_viewport()
        assert 1000 <= page.locator(".entry").count() <= 5000


def test_lines_of_a_silent_robot_are_shown_with_their_age(page: Page, fleet: Fleet) -> None:
    with fleet.program(1) as robot, fleet.dashboard() as url:
        open_log(page, url)
        Program(robot, "last-words").log("the battery is empty")
        expect(line(page, "the battery is empty")).to_be_visible()
        fleet.room.cut()
        try:
            silent = re.compile(r"wombat-2 is silent since \d\d:\d\d:\d\d: its last line was seen [\d.]+ (s|min) ago")
            expect(page.locator("#content > .problems")).to_contain_text(silent)
            # The file is written when the last page hides the lines.
            page.goto(f"{url}/#fleet")
            expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("✗ not reachable")
            with fleet.dashboard() as again:
                open_log(page, again)
                expect(line(page, "the battery is empty")).to_be_visible()
                expect(line(page, "the battery is empty")).to_have_class(re.compile("is-old"))
                unknown = re.compile(r"wombat-2 is silent: its last line was seen [\d.]+ (s|min) ago")
                expect(page.locator("#content > .problems")).to_contain_text(unknown)
                Program(robot, "last-words").log("still alive")
                fleet.room.restore()
                expect(line(page, "still alive")).to_be_visible()
                expect(line(page, "the battery is empty")).not_to_have_class(re.compile("is-old"))
                expect(page.locator("#content > .problems")).not_to_contain_text("wombat-2 is silent")
        finally:
            fleet.room.restore()


def test_alerts_are_shown_until_they_are_cleared(page: Page, fleet: Fleet, dashboard: str) -> None:
    def alert(text: str, level: str) -> dict[str, Any]:
        return {"text": text, "level": level, "at": 5, "program": "guard"}

    card = page.get_by_role("region", name="wombat-2", exact=True)
    alerts = card.get_by_role("list", name="Alerts")
    count = page.locator(".alert-count")
    with fleet.dashboard("--read-only") as url, fleet.program(1) as robot:
        for address in (url, dashboard):
            page.goto(f"{address}/#fleet")
            expect(card).to_contain_text("✓ reachable")
            expect(count).to_be_hidden()
            with rect.connect("wombat-2", router=fleet.endpoint(1), program="guard") as program:
                program.publish("alerts/battery-low", alert("battery low", "warn"), retained=True)
                shown = re.compile(r"⚠ battery low warn, since \d\d:\d\d:\d\d, by guard$")
                expect(alerts.get_by_role("listitem")).to_have_text(shown)
                expect(count).to_have_text("⚠ 1 alert")
                program.publish("alerts/motor", alert("motor too hot", "error"), retained=True)
                expect(count).to_have_text("✗ 2 alerts")
                expect(alerts.get_by_role("listitem").filter(has_text="motor")).to_contain_text("✗ motor too hot error")
            expect(alerts.get_by_role("listitem").filter(has_text="its program has ended")).to_have_count(2)
            for topic in ("alerts/battery-low", "alerts/motor"):
                robot.forget(topic)
            expect(alerts).to_be_hidden()
            expect(count).to_be_hidden()
