"""Compares rect-router with the published zenohd on TCP loopback: messages between two programs through one router."""

import os
import statistics
from contextlib import ExitStack

from comparison import alternate, ratio
from peers import figures_of
from routers import PROGRAMS, Router
from table import Table

ROUNDS = 15
SECONDS = 1.5
THROUGHPUT_BYTES = [8, 1024, 65_536]
PING_BYTES = 64


def run() -> Table:
    table = Table(
        "TCP loopback through one router: rect-router compared with stock zenohd 1.10.2",
        ["what", *PROGRAMS, "rect-router to stock"],
    )
    with ExitStack() as stack:
        routers = [stack.enter_context(Router(program)) for program in PROGRAMS]
        for size in THROUGHPUT_BYTES:
            compare(table, routers, f"throughput, {size} B", "messages_per_s", "throughput", size)
        compare(table, routers, f"round trip, {PING_BYTES} B, p50", "p50_us", "ping", PING_BYTES)
    table.notes = [
        f"Medians of {ROUNDS} alternating rounds of {SECONDS} s each; the ratio is the median of the rounds' ratios, "
        "with the range of the middle half in brackets. Throughput in messages/s, round trip in microseconds. Target: "
        "within 2 %.",
    ]
    return table


def compare(table: Table, routers: list[Router], what: str, figure: str, mode: str, size: int) -> None:
    ours, stock = (lambda router=router: load(mode, router, size)[figure] for router in routers)
    found = alternate(ROUNDS, ours, stock)
    table.add(what, *(f"{statistics.median(rounds):,.0f}" for rounds in found), ratio(*found, digits=3))
    print(f"  {what}: {ratio(*found, digits=3)}", flush=True)


def load(mode: str, router: Router, size: int) -> dict[str, float]:
    command = [os.environ["RECT_LOAD"], mode, router.endpoint, str(size), str(SECONDS)]
    return figures_of(command)
