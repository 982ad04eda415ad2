"""Measures what different radios carry: messages of several sizes over two routers, compared with a bare channel, for
each PHY and packet size of the simulated air."""

import threading
import time
from dataclasses import dataclass, field

import zenoh
from pairs import ble_pair_endpoints, declare_reached
from peers import bare_channel
from robots import open_client, wait_until
from room import Room
from table import Table
from zenoh import CongestionControl

#: The names of the air's physical layers and packets, with those of the table.
RADIOS = [
    ("2m", 251, "2M PHY, packets of 251 bytes"),
    ("1m", 251, "1M PHY, packets of 251 bytes"),
    ("1m", 27, "1M PHY, packets of 27 bytes"),
    ("coded-s2", 251, "coded PHY, 500 kbit/s"),
    ("coded-s8", 251, "coded PHY, 125 kbit/s"),
]
SIZES = [20, 100, 1000, 4000, 16000]
SDU_BYTES = (1000, 4000)
RAW_S = 5
PUT_S = 4
#: How long the messages in flight may take over the slowest radio.
LIMIT_S = 30
#: The bytes of messages in flight. They fill every link.
WINDOW_BYTES = 64_000
INTERVAL = "30ms"
KEY = "rect/wombat-1/load"


@dataclass
class Arrivals:
    """The messages that arrived, without the first one, which begins the measurement."""

    began_at: float = 0.0
    last_at: float = 0.0
    messages: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def on_sample(self, _: zenoh.Sample) -> None:
        with self.lock:
            self.last_at = time.monotonic()
            if self.began_at:
                self.messages += 1
            else:
                self.began_at = self.last_at


def run() -> Table:
    table = Table(
        "Goodput by radio: Zenoh puts over two routers compared with a bare channel, on the simulated air",
        ["radio", "bare channel", *(f"put {size} B" for size in SIZES)],
    )
    for phy, pdu, name in RADIOS:
        with Room("desk", "--phy", phy, "--pdu", str(pdu), "--interval", INTERVAL) as room:
            raw = goodput_of_bare_channel(room)
            one, two = ble_pair_endpoints(room)
            with open_client(one) as near, open_client(two) as far:
                put = [goodput(near, far, size) for size in SIZES]
        table.add(name, f"{raw:.1f}", *(f"{one:.1f} ({one / raw:.2f})" for one in put))
        print(f"  {table.rows[-1]}", flush=True)
    table.notes = [
        "kB/s of payload, in brackets its ratio to the bare channel. Condition desk, connection interval "
        f"{INTERVAL}. The bare channel sends SDUs of {SDU_BYTES[0]} or {SDU_BYTES[1]} bytes, whichever is faster. "
        "Stock eclipse-zenoh clients at both ends, congestion control Block, from the first arrival to the last "
        "one."
    ]
    return table


def goodput_of_bare_channel(room: Room) -> float:
    def flood(total: int, sdu: int) -> float:
        adapters = (f"sim-near-{total}-{sdu}", f"sim-far-{total}-{sdu}")
        return bare_channel("flood", *adapters, str(total), str(sdu), environment=room.environment())["kb_per_s"]

    total = int(flood(20_000, SDU_BYTES[0]) * 1000 * RAW_S)
    return max(flood(total, sdu) for sdu in SDU_BYTES)


def goodput(near: zenoh.Session, far: zenoh.Session, size: int) -> float:
    arrivals = Arrivals()
    subscriber = far.declare_subscriber(f"{KEY}/{size}", arrivals.on_sample)
    publisher = declare_reached(near, f"{KEY}/{size}", CongestionControl.BLOCK)
    payload, end, sent = bytes(size), time.monotonic() + PUT_S, 0
    while time.monotonic() < end:
        # Without a limit, the sockets between programs and routers take megabytes.
        if (sent - arrivals.messages) * size > WINDOW_BYTES:
            time.sleep(0.001)
            continue
        publisher.put(payload)
        sent += 1
    wait_until("all messages arrive", LIMIT_S, lambda: arrivals.messages >= sent - 1)
    subscriber.undeclare()
    publisher.undeclare()
    return arrivals.messages * size / 1000 / (arrivals.last_at - arrivals.began_at)
