"""Measures what programs notice when the Wi-Fi between two robots falls silent or is lost: a link over Bluetooth and
Wi-Fi compared with each alone, and with stock Zenoh over two TCP links of the same rates."""

import itertools
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
from traffic import percentile
from zenoh import CongestionControl, Priority

WIFI_BYTES_PER_S, BLUETOOTH_BYTES_PER_S = 3_000_000, 34_000
FAULTS = {"silent": "silent for 3 s", "off": "lost for 3 s"}
ROUNDS = 2
BEFORE_S, FAULT_S, AFTER_S, STRAGGLERS_S = 2, 3, 5, 20
# Number, and the time when it was due.
MESSAGE = "<Id"
# The priority and the period in seconds of each kind of message, and its size in bytes.
KINDS = {
    "urgent": (Priority.REAL_TIME, 0.05, 16),
    "small": (Priority.DATA, 0.05, 64),
    "bulk": (Priority.DATA_LOW, 0.5, 10_000),
}


@dataclass
class Pair:
    near: Callable[[], zenoh.Session]
    far: Callable[[], zenoh.Session]
    set_wifi: Callable[[str], None]
    """Sets the state of the Wi-Fi: `on`, `silent` or `off`."""


@dataclass
class Flow:
    """The messages of one kind."""

    sent: int = 0
    arrived: list[tuple[int, float, float]] = field(default_factory=list)
    """Number, time when it was due, and age on arrival, in the order of arrival."""


@contextmanager
def any_pair() -> Iterator[Pair]:
    with Room("desk", "--pdu", "27", has_wifi=True) as room:
        one, two = (room.add_robot(name, kind=AnyRobot) for name in ("wombat-1", "wombat-2"))
        wait_until("linked by both", 20, lambda: one.bulk_path() == "tcp" and one.has_path("ble"))
        yield Pair(one.session, two.session, room.set_wifi)


@contextmanager
def bluetooth_pair() -> Iterator[Pair]:
    with Room("desk", "--pdu", "27") as room:
        one, two = room.add_robot("wombat-1"), room.add_robot("wombat-2")
        wait_for_link(one, two)
        yield Pair(one.session, two.session, lambda _: None)


@contextmanager
def stock_pair(links: int, *settings: str) -> Iterator[Pair]:
    """Runs two stock zenohd with TCP links of the rates of Wi-Fi and, if there are two, of Bluetooth."""
    arguments = [part for setting in settings for part in ("--cfg", setting)]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        near = stack.enter_context(Router("stock zenohd", *arguments, log=Path(folder) / "near.log"))
        port = int(near.endpoint.rsplit(":", 1)[1])
        rates = [WIFI_BYTES_PER_S, BLUETOOTH_BYTES_PER_S][:links]
        shapers = [stack.enter_context(Shaper(rate, port)) for rate in rates]
        dials = [part for shaper in shapers for part in ("-e", f"tcp/127.0.0.1:{shaper.port}")]
        far = stack.enter_context(Router("stock zenohd", *dials, *arguments, log=Path(folder) / "far.log"))

        def set_wifi(state: str) -> None:
            shapers[0].state = state

        yield Pair(lambda: open_client(near.endpoint), lambda: open_client(far.endpoint), set_wifi)


PEERS = {
    "any: Bluetooth and Wi-Fi": any_pair,
    "Bluetooth alone": bluetooth_pair,
    "stock, TCP alone": lambda: stock_pair(1),
    "stock, two endpoints": lambda: stock_pair(2),
    "stock, multilink": lambda: stock_pair(2, "transport/unicast/max_links:2"),
}


def run() -> Table:
    columns = ["Wi-Fi", "peer", "small lost", "twice", "out of order", "small p99", "max"]
    columns += ["urgent lost", "urgent p99", "max", "bulk lost"]
    table = Table("Two robots while their Wi-Fi is silent or lost", columns)
    for fault, what in FAULTS.items():
        for peer, pair in PEERS.items():
            flows = {kind: Flow() for kind in KINDS}
            for _ in range(ROUNDS):
                with pair() as link:
                    for kind, flow in measured(link, fault).items():
                        flows[kind].sent += flow.sent
                        flows[kind].arrived += flow.arrived
            print(f"  {what}: {peer}", flush=True)
            table.add(what, peer, *cells(flows))
    table.notes = [
        "Stock eclipse-zenoh clients publish with congestion control Block: urgent, 16 bytes every 50 ms, REAL_TIME; "
        "small, 64 bytes every 50 ms, DATA; bulk, 10 kB every 0.5 s, DATA_LOW. "
        f"{ROUNDS} faults for each row. Ages are those of the messages that were due during the fault and {FAULT_S} s "
        f"after it. Lost: did not arrive within {STRAGGLERS_S} s.",
        "any and Bluetooth: rect-router on the simulated air (desk, packets of 27 bytes), and the simulated Wi-Fi "
        "(3 MB/s, 2 ms). Stock: zenohd 1.10.2 over TCP shaped to 3 MB/s and 34 kB/s; only the fast link fails.",
    ]
    return table


def cells(flows: dict[str, Flow]) -> list[str]:
    small, urgent = flows["small"], flows["urgent"]
    dues = [due for _, due, _ in small.arrived]
    late = sum(after < before for before, after in itertools.pairwise(dues))
    return [
        f"{lost(small)}/{small.sent}",
        f"{twice(small)}",
        f"{late}",
        *ages(small),
        f"{lost(urgent)}/{urgent.sent}",
        *ages(urgent),
        f"{lost(flows['bulk'])}/{flows['bulk'].sent}",
    ]


def twice(flow: Flow) -> int:
    return len(flow.arrived) - len({(number, due) for number, due, _ in flow.arrived})


def lost(flow: Flow) -> int:
    return flow.sent - len({(number, due) for number, due, _ in flow.arrived})


def ages(flow: Flow) -> list[str]:
    values = [age for _, _, age in flow.arrived]
    if not values:
        return ["-", "-"]
    return [f"{percentile(values, share) * 1000:.0f} ms" for share in (0.99, 1.0)]


def measured(link: Pair, fault: str) -> dict[str, Flow]:
    """Publishes through one fault, and returns the messages that were due during it and shortly after."""
    flows = {kind: Flow() for kind in KINDS}
    here, there = link.near(), link.far()
    ended = threading.Event()
    window = [float("inf"), float("inf")]
    subscribers = [subscribe(there, kind, flow, window) for kind, flow in flows.items()]
    publishers = [
        here.declare_publisher(key(kind), priority=priority, congestion_control=CongestionControl.BLOCK, express=True)
        for kind, (priority, *_) in KINDS.items()
    ]
    opened = {kind: threading.Event() for kind in KINDS}
    probes = [there.declare_subscriber(f"{key(kind)}/probe", lambda _, e=e: e.set()) for kind, e in opened.items()]
    for kind, event in opened.items():
        probe = f"{key(kind)}/probe"
        wait_until("a message arrives", 30, lambda p=probe, e=event: here.put(p, b"?") or e.is_set())
    time.sleep(0.5)
    threads = [
        threading.Thread(target=publish, args=(publisher, kind, flows[kind], window, ended), daemon=True)
        for publisher, kind in zip(publishers, KINDS, strict=True)
    ]
    for thread in threads:
        thread.start()
    time.sleep(BEFORE_S)
    window[:] = [time.monotonic(), time.monotonic() + FAULT_S + FAULT_S]
    link.set_wifi(fault)
    time.sleep(FAULT_S)
    link.set_wifi("on")
    time.sleep(AFTER_S)
    ended.set()
    deadline = time.monotonic() + STRAGGLERS_S
    while any(lost(flow) for flow in flows.values()) and time.monotonic() < deadline:
        time.sleep(0.05)
    del subscribers, probes
    return flows


def key(kind: str) -> str:
    return f"rect/wombat-1/{kind}"


def subscribe(there: zenoh.Session, kind: str, flow: Flow, window: list[float]) -> zenoh.Subscriber:
    def on_sample(sample: zenoh.Sample) -> None:
        number, due = struct.unpack_from(MESSAGE, sample.payload.to_bytes())
        if window[0] <= due <= window[1]:
            flow.arrived.append((number, due, time.monotonic() - due))

    return there.declare_subscriber(key(kind), on_sample)


def publish(publisher: zenoh.Publisher, kind: str, flow: Flow, window: list[float], ended: threading.Event) -> None:
    """Publishes periodically. Messages that could not be published in time are due nevertheless."""
    _, period_s, size = KINDS[kind]
    due, number = time.monotonic(), 0
    while not ended.is_set():
        head = struct.pack(MESSAGE, number, due)
        if window[0] <= due <= window[1]:
            flow.sent += 1
        try:
            publisher.put(head + bytes(size - len(head)))
        except zenoh.ZError:
            return
        number += 1
        due += period_s
        ended.wait(max(0.0, due - time.monotonic()))
