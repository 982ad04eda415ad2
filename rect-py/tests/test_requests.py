"""Tests requests and services between two robots.

pytest rect-py/tests/test_requests.py
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import rect
import zenoh
from conftest import DEADLINE, until, until_served
from rect import _rect

Pair = tuple[rect.Robot, rect.Robot]


def test_request_returns_reply(pair: Pair) -> None:
    one, two = pair

    @one.serve("double")
    def double(request: rect.Request) -> int:
        assert (request.sender, request.topic) == ("wombat-2", "double")
        assert 0 < request.remaining <= DEADLINE
        return int(request.value) * 2

    until_served(two, "wombat-1", "double")
    reply = two.request("wombat-1", "double", 21, timeout=DEADLINE)
    assert (reply.sender, reply.value, reply.is_shared) == ("wombat-1", 42, False)


def test_exception_of_handler_arrives_as_service_error(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair

    def refuse_or_raise(request: rect.Request) -> None:
        if request.value == "refuse":
            raise rect.Refusal({"cells": [1, 2]})
        raise ValueError("the cell must be 1 or 2")

    one.serve("battery", refuse_or_raise)
    until_served(two, "wombat-1", "battery")
    with caplog.at_level(logging.ERROR, "rect"):
        with pytest.raises(rect.ServiceError, match="wombat-1 replied with an error: the cell must be") as raised:
            two.request("wombat-1", "battery", timeout=DEADLINE)
        assert "the handler of the service battery raised an exception" in caplog.text
        caplog.clear()
        with pytest.raises(rect.ServiceError) as refused:
            two.request("wombat-1", "battery", "refuse", timeout=DEADLINE)
        assert caplog.text == ""
    assert (raised.value.robot, raised.value.value) == ("wombat-1", "the cell must be 1 or 2")
    assert refused.value.value == {"cells": [1, 2]}


def test_handler_that_exits_replies_with_error_and_service_continues(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    one, two = pair

    def exits(request: rect.Request) -> int:
        if request.value == "exit":
            sys.exit(3)
        return 1

    one.serve("exits", exits)
    until_served(two, "wombat-1", "exits")
    with caplog.at_level(logging.ERROR, "rect"):
        # More requests than there are worker threads.
        for _ in range(_rect.MAX_CONCURRENT + 1):
            with pytest.raises(rect.ServiceError, match=r"the service called sys\.exit\(3\)"):
                two.request("wombat-1", "exits", "exit", timeout=DEADLINE)
    assert two.request("wombat-1", "exits", timeout=DEADLINE).value == 1
    assert "the handler of the service exits raised an exception" in caplog.text


def test_reply_that_cannot_be_sent_arrives_as_service_error(pair: Pair) -> None:
    one, two = pair
    one.serve("long", lambda request: rect.Payload(b"", "x" * 300))
    until_served(two, "wombat-1", "long")
    with pytest.raises(rect.ServiceError, match="is 300 bytes long, but an encoding has at most 200"):
        two.request("wombat-1", "long", timeout=DEADLINE)


def test_request_all_returns_every_reply_of_all_robots(pair: Pair) -> None:
    one, two = pair

    def count(request: rect.Request) -> Iterator[int]:
        yield from range(request.value)

    one.serve("count", count)
    two.serve("count", lambda request: 100)
    until_served(two, "wombat-1", "count")
    with two.request_all("count", 3, timeout=DEADLINE) as replies:
        values = sorted((reply.sender, reply.value) for reply in replies)
    assert values == [("wombat-1", 0), ("wombat-1", 1), ("wombat-1", 2), ("wombat-2", 100)]


def test_no_service_error_lists_reachable_robots(pair: Pair) -> None:
    with pytest.raises(rect.NoService, match="no program serves nothing at wombat-9; reachable robots: wombat-1"):
        pair[1].request("wombat-9", "nothing", timeout=DEADLINE)


def test_request_whose_service_does_not_reply_may_have_been_carried_out(pair: Pair) -> None:
    one, two = pair

    @one.serve("none")
    def none(request: rect.Request) -> Iterator[int]:
        yield from range(request.value)

    until_served(two, "wombat-1", "none")
    with pytest.raises(
        rect.Interrupted, match="wombat-1 did not reply to the request none, which may have been carried"
    ):
        two.request("wombat-1", "none", 0, timeout=DEADLINE)


def test_request_whose_program_ends_may_have_been_carried_out(pair: Pair) -> None:
    one, two = pair
    began, proceed = threading.Event(), threading.Event()

    @one.serve("slow")
    def slow(request: rect.Request) -> None:
        if request.value == "wait":
            began.set()
            proceed.wait(DEADLINE)

    until_served(two, "wombat-1", "slow")
    with ThreadPoolExecutor() as pool:
        asking = pool.submit(two.request, "wombat-1", "slow", "wait", timeout=DEADLINE)
        assert began.wait(DEADLINE)
        one.zenoh.close()
        error = asking.exception(DEADLINE)
        proceed.set()
    assert isinstance(error, rect.Interrupted)


def test_request_times_out(pair: Pair) -> None:
    one, two = pair
    proceed = threading.Event()
    one.serve("slow", lambda request: proceed.wait(DEADLINE))
    until_served(two, "wombat-1", "slow")
    with pytest.raises(rect.TimedOut, match="no reply about slow within 200 ms"):
        two.request("wombat-1", "slow", timeout=0.2)
    proceed.set()


def test_service_handles_sixteen_requests_concurrently(pair: Pair) -> None:
    one, two = pair
    together = threading.Barrier(16)
    one.serve("together", lambda request: together.wait(DEADLINE) >= 0)
    until_served(two, "wombat-1", "together")
    replies = []
    threads = [
        threading.Thread(target=lambda: replies.append(two.request("wombat-1", "together", timeout=DEADLINE).value))
        for _ in range(16)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert replies == [True] * 16


def test_closed_service_no_longer_replies(pair: Pair) -> None:
    one, two = pair
    with one.serve("once", lambda request: 1):
        until_served(two, "wombat-1", "once")
        assert two.request("wombat-1", "once", timeout=DEADLINE).value == 1
    until_served(two, "wombat-1", "once", is_served=False)

    def is_no_service() -> bool:
        try:
            two.request("wombat-1", "once", timeout=DEADLINE)
        except rect.NoService:
            return True
        except rect.Interrupted:
            # The catalogue does not yet show its end: it is unknown whether the service has received the request.
            return False
        raise AssertionError("the service replied")

    until(is_no_service)


def test_stock_program_can_send_request(pair: Pair) -> None:
    one, two = pair
    one.serve("who", lambda request: [request.sender, request.value])
    until_served(two, "wombat-1", "who")
    replies = two.zenoh.get("rect/wombat-1/who", payload=b"7", encoding="application/json", timeout=DEADLINE)
    payloads = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
    assert payloads == [b"[null,7]"]


def test_query_with_wildcards_of_stock_program_runs_no_service(pair: Pair) -> None:
    one, two = pair
    requests: list[object] = []
    one.serve("arm/home", lambda request: requests.append(request.value))
    until_served(two, "wombat-1", "arm/home")
    requests.clear()
    for key in ("rect/**", "rect/*/arm/home"):
        replies = two.zenoh.get(key, target=zenoh.QueryTarget.ALL, timeout=DEADLINE)
        assert [reply for reply in replies if reply.ok is not None] == []
    # The queries before it have been handled: the requests of a service are handled in order.
    two.request("wombat-1", "arm/home", "last", timeout=DEADLINE)
    assert requests == ["last"]


def test_compressed_request_is_decoded(pair: Pair) -> None:
    one, two = pair
    one.serve("length", lambda request: len(request.value))
    until_served(two, "wombat-1", "length")
    assert two.request("wombat-1", "length", "x" * 5000, codec="zstd", timeout=DEADLINE).value == 5000


def test_error_names_requested_robot_even_if_reply_names_another(pair: Pair) -> None:
    one, two = pair

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply_err(b"stuck", encoding="text/plain;from=wombat-9")

    service = one.zenoh.declare_queryable("rect/wombat-1/arm", answer)
    until_served(two, "wombat-1", "arm")
    with pytest.raises(rect.ServiceError) as error:
        two.request("wombat-1", "arm", 1, timeout=DEADLINE)
    assert error.value.robot == "wombat-1"
    service.undeclare()


def test_reply_that_cannot_be_sent_is_logged_by_the_service(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    one.serve("camera", lambda _: object())
    one.serve("battery", lambda _: {"cells": [object()]})
    for topic in ("camera", "battery"):
        until_served(two, "wombat-1", topic)
        with caplog.at_level(logging.WARNING, "rect"), pytest.raises(rect.ServiceError) as error:
            two.request("wombat-1", topic, timeout=DEADLINE)
        assert f"the service {topic} replies with an error: {error.value.value}" in caplog.text
