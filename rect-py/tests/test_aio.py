"""The forms for asyncio do the same.

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
from conftest import DEADLINE, free_port, until_heard, until_served

Pair = tuple[rect.aio.Robot, rect.aio.Robot]


def with_a_pair(test: Callable[[rect.aio.Robot, rect.aio.Robot], Awaitable[None]]) -> None:
    async def run() -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        async with (
            rect.aio.connect("wombat-1", listen=[endpoint]) as one,
            rect.aio.connect("wombat-2", endpoints=[endpoint]) as two,
        ):
            for robot in (one, two):
                async with robot.on_state() as events:
                    async for event in events:
                        if event.what == "peer_up":
                            break
            await asyncio.wait_for(test(one, two), DEADLINE)

    asyncio.run(run())


def test_a_handler_that_exits_ends_the_loop_after_an_answer(caplog: pytest.LogCaptureFixture) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    told: list[str] = []

    def asks(asker: rect.Robot) -> None:
        until_served(asker, "wombat-1", "exits")
        try:
            asker.request("wombat-1", "exits", timeout=DEADLINE)
        except rect.RectError as error:
            told.append(str(error))

    def exits(request: rect.Request) -> None:
        sys.exit(3)

    async def serve() -> None:
        async with rect.aio.connect("wombat-1", endpoints=[endpoint]) as robot:
            robot.serve("exits", exits)
            asking.start()
            await asyncio.sleep(DEADLINE)

    with rect.connect("wombat-2", listen=[endpoint]) as asker, caplog.at_level(logging.ERROR, "rect"):
        asking = threading.Thread(target=asks, args=(asker,))
        with pytest.raises(SystemExit):
            asyncio.run(serve())
        asking.join(DEADLINE)
    assert told == ["wombat-1 answers with an error: the service called sys.exit(3)"]


def test_messages_come_by_async_for() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        heard = two.subscribe("wombat-1/count")
        await asyncio.to_thread(until_heard, one._robot, "count")
        for number in range(3):
            await one.publish("count", number)
        await one.publish("count", "x" * 100_000)
        values = []
        async for message in heard:
            values.append(message.value)
            if len(values) == 4:
                break
        assert values == [0, 1, 2, "x" * 100_000]
        with pytest.raises(rect.TimedOut):
            await heard.next(0.01)
        await two.close()
        assert [message async for message in heard] == []

    with_a_pair(test)


def test_callbacks_may_be_plain_or_async_and_go_on_after_they_raised(caplog: pytest.LogCaptureFixture) -> None:
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

        two.subscribe("wombat-1/count", plain_callback)
        two.subscribe("wombat-1/count", callback)
        await asyncio.to_thread(until_heard, one._robot, "count")
        await one.publish("count", 0)
        await one.publish("count", 1)
        for done in both:
            await done.wait()
        assert (plain, awaited) == ([0, 1], [0, 1])

    with caplog.at_level(logging.ERROR, "rect"):
        with_a_pair(test)
    assert "on purpose" in caplog.text


def test_requests_are_answered_by_plain_and_async_handlers() -> None:
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
        answers = await asyncio.gather(*(two.request("wombat-1", "double", n, timeout=DEADLINE) for n in range(40)))
        assert [answer.value for answer in answers] == [n * 2 for n in range(40)]
        assert [reply.value async for reply in two.request_all("count", 3, timeout=DEADLINE)] == [0, 1, 2]
        with pytest.raises(rect.ServiceError, match="no"):
            await two.request("wombat-1", "fail", timeout=DEADLINE)
        with pytest.raises(rect.NoService, match="robots there: wombat-1"):
            await two.request("wombat-1", "nothing", timeout=DEADLINE)
        assert await two.peers() == ["wombat-1"]

    with_a_pair(test)


def test_a_dictionary_is_fetched_beside_the_loop() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        samples = [b'{"angle_deg": %d, "moving": true, "battery_volt": 7.2}' % n for n in range(2000)]
        codec = one.share(rect.Dictionary.train(samples, 4096))
        heard = two.subscribe("wombat-1/telemetry")
        await asyncio.to_thread(until_heard, one._robot, "telemetry")
        await one.publish("telemetry", {"angle_deg": 3}, codec=codec)
        assert (await heard.next(DEADLINE)).value == {"angle_deg": 3}

    with_a_pair(test)


def test_transfers_and_streams_are_awaited() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        async with two.receive_transfers("*/maps") as maps:
            await one.transfer("wombat-2", "maps", b"x" * 300_000)
            assert (await maps.next(DEADLINE)).content == b"x" * 300_000
        picture = numpy.zeros((24, 32, 3), numpy.uint8)
        async with one.stream("camera") as camera, two.watch("wombat-1", "camera") as watch:
            frames = asyncio.ensure_future(watch.next(DEADLINE))
            while not frames.done():
                await camera.send(picture)
                await asyncio.wait([frames], timeout=0.02)
            assert isinstance(frames.result().value, rect.Picture)

    with_a_pair(test)


def test_a_cancelled_wait_is_over_and_the_next_one_works() -> None:
    async def test(one: rect.aio.Robot, two: rect.aio.Robot) -> None:
        heard = two.subscribe("wombat-1/x")
        await asyncio.to_thread(until_heard, one._robot, "x")
        waiting = asyncio.ensure_future(heard.next())
        await asyncio.sleep(0)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        await one.publish("x", 1)
        assert (await heard.next(DEADLINE)).value == 1

    with_a_pair(test)
