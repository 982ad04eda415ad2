"""Tests the view of parameters in Chromium, with programs in Python that declare them."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rect
from conftest import Fleet
from playwright.sync_api import Locator, Page, expect
from test_bad_input import command, socket_of

IN_MEMORY = rect.GroupOptions(about="how it drives", file=False)


@contextmanager
def driving(fleet: Fleet, program: str = "arm") -> Iterator[tuple[rect.Robot, Any]]:
    """Runs a program of wombat-2 that declares a group with each type of parameter."""
    with rect.connect("wombat-2", router=fleet.endpoint(1), program=program) as robot:
        group = robot.parameters(
            "drive",
            IN_MEMORY,
            kp=rect.Number(1.0, min=0, max=10, unit="1/s", about="gain of the heading"),
            steps=rect.Integer(3, min=1, max=8),
            offset=rect.Number(0.5, about="any number"),
            turbo=rect.Bool(False),
            side=rect.Choice("left", "right"),
            label=rect.Text("first"),
            points=rect.Numbers([1, 2.5]),
            serial=rect.Text("A-1", read_only=True),
        )
        yield robot, group


def card(page: Page, name: str = "wombat-2/drive") -> Locator:
    return page.get_by_role("region", name=name, exact=True)


def row(page: Page, name: str) -> Locator:
    return card(page).get_by_role("group", name=name, exact=True)


def open_view(page: Page, url: str) -> None:
    page.goto(f"{url}/#parameters")
    expect(row(page, "kp").get_by_role("slider")).to_be_enabled()


def slide(slider: Locator, *values: float, last: bool = True) -> None:
    """Moves a slider as a drag does: many inputs, and one change at the end."""
    slider.evaluate(
        """(slider, [values, last]) => {
          for (const value of values) {
            slider.value = value;
            slider.dispatchEvent(new Event("input", { bubbles: true }));
          }
          if (last) {
            slider.dispatchEvent(new Event("change", { bubbles: true }));
          }
        }""",
        [list(values), last],
    )


def test_each_type_has_a_control_that_sets_it(page: Page, fleet: Fleet, dashboard: str) -> None:
    changed = threading.Event()
    with driving(fleet) as (_, group):
        open_view(page, dashboard)
        expect(card(page)).to_contain_text("how it drives")
        expect(card(page)).to_contain_text("program arm")
        expect(row(page, "kp")).to_contain_text("gain of the heading")
        expect(row(page, "kp")).to_contain_text("default 1 1/s")
        expect(row(page, "serial")).to_contain_text("A-1")
        expect(row(page, "serial").get_by_role("textbox")).to_have_count(0)

        @group.on_change
        def on_change(_: rect.ParameterChange) -> None:
            changed.set()

        def until(name: str, value: object) -> None:
            while getattr(group, name) != value:
                assert changed.wait(30), (name, value, getattr(group, name))
                changed.clear()

        slide(row(page, "kp").get_by_role("slider"), 2, 3, 4.5)
        until("kp", 4.5)
        expect(row(page, "kp").get_by_role("spinbutton")).to_have_value("4.5")
        row(page, "kp").get_by_role("spinbutton").fill("2.25")
        page.keyboard.press("Enter")
        until("kp", 2.25)
        slide(row(page, "steps").get_by_role("slider"), 5)
        until("steps", 5)
        row(page, "offset").get_by_role("spinbutton").fill("-7")
        page.keyboard.press("Tab")
        until("offset", -7.0)
        row(page, "turbo").get_by_role("switch").check()
        until("turbo", True)
        row(page, "side").get_by_role("combobox").select_option("right")
        until("side", "right")
        row(page, "label").get_by_role("textbox").fill("second")
        page.keyboard.press("Enter")
        until("label", "second")
        row(page, "points").get_by_role("textbox").fill("3, 4;5.5")
        page.keyboard.press("Enter")
        until("points", [3, 4, 5.5])
        expect(card(page)).to_contain_text("points last changed by wombat-1")
        # The program changes one itself.
        group.label = "third"
        expect(row(page, "label").get_by_role("textbox")).to_have_value("third")
        expect(card(page)).to_contain_text("label last changed by the program itself")
        row(page, "kp").get_by_role("button", name="Reset kp").click()
        until("kp", 1.0)
        expect(row(page, "kp").get_by_role("button", name="Reset kp")).to_be_hidden()
        card(page).get_by_role("button", name="Reset all of wombat-2/drive").click()
        until("points", [1, 2.5])
        assert (group.steps, group.side, group.turbo, group.label) == (3, "left", False, "first")
        card(page).get_by_role("button", name=re.compile("Undo")).click()
        until("points", [3, 4, 5.5])
        assert (group.steps, group.side, group.label) == (5, "right", "third")


def test_a_slider_sends_at_most_ten_values_per_second_and_the_last_one(
    page: Page, fleet: Fleet, dashboard: str
) -> None:
    with driving(fleet) as (_, group):
        values = []
        group.on_change(lambda change: values.append(dict((name, new) for name, _, new in change.changed)))
        open_view(page, dashboard)
        sent = []
        page.on("websocket", lambda socket: socket.on("framesent", lambda text: sent.append(text)))
        page.reload()
        slider = row(page, "kp").get_by_role("slider")
        expect(slider).to_be_enabled()
        started = page.evaluate("performance.now()")
        slider.evaluate(
            """async (slider) => {
              for (let step = 0; step < 100; step += 1) {
                slider.value = 2 + step / 20;
                slider.dispatchEvent(new Event("input", { bubbles: true }));
                await new Promise((resolve) => setTimeout(resolve, 10));
              }
              slider.dispatchEvent(new Event("change", { bubbles: true }));
            }"""
        )
        took_s = (page.evaluate("performance.now()") - started) / 1000
        expect(card(page).get_by_role("button", name="Undo kp")).to_be_visible()
        expect(row(page, "kp")).not_to_have_class(re.compile("is-pending"))
        orders = [json.loads(text) for text in sent if "set_parameters" in text]
        assert 3 <= len(orders) <= took_s * 10 + 2, (len(orders), took_s)
        assert all(list(order["set"]) == ["kp"] for order in orders)
        assert group.kp == orders[-1]["set"]["kp"] == 6.95
        # All of that was one change.
        card(page).get_by_role("button", name="Undo kp").click()
        expect(row(page, "kp").get_by_role("spinbutton")).to_have_value("1")
        expect(row(page, "kp")).not_to_have_class(re.compile("is-pending"))
        assert group.kp == 1.0


def test_a_refusal_shows_the_reason_and_the_value_in_force(page: Page, fleet: Fleet, dashboard: str) -> None:
    with driving(fleet) as (_, group):

        @group.check
        def check(values: dict[str, Any]) -> str | None:
            return "the turbo overheats" if values["turbo"] else None

        open_view(page, dashboard)
        row(page, "turbo").get_by_role("switch").click()
        expect(row(page, "turbo").get_by_role("status")).to_have_text("the turbo overheats")
        expect(row(page, "turbo").get_by_role("switch")).not_to_be_checked()
        row(page, "kp").get_by_role("spinbutton").fill("11")
        page.keyboard.press("Enter")
        expect(row(page, "kp")).to_contain_text("the maximum is 10 1/s")
        expect(row(page, "kp").get_by_role("spinbutton")).to_have_value("1")
        expect(row(page, "turbo")).not_to_contain_text("overheats")
        row(page, "points").get_by_role("textbox").fill("1, two")
        page.keyboard.press("Enter")
        expect(row(page, "points")).to_contain_text("it must be a list of numbers")
        expect(row(page, "points").get_by_role("textbox")).to_have_value("1, 2.5")
        assert (group.turbo, group.kp) == (False, 1.0)


def test_a_value_that_is_not_confirmed_yet_is_marked(page: Page, fleet: Fleet, dashboard: str) -> None:
    may_answer = threading.Event()
    with driving(fleet) as (_, group):

        @group.check
        def check(_: dict[str, Any]) -> None:
            may_answer.wait(30)

        open_view(page, dashboard)
        try:
            row(page, "side").get_by_role("combobox").select_option("right")
            expect(row(page, "side").get_by_text("not yet confirmed")).to_be_visible()
            expect(row(page, "kp").get_by_text("not yet confirmed")).to_be_hidden()
        finally:
            may_answer.set()
        expect(row(page, "side").get_by_text("not yet confirmed")).to_be_hidden()
        expect(row(page, "side").get_by_role("combobox")).to_have_value("right")


def test_a_group_whose_program_has_ended_is_shown_and_cannot_be_changed(
    page: Page, fleet: Fleet, dashboard: str
) -> None:
    with driving(fleet):
        open_view(page, dashboard)
    expect(card(page)).to_contain_text("its program has ended")
    expect(row(page, "kp").get_by_role("slider")).to_be_disabled()
    expect(row(page, "kp").get_by_role("spinbutton")).to_have_value("1")
    with driving(fleet):
        expect(row(page, "kp").get_by_role("slider")).to_be_enabled()
        expect(card(page)).not_to_contain_text("its program has ended")


def test_parameters_are_no_services_and_are_received_only_while_they_are_shown(
    page: Page, fleet: Fleet, dashboard: str
) -> None:
    sent: list[str] = []
    page.on("websocket", lambda socket: socket.on("framesent", lambda text: sent.append(str(text))))
    with driving(fleet) as (robot, _):
        robot.serve("grab", lambda request: None)
        page.goto(f"{dashboard}/#services")
        services = page.get_by_role("region", name="wombat-2", exact=True)
        expect(services).to_contain_text("grab")
        expect(services).not_to_contain_text("drive")
        assert not any("parameters" in text for text in sent)
        page.goto(f"{dashboard}/#parameters")
        expect(row(page, "kp").get_by_role("slider")).to_be_enabled()
        watched = [json.loads(text) for text in sent if '"watch"' in text]
        watch = next(one for one in watched if one["topic"] == "wombat-2/parameters/drive")
        page.goto(f"{dashboard}/#services")
        expect(services).to_contain_text("grab")
        assert {"type": "unwatch", "id": watch["id"]} in [json.loads(text) for text in sent]
        page.goto(f"{dashboard}/#parameters")
        page.get_by_label("Filter parameters").fill("drive kp")
        expect(row(page, "kp")).to_be_visible()
        expect(row(page, "side")).to_be_hidden()


def test_a_page_that_only_shows_has_no_controls(page: Page, fleet: Fleet) -> None:
    with driving(fleet) as (_, group), fleet.dashboard("--read-only") as url:
        page.goto(f"{url}/#parameters")
        expect(row(page, "kp")).to_contain_text("default 1 1/s")
        expect(row(page, "side").get_by_text("left", exact=True)).to_be_visible()
        for role in ("slider", "spinbutton", "switch", "combobox", "button"):
            expect(card(page).get_by_role(role)).to_have_count(0)
        with socket_of(url) as connection:
            fields = {"robot": "wombat-2", "group": "drive", "set": {"kp": 2}, "reset": []}
            assert "--read-only" in command(connection, type="set_parameters", id=1, **fields)["error"]
        assert group.kp == 1.0


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"robot": "wombat-2", "group": "none", "set": {"kp": 1}, "reset": []}, "none"),
        ({"robot": "a b", "group": "drive", "set": {"kp": 1}, "reset": []}, "a b"),
        ({"robot": "wombat-2", "group": "../x", "set": {"kp": 1}, "reset": []}, "group"),
        ({"robot": "wombat-2", "group": "drive", "set": {"kp": 1}, "reset": ["side"]}, "not both"),
        ({"robot": "wombat-2", "group": "drive", "set": {"kpp": 1}, "reset": []}, "did you mean kp?"),
    ],
)
def test_invalid_orders_are_answered_with_their_problem(
    fleet: Fleet, dashboard: str, fields: dict[str, Any], problem: str
) -> None:
    with driving(fleet), socket_of(dashboard) as connection:
        answer = command(connection, type="set_parameters", id=1, **fields)
        assert answer["error"] and problem in answer["error"], answer
