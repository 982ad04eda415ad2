"""Measures when messages arrive again after an outage of all radios between two robots, and whether they go on, while
programs publish with congestion control Block."""

from __future__ import annotations

import itertools
import json
import os
import random
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import zenoh
from robots import AnyRobot, open_client, wait_until
from room import Room, wait_for_link
from routers import Router
from shaper import Shaper
from table import Table
from zenoh import CongestionControl, Priority

#: Number of outages of each case, in rooms that run at the same time.
ROOMS, OUTAGES = 3, int(os.environ.get("RECT_OUTAGES", "17"))
#: A program whose message could not be queued waits, so the same publisher is not used for all of them.
KINDS = {
    "urgent": (Priority.REAL_TIME, 0.05, 16),
    "high": (Priority.DATA_HIGH, 0.1, 200),
    "small": (Priority.DATA, 0.05, 64),
    "bulk": (Priority.DATA_LOW, 0.1, 10_000),
    "background": (Priority.BACKGROUND, 0.5, 10_000),
}
WATCHED = "small"
#: Number, and the time when it was published.
MESSAGE = "<Id"
DEAD_S, WATCHED_S, GAP_S = 30, 12, 5
TARGET_S = 2.5


@dataclass
class Pair:
    near: Callable[[], zenoh.Session]
    far: Callable[[], zenoh.Session]
    cut: Callable[[], None]
    restore: Callable[[], None]


@dataclass
class Outcome:
    backs_s: list[float] = field(default_factory=list)
    dead: int = 0
    stopped: int = 0


@contextmanager
def bluetooth() -> Iterator[Pair]:
    with Room("desk", "--pdu", "27") as room:
        one, two = room.add_robot("wombat-1"), room.add_robot("wombat-2")
        wait_for_link(one, two)
        yield Pair(one.session, two.session, room.cut, room.restore)


@contextmanager
def both() -> Iterator[Pair]:
    with Room("desk", "--pdu", "27", has_wifi=True) as room:
        one, two = (room.add_robot(name, kind=AnyRobot) for name in ("wombat-1", "wombat-2"))
        wait_until("linked by both", 20, lambda: one.bulk_path() == "tcp" and one.has_path("ble"))

        def cut() -> None:
            room.set_wifi("silent")
            room.cut()

        def restore() -> None:
            room.restore()
            room.set_wifi("on")

        yield Pair(one.session, two.session, cut, restore)


@contextmanager
def tcp(program: str) -> Iterator[Pair]:
    """Two routers, each of which dials the other one through a hop."""
    settings = [
        "transport/link/tx/queue/congestion_control/block/wait_before_close:60000000",
        "connect/retry:{period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 2}",
        "connect/exit_on_failure:false",
        "connect/timeout_ms:-1",
    ]
    arguments = [part for setting in settings for part in ("--cfg", setting)]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        near = stack.enter_context(Router(program, *arguments, log=Path(folder) / "near.log"))
        port = int(near.endpoint.rsplit(":", 1)[1])
        hop = stack.enter_context(Shaper(1_000_000, port))
        far = stack.enter_context(Router(program, "-e", f"tcp/127.0.0.1:{hop.port}", *arguments))

        def set_state(state: str) -> None:
            hop.state = state

        yield Pair(
            lambda: open_client(near.endpoint),
            lambda: open_client(far.endpoint),
            lambda: set_state("silent"),
            lambda: set_state("on"),
        )


#: The link, and the shortest and the longest outage in seconds.
CASES: dict[str, tuple[Callable[[], Iterator[Pair]], float, float]] = {
    "any, both radios": (both, 2, 20),
    "Bluetooth": (bluetooth, 2, 20),
    "TCP": (lambda: tcp("rect-router"), 2, 20),
    "TCP, stock zenohd": (lambda: tcp("stock zenohd"), 2, 20),
}


def run() -> Table:
    table = Table(
        "Messages after an outage of all radios",
        ["link", "outages", "back p50", "max", f"not within {DEAD_S} s", f"stopped again for {GAP_S} s"],
    )
    chosen = json.loads(os.environ.get("RECT_OUTAGE_CASES", "null")) or list(CASES)
    for name in chosen:
        link, shortest, longest = CASES[name]
        outcome = Outcome()
        rooms = [
            threading.Thread(target=measure, args=(link, shortest, longest, seed, outcome)) for seed in range(ROOMS)
        ]
        for room in rooms:
            room.start()
        for room in rooms:
            room.join()
        backs = sorted(outcome.backs_s)
        table.add(
            name,
            ROOMS * OUTAGES,
            f"{backs[len(backs) // 2]:.2f} s" if backs else "-",
            f"{backs[-1]:.2f} s" if backs else "-",
            outcome.dead,
            outcome.stopped,
        )
        print("  " + " | ".join(table.rows[-1]), flush=True)
    table.notes = [
        "Two robots of `config/simulation.json5` on the simulated air (desk, packets of 27 bytes) and the simulated "
        "Wi-Fi; or two routers over a TCP hop. Stock eclipse-zenoh clients publish with congestion control Block at "
        "five priorities, 10 kB every 0.1 s among them. The radio is cut, and the Wi-Fi or the hop is silent, for 2 to "
        "20 s. Back: from the end of the outage to the arrival of a message that was published after it. Target: "
        f"{TARGET_S} s, and none that stays away or stops again within {WATCHED_S} s.",
    ]
    return table


def measure(link: Callable[[], Iterator[Pair]], shortest: float, longest: float, seed: int, outcome: Outcome) -> None:
    times = random.Random(seed)
    with link() as pair:
        arrived = Arrivals(pair.far())
        ended = threading.Event()
        sessions = [pair.near() for _ in KINDS]
        for session, kind in zip(sessions, KINDS, strict=True):
            threading.Thread(target=publish, args=(session, kind, ended), daemon=True).start()
        for number in range(OUTAGES):
            wait_until("messages arrive", 60, lambda: arrived.since(time.monotonic() - 1) is not None)
            time.sleep(2)
            length = times.uniform(shortest, longest)
            pair.cut()
            time.sleep(length)
            pair.restore()
            restored = time.monotonic()
            while arrived.since(restored) is None and time.monotonic() < restored + DEAD_S:
                time.sleep(0.01)
            back = arrived.since(restored)
            if back is None:
                outcome.dead += 1
                print(f"  room {seed}, outage {number} of {length:.1f} s: nothing within {DEAD_S} s", flush=True)
                continue
            outcome.backs_s.append(back - restored)
            time.sleep(WATCHED_S)
            if arrived.longest_gap_after(back) > GAP_S:
                outcome.stopped += 1
                print(f"  room {seed}, outage {number} of {length:.1f} s: stopped again", flush=True)
        ended.set()
        for session in sessions:
            threading.Thread(target=session.close, daemon=True).start()
        time.sleep(1)


class Arrivals:
    """The arrivals of the watched messages."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._arrived: list[tuple[float, float]] = []
        self._subscribers = [
            session.declare_subscriber(f"rect/wombat-1/{kind}", self._on_sample if kind == WATCHED else lambda _: None)
            for kind in KINDS
        ]

    def _on_sample(self, sample: zenoh.Sample) -> None:
        _, sent = struct.unpack_from(MESSAGE, sample.payload.to_bytes())
        with self._lock:
            self._arrived = [*self._arrived[-5000:], (sent, time.monotonic())]

    def since(self, sent: float) -> float | None:
        """Returns when the first message arrived that was published after `sent`."""
        with self._lock:
            return next((at for published, at in self._arrived if published >= sent), None)

    def longest_gap_after(self, at: float) -> float:
        with self._lock:
            times = [at, *(arrived for _, arrived in self._arrived if arrived >= at), time.monotonic()]
        return max(later - sooner for sooner, later in itertools.pairwise(times))


def publish(session: zenoh.Session, kind: str, ended: threading.Event) -> None:
    priority, period_s, size = KINDS[kind]
    publisher = session.declare_publisher(
        f"rect/wombat-1/{kind}", priority=priority, congestion_control=CongestionControl.BLOCK, express=True
    )
    number = 0
    while not ended.wait(period_s):
        head = struct.pack(MESSAGE, number, time.monotonic())
        try:
            publisher.put(head + bytes(size - len(head)))
        except zenoh.ZError:
            return
        number += 1
