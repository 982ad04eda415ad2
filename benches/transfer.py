"""Measures a transfer of 5 MB over a slow link, without and with three cuts, and concurrent urgent messages.

All runs are concurrent, each on a separate air.
"""

import contextlib
import multiprocessing
import os
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import rect
from pairs import INTERVAL_MS, ble_pair_endpoints, carried, room
from robots import wait_until
from room import Room
from routers import status
from table import Table
from traffic import PERIOD_S, STRAGGLERS_S, percentile
from urgent import RATES, raw_bytes_per_s

FILE_BYTES = 5_000_000
ALONE, WITH_URGENT, WITH_CUTS = CASES = ["alone", "with urgent messages", "with urgent messages and three cuts"]
CUTS = 3
CUT_S = 3
LIMIT_S = 900
TARGET_SHARE, TARGET_URGENT_MS = 0.92, 100


@dataclass
class Outcome:
    kb_per_s: float
    carried: int
    """The bytes that the link carried, in both directions."""
    grown_mb: float
    """The growth of the program's memory."""
    urgent_sent: int
    urgent_ms: list[float]


def run() -> Table:
    runs = [(rate, case) for rate in RATES for case in CASES]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(len(runs), mp_context=context) as pool:
        raw = dict(zip(RATES, pool.map(raw_bytes_per_s, RATES.values()), strict=True))
        outcomes = dict(zip(runs, pool.map(measured, *zip(*runs, strict=True)), strict=True))
    table = Table(
        "A file of 5 MB over a slow link",
        [
            "link",
            "case",
            "kB/s (of raw)",
            "additional bytes",
            "memory growth",
            "urgent arrived",
            "p50",
            "p99",
            "outcome",
        ],
    )
    for (rate, case), outcome in outcomes.items():
        share = outcome.kb_per_s * 1000 / raw[rate]
        faults = []
        urgent = ["", "", ""]
        if case == ALONE and share < TARGET_SHARE:
            faults.append("slow")
        if case != ALONE:
            urgent[0] = f"{len(outcome.urgent_ms)}/{outcome.urgent_sent}"
        if case == WITH_URGENT:
            p50, p99 = (percentile(outcome.urgent_ms, part) for part in (0.5, 0.99))
            urgent[1:] = f"{p50:.0f} ms", f"{p99:.0f} ms"
            if len(outcome.urgent_ms) < outcome.urgent_sent:
                faults.append("urgent lost")
            if p99 > TARGET_URGENT_MS:
                faults.append("urgent late")
        # The overhead of the pieces and the urgent messages take as many bytes without cuts.
        more = outcome.carried - outcomes[rate, WITH_URGENT].carried
        table.add(
            f"{rate} ({raw[rate] / 1000:.1f} raw)",
            case,
            f"{outcome.kb_per_s:.1f} ({share:.2f})",
            f"{more / 1000:.0f} kB" if case == WITH_CUTS else "",
            f"{outcome.grown_mb:.1f} MB",
            *urgent,
            ", ".join(faults) or "ok",
        )
    table.notes = [
        f"The simulated air (condition desk, interval {INTERVAL_MS} ms; link-layer packets of 27 and of 251 bytes), "
        "`config/simulation.json5`; the Python package, both ends in one process, from a file into a folder. Raw: a "
        f"bare channel at its best SDU size. Cuts: the air is cut for {CUT_S} s at a quarter, half and three "
        "quarters; the rate includes these times, and urgent messages that are published while there is no link are "
        "lost. Additional bytes: more than without cuts, including the handshakes of new links. Urgent: a number every "
        "50 ms from the program that sends the file; these take airtime, too.",
        f"Target: alone {TARGET_SHARE} of raw; urgent p99 below {TARGET_URGENT_MS} ms.",
    ]
    return table


def measured(rate: str, case: str) -> Outcome:
    with tempfile.TemporaryDirectory() as name, room(RATES[rate]) as air:
        folder = Path(name)
        file = folder / "map.bin"
        file.write_bytes(os.urandom(FILE_BYTES))
        near, far = ble_pair_endpoints(air)
        with rect.connect("wombat-1", router=near) as here, rect.connect("wombat-2", router=far) as there:
            arriving = there.receive_transfers("*/map", folder=folder / "arrived")
            urgent = Urgent(here, there)
            at = [FILE_BYTES * (n + 1) // (CUTS + 1) for n in range(CUTS)] if case == WITH_CUTS else []

            def on_progress(progress: rect.Progress) -> None:
                if at and progress.received_bytes >= at[0]:
                    at.pop(0)
                    threading.Thread(target=cut, args=(air,)).start()

            before, memory, started = carried(air), status(os.getpid(), "VmRSS"), time.monotonic()
            with urgent if case != ALONE else contextlib.nullcontext():
                here.transfer("wombat-2", "map", file, on_progress=on_progress)
            took = time.monotonic() - started
            received = arriving.next(LIMIT_S)
            grown_mb = (status(os.getpid(), "VmRSS") - memory) / 1000
            assert Path(received.content).read_bytes() == file.read_bytes()
        return Outcome(FILE_BYTES / took / 1000, carried(air) - before, grown_mb, urgent.sent, urgent.ages_ms)


def cut(air: Room) -> None:
    air.cut()
    time.sleep(CUT_S)
    air.restore()


class Urgent:
    """Publishes an urgent number every 50 ms, and records the ages on arrival."""

    def __init__(self, here: rect.Robot, there: rect.Robot) -> None:
        self.ages_ms: list[float] = []
        self.sent = 0
        self._here = here
        self._due: list[float] = []
        self._is_reached = False
        self._ended = threading.Event()
        self._subscription = there.subscribe("wombat-1/stop", callback=self._on_message)
        wait_until("an urgent message arrives", 20, self._reaches)
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> "Urgent":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        ended = time.monotonic()
        while len(self.ages_ms) < self.sent and time.monotonic() - ended < STRAGGLERS_S:
            time.sleep(PERIOD_S)

    def _reaches(self) -> bool:
        self._here.publish("stop", -1, urgency="urgent")
        return self._is_reached

    def _on_message(self, message: rect.Message) -> None:
        now = time.monotonic()
        if message.value < 0:
            self._is_reached = True
        else:
            self.ages_ms.append((now - self._due[message.value]) * 1000)

    def _send(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            self._due.append(due)
            self._here.publish("stop", self.sent, urgency="urgent")
            self.sent += 1
            due += PERIOD_S
            self._ended.wait(max(due - time.monotonic(), 0))
