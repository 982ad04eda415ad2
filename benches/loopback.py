"""rect-router beside the published zenohd, on TCP loopback: one program's messages to another through one router."""

import os
import statistics
from contextlib import ExitStack

from peers import figures_of
from routers import PROGRAMS, Router
from table import Table

ROUNDS = 15
SECONDS = 1.5
THROUGHPUT_BYTES = [8, 1024, 65_536]
PING_BYTES = 64


def run() -> Table:
    table = Table(
        "TCP loopback through one router: rect-router beside stock zenohd 1.10.2",
        ["what", *PROGRAMS, "rect-router to stock"],
    )
    with ExitStack() as stack:
        routers = [stack.enter_context(Router(program)) for program in PROGRAMS]
        for size in THROUGHPUT_BYTES:
            compare(table, routers, f"throughput, {size} B", "messages_per_s", "throughput", size)
        compare(table, routers, f"round trip, {PING_BYTES} B, p50", "p50_us", "ping", PING_BYTES)
    table.notes = [
        f"Medians of {ROUNDS} rounds of {SECONDS} s each, by turns; the ratio is the median of the rounds' own, its "
        "middle half in brackets. Throughput in messages/s, round trip in microseconds. Wanted: within 2 %.",
    ]
    return table


def compare(table: Table, routers: list[Router], what: str, figure: str, mode: str, size: int) -> None:
    ours, stock = [], []
    for n in range(ROUNDS):
        # By turns in going first: whoever does may find a cooler or a hotter machine.
        for index in (0, 1) if n % 2 else (1, 0):
            (ours, stock)[index].append(load(mode, routers[index], size)[figure])
    ratios = [one / other for one, other in zip(ours, stock, strict=True)]
    low, middle, high = statistics.quantiles(ratios, n=4)
    ours, stock = statistics.median(ours), statistics.median(stock)
    table.add(what, f"{ours:,.0f}", f"{stock:,.0f}", f"{middle:.3f} ({low:.3f} to {high:.3f})")
    print(f"  {what}: {middle:.3f}", flush=True)


def load(mode: str, router: Router, size: int) -> dict[str, float]:
    command = [os.environ["RECT_LOAD"], mode, router.endpoint, str(size), str(SECONDS)]
    return figures_of(command)
