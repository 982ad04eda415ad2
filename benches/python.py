"""Compares the Python package with plain eclipse-zenoh: two programs, linked directly over TCP, do the same
alternately."""

import json
import os
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rect
import zenoh
from comparison import IS_STEADY, alternate, ratio, rounds
from table import Table

ROUNDS = rounds(15)
PINGS = 300
FRAMES = 100
#: The number of messages for the memory figure: 10 million, or `RECT_BENCH_MESSAGES`.
MESSAGES = int(os.environ.get("RECT_BENCH_MESSAGES", 20_000 if IS_STEADY else 10_000_000))
READING = {"robot": "wombat-1", "angle_deg": 12.5, "volt": 7.2, "ok": True}
WAIT_S = 30


@dataclass
class Reading:
    """The type of `READING`."""

    robot: str
    angle_deg: float
    volt: float
    ok: bool


Call = Callable[[], object]


def run() -> Table:
    table = Table(
        "The Python package compared with plain eclipse-zenoh 1.10.2", ["what", "rect", "zenoh", "rect to zenoh"]
    )
    size = len(json.dumps(READING, separators=(",", ":")))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-1", listen=[endpoint]) as robot, other(endpoint):
        while not robot.peers():
            time.sleep(0.05)
        pings = [Pings(rect_ping(robot, "")), Pings(plain_ping(robot.zenoh))]
        compare(table, f"publish to callback and back, {size} B of JSON, p50, us", *pings)
        typed = Pings(rect_ping(robot, "typed-", Reading))
        compare(table, "the same with a dataclass (in place of rect) and without (in place of zenoh)", typed, pings[0])
        compare(table, f"request and reply, {size} B of JSON, p50, us", rect_ask(robot), plain_ask(robot.zenoh))
        frame = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)
        compare(table, "640x480 frames, raw, frames/s", rect_frames(robot, frame), plain_frames(robot.zenoh, frame))
    imported = [import_s("rect"), import_s("zenoh")]
    table.add("import, s", *(f"{seconds:.3f}" for seconds in imported), f"{imported[0] / imported[1]:.2f}")
    begin, end = memory_mb()
    table.add(f"memory of a subscriber after {MESSAGES:,} messages, MB", f"{end:.1f} ({begin:.1f} before)", "", "")
    table.notes = [
        f"Medians of {ROUNDS} alternating rounds of {PINGS} pings or {FRAMES} frames each; the ratio is the median of "
        "the rounds' ratios, with the range of the middle half in brackets. Plain programs use `json` for the same "
        "values. Target: latency at most 1.15, import under 0.3 s, constant memory.",
    ]
    return table


def compare(table: Table, what: str, ours: Callable[[], float], stock: Callable[[], float]) -> None:
    found = alternate(ROUNDS, ours, stock)
    medians = [f"{statistics.median(rounds):,.0f}" for rounds in found]
    table.add(what, *medians, ratio(*found))
    print(f"  {what}: {medians[0]} and {medians[1]}, {ratio(*found)}", flush=True)


class Pings:
    """Measures round trips of a message and its echo."""

    def __init__(self, begin: Callable[[Call], Call]) -> None:
        self._back = threading.Event()
        self._ping = begin(self._back.set)
        # The subscriptions of both directions take a moment.
        while not self._back.wait(0.2):
            self._ping()

    def __call__(self) -> float:
        took = []
        for _ in range(PINGS):
            self._back.clear()
            started = time.perf_counter()
            self._ping()
            assert self._back.wait(WAIT_S)
            took.append(time.perf_counter() - started)
        return statistics.median(took) * 1e6


def rect_ping(robot: rect.Robot, topics: str, type: type | None = None) -> Callable[[Call], Call]:
    def begin(back: Call) -> Call:
        def on_pong(message: rect.Message) -> None:
            assert message.value
            back()

        robot.subscribe(f"wombat-2/{topics}pong", type, callback=on_pong)
        return lambda: robot.publish(f"{topics}ping", READING)

    return begin


def plain_ping(session: zenoh.Session) -> Callable[[Call], Call]:
    publisher = session.declare_publisher("plain/ping", encoding="application/json")

    def begin(back: Call) -> Call:
        def on_pong(sample: zenoh.Sample) -> None:
            assert json.loads(sample.payload.to_bytes())
            back()

        session.declare_subscriber("plain/pong", on_pong)
        return lambda: publisher.put(json.dumps(READING, separators=(",", ":")))

    return begin


def rect_ask(robot: rect.Robot) -> Callable[[], float]:
    def ask() -> None:
        assert robot.request("wombat-2", "echo", READING, timeout=WAIT_S).value

    return lambda: p50_us(ask)


def plain_ask(session: zenoh.Session) -> Callable[[], float]:
    def ask() -> None:
        asked = session.get("plain/echo", payload=json.dumps(READING, separators=(",", ":")), timeout=WAIT_S)
        assert [json.loads(reply.ok.payload.to_bytes()) for reply in asked]

    return lambda: p50_us(ask)


def p50_us(call: Call) -> float:
    took = []
    for _ in range(PINGS):
        started = time.perf_counter()
        call()
        took.append(time.perf_counter() - started)
    return statistics.median(took) * 1e6


def rect_frames(robot: rect.Robot, frame: np.ndarray) -> Callable[[], float]:
    done = threading.Event()
    robot.subscribe("wombat-2/counted", callback=lambda message: done.set())
    return lambda: frames_per_s(done, lambda: robot.publish("frame", rect.Picture(frame)))


def plain_frames(session: zenoh.Session, frame: np.ndarray) -> Callable[[], float]:
    done = threading.Event()
    block = zenoh.CongestionControl.BLOCK
    publisher = session.declare_publisher("plain/frame", congestion_control=block)
    session.declare_subscriber("plain/counted", lambda sample: done.set())
    return lambda: frames_per_s(done, lambda: publisher.put(frame.tobytes()))


def frames_per_s(done: threading.Event, send: Call) -> float:
    done.clear()
    started = time.perf_counter()
    for _ in range(FRAMES):
        send()
    assert done.wait(WAIT_S)
    return FRAMES / (time.perf_counter() - started)


def import_s(module: str) -> float:
    code = f"import time; began = time.perf_counter(); import {module}; print(time.perf_counter() - began)"
    times = [float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(7)]
    return statistics.median(times)


def memory_mb() -> tuple[float, float]:
    """Returns the memory of a program that receives `MESSAGES`: after the first hundredth of them, and after all."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-1", listen=[endpoint]) as robot:
        command = [sys.executable, __file__, "count", endpoint, str(MESSAGES)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as counting:
            assert counting.stdout is not None
            counting.stdout.readline()
            while not robot.peers():
                time.sleep(0.05)
            session = robot._session
            while counting.poll() is None:
                robot.publish("count", READING)
                if session.is_closed:
                    break
            begin, end = counting.stdout.read().split()
    return float(begin), float(end)


def other(endpoint: str) -> subprocess.Popen[bytes]:
    """Starts the other program, which ends when its input is closed, at the end of the `with` block."""
    return subprocess.Popen([sys.executable, __file__, "echo", endpoint], stdin=subprocess.PIPE)


def echo(endpoint: str) -> None:
    """Runs the other program, which echoes messages of both kinds until its input ends."""
    with rect.connect("wombat-2", endpoints=[endpoint]) as robot:
        session = robot.zenoh
        robot.subscribe("wombat-1/ping", callback=lambda message: robot.publish("pong", message.value))
        robot.subscribe("wombat-1/typed-ping", callback=lambda message: robot.publish("typed-pong", message.value))
        robot.serve("echo", lambda request: request.value)
        publisher = session.declare_publisher("plain/pong", encoding="application/json")

        def on_ping(sample: zenoh.Sample) -> None:
            publisher.put(json.dumps(json.loads(sample.payload.to_bytes()), separators=(",", ":")))

        def on_query(query: zenoh.Query) -> None:
            with query:
                value = json.loads(query.payload.to_bytes())
                query.reply("plain/echo", json.dumps(value, separators=(",", ":")))

        kept = [session.declare_subscriber("plain/ping", on_ping), session.declare_queryable("plain/echo", on_query)]
        counts = {"rect": 0, "plain": 0}

        def on_frame(message: rect.Message) -> None:
            counts["rect"] += len(message.payload.bytes) > 0
            if counts["rect"] % FRAMES == 0:
                robot.publish("counted", 1)

        def on_plain_frame(sample: zenoh.Sample) -> None:
            counts["plain"] += len(sample.payload.to_bytes()) > 0
            if counts["plain"] % FRAMES == 0:
                session.put("plain/counted", b"1")

        robot.subscribe("wombat-1/frame", callback=on_frame, when_full="block")
        kept.append(session.declare_subscriber("plain/frame", on_plain_frame))
        sys.stdin.read()
        del kept


def count(endpoint: str, messages: int) -> None:
    """Receives `messages` messages, and prints the memory after a hundredth of them and at the end."""
    with rect.connect("wombat-2", endpoints=[endpoint]) as robot:
        received = robot.subscribe("wombat-1/count", when_full="block")
        print("ready", flush=True)
        for n, _ in enumerate(received):
            if n in (messages // 100, messages):
                print(rss_mb(), flush=True)
            if n == messages:
                return


def rss_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1000


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    if sys.argv[1] == "echo":
        echo(sys.argv[2])
    else:
        count(sys.argv[2], int(sys.argv[3]))
