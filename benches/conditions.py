"""Measures losses and ages of messages by radio condition: Bluetooth on the simulated air, and UDP and TCP with the
same share of lost packets."""

import struct
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import zenoh
from lossy import LossyTcp, LossyUdp
from pairs import ble_pair_endpoints, declare_reached
from robots import free_port, open_client
from room import Room
from table import Table
from traffic import percentile
from zenoh import CongestionControl

#: The share of packets with 251 bytes that each condition of the air loses (condition.rs in crates/zenoh-link-ble-air).
CONDITIONS = {"desk": 0.0, "room": 0.01, "wall": 0.1, "crowded-hall": 0.2, "edge-of-range": 0.4}
MESSAGE_BYTES = 200
EVERY_S = 0.05
MESSAGES = 400
#: How long a message may take. One that is older counts as lost.
LIMIT_S = 5.0
KEY = "rect/wombat-1/state"

#: The sessions at the two ends, and what brings the condition about.
Link = tuple[zenoh.Session, zenoh.Session, Callable[[], None]]


@contextmanager
def ble(condition: str) -> Iterator[Link]:
    with Room("desk") as room:
        one, two = ble_pair_endpoints(room)
        with open_client(one) as near, open_client(two) as far:
            yield near, far, lambda: room.set_condition(condition)


@contextmanager
def network(protocol: str, condition: str) -> Iterator[Link]:
    port = free_port()
    hop = (LossyUdp if protocol == "udp" else LossyTcp)(port)
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", f'["{protocol}/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")

    def worsen() -> None:
        hop.share = CONDITIONS[condition]

    with zenoh.open(config) as far, open_client(f"{protocol}/127.0.0.1:{hop.port}") as near:
        yield near, far, worsen
    hop.close()


PEERS = {
    "Bluetooth, RECT": ble,
    "TCP": lambda condition: network("tcp", condition),
    "UDP": lambda condition: network("udp", condition),
}


def run() -> Table:
    table = Table(
        "Losses and ages of messages by radio condition",
        ["condition", "packets lost", "peer", "messages lost", "p50", "p99", "max"],
    )
    for condition, share in CONDITIONS.items():
        for peer, connect in PEERS.items():
            ages_ms = measure(connect(condition))
            at = [f"{percentile(ages_ms, of):.0f} ms" for of in (0.5, 0.99, 1.0)]
            lost = (MESSAGES - len(ages_ms)) / MESSAGES
            table.add(condition, f"{share:.0%}", peer, f"{lost:.1%}", *at)
            print(f"  {table.rows[-1]}", flush=True)
    table.notes = [
        f"{MESSAGES} messages of {MESSAGE_BYTES} bytes, one every {EVERY_S * 1000:.0f} ms, congestion control Block,"
        f" stock eclipse-zenoh clients. Those that have not arrived after {LIMIT_S:.0f} s count as lost. Bluetooth: "
        "two rect-routers on the simulated air, 1M PHY, packets of 251 bytes, connection interval 30 ms; a short "
        "packet is lost less often. UDP and TCP: two sessions with a hop that loses the same share of datagrams, or"
        " delays the same share of TCP's segments by 200 ms, Linux's shortest time until it sends one again. Real "
        "Wi-Fi sends lost frames again by itself, so its share of lost packets is smaller under the same condition."
    ]
    return table


def measure(link: AbstractContextManager[Link]) -> list[float]:
    """Returns the ages of the messages that arrived, in milliseconds."""
    ages_ms: list[float] = []

    def on_sample(sample: zenoh.Sample) -> None:
        (sent_at,) = struct.unpack_from("<d", sample.payload.to_bytes())
        ages_ms.append((time.monotonic() - sent_at) * 1000)

    with link as (near, far, worsen):
        subscriber = far.declare_subscriber(KEY, on_sample)
        publisher = declare_reached(near, KEY, CongestionControl.BLOCK)
        worsen()
        due = time.monotonic()
        for _ in range(MESSAGES):
            publisher.put(struct.pack("<d", time.monotonic()).ljust(MESSAGE_BYTES, b"\0"))
            due += EVERY_S
            time.sleep(max(0.0, due - time.monotonic()))
        deadline = time.monotonic() + LIMIT_S
        while len(ages_ms) < MESSAGES and time.monotonic() < deadline:
            time.sleep(0.05)
        arrived = [age for age in ages_ms if age <= LIMIT_S * 1000]
        subscriber.undeclare()
    return arrived
