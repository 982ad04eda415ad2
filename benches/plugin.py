"""Measures the cost of RECT in a stock zenohd: the plugin compared with rect-router and with a zenohd without it."""

import math
import os
import statistics
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from robots import rect_settings
from routers import Router
from table import Table
from traffic import percentile
from urgent import RATES, Outcome, milliseconds, outcome_of, raw_bytes_per_s

HOSTS = {"rect-router": "lanes", "zenohd with the plugin": "plugin"}
CASES = {"1mb": "1 MB", "camera": "20 kB x 20 Hz, droppable"}
ROUNDS = 5


def run() -> Table:
    table = Table(
        "RECT in a stock zenohd (plugin) compared with rect-router",
        ["what", *HOSTS, "plugin to rect-router", "zenohd without it"],
    )
    raw = {rate: raw_bytes_per_s(pdu) for rate, pdu in RATES.items()}
    for case, title in CASES.items():
        for rate in RATES:
            with ThreadPoolExecutor() as pool:
                peers = list(HOSTS.values())
                outcomes = list(pool.map(lambda peer, c=case, r=rate: outcome_of(c, r, peer, raw[r]), peers))
            print(f"  {title} at {rate}", flush=True)
            what = f"{rate}, {title}"
            rates = [outcome.load.kb_per_s for outcome in outcomes]
            table.add(f"{what}: large, kB/s", *(f"{rate:.1f}" for rate in rates), ratio(rates), "")
            for place in (0.5, 0.99):
                ages = [age_s(outcome, place) for outcome in outcomes]
                cells = map(milliseconds, ages)
                table.add(f"{what}: urgent, p{place * 100:.0f}", *cells, ratio(ages), "")
    rows: tuple[tuple[str, Callable[[Router], int], int], ...] = (
        ("private memory, idle", lambda router: router.own_kb(), 1000),
        ("resident memory (RSS), idle", lambda router: router.status("VmRSS"), 1000),
        ("threads, idle", lambda router: router.status("Threads"), 1),
    )
    for what, figure, unit in rows:
        figures = [statistics.median(idle(kind, figure) / unit for _ in range(ROUNDS)) for kind in IDLE]
        cells = [f"{value:.1f} MB" if unit > 1 else f"{value:.0f}" for value in figures]
        table.add(what, *cells[:2], ratio(figures[:2]), cells[2])
    table.notes = [
        "The simulated air as in `urgent.md`; both hosts run at the same time, each on a separate air. Urgent: 16 "
        "bytes every 50 ms from the session that sends the rest. Target: within 2x. Idle: named `wombat-1`, an empty "
        f"list of connections, no Bluetooth listener, after one query by a client; medians of {ROUNDS} starts. Private "
        "memory: anonymous memory, without program text."
    ]
    return table


def age_s(outcome: Outcome, place: float) -> float:
    lost = outcome.sent - len(outcome.ages_s)
    return percentile(outcome.ages_s + [math.inf] * lost, place)


def ratio(pair: list[float]) -> str:
    return f"{pair[1] / pair[0]:.2f}"


IDLE = ("rect-router", "plugin", "stock zenohd")


def idle(kind: str, figure: Callable[[Router], int]) -> int:
    """Starts an idle router of one of the kinds in `IDLE`, and returns a figure of its process."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "connections.json"
        path.write_text('{"connections": []}')
        settings = {"robot": "wombat-1", "connections": str(path)}
        arguments = rect_settings(settings)
        program = "rect-router" if kind == "rect-router" else "stock zenohd"
        if kind == "plugin":
            arguments = ["-P", f"rect:{os.environ['RECT_PLUGIN']}", *arguments]
        with Router(program, *(arguments if kind != "stock zenohd" else [])) as router:
            router.wait_for_answer("@/*/router" if kind == "stock zenohd" else "rect/wombat-1/@rect/connections")
            return figure(router)
