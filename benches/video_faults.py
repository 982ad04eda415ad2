"""Measures how long a camera's video pauses while the radio is cut, or the Wi-Fi of an `any` link falls silent."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy
import rect
from robots import AnyRobot, wait_until
from room import Room, wait_for_link
from table import Table

SIZE, FRAMES_PER_S = (640, 480), 15
BEFORE_S, AFTER_S, ROUNDS = 8, 8, 3
OTHERS = 9


@dataclass
class Link:
    near: str
    far: str
    """Endpoints of the two routers."""
    fail: Callable[[], None]
    restore: Callable[[], None]


@contextmanager
def bluetooth() -> Iterator[Link]:
    with Room("desk", "--pdu", "27") as room:
        one, two = room.add_robot("wombat-1"), room.add_robot("wombat-2")
        wait_for_link(one, two)
        yield Link(one.endpoint(), two.endpoint(), room.cut, room.restore)


@contextmanager
def both() -> Iterator[Link]:
    with Room("desk", "--pdu", "27", has_wifi=True) as room:
        one, two = (room.add_robot(name, kind=AnyRobot) for name in ("wombat-1", "wombat-2"))
        wait_until("linked by both", 20, lambda: one.bulk_path() == "tcp" and one.has_path("ble"))
        yield Link(one.endpoint(), two.endpoint(), lambda: room.set_wifi("silent"), lambda: room.set_wifi("on"))


@contextmanager
def crowded() -> Iterator[Link]:
    """Nine more programs receive the video, and do not read it, from the fault on."""
    with bluetooth() as link, ExitStack() as others:

        def join() -> None:
            for _ in range(OTHERS):
                other = others.enter_context(rect.connect("wombat-2", router=link.far))
                others.enter_context(other.watch("wombat-1/camera"))

        yield Link(link.near, link.far, join, lambda: None)


#: The link, and how long it fails.
CASES = {
    "Bluetooth, cut for 1 s": (bluetooth, 1.0),
    "Bluetooth, nine more receivers": (crowded, 1.0),
    "any, Wi-Fi silent for 3 s": (both, 3.0),
    "any, Wi-Fi on again": (both, None),
}


def run() -> Table:
    table = Table("A camera's video while a link fails", ["link", "longest pause", "picture back after", "damaged"])
    for name, (link, fault_s) in CASES.items():
        pauses, backs, damaged = [], [], 0
        for _ in range(ROUNDS):
            with link() as made:
                pause, back, wrong = measured(made, fault_s)
            pauses.append(pause)
            backs.append(back)
            damaged += wrong
        print(f"  {name}: {[f'{pause:.2f}' for pause in pauses]}", flush=True)
        table.add(name, f"{max(pauses):.2f} s", f"{max(backs):.2f} s", str(damaged))
    table.notes = [
        f"The simulated air (desk, packets of 27 bytes) and the simulated Wi-Fi; a camera of {SIZE[0]}x{SIZE[1]} at "
        f"{FRAMES_PER_S} Hz, the mode `video`; the longest of {ROUNDS} rounds. Pause: the longest time between two "
        "pictures that the program gets, from the fault on. Back: from the end of the fault to the next picture. Nine "
        "more receivers: programs of the far robot that join at the same time, and do not read. Wi-Fi "
        "on again: from Bluetooth back to Wi-Fi. Damaged: pictures without the camera's moving stripe. "
        "Target: back within 1 s after a cut of 1 s, and a pause of at most 0.5 s with `any`.",
    ]
    return table


def scene(number: int) -> numpy.ndarray:
    """Returns a picture with a texture, and a stripe whose place tells its number."""
    width, height = SIZE
    across = 90 + 60 * numpy.sin((numpy.arange(width) + number * 3) / 9)
    down = 30 * numpy.sin((numpy.arange(height) + number * 2) / 13)
    picture = (across[None, :] + down[:, None]).astype(numpy.uint8)
    picture[:, place(number) : place(number) + 16] = 250
    return numpy.repeat(picture[:, :, None], 3, 2)


def film(stream: rect.StreamSender, ends: threading.Event) -> None:
    """Sends pictures as a camera does, until the end."""
    due = time.monotonic()
    for number in itertools.count():
        stream.send(scene(number))
        due += 1 / FRAMES_PER_S
        if ends.wait(max(0, due - time.monotonic())):
            return


def place(number: int) -> int:
    return number % 39 * 16


def measured(link: Link, fault_s: float | None) -> tuple[float, float, int]:
    """Returns the longest pause, the time until the picture is back (both in seconds), and the damaged pictures."""
    arrivals: list[tuple[float, bool]] = []
    ends = threading.Event()
    with rect.connect("wombat-1", router=link.near) as near, rect.connect("wombat-2", router=link.far) as far:
        stream = near.stream("camera", mode="video", max_frames_per_s=FRAMES_PER_S)
        watch = far.watch("wombat-1/camera")

        def show() -> None:
            for frame in watch:
                row = numpy.asarray(frame.value)[:, :, 1].mean(0)
                stripe = numpy.convolve(row, numpy.ones(16), "valid").max() / 16
                arrivals.append((time.monotonic(), stripe > 200))

        threads = [threading.Thread(target=film, args=[stream, ends]), threading.Thread(target=show)]
        for thread in threads:
            thread.start()
        time.sleep(BEFORE_S)
        started = time.monotonic()
        link.fail()
        if fault_s is None:
            # The way back is measured, after the way there.
            time.sleep(AFTER_S)
            started = time.monotonic()
        else:
            time.sleep(fault_s)
        link.restore()
        restored = time.monotonic()
        time.sleep(AFTER_S)
        ends.set()
        threads[0].join()
        watch.close()
        threads[1].join()
    before = max(at for at, _ in arrivals if at <= started)
    times = [at for at, _ in arrivals if at >= before]
    pause = max(after - earlier for earlier, after in itertools.pairwise(times))
    back = min(at for at in times if at > restored) - restored
    return pause, back, sum(not is_whole for _, is_whole in arrivals)
