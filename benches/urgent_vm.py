"""Measures urgent messages during large transfers on a real kernel's Bluetooth stack, with radios paced as in
`goodput.py`."""

import json
import tempfile
import time
from pathlib import Path

import zenoh
from guest import CLOCK, figures_of, set_pace
from peers import bare_channel
from robots import Robot, wait_until
from table import Table
from traffic import PERIOD_S, URGENT_BYTES, Load, Urgent, bulk, camera, percentile

PACES = [100_000, 34_000]
SDU_BYTES = [2000, 4000]
SECONDS = 5
CAMERA_S = 20
BULK_BYTES = 1_000_000
BULK_LIMIT_S = 90
# The target beside urgent messages; `goodput` measures the rate without them.
TARGET = 0.95
LIMIT_MS = 30
ADAPTERS = ["hci0", "hci1"]


def run() -> Table:
    table = Table(
        "Urgent messages during large transfers on a real kernel's Bluetooth stack, compared with a raw L2CAP channel",
        ["pace", "raw kB/s", "case", "large kB/s (of raw)", "urgent arrived", "p50", "p99", "max", "outcome"],
    )
    for figures in figures_of("urgent_vm", 600):
        share = figures["kb_per_s"] / figures["raw"]
        table.add(
            f"{figures['pace'] / 1000:.0f} kB/s",
            f"{figures['raw']:.1f}",
            figures["case"],
            f"{figures['kb_per_s']:.1f} ({share:.3f})",
            f"{figures['arrived']}/{figures['sent']}",
            *(f"{figures[name]:.0f} ms" for name in ("p50", "p99", "max")),
            "; ".join([", ".join(faults_of(figures, share)) or "ok", *figures["remarks"]]),
        )
    table.notes = [
        "Two routers with lanes and stock eclipse-zenoh clients; 16 bytes every 50 ms, `REAL_TIME`, from the session "
        "that sends the rest. Raw: a bare L2CAP channel at its best SDU size, just before, with the same urgent bytes "
        "in separate SDUs. 1 MB: from the put to the arrival, including the paths between programs and routers.",
        CLOCK,
        f"Target: {TARGET} of raw, no urgent message lost, their p99 under {LIMIT_MS} ms at 100 kB/s.",
    ]
    return table


def faults_of(figures: dict, share: float) -> list[str]:
    faults = list(figures["faults"])
    if share < TARGET:
        faults.append("slow")
    if figures["arrived"] != figures["sent"]:
        faults.append("urgent lost")
    if figures["pace"] == PACES[0] and figures["p99"] >= LIMIT_MS:
        faults.append("urgent late")
    return faults


def in_guest() -> None:
    for pace in PACES:
        set_pace(ADAPTERS, pace)
        total = str(pace * SECONDS)
        urgent = (str(URGENT_BYTES), f"{PERIOD_S * 1000:.0f}")
        raw = max(bare_channel("flood", *ADAPTERS, total, str(sdu), *urgent)["kb_per_s"] for sdu in SDU_BYTES)
        for case in ("1 MB", "20 kB x 20 Hz, droppable"):
            print(f"  pace {pace / 1000:.0f} kB/s: {case}", flush=True)
            with tempfile.TemporaryDirectory() as folder:
                figures = measured(case, Path(folder))
            print(json.dumps({"pace": pace, "raw": raw, "case": case} | figures), flush=True)


def measured(case: str, folder: Path) -> dict:
    one = Robot("wombat-1", ADAPTERS[0], folder / "1.log").start([])
    two = Robot("wombat-2", ADAPTERS[1], folder / "2.log").start(["ble/wombat-1"])
    try:
        wait_until("linked", 30, lambda: bool(one.ble_links() and two.ble_links()))
        with one.session() as here, two.session() as there, Urgent(here, there) as urgent:
            time.sleep(1)
            load = large(case, here, there)
    finally:
        one.stop()
        two.stop()
    ages_ms = [age * 1000 for age in urgent.ages_s]
    places = {"p50": 0.5, "p99": 0.99, "max": 1.0}
    figures = {name: percentile(ages_ms, share) for name, share in places.items()}
    return figures | vars(load) | {"arrived": len(ages_ms), "sent": urgent.sent}


def large(case: str, here: zenoh.Session, there: zenoh.Session) -> Load:
    if case != "1 MB":
        return camera(here, there, CAMERA_S)
    started = time.monotonic()
    return bulk(here, there, [BULK_BYTES], lambda: time.monotonic() - started > BULK_LIMIT_S)
