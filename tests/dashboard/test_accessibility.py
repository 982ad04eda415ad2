"""Checks every view with axe, in both themes and at two widths."""

from __future__ import annotations

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import Fleet
from playwright.sync_api import Browser, expect
from test_log import Program
from test_views import repeat

VIEWS = [
    "fleet",
    "log",
    "topics/wombat-2%2Farm%2Fstate",
    "services",
    "actions",
    "parameters",
    "cameras",
    "connections",
    "events",
]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_views_are_accessible(chromium: Browser, fleet: Fleet, dashboard: str, scheme: str, width: int) -> None:
    context = chromium.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page = context.new_page()
    with fleet.program(1) as robot, repeat(robot, "arm/state", lambda number: {"angle": number % 10}):
        for view in VIEWS:
            page.goto(f"{dashboard}/#{view}")
            expect(page.locator(".condition")).to_have_text("live")
            # The heading of the view before is there until the browser has told the page that the address has changed.
            heading = page.get_by_role("heading", level=1, name=view.split("/")[0])
            expect(heading).to_be_visible()
            if view == "fleet":
                expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("ble")
            if view == "log":
                Program(robot, "arm").log("slow", level="warn", logger="gripper", source="arm.py:12")
                expect(page.locator(".entry").first).to_be_visible()
            if view == "actions":
                action = robot.action("dig", lambda goal: goal.sleep(60), about="digs a hole")
                for _ in range(2):
                    run = robot.start("wombat-2", "dig", 3)
                expect(page.get_by_role("progressbar", include_hidden=True)).to_have_count(1)
                expect(page.get_by_text("preempted").first).to_be_visible()
            if view.startswith("topics"):
                expect(page.locator(".plot canvas")).to_be_visible()
            violations = Axe().run(page).response["violations"]
            assert violations == [], (view, [(found["id"], found["nodes"][0]["html"]) for found in violations])
            overflow = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            assert overflow <= 0, view
            if view == "actions":
                run.cancel()
                action.close()
    context.close()
