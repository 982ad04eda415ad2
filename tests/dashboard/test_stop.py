"""Tests the Stop button in Chromium. The dashboards of other robots are the programs that take part in stops."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
import serving
from conftest import ROBOTS, Fleet
from playwright.sync_api import Browser, Locator, Page, expect


def area(page: Page) -> Locator:
    return page.get_by_role("region", name="Stop", exact=True)


def robot(page: Page, number: int) -> Locator:
    return area(page).locator(".followers li").filter(has_text=f"wombat-{number}")


def release(page: Page) -> None:
    area(page).get_by_role("button", name="Release…").click()
    expect(area(page)).to_contain_text("nothing moves: each robot waits for a neutral command first")
    area(page).get_by_role("button", name="Release the stop").click()
    expect(area(page)).to_be_hidden()


@pytest.fixture(autouse=True)
def released(chromium: Browser, dashboard: str) -> Iterator[None]:
    """Leaves no stop to other tests."""
    yield
    page = chromium.new_page()
    page.goto(dashboard)
    expect(page.locator(".condition")).to_have_text("live")
    with suppress(AssertionError):
        expect(area(page)).to_be_visible(timeout=2000)
        release(page)
    page.close()


@contextmanager
def taking_part(fleet: Fleet, index: int) -> Iterator[int]:
    """Runs a program of a robot that takes part in stops. Yields its process."""
    with serving.dashboard(fleet.endpoint(index)) as (_, pid):
        yield pid


def test_each_robot_is_listed_by_its_answer_in_all_browsers(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.goto(dashboard)
    other = page.context.new_page()
    other.goto(dashboard)
    with taking_part(fleet, 1), taking_part(fleet, 2) as hung, taking_part(fleet, 3):
        for number in (2, 3, 4):
            expect(page.get_by_role("region", name=f"wombat-{number}", exact=True)).to_contain_text("✓ reachable")
        page.get_by_role("button", name="STOP").click()
        for browser in (page, other):
            for number in (2, 3, 4):
                expect(robot(browser, number)).to_contain_text(re.compile(r"✓ wombat-\d has confirmed after \d"))
            expect(robot(browser, 5)).to_contain_text("- wombat-5 takes no part in stops: no program of it listens")
            expect(area(browser)).to_contain_text("The fleet is stopped: confirmed by 3 of 3")
            expect(area(browser)).to_contain_text(re.compile(r"since \d\d:\d\d:\d\d by wombat-1: dashboard"))
        release(other)
        expect(area(page)).to_be_hidden()
        os.kill(hung, signal.SIGSTOP)
        try:
            page.get_by_role("button", name="STOP").click()
            expect(robot(page, 2)).to_contain_text("✓")
            expect(robot(page, 3)).to_have_class("error")
            expect(robot(page, 3)).to_contain_text("✗ wombat-3 has not confirmed")
        finally:
            os.kill(hung, signal.SIGCONT)
        expect(robot(page, 3)).to_contain_text("✓ wombat-3 has confirmed")


def test_stop_remains_after_reload_and_restart_and_reaches_robots_that_return(
    page: Page, fleet: Fleet, dashboard: str
) -> None:
    with taking_part(fleet, 1):
        with fleet.dashboard() as url:
            page.goto(url)
            expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("✓ reachable")
            page.get_by_role("button", name="STOP").click()
            expect(robot(page, 2)).to_contain_text("✓ wombat-2 has confirmed after")
            page.reload()
            expect(robot(page, 2)).to_contain_text("✓ wombat-2 has confirmed after")
        with fleet.dashboard() as url:
            page.goto(url)
            expect(robot(page, 2)).to_have_text("✓ wombat-2 has confirmed")
            expect(area(page)).to_contain_text("by wombat-1: dashboard")
            fleet.room.cut()
            try:
                expect(robot(page, 2)).to_contain_text("✗ wombat-2 cannot be reached")
                page.get_by_role("button", name="STOP").click()
                expect(area(page)).to_contain_text(f"confirmed by 0 of {ROBOTS - 1}")
            finally:
                fleet.room.restore()
            expect(robot(page, 2)).to_contain_text("✓ wombat-2 has confirmed")
            # One that had confirmed before it was out of reach.
            fleet.room.cut()
            try:
                expect(robot(page, 2)).to_contain_text("✗ wombat-2 cannot be reached")
            finally:
                fleet.room.restore()
            expect(robot(page, 2)).to_contain_text("✓ wombat-2 has confirmed")


def test_stop_that_was_pressed_elsewhere_is_shown_and_released_here(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.goto(dashboard)
    with fleet.dashboard(index=1) as elsewhere:
        other = page.context.new_page()
        other.goto(elsewhere)
        other.get_by_role("button", name="STOP").click()
        expect(area(page)).to_contain_text(re.compile(r"since \d\d:\d\d:\d\d by wombat-2: dashboard"))
        expect(robot(page, 2)).to_have_text("✓ wombat-2 has confirmed")
        area(page).get_by_role("button", name="Release…").click()
        area(page).get_by_role("button", name="Keep it").click()
        expect(area(other)).to_be_visible()
        release(page)
        expect(area(other)).to_be_hidden()


def test_stop_without_the_router_is_not_sent_until_it_is_back(page: Page, fleet: Fleet) -> None:
    with taking_part(fleet, 1), fleet.dashboard(index=ROBOTS - 1) as url:
        page.goto(url)
        expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("✓ reachable")
        fleet.robots[-1].stop()
        try:
            expect(page.locator(".condition")).to_have_text("the router does not answer")
            page.get_by_role("button", name="STOP").click()
            expect(area(page)).to_contain_text("Not sent: the router of this computer cannot be reached")
            expect(robot(page, 2)).to_contain_text("✗ wombat-2 cannot be reached")
        finally:
            fleet.robots[-1].start()
        expect(robot(page, 2)).to_contain_text("✓ wombat-2 has confirmed")
        expect(area(page)).not_to_contain_text("Not sent")
        release(page)
