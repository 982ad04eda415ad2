"""Measures `rect dashboard` with pages in headless Chromium: what the page costs the air, urgent messages, memory and
processor time, how soon it shows something, and how smoothly."""

import statistics
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import rect
from pairs import carried
from playwright.sync_api import Browser, Page, Playwright, Response, expect, sync_playwright
from robots import rect_settings
from room import Room, wait_for_link
from routers import own_kb
from table import Table
from traffic import percentile

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "dashboard"))

from recording import processor_ms
from serving import dashboard, launched, list_topics

SECONDS = 60
TOPICS, TOPICS_HZ = 20, 10
FAST_HZ = 500
URGENT_EVERY_S = 0.05
DEADLINE_MS = 30_000
MANY_TOPICS, DRAWN_MS = 1000, 10_000
#: Returns the times between the frames that the browser draws, in milliseconds.
DRAW = """ms => new Promise(resolve => {
  const [started, times] = [performance.now(), []];
  let last = started;
  function draw(now) {
    times.push(now - last);
    last = now;
    now - started < ms ? requestAnimationFrame(draw) : resolve(times);
  }
  requestAnimationFrame(draw);
})"""


@contextmanager
def publishing(robot: rect.Robot, topics: int, hertz: int) -> Iterator[None]:
    """Publishes values on topics of a robot until the end of the block."""
    publishers = [robot.publisher(f"sensor/{number}") for number in range(topics)]
    ends = threading.Event()

    def run() -> None:
        started, tick = time.monotonic(), 0
        while not ends.is_set():
            for publisher in publishers:
                publisher.publish({"tick": tick, "value": tick % 100})
            tick += 1
            time.sleep(max(0.0, started + tick / hertz - time.monotonic()))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


def urgent_ms(here: rect.Robot, there: rect.Robot) -> list[float]:
    """Sends urgent messages over the air for a time; returns how long each took, in milliseconds."""
    taken: list[float] = []

    def on_stop(message: rect.Message) -> None:
        taken.append(1000 * (time.monotonic() - message.value))

    with there.subscribe("wombat-2/stop", callback=on_stop):
        stop = here.publisher("stop", urgency="urgent")
        stop.wait_for_subscriber(20)
        ends = time.monotonic() + SECONDS
        while time.monotonic() < ends:
            stop.publish(time.monotonic())
            time.sleep(URGENT_EVERY_S)
    return taken


def opened(browser: Browser, url: str) -> tuple[Page, float, int]:
    """Opens the page; returns it, the milliseconds until it shows a robot, and the bytes that were transferred."""
    page = browser.new_page()
    responses: list[Response] = []
    page.on("response", lambda response: responses.append(response))
    started = time.monotonic()
    page.goto(url)
    expect(page.get_by_role("region", name="wombat-2", exact=True)).to_be_visible(timeout=DEADLINE_MS)
    shown_ms = 1000 * (time.monotonic() - started)
    return page, shown_ms, sum(len(response.body()) for response in responses)


def run() -> Table:
    table = Table(
        f"A page of the dashboard at wombat-1, which is linked with wombat-2 by Bluetooth: {TOPICS} topics there",
        ["page", "bytes/s on the air", "urgent p50", "p99", "private memory", "processor time"],
    )
    with ExitStack() as stack:
        room = stack.enter_context(Room("desk"))
        robots = [
            room.add_robot(name, arguments=tuple(rect_settings({"robot": name}))) for name in ("wombat-1", "wombat-2")
        ]
        wait_for_link(*robots)
        here = stack.enter_context(rect.connect("wombat-1", router=robots[0].endpoint()))
        there = stack.enter_context(rect.connect("wombat-2", router=robots[1].endpoint()))
        url, pid = stack.enter_context(dashboard(robots[0].endpoint()))
        playwright = stack.enter_context(sync_playwright())
        browser = launched(playwright)
        stack.enter_context(publishing(there, TOPICS, TOPICS_HZ))

        def measure(name: str) -> None:
            # The first answers after a change are not measured.
            time.sleep(12)
            before, cpu = carried(room), processor_ms(pid)
            taken = urgent_ms(there, here)
            rate = (carried(room) - before) / SECONDS
            used = (processor_ms(pid) - cpu) / SECONDS
            p50, p99 = (f"{percentile(taken, share):.1f} ms" for share in (0.5, 0.99))
            table.add(name, f"{rate:.0f}", p50, p99, f"{own_kb(pid) / 1000:.1f} MB", f"{used:.1f} ms/s")

        measure("none")
        page, shown_ms, size = opened(browser, url)
        measure("fleet")
        page.goto(f"{url}/#topics")
        measure("topics")
        others = [opened(browser, url)[0] for _ in range(2)]
        measure("three: topics, fleet, fleet")
        for other in others:
            other.close()
        with publishing(here, 1, FAST_HZ):
            page.goto(f"{url}/#topics/wombat-1%2Fsensor%2F0")
            measure(f"a plot of a topic of wombat-1 with {FAST_HZ} messages/s")
        page.close()
        with publishing(here, 1, FAST_HZ):
            frames_per_s, longest_ms = drawn(browser, url)
        browser.close()
        again = statistics.median(reopened(playwright, url) for _ in range(3))
    table.notes.append(
        f"The page transfers {size / 1000:.0f} kB, and shows the robots {shown_ms:.0f} ms after it was opened, for the "
        f"first time since the dashboard was started, and {again:.0f} ms (median of 3) later. The urgent messages, "
        f"{1 / URGENT_EVERY_S:.0f} per second, are part of the bytes on the air. With a list of {MANY_TOPICS} topics "
        f"that is scrolled, and the plot of a topic with {FAST_HZ} messages/s, headless Chromium draws "
        f"{frames_per_s:.0f} frames/s (at most 60); 99 of 100 frames follow the one before within {longest_ms:.0f} ms."
    )
    return table


def drawn(browser: Browser, url: str) -> tuple[float, float]:
    """Returns how many frames per second a busy page draws, and the 99th percentile of the milliseconds between two."""
    page = browser.new_page()
    list_topics(page, MANY_TOPICS)
    page.goto(f"{url}/#topics/wombat-1%2Fsensor%2F0")
    expect(page.locator(".plot canvas")).to_be_visible(timeout=DEADLINE_MS)
    page.locator(".list").evaluate("list => setInterval(() => list.scrollBy(0, 7), 20)")
    times = page.evaluate(DRAW, DRAWN_MS)
    page.close()
    return 1000 * len(times) / sum(times), percentile(times, 0.99)


def reopened(playwright: Playwright, url: str) -> float:
    """Returns how long a new browser takes to show the robots, in milliseconds."""
    browser = launched(playwright)
    shown_ms = opened(browser, url)[1]
    browser.close()
    return shown_ms
