"""Tests results of goals beyond 48 kB, which the program keeps that has carried out the goal.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_action_results.py
"""

from __future__ import annotations

import asyncio
import json
import random
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import rect
import rect.aio
from conftest import DEADLINE, Pair, until
from programs import Routers, initialised_routers
from test_actions import Robots, end_of, line, process, start

#: Random bytes, which no link can compress.
MEGABYTE = random.Random(1).randbytes(1 << 20)

#: Carries out goals with a large result.
_SERVER = """
import sys, threading, rect
with rect.connect("wombat-2", router=sys.argv[1], program="mapper") as robot:
    robot.action("map", lambda goal: bytes(1 << 20))
    print("ready", flush=True)
    threading.Event().wait()
"""


@pytest.fixture
def robots(routers: Routers) -> Iterator[Robots]:
    robots = Robots(routers)
    with robots.client, robots.server:
        yield robots


def received_kb(run: rect.ActionRun[bytes], timeout: float) -> int:
    """Waits a while for a result, and returns how much of it has arrived, as the error says."""
    with pytest.raises(rect.TimedOut, match="result of map of wombat-2") as late:
        run.result(timeout)
    found = re.search(r"of which (\d+) k?B of 1048 kB have arrived", str(late.value))
    assert found is not None, late.value
    return int(found[1])


def test_megabyte_arrives_although_the_link_is_cut(robots: Robots) -> None:
    action = robots.server.action("map", lambda goal: MEGABYTE)
    run = robots.start("map", id="g1")
    until(lambda: run.has_ended)
    until(lambda: received_kb(run, 0.1) > 0)
    with robots.routers.without_link():
        received_kb(run, 1)
    assert run.result(120) == MEGABYTE
    assert run.phase == "done"
    # It is received once.
    assert run.result(0) == MEGABYTE
    # Other programs find it, also after the end of the action.
    action.close()
    with robots.routers.connect("wombat-2", program="other") as other:
        assert other.find("wombat-2", "map", "g1").result(DEADLINE) == MEGABYTE
        (known,) = (goal for goal in other.goals("wombat-2") if goal.action == "map")
        assert (known.phase, known.result) == ("done", None)


def test_result_is_lost_when_its_program_has_ended(robots: Robots) -> None:
    with process(_SERVER, robots.routers.endpoints["wombat-2"]) as server:
        assert line(server) == "ready"
        run = robots.start("map", id="lost")
        until(lambda: run.has_ended)
        server.kill()
        server.wait()
        for one in (run, robots.client.find("wombat-2", "map", "lost")):
            with pytest.raises(rect.ActionError) as ended:
                one.result(DEADLINE)
            assert ended.value.phase == one.phase == "done"
            assert str(ended.value) == (
                "the goal is done, but its result of 1048 kB is lost: the program that carried it out has ended"
            )


def test_large_values_keep_their_types(pair: Pair) -> None:
    client, server = pair
    numbers = {"x": list(range(50_000))}
    text = "ä" * 60_000
    server.action("numbers", lambda goal: numbers)
    server.action("text", lambda goal: text)
    assert start(client, "numbers", returns=dict[str, list[int]]).result(DEADLINE) == numbers
    assert start(client, "text").result(DEADLINE) == text
    with pytest.raises(rect.PayloadError):
        start(client, "numbers", returns=list[int]).result(DEADLINE)


def test_ten_megabytes_arrive_and_seventeen_are_refused(pair: Pair) -> None:
    client, server = pair
    server.action("bytes", lambda goal: bytes(goal.value))
    assert start(client, "bytes", 10_000_000).result(DEADLINE) == bytes(10_000_000)
    assert start(client, "bytes", 16 << 20).result(DEADLINE) == bytes(16 << 20)
    phase, reason = end_of(start(client, "bytes", 17_000_000))
    assert phase == "failed"
    assert "send it as a transfer" in reason


def test_states_with_other_sizes_are_refused(pair: Pair) -> None:
    client, server = pair
    forged = {"id": "0" * 16, "size_bytes": 1 << 60, "sha256": "0" * 64, "encoding": "zenoh/bytes"}
    for id, transfer, expected in (
        ("huge", forged, "at most 16777216 bytes are allowed"),
        ("id", {**forged, "size_bytes": 9, "id": "**"}, "is not valid"),
    ):
        state = json.dumps({"phase": "done", "transfer": transfer}).encode()
        server.publish(f"actions/map/{id}", rect.Payload(state, "application/json"), retained=True)
        until(lambda id=id: id in [goal.id for goal in client.goals("wombat-2")])  # type: ignore[misc]
        with pytest.raises(rect.ActionError, match=expected):
            client.find("wombat-2", "map", id).result(DEADLINE)


def test_access_control_permits_large_results(tmp_path: Path) -> None:
    with initialised_routers(tmp_path) as options, ExitStack() as stack:
        one, two = (stack.enter_context(rect.connect(name, **options[name])) for name in options)
        two.action("map", lambda goal: bytes(100_000))
        assert start(one, "map").result(DEADLINE) == bytes(100_000)


def test_command_prints_a_large_result(robots: Robots) -> None:
    robots.server.action("numbers", lambda goal: list(range(20_000)))
    robots.start("numbers", id="n1")
    with robots.routers.tool("wombat-1", "action", "watch", "wombat-2", "numbers", "n1", "--json") as tool:
        end = json.loads(tool.until('"result"'))
        assert (end["phase"], end["result"]) == ("done", list(range(20_000)))
        assert tool.ends() == 0


def test_closed_client_ends_the_wait(robots: Robots) -> None:
    robots.server.action("map", lambda goal: MEGABYTE)
    run = robots.start("map")
    until(lambda: run.has_ended)
    received_kb(run, 0.1)
    run.close()
    with pytest.raises(rect.Closed):
        run.result(DEADLINE)


def test_asyncio(routers: Routers) -> None:
    async def scenario() -> None:
        async with rect.aio.connect("wombat-2", router=routers.endpoints["wombat-2"]) as robot:

            async def carry_out(goal: rect.aio.Goal[None]) -> bytes:
                return bytes(200_000)

            robot.action("aio", carry_out)
            run = await robot.start("wombat-2", "aio")
            assert await run.result(DEADLINE) == bytes(200_000)
            assert await run.result(0) == bytes(200_000)

    asyncio.run(scenario())
