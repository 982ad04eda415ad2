"""Tests the cost of programs and services on a slow link: how long urgent messages wait while the declarations of 15
robots cross a new link, and how long the list of a robot's services takes. The simulated air carries 34 kB/s.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest -s rect-py/tests/test_budget.py
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import rect
from conftest import DEADLINE, until, until_served, until_subscribed
from programs import Routers, linked_routers, program

ROBOTS, SERVICES = 15, 10
NAMES = ["arm", "camera", "drive", "gripper"]
#: The payload of the link-layer packets in bytes: with 27, the air carries 34 kB/s.
PDU = "27"
#: The upper limit of the bytes of a link-up, by the number of services of each program. A link carries the declarations
#: of its routers before everything else, compressed: a service has no token, but a queryable of about 45 bytes, and 600
#: of them take 6 kB in place of 27 kB.
BYTES = {0: 6_000, SERVICES: 13_000}
#: The upper limit of the delay of an urgent message on a computer that is busy, in seconds; otherwise it is half as
#: long.
URGENT = 0.6
#: The upper limit of the time of the list, in seconds.
LIST = 2.0
#: The time between two urgent messages, and how long a new link is observed, in seconds.
INTERVAL, OBSERVED = 0.02, 5.0
#: The link counts as silent if it carries fewer bytes than this in a second.
SILENCE_BYTES = 100
#: The keys below `@rect/` for which the router of a robot has a queryable (docs/reference/registry.md).
OF_ROUTER = [
    "@config/connections",
    "@set/program",
    "@set/state",
    "catalogue",
    "clock",
    "connections",
    "connections/count",
    "doctor",
    "peers",
    "status",
    "topics",
]


@pytest.fixture(scope="module")
def slow_routers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Routers]:
    with linked_routers(tmp_path_factory.mktemp("connections"), "--pdu", PDU) as routers:
        yield routers


def carried(routers: Routers) -> int:
    """Returns the bytes that the air has carried so far, in both directions."""
    return sum(adapter["stats"]["sdu_bytes"] for adapter in routers.room.status()["adapters"])


def carried_until_silent(routers: Routers) -> int:
    before, now = -SILENCE_BYTES, carried(routers)
    while now - before >= SILENCE_BYTES:
        time.sleep(1)
        before, now = now, carried(routers)
    return now


def serve(stack: ExitStack, routers: Routers, services: int) -> None:
    """Runs the programs of wombat-1, with this number of services each."""
    for name in NAMES:
        robot = stack.enter_context(routers.connect("wombat-1", program=name))
        for service in range(services):
            robot.serve(f"{name}/service-{service}", lambda request: "done", about="closes the gripper")


def robots_behind(stack: ExitStack, routers: Routers, services: int) -> None:
    """Declares at the router of wombat-1 what all further robots would: a stock session stands for each of them."""
    for number in range(3, ROBOTS + 1):
        session = stack.enter_context(routers.robots["wombat-1"].session())
        declare_token, own = session.liveliness().declare_token, f"rect/wombat-{number}"
        kept: list[Any] = [declare_token(f"{own}/@rect/alive/{session.zid()}")]
        kept += [session.declare_queryable(f"{own}/@rect/{key}", print) for key in OF_ROUTER]
        for index, name in enumerate(NAMES):
            kept.append(declare_token(f"{own}/@rect/p/{name}/{number:04x}{index:04x}/{services}"))
            topics = [f"{own}/{name}/service-{service}" for service in range(services)]
            kept += [session.declare_queryable(topic, print, complete=True) for topic in topics]
        stack.callback(kept.clear)


@pytest.mark.parametrize("services", BYTES)
def test_urgent_messages_wait_briefly_for_the_declarations_of_all_robots(slow_routers: Routers, services: int) -> None:
    routers = slow_routers
    with ExitStack() as stack:
        one, two = (stack.enter_context(routers.connect(name, program="observer")) for name in ("wombat-1", "wombat-2"))
        serve(stack, routers, services)
        for key in OF_ROUTER:
            until_served(two, "wombat-1", f"@rect/{key}")
        robots_behind(stack, routers, services)
        until(lambda: len(two.peers()) == ROBOTS - 1, two.peers)
        # The delay and the time of the arrival of each message, from each of the two robots.
        arrived: dict[str, list[tuple[float, float]]] = {"wombat-1": [], "wombat-2": []}

        def on_message(message: rect.Message) -> None:
            now = time.monotonic()
            arrived[message.sender].append((now - message.value, now))

        stack.enter_context(two.subscribe("wombat-1/stop", callback=on_message))
        stack.enter_context(one.subscribe("wombat-2/stop", callback=on_message))
        for robot in (one, two):
            until_subscribed(robot, "stop")
        carried_until_silent(routers)
        with routers.without_link():
            before = carried(routers)
        link_up = carried_until_silent(routers) - before
        with routers.without_link():
            for messages in arrived.values():
                messages.clear()
            routers.room.restore()
            restored = time.monotonic()
            sent = 0
            while time.monotonic() < restored + OBSERVED:
                for robot in (one, two):
                    robot.publish("stop", time.monotonic(), urgency="urgent")
                sent += 1
                time.sleep(INTERVAL)
            until(lambda: all(arrived.values()))
    print(f"\n{ROBOTS} robots, {len(NAMES)} programs, {services} services each: the link-up carries {link_up} bytes")
    longest = 0.0
    for sender, messages in arrived.items():
        delays = sorted(delay for delay, _ in messages)
        print(
            f"  urgent messages of {sender}: {len(messages)} of {sent} arrived, the first one "
            f"{messages[0][1] - restored:.2f} s after the robots came into range; delay: median "
            f"{1000 * delays[len(delays) // 2]:.0f} ms, max {1000 * delays[-1]:.0f} ms"
        )
        longest = max(longest, delays[-1])
    assert link_up <= BYTES[services]
    assert longest <= URGENT


def test_services_of_a_robot_are_listed_at_once(slow_routers: Routers) -> None:
    command = [program("RECT_TOOL", "rect"), "service", "list", "wombat-1", "--as", "wombat-2"]
    command += ["--router", slow_routers.endpoints["wombat-2"]]

    def listed() -> int:
        done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE, check=True)
        return done.stdout.count("/service-")

    with ExitStack() as stack:
        serve(stack, slow_routers, SERVICES)
        here = stack.enter_context(slow_routers.connect("wombat-1", program=None))
        until(lambda: sum(len(each.services) for each in here.programs("wombat-1")) == len(NAMES) * SERVICES)
        carried_until_silent(slow_routers)
        for which in ("first", "again"):
            before, began = carried(slow_routers), time.monotonic()
            count = listed()
            seconds = time.monotonic() - began
            print(f"\nthe list of {count} services, {which}: {seconds:.2f} s, {carried(slow_routers) - before} bytes")
            assert count == len(NAMES) * SERVICES and seconds <= LIST
