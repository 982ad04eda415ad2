"""Values as the type that the program states: what fits, what does not, and how that is reported."""

from __future__ import annotations

import asyncio
import dataclasses
import enum
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any, Literal, NamedTuple, Optional, TypedDict, Union

import msgspec
import numpy
import pydantic
import pytest
import rect
from conftest import DEADLINE, Pair, connected_pair, until, until_served, until_subscribed
from rect import aio
from rect.typed import Converter, converter_of


class Mode(enum.Enum):
    IDLE = "idle"
    DRIVING = "driving"


@dataclass
class Cell:
    volt: float
    hot: bool = False


@dataclass
class Battery:
    percent: float
    cells: list[Cell] = field(default_factory=list)
    mode: Mode = Mode.IDLE
    read_at: datetime | None = None
    labels: dict[str, int] = field(default_factory=dict)


@dataclass
class Node:
    next: Node | None


class Pose(pydantic.BaseModel):
    x: float
    y: float = 0.0


class Grab(msgspec.Struct):
    force: float
    fingers: list[int] = []


class Size(TypedDict):
    width: int


@dataclass
class Socket:
    of: Iterator[int]


AT = datetime(2026, 11, 29, 12, 30, tzinfo=timezone.utc)


@pytest.mark.parametrize(
    ("type", "value", "expected"),
    [
        (int, 3, 3),
        (int, 3.0, 3),
        (float, 3, 3.0),
        (str, "ä", "ä"),
        (bool, True, True),
        (bytes, b"\0", b"\0"),
        (Any, {"a": [1]}, {"a": [1]}),
        (list[float], [1, 2.5], [1.0, 2.5]),
        (list, ["a", 1], ["a", 1]),
        (tuple[int, str], [1, "a"], (1, "a")),
        (tuple[int, ...], [1, 2, 3], (1, 2, 3)),
        (set[str], ["a", "b"], {"a", "b"}),
        (dict[str, float], {"a": 1}, {"a": 1.0}),
        (dict[int, str], {"7": "a"}, {7: "a"}),
        (Optional[int], None, None),
        (Union[int, str], "a", "a"),
        (Union[float, int], 3, 3),
        (Literal["left", "right"], "left", "left"),
        (datetime, "2026-11-29T12:30:00Z", AT),
        (datetime, "2026-11-29T12:30:00", AT),
        (Mode, "driving", Mode.DRIVING),
        (list[Mode], ["idle"], [Mode.IDLE]),
        (Size, {"width": 3, "more": 1}, {"width": 3}),
        (Battery, {"percent": 80, "unknown": 1}, Battery(80.0)),
        (
            Battery,
            {"percent": 1.5, "cells": [{"volt": 3.6, "hot": True}], "mode": "driving", "labels": {"a": 1}},
            Battery(1.5, [Cell(3.6, True)], Mode.DRIVING, None, {"a": 1}),
        ),
        (Pose, {"x": 1}, Pose(x=1)),
        (Grab, {"force": 2.5, "fingers": [1]}, Grab(2.5, [1])),
        (list[Pose], [{"x": 1, "y": 2}], [Pose(x=1, y=2)]),
        (numpy.ndarray, numpy.zeros(3), None),
    ],
)
def test_values_become_the_type(type: Any, value: Any, expected: Any) -> None:
    converted = Converter(type).convert(value)
    if expected is None and value is not None:
        assert converted is value
    else:
        assert converted == expected
        assert repr(converted) == repr(expected)


@pytest.mark.parametrize(
    ("type", "value", "problem"),
    [
        (float, "80", "expected a number, found the text '80'"),
        (float, True, "expected a number, found true"),
        (int, 2.5, "expected an integer, found the number 2.5"),
        (int, float("nan"), "expected an integer, found NaN"),
        (int, None, "expected an integer, found nothing (null)"),
        (str, 5, "expected text, found the number 5"),
        (bool, 1, "expected true or false, found the number 1"),
        (bytes, "a", "expected bytes, found the text 'a'"),
        (list[int], {"a": 1}, "expected a list, found an object with the fields a"),
        (list[int], [1, "b"], "field [1]: expected an integer, found the text 'b'"),
        (tuple[int, str], [1], "expected a list of 2, found a list of 1"),
        (dict[str, float], {"a": None}, "field a: expected a number, found nothing (null)"),
        (dict[int, str], {"a": "b"}, "field a: expected an integer, found the text 'a'"),
        (Union[int, str], None, "expected an integer or text, found nothing (null)"),
        (Literal[1, "a"], True, "expected one of 1, 'a', found true"),
        (Literal["a"], [1], "expected one of 'a', found a list of 1"),
        (datetime, "noon", "expected a time such as 2026-11-29T12:00:00Z, found the text 'noon'"),
        (Mode, "flying", "expected one of 'idle', 'driving', found the text 'flying'"),
        (Size, {}, "field width: expected a value, found no such field"),
        (Battery, {}, "field percent: expected a value, found no such field"),
        (Battery, [1], "expected an object, found a list of 1"),
        (
            Battery,
            {"percent": 1, "cells": [{"volt": 1}, {"volt": "low"}]},
            "field cells[1].volt: expected a number, found the text 'low'",
        ),
        (Optional[Cell], {"volt": []}, "field volt: expected a number, found a list of 0"),
        (Pose, {}, "field x: expected a value, found no such field"),
        (
            Pose,
            {"x": "far"},
            "field x: expected a valid number, unable to parse string as a number, found the text 'far'",
        ),
        (Grab, {"fingers": []}, "field force: expected a value, found no such field"),
        (Grab, {"force": 1, "fingers": [1, "b"]}, "field fingers[1]: expected int, found str"),
        (list[Grab], [{"force": "much"}], "field [0].force: expected float, found str"),
        (rect.Picture, "a", "expected a value of the type Picture, found the text 'a'"),
        (str, "x" * 100, None),
        (int, "x" * 100, f"expected an integer, found the text '{'x' * 59}…'"),
    ],
)
def test_values_that_do_not_fit_are_described(type: Any, value: Any, problem: str | None) -> None:
    if problem is None:
        assert Converter(type).convert(value) == value
        return
    with pytest.raises(rect.MismatchError) as raised:
        Converter(type).convert(value)
    assert str(raised.value) == problem
    assert isinstance(raised.value, rect.PayloadError)


def test_what_a_class_checks_itself_is_reported() -> None:
    @dataclass
    class Percent:
        value: float

        def __post_init__(self) -> None:
            if not 0 <= self.value <= 100:
                raise ValueError("percent must be 0 to 100")

    # Its module cannot resolve annotations of a class inside of a function if they name one; these do not.
    assert Converter(Percent).convert({"value": 7}) == Percent(7.0)
    with pytest.raises(rect.MismatchError, match="percent must be 0 to 100"):
        Converter(Percent).convert({"value": 101})


@pytest.mark.parametrize(
    ("type", "advice"),
    [
        (Node, "Node contains itself (Node -> Node)"),
        (Socket, "values cannot be converted to collections.abc.Iterator[int] (a field of Socket): use a dataclass"),
        (complex, "values cannot be converted to complex: use a dataclass"),
        (print, "is not a type of values: pass a function as callback="),
        (7, "is not a type of values: for example a dataclass"),
    ],
)
def test_types_that_cannot_be_converted_are_errors_at_the_declaration(type: Any, advice: str) -> None:
    with pytest.raises(TypeError) as raised:
        converter_of(type)
    assert advice in str(raised.value)


def test_names_that_cannot_be_resolved_are_explained() -> None:
    @dataclass
    class Inner:
        x: float

    @dataclass
    class Outer:
        inner: Inner

    with pytest.raises(
        TypeError, match=r"cannot be resolved: name 'Inner' is not defined\. Define the classes outside"
    ):
        converter_of(Outer)


@pytest.mark.parametrize("value", [Battery(1.5, [Cell(3.6)], Mode.DRIVING, AT, {"a": 1}), Pose(x=1), Grab(1.5, [2])])
def test_what_goes_out_comes_in_as_the_same_type(pair: Pair, value: Any) -> None:
    one, two = pair
    subscriber = two.subscribe("*/value", type(value))
    publisher = one.publisher("value", type(value))
    publisher.wait_for_subscriber(DEADLINE)
    publisher.publish(value)
    one.publish("value", rect.Cbor(value))
    for _ in range(2):
        received = subscriber.next(DEADLINE).value
        assert type(received) is type(value)
        assert received == value


def test_problem_is_reported_and_counted_and_warned_of_once(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    subscriber = two.subscribe("*/battery", Battery)
    until_subscribed(one, "battery")
    with caplog.at_level(logging.WARNING, "rect"):
        for value in ({"percent": "full"}, {"percent": "empty"}, {"percent": 50}, "not even JSON"):
            one.publish("battery", value)
        messages = [subscriber.next(DEADLINE) for _ in range(4)]
    problem = messages[0].problem
    assert isinstance(problem, rect.MismatchError)
    assert (problem.field, problem.expected, problem.found) == ("percent", "a number", "the text 'full'")
    with pytest.raises(rect.MismatchError):
        _ = messages[0].value
    assert messages[0].payload.value == {"percent": "full"}, "the payload is there"
    assert (messages[2].problem, messages[2].value) == (None, Battery(50.0))
    assert str(messages[3].problem) == "expected an object, found the text 'not even JSON'"
    assert two.counters().problems == 3
    warning = "battery of wombat-1: field percent: expected a number, found the text 'full'"
    assert [record.getMessage() for record in caplog.records] == [warning]


def test_names_that_nobody_has_are_warned_of_within_3_s(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    stream = one.stream("camera")
    begun = time.monotonic()
    with caplog.at_level(logging.WARNING, "rect"):
        kept = [two.subscribe("arm/angle"), two.subscribe("wombat-1/arm"), two.watch("wombat-1/camra")]
        one.publish("arm angle", 1)
        with pytest.raises(rect.TimedOut, match="did you mean wombat-1"):
            two.wait_for_peer("wombt-1", 3)
        until(lambda: len(caplog.records) == 4)
    assert time.monotonic() - begun < DEADLINE
    texts = sorted(record.getMessage() for record in caplog.records)
    assert texts == [
        "no robot called arm is reachable yet; reachable robots: wombat-1. The pattern arm/angle means the robot arm; "
        "for the topic arm/angle of every robot, use */arm/angle",
        "no robot called wombt-1 is reachable yet; did you mean wombat-1? (reachable robots: wombat-1)",
        'the topic "arm angle" contains a space, and only programs that write it in the same way receive it; '
        "`rect topic list` lists the topics of all robots",
        "wombat-1 has no stream camra yet; did you mean camera? (its streams: camera)",
    ]
    del kept, stream


def test_large_value_that_does_not_fit_is_shown_briefly(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("*/numbers", list[int])
    until_subscribed(one, "numbers")
    one.publish("numbers", [0] * 2_000_000 + ["x" * 2_000_000])
    problem = subscriber.next(DEADLINE).problem
    assert isinstance(problem, rect.MismatchError)
    assert (problem.field, len(str(problem))) == ("[2000000]", 115)


def test_array_of_numbers_fits_a_list(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("*/scan", list[float])
    until_subscribed(one, "scan")
    one.publish("scan", numpy.array([1.5, 2.5]))
    assert subscriber.next(DEADLINE).value == [1.5, 2.5]


def test_callback_receives_typed_messages(pair: Pair) -> None:
    one, two = pair
    received: list[rect.Message[Battery]] = []
    with two.subscribe("*/battery", Battery, callback=received.append):
        until_subscribed(one, "battery")
        one.publish("battery", Battery(80))
        until(lambda: bool(received))
    assert received[0].value == Battery(80)


def test_publisher_accepts_only_its_type(pair: Pair) -> None:
    publisher = pair[0].publisher("battery", Battery)
    with pytest.raises(TypeError, match="the value must be of the type Battery, not dict"):
        publisher.publish({"percent": 1})  # type: ignore[arg-type]
    number = pair[0].publisher("number", float)
    number.publish(1)
    with pytest.raises(TypeError, match="the value must be of the type float, not str"):
        number.publish("1")  # type: ignore[arg-type]


def test_services_and_replies_have_types(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair

    @one.serve("grab")
    def grab(request: rect.Request[Grab]) -> Pose:
        return Pose(x=request.value.force)

    until_served(two, "wombat-1", "grab")
    reply = two.request("wombat-1", "grab", Grab(2.5), returns=Pose)
    assert reply.value == Pose(x=2.5)
    assert [reply.value for reply in two.request_all("grab", Grab(1.5), returns=Pose)] == [Pose(x=1.5)]
    problem = "grab: field force: expected a value, found no such field"
    with caplog.at_level(logging.WARNING, "rect"), pytest.raises(rect.ServiceError, match=problem):
        two.request("wombat-1", "grab", {"fingers": [1]})
    assert "grab of wombat-2: field force: expected a value" in caplog.text
    assert one.counters().problems == 1
    with pytest.raises(rect.MismatchError, match="expected an integer, found an object with the fields x, y"):
        _ = two.request("wombat-1", "grab", Grab(2.5), returns=int).value
    del grab


def test_handler_with_a_type_that_cannot_be_converted_is_an_error(pair: Pair) -> None:
    def handler(request: rect.Request[Node]) -> None:
        raise AssertionError(request)

    with pytest.raises(TypeError, match="Node contains itself"):
        pair[0].serve("x", handler)


def test_other_annotations_of_a_handler_are_not_resolved(pair: Pair) -> None:
    def handler(request: list[Unknown]) -> int:  # type: ignore[name-defined]  # noqa: F821
        return len(request)

    pair[0].serve("other", handler).close()  # type: ignore[arg-type]


def test_asyncio_has_the_same_types() -> None:
    async def run() -> None:
        with connected_pair() as (one, two):
            here, there = aio.Robot(one), aio.Robot(two)
            subscriber = there.subscribe("*/battery", Battery)
            await asyncio.to_thread(until_subscribed, one, "battery")
            await here.publisher("battery", Battery).publish(Battery(80))
            await here.publish("battery", {"percent": None})
            assert (await subscriber.next(DEADLINE)).value == Battery(80)
            assert (await subscriber.next(DEADLINE)).problem is not None

            async def double(request: rect.Request[int]) -> int:
                return request.value * 2

            service = here.serve("double", double)
            await asyncio.to_thread(until_served, two, "wombat-1", "double")
            assert (await there.request("wombat-1", "double", 21, returns=int)).value == 42
            with pytest.raises(rect.ServiceError, match="double: expected an integer, found the text 'x'"):
                await there.request("wombat-1", "double", "x")
            service.close()

    asyncio.run(run())


def test_sender_may_change_its_type(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("*/x", Union[int, str])
    until_subscribed(one, "x")
    for value in (1, "a", 2.5, 3):
        one.publish("x", value)
    received = [subscriber.next(DEADLINE) for _ in range(4)]
    assert [message.problem is None for message in received] == [True, True, False, True]


class Point(NamedTuple):
    x: int


def test_named_tuples_are_not_possible_yet() -> None:
    with pytest.raises(TypeError, match="values cannot be converted to Point"):
        converter_of(Point)
    assert dataclasses.is_dataclass(Cell)
