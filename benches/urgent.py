"""Measures urgent messages of a program that also sends large ones over a slow link: lanes, a plain link, stock over
TCP.

The peers of a case run at the same time, each with a separate air or shaper, so that the machine's load affects all of
them."""

import math
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

import zenoh
from latency_plot import plot
from pairs import INTERVAL_MS, PEERS, Pair, pair, room
from peers import bare_channel
from stopped import stopped
from table import Table
from traffic import Load, Stall, Urgent, bulk, camera, percentile

# The payload of the link layer's packets for each approximate rate. 27 bytes: a Raspberry Pi 3B.
RATES = {"34 kB/s": 27, "100 kB/s": 251}
RAW_BYTES, RAW_SDUS = 300_000, [1000, 2000, 4000]
MTU_BYTES = 736
MB = 1_000_000
CAMERA_S = 30
IDLE_S = 60
IDLE_BYTES_PER_S = 2
# Zenoh sends a byte in each direction every quarter of the lease of 10 s.
KEEP_ALIVE_BYTES_PER_S = 2 / 2.5
LEASE = "transport/link/tx/lease:2000"
LIMIT_S = 600
# The targets, as shares of the raw rate: of large messages, and of frames that arrive whole.
LARGE, FRAMES = 0.95, 0.70


@dataclass
class Case:
    title: str
    target: float | None
    """The required share of the raw rate."""
    load: Callable[[zenoh.Session, zenoh.Session, Pair, float], Load]
    settings: list[str] = field(default_factory=list)
    is_urgent: bool = True


@dataclass
class Outcome:
    """The result of one peer in a case."""

    load: Load
    sent: int = 0
    ages_s: list[float] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    """The warnings and errors of the routers."""


def bulks(*sizes: int) -> Callable[[zenoh.Session, zenoh.Session, Pair, float], Load]:
    return lambda here, there, link, rate: bulk(here, there, list(sizes), Stall(link.carried, rate))


def idle(here: zenoh.Session, there: zenoh.Session, link: Pair, rate: float) -> Load:
    time.sleep(5)
    before, started = link.carried(), time.monotonic()
    time.sleep(IDLE_S)
    per_s = (link.carried() - before) / (time.monotonic() - started)
    beyond = (per_s - KEEP_ALIVE_BYTES_PER_S) / 2
    faults = [f"over {IDLE_BYTES_PER_S} B/s"] if beyond > IDLE_BYTES_PER_S else []
    return Load(0.0, faults, [f"{beyond:.1f} B/s in each direction in addition to Zenoh's keep-alive"])


CASES = {
    "1mb": Case("1 MB", LARGE, bulks(MB)),
    "3mb": Case("three of 1 MB", LARGE, bulks(MB, MB, MB)),
    "10mb": Case("10 MB", LARGE, bulks(10 * MB)),
    "camera": Case("20 kB x 20 Hz, droppable", FRAMES, lambda here, there, *_: camera(here, there, CAMERA_S)),
    "stopped": Case("subscriber stopped for 60 s, 8 MB", LARGE, stopped),
    "lease": Case("1 MB, lease 2 s", LARGE, bulks(MB), [LEASE]),
    "idle": Case("idle", None, idle, is_urgent=False),
}


def run() -> Table:
    with ThreadPoolExecutor() as pool:
        raw = dict(zip(RATES, pool.map(raw_bytes_per_s, RATES.values()), strict=True))
    print("  raw: " + ", ".join(f"{rate / 1000:.1f} kB/s" for rate in raw.values()), flush=True)
    outcomes = {}
    for name in CASES:
        outcomes |= outcomes_of(name, raw)
    plot([(rate, CASES[name].title, peer, outcome) for (name, rate, peer), outcome in outcomes.items()])
    return table_of(outcomes, raw)


def raw_bytes_per_s(pdu: int) -> float:
    """Measures the rate of a bare channel at its best SDU size."""
    with room(pdu) as air:
        floods = [
            bare_channel("flood", "sim-bare-1", "sim-bare-2", str(RAW_BYTES), str(sdu), environment=air.environment())
            for sdu in RAW_SDUS
        ]
    return max(flood["kb_per_s"] for flood in floods) * 1000


def outcomes_of(name: str, raw: dict[str, float]) -> dict[tuple[str, str, str], Outcome]:
    started = time.monotonic()
    rates = list(RATES) if CASES[name].is_urgent else list(RATES)[-1:]
    runs = [(name, rate, peer) for rate in rates for peer in PEERS]
    with ThreadPoolExecutor(len(runs)) as pool:
        outcomes = dict(zip(runs, pool.map(lambda run: outcome_of(*run, raw[run[1]]), runs), strict=True))
    print(f"  {CASES[name].title}: {time.monotonic() - started:.0f} s", flush=True)
    return outcomes


def outcome_of(name: str, rate: str, peer: str, raw: float) -> Outcome:
    """Runs a case in a separate process, so that the Python programs do not share an interpreter."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs, name, RATES[rate], peer, raw))
    process.start()
    theirs.close()
    try:
        return ours.recv() if ours.poll(LIMIT_S) else Outcome(Load(0.0, [f"not finished within {LIMIT_S} s"]))
    except EOFError:
        return Outcome(Load(0.0, ["the bench's program ended"]))
    finally:
        # The process group includes all programs that it started.
        os.killpg(process.pid, signal.SIGKILL) if process.is_alive() else None
        process.join()


def work(pipe: Connection, name: str, pdu: int, peer: str, raw: float) -> None:
    os.setsid()
    try:
        outcome = measured(CASES[name], pdu, peer, raw)
    except Exception as error:  # A failure of one peer must not affect the figures of the others.
        outcome = Outcome(Load(0.0, [f"failed: {error}"]))
    pipe.send(outcome)
    # Clients may still be waiting for routers that were stopped.
    os._exit(0)


def measured(case: Case, pdu: int, peer: str, raw: float) -> Outcome:
    with pair(peer, pdu, raw, *case.settings) as link:
        here, there = link.near(), link.far()
        if not case.is_urgent:
            return Outcome(case.load(here, there, link, raw))
        urgent = Urgent(here, there)
        links = link.links()
        with urgent:
            time.sleep(0.5)
            load = case.load(here, there, link, raw)
        if link.links() != links and "link lost" not in load.faults:
            load.faults.append("link lost")
        return Outcome(load, urgent.sent, urgent.ages_s, link.complaints())


def table_of(outcomes: dict[tuple[str, str, str], Outcome], raw: dict[str, float]) -> Table:
    table = Table(
        "Urgent messages during large transfers from the same session, over a slow link",
        ["link", "case", "peer", "large kB/s (of raw)", "urgent arrived", "p50", "p99", "limit", "outcome"],
    )
    for (name, rate, peer), outcome in outcomes.items():
        case, load = CASES[name], outcome.load
        limit_s = MTU_BYTES / raw[rate] + INTERVAL_MS / 1000 + 0.010
        share = load.kb_per_s * 1000 / raw[rate]
        faults, cells = list(load.faults), ["", "", "", ""]
        if case.target and share < case.target and not load.faults:
            faults.append("slow")
        if case.is_urgent and outcome.ages_s:
            # Percentiles of all messages that were sent: a lost one counts as infinitely late.
            ages_s = outcome.ages_s + [math.inf] * (outcome.sent - len(outcome.ages_s))
            p50, p99 = (percentile(ages_s, part) for part in (0.5, 0.99))
            cells = [
                f"{len(outcome.ages_s)}/{outcome.sent}",
                milliseconds(p50),
                milliseconds(p99),
                milliseconds(limit_s),
            ]
            if outcome.sent != len(outcome.ages_s):
                faults.append("urgent lost")
            if limit_s < p99 < math.inf:
                faults.append("urgent late")
        large = f"{load.kb_per_s:.1f} ({share:.2f})" if case.target else ""
        complaint = [f"`{outcome.complaints[0]}`"] if faults and outcome.complaints else []
        remarks = "; ".join([", ".join(faults) or "ok", *load.remarks, *complaint])
        table.add(f"{rate} ({raw[rate] / 1000:.1f} raw)", case.title, peer, large, *cells, remarks)
    table.notes = [
        "The simulated air (condition desk, interval 30 ms; link-layer packets of 27 and of 251 bytes), "
        "`config/simulation.json5`; stock zenohd 1.10.2 with its defaults over TCP shaped to the raw rate, without a "
        "connection interval. Raw: a bare channel at its best SDU size in the same run. Stock eclipse-zenoh clients; "
        "urgent: 16 bytes every 50 ms, `REAL_TIME`, from the session that sends the rest; ages count from the time "
        "when each was due.",
        f"Target: no urgent message lost, p99 within the limit (airtime of an MTU of {MTU_BYTES} bytes, a connection "
        f"interval, 10 ms); large: {LARGE} of raw, whole frames {FRAMES} and none older than 1 s. Stopped subscriber: "
        "the rate is that of 500 kB of another priority sent meanwhile. The client that was stopped connects to its "
        "router again (lease), so that one of the 8 MB may be lost between the router and the client.",
        "Plot: `urgent.svg`.",
    ]
    return table


def milliseconds(seconds: float) -> str:
    return "lost" if seconds == math.inf else f"{seconds * 1000:.0f} ms"
