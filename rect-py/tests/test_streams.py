"""Tests streams between two robots: adaptive pictures, fixed frames, and values of a sensor.

pytest rect-py/tests/test_streams.py
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Any

import av
import numpy
import PIL.Image
import pytest
import rect
from conftest import DEADLINE

Pair = tuple[rect.Robot, rect.Robot]


def send_until(watch: rect.Watcher, send: Callable[[], object], accept: Callable[[rect.Frame], bool]) -> rect.Frame:
    """Sends frames, as a camera does, until one arrives that `accept` accepts, and returns it."""
    stop = threading.Event()

    def camera() -> None:
        while not stop.wait(0.01):
            send()

    sending = threading.Thread(target=camera)
    sending.start()
    try:
        frame = watch.next(DEADLINE)
        while not accept(frame):
            frame = watch.next(DEADLINE)
        return frame
    finally:
        stop.set()
        sending.join()


def test_pictures_arrive_with_number_and_age(pair: Pair) -> None:
    one, two = pair
    picture = numpy.full((48, 64, 3), 90, numpy.uint8)
    with one.stream("camera") as camera, two.watch("wombat-1/camera") as watch:
        frame = send_until(watch, lambda: camera.send(picture), lambda frame: frame.number > 3)
        assert isinstance(frame.value, rect.Picture)
        assert abs(int(numpy.asarray(frame.value)[0, 0, 0]) - 90) < 8
        assert frame.age is not None
        assert 0 <= frame.age < DEADLINE
        assert frame._repr_png_() is not None
        assert watch.round_trip is not None
        status = camera.status
    assert status["groups"][0]["frames"] > 3
    assert status["groups"][0]["last_change"].startswith("started with")


def moving(number: int) -> numpy.ndarray:
    """Returns a picture whose stripes move with the number."""
    stripes = 128 + 100 * numpy.sin((numpy.arange(160) + 3 * number) / 9)
    return numpy.broadcast_to(stripes[None, :, None], (120, 160, 3)).astype(numpy.uint8)


def test_video_arrives_as_pictures(pair: Pair) -> None:
    one, two = pair
    numbers = itertools.count()
    with one.stream("camera", mode="video") as camera, two.watch("wombat-1/camera") as watch:
        frame = send_until(watch, lambda: camera.send(moving(next(numbers))), lambda frame: frame.number > 3)
        picture = numpy.asarray(frame.value)
        assert picture.shape == (120, 160, 3)
        assert picture.std() > 30, "it has no stripes"
        assert frame.sent_bytes < picture.size / 4
        assert camera.status["groups"][0]["video"]["key_frames"] >= 1


def test_an_array_that_is_no_picture_is_refused_in_a_video(pair: Pair) -> None:
    with pair[0].stream("camera", mode="video") as camera:
        for frame in (
            numpy.zeros((240, 320, 3)),
            numpy.zeros((240, 320, 2), numpy.uint8),
            PIL.Image.new("I;16", (9, 9)),
        ):
            with pytest.raises(rect.PayloadError, match="picture"):
                camera.send(frame)


def test_ffmpeg_decodes_video(pair: Pair) -> None:
    one, two = pair
    numbers = itertools.count()
    frames: list[rect.Frame] = []

    def is_enough(frame: rect.Frame) -> bool:
        frames.append(frame)
        return len(frames) == 20

    with one.stream("camera", mode="video") as camera:
        watch = two.watch("wombat-1/camera", decode=False, capacity=100)
        send_until(watch, lambda: camera.send(moving(next(numbers))), is_enough)
    assert {frame.payload.encoding for frame in frames} == {"video/h264"}
    decoder = av.CodecContext.create("h264", "r")
    decoded = [picture for frame in frames for picture in decoder.decode(av.Packet(frame.payload.bytes))]
    decoded += decoder.decode(None)
    assert len(decoded) == 20
    assert decoded[-1].to_ndarray(format="rgb24").std() > 30


def test_nothing_is_encoded_without_receivers(pair: Pair) -> None:
    one, _ = pair

    def encode(quality: int | None, scale: float | None) -> bytes:
        raise AssertionError("there is no receiver")

    with one.stream("camera") as camera:
        assert camera.send_with(64 * 48, encode) == 0
        assert camera.send(numpy.zeros((48, 64, 3), numpy.uint8)) == 0


def test_send_with_uses_encoder_of_program(pair: Pair) -> None:
    one, two = pair
    with one.stream("camera") as camera, two.watch("wombat-1/camera") as watch:
        encode: Callable[[Any, Any], str] = lambda quality, scale: f"{quality} {scale}"  # noqa: E731
        frame = send_until(watch, lambda: camera.send_with(3_000_000, encode), lambda frame: True)
        quality, scale = frame.value.split()
        assert 1 <= int(quality) <= 100
        assert 0 < float(scale) <= 1


def test_codec_compresses_each_frame(pair: Pair) -> None:
    one, two = pair
    with (
        one.stream("camera", codec="jpeg:50", max_frames_per_s=100) as camera,
        two.watch("wombat-1/camera") as watch,
    ):
        picture = numpy.zeros((48, 64), numpy.uint8)
        frame = send_until(watch, lambda: camera.send(picture), lambda frame: True)
        assert frame.payload.encoding == "image/jpeg"


def test_callback_receives_all_values_of_sensor(pair: Pair) -> None:
    one, two = pair
    values: list[int] = []
    enough = threading.Event()

    def on_frame(frame: rect.Frame) -> None:
        values.append(frame.value)
        if len(values) == 20:
            enough.set()

    with (
        one.stream("distance", mode="sensor") as distance,
        two.watch("wombat-1/distance", callback=on_frame, capacity=100),
    ):
        number = 0
        while not enough.wait(0.001):
            number += distance.send(number)
        assert values == list(range(values[0], values[0] + len(values)))


def test_unread_frames_are_counted_as_skipped(pair: Pair) -> None:
    one, two = pair
    with one.stream("count", mode="sensor") as count, two.watch("wombat-1/count") as watch:
        number = 0

        def send() -> None:
            nonlocal number
            number += count.send(number)

        first = send_until(watch, send, lambda frame: True)
        while number < first.number + 50:
            send()
        later = send_until(watch, send, lambda frame: frame.skipped > 0)
        assert later.number > first.number + later.skipped
        assert watch.dropped > 0


def test_frames_of_stock_program_have_no_age(pair: Pair) -> None:
    one, two = pair
    publisher = one.zenoh.declare_publisher("rect/wombat-1/plain")
    with two.watch("wombat-1/plain") as watch:
        frame = send_until(watch, lambda: publisher.put(b"7", encoding="application/json"), lambda frame: True)
        assert (frame.value, frame.age) == (7, None)


def test_frame_of_unsupported_type_raises_payload_error(pair: Pair) -> None:
    with pair[0].stream("x", mode="sensor") as stream, pytest.raises(rect.PayloadError, match="is of the type object"):
        stream.send(object())
