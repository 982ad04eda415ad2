"""Tests subscriptions for fewer messages (`max_hz`, `on_change`) between robots on the simulated air.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_throttle.py
"""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from typing import Any

import pytest
import rect
import zenoh
from conftest import DEADLINE, Pair, until
from programs import Routers


def numbers_of(subscriber: rect.Subscriber[Any], last: int) -> list[rect.Message[Any]]:
    """Returns the messages up to the one with the value `last`, which arrives although it comes too early."""
    messages: list[rect.Message[Any]] = []
    while not messages or messages[-1].value != last:
        messages.append(subscriber.next(DEADLINE))
    return messages


def publish_numbers(robot: rect.Robot, topic: str, count: int, every: float) -> float:
    """Publishes 0 to `count`. Returns how long that took."""
    publisher = robot.publisher(topic)
    began = time.monotonic()
    for number in range(count + 1):
        publisher.publish(number)
        time.sleep(every)
    return time.monotonic() - began


def until_throttled(publishing: rect.Robot, topic: str, subscriber: rect.Subscriber[Any]) -> None:
    """Waits until the wish of a subscriber has reached the robot that publishes."""

    def arrives() -> bool:
        publishing.publish(topic, -1)
        try:
            subscriber.next(0.1)
        except rect.TimedOut:
            return False
        return True

    until(arrives)


def air_bytes(routers: Routers) -> int:
    """Returns the bytes that wombat-1 has sent over the air so far."""
    adapters = routers.room.status()["adapters"]
    return sum(adapter["stats"]["sdu_bytes"] for adapter in adapters if adapter["name"] == "sim-wombat-1")


def test_each_of_three_receivers_gets_its_rate_and_the_largest_is_sent(routers: Routers) -> None:
    with ExitStack() as stack:
        one = stack.enter_context(routers.connect("wombat-1"))
        rates = [20.0, 5.0, 1.0]
        programs = [stack.enter_context(routers.connect("wombat-2")) for _ in rates]
        subscribers = [
            program.subscribe("wombat-1/three", max_hz=max_hz, capacity=1000)
            for program, max_hz in zip(programs, rates)
        ]
        for subscriber in subscribers:
            until_throttled(one, "three", subscriber)
        before = air_bytes(routers)
        took = publish_numbers(one, "three", 200, 0.01)
        counts = []
        for subscriber, max_hz in zip(subscribers, rates):
            messages = [message for message in numbers_of(subscriber, 200) if message.value >= 0]
            assert [message.value for message in messages] == sorted({message.value for message in messages})
            assert all(message.missed == 0 for message in messages)
            assert sum(message.skipped for message in messages) > 0
            # The first, the last, and a repetition.
            assert len(messages) <= took * max_hz + 4
            counts.append(len(messages))
        assert counts[0] > counts[1] > counts[2], counts
        sent = air_bytes(routers) - before
        # A message takes about 60 bytes. Sent as they are published, 200 of them take 10 kB.
        assert sent < (took * 20 + 10) * 100, (sent, took)


def test_wildcards_urgency_and_metadata_are_kept(routers: Routers) -> None:
    with (
        routers.connect("wombat-1") as one,
        routers.connect("wombat-2") as two,
        two.subscribe("*/kept/*", max_hz=10) as subscriber,
    ):
        until_throttled(one, "kept/a", subscriber)
        one.publish("kept/b", {"x": 1}, urgency="urgent")
        message = subscriber.next(DEADLINE)
        while message.topic != "kept/b":
            message = subscriber.next(DEADLINE)
        assert message.sender == "wombat-1"
        assert message.value == {"x": 1}
        assert message.urgency == "urgent"
        assert message.sequence is not None
        assert message.sent_at is not None
        assert message.skipped == 0
        # Messages to this robot alone arrive as they are sent.
        for number in range(5):
            one.send("wombat-2", "kept/c", number)
        sent = [subscriber.next(DEADLINE) for _ in range(5)]
        assert [message.value for message in sent] == [0, 1, 2, 3, 4]


def test_equal_values_do_not_cross_the_air(routers: Routers) -> None:
    with (
        routers.connect("wombat-1") as one,
        routers.connect("wombat-2") as two,
        two.subscribe("wombat-1/mode", on_change=True) as subscriber,
    ):
        until_throttled(one, "mode", subscriber)
        before = air_bytes(routers)
        for _ in range(100):
            one.publish("mode", "x" * 100)
        one.publish("mode", "last")
        values = [subscriber.next(DEADLINE).value]
        while values[-1] != "last":
            values.append(subscriber.next(DEADLINE).value)
        assert [value for value in values if value != -1] == ["x" * 100, "last"]
        assert air_bytes(routers) - before < 3000


def test_retained_topic_delivers_its_last_value(routers: Routers) -> None:
    with routers.connect("wombat-1") as one, routers.connect("wombat-2") as two:
        one.publish("state/of/arm", "folded", retained=True)
        with two.subscribe("wombat-1/state/of/*", max_hz=1) as subscriber:
            assert subscriber.next(DEADLINE).value == "folded"
            one.publish("state/of/arm", "stretched", retained=True)
            message = subscriber.next(DEADLINE)
            assert message.value == "stretched"
            assert message.retained is not None


def test_nothing_is_sent_for_a_program_that_has_ended(routers: Routers) -> None:
    with routers.connect("wombat-1") as one:
        with routers.connect("wombat-2") as two, two.subscribe("wombat-1/ended", max_hz=100) as subscriber:
            until_throttled(one, "ended", subscriber)

        def costs_nothing() -> bool:
            before = air_bytes(routers)
            for number in range(20):
                one.publish("ended", f"{number}" * 100)
            time.sleep(0.2)
            return air_bytes(routers) - before < 1000

        until(costs_nothing)


def test_stock_programs_are_throttled_too(routers: Routers) -> None:
    with (
        routers.connect("wombat-2") as two,
        routers.robots["wombat-1"].session() as stock,
        two.subscribe("wombat-1/stock", max_hz=5) as subscriber,
    ):
        until(lambda: stock.put("rect/wombat-1/stock", "text") is None and arrived(subscriber))
        received = 0
        for _ in range(100):
            stock.put("rect/wombat-1/stock", "text", encoding=zenoh.Encoding.TEXT_PLAIN)
        while arrived(subscriber):
            received += 1
        assert received < 20


def arrived(subscriber: rect.Subscriber[Any]) -> bool:
    try:
        subscriber.next(0.5)
    except rect.TimedOut:
        return False
    return True


def test_programs_without_a_router(pair: Pair) -> None:
    one, two = pair
    with two.subscribe("wombat-1/direct", max_hz=10) as subscriber:
        until_throttled(one, "direct", subscriber)
        sending = threading.Thread(target=publish_numbers, args=(one, "direct", 100, 0.005))
        sending.start()
        messages = numbers_of(subscriber, 100)
        sending.join()
        assert len(messages) < 60
        assert sum(message.skipped for message in messages) > 0


@pytest.mark.parametrize("max_hz", [0, -1, 0.001, 1e6, float("nan")])
def test_rate_out_of_range_is_refused(pair: Pair, max_hz: float) -> None:
    with pytest.raises(rect.OptionError, match=r"max_hz.*0\.01 to 1000 messages per second"):
        pair[0].subscribe("*/pose", max_hz=max_hz)
