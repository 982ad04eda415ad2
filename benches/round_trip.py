"""Compares the round trip of 20 bytes over the simulated air: a bare channel, and a Zenoh query through two routers."""

import statistics
import time

import zenoh
from peers import bare_channel
from room import Room, wait_for_link
from table import Table

INTERVALS_MS = [7.5, 30]
COUNT = 150
ROUNDS = 5
PAYLOAD = bytes(20)
KEY = "rect/wombat-2/bench"
TARGET = 1.3


def run() -> Table:
    table = Table(
        "Round trip of 20 bytes on the simulated air: a Zenoh query through two routers compared with a bare channel",
        ["connection interval", "bare p50", "bare p99", "query p50", "query p99", "ratio of p50"],
    )
    for interval in INTERVALS_MS:
        with Room("room", "--interval", f"{interval}ms") as room:
            bare, asked, ratios = [], [], []
            one, two = room.add_robot("wombat-1"), room.add_robot("wombat-2")
            wait_for_link(one, two)
            with one.session() as here, two.session() as there:
                service = there.declare_queryable(KEY, lambda query: query.reply(KEY, PAYLOAD))
                querier = here.declare_querier(KEY, timeout=5)
                for _ in range(ROUNDS):
                    bare.append(ping(room))
                    asked.append(ask(querier, PAYLOAD, COUNT))
                    ratios.append(percentile(asked[-1], 0.5) / bare[-1]["p50_ms"])
                service.undeclare()
        every = [t for times in asked for t in times]
        table.add(
            f"{interval} ms",
            f"{statistics.median(b['p50_ms'] for b in bare):.1f} ms",
            f"{statistics.median(b['p99_ms'] for b in bare):.1f} ms",
            f"{percentile(every, 0.5):.1f} ms",
            f"{percentile(every, 0.99):.1f} ms",
            f"{statistics.median(ratios):.2f}",
        )
    table.notes = [
        f"{ROUNDS} alternating rounds of {COUNT} each on the same air (condition room). Target: a ratio of {TARGET} or "
        "less. The query goes from a stock Python client over TCP to its router, over the air to the other, over TCP "
        "to a Python queryable, and back."
    ]
    return table


def ping(room: Room) -> dict[str, float]:
    return bare_channel("ping", "sim-bare-1", "sim-bare-2", str(COUNT), environment=room.environment())


def ask(querier: zenoh.Querier, payload: bytes, count: int) -> list[float]:
    """Measures the milliseconds from a query to its answer, until `count` queries were answered."""
    times = []
    while len(times) < count:
        started = time.perf_counter()
        answers = [reply for reply in querier.get(payload=payload) if reply.ok is not None]
        if answers:  # The first queries get none, until the service is known.
            times.append((time.perf_counter() - started) * 1000)
    return times


def percentile(times: list[float], share: float) -> float:
    return sorted(times)[int((len(times) - 1) * share)]
