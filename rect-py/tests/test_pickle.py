"""Tests that objects which a program passes to another process survive `pickle` in every protocol, and `copy`.

pytest rect-py/tests/test_pickle.py
"""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rect
from rect import errors
from rect._rect import MessageMetadata
from rect.message import UNREAD
from rect.recording import RecordedMessage

WAYS: list[Callable[[Any], Any]] = [
    *(
        lambda value, protocol=protocol: pickle.loads(pickle.dumps(value, protocol))
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1)
    ),
    copy.copy,
    copy.deepcopy,
]
ERRORS = [
    errors.RectError("text"),
    errors.InvalidNameError("text"),
    errors.InvalidTopicError("text"),
    errors.OptionError("queue", -1, "it must be positive"),
    errors.PayloadError("text", "write"),
    errors.CodecError("text", "dictionary", 7),
    errors.MismatchError("cells[2].volt", "a number", "the text 'full'"),
    errors.DictionaryError("text"),
    errors.RecordingError("text"),
    errors.NoRouter("tcp/127.0.0.1:7447", "connection refused"),
    errors.LoginRefused("text", "tcp/127.0.0.1:7447"),
    errors.WrongRobot("text", "wombat-2"),
    errors.NotReachable("wombat-2", ["wombat-3"]),
    errors.NotRetained("mode", "text"),
    errors.NoService("wombat-2", "grab", ["wombat-3"]),
    errors.ServiceRefused("text"),
    errors.ParameterError("text"),
    errors.NoParameters("wombat-2", "drive", ["arm"]),
    errors.NoAction("wombat-2", "goto", ["dig"]),
    errors.NoGoal("wombat-2", "goto", "0123456789abcdef"),
    errors.ActionError("failed", "text", {"x": 1}),
    errors.Cancelled("text"),
    errors.NotStored("wombat-2", "text"),
    errors.Interrupted("wombat-2", "grab"),
    errors.TimedOut("reply", 2.5),
    errors.ServiceError("wombat-2", {"code": 3}, "text"),
    errors.ZenohError("put", "text"),
    errors.ThreadError("text"),
    errors.TransferError("text"),
    errors.TransferRefused("text"),
    errors.TransferFailed("text"),
    errors.FileError("text", 2),
    errors.Closed(),
    rect.Refusal({"code": 3}),
]


def test_every_error_is_tried() -> None:
    classes = {each for each in vars(errors).values() if isinstance(each, type) and issubclass(each, rect.RectError)}
    assert classes <= {type(error) for error in ERRORS}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors(error: Exception, way: Callable[[Any], Any]) -> None:
    made = way(error)
    assert type(made) is type(error)
    assert (str(made), made.args, vars(made)) == (str(error), error.args, vars(error))
    if isinstance(error, OSError):
        assert getattr(made, "errno", None) == error.errno


def metadata(expires_s: float | None = None, retained: tuple[float, bool, bool] | None = None) -> MessageMetadata:
    flags = (2, True, True, expires_s, retained)
    return MessageMetadata(("wombat-2", "wombat-1", "arm/angle", "urgent", 1_795_000_000_123, 7, 99, *flags))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("is_read", [False, True])
def test_messages(way: Callable[[Any], Any], is_read: bool) -> None:
    message: rect.Message[Any] = rect.Message(
        metadata(60, (1.5, True, False)), rect.Payload(b"[1, 2]", "text/json"), "ble"
    )
    if is_read:
        assert message.value == [1, 2]
    made = way(message)
    names = [name for name in dir(rect.Message) if isinstance(getattr(rect.Message, name), property)]
    assert "sent_at" in names and "retained" in names
    for name in [*names, "payload", "method", "problem"]:
        assert getattr(made, name) == getattr(message, name), name
    assert not made.is_expired


@pytest.mark.parametrize("way", WAYS)
def test_messages_without_value_that_have_expired_or_are_recorded(way: Callable[[Any], Any]) -> None:
    message: rect.Message[Any] = rect.Message(metadata(-1), rect.Payload(b"{"))
    message.problem = rect.MismatchError("", "a number", "nothing (null)")
    made = way(message)
    assert made.is_expired and made._value is UNREAD
    with pytest.raises(rect.MismatchError, match="expected a number"):
        _ = made.value
    recorded = RecordedMessage(metadata(), rect.Payload(b"hi", "text/plain"), 1.5)
    made = way(recorded)
    assert (type(made), made.value, made.recorded_at) == (RecordedMessage, "hi", recorded.recorded_at)


@pytest.mark.parametrize("way", WAYS)
def test_payloads_and_pictures(way: Callable[[Any], Any]) -> None:
    for value in (rect.Payload(b"[1]", "text/json"), rect.Picture.of_pixels(2, 1, "rgb8", bytes(6)), rect.Cbor([1])):
        assert way(value) == value


@pytest.mark.parametrize("way", WAYS)
def test_codecs_and_dictionaries(way: Callable[[Any], Any]) -> None:
    samples = [b'{"angle": %d, "name": "joint"}' % n for n in range(500)]
    dictionary = rect.Dictionary.train(samples, 1000)
    made = way(dictionary)
    assert (bytes(made), made.id, made) == (bytes(dictionary), dictionary.id, dictionary)
    for codec in (rect.Codec("zstd:9"), rect.Codec("quantised:0.01"), rect.Codec(dictionary)):
        made = way(codec)
        assert made.name == codec.name
        if codec.name != "quantised:0.01":
            assert made.encode(samples[0] * 9, "text/json") == codec.encode(samples[0] * 9, "text/json")


#: Run in a process of its own, which starts another one.
PROGRAM = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import rect


def fail(payload):
    raise rect.ServiceError("wombat-2", payload, "text")


if __name__ == "__main__":
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        error = pool.submit(fail, rect.Payload(b"[1]", "text/json")).exception(60)
    print(type(error).__name__, error.robot, error.value.value)
"""


def test_a_spawned_process_gets_and_returns_them(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(PROGRAM)
    ended = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout == "ServiceError wombat-2 [1]\n"


def test_a_robot_says_that_it_belongs_to_its_process() -> None:
    robot = rect.Robot.__new__(rect.Robot)
    with pytest.raises(TypeError, match=r"call rect.connect in the other process"):
        pickle.dumps(robot)
