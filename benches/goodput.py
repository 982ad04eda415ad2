"""Compares the goodput of Zenoh over two routers with a raw channel, on a real kernel's Bluetooth stack with paced
radios.

The paces are those of a Pi 3B (34 kB/s, packets of 27 bytes) and of a radio with long packets (100 kB/s), see
README.md. Without a pace, the emulated processor is the limit; that row has no target."""

import itertools
import json
import statistics
import tempfile
import threading
import time
from pathlib import Path

import zenoh
from guest import CLOCK, figures_of, set_pace
from peers import bare_channel
from robots import Robot, RobotError, wait_until
from table import Table

PACES = [34_000, 100_000, 0]
SDU_BYTES = [500, 1000, 2000, 4000]
PAYLOAD_BYTES = [100, 1000, 4000, 16_000, 100_000]
ROUNDS = 3
SECONDS = 5
UNPACED_BYTES = 1_000_000
TARGET = 0.97
# Small messages need no more, because the cost of each matters, not their total.
MAX_PUTS = 4000


def run() -> Table:
    results = figures_of("goodput", 1500)
    table = Table(
        "Goodput on a real kernel's Bluetooth stack: Zenoh put over two routers compared with a raw L2CAP channel",
        ["pace", "raw, best SDU", *(f"put {size} B" for size in PAYLOAD_BYTES)],
    )
    for pace, rows in itertools.groupby(results, key=lambda result: result["pace"]):
        rounds = list(rows)
        best = [max(figures["raw"].items(), key=lambda item: item[1]) for figures in rounds]
        best_raw = statistics.median(raw for _, raw in best)
        cells = []
        for size in PAYLOAD_BYTES:
            # Each put is compared with the raw channel of the same round: the machine may be busier in another round.
            pairs = [(figures["put"][str(size)], raw) for figures, (_, raw) in zip(rounds, best, strict=True)]
            rate = statistics.median(put for put, _ in pairs)
            cells.append(f"{rate:.1f} ({statistics.median(put / raw for put, raw in pairs):.3f})")
        table.add(f"{pace / 1000:.0f} kB/s" if pace else "none", f"{best_raw:.1f} at {best[0][0]} B", *cells)
    table.notes = [
        f"kB/s of payload, in brackets its ratio to raw; medians of {ROUNDS} rounds, each of which measures all of "
        f"them in turn. Target: {TARGET} or better from 4000 B on, with a pace.",
        "Stock eclipse-zenoh clients at both ends, congestion control Block, from the first put to the last arrival.",
        CLOCK,
    ]
    return table


def in_guest() -> None:
    for pace in PACES:
        set_pace(["hci0", "hci1"], pace)
        total = pace * SECONDS or UNPACED_BYTES
        for n in range(ROUNDS):
            print(f"pace {pace or 'none'}, round {n + 1} of {ROUNDS}", flush=True)
            raw = {sdu: raw_rate(total, sdu) for sdu in SDU_BYTES}
            with tempfile.TemporaryDirectory() as folder:
                put = put_rates(total, Path(folder))
            print(json.dumps({"pace": pace, "raw": raw, "put": put}), flush=True)


def raw_rate(total: int, sdu_bytes: int) -> float:
    """Measures the kB/s of a bare SEQPACKET channel."""
    return bare_channel("flood", "hci0", "hci1", str(total), str(sdu_bytes))["kb_per_s"]


def put_rates(total: int, folder: Path) -> dict[int, float]:
    """Measures the kB/s of payloads of each size from one stock client to another, each with its own router."""
    one = Robot("wombat-1", "hci0", folder / "1.log").start([])
    two = Robot("wombat-2", "hci1", folder / "2.log").start(["ble/wombat-1"])
    try:
        wait_until("linked", 30, lambda: bool(one.ble_links() and two.ble_links()))
        with one.session() as here, two.session() as there:
            return {size: put_rate(here, there, size, total) for size in PAYLOAD_BYTES}
    finally:
        one.stop()
        two.stop()


def put_rate(here: zenoh.Session, there: zenoh.Session, size: int, total: int) -> float:
    key = f"rect/wombat-1/bench/{size}"
    count = min(max(total // size, 1), MAX_PUTS)
    arrived = threading.Semaphore(0)
    started = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        if len(sample.payload) == 1:
            started.set()
        else:
            arrived.release()

    subscriber = there.declare_subscriber(key, on_sample)
    publisher = here.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    wait_until("a message arrives", 30, lambda: publisher.put(b"?") or started.is_set())
    payload = bytes(size)
    start = time.monotonic()
    for _ in range(count):
        publisher.put(payload)
    for _ in range(count):
        if not arrived.acquire(timeout=60):
            raise RobotError(f"not all of {count} messages of {size} bytes arrived")
    took = time.monotonic() - start
    subscriber.undeclare()
    publisher.undeclare()
    return count * size / took / 1000
