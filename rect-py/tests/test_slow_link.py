"""Tests what a router reports about its slow links: the bytes on the air by topic, beside the count of the air.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_slow_link.py
"""

from __future__ import annotations

import json
import re
import subprocess
import threading
from typing import Any

import rect
from conftest import DEADLINE, repeating, until, until_subscribed
from programs import Routers, program

#: The topics that share the link: the sizes of their values, and their messages for each message of the slowest one.
TOPICS = {"camera": (900, 1), "pose": (18, 4), "battery": (60, 2)}
#: The number of messages of the slowest topic.
ROUNDS = 15
#: The routers count over this time, in seconds.
WINDOW = 5.0


def asked(session: Any) -> dict[str, Any]:
    """Asks the router of wombat-1, which counts from the first question on."""
    (reply,) = session.get("rect/wombat-1/@rect/topics", timeout=DEADLINE)
    answer: dict[str, Any] = json.loads(reply.ok.payload.to_bytes())
    return answer


def on_air(routers: Routers) -> int:
    """Returns the bytes that the air has carried from wombat-1 so far."""
    adapters = routers.room.status()["adapters"]
    return sum(adapter["stats"]["sdu_bytes"] for adapter in adapters if adapter["name"] == "sim-wombat-1")


def measured(routers: Routers, session: Any, robot: rect.Robot, subscriber: rect.Subscriber) -> tuple[Any, int]:
    """Publishes all topics, and returns what the router has counted of it, and what the air has."""
    while True:
        # The count before has ended, or its window is full.
        until(lambda: asked(session)["window_s"] in (0.0, WINDOW))
        began, before = asked(session)["window_s"], on_air(routers)
        sent = 0
        for _ in range(ROUNDS):
            for topic, (size, messages) in TOPICS.items():
                for _ in range(messages):
                    robot.publish(topic, bytes(size))
                    sent += 1
            for _ in range(sum(messages for _, messages in TOPICS.values())):
                subscriber.next(DEADLINE)
        after, answer = on_air(routers), asked(session)
        if began < WINDOW and answer["window_s"] < WINDOW:
            return answer, after - before


def test_the_bytes_of_all_topics_add_up_to_what_the_air_carries(routers: Routers) -> None:
    with (
        routers.robots["wombat-1"].session() as session,
        routers.connect("wombat-1", program="sender") as robot,
        routers.connect("wombat-2", program="receiver") as other,
        other.subscribe("wombat-1/*") as subscriber,
    ):
        for topic in TOPICS:
            until_subscribed(robot, topic)
        answer, carried = measured(routers, session, robot, subscriber)
    (link,) = answer["links"]
    assert link["link"] == "ble/wombat-2"
    sent = {row[0]: row[1] * answer["window_s"] for row in link["sent"]}
    assert abs(sum(sent.values()) / carried - 1) < 0.1, (sent, carried)
    for topic, (size, messages) in TOPICS.items():
        payload = ROUNDS * messages * size
        assert payload < sent[f"wombat-1/{topic}"] < payload + ROUNDS * messages * 80, sent
    assert "other" not in sent


def test_the_list_shows_what_topics_take_on_the_air(routers: Routers) -> None:
    with (
        routers.connect("wombat-1", program="sender") as robot,
        routers.connect("wombat-2", program="receiver") as other,
        other.subscribe("wombat-1/pose"),
    ):
        until_subscribed(robot, "pose")
        with repeating(0.05, lambda: robot.publish("pose", bytes(18))):
            with routers.tool("wombat-1", "topic", "list", "wombat-1") as tool:
                heads = tool.until("ON AIR/S").split("  ")
                assert [head.strip() for head in heads if head][3] == "ON AIR/S"
                row = tool.until("wombat-1/pose")
                assert re.search(r"pose +[0-9.]+ Hz +\d+ B +\d+ B +18 B", row), row
                assert re.match("wombat-1 sends over ble/wombat-2: .*pose ", tool.until("sends over"))
            with routers.tool("wombat-1", "topic", "info", "wombat-1/pose") as tool:
                assert re.match(r"on air: +\d+ B/s over ble/wombat-2", tool.until("on air:"))


def test_doctor_names_the_topic_that_fills_a_link(routers: Routers) -> None:
    ended = threading.Event()
    with (
        routers.robots["wombat-1"].session() as session,
        routers.connect("wombat-1", program="sender") as robot,
        routers.connect("wombat-2", program="receiver") as other,
        other.subscribe("wombat-1/*"),
    ):
        until_subscribed(robot, "camera")

        def fill() -> None:
            while not ended.is_set():
                robot.publish("camera", bytes(3000))

        def is_filled() -> bool:
            (link,) = asked(session)["links"]
            # The share is known once the link has measured its rate.
            shares = {topic: shares for topic, _, *shares in link["sent"]}
            return bool(sum(shares.get("wombat-1/camera", [])) > 0.9)

        filling = threading.Thread(target=fill)
        filling.start()
        try:
            until(is_filled)
            command = [program("RECT_TOOL", "rect"), "doctor", "--router", routers.endpoints["wombat-1"], "--json"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=2 * DEADLINE, check=False)
        finally:
            ended.set()
            filling.join()
    findings = [finding["what"] for finding in json.loads(done.stdout) if finding["about"] == "link"]
    (what,) = [what for what in findings if "takes" in what]
    expected = r"wombat-1/camera takes \d+ % of what ble/wombat-2 carries from wombat-1, .* camera \d+ %, .*free \d+ %"
    assert re.fullmatch(expected, what), what
