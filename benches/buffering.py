"""Measures how the size of queues affects age and losses when more is published than the link carries."""

import struct
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import zenoh
from pairs import declare_reached, pair, room
from room import wait_for_link
from table import Table
from traffic import percentile
from zenoh import CongestionControl

PDU = 27
#: Rate of the bare channel, to which the TCP link is slowed down: benches/results/urgent.md.
RAW_BYTES_PER_S = 36_800
MESSAGE_BYTES = 1000
#: Half more than the link carries.
EVERY_S = MESSAGE_BYTES / (1.5 * RAW_BYTES_PER_S)
SECONDS = 20
#: The queues fill in the beginning.
WARM_UP_S = 5
KEY = "rect/wombat-1/state"

#: How long the data before a droppable message may take on RECT's link, in milliseconds.
DROPPABLE_MS = [50, 100, 300, 1000, 3000]
#: The number of batches that stock Zenoh queues for each priority.
QUEUES = [1, 2, 4, 8, 16]

Sessions = tuple[zenoh.Session, zenoh.Session]


def run() -> Table:
    table = Table(
        "More messages than the link carries: the size of the queue, ages and losses",
        ["peer", "queue", "dropped", "age p50", "p99", "kB/s"],
    )
    for ms in DROPPABLE_MS:
        add(table, "RECT", f"{ms} ms", ble(ms))
    for size in QUEUES:
        add(table, "stock Zenoh over TCP", f"{size} batches", tcp(size))
    table.notes = [
        f"Messages of {MESSAGE_BYTES} bytes at 1.5 times the rate of the link, 36.8 kB/s, for {SECONDS} s, "
        f"congestion control Drop; those of the first {WARM_UP_S} s are not counted. RECT: `droppable=`, the "
        f"simulated air, packets of {PDU} bytes, condition desk. Stock: two zenohds 1.10.2 with "
        "`transport/link/tx/queue/size/data` over TCP that was slowed down to the same rate. Stock eclipse-zenoh "
        "clients."
    ]
    return table


@contextmanager
def ble(droppable_ms: int) -> Iterator[Sessions]:
    option = f"droppable={droppable_ms}"
    with room(PDU) as air:
        one = air.add_robot("wombat-1", ble_options=f";{option}")
        two = air.add_robot("wombat-2", f"#{option}", ble_options=f";{option}")
        wait_for_link(one, two)
        with one.session() as near, two.session() as far:
            yield near, far


@contextmanager
def tcp(batches: int) -> Iterator[Sessions]:
    setting = f"transport/link/tx/queue/size/data:{batches}"
    with pair("stock over TCP", PDU, RAW_BYTES_PER_S, setting) as made, made.near() as near, made.far() as far:
        yield near, far


def add(table: Table, peer: str, queue: str, link: AbstractContextManager[Sessions]) -> None:
    arrived: list[tuple[float, float]] = []

    def on_sample(sample: zenoh.Sample) -> None:
        now = time.monotonic()
        (sent_at,) = struct.unpack_from("<d", sample.payload.to_bytes())
        arrived.append((sent_at, now))

    with link as (near, far):
        subscriber = far.declare_subscriber(KEY, on_sample)
        publisher = declare_reached(near, KEY, CongestionControl.DROP)
        began = due = time.monotonic()
        sent = 0
        while due < began + SECONDS:
            publisher.put(struct.pack("<d", due).ljust(MESSAGE_BYTES, b"\0"))
            sent += due >= began + WARM_UP_S
            due += EVERY_S
            time.sleep(max(0.0, due - time.monotonic()))
        wait_until_silent(arrived)
        subscriber.undeclare()
    counted = [(sent_at, at) for sent_at, at in arrived if sent_at >= began + WARM_UP_S]
    ages_ms = [(at - sent_at) * 1000 for sent_at, at in counted]
    rate = len(counted) * MESSAGE_BYTES / 1000 / (counted[-1][1] - counted[0][1])
    at = [f"{percentile(ages_ms, share):.0f} ms" for share in (0.5, 0.99)]
    table.add(peer, queue, f"{1 - len(counted) / sent:.0%}", *at, f"{rate:.1f}")
    print(f"  {table.rows[-1]}", flush=True)


def wait_until_silent(arrived: list[tuple[float, float]]) -> None:
    """Waits until no message has arrived for a second."""
    while True:
        before = len(arrived)
        time.sleep(1)
        if len(arrived) == before:
            return
