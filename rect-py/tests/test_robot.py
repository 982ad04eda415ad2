"""Two robots, linked directly, say and hear; and what they are told when they may not.

pytest rect-py/tests/test_robot.py
"""

from __future__ import annotations

import logging
import queue
import sys
import threading
import zlib
from collections.abc import Callable
from typing import Any

import numpy
import pytest
import rect
from conftest import DEADLINE, free_port, until_heard

Pair = tuple[rect.Robot, rect.Robot]


def test_what_is_said_to_all_is_heard_with_who_when_and_which(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("*/arm/*")
    until_heard(one, "arm/angle")
    for number in range(3):
        one.publish("arm/angle", {"degrees": number}, urgency="urgent")
    messages = [heard.next(DEADLINE) for _ in range(3)]
    assert [message.value for message in messages] == [{"degrees": number} for number in range(3)]
    first = messages[0]
    assert (first.sender, first.from_, first.topic, first.to) == ("wombat-1", "wombat-1", "arm/angle", None)
    assert (first.urgency, first.encoding, first.sequence, first.missed) == ("urgent", "application/json", 0, 0)
    assert first.sent_at is not None
    assert heard.tallies == {"wombat-1": rect.Tally(3, 0)}
    assert (two.counters().received, one.counters().sent) == (3, 3)


def test_what_is_said_to_one_is_heard_by_that_one_alone(pair: Pair) -> None:
    one, two = pair
    mine, anyones = two.subscribe("wombat-1/note"), one.subscribe("*/**")
    until_heard(one, "to/wombat-2/note")
    one.send("wombat-2", "note", "psst")
    one.publish("after", "")
    message = mine.next(DEADLINE)
    assert (message.value, message.to) == ("psst", "wombat-2")
    assert anyones.next(DEADLINE).topic == "after"


@pytest.mark.parametrize(
    ("value", "codec"),
    [
        ("text", None),
        (b"\0bytes", None),
        ([1, 2.5, None, True], "zstd"),
        ({"big": "x" * 100_000}, "zstd:19"),
        (rect.Cbor({"raw": b"\0"}), None),
        (rect.Picture.of_pixels(2, 2, "rgb8", bytes(12)), "png"),
    ],
)
def test_every_kind_of_value_arrives_as_what_it_is(pair: Pair, value: Any, codec: str | None) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/thing")
    until_heard(one, "thing")
    one.publish("thing", value, codec=codec)
    assert heard.next(DEADLINE).value == (value.value if isinstance(value, rect.Cbor) else value)


def test_an_array_arrives_as_one(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/thing")
    until_heard(one, "thing")
    array = numpy.arange(6, dtype=numpy.float32).reshape(2, 3)
    one.publish("thing", array)
    assert numpy.array_equal(heard.next(DEADLINE).value, array)


def test_a_dictionary_is_fetched_by_whoever_hears(pair: Pair) -> None:
    one, two = pair
    samples = [b'{"angle_deg": %d, "moving": true, "battery_volt": 7.2}' % n for n in range(2000)]
    codec = one.share(rect.Dictionary.train(samples, 4096))
    heard = two.subscribe("wombat-1/telemetry")
    until_heard(one, "telemetry")
    value = {"angle_deg": 45, "moving": False, "battery_volt": 7.1}
    for _ in range(2):
        one.publish("telemetry", value, codec=codec)
        message = heard.next(DEADLINE)
        assert (message.value, message.flaw) == (value, None)


def test_a_callback_is_called_for_each_and_goes_on_after_it_raised(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    one, two = pair
    done = threading.Event()
    values: list[Any] = []

    def callback(message: rect.Message) -> None:
        values.append(message.value)
        if message.value == 1:
            raise ValueError("on purpose")
        if message.value == 2:
            done.set()

    two.subscribe("wombat-1/count", callback)
    until_heard(one, "count")
    with caplog.at_level(logging.ERROR, "rect"):
        for number in range(3):
            one.publish("count", number)
        assert done.wait(DEADLINE)
    assert values == [0, 1, 2]
    assert "the callback for wombat-1/count raised" in caplog.text
    assert "on purpose" in caplog.text


@pytest.mark.parametrize(("when_full", "kept"), [("newest wins", [8, 9]), ("oldest wins", [0, 1])])
def test_what_has_no_room_is_dropped_and_counted(pair: Pair, when_full: str, kept: list[int]) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/count", capacity=2, when_full=when_full)
    last = two.subscribe("wombat-1/count")
    until_heard(one, "count")
    for number in range(10):
        one.publish("count", number)
    for number in range(10):
        assert last.next(DEADLINE).value == number
    assert heard.dropped == 8
    assert [heard.next(DEADLINE).value for _ in range(2)] == kept


def test_where_the_rule_is_to_wait_nothing_is_dropped(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/count", capacity=1, when_full="wait")
    until_heard(one, "count")
    for number in range(50):
        one.publish("count", number)
    assert [heard.next(DEADLINE).value for _ in range(50)] == list(range(50))
    assert heard.dropped == 0


def test_the_next_message_is_listened_for(pair: Pair) -> None:
    one, two = pair
    with pytest.raises(rect.TimedOut, match="no message wombat-1/arm within 10 ms"):
        two.listen("wombat-1", "arm", 0.01)

    def say() -> None:
        until_heard(one, "arm")
        one.publish("arm", 7)

    saying = threading.Thread(target=say)
    saying.start()
    assert two.listen("wombat-1", "arm", DEADLINE).value == 7
    saying.join()


def test_a_stock_program_is_heard_and_hears(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/plain")
    until_heard(one, "plain")
    one.zenoh.put("rect/wombat-1/plain", b"7", encoding="application/json")
    message = heard.next(DEADLINE)
    assert (message.value, message.sequence, message.sent_at) == (7, None, None)


def test_what_is_damaged_is_delivered_as_it_came_with_the_reason(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/plain")
    until_heard(one, "plain")
    one.zenoh.put("rect/wombat-1/plain", b"no frame", encoding="application/json;zstd")
    message = heard.next(DEADLINE)
    assert message.payload.bytes == b"no frame"
    assert isinstance(message.flaw, rect.CodecError)
    with pytest.raises(rect.CodecError, match="no valid zstd"):
        _ = message.value


def test_messages_are_shown(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/thing")
    until_heard(one, "thing")
    one.publish("thing", "<b>")
    one.publish("thing", rect.Picture.of_pixels(1, 1, "grey8", b"\0"))
    text, picture = heard.next(DEADLINE), heard.next(DEADLINE)
    assert repr(text) == "Message(wombat-1/thing, '<b>')"
    assert "&lt;b&gt;" in text._repr_html_()
    assert "data:image/png" in picture._repr_html_()


def test_what_nobody_has_any_more_ends(pair: Pair) -> None:
    one, _ = pair
    one.subscribe("*/x")
    handles = len(one._session.handles)
    one.publish("y", "")
    assert len(one._session.handles) == handles - 1


def test_peers_are_those_that_are_there(pair: Pair) -> None:
    one, two = pair
    assert (one.peers(), two.peers()) == (["wombat-2"], ["wombat-1"])
    with two.on_state() as events:
        assert events.next(DEADLINE) == rect.Event("peer_up", "wombat-1")
        one.close()
        assert {events.next(DEADLINE).what for _ in range(2)} == {"peer_down", "link_down"}


def test_state_goes_to_a_callback(pair: Pair) -> None:
    _, two = pair
    seen: list[rect.Event] = []
    came = threading.Event()

    def told(event: rect.Event) -> None:
        seen.append(event)
        came.set()

    two.on_state(told)
    assert came.wait(DEADLINE)
    assert seen == [rect.Event("peer_up", "wombat-1")]


_TOO_LONG = "is 304 bytes long, and an encoding has at most 200"
_NUMBER: Any = 7
_TEXT: Any = "x"
_NO_SECONDS = "timeout is a number of seconds, not a str"


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        (lambda robot: robot.publish("a b/*", 1), rect.InvalidTopicError, "has a wildcard in it"),
        (lambda robot: robot.publish("", 1), rect.InvalidTopicError, "a topic is 1 to 200 bytes long"),
        (lambda robot: robot.publish("/a", 1), rect.InvalidTopicError, 'the topic "/a" is not one'),
        (lambda robot: robot.publish("@rect/x", 1), rect.InvalidTopicError, "for RECT's own messages"),
        (lambda robot: robot.publish("x" * 201, 1), rect.InvalidTopicError, "a topic is 1 to 200 bytes long"),
        (lambda robot: robot.publish(7, 1), TypeError, "topic is text, not a int"),
        (lambda robot: robot.publish("a\nb", 1), rect.InvalidTopicError, "the character U+000A in it"),
        (lambda robot: robot.publish("a\u202eb", 1), rect.InvalidTopicError, "the character U+202E in it"),
        (lambda robot: robot.subscribe("*/a\x1b[2J/**"), rect.InvalidTopicError, "the character U+001B in it"),
        (lambda robot: robot.serve("a\x7f", print), rect.InvalidTopicError, "the character U+007F in it"),
        (lambda robot: robot.publish("x", rect.Payload(b"", "a/b;" + "x" * 300)), rect.PayloadError, _TOO_LONG),
        (lambda robot: robot.send("a", "x", rect.Payload(b"", "ä" * 110)), rect.PayloadError, "is 220 bytes long"),
        (lambda robot: robot.request("a", "x", rect.Payload(b"", "x" * 304)), rect.PayloadError, _TOO_LONG),
        (lambda robot: robot.transfer("a", "x", rect.Payload(b"", "x" * 304)), rect.PayloadError, _TOO_LONG),
        (lambda robot: robot.publish("x", rect.Payload(b"", _NUMBER)), TypeError, "an encoding is text, not a int"),
        (lambda robot: robot.publish("x", rect.Payload(_TEXT)), TypeError, "a payload has bytes, not a str"),
        (lambda robot: robot.publish("x", rect.Payload(b"", "\ud800")), rect.PayloadError, "not text in UTF-8"),
        (lambda robot: robot.publish("x", 1, urgency="soon"), rect.OptionError, 'the option urgency can\'t be "soon"'),
        (lambda robot: robot.publish("x", 1, codec="zip"), rect.CodecError, 'there is no codec "zip"'),
        (lambda robot: robot.publish("x", 1, codec=7), TypeError, "codec is text such as"),
        (lambda robot: robot.send("wombat 2", "x", 1), rect.InvalidNameError, "has ' ' in it"),
        (lambda robot: robot.send("wömbat", "x", 1), rect.InvalidNameError, "has 'ö' in it"),
        (lambda robot: robot.send("", "x", 1), rect.InvalidNameError, "1 to 29 bytes long"),
        (lambda robot: robot.send(None, "x", 1), TypeError, "robot is text, not a NoneType"),
        (lambda robot: robot.subscribe("arm"), rect.InvalidTopicError, "a pattern is `<robot>/<topic>`"),
        (lambda robot: robot.subscribe("*/x", 7), TypeError, "callback is a function, not a int"),
        (lambda robot: robot.subscribe("*/x", when_full="?"), rect.OptionError, '"newest wins"'),
        (lambda robot: robot.subscribe("*/x", capacity="1"), TypeError, "capacity is a whole number, not a str"),
        (lambda robot: robot.subscribe("*/x", capacity=-1), rect.OptionError, "the option capacity can't be -1"),
        (lambda robot: robot.subscribe("*/x", capacity=0), rect.OptionError, "a whole number from 1 on"),
        (lambda robot: robot.subscribe("*/x", capacity=2**70), rect.OptionError, "the option capacity can't be"),
        (lambda robot: robot.subscribe("*/x", when_full=1), TypeError, "when_full is text, not a int"),
        (lambda robot: robot.watch("a", "x", capacity=-1), rect.OptionError, "the option capacity can't be -1"),
        (lambda robot: robot.subscribe("*/x").next(timeout="x"), TypeError, _NO_SECONDS),
        (lambda robot: robot.subscribe("*/x").next(timeout=float("nan")), rect.OptionError, "the option timeout can't"),
        (lambda robot: robot.watch("a", "x").next(timeout="x"), TypeError, _NO_SECONDS),
        (lambda robot: robot.on_state().next(timeout="x"), TypeError, _NO_SECONDS),
        (lambda robot: robot.receive_transfers("*/x").next(timeout="x"), TypeError, _NO_SECONDS),
        (lambda robot: robot.receive_transfers("*/x", at_once=0), rect.OptionError, "the option at_once can't be 0"),
        (lambda robot: robot.receive_transfers("*/x", max_bytes=-1), rect.OptionError, "the option max_bytes can't be"),
        (lambda robot: robot.add_connection("a", "tcp", "b", port=-1), rect.OptionError, "the option port can't be -1"),
        (lambda robot: robot.add_connection("a", "tcp", "b", port="7"), TypeError, "port is a whole number, not a str"),
        (lambda robot: robot.listen("*", "x", 1), rect.InvalidNameError, "has '*' in it"),
        (lambda robot: robot.listen("a", "x", -1), rect.OptionError, "the option timeout can't be -1"),
        (lambda robot: robot.request("a", "x", timeout="1"), TypeError, "timeout is a number of seconds, not a str"),
        (lambda robot: robot.serve("x", 7), TypeError, "handler is a function, not a int"),
        (lambda robot: robot.stream("x", mode="fast"), rect.OptionError, '"adaptive", "fixed" or "sensor"'),
        (lambda robot: robot.stream("x", frames_per_s=0), rect.OptionError, "the option frames_per_s can't be"),
        (lambda robot: robot.stream("x", photographs="gif"), rect.OptionError, '"jpeg" or "webp"'),
        (lambda robot: robot.transfer("a", "x", "/no/such/file"), rect.FileError, "/no/such/file: No such file"),
        (lambda robot: robot.transfer("a", "x", b"", name="../x"), rect.TransferError, "can't name a file here"),
    ],
)
def test_what_is_wrong_is_named(
    pair: Pair, wrong: Callable[[rect.Robot], object], error: type[Exception], said: str
) -> None:
    with pytest.raises(error) as raised:
        wrong(pair[0])
    assert said in str(raised.value)


@pytest.mark.parametrize("name", ["", "a b", "a/b", "*", "wömbat", "hci0", "sim-1", "x" * 30])
def test_a_robot_that_may_not_be_called_so_does_not_join(name: str) -> None:
    with pytest.raises(rect.InvalidNameError):
        rect.connect(name)
    with pytest.raises(rect.InvalidNameError):
        rect.connect("wombat-1", fleet=name)


def test_without_a_router_it_is_said_how_to_start_one() -> None:
    with pytest.raises(rect.NoRouter, match=r"`python -m rect router -l tcp/127.0.0.1:7447` starts one here"):
        rect.connect("wombat-1", router="tcp/127.0.0.1:9", timeout=0.2)


def test_a_locator_that_is_none_is_named() -> None:
    with pytest.raises(rect.OptionError, match="listen or endpoint"):
        rect.connect("wombat-1", listen=["nonsense/127.0.0.1:7447"])
    with pytest.raises(rect.OptionError, match="listen/endpoints"):
        rect.connect("wombat-1", listen=["nonsense"])
    with pytest.raises(rect.OptionError, match="no/such/setting"):
        rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"], zenoh={"no/such/setting": 1})
    wrong: Any = "tcp/127.0.0.1:0"
    with pytest.raises(TypeError, match="listen is a list of locators"):
        rect.connect("wombat-1", listen=wrong)


def test_options_of_another_type_are_named() -> None:
    wrong: Any
    for wrong in ("fleet", ("fleet",), ("fleet", 7)):
        with pytest.raises(TypeError, match=r"login is \(user, password\), two texts"):
            rect.connect("wombat-1", login=wrong)
    wrong = 7
    with pytest.raises(TypeError, match="endpoints is a list of locators"):
        rect.connect("wombat-1", endpoints=wrong)


def test_an_encoding_that_is_too_long_leaves_the_session_as_it_was(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/x")
    until_heard(one, "x")
    with pytest.raises(rect.PayloadError):
        one.publish("x", rect.Payload(b"", "a/b;" + "x" * 300))
    longest = rect.Payload(b"1", "a/b;" + "x" * 196)
    one.publish("x", longest)
    assert heard.next(DEADLINE).payload == longest


def test_a_message_of_another_program_with_an_invalid_topic_is_dropped_and_counted(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/**")
    until_heard(one, "x")
    one.zenoh.put("rect/wombat-1/a\x1b]0;pwned\x07\x1b[2Jb\nfake/c", b"12.5")
    one.publish("x", 1)
    assert heard.next(DEADLINE).topic == "x"
    assert (two.counters().received, two.counters().rejected) == (1, 1)


def test_a_callback_that_exits_is_called_for_the_next_message(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    calls: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def exits(message: rect.Message) -> None:
        calls.put(message.value)
        sys.exit(3)

    with caplog.at_level(logging.ERROR, "rect"), two.subscribe("wombat-1/x", exits):
        until_heard(one, "x")
        one.publish("x", 1)
        one.publish("x", 2)
        assert [calls.get(timeout=DEADLINE) for _ in range(2)] == [1, 2]
    assert "the callback for wombat-1/x raised" in caplog.text


def test_a_closed_robot_says_so(pair: Pair) -> None:
    one, _ = pair
    heard = one.subscribe("*/x")
    one.close()
    one.close()
    assert list(heard) == []
    assert repr(one) == "Robot(rect/wombat-1, closed)"
    calls: list[Callable[[], object]] = [
        lambda: one.publish("x", 1),
        lambda: one.subscribe("*/x"),
        lambda: one.request("wombat-2", "x"),
        lambda: one.serve("x", print),
        lambda: one.peers(),
        lambda: one.stream("x"),
        lambda: one.watch("wombat-2", "x"),
        lambda: one.transfer("wombat-2", "x", b""),
        lambda: one.receive_transfers("*/x"),
        lambda: one.on_state(),
        lambda: heard.next(1),
    ]
    for call in calls:
        with pytest.raises(rect.Closed, match="the session is closed"):
            call()


def test_many_threads_say_things_at_once(pair: Pair) -> None:
    one, two = pair
    heard = two.subscribe("wombat-1/count", capacity=10_000)
    until_heard(one, "count")

    def count() -> None:
        for number in range(200):
            one.publish("count", number)

    threads = [threading.Thread(target=count) for _ in range(8)]
    for thread in threads:
        thread.start()
    messages = [heard.next(DEADLINE) for _ in range(1600)]
    for thread in threads:
        thread.join()
    assert [message.sequence for message in messages] == list(range(1600))
    assert heard.tallies["wombat-1"] == rect.Tally(1600, 0)


def test_a_dictionary_of_one_robot_is_not_used_for_anothers_messages() -> None:
    samples = [b'{"angle_deg": %d, "moving": true, "battery_volt": 7.2}' % n for n in range(2000)]
    dictionary = rect.Dictionary.train(samples, 4096)
    begun = zlib.crc32(bytes(dictionary)[8:])
    suffixes = (n.to_bytes(4, "little") for n in range(2**32))
    suffix = next(suffix for suffix in suffixes if 32768 + zlib.crc32(suffix, begun) % 32768 == dictionary.id)
    same_id = rect.Dictionary(bytes(dictionary) + suffix)
    assert same_id.id == dictionary.id
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    value = {"angle_deg": 45, "moving": False, "battery_volt": 7.1}
    with (
        rect.connect("wombat-2", listen=[endpoint]) as two,
        rect.connect("other", endpoints=[endpoint]) as other,
        rect.connect("honest", endpoints=[endpoint]) as honest,
    ):
        heard = two.subscribe("*/telemetry")
        for robot, known in ((other, same_id), (honest, dictionary)):
            codec = robot.share(known)
            until_heard(robot, "telemetry")
            robot.publish("telemetry", value, codec=codec)
            message = heard.next(DEADLINE)
            assert (message.sender, message.flaw, message.value) == (robot.name, None, value)
