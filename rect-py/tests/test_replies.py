"""Tests the ends of requests: outcomes of all robots, streams of replies, and handlers that learn that nobody waits.

pytest rect-py/tests/test_replies.py
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Iterator

import pytest
import rect
import rect.aio
from conftest import DEADLINE, free_port, until_served

Pair = tuple[rect.Robot, rect.Robot]

#: How long a handler may take to learn that nobody waits, in seconds.
LEARNS_WITHIN = 0.5


def count(request: rect.Request) -> Iterator[int]:
    yield from range(request.value)


def test_each_robot_that_serves_a_topic_has_an_outcome(pair: Pair) -> None:
    one, two = pair
    with pytest.raises(rect.NoService, match="no program of the fleet serves cell; reachable robots: wombat-1"):
        two.request_all("cell", timeout=DEADLINE).gather()
    is_asked = threading.Event()

    def cell(request: rect.Request) -> float:
        if request.value == "stuck":
            raise rect.Refusal("the arm is stuck")
        if request.value == "hang":
            is_asked.set()
            time.sleep(DEADLINE)
        return 7.2

    one.serve("cell", cell)
    until_served(two, "wombat-1", "cell")
    replied = two.request_all("cell", timeout=DEADLINE).gather()
    assert [(reply.sender, reply.value) for reply in replied.replies] == [("wombat-1", 7.2)]
    assert (replied.expected, replied.missing, replied.errors) == ({"wombat-1"}, set(), {})
    refused = two.request_all("cell", "stuck", timeout=DEADLINE).gather()
    assert isinstance(refused.errors["wombat-1"], rect.ServiceError)
    assert refused.missing == set()
    late = two.request_all("cell", "hang", timeout=1).gather()
    assert isinstance(late.errors["wombat-1"], rect.TimedOut)
    assert late.missing == {"wombat-1"}
    is_asked.clear()
    lost = two.request_all("cell", "hang", timeout=DEADLINE)
    gathered: list[rect.Gathered[float]] = []
    gathering = threading.Thread(target=lambda: gathered.append(lost.gather()))
    gathering.start()
    assert is_asked.wait(DEADLINE)
    one.close()
    gathering.join(DEADLINE)
    assert isinstance(gathered[0].errors["wombat-1"], rect.Interrupted)
    assert gathered[0].missing == {"wombat-1"}


def test_stream_ends_after_all_replies(pair: Pair) -> None:
    one, two = pair
    one.serve("count", count)
    one.serve("single", lambda request: "one")
    until_served(two, "wombat-1", "count")
    until_served(two, "wombat-1", "single")
    for n in (0, 1, 200):
        replies = two.request_stream("wombat-1", "count", n, returns=int, timeout=DEADLINE)
        assert [reply.value for reply in replies] == list(range(n))
    assert [reply.value for reply in two.request_stream("wombat-1", "single", timeout=DEADLINE)] == ["one"]
    assert two.request("wombat-1", "count", 3, timeout=DEADLINE).value == 0
    with pytest.raises(rect.NoService):
        list(two.request_stream("wombat-1", "nothing", timeout=DEADLINE))


def test_stream_that_is_cut_is_interrupted(pair: Pair) -> None:
    one, two = pair
    continues = threading.Event()

    def scan(request: rect.Request) -> Iterator[int]:
        yield 1
        continues.wait(DEADLINE)
        yield 2

    one.serve("scan", scan)
    until_served(two, "wombat-1", "scan")
    replies = two.request_stream("wombat-1", "scan", timeout=DEADLINE)
    assert next(replies).value == 1
    one.close()
    with pytest.raises(rect.Interrupted, match="may have been carried out"):
        next(replies)
    with pytest.raises(StopIteration):
        next(replies)
    continues.set()


@pytest.mark.parametrize("leaves", ["closes", "deadline", "program"])
def test_handler_learns_that_nobody_waits(pair: Pair, leaves: str) -> None:
    one, two = pair
    observed: list[bool] = []
    is_waited_for, has_learnt = threading.Event(), threading.Event()

    def long(request: rect.Request) -> None:
        if request.value != "wait":
            return
        observed.append(request.is_wanted)
        is_waited_for.set()
        while request.is_wanted:
            time.sleep(0.005)
        has_learnt.set()

    one.serve("long", long)
    until_served(two, "wombat-1", "long")
    timeout = LEARNS_WITHIN / 2 if leaves == "deadline" else DEADLINE
    replies = two.request_stream("wombat-1", "long", "wait", timeout=timeout)
    assert is_waited_for.wait(DEADLINE)
    assert observed == [True]
    if leaves == "closes":
        replies.close()
    elif leaves == "program":
        two.close()
    assert has_learnt.wait(LEARNS_WITHIN)


def test_generator_ends_when_the_requester_has_left(pair: Pair) -> None:
    one, two = pair
    has_ended = threading.Event()

    def numbers(request: rect.Request) -> Iterator[int]:
        try:
            n = 0
            while True:
                yield n
                n += 1
                time.sleep(0.005)
        finally:
            has_ended.set()

    one.serve("numbers", numbers)
    until_served(two, "wombat-1", "numbers")
    # The generator of that request ends, too, as its requester has left after the first reply.
    has_ended.clear()
    with two.request_stream("wombat-1", "numbers", timeout=DEADLINE) as replies:
        assert [next(replies).value for _ in range(3)] == [0, 1, 2]
    assert has_ended.wait(DEADLINE)


def test_streams_and_outcomes_with_asyncio() -> None:
    async def run() -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        async with (
            rect.aio.connect("wombat-1", listen=[endpoint]) as one,
            rect.aio.connect("wombat-2", endpoints=[endpoint]) as two,
        ):
            has_learnt = asyncio.Event()
            is_asked = asyncio.Event()

            async def numbers(request: rect.Request) -> AsyncIterator[int]:
                for n in range(request.value):
                    yield n

            async def long(request: rect.Request) -> None:
                is_asked.set()
                await request.unwanted()
                has_learnt.set()

            one.serve("numbers", numbers)
            one.serve("long", long)
            await two.wait_for_peer("wombat-1", DEADLINE)
            while True:
                try:
                    await two.request("wombat-1", "numbers", 1, timeout=DEADLINE)
                    break
                except rect.NoService:
                    await asyncio.sleep(0.01)
            values = [reply.value async for reply in two.request_stream("wombat-1", "numbers", 3, timeout=DEADLINE)]
            assert values == [0, 1, 2]
            gathered = await two.request_all("numbers", 1, timeout=DEADLINE).gather()
            assert [reply.value for reply in gathered.replies] == [0]
            while True:
                asking = asyncio.create_task(two.request("wombat-1", "long", timeout=DEADLINE))
                await asyncio.wait([asking, asyncio.create_task(is_asked.wait())], return_when="FIRST_COMPLETED")
                if is_asked.is_set():
                    break
            asking.cancel()
            await asyncio.wait_for(has_learnt.wait(), DEADLINE)

    asyncio.run(run())
