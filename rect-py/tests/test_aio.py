"""Tests the API for asyncio.

pytest rect-py/tests/test_aio.py
"""

from __future__ import annotations

import asyncio
import logging
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable

import numpy
import pytest
import rect
import rect.aio
from conftest import DEADLINE, free_port, until_served, until_subscribed

Pair = tuple[rect.aio.Robot, rect.aio.Robot]


def with_a_pair(test: Callable[[rect.aio.Robot, rect.aio.Robot], Awaitable[None]]) -> None:
    async def run() -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        async with (
            rect.aio.connect("wombat-1", listen=[endpoint]) as one,
            rect.aio.connect("wombat-2", endpoints=[endpoint]) as two,
        ):
            for robot in (one, two):
                async with robot.events() as events:
                    async for event in events:
                        if event.kind == "peer_up":
                            break
            await asyncio.wait_for(test(one, two), DEADLINE)

    asyncio.run(run())


def test_send_to_one_robot_does_not_block_the_loop() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        async with two.subscribe("*/note") as notes:
            await two.wait_until_established(DEADLINE)
            ticks = 0

            async def tick() -> None:
                nonlocal ticks
                while True:
                    await asyncio.sleep(0.01)
                    ticks += 1

            ticking = asyncio.create_task(tick())
            with pytest.raises(rect.NotReachable, match="did you mean wombat-2"):
                await one.send("wmbat-2", "note", "psst")
            ticking.cancel()
            assert ticks > 3
            for value in range(2):
                await one.send("wombat-2", "note", value)
                assert (await notes.next(DEADLINE)).value == value

    with_a_pair(test)


def test_handler_that_exits_replies_with_error_and_ends_loop(caplog: pytest.LogCaptureFixture) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    errors: list[str] = []

    def request(requester: rect.Robot) -> None:
        until_served(requester, "wombat-1", "exits")
        try:
            requester.request("wombat-1", "exits", timeout=DEADLINE)
        except rect.RectError as error:
            errors.append(str(error))

    def exits(request: rect.Request) -> None:
        sys.exit(3)

    async def serve() -> None:
        async with rect.aio.connect("wombat-1", endpoints=[endpoint]) as robot:
            robot.serve("exits", exits)
            requesting.start()
            await asyncio.sleep(DEADLINE)

    with rect.connect("wombat-2", listen=[endpoint]) as requester, caplog.at_level(logging.ERROR, "rect"):
        requesting = threading.Thread(target=request, args=(requester,))
        with pytest.raises(SystemExit):
            asyncio.run(serve())
        requesting.join(DEADLINE)
    assert errors == ["wombat-1 replied with an error: the service called sys.exit(3)"]


def test_subscriber_is_async_iterator() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        subscriber = two.subscribe("wombat-1/count")
        await asyncio.to_thread(until_subscribed, one._robot, "count")
        for number in range(3):
            await one.publish("count", number)
        await one.publish("count", "x" * 100_000)
        values = []
        async for message in subscriber:
            values.append(message.value)
            if len(values) == 4:
                break
        assert values == [0, 1, 2, "x" * 100_000]
        with pytest.raises(rect.TimedOut):
            await subscriber.next(0.01)
        await two.close()
        assert [message async for message in subscriber] == []

    with_a_pair(test)


def test_plain_and_async_callbacks_continue_after_exception(caplog: pytest.LogCaptureFixture) -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        plain: list[int] = []
        awaited: list[int] = []
        loop, both = asyncio.get_running_loop(), [asyncio.Event(), asyncio.Event()]

        async def callback(message: rect.Message) -> None:
            await asyncio.sleep(0)
            awaited.append(message.value)
            if message.value == 0:
                raise ValueError("on purpose")
            both[0].set()

        def plain_callback(message: rect.Message) -> None:
            plain.append(message.value)
            if message.value == 1:
                loop.call_soon_threadsafe(both[1].set)

        two.subscribe("wombat-1/count", callback=plain_callback)
        two.subscribe("wombat-1/count", callback=callback)
        await asyncio.to_thread(until_subscribed, one._robot, "count")
        await one.publish("count", 0)
        await one.publish("count", 1)
        for done in both:
            await done.wait()
        assert (plain, awaited) == ([0, 1], [0, 1])

    with caplog.at_level(logging.ERROR, "rect"):
        with_a_pair(test)
    assert "on purpose" in caplog.text


def test_plain_and_async_handlers_reply() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        @one.serve("double")
        async def double(request: rect.Request) -> int:
            await asyncio.sleep(0)
            return int(request.value) * 2

        @one.serve("count")
        async def count(request: rect.Request) -> AsyncIterator[int]:
            for number in range(request.value):
                yield number

        @one.serve("fail")
        def fail(request: rect.Request) -> None:
            raise rect.Refusal("no")

        for topic in ("double", "count", "fail"):
            await asyncio.to_thread(until_served, two._robot, "wombat-1", topic)
        replies = await asyncio.gather(*(two.request("wombat-1", "double", n, timeout=DEADLINE) for n in range(40)))
        assert [reply.value for reply in replies] == [n * 2 for n in range(40)]
        assert [reply.value async for reply in two.request_all("count", 3, timeout=DEADLINE)] == [0, 1, 2]
        with pytest.raises(rect.ServiceError, match="no"):
            await two.request("wombat-1", "fail", timeout=DEADLINE)
        with pytest.raises(rect.NoService, match="reachable robots: wombat-1"):
            await two.request("wombat-1", "nothing", timeout=DEADLINE)
        assert await two.peers() == ["wombat-1"]

    with_a_pair(test)


def test_dictionary_is_fetched_without_blocking_loop() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        samples = [b'{"angle_deg": %d, "moving": true, "battery_volt": 7.2}' % n for n in range(2000)]
        codec = one.share_dictionary(rect.Dictionary.train(samples, 4096))
        subscriber = two.subscribe("wombat-1/telemetry")
        await asyncio.to_thread(until_subscribed, one._robot, "telemetry")
        await one.publish("telemetry", {"angle_deg": 3}, codec=codec)
        assert (await subscriber.next(DEADLINE)).value == {"angle_deg": 3}

    with_a_pair(test)


def test_transfers_and_streams() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        async with two.receive_transfers("*/maps") as maps:
            await one.transfer("wombat-2", "maps", b"x" * 300_000)
            assert (await maps.next(DEADLINE)).content == b"x" * 300_000
        picture = numpy.zeros((24, 32, 3), numpy.uint8)
        async with one.stream("camera") as camera, two.watch("wombat-1/camera") as watch:
            frames = asyncio.ensure_future(watch.next(DEADLINE))
            while not frames.done():
                await camera.send(picture)
                await asyncio.wait([frames], timeout=0.02)
            assert isinstance(frames.result().value, rect.Picture)

    with_a_pair(test)


def test_next_works_after_cancelled_wait() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        subscriber = two.subscribe("wombat-1/x")
        await asyncio.to_thread(until_subscribed, one._robot, "x")
        waiting = asyncio.ensure_future(subscriber.next())
        await asyncio.sleep(0)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        await one.publish("x", 1)
        assert (await subscriber.next(DEADLINE)).value == 1

    with_a_pair(test)
