"""Compares the library with plain zenoh, gRPC and MQTT on TCP loopback: latency, messages/s, bytes."""

import os
import statistics
import subprocess
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import dataclass

from comparison import ratio, rounds
from peers import figures_of
from robots import free_port, is_listening, wait_until
from routers import Router
from table import Table
from traffic import percentile

SIZES = [64, 1024]
ROUNDS = rounds(16)
SECONDS = 0.5
TARGET = 1.1


@dataclass(frozen=True)
class Pairing:
    """Two programs that use one middleware, with or without a router or broker between them."""

    name: str
    middleware: str
    over: str | None
    """The router or broker between them."""
    baseline: str
    """The pairing that it is compared with."""


PAIRINGS = [
    Pairing("RECT", "rect", None, "zenoh"),
    Pairing("RECT, one thread", "rect-one-thread", None, "zenoh"),
    Pairing("zenoh", "zenoh", None, "zenoh"),
    Pairing("zenoh, attached", "zenoh-attached", None, "zenoh"),
    Pairing("gRPC", "grpc", None, "zenoh"),
    Pairing("RECT over rect-router", "rect", "rect-router", "zenoh over zenohd"),
    Pairing("RECT, one thread, over rect-router", "rect-one-thread", "rect-router", "zenoh over zenohd"),
    Pairing("zenoh over rect-router", "zenoh", "rect-router", "zenoh over zenohd"),
    Pairing("zenoh over zenohd", "zenoh", "stock zenohd", "zenoh over zenohd"),
    Pairing("MQTT over rumqttd", "mqtt", "rumqttd", "zenoh over zenohd"),
]


class Program:
    """The running program `middleware`."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen([os.environ["RECT_MIDDLEWARE"], *arguments])

    def __enter__(self) -> "Program":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(10)


class Pair:
    """A pairing whose serving program is running; the other program is run for each measurement."""

    def __init__(self, pairing: Pairing, stack: ExitStack) -> None:
        self.pairing = pairing
        if pairing.over == "rumqttd":
            self._where = [listening(stack, "broker"), "--router"]
        elif pairing.over:
            # Each pairing has its own router, because all use the same keys, and a request goes to every service.
            router = stack.enter_context(Router(pairing.over))
            self._where = [router.endpoint.removeprefix("tcp/"), "--router"]
        else:
            self._where = [listening(stack, "serve", pairing.middleware)]
        if pairing.over:
            stack.enter_context(Program("serve", pairing.middleware, *self._where))

    def measure(self, job: str, size: int) -> dict:
        load = ["--bytes", str(size), "--seconds", str(SECONDS)]
        command = [os.environ["RECT_MIDDLEWARE"], "measure", self.pairing.middleware, job, *self._where, *load]
        return figures_of(command)


class Measured:
    """The figures of each pairing, round by round."""

    def __init__(self) -> None:
        self.times_us: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
        self.rates: dict[str, list[float]] = defaultdict(list)
        self.lost: dict[str, int] = defaultdict(int)
        self.bytes: dict[str, dict] = {}

    def round(self, pairs: list[Pair], size: int) -> None:
        for job in ("publish", "request"):
            for pair in pairs:
                self.times_us[pair.pairing.name, job].append(pair.measure(job, size)["times_us"])
        for pair in pairs:
            figures = pair.measure("flood", size)
            self.rates[pair.pairing.name].append(figures["messages_per_s"])
            self.lost[pair.pairing.name] += figures["lost"]

    def row(self, pairing: Pairing) -> list[str]:
        cells = []
        # A round trip by publishing takes two messages.
        for job, share in (("publish", 0.5), ("request", 1.0)):
            ours, others = (self.times_us[name, job] for name in (pairing.name, pairing.baseline))
            every = [time * share for times in ours for time in times]
            cells += [f"{percentile(every, place):,.0f} us" for place in (0.5, 0.99)]
            cells.append(ratio_to([percentile(times, 0.5) for times in ours], [percentile(t, 0.5) for t in others]))
        rates = self.rates[pairing.name]
        cells += [f"{statistics.median(rates):,.0f}", ratio_to(rates, self.rates[pairing.baseline])]
        counted = self.bytes[pairing.name]
        return cells + [f"{counted[what]:.0f}" for what in ("bytes_per_message", "bytes_per_request")]


def run() -> Table:
    latency, rate = ["p50", "p99", "to zenoh"], ["messages/s", "to zenoh"]
    columns = [f"publish {latency[0]}", *latency[1:], f"request {latency[0]}", *latency[1:], *rate]
    table = Table(
        "RECT compared with plain zenoh, gRPC and MQTT on TCP loopback",
        ["payload, what", *columns, "bytes per message", "bytes per request"],
    )
    with ExitStack() as stack:
        pairs = [Pair(pairing, stack) for pairing in PAIRINGS]
        for size in SIZES:
            measured = Measured()
            for pair in pairs:
                measured.bytes[pair.pairing.name] = pair.measure("bytes", size)
            for n in range(ROUNDS):
                # The pairs alternate in going first, because the first one may find a cooler or a hotter machine.
                rotated = pairs[n % len(pairs) :] + pairs[: n % len(pairs)]
                measured.round(rotated[::-1] if n % 2 else rotated, size)
                print(f"  {size} B: round {n + 1} of {ROUNDS}", flush=True)
            for pair in pairs:
                table.add(f"{size} B: {pair.pairing.name}", *measured.row(pair.pairing))
            lost = [f"{name}: {count}" for name, count in measured.lost.items() if count]
            if lost:
                table.notes.append(f"Lost at {size} B: {', '.join(lost)}.")
    table.notes += notes()
    return table


def listening(stack: ExitStack, *arguments: str) -> str:
    """Starts the program `middleware`, and returns the address that it listens on."""
    port = free_port()
    address = f"127.0.0.1:{port}"
    stack.enter_context(Program(*arguments, address))
    wait_until(f"{' '.join(arguments)} listens", 20, lambda: is_listening(port))
    return address


def ratio_to(ours: list[float], others: list[float]) -> str:
    return "1" if ours == others else ratio(ours, others)


def notes() -> list[str]:
    return [
        f"Two processes, {ROUNDS} rounds of {SECONDS} s for each figure, alternating. Latencies: all samples of all "
        "rounds; messages/s: the median. To zenoh: the median of the rounds' ratios, of the p50s and of the "
        "messages/s, to plain zenoh, direct or over zenohd, with the range of the middle half in brackets. Target "
        f"for RECT at 64 B: at most {TARGET:.2f} of zenoh's latency.",
        "Publish: half the round trip of a message and its echo, both published. Request: until the reply arrives. "
        "Messages/s: one way, as fast as possible without loss, counted by the receiver. Bytes: in the TCP "
        "streams, both directions added, on the connection of the program that publishes or requests, 200 messages "
        "5 ms apart. The p99s mostly show other work of the machine.",
        "All: Rust, tokio's default runtime, messages taken by an async call, TCP_NODELAY. RECT: its defaults; for "
        "messages/s its subscriber blocks the sender (`WhenFull::Block`), while the default drops the oldest message. "
        "One thread: both programs call `use_one_thread`, so that Zenoh works on one thread. zenoh: congestion control "
        "Block, as for RECT; `zenoh, attached`: with an attachment of 10 bytes to each published message, as RECT has "
        "one for its number, its time and its publisher. gRPC: tonic; published messages share one stream. MQTT: "
        "3.1.1, QoS 1 in both directions (rumqttc and rumqttd acknowledge every message); a request is a message and "
        "its answer, one at a time. rumqttd does not set TCP_NODELAY; here it is set.",
    ]
