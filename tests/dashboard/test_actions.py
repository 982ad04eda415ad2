"""Tests the view of actions in Chromium, with programs in Python that declare them."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rect
from conftest import Fleet
from playwright.sync_api import Locator, Page, expect
from test_bad_input import command, socket_of

TIMEOUT_S = 60


@contextmanager
def digging(fleet: Fleet, program: str = "digger") -> Iterator[rect.Robot]:
    """Runs a program of wombat-2 that digs: 0 is rock, and below that there is no end."""
    with rect.connect("wombat-2", router=fleet.endpoint(1), program=program) as robot:

        @robot.action("dig", about="digs a hole")
        def dig(goal: rect.Goal[Any]) -> dict[str, Any]:
            goal.feedback({"depth": goal.value}, progress=0.25)
            if goal.value == 0:
                raise rect.Refusal("rock")
            while goal.value < 0:
                goal.sleep(1)
            return {"dug": goal.value}

        yield robot


def card(page: Page, name: str = "wombat-2/dig") -> Locator:
    return page.get_by_role("region", name=name, exact=True)


def running(page: Page) -> Locator:
    return card(page).get_by_role("list", name="Goals of wombat-2/dig").get_by_role("listitem")


def ends(page: Page) -> Locator:
    return card(page).get_by_role("list", name="Ends of wombat-2/dig").get_by_role("listitem")


def start(page: Page, value: str) -> None:
    page.get_by_label("Value for wombat-2/dig").fill(value)
    page.get_by_role("button", name="Start wombat-2/dig").click()


def open_view(page: Page, url: str) -> None:
    page.goto(f"{url}/#actions")
    expect(page.get_by_role("button", name="Start wombat-2/dig")).to_be_enabled()


def test_a_goal_is_started_followed_and_cancelled(page: Page, fleet: Fleet, dashboard: str) -> None:
    with digging(fleet):
        open_view(page, dashboard)
        expect(card(page)).to_contain_text("digs a hole")
        expect(card(page)).to_contain_text("program digger")
        idle = card(page).get_by_text("No goal is carried out.")
        expect(idle).to_be_visible()
        start(page, "3")
        expect(ends(page).first).to_contain_text('Result: {"dug":3}')
        expect(ends(page).first).to_contain_text("started by wombat-1")
        start(page, "0")
        expect(ends(page).first).to_contain_text("failed: rock")
        start(page, "-1")
        expect(running(page)).to_contain_text("is carried out")
        expect(running(page)).to_contain_text("25 %")
        expect(running(page)).to_contain_text('{"depth":-1}')
        expect(running(page).get_by_role("progressbar")).to_have_js_property("value", 0.25)
        expect(idle).to_be_hidden()
        page.get_by_role("button", name="Cancel wombat-2/dig").click()
        expect(ends(page).first).to_contain_text("cancelled by wombat-1")
        expect(running(page)).to_have_count(0)


def test_the_bar_follows_the_progress(page: Page, fleet: Fleet, dashboard: str) -> None:
    continues = [threading.Event(), threading.Event()]
    with rect.connect("wombat-2", router=fleet.endpoint(1), program="digger") as robot:

        @robot.action("dig")
        def dig(goal: rect.Goal[Any]) -> None:
            goal.feedback("begins")
            assert continues[0].wait(TIMEOUT_S)
            goal.feedback(progress=0.5)
            assert continues[1].wait(TIMEOUT_S)
            goal.feedback(progress=0.875)
            goal.sleep(TIMEOUT_S)

        open_view(page, dashboard)
        start(page, "1")
        bar = running(page).get_by_role("progressbar")
        expect(running(page)).to_contain_text("begins")
        expect(running(page)).to_contain_text("progress not known")
        expect(bar).to_have_count(0)
        continues[0].set()
        expect(bar).to_have_js_property("value", 0.5)
        expect(bar).to_have_js_property("max", 1)
        expect(running(page)).to_contain_text("50 %")
        continues[1].set()
        expect(bar).to_have_js_property("value", 0.875)
        expect(running(page)).to_contain_text("88 %")


def test_a_goal_of_another_program_is_shown_and_a_newer_one_preempts_it(
    page: Page, fleet: Fleet, dashboard: str
) -> None:
    with digging(fleet), rect.connect("wombat-3", router=fleet.endpoint(2), program="scout") as scout:
        run = scout.start("wombat-2", "dig", -7, timeout=TIMEOUT_S)
        open_view(page, dashboard)
        expect(running(page)).to_contain_text("started by wombat-3/scout")
        expect(running(page)).to_contain_text("Value: -7")
        start(page, "2")
        preempted = ends(page).filter(has_text="preempted by a newer goal of wombat-1")
        expect(preempted.first).to_contain_text("started by wombat-3/scout")
        with pytest.raises(rect.ActionError, match="preempted"):
            run.result(timeout=TIMEOUT_S)


def test_a_stop_is_the_reason_of_an_end_and_refuses_new_goals(page: Page, fleet: Fleet, dashboard: str) -> None:
    with digging(fleet) as robot:
        stop = robot.fleet_stop()
        open_view(page, dashboard)
        start(page, "-1")
        expect(running(page)).to_contain_text("is carried out")
        try:
            stop.press("the table edge")
            expect(ends(page).first).to_contain_text("cancelled")
            expect(ends(page).first).to_contain_text("the table edge")
            start(page, "1")
            expect(card(page).get_by_role("status").first).to_contain_text("the table edge")
        finally:
            stop.release()
        expect(page.locator(".stop-area")).to_be_hidden()
        start(page, "1")
        expect(ends(page).first).to_contain_text('Result: {"dug":1}')
        expect(card(page)).not_to_contain_text("refused")


def test_a_goal_whose_program_has_ended_is_lost(page: Page, fleet: Fleet, dashboard: str) -> None:
    code = threading.Event()
    with rect.connect("wombat-2", router=fleet.endpoint(1), program="digger") as robot:

        @robot.action("dig", lost_after=None)
        def dig(goal: rect.Goal[Any]) -> None:
            code.wait(TIMEOUT_S)

        open_view(page, dashboard)
        start(page, "1")
        expect(running(page)).to_contain_text("is carried out")
        # As if it had been killed: nothing reports the end of the goal.
        robot.zenoh.close()
    code.set()
    expect(card(page)).to_contain_text("its program has ended")
    expect(page.get_by_role("button", name="Start wombat-2/dig")).to_be_disabled()
    expect(ends(page).first).to_contain_text("lost: its program has ended")


def test_actions_are_no_services_and_goals_are_received_only_while_they_are_shown(
    page: Page, fleet: Fleet, dashboard: str
) -> None:
    sent: list[str] = []
    page.on("websocket", lambda socket: socket.on("framesent", lambda text: sent.append(str(text))))
    with digging(fleet) as robot:
        robot.serve("grab", lambda request: None)
        page.goto(f"{dashboard}/#services")
        services = page.get_by_role("region", name="wombat-2", exact=True)
        expect(services).to_contain_text("grab")
        expect(services).not_to_contain_text("actions/dig")
        assert not any('"actions":true' in text for text in sent)
        open_view(page, dashboard)
        start(page, "-1")
        expect(running(page)).to_contain_text("25 %")
        page.goto(f"{dashboard}/#services")
        expect(services).to_contain_text("grab")
        orders = [json.loads(text) for text in sent]
        assert {"type": "show", "topics": False, "actions": False} in orders
        # The goal goes on meanwhile.
        open_view(page, dashboard)
        expect(running(page)).to_contain_text("is carried out")


def test_topics_of_goals_are_listed_only_if_the_filter_names_them(page: Page, fleet: Fleet, dashboard: str) -> None:
    with digging(fleet) as robot:
        robot.publish("mode", "auto", retained=True)
        run = robot.start("wombat-2", "dig", 3)
        run.result(timeout=TIMEOUT_S)
        page.goto(f"{dashboard}/#topics")
        topics = page.get_by_role("region", name="Topics")
        expect(topics).to_contain_text("wombat-2/mode")
        expect(topics).not_to_contain_text("actions/dig")
        page.get_by_label("Filter topics").fill("actions/dig")
        expect(topics).to_contain_text(f"wombat-2/actions/dig/{run.id}")


def test_a_page_that_only_shows_has_no_buttons(page: Page, fleet: Fleet) -> None:
    with digging(fleet) as robot, fleet.dashboard("--read-only") as url:
        page.goto(f"{url}/#actions")
        expect(card(page)).to_contain_text("digs a hole")
        run = robot.start("wombat-2", "dig", -1)
        expect(running(page)).to_contain_text("25 %")
        for role in ("button", "textbox"):
            expect(card(page).get_by_role(role)).to_have_count(0)
        with socket_of(url) as connection:
            fields = {"robot": "wombat-2", "action": "dig"}
            assert "--read-only" in command(connection, type="start_action", id=1, value="1", **fields)["error"]
            assert "--read-only" in command(connection, type="cancel_action", id=2, goal=run.id, **fields)["error"]
        assert run.phase == "running"


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"type": "start_action", "robot": "wombat-2", "action": "dug", "value": ""}, "did you mean dig?"),
        ({"type": "start_action", "robot": "a b", "action": "dig", "value": ""}, "a b"),
        ({"type": "start_action", "robot": "wombat-2", "action": "../x", "value": ""}, "action"),
        ({"type": "start_action", "robot": "wombat-2", "action": "dig", "value": f'"{"x" * 60_000}"'}, "at most"),
        ({"type": "cancel_action", "robot": "wombat-2", "action": "dig", "goal": "none"}, "none"),
        ({"type": "cancel_action", "robot": "wombat-2", "action": "dig", "goal": "a/b"}, "a/b"),
    ],
)
def test_invalid_orders_are_answered_with_their_problem(
    fleet: Fleet, dashboard: str, fields: dict[str, Any], problem: str
) -> None:
    with digging(fleet), socket_of(dashboard) as connection:
        answer = command(connection, id=1, **fields)
        assert answer["error"] and problem in answer["error"], answer
