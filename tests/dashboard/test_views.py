"""Tests what the dashboard shows, and what can be done with it, in Chromium with robots on the simulated air."""

from __future__ import annotations

import csv
import io
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy
import pytest
import rect
import serving
from conftest import ROBOTS, Fleet
from PIL import Image
from playwright.sync_api import Page, expect


@contextmanager
def repeat(robot: rect.Robot, topic: str, values: Callable[[int], Any]) -> Iterator[None]:
    """Publishes values on a topic at 20 Hz, until the end of the block."""
    ends = threading.Event()

    def run() -> None:
        number = 0
        while not ends.wait(0.05):
            robot.publish(topic, values(number))
            number += 1

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


def picture(number: int) -> rect.Payload:
    image = Image.new("RGB", (32, 24), (number * 8 % 256, 80, 80))
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return rect.Payload(buffer.getvalue(), "image/png")


def test_robots_and_their_links_are_shown(page: Page, dashboard: str) -> None:
    page.goto(dashboard)
    for number in range(1, ROBOTS + 1):
        card = page.get_by_role("region", name=f"wombat-{number}", exact=True)
        expect(card).to_contain_text("this robot" if number == 1 else "reachable")
    own = page.get_by_role("region", name="wombat-1", exact=True)
    expect(own.get_by_role("row")).to_have_count(ROBOTS)
    expect(own).to_contain_text("ble")
    links = ROBOTS * (ROBOTS - 1) // 2
    expect(page.get_by_role("img", name=f"{ROBOTS} robots, {links} links")).to_be_visible()
    linked = own.get_by_role("row", name=re.compile("wombat-2"))
    # How long an urgent message takes, what waits, and what was lost.
    expect(linked.get_by_role("cell").nth(4)).to_have_text(re.compile(r"^\d.* ms$"))
    expect(linked.get_by_role("cell").nth(7)).to_have_text(re.compile(r"\d k?B"))
    expect(linked.get_by_role("cell").nth(8)).to_have_text("0 dropped")


def test_bytes_that_wait_are_shown(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.program(0) as robot, fleet.program(1) as other, other.subscribe("wombat-1/large"):
        large = robot.publisher("large", urgency="bulk")
        large.wait_for_subscriber(30)
        page.goto(dashboard)
        own = page.get_by_role("region", name="wombat-1", exact=True)
        waiting = own.get_by_role("row", name=re.compile("wombat-2")).get_by_role("cell").nth(7)
        expect(waiting).to_have_text("0 B")
        large.publish(bytes(400_000))
        expect(waiting).to_have_text(re.compile(r"Background \d+ kB"))


def test_map_of_many_robots_shows_each_name(page: Page, dashboard: str) -> None:
    page.goto(dashboard)
    expect(page.locator(".picture").first).to_be_attached()
    names, outside = page.evaluate("""async () => {
      const { drawMap } = await import("/assets/map.js");
      const figure = document.querySelector(".picture").cloneNode();
      document.body.append(figure);
      const names = Array.from({ length: 45 }, (_, index) => `wombat-${45 - index}`);
      const robots = names.map((name) => ({ name, reachable: true, problems: [], connections: [] }));
      drawMap(figure, robots, "wombat-1");
      const frame = figure.querySelector("svg").getBoundingClientRect();
      const isOutside = ({ left, right, top, bottom }) =>
        left < frame.left || right > frame.right || top < frame.top || bottom > frame.bottom;
      const texts = [...figure.querySelectorAll("text")];
      const outside = texts.filter((text) => isOutside(text.getBoundingClientRect()));
      return [texts.map((text) => text.textContent), outside.length];
    }""")
    assert (names, outside) == ([f"wombat-{number}" for number in range(1, 46)], 0)


def test_a_robot_is_checked(page: Page, dashboard: str) -> None:
    page.goto(dashboard)
    page.get_by_role("button", name="Check wombat-2").click()
    other = page.get_by_role("region", name="wombat-2", exact=True)
    expect(other).to_contain_text("kernel: Linux")
    expect(other).to_contain_text("✓ adapter: sim-wombat-2, of the simulated air")


def test_cut_and_restored_radio_is_shown(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.goto(dashboard)
    other = page.get_by_role("region", name="wombat-2", exact=True)
    expect(other).to_contain_text("✓ reachable")
    fleet.room.cut()
    try:
        expect(other).to_contain_text("✗ not reachable")
        page.goto(f"{dashboard}/#events")
        expect(page.get_by_role("row", name=re.compile("robot not reachable wombat-2")).first).to_be_visible()
    finally:
        fleet.room.restore()
    page.goto(f"{dashboard}/#fleet")
    expect(other).to_contain_text("✓ reachable")


def test_topics_are_listed_shown_and_plotted(page: Page, fleet: Fleet, dashboard: str) -> None:
    with (
        fleet.program(1) as robot,
        repeat(robot, "arm/state", lambda number: {"angle": number % 10, "at": {"x": 1.5}}),
    ):
        page.goto(f"{dashboard}/#topics")
        page.get_by_label("Filter topics").fill("arm state")
        line = page.get_by_role("button", name="wombat-2/arm/state")
        expect(line).to_contain_text("Hz")
        line.click()
        expect(page.locator(".tree")).to_contain_text("x: 1.5")
        # The part that was chosen by keyboard stays so while values arrive.
        part = page.locator(".tree summary").last
        part.focus()
        expect(page.locator(".tree")).not_to_have_text(page.locator(".tree").inner_text())
        expect(part).to_be_focused()
        expect(page.locator(".plot canvas")).to_be_visible()
        for series in ("angle", "at.x"):
            expect(page.get_by_role("group", name="Series").get_by_label(series)).to_be_checked()
        page.get_by_role("button", name="Pause").click()
        with page.expect_download() as download:
            page.get_by_role("button", name="Save as CSV").click()
        rows = list(csv.DictReader(Path(download.value.path()).read_text().splitlines()))
        assert {row["at.x"] for row in rows} == {"1.5"}
        assert all(0 <= float(row["angle"]) < 10 for row in rows)


def test_array_of_numbers_is_shown_and_plotted(page: Page, fleet: Fleet, dashboard: str) -> None:
    def array(number: int) -> Any:
        return numpy.array([number, 0.5, numpy.nan], numpy.float32)

    with fleet.program(1) as robot, repeat(robot, "ranges", array):
        page.goto(f"{dashboard}/#topics")
        # The document contains only the topics that the list shows at the moment.
        page.get_by_label("Filter topics").fill("ranges")
        page.get_by_role("button", name="wombat-2/ranges").click()
        expect(page.locator(".tree")).to_contain_text("2: NaN")
        expect(page.locator(".plot canvas")).to_be_visible()
        for series in ("0", "1"):
            expect(page.get_by_role("group", name="Series").get_by_label(series, exact=True)).to_be_checked()


def test_values_are_published_sent_and_requested(page: Page, fleet: Fleet, dashboard: str) -> None:
    with (
        fleet.program(1) as robot,
        robot.subscribe("wombat-1/led") as messages,
        robot.serve("double", lambda request: request.value * 2),
    ):
        page.goto(f"{dashboard}/#topics")
        form = page.get_by_role("form", name="Publish and request")
        form.get_by_label("Topic").fill("led")
        form.get_by_label("Value").fill('{"on": true}')
        form.get_by_role("button", name="Publish").click()
        expect(form).to_contain_text("Published.")
        message = messages.next(30)
        assert (message.topic, message.value, message.recipient) == ("led", {"on": True}, None)
        form.get_by_label("What").select_option("Send to one robot")
        form.get_by_role("combobox", name="Robot").fill("wombat-2")
        form.get_by_label("urgent").check()
        form.get_by_role("button", name="Send").click()
        expect(form).to_contain_text("Sent to wombat-2.")
        message = messages.next(30)
        assert (message.recipient, message.urgency) == ("wombat-2", "urgent")
        form.get_by_label("What").select_option("Request a service")
        form.get_by_role("textbox", name="Service").fill("double")
        form.get_by_label("Value").fill("21")
        form.get_by_role("button", name="Request").click()
        expect(form).to_contain_text("42 (after")
        form.get_by_role("textbox", name="Service").fill("nothing")
        form.get_by_role("button", name="Request").click()
        expect(form.get_by_role("status")).to_contain_text("nothing")
        form.get_by_role("textbox", name="Service").fill("a/*")
        form.get_by_role("button", name="Request").click()
        expect(form.get_by_role("status")).to_contain_text("wildcard")


def test_services_are_listed_and_requested(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.goto(f"{dashboard}/#services")
    with rect.connect("wombat-2", router=fleet.endpoint(1), program="arm") as arm:
        card = page.get_by_role("region", name="wombat-2", exact=True)
        row = card.get_by_role("row", name=re.compile("^arm"))
        expect(row).to_contain_text("serves nothing")
        service = arm.serve("grab", lambda request: request.value["force"] + 1, about="closes the gripper")
        expect(row).to_contain_text("closes the gripper")
        fleet.until_served("wombat-2", "grab")
        row.get_by_role("button", name="Request wombat-2/grab").click()
        form = page.get_by_role("form", name="Publish and request")
        expect(form.get_by_role("combobox", name="Robot")).to_have_value("wombat-2")
        form.get_by_label("Value, JSON or text").fill('{"force": 3}')
        form.get_by_role("button", name="Request").click()
        expect(form.get_by_role("status")).to_contain_text("4 (after")
        service.close()
        expect(row).to_contain_text("serves nothing")
    expect(card).to_be_hidden()


def test_view_is_shown_once_so_that_typed_text_is_kept(page: Page, dashboard: str) -> None:
    page.add_init_script("""
        globalThis.views = 0;
        new MutationObserver((changes) => {
            const added = changes.flatMap(({ addedNodes }) => [...addedNodes]);
            views += added.filter(({ nodeName }) => nodeName === "H1").length;
        }).observe(document, { childList: true, subtree: true });
    """)
    page.goto(f"{dashboard}/#cameras")
    field = page.get_by_label("Topic of the camera")
    field.fill("wombat-2/camera")
    expect(page.locator("header .condition")).to_have_text("live")
    expect(field).to_have_value("wombat-2/camera")
    assert page.evaluate("views") == 1


def test_cameras_show_streams_with_age_and_rate(page: Page, fleet: Fleet, dashboard: str) -> None:
    with fleet.program(1) as robot, robot.stream("camera", mode="fixed") as stream:
        page.goto(f"{dashboard}/#cameras")
        page.get_by_label("Topic of the camera").fill("wombat-2/camera")
        page.get_by_role("button", name="Show").click()
        camera = page.get_by_role("figure", name="wombat-2/camera")
        deadline = time.monotonic() + 30
        number = 0
        while "old" not in camera.inner_text() and time.monotonic() < deadline:
            stream.send(picture(number))
            number += 1
            page.wait_for_timeout(100)
        expect(camera).to_contain_text(re.compile(r"Hz · \d.* old"))
        expect(camera.locator("canvas")).to_be_visible()
        assert camera.locator("canvas").evaluate("canvas => [canvas.width, canvas.height]") == [32, 24]
        page.goto(f"{dashboard}/?embed=camera/wombat-2/camera")
        expect(page.locator("header")).to_have_count(0)
        expect(page.get_by_role("figure", name="wombat-2/camera")).to_be_visible()


@pytest.mark.parametrize("decodes", [True, False], ids=["in the browser", "in the program"])
def test_cameras_show_video(page: Page, fleet: Fleet, dashboard: str, decodes: bool) -> None:
    if not decodes:
        page.add_init_script("delete globalThis.VideoDecoder")
    with fleet.program(1) as robot, robot.stream("video", mode="video") as stream:
        page.goto(f"{dashboard}/#cameras")
        assert page.evaluate("'VideoDecoder' in globalThis") == decodes
        page.get_by_label("Topic of the camera").fill("wombat-2/video")
        page.get_by_role("button", name="Show").click()
        camera = page.get_by_role("figure", name="wombat-2/video")
        canvas = camera.locator("canvas")
        deadline = time.monotonic() + 30
        colours = set()
        number = 0
        while len(colours) < 3 and time.monotonic() < deadline:
            # The picture gets brighter.
            stream.send(numpy.full((120, 160, 3), number * 8 % 256, numpy.uint8))
            number += 1
            page.wait_for_timeout(100)
            if canvas.is_visible():
                pixel = "canvas => canvas.getContext('2d').getImageData(80, 60, 1, 1).data[0]"
                colours.add(canvas.evaluate(pixel))
        assert len(colours) >= 3, camera.inner_text()
        assert canvas.evaluate("canvas => [canvas.width, canvas.height]") == [160, 120]
        expect(camera).to_contain_text(re.compile(r"Hz · \d.* old"))
        group = stream.status["groups"][0]
        assert group["video"]["key_frames"] >= 1


def test_connections_are_added_and_removed_and_errors_are_shown_at_their_field(page: Page, dashboard: str) -> None:
    page.goto(f"{dashboard}/#connections")
    form = page.get_by_role("form", name="Add a connection")
    expect(form.get_by_label("Robot", exact=True)).to_have_value("wombat-1")
    form.get_by_label("Name").fill("base")
    form.get_by_label("Method").select_option("tcp")
    form.get_by_label("Robot or host").fill("127.0.0.1")
    form.get_by_role("button", name="Add").click()
    port = form.get_by_label("Port")
    expect(port).to_have_attribute("aria-invalid", "true")
    expect(form.locator("#error-port")).not_to_be_empty()
    port.fill("9")
    form.get_by_role("button", name="Add").click()
    row = page.get_by_role("row", name=re.compile("wombat-1 base tcp"))
    expect(row).to_contain_text("connecting")
    page.on("dialog", lambda dialog: dialog.accept())
    row.get_by_role("button", name="Remove base of wombat-1").click()
    expect(row).to_have_count(0)


def test_record_button_makes_a_recording(page: Page, fleet: Fleet, dashboard: str) -> None:
    page.goto(dashboard)
    page.get_by_role("button", name="Record", exact=True).click()
    expect(page.locator("#notices")).to_contain_text("Recording to")
    padding = "-" * 1000
    with fleet.program(0) as robot, repeat(robot, "count", lambda number: {"number": number, "padding": padding}):
        # The recording begins with the retained values of the fleet, which are far smaller.
        expect(page.get_by_role("button", name=re.compile(r"Recording [2-9]\d\.?\d* kB"))).to_be_visible()
    page.get_by_role("button", name=re.compile("Recording")).click()
    expect(page.locator("#notices")).to_contain_text("Recorded")
    text = page.locator("#notices").inner_text()
    found = re.search(r"Recorded (\S+\.mcap): \d+ messages", text)
    assert found, text
    values = [message.value["number"] for message in rect.Recording(found[1]) if message.topic == "count"]
    assert values == list(range(values[0], values[0] + len(values)))


def test_page_connects_again_when_the_dashboard_is_restarted(page: Page, fleet: Fleet) -> None:
    with fleet.dashboard() as url:
        page.goto(url)
        expect(page.locator(".condition")).to_have_text("live")
    expect(page.locator(".condition")).to_contain_text("disconnected")
    address = url.removeprefix("http://")
    with fleet.dashboard("--listen", address):
        expect(page.locator(".condition")).to_have_text("live")
        expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("✓ reachable")


def test_lost_router_is_shown(page: Page, fleet: Fleet) -> None:
    with fleet.dashboard(index=ROBOTS - 1) as url:
        page.goto(url)
        expect(page.locator(".condition")).to_have_text("live")
        fleet.robots[-1].stop()
        try:
            expect(page.locator(".condition")).to_have_text("the router does not answer")
        finally:
            fleet.robots[-1].start()
        expect(page.locator(".condition")).to_have_text("live")


def test_first_data_arrives_within_seconds_and_the_page_is_small(page: Page, fleet: Fleet, dashboard: str) -> None:
    responses: list[Any] = []
    page.on("response", lambda response: responses.append(response))
    page.goto(dashboard)
    expect(page.get_by_role("region", name="wombat-1", exact=True)).to_be_visible()
    sizes = [len(response.body()) for response in responses]
    assert 50_000 < sum(sizes) < 150_000, sizes


def test_thousand_topics_are_listed_without_as_many_elements(page: Page, dashboard: str) -> None:
    serving.list_topics(page, 1000)
    page.goto(f"{dashboard}/#topics")
    expect(page.get_by_text("1000 of 1000")).to_be_visible()
    lines = page.locator(".lines li")
    assert lines.count() < 60
    page.locator(".list").evaluate("list => list.scrollTo(0, list.scrollHeight)")
    expect(page.get_by_role("button", name="sensor/999")).to_be_visible()
    assert lines.count() < 60


def test_silent_connection_is_given_up_and_replaced(page: Page, fleet: Fleet) -> None:
    # As after a laptop has slept, or has left the range of the Wi-Fi: the connection is open, and nothing arrives.
    with serving.dashboard(fleet.endpoint(0)) as (url, pid):
        page.goto(url)
        condition = page.locator(".condition")
        expect(condition).to_have_text("live")
        os.kill(pid, signal.SIGSTOP)
        try:
            expect(condition).to_contain_text("disconnected")
        finally:
            os.kill(pid, signal.SIGCONT)
        expect(condition).to_have_text("live")
        expect(page.get_by_role("region", name="wombat-2", exact=True)).to_contain_text("✓ reachable")
