"""Tests messages between two directly linked robots, and the errors of invalid arguments.

pytest rect-py/tests/test_robot.py
"""

from __future__ import annotations

import logging
import queue
import sys
import threading
import time
import zlib
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy
import pytest
import rect
from conftest import DEADLINE, free_port, until, until_served, until_subscribed
from rect.receive_queue import DEFAULT_CAPACITY

Pair = tuple[rect.Robot, rect.Robot]


def test_published_message_arrives_with_metadata(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("*/arm/*")
    until_subscribed(one, "arm/angle")
    for number in range(3):
        one.publish("arm/angle", {"degrees": number}, urgency="urgent")
    messages = [subscriber.next(DEADLINE) for _ in range(3)]
    assert [message.value for message in messages] == [{"degrees": number} for number in range(3)]
    first = messages[0]
    assert (first.sender, first.topic, first.recipient) == ("wombat-1", "arm/angle", None)
    assert (first.urgency, first.encoding, first.sequence, first.missed) == ("urgent", "application/json", 0, 0)
    assert first.sent_at is not None
    assert timedelta(0) <= datetime.now(timezone.utc) - first.sent_at < timedelta(seconds=DEADLINE)
    assert subscriber.counts_by_sender == {"wombat-1": rect.SenderCounts(3, 0)}
    assert (two.counters().received, one.counters().sent) == (3, 3)


def test_sent_message_arrives_only_at_recipient(pair: Pair) -> None:
    one, two = pair
    note, everything = two.subscribe("wombat-1/note"), one.subscribe("*/**")
    until_subscribed(one, "to/wombat-2/note")
    one.send("wombat-2", "note", "psst")
    one.publish("after", "")
    message = note.next(DEADLINE)
    assert (message.value, message.recipient) == ("psst", "wombat-2")
    assert everything.next(DEADLINE).topic == "after"


def test_message_to_a_robot_that_is_not_reachable_raises_until_it_is() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-1", listen=[endpoint]) as one:
        one.send("wombat-1", "note", "to itself")
        with rect.connect("wombat-2", endpoints=[endpoint]):
            one.wait_for_peer("wombat-2", timeout=DEADLINE)
            one.send("wombat-2", "note", "psst")
            text = r"^wmbat-2 is not reachable; did you mean wombat-2\? \(reachable robots: wombat-2\)$"
            for _ in range(2):
                with pytest.raises(rect.NotReachable, match=text) as raised:
                    one.send("wmbat-2", "note", "psst")
                assert (raised.value.robot, raised.value.available) == ("wmbat-2", ["wombat-2"])
        until(lambda: not sends(one, "wombat-2"))
        with rect.connect("wombat-2", endpoints=[endpoint]) as two, two.subscribe("wombat-1/note") as notes:
            until_subscribed(one, "to/wombat-2/note")
            until(lambda: sends(one, "wombat-2"))
            assert notes.next(DEADLINE).value == "psst"


def sends(robot: rect.Robot, other: str) -> bool:
    """Returns whether the robot can send to the other one."""
    try:
        robot.send(other, "note", "psst")
    except rect.NotReachable:
        return False
    return True


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
def test_value_of_each_type_arrives_unchanged(pair: Pair, value: Any, codec: str | None) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/thing")
    until_subscribed(one, "thing")
    one.publish("thing", value, codec=codec)
    assert subscriber.next(DEADLINE).value == (value.value if isinstance(value, rect.Cbor) else value)


def test_array_arrives_unchanged(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/thing")
    until_subscribed(one, "thing")
    array = numpy.arange(6, dtype=numpy.float32).reshape(2, 3)
    one.publish("thing", array)
    assert numpy.array_equal(subscriber.next(DEADLINE).value, array)


def test_subscriber_fetches_dictionary(pair: Pair) -> None:
    one, two = pair
    samples = [b'{"angle_deg": %d, "moving": true, "battery_volt": 7.2}' % n for n in range(2000)]
    codec = one.share_dictionary(rect.Dictionary.train(samples, 4096))
    subscriber = two.subscribe("wombat-1/telemetry")
    until_subscribed(one, "telemetry")
    value = {"angle_deg": 45, "moving": False, "battery_volt": 7.1}
    for _ in range(2):
        one.publish("telemetry", value, codec=codec)
        message = subscriber.next(DEADLINE)
        assert (message.value, message.problem) == (value, None)


def test_callback_is_called_again_after_exception(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    done = threading.Event()
    values: list[Any] = []

    def callback(message: rect.Message) -> None:
        values.append(message.value)
        if message.value == 1:
            raise ValueError("on purpose")
        if message.value == 2:
            done.set()

    two.subscribe("wombat-1/count", callback=callback)
    until_subscribed(one, "count")
    with caplog.at_level(logging.ERROR, "rect"):
        for number in range(3):
            one.publish("count", number)
        assert done.wait(DEADLINE)
    assert values == [0, 1, 2]
    assert "the callback for wombat-1/count raised an exception" in caplog.text
    assert "on purpose" in caplog.text


@pytest.mark.parametrize(("when_full", "kept"), [("drop_oldest", [8, 9]), ("drop_newest", [0, 1])])
def test_full_queue_drops_and_counts_messages(pair: Pair, when_full: rect.WhenFull, kept: list[int]) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/count", capacity=2, when_full=when_full)
    last = two.subscribe("wombat-1/count")
    until_subscribed(one, "count")
    for number in range(10):
        one.publish("count", number)
    for number in range(10):
        assert last.next(DEADLINE).value == number
    assert subscriber.dropped == 8
    assert [subscriber.next(DEADLINE).value for _ in range(2)] == kept


def test_blocking_queue_drops_nothing(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/count", capacity=1, when_full="block")
    until_subscribed(one, "count")
    for number in range(50):
        one.publish("count", number)
    assert [subscriber.next(DEADLINE).value for _ in range(50)] == list(range(50))
    assert subscriber.dropped == 0


def test_message_that_is_read_too_late_has_expired(pair: Pair) -> None:
    one, two = pair
    with two.subscribe("wombat-1/drive") as subscriber:
        until_subscribed(one, "drive")
        steering = one.publisher("drive", expires_after=0.1)
        for value in range(2):
            one.publish("drive", value, expires_after=0.1)
            steering.publish(value)
        one.send("wombat-2", "drive", "old", expires_after=0.1)
        one.publish("drive", "stop")
        stop = subscriber.next(DEADLINE)
        while stop.value != "stop":
            assert not stop.is_expired
            stop = subscriber.next(DEADLINE)
        assert not stop.is_expired
        before = two.counters().expired
        one.publish("drive", "old", expires_after=0.001)
        one.publish("drive", "new", expires_after=60)
        time.sleep(0.3)
        new = subscriber.next(DEADLINE)
        assert new.value == "new"
        assert not new.is_expired
        assert two.counters().expired == before + 1


@pytest.mark.parametrize("expires_after", [-1, float("inf")])
def test_invalid_lifetime_is_named(pair: Pair, expires_after: float) -> None:
    with pytest.raises(rect.OptionError, match="expires_after"):
        pair[0].publish("drive", 1, expires_after=expires_after)


def test_wait_for_message_returns_next_message(pair: Pair) -> None:
    one, two = pair
    with pytest.raises(rect.TimedOut, match="no message wombat-1/arm within 10 ms"):
        two.wait_for_message("wombat-1/arm", timeout=0.01)

    def publish() -> None:
        until_subscribed(one, "arm")
        one.publish("arm", 7)

    publishing = threading.Thread(target=publish)
    publishing.start()
    assert two.wait_for_message("wombat-1/arm", timeout=DEADLINE).value == 7
    publishing.join()


def test_message_of_stock_program_has_no_metadata(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/plain")
    until_subscribed(one, "plain")
    one.zenoh.put("rect/wombat-1/plain", b"7", encoding="application/json")
    message = subscriber.next(DEADLINE)
    assert (message.value, message.sequence, message.sent_at) == (7, None, None)


def test_damaged_message_is_delivered_undecoded_with_problem(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/plain")
    until_subscribed(one, "plain")
    one.zenoh.put("rect/wombat-1/plain", b"no frame", encoding="application/json;zstd")
    message = subscriber.next(DEADLINE)
    assert message.payload.bytes == b"no frame"
    assert isinstance(message.problem, rect.CodecError)
    with pytest.raises(rect.CodecError, match="invalid zstd"):
        _ = message.value


def test_messages_have_text_and_html_representations(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/thing")
    until_subscribed(one, "thing")
    one.publish("thing", "<b>")
    one.publish("thing", rect.Picture.of_pixels(1, 1, "grey8", b"\0"))
    text, picture = subscriber.next(DEADLINE), subscriber.next(DEADLINE)
    assert repr(text) == "Message(wombat-1/thing, '<b>')"
    assert "&lt;b&gt;" in text._repr_html_()
    assert "data:image/png" in picture._repr_html_()


def test_garbage_collected_subscriber_is_undeclared(pair: Pair) -> None:
    one, _ = pair
    one.subscribe("*/x")
    handles = len(one._session.handles)
    one.publish("y", "")
    assert len(one._session.handles) == handles - 1


def test_peers_and_events_report_reachable_robots(pair: Pair) -> None:
    one, two = pair
    assert (one.peers(), two.peers()) == (["wombat-2"], ["wombat-1"])
    with two.events() as events:
        assert events.next(DEADLINE) == rect.Event("peer_up", "wombat-1")
        one.close()
        assert {events.next(DEADLINE).kind for _ in range(2)} == {"peer_down", "link_down"}


def test_events_are_passed_to_callback(pair: Pair) -> None:
    _, two = pair
    seen: list[rect.Event] = []
    received = threading.Event()

    def on_event(event: rect.Event) -> None:
        seen.append(event)
        received.set()

    two.on_event(on_event)
    assert received.wait(DEADLINE)
    assert seen == [rect.Event("peer_up", "wombat-1")]


def test_subscription_to_events_has_counts(pair: Pair) -> None:
    _, two = pair
    received = threading.Event()
    with two.on_event(lambda event: received.set()) as events, two.watch("wombat-1/x", callback=print) as frames:
        assert received.wait(DEADLINE)
        for subscription in (events, frames):
            assert (subscription.dropped, subscription.counts_by_sender) == (0, {})


def test_full_queue_of_events_counts_drops(pair: Pair) -> None:
    _, two = pair
    with two.events() as events:
        events.next(DEADLINE)
        for _ in range(DEFAULT_CAPACITY + 3):
            events._queue.push(("router_up", None, None, None))
        assert events.dropped == 3


_TOO_LONG = "is 304 bytes long, but an encoding has at most 200"
_NUMBER: Any = 7
_TEXT: Any = "x"
_NO_SECONDS = "timeout must be a number of seconds, not str"


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda robot: robot.publish("a b/*", 1), rect.InvalidTopicError, "contains a wildcard"),
        (lambda robot: robot.publish("", 1), rect.InvalidTopicError, "a topic must be 1 to 200 bytes long"),
        (lambda robot: robot.publish("/a", 1), rect.InvalidTopicError, '"/a" is not a valid topic'),
        (lambda robot: robot.publish("@rect/x", 1), rect.InvalidTopicError, "is reserved for internal messages"),
        (lambda robot: robot.publish("x" * 201, 1), rect.InvalidTopicError, "a topic must be 1 to 200 bytes long"),
        (lambda robot: robot.publish(7, 1), TypeError, "topic must be a str, not int"),
        (lambda robot: robot.publish("a\nb", 1), rect.InvalidTopicError, "the character U+000A"),
        (lambda robot: robot.publish("a\u202eb", 1), rect.InvalidTopicError, "the character U+202E"),
        (lambda robot: robot.subscribe("*/a\x1b[2J/**"), rect.InvalidTopicError, "the character U+001B"),
        (lambda robot: robot.serve("a\x7f", print), rect.InvalidTopicError, "the character U+007F"),
        (lambda robot: robot.publish("x", rect.Payload(b"", "a/b;" + "x" * 300)), rect.PayloadError, _TOO_LONG),
        (lambda robot: robot.send("a", "x", rect.Payload(b"", "ä" * 110)), rect.PayloadError, "is 220 bytes long"),
        (lambda robot: robot.request("a", "x", rect.Payload(b"", "x" * 304)), rect.PayloadError, _TOO_LONG),
        (lambda robot: robot.transfer("a", "x", rect.Payload(b"", "x" * 304)), rect.PayloadError, _TOO_LONG),
        (
            lambda robot: robot.publish("x", rect.Payload(b"", _NUMBER)),
            TypeError,
            "Payload.encoding must be a str, not int",
        ),
        (lambda robot: robot.publish("x", rect.Payload(_TEXT)), TypeError, "Payload.bytes must be bytes, not str"),
        (lambda robot: robot.publish("x", rect.Payload(b"", "\ud800")), rect.PayloadError, "not valid UTF-8"),
        (lambda robot: robot.publish("x", 1, urgency="soon"), rect.OptionError, 'the option urgency cannot be "soon"'),
        (lambda robot: robot.publish("x", 1, codec="zip"), rect.CodecError, 'there is no codec "zip"'),
        (lambda robot: robot.publish("x", 1, codec=7), TypeError, "codec must be a name such as"),
        (lambda robot: robot.send("wombat 2", "x", 1), rect.InvalidNameError, "contains ' '"),
        (lambda robot: robot.send("wömbat", "x", 1), rect.InvalidNameError, "contains 'ö'"),
        (lambda robot: robot.send("", "x", 1), rect.InvalidNameError, "1 to 29 bytes long"),
        (lambda robot: robot.send(None, "x", 1), TypeError, "robot must be a str, not NoneType"),
        (lambda robot: robot.subscribe("arm"), rect.InvalidTopicError, "write `<robot>/<topic>`"),
        (lambda robot: robot.subscribe("*/x", callback=7), TypeError, "callback must be a function, not int"),
        (lambda robot: robot.subscribe("*/x", when_full="?"), rect.OptionError, '"drop_oldest"'),
        (lambda robot: robot.subscribe("*/x", capacity="1"), TypeError, "capacity must be an integer, not str"),
        (lambda robot: robot.subscribe("*/x", capacity=-1), rect.OptionError, "the option capacity cannot be -1"),
        (lambda robot: robot.subscribe("*/x", capacity=0), rect.OptionError, "it must be an integer of at least 1"),
        (lambda robot: robot.subscribe("*/x", capacity=2**70), rect.OptionError, "the option capacity cannot be"),
        (lambda robot: robot.subscribe("*/x", when_full=1), TypeError, "when_full must be a str, not int"),
        (lambda robot: robot.watch("a/x", capacity=-1), rect.OptionError, "the option capacity cannot be -1"),
        (lambda robot: robot.subscribe("*/x").next(timeout="x"), TypeError, _NO_SECONDS),
        (
            lambda robot: robot.subscribe("*/x").next(timeout=float("nan")),
            rect.OptionError,
            "the option timeout cannot",
        ),
        (lambda robot: robot.watch("a/x").next(timeout="x"), TypeError, _NO_SECONDS),
        (lambda robot: robot.events().next(timeout="x"), TypeError, _NO_SECONDS),
        (lambda robot: robot.receive_transfers("*/x").next(timeout="x"), TypeError, _NO_SECONDS),
        (
            lambda robot: robot.receive_transfers("*/x", max_concurrent=0),
            rect.OptionError,
            "the option max_concurrent cannot be 0",
        ),
        (
            lambda robot: robot.receive_transfers("*/x", max_bytes=-1),
            rect.OptionError,
            "the option max_bytes cannot be",
        ),
        (
            lambda robot: robot.add_connection("a", "tcp", "b", port=-1),
            rect.OptionError,
            "the option port cannot be -1",
        ),
        (lambda robot: robot.add_connection("a", "tcp", "b", port="7"), TypeError, "port must be an integer, not str"),
        (lambda robot: robot.wait_for_message("a*/x", timeout=1), rect.InvalidNameError, "contains '*'"),
        (lambda robot: robot.wait_for_message("a/x", timeout=-1), rect.OptionError, "the option timeout cannot be -1"),
        (lambda robot: robot.request("a", "x", timeout="1"), TypeError, "timeout must be a number of seconds, not str"),
        (lambda robot: robot.serve("x", 7), TypeError, "handler must be a function, not int"),
        (lambda robot: robot.stream("x", mode="fast"), rect.OptionError, '"video", "fixed" or "sensor"'),
        (
            lambda robot: robot.stream("x", max_frames_per_s=0),
            rect.OptionError,
            "the option max_frames_per_s cannot be",
        ),
        (lambda robot: robot.stream("x", lossy_format="gif"), rect.OptionError, '"jpeg" or "webp"'),
        (lambda robot: robot.transfer("a", "x", "/no/such/file"), rect.FileError, "/no/such/file: No such file"),
        (lambda robot: robot.transfer("a", "x", b"", name="../x"), rect.TransferError, "is not a valid file name"),
    ],
)
def test_invalid_argument_raises_error_that_names_it(
    pair: Pair, call: Callable[[rect.Robot], object], error: type[Exception], text: str
) -> None:
    with pytest.raises(error) as raised:
        call(pair[0])
    assert text in str(raised.value)


@pytest.mark.parametrize("name", ["", "a b", "a/b", "*", "wömbat", "hci0", "sim-1", "x" * 30])
def test_connect_rejects_invalid_name(name: str) -> None:
    with pytest.raises(rect.InvalidNameError):
        rect.connect(name)
    with pytest.raises(rect.InvalidNameError):
        rect.connect("wombat-1", fleet=name)


def test_no_router_error_contains_command_that_starts_one() -> None:
    with pytest.raises(
        rect.NoRouter, match=r"Start one on this computer with `python -m rect router -l tcp/127.0.0.1:9`"
    ):
        rect.connect("wombat-1", router="tcp/127.0.0.1:9", timeout=0.2)


def test_invalid_locator_or_setting_is_named() -> None:
    with pytest.raises(rect.OptionError, match="listen or endpoints"):
        rect.connect("wombat-1", listen=["nonsense/127.0.0.1:7447"])
    nonsense: list[tuple[str, dict[str, Any]]] = [
        ("listen", {"listen": ["nonsense"]}),
        ("endpoints", {"endpoints": ["nonsense"]}),
        ("router", {"router": "nonsense"}),
    ]
    for option, options in nonsense:
        with pytest.raises(rect.OptionError, match=f'the option {option} cannot be "nonsense"'):
            rect.connect("wombat-1", **options)
    with pytest.raises(rect.OptionError, match=r"the option zenoh cannot be .*connect/endpoints"):
        rect.connect("wombat-1", router="tcp/127.0.0.1:7447", zenoh={"connect/endpoints": ["nonsense"]})
    with pytest.raises(rect.OptionError, match="no/such/setting"):
        rect.connect("wombat-1", listen=["tcp/127.0.0.1:0"], zenoh={"no/such/setting": 1})
    wrong: Any = "tcp/127.0.0.1:0"
    with pytest.raises(TypeError, match="listen must be a list of locators"):
        rect.connect("wombat-1", listen=wrong)


def test_option_of_wrong_type_is_named() -> None:
    wrong: Any
    for wrong in ("fleet", ("fleet",), ("fleet", 7)):
        with pytest.raises(TypeError, match=r"login must be a pair of strings: \(user, password\)"):
            rect.connect("wombat-1", login=wrong)
    wrong = 7
    with pytest.raises(TypeError, match="endpoints must be a list of locators"):
        rect.connect("wombat-1", endpoints=wrong)


def test_session_works_after_too_long_encoding(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/x")
    until_subscribed(one, "x")
    with pytest.raises(rect.PayloadError):
        one.publish("x", rect.Payload(b"", "a/b;" + "x" * 300))
    longest = rect.Payload(b"1", "a/b;" + "x" * 196)
    one.publish("x", longest)
    assert subscriber.next(DEADLINE).payload == longest


def test_message_with_invalid_topic_is_dropped_and_counted(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/**")
    until_subscribed(one, "x")
    one.zenoh.put("rect/wombat-1/a\x1b]0;pwned\x07\x1b[2Jb\nfake/c", b"12.5")
    one.publish("x", 1)
    assert subscriber.next(DEADLINE).topic == "x"
    assert (two.counters().received, two.counters().rejected) == (1, 1)


def test_callback_is_called_again_after_sys_exit(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    one, two = pair
    calls: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def record_and_exit(message: rect.Message) -> None:
        calls.put(message.value)
        sys.exit(3)

    with caplog.at_level(logging.ERROR, "rect"), two.subscribe("wombat-1/x", callback=record_and_exit):
        until_subscribed(one, "x")
        one.publish("x", 1)
        one.publish("x", 2)
        assert [calls.get(timeout=DEADLINE) for _ in range(2)] == [1, 2]
    assert "the callback for wombat-1/x raised an exception" in caplog.text


def test_closed_robot_raises_closed(pair: Pair) -> None:
    one, _ = pair
    subscriber = one.subscribe("*/x")
    one.close()
    one.close()
    assert list(subscriber) == []
    assert repr(one) == "Robot(rect/wombat-1, closed)"
    calls: list[Callable[[], object]] = [
        lambda: one.publish("x", 1),
        lambda: one.subscribe("*/x"),
        lambda: one.request("wombat-2", "x"),
        lambda: one.serve("x", print),
        lambda: one.peers(),
        lambda: one.stream("x"),
        lambda: one.watch("wombat-2/x"),
        lambda: one.transfer("wombat-2", "x", b""),
        lambda: one.receive_transfers("*/x"),
        lambda: one.events(),
        lambda: subscriber.next(1),
    ]
    for call in calls:
        with pytest.raises(rect.Closed, match="the session is closed"):
            call()


def test_closed_handle_is_named(pair: Pair) -> None:
    one, _ = pair
    for handle, name in (
        (one.subscribe("*/x"), "subscriber"),
        (one.watch("wombat-2/x"), "watcher"),
        (one.events(), "subscription to events"),
        (one.receive_transfers("*/x"), "transfer receiver"),
    ):
        handle.close()
        with pytest.raises(rect.Closed, match=f"^the {name} is closed$"):
            while True:
                handle.next(1)


def test_expired_query_of_registry_is_timeout(pair: Pair) -> None:
    one, two = pair
    # The error reply is the one that Zenoh creates itself when a query expires.
    registry = one.zenoh.declare_queryable("rect/wombat-1/@rect/connections", lambda query: query.reply_err(b"Timeout"))
    until_served(two, "wombat-1", "@rect/connections")
    with pytest.raises(rect.TimedOut, match="no reply from the router of wombat-1 about connections within 5 s"):
        two.connections("wombat-1")
    registry.undeclare()


def test_many_threads_publish_concurrently(pair: Pair) -> None:
    one, two = pair
    subscriber = two.subscribe("wombat-1/count", capacity=10_000)
    until_subscribed(one, "count")

    def count() -> None:
        for number in range(200):
            one.publish("count", number)

    threads = [threading.Thread(target=count) for _ in range(8)]
    for thread in threads:
        thread.start()
    messages = [subscriber.next(DEADLINE) for _ in range(1600)]
    for thread in threads:
        thread.join()
    assert [message.sequence for message in messages] == list(range(1600))
    assert subscriber.counts_by_sender["wombat-1"] == rect.SenderCounts(1600, 0)


def test_dictionary_of_one_robot_is_not_used_for_messages_of_another() -> None:
    samples = [b'{"angle_deg": %d, "moving": true, "battery_volt": 7.2}' % n for n in range(2000)]
    dictionary = rect.Dictionary.train(samples, 4096)
    crc_before_suffix = zlib.crc32(bytes(dictionary)[8:])
    suffixes = (n.to_bytes(4, "little") for n in range(2**32))
    suffix = next(
        suffix for suffix in suffixes if 32768 + zlib.crc32(suffix, crc_before_suffix) % 32768 == dictionary.id
    )
    same_id = rect.Dictionary(bytes(dictionary) + suffix)
    assert same_id.id == dictionary.id
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    value = {"angle_deg": 45, "moving": False, "battery_volt": 7.1}
    with (
        rect.connect("wombat-2", listen=[endpoint]) as two,
        rect.connect("other", endpoints=[endpoint]) as other,
        rect.connect("honest", endpoints=[endpoint]) as honest,
    ):
        subscriber = two.subscribe("*/telemetry")
        for robot, shared in ((other, same_id), (honest, dictionary)):
            codec = robot.share_dictionary(shared)
            until_subscribed(robot, "telemetry")
            robot.publish("telemetry", value, codec=codec)
            message = subscriber.next(DEADLINE)
            assert (message.sender, message.problem, message.value) == (robot.name, None, value)
