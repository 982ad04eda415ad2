"""Measures the other traffic of a link while a program that receives many messages is stopped.

When the program continues, the stock client detects that it has received nothing from its router for longer than the
router's lease, and connects again. The message that was being delivered is lost then, whatever the link between the
routers.

usage: stopped.py LOCATOR KEY    # runs the program that is stopped; it prints the size of every message"""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import zenoh
from pairs import Pair
from robots import open_client, wait_until
from traffic import PERIOD_S, STRAGGLERS_S, Load, Sender, Stall
from zenoh import CongestionControl, Priority

STOPPED_S = 60
# The bytes that the other router accepts for the stopped program until its queues are full. The other bulk message is
# sent after the time that they take.
FILLING_BYTES = 1_200_000
MESSAGES, MESSAGE_BYTES = 8, 1_000_000
OTHER_BYTES = 500_000
# The limit for the growth of a router: twice the bytes that were sent.
MEMORY_MB = 2 * MESSAGES
# Longer than the program is stopped; otherwise the router would close its session.
LEASE_MS = 120_000
KEY = "rect/wombat-1/log"


def stopped(here: zenoh.Session, there: zenoh.Session, pair: Pair, bytes_per_s: float) -> Load:
    """Stops a program, and returns the rate at which a bulk message of another priority arrives meanwhile."""
    before, links = pair.memory_mb("VmRSS"), pair.links()
    other = Sender(here, there, "rect/wombat-1/bulk/0", Priority.DATA_LOW)
    with Program(pair.far_socket) as program:
        publisher = here.declare_publisher(KEY, congestion_control=CongestionControl.BLOCK)
        wait_until("a message arrives", 30, lambda: publisher.put(b"?") or program.sizes)
        program.process.send_signal(signal.SIGSTOP)
        started = time.monotonic()
        threading.Thread(target=put_all, args=(publisher,), daemon=True).start()
        time.sleep(FILLING_BYTES / bytes_per_s)
        sent_at = time.monotonic()
        other.put(OTHER_BYTES)
        wait_or_end(started + STOPPED_S, lambda: False)
        program.process.send_signal(signal.SIGCONT)
        stall = Stall(pair.carried, bytes_per_s)
        while program.whole() < MESSAGES and not stall():
            time.sleep(PERIOD_S)
        wait_or_end(time.monotonic() + STRAGGLERS_S, lambda: bool(other.arrived))
        whole = program.whole()
    arrived = other.arrived[0][0] if other.arrived else float("inf")
    peak = [after - start for after, start in zip(pair.memory_mb("VmHWM"), before, strict=True)]
    load = Load(OTHER_BYTES / (arrived - sent_at) / 1000)
    load.remarks = [
        f"{whole} of {MESSAGES} MB reached the stopped program",
        f"memory of the routers +{peak[0]:.0f} and +{peak[1]:.0f} MB at most",
    ]
    if max(peak) > MEMORY_MB:
        load.faults.append("memory")
    if not other.arrived:
        load.faults.append("other bulk lost")
    elif arrived > started + STOPPED_S:
        load.faults.append("other bulk only after the stop")
    if pair.links() != links:
        load.faults.append("link lost")
    return load


def put_all(publisher: zenoh.Publisher) -> None:
    for _ in range(MESSAGES):
        publisher.put(bytes(MESSAGE_BYTES))


def wait_or_end(until: float, is_done: Callable[[], bool]) -> None:
    """Waits until the time `until`, or until `is_done` returns true."""
    while time.monotonic() < until and not is_done():
        time.sleep(PERIOD_S)


class Program:
    """The process of the program that is stopped."""

    def __init__(self, locator: str) -> None:
        self.sizes: list[int] = []
        self._command = [sys.executable, str(Path(__file__).resolve()), locator, KEY]

    def __enter__(self) -> "Program":
        path = ":".join(sys.path)
        self.process = subprocess.Popen(self._command, stdout=subprocess.PIPE, text=True, env={"PYTHONPATH": path})
        threading.Thread(target=self._read, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()

    def whole(self) -> int:
        """Returns how many of the large messages arrived."""
        return self.sizes.count(MESSAGE_BYTES)

    def _read(self) -> None:
        for line in self.process.stdout:
            self.sizes.append(int(line))


def main(locator: str, key: str) -> None:
    """Runs the program that is stopped. Prints the size of every message."""
    with open_client(locator, transport__link__tx__lease=LEASE_MS) as session:
        subscriber = session.declare_subscriber(key, lambda sample: print(len(sample.payload), flush=True))
        signal.pause()
        subscriber.undeclare()


if __name__ == "__main__":
    main(*sys.argv[1:])
