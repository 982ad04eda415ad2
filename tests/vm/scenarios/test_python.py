"""Two programs of the Python package `rect`, each at its robot's router, on the Bluetooth stack of a real kernel.

Run by `tests/vm/test`. Requires the package in .venv (`scripts/test-python` installs it there)."""

import os
import time

import rect
from test_two_robots import pair

WAIT_S = 60
MAP = os.urandom(200_000)


def test_two_python_programs_publish_request_stream_and_transfer(robots):
    one, two = pair(robots)
    with (
        rect.connect(one.name, router=one.endpoint()) as here,
        rect.connect(two.name, router=two.endpoint()) as there,
        there.receive_transfers("*/maps") as maps,
        here.watch(f"{two.name}/camera") as camera,
        there.subscribe("*/hello") as greetings,
        there.subscribe("*/arm/*") as readings,
    ):
        there.serve("double", lambda request: request.value * 2)
        answer = until(lambda: here.request(two.name, "double", 21, timeout=WAIT_S), rect.NoService)
        assert (answer.sender, answer.value) == (two.name, 42)

        reading = {"angle_deg": 12.5, "ok": True}
        until(lambda: publish_and_receive(here, greetings, "hello", "hello from wombat-1"), rect.TimedOut)
        for n in range(50):
            here.send(two.name, "arm/angle", reading | {"n": n}, urgency="urgent" if n % 2 else "normal")
        messages = [readings.next(WAIT_S) for _ in range(50)]
        assert sorted(message.value["n"] for message in messages) == list(range(50))

        here.transfer(two.name, "maps", MAP, timeout=WAIT_S)
        received = maps.next(WAIT_S)
        assert (received.sender, received.content) == (one.name, MAP)

        picture = rect.Picture.of_pixels(64, 48, "rgb8", bytes(range(256)) * 36)
        with there.stream("camera", mode="fixed", codec="png") as stream:
            frame = until(lambda: send_and_receive_frame(stream, picture, camera), rect.TimedOut)
        assert frame.value.pixels == picture.pixels


def until(call, expected_error):
    """Repeats the call until it succeeds, and returns its result: declarations take time to reach the other end."""
    deadline = time.monotonic() + WAIT_S
    while True:
        try:
            return call()
        except expected_error:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def publish_and_receive(publisher: rect.Robot, subscriber: rect.Subscriber, topic: str, value: object) -> rect.Message:
    publisher.publish(topic, value)
    return subscriber.next(1)


def send_and_receive_frame(stream: rect.StreamSender, picture: rect.Picture, camera: rect.Watcher) -> rect.Frame:
    stream.send(picture)
    return camera.next(1)
