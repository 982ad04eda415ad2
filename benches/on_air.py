"""Counts the bytes of a message and of establishing a link on the simulated air."""

import statistics
import tempfile
import threading
import time
from pathlib import Path

import rect
import zenoh
from robots import Robot, rect_settings, wait_until
from room import Room, wait_for_link
from table import Table

SAMPLES = 200
KEY = "rect/wombat-1/arm/angle"
# The most bytes over the payload, without and with a secret.
TARGETS = {"no secret": 12, "a secret": 18}
SECRET = "fleet:a secret of the team, long enough"
LINK_UPS = 15


def run() -> Table:
    table = Table("Bytes on the air", ["link with", "what", "SDUs", "SDU bytes", "over the payload", "target"])
    times = {}
    with tempfile.TemporaryDirectory() as folder:
        secret = Path(folder) / "secret"
        secret.write_text(f"{SECRET}\n")
        options = {"no secret": "", "a secret": f";secret={secret}"}
        for link, option in options.items():
            times[link] = rows(table, link, option)
    table.notes = [
        f"A message: the mean of {SAMPLES}, one at a time, from a stock Python client's declared publisher to a stock "
        "subscriber, `config/simulation.json5`. L2CAP adds 6 bytes to an SDU of up to 245 bytes, and the link "
        "layer 10 bytes to each of its packets (1M PHY).",
        "RECT: the same with the library, whose attachment has 10 or 11 bytes and 3 before it. A subscription to "
        "`wombat-1/pose` makes the key a number; for one with a wildcard in place of the robot, it makes "
        "the beginning of the key one, and each message carries the topic.",
        "Establishing a link: hello, Zenoh's handshake, and the routers' information about each other.",
        f"From the start of a router (process included) to its link, medians of {LINK_UPS}: "
        + ", ".join(
            f"{statistics.median(t):.2f} s with {link} ({min(t):.2f} to {max(t):.2f})" for link, t in times.items()
        )
        + ".",
    ]
    return table


def rows(table: Table, link: str, ble_options: str) -> list[float]:
    """Adds the rows of one kind of link, and returns the times to establish it."""
    with Room("room") as room:
        settings = [tuple(rect_settings({"robot": name})) for name in ("wombat-1", "wombat-2")]
        one = room.add_robot("wombat-1", ble_options=ble_options, arguments=settings[0])
        before = sent(room)
        two = room.add_robot("wombat-2", ble_options=ble_options, arguments=settings[1])
        wait_for_link(one, two)
        with one.session() as here, two.session() as there:
            link_up = settled(room, before)
            for size in (8, 100):
                row(table, link, room, here, there, size)
        for pattern, size in (("wombat-1/pose", 18), ("wombat-1/pose", 81), ("*/speed", 18)):
            library_row(table, link, room, (one, two), pattern, size)
        table.add(link, "establishing a link, both directions", f"{link_up[0]}", f"{link_up[1]}", "", "")
        return [link_up_s(two) for _ in range(LINK_UPS)]


def row(table: Table, link: str, room: Room, here: zenoh.Session, there: zenoh.Session, size: int) -> None:
    arrived = threading.Semaphore(0)
    subscriber = there.declare_subscriber(KEY, lambda _: arrived.release())
    publisher = here.declare_publisher(KEY)
    wait_until("a message arrives", 20, lambda: publisher.put(b"?") or arrived.acquire(timeout=0.1))
    settled(room, (0, 0))
    while arrived.acquire(blocking=False):
        pass
    before = sent(room, "sim-wombat-1")
    for _ in range(SAMPLES):
        publisher.put(bytes(size))
        if not arrived.acquire(timeout=10):
            raise SystemExit("on_air: a message was lost")
    after = sent(room, "sim-wombat-1")
    sdus, in_bytes = (after[0] - before[0]) / SAMPLES, (after[1] - before[1]) / SAMPLES
    over = in_bytes - size
    cells = (f"{sdus:.2f}", f"{in_bytes:.1f}", f"{over:.1f}", f"at most {TARGETS[link]}")
    table.add(link, f"a message of {size} B", *cells)
    publisher.undeclare()
    subscriber.undeclare()


def library_row(table: Table, link: str, room: Room, robots: tuple[Robot, Robot], pattern: str, size: int) -> None:
    """Adds the row of a message of the library."""
    one, two = robots
    with (
        rect.connect("wombat-1", router=one.endpoint(), program=None) as here,
        rect.connect("wombat-2", router=two.endpoint(), program=None) as there,
        there.subscribe(pattern) as subscriber,
    ):
        publisher = here.publisher(pattern.partition("/")[2])

        def arrives() -> bool:
            publisher.publish(b"?")
            try:
                subscriber.next(timeout=0.2)
            except rect.TimedOut:
                return False
            return True

        wait_until("a message arrives", 20, arrives)
        settled(room, (0, 0))
        before = sent(room, "sim-wombat-1")
        for _ in range(SAMPLES):
            publisher.publish(bytes(size))
            subscriber.next(timeout=10)
        after = sent(room, "sim-wombat-1")
    sdus, in_bytes = (after[0] - before[0]) / SAMPLES, (after[1] - before[1]) / SAMPLES
    about = f"RECT, {size} B, for `{pattern}`"
    table.add(link, about, f"{sdus:.2f}", f"{in_bytes:.1f}", f"{in_bytes - size:.1f}", "")


def sent(room: Room, adapter: str | None = None) -> tuple[int, int]:
    """Returns the number of SDUs and their bytes so far, of one adapter or of all."""
    stats = [a["stats"] for a in room.status()["adapters"] if adapter in (None, a["name"])]
    return sum(s["sdus"] for s in stats), sum(s["sdu_bytes"] for s in stats)


def settled(room: Room, before: tuple[int, int]) -> tuple[int, int]:
    """Returns the traffic since `before`, after a pause that is shorter than the interval of keep-alives."""
    last, since = sent(room), time.monotonic()
    while time.monotonic() - since < 0.5:
        now = sent(room)
        if now != last:
            last, since = now, time.monotonic()
        time.sleep(0.02)
    return last[0] - before[0], last[1] - before[1]


def link_up_s(robot: Robot) -> float:
    robot.stop()
    started = time.monotonic()
    robot.start()
    wait_until("linked", 20, lambda: bool(robot.ble_links()))
    return time.monotonic() - started
