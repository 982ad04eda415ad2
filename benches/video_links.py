"""Measures a camera's video over links that have only Bluetooth, beside links that carry nothing."""

from __future__ import annotations

import statistics
import threading
import time

import rect
from robots import AnyRobot, Robot, wait_until
from room import Room
from table import Table
from video_faults import FRAMES_PER_S, SIZE, film

#: How long the video runs before it is measured, and how long it is measured, in seconds.
WARM_UP_S, MEASURED_S = 10, 30
IDLE_LINKS = (0, 1, 3, 6)
KINDS = {"ble": Robot, "any": AnyRobot}


def run() -> Table:
    columns = ["link", "idle links", "pictures per second", "age p50", "age max"]
    table = Table("A camera's video over Bluetooth alone, beside idle links of the same robot", columns)
    for name, kind in KINDS.items():
        for idle in IDLE_LINKS:
            ages_s = measured(kind, idle)
            rate = len(ages_s) / MEASURED_S
            cells = [f"{1000 * age:.0f} ms" for age in (statistics.median(ages_s), max(ages_s))]
            table.add(name, str(idle), f"{rate:.1f}", *cells)
            print("  " + " | ".join(table.rows[-1]), flush=True)
    table.notes = [
        f"The simulated air (desk, packets of 27 bytes); a camera of {SIZE[0]}x{SIZE[1]} at {FRAMES_PER_S} Hz, mode "
        f"`video`, from one robot to another. The idle links are those of the first robot to further ones, of the same "
        f"method. Measured for {MEASURED_S} s, after {WARM_UP_S} s. Target: `any` equals `ble`."
    ]
    return table


def is_linked(robot: Robot) -> bool:
    return robot.has_path("ble") if isinstance(robot, AnyRobot) else bool(robot.ble_links())


def measured(kind: type[Robot], idle: int) -> list[float]:
    """Returns the ages of the pictures that arrive in the measured time, in seconds."""
    ages: list[tuple[float, float]] = []
    ends = threading.Event()
    with Room("desk", "--pdu", "27") as room:
        one, two = (room.add_robot(f"wombat-{number}", kind=kind) for number in (1, 2))
        others = [two, *(room.add_robot(f"wombat-{3 + number}", kind=kind, dials=[one]) for number in range(idle))]
        for other in others:
            wait_until("linked", 60, lambda other=other: is_linked(other))
        with (
            rect.connect("wombat-1", router=one.endpoint()) as near,
            rect.connect("wombat-2", router=two.endpoint()) as far,
        ):
            stream = near.stream("camera", mode="video", max_frames_per_s=FRAMES_PER_S)
            watcher = far.watch("wombat-1/camera")

            def show() -> None:
                for frame in watcher:
                    if frame.age is not None:
                        ages.append((time.monotonic(), frame.age))

            threads = [threading.Thread(target=film, args=[stream, ends]), threading.Thread(target=show)]
            for thread in threads:
                thread.start()
            time.sleep(WARM_UP_S)
            started = time.monotonic()
            time.sleep(MEASURED_S)
            ended = time.monotonic()
            ends.set()
            threads[0].join()
            watcher.close()
            threads[1].join()
    return [age for at, age in ages if started <= at < ended]
