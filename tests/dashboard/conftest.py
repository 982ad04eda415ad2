"""Defines fixtures: robots on the simulated air, the dashboard at a router, and a page in headless Chromium.

The job `dashboard` runs these tests (`scripts/test dashboard`)."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rect
import zenoh
from playwright.sync_api import Browser, Page, expect, sync_playwright

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "demo"))

import serving  # noqa: E402
from robots import rect_settings  # noqa: E402
from room import Room  # noqa: E402

#: How long to wait for something to appear, in milliseconds. A test machine may be busy with other builds.
DEADLINE_MS = 30_000
ROBOTS = int(os.environ.get("RECT_DASHBOARD_ROBOTS", "6"))

expect.set_options(timeout=DEADLINE_MS)


class Fleet:
    """Robots on the simulated air, all linked with each other."""

    def __init__(self, room: Room, robots: list[Any]) -> None:
        self.room = room
        self.robots = robots

    def endpoint(self, index: int) -> str:
        return self.robots[index].endpoint()

    @contextmanager
    def program(self, index: int) -> Iterator[rect.Robot]:
        """Connects a program of a robot."""
        with rect.connect(self.robots[index].name, router=self.endpoint(index)) as robot:
            yield robot

    def until_served(self, robot: str, topic: str) -> None:
        """Waits until the router of the first robot knows a service of another one."""
        deadline = time.monotonic() + DEADLINE_MS / 1000
        with self.program(0) as program:
            destination = zenoh.Locality.REMOTE
            querier = program.zenoh.declare_querier(f"rect/{robot}/{topic}", allowed_destination=destination)
            while not querier.matching_status.matching:
                assert time.monotonic() < deadline, f"{robot} does not serve {topic}"
                time.sleep(0.01)

    @contextmanager
    def dashboard(self, *options: str, index: int = 0) -> Iterator[str]:
        """Runs the dashboard at the router of a robot, and yields its address."""
        with serving.dashboard(self.endpoint(index), *options) as (url, _):
            yield url


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp("connections")
    with Room("desk") as room:
        robots = []
        for number in range(1, ROBOTS + 1):
            name = f"wombat-{number}"
            file = folder / f"{name}.json"
            file.write_text('{"connections": []}')
            settings = rect_settings({"robot": name, "connections": str(file)})
            robots.append(room.add_robot(name, arguments=tuple(settings)))
        yield Fleet(room, robots)


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keeps the lines that dashboards have seen in a folder of these tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="session")
def dashboard(fleet: Fleet, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("recordings")
    with fleet.dashboard("--record", str(folder), "--embed-in", "http://127.0.0.1:1") as url:
        yield url


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = serving.launched(playwright)
        yield browser
        browser.close()


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    """A page. The test fails if a script on it does."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, ignore_https_errors=True)
    context.set_default_timeout(DEADLINE_MS)
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    yield page
    context.close()
    assert errors == []
