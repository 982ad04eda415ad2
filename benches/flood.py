"""Measures how a flood of messages over a slow link delays the next message of the same priority, and urgent messages
of the flooding program, with the default of `backlog=` and with other settings."""

import multiprocessing
import os
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

import zenoh
from pairs import carried, room
from robots import Robot, free_port, open_client, wait_until
from room import wait_for_link
from routers import status
from table import Table
from traffic import percentile
from zenoh import CongestionControl, Priority

PDU = 27
FLOOD_S = 8
LIMIT_S = 60
PERIOD_S = 0.1
SILENCE_BYTES_PER_S = 500
#: Practically no limit.
WITHOUT = "backlog=600000"
#: By default a client that waits for its router for more than 5 s closes the link and loses messages.
LONG_WAIT = {"transport__link__tx__queue__congestion_control__block__wait_before_close": 60_000_000}


@dataclass
class Case:
    title: str
    message_bytes: int = 128
    programs: int = 1
    options: str = ""
    """Options of both `ble/` locators."""
    listener: str = "tcp"
    """The listener that the flooding programs connect to."""
    is_urgent_too: bool = False
    """Whether the first flooding program sends urgent messages, too, over the same session."""


CASES = [
    Case("128 bytes, without the limit", options=WITHOUT),
    Case("128 bytes"),
    Case("128 bytes, three programs", programs=3),
    Case("8 kB", 8_000),
    Case("30 kB", 30_000),
    Case("60 kB", 60_000),
    Case("100 kB", 100_000),
    Case("128 bytes, `backlog=500`", options="backlog=500"),
    Case("128 bytes, `backlog=2000`", options="backlog=2000"),
    Case("one session for flood and urgent messages, without the limit", options=WITHOUT, is_urgent_too=True),
    Case("one session, TCP", is_urgent_too=True),
    Case("one session, TCP, `#so_rcvbuf=65536`", listener="small tcp", is_urgent_too=True),
    Case("one session, TCP, `#so_rcvbuf=65536`, client `#so_sndbuf=65536`", listener="small both", is_urgent_too=True),
    Case("one session, Unix socket", listener="unix", is_urgent_too=True),
]


@dataclass
class Outcome:
    next_s: float | None = None
    """How long the next message of another program took after the flood; None if it did not arrive."""
    during_s: list[float] = field(default_factory=list)
    """How long such messages took during the flood."""
    urgent_s: list[float] = field(default_factory=list)
    urgent_sent: int = 0
    left_bytes: int = 0
    """The bytes that the link carried after the subscriber to the flood had left."""
    memory_mb: list[float] = field(default_factory=list)


def run() -> Table:
    table = Table(
        "A flood of messages over a slow link, and the next message of the same priority",
        [
            "flood",
            "next message of another program: during, max",
            "right after",
            "urgent messages of the flooding program",
            "bytes on the air after its subscriber has left",
            "peak memory of the routers",
        ],
    )
    for case in CASES:
        outcome = in_a_process(case)
        urgent = ""
        if case.is_urgent_too:
            ages_s = outcome.urgent_s
            late = f", p50 {percentile(ages_s, 0.5):.1f} s, max {max(ages_s):.1f} s" if ages_s else ""
            urgent = f"{len(ages_s)} of {outcome.urgent_sent} within {LIMIT_S} s{late}"
        table.add(
            case.title,
            f"{max(outcome.during_s):.1f} s" if outcome.during_s else f"over {FLOOD_S} s",
            f"over {LIMIT_S} s" if outcome.next_s is None else f"{outcome.next_s:.1f} s",
            urgent,
            f"{outcome.left_bytes / 1000:.0f} kB",
            " and ".join(f"{memory:.0f} MB" for memory in outcome.memory_mb),
        )
        print(f"  {table.rows[-1]}", flush=True)
    table.notes = [
        f"The simulated air as in `urgent`, with link-layer packets of {PDU} bytes (34 kB/s). Stock eclipse-zenoh "
        f"clients put for {FLOOD_S} s with congestion control `BLOCK` and `wait_before_close` of 60 s. Another "
        "client of the same robot puts 8 bytes of the same priority, each when the previous one has arrived. Urgent: "
        "8 bytes every 0.1 s, `REAL_TIME`. The subscriber to the flood leaves when it ends; the bytes are counted from "
        "then on for 10 s, or until the air is silent.",
    ]
    return table


def in_a_process(case: Case) -> Outcome:
    """Runs a case in a separate process, whose clients may still be waiting for routers that were stopped."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs, case))
    process.start()
    theirs.close()
    outcome = ours.recv()
    process.join()
    return outcome


def work(pipe: Connection, case: Case) -> None:
    try:
        pipe.send(outcome_of(case))
    finally:
        os._exit(0)


def outcome_of(case: Case) -> Outcome:
    outcome = Outcome()
    with room(PDU) as air:
        port, socket = free_port(), f"/tmp/rect-flood-{free_port()}.sock"
        listeners = ["-l", f"tcp/127.0.0.1:{port}#so_rcvbuf=65536", "-l", f"unixsock-stream/{socket}"]
        one = air.add_robot("wombat-1", arguments=tuple(listeners))
        two = air.add_robot("wombat-2", f"#{case.options}" if case.options else "")
        if case.options:
            # This router accepts the link, so its listener needs the options, too.
            one.stop()
            one.start([], ble_options=f";{case.options}")
        wait_for_link(one, two)
        small = f"tcp/127.0.0.1:{port}"
        endpoints = {
            "tcp": one.endpoint(),
            "small tcp": small,
            "small both": f"{small}#so_sndbuf=65536",
            "unix": f"unixsock-stream/{socket}",
        }
        measure(case, outcome, one, two, endpoints[case.listener], lambda: carried(air))
    return outcome


def measure(case: Case, outcome: Outcome, one: Robot, two: Robot, endpoint: str, on_air: Callable[[], int]) -> None:
    there, other = two.session(), one.session()
    flooding = [open_client(endpoint, **LONG_WAIT) for _ in range(case.programs)]
    flooded = there.declare_subscriber("rect/wombat-1/flood", lambda _: None)
    other_program = OtherProgram(there, other)
    urgent = there.declare_subscriber(
        "rect/wombat-1/stop", lambda sample: outcome.urgent_s.append(age_s(sample.payload.to_bytes()))
    )
    end = time.monotonic() + FLOOD_S
    for session in flooding:
        threading.Thread(target=flood, args=(session, bytes(case.message_bytes), end), daemon=True).start()
    if case.is_urgent_too:
        threading.Thread(target=publish_urgent, args=(flooding[0], end, outcome), daemon=True).start()
    while time.monotonic() < end:
        took = other_program.put(end + LIMIT_S - time.monotonic())
        if took is not None:
            outcome.during_s.append(took)
        time.sleep(PERIOD_S)
    if outcome.during_s and time.monotonic() < end + FLOOD_S:
        outcome.next_s = other_program.put(LIMIT_S)
    if case.is_urgent_too:
        time.sleep(max(0.0, end + LIMIT_S - time.monotonic()))
    else:
        flooded.undeclare()
        outcome.left_bytes = carried_until_silence(on_air)
    outcome.memory_mb = [status(robot.pid(), "VmHWM") / 1000 for robot in (one, two)]
    urgent.undeclare()


def flood(session: zenoh.Session, payload: bytes, end: float) -> None:
    publisher = session.declare_publisher("rect/wombat-1/flood", congestion_control=CongestionControl.BLOCK)
    while time.monotonic() < end:
        publisher.put(payload)


def publish_urgent(session: zenoh.Session, end: float, outcome: Outcome) -> None:
    publisher = session.declare_publisher(
        "rect/wombat-1/stop", priority=Priority.REAL_TIME, congestion_control=CongestionControl.BLOCK, express=True
    )
    due = time.monotonic()
    while due < end:
        outcome.urgent_sent += 1
        publisher.put(struct.pack("<d", due))
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))


def age_s(payload: bytes) -> float:
    return time.monotonic() - struct.unpack("<d", payload)[0]


def carried_until_silence(on_air: Callable[[], int]) -> int:
    """Returns the bytes that the link carries until it has carried almost nothing for a second, for at most 10 s."""
    first = latest = on_air()
    for _ in range(10):
        time.sleep(1)
        before, latest = latest, on_air()
        if latest - before < SILENCE_BYTES_PER_S:
            break
    return latest - first


class OtherProgram:
    """A program that publishes messages of the same priority as the flood, one after the other."""

    def __init__(self, there: zenoh.Session, other: zenoh.Session) -> None:
        self._arrived = threading.Event()
        self._subscriber = there.declare_subscriber("rect/wombat-1/other", lambda _: self._arrived.set())
        self._publisher = other.declare_publisher("rect/wombat-1/other", congestion_control=CongestionControl.BLOCK)
        wait_until("a message arrives", 30, lambda: self.put(0.5) is not None)

    def put(self, limit_s: float) -> float | None:
        """Publishes a message, and returns the seconds until it arrived, or None if it did not within the limit."""
        self._arrived.clear()
        started = time.monotonic()
        self._publisher.put(bytes(8))
        return time.monotonic() - started if self._arrived.wait(limit_s) else None
