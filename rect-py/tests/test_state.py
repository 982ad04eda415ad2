"""Tests state that stays, between the programs of two robots whose routers are linked on the simulated air.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_state.py
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import rect
import zenoh
from conftest import DEADLINE, until
from programs import Routers, initialised_routers, linked_routers

#: How long nothing may arrive after which nothing is expected any more, in seconds.
QUIET = 1.0


@pytest.fixture(scope="module")
def state_routers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Routers]:
    with linked_routers(tmp_path_factory.mktemp("state")) as routers:
        yield routers


def values(subscriber: rect.Subscriber[Any], count: int) -> list[Any]:
    """Returns the values of the next messages."""
    return [subscriber.next(DEADLINE).value for _ in range(count)]


def nothing_more(subscriber: rect.Subscriber[Any]) -> None:
    with pytest.raises(rect.TimedOut):
        raise AssertionError(subscriber.next(QUIET))


def test_program_that_starts_late_receives_the_last_value(state_routers: Routers) -> None:
    with state_routers.connect("wombat-1") as one, state_routers.connect("wombat-2") as two:
        one.publish("late/mode", "auto", retained=True)
        one.publish("late/mode", "manual", retained=True)
        with two.subscribe("wombat-1/late/mode") as subscriber:
            first = subscriber.next(DEADLINE)
            assert first.value == "manual"
            assert first.retained is not None
            assert 0 < first.retained.age < DEADLINE
            assert not first.retained.has_ended
            one.publish("late/mode", "auto", retained=True)
            one.publish("late/mode", "auto", retained=True)
            assert values(subscriber, 2) == ["auto", "auto"]
            one.forget("late/mode")
            forgotten = subscriber.next(DEADLINE)
            assert forgotten.value is None
            assert forgotten.retained is not None
            assert forgotten.retained.is_forgotten
            nothing_more(subscriber)
        assert two.latest("wombat-1", "late/mode") is None


def test_value_stays_when_its_program_ends(state_routers: Routers) -> None:
    code = f"""
import rect
with rect.connect("wombat-1", router={state_routers.endpoints["wombat-1"]!r}, program="ends") as robot:
    robot.publish("ends/mode", {{"speed": 1.5}}, retained=True)
    input()
"""
    with state_routers.connect("wombat-2") as two:
        subscriber = two.subscribe("*/ends/mode", dict[str, float])
        with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as process:
            assert values(subscriber, 1) == [{"speed": 1.5}]
            process.kill()

        def has_ended() -> bool:
            latest = two.latest("wombat-1", "ends/mode", dict[str, float])
            assert latest is not None
            assert latest.value == {"speed": 1.5}
            assert latest.retained is not None
            return latest.retained.has_ended

        until(has_ended)
        nothing_more(subscriber)
        with state_routers.connect("wombat-1") as one:
            one.forget("ends/mode")
            assert values(subscriber, 1) == [None]


def test_change_during_a_cut_arrives_after_it(state_routers: Routers) -> None:
    with state_routers.connect("wombat-1") as one, state_routers.connect("wombat-2") as two:
        for topic in ("same", "changed", "forgotten"):
            one.publish(f"cut/{topic}", 1, retained=True)
        with two.subscribe("wombat-1/cut/*") as subscriber:
            assert values(subscriber, 3) == [1, 1, 1]
            with state_routers.without_link():
                one.publish("cut/changed", 2, retained=True)
                one.publish("cut/new", 3, retained=True)
                one.forget("cut/forgotten")
                kept = two.latest("wombat-1", "cut/changed")
                assert kept is not None
                assert kept.value == 1
            received = {message.topic: message.value for message in [subscriber.next(DEADLINE) for _ in range(3)]}
            assert received == {"cut/changed": 2, "cut/new": 3, "cut/forgotten": None}
            nothing_more(subscriber)


@pytest.mark.parametrize("restarted", ["wombat-1", "wombat-2"])
def test_restart_of_a_router_loses_and_repeats_nothing(state_routers: Routers, restarted: str) -> None:
    with state_routers.connect("wombat-1") as one, state_routers.connect("wombat-2") as two:
        topic = f"restart/{restarted}"
        one.publish(topic, "auto", retained=True)
        with two.subscribe(f"wombat-1/{topic}") as subscriber:
            assert values(subscriber, 1) == ["auto"]
            state_routers.restart(restarted)
            # While the router is away, too.
            one.publish(topic, "stop", retained=True)
            assert values(subscriber, 1) == ["stop"]
            nothing_more(subscriber)
            with two.subscribe(f"wombat-1/{topic}") as late:
                assert values(late, 1) == ["stop"]


def test_value_on_disk_survives_a_restart_of_the_robot(state_routers: Routers) -> None:
    with state_routers.connect("wombat-1") as one:
        one.publish("disk/offset", 1.25, retained="disk")
        published = time.monotonic()
        one.publish("disk/gone", 1, retained="disk")
        one.publish("disk/memory", 1, retained=True)
        one.forget("disk/gone")
    state_routers.restart("wombat-1")
    with state_routers.connect("wombat-2") as two:

        def latest(topic: str) -> Any:
            message = two.latest("wombat-1", topic)
            return message and message.value

        until(lambda: latest("disk/offset") == 1.25)
        offset = two.latest("wombat-1", "disk/offset")
        assert offset is not None and offset.retained is not None
        # Also the time for which the router did not run. The two clocks may differ by a millisecond.
        assert 0 <= time.monotonic() - published - offset.retained.age + 0.01 < 1
        assert latest("disk/gone") is None
        assert latest("disk/memory") is None


def test_disk_that_cannot_be_written_is_reported_and_loses_nothing_in_memory(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "retained.cbor").write_bytes(b"damaged")
    with linked_routers(tmp_path) as routers, routers.connect("wombat-1") as one:
        # Root writes to a folder that is read-only.
        (tmp_path / "retained.cbor").unlink()
        (tmp_path / "retained.cbor").mkdir()
        one.publish("mode", "auto", retained="disk")
        one.publish("mode", "manual", retained="disk")
        assert "the retained values cannot be written to disk" in caplog.text
        latest = one.latest("wombat-1", "mode")
        assert latest is not None
        assert latest.value == "manual"


def test_topic_is_either_served_or_retained(state_routers: Routers) -> None:
    with state_routers.connect("wombat-1") as one, state_routers.connect("wombat-1") as other:
        served = "a program of this robot serves either/grab"
        with other.serve("either/grab", lambda _: "done"), pytest.raises(rect.NotRetained, match=served):
            one.publish("either/grab", 1, retained=True)
        one.publish("either/mode", 1, retained=True)
        with pytest.raises(rect.ServiceRefused, match="either/mode is retained by a program of this robot"):
            other.serve("either/mode", lambda _: "done")
        with pytest.raises(rect.NoService):
            other.request("wombat-1", "either/mode")


def test_limits_are_reported_and_the_message_is_published(state_routers: Routers) -> None:
    limit = 64 << 10
    with state_routers.connect("wombat-1") as one, one.subscribe("wombat-1/limits/*") as subscriber:
        one.publish("limits/most", bytes(limit), retained=True)
        assert len(subscriber.next(DEADLINE).value) == limit
        with pytest.raises(rect.NotRetained, match="the value has 65537 bytes, and at most 65536 are kept"):
            one.publish("limits/more", bytes(limit + 1), retained=True)
        message = subscriber.next(DEADLINE)
        assert (len(message.value), message.retained) == (limit + 1, None)
        one.forget("limits/most")
        # 100,000 topics of a program with a mistake.
        number = 0
        with pytest.raises(rect.NotRetained, match="the retained topics of this robot have 262144 bytes already"):
            for number in range(100_000):
                one.publish(f"flood/{number}", 1, retained=True)
        assert number > 1500
        for known in range(number):
            one.forget(f"flood/{known}")


def test_options_are_checked(state_routers: Routers) -> None:
    with state_routers.connect("wombat-1") as one:
        wrong: Any = "yes"
        with pytest.raises(rect.OptionError, match='it must be True, False or "disk"'):
            one.publish("mode", 1, retained=wrong)
        with pytest.raises(rect.OptionError, match="a message that expires cannot be retained"):
            one.publish("mode", 1, retained=True, expires_after=1)


def until_advanced_subscriber_follows(stock: zenoh.Session, robot: rect.Robot) -> None:
    """Waits until a subscriber of zenoh-ext has the retained value `auto` of `stock/mode`, and then its change to
    `manual`."""
    received: list[bytes] = []
    until_declared = time.monotonic() + DEADLINE
    while True:
        advanced = zenoh.ext.declare_advanced_subscriber(
            stock,
            "rect/wombat-1/stock/mode",
            lambda sample: received.append(sample.payload.to_bytes()),
            history=zenoh.ext.HistoryConfig(),
        )
        # It asks once. Right after a link-up, its router may not know yet that there is a history.
        asked = time.monotonic()
        while not received and time.monotonic() < asked + 1:
            time.sleep(0.01)
        if received:
            break
        assert time.monotonic() < until_declared, "no history"
        advanced.undeclare()
    until(lambda: received == [b"auto"], lambda: received)
    robot.publish("stock/mode", "manual", retained=True)
    until(lambda: received == [b"auto", b"manual"], lambda: received)
    advanced.undeclare()


def test_stock_tools_get_the_last_value(state_routers: Routers) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{state_routers.endpoints["wombat-2"]}"]')
    with state_routers.connect("wombat-1") as one, zenoh.open(config) as stock:

        def get(key: str) -> list[tuple[str, bytes]]:
            replies = [reply.ok for reply in stock.get(key)]
            return [(str(sample.key_expr), sample.payload.to_bytes()) for sample in replies if sample is not None]

        one.publish("stock/mode", "auto", retained=True)
        until(lambda: get("rect/wombat-1/stock/mode") == [("rect/wombat-1/stock/mode", b"auto")])
        assert get("rect/*/stock/**") == [("rect/wombat-1/stock/mode", b"auto")]
        until_advanced_subscriber_follows(stock, one)
        one.forget("stock/mode")
        assert get("rect/wombat-1/stock/mode") == []


def test_subscription_that_is_replaced_at_once_gets_the_last_value(state_routers: Routers) -> None:
    with state_routers.connect("wombat-2") as two, state_routers.connect("wombat-1") as one:
        one.wait_for_peer("wombat-2", DEADLINE)
        for number in range(60):
            two.publish("again/mode", number, retained=True)
            # The question of the first subscription may be answered after it has ended.
            for pattern in ("wombat-2/again/*", "*/again/*", "wombat-2/again/*"):
                with one.subscribe(pattern) as subscriber:
                    if number % 3 == 0:
                        assert subscriber.next(timeout=DEADLINE).value <= number
                time.sleep(0.01 * (number % 5))
            with one.subscribe("wombat-2/again/*") as subscriber:
                while subscriber.next(timeout=DEADLINE).value != number:
                    pass
        two.forget("again/mode")


def test_advanced_subscriber_gets_the_last_value_of_a_robot_that_rect_init_configured(tmp_path: Path) -> None:
    with initialised_routers(tmp_path) as options, ExitStack() as stack:
        one, two = (stack.enter_context(rect.connect(name, **options[name])) for name in options)
        one.publish("stock/mode", "auto", retained=True)
        two.wait_for_peer("wombat-1", DEADLINE)
        user, password = Path(options["wombat-2"]["login_file"]).read_text().split()[0].split(":")
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{options["wombat-2"]["router"]}"]')
        config.insert_json5("transport/auth/usrpwd/user", f'"{user}"')
        config.insert_json5("transport/auth/usrpwd/password", f'"{password}"')
        stock = stack.enter_context(zenoh.open(config))
        # It asks for the history once, when it is declared.
        until(lambda: any(reply.ok for reply in stock.get("rect/wombat-1/stock/mode")))
        until_advanced_subscriber_follows(stock, one)


def test_late_subscription_is_complete_soon(tmp_path: Path) -> None:
    with (
        linked_routers(tmp_path, "--pdu", "27") as routers,
        routers.connect("wombat-1") as one,
        routers.connect("wombat-2") as two,
    ):
        for number in range(50):
            one.publish(f"soon/{number}", "x" * 38, retained=True)
        time.sleep(2.0)
        before = air_bytes(routers)
        began = time.monotonic()
        with two.subscribe("wombat-1/soon/*") as subscriber:
            values(subscriber, 50)
            took = time.monotonic() - began
            carried = air_bytes(routers) - before
            print(f"\n50 values of 40 bytes: {took * 1000:.0f} ms, {carried} bytes on the air")
            assert took < 2.0
            before = air_bytes(routers)
            with two.subscribe("wombat-1/soon/*") as second:
                values(second, 50)
            with routers.connect("wombat-2") as third, third.subscribe("wombat-1/soon/*") as other:
                values(other, 50)
                print(f"two more subscriptions of the robot: {air_bytes(routers) - before} bytes on the air")
                assert air_bytes(routers) - before < 400


def air_bytes(routers: Routers) -> int:
    """Returns the bytes that the air has carried so far, in both directions."""
    return sum(adapter["stats"]["sdu_bytes"] for adapter in routers.room.status()["adapters"])


@contextmanager
def chain(kind: str) -> Iterator[list[str]]:
    """Runs the routers of three robots, of which the first and the last are linked with the second. Yields their
    endpoints."""
    from robots import AnyRobot, Robot, rect_settings  # type: ignore[import-not-found, unused-ignore]
    from room import Room  # type: ignore[import-not-found, unused-ignore]

    with Room("desk", has_wifi=kind == "any") as room:
        robots: list[Any] = []
        for number in (1, 2, 3):
            name = f"wombat-{number}"
            # The other kind has these settings already.
            settings = tuple(rect_settings({"robot": name})) if kind == "ble" else ()
            robot_kind = Robot if kind == "ble" else AnyRobot
            robots.append(room.add_robot(name, arguments=settings, kind=robot_kind, dials=robots[-1:]))
        yield [robot.endpoint() for robot in robots]


@pytest.mark.parametrize("kind", ["ble", "any"])
def test_state_crosses_a_chain_of_robots(state_routers: Routers, kind: str) -> None:
    with chain(kind) as (first, second, third), ExitStack() as stack:
        one = stack.enter_context(rect.connect("wombat-1", router=first))
        base = stack.enter_context(rect.connect("wombat-2", router=second))
        three = stack.enter_context(rect.connect("wombat-3", router=third))
        one.publish("chain/mode", "auto", retained=True)
        three.wait_for_peer("wombat-1", DEADLINE)
        far = stack.enter_context(three.subscribe("*/chain/mode"))
        near = stack.enter_context(base.subscribe("*/chain/mode"))
        assert values(far, 1) == values(near, 1) == ["auto"]
        for value in ("manual", "stop"):
            one.publish("chain/mode", value, retained=True)
            assert values(far, 1) == values(near, 1) == [value]
        three.publish("chain/mode", "far", retained=True)
        assert values(near, 1) == ["far"]
        with base.subscribe("*/chain/mode") as late:
            assert sorted(values(late, 2)) == ["far", "stop"]


def test_fleets_in_one_hall_do_not_see_each_others_state(state_routers: Routers) -> None:
    router = state_routers.endpoints["wombat-1"]
    lions: dict[str, Any] = {"fleet": "lions", "router": router, "allow_name_mismatch": True}
    with state_routers.connect("wombat-1") as one, rect.connect("wombat-1", **lions) as other:
        one.publish("fleet/mode", "auto", retained=True)
        with other.subscribe("*/fleet/mode") as subscriber:
            nothing_more(subscriber)
        assert other.latest("wombat-1", "fleet/mode") is None
        with pytest.raises(rect.NotRetained, match="no router of this robot keeps values"):
            other.publish("fleet/mode", "lions", retained=True)
        latest = one.latest("wombat-1", "fleet/mode")
        assert latest is not None
        assert latest.value == "auto"
