"""Asking and answering between two robots.

pytest rect-py/tests/test_requests.py
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator

import pytest
import rect
import zenoh
from conftest import DEADLINE, until_served
from rect.service import AT_A_TIME

Pair = tuple[rect.Robot, rect.Robot]


def test_a_request_gets_the_answer(pair: Pair) -> None:
    one, two = pair

    @one.serve("double")
    def double(request: rect.Request) -> int:
        assert (request.sender, request.topic) == ("wombat-2", "double")
        assert 0 < request.remaining <= DEADLINE
        return int(request.value) * 2

    until_served(two, "wombat-1", "double")
    reply = two.request("wombat-1", "double", 21, timeout=DEADLINE)
    assert (reply.sender, reply.value) == ("wombat-1", 42)


def test_what_a_handler_raises_arrives_as_an_error(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair

    def refuses(request: rect.Request) -> None:
        if request.value == "refuse":
            raise rect.Refusal({"cells": [1, 2]})
        raise ValueError("there are the cells 1 and 2")

    one.serve("battery", refuses)
    until_served(two, "wombat-1", "battery")
    with caplog.at_level(logging.ERROR, "rect"):
        with pytest.raises(rect.ServiceError, match="wombat-1 answers with an error: there are") as raised:
            two.request("wombat-1", "battery", timeout=DEADLINE)
        assert "the service battery raised" in caplog.text
        caplog.clear()
        with pytest.raises(rect.ServiceError) as refused:
            two.request("wombat-1", "battery", "refuse", timeout=DEADLINE)
        assert caplog.text == ""
    assert (raised.value.robot, raised.value.value) == ("wombat-1", "there are the cells 1 and 2")
    assert refused.value.value == {"cells": [1, 2]}


def test_a_handler_that_exits_answers_with_an_error_and_goes_on_serving(
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
        # More often than there are threads that answer.
        for _ in range(AT_A_TIME + 1):
            with pytest.raises(rect.ServiceError, match=r"the service called sys\.exit\(3\)"):
                two.request("wombat-1", "exits", "exit", timeout=DEADLINE)
    assert two.request("wombat-1", "exits", timeout=DEADLINE).value == 1
    assert "the service exits raised" in caplog.text


def test_an_answer_that_can_not_be_sent_arrives_as_an_error(pair: Pair) -> None:
    one, two = pair
    one.serve("long", lambda request: rect.Payload(b"", "x" * 300))
    until_served(two, "wombat-1", "long")
    with pytest.raises(rect.ServiceError, match="is 300 bytes long, and an encoding has at most 200"):
        two.request("wombat-1", "long", timeout=DEADLINE)


def test_a_generator_gives_several_answers_and_all_robots_are_asked(pair: Pair) -> None:
    one, two = pair

    def count(request: rect.Request) -> Iterator[int]:
        yield from range(request.value)

    one.serve("count", count)
    two.serve("count", lambda request: 100)
    until_served(two, "wombat-1", "count")
    with two.request_all("count", 3, timeout=DEADLINE) as replies:
        answers = sorted((reply.sender, reply.value) for reply in replies)
    assert answers == [("wombat-1", 0), ("wombat-1", 1), ("wombat-1", 2), ("wombat-2", 100)]


def test_nobody_serves_it_and_it_is_said_who_is_there(pair: Pair) -> None:
    with pytest.raises(rect.NoService, match="nobody serves nothing at wombat-9; robots there: wombat-1"):
        pair[1].request("wombat-9", "nothing", timeout=DEADLINE)


def test_an_answer_that_does_not_come_is_timed_out(pair: Pair) -> None:
    one, two = pair
    go_on = threading.Event()
    one.serve("slow", lambda request: go_on.wait(DEADLINE))
    until_served(two, "wombat-1", "slow")
    with pytest.raises(rect.TimedOut, match="no answer about slow within 200 ms"):
        two.request("wombat-1", "slow", timeout=0.2)
    go_on.set()


def test_sixteen_are_worked_on_at_a_time(pair: Pair) -> None:
    one, two = pair
    together = threading.Barrier(16)
    one.serve("together", lambda request: together.wait(DEADLINE) >= 0)
    until_served(two, "wombat-1", "together")
    answers = []
    threads = [
        threading.Thread(target=lambda: answers.append(two.request("wombat-1", "together", timeout=DEADLINE).value))
        for _ in range(16)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [True] * 16


def test_a_closed_service_is_gone(pair: Pair) -> None:
    one, two = pair
    with one.serve("once", lambda request: 1):
        until_served(two, "wombat-1", "once")
        assert two.request("wombat-1", "once", timeout=DEADLINE).value == 1
    with pytest.raises(rect.NoService):
        two.request("wombat-1", "once", timeout=DEADLINE)


def test_a_stock_program_asks(pair: Pair) -> None:
    one, two = pair
    one.serve("who", lambda request: [request.sender, request.value])
    until_served(two, "wombat-1", "who")
    replies = two.zenoh.get("rect/wombat-1/who", payload=b"7", encoding="application/json", timeout=DEADLINE)
    answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
    assert answers == [b"[null,7]"]


def test_a_packed_request_is_unpacked(pair: Pair) -> None:
    one, two = pair
    one.serve("length", lambda request: len(request.value))
    until_served(two, "wombat-1", "length")
    assert two.request("wombat-1", "length", "x" * 5000, codec="zstd", timeout=DEADLINE).value == 5000


def test_an_error_is_of_the_robot_that_was_asked_whatever_name_it_has(pair: Pair) -> None:
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
