"""Logs over Bluetooth, on the simulated air, and over a TCP link slowed to its rate: urgent messages beside a program
that logs 10,000 lines a second, the last lines of a crash, and the memory of the program."""

import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import rect
from comparison import rounds
from pairs import linked_robots, room
from state import RATE_BYTES_PER_S, routers
from table import Table
from traffic import percentile

#: How many lines a second the loud program logs, and for how long.
LINES_PER_S, FOR_S = 10_000, float(rounds(20))
#: Urgent messages a second.
URGENT_PER_S = 20
#: The payload of the link-layer packets in bytes: with 27, the air carries 34 kB/s.
PDU = 27
CRASHES = rounds(5)
TIMEOUT_S = 30.0

LOUD = """
import sys, time
import rect

per_s, for_s, router = float(sys.argv[1]), float(sys.argv[2]), sys.argv[3]
with rect.connect("wombat-1", router=router, program="loud") as robot:
    print("ready", flush=True)
    sys.stdin.readline()
    began, number, longest = time.monotonic(), 0, 0.0
    while (passed := time.monotonic() - began) < for_s:
        while number < passed * per_s:
            called = time.perf_counter()
            text = f"line {number} of a loud program that reports its position ({number % 97}, {number % 89})"
            robot.log(text, level="debug")
            longest = max(longest, time.perf_counter() - called)
            number += 1
        time.sleep(0.001)
    resident = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("RssAnon"))
    print(number, longest, resident, flush=True)
    sys.stdin.readline()
"""

CRASH = """
def a(depth):
    return a(depth - 1) if depth else {}["elbow"]
print("moving", flush=True)
a(40)
"""


def urgent_ages(laptop: rect.Robot, robot: rect.Robot, for_s: float) -> list[float]:
    """Publishes urgent messages, and returns how long each took, in ms."""
    ages: list[float] = []

    def on_beat(message: rect.Message) -> None:
        ages.append((time.monotonic() - message.value) * 1000)

    with laptop.subscribe("wombat-1/beat", callback=on_beat):
        time.sleep(0.5)
        until = time.monotonic() + for_s
        while time.monotonic() < until:
            robot.publish("beat", time.monotonic(), urgency="urgent")
            time.sleep(1 / URGENT_PER_S)
        time.sleep(0.5)
    return ages


def loud(near: str, far: str, follows: bool) -> tuple[list[str], str]:
    """Measures urgent messages beside the loud program. `follows`: the laptop follows its lines meanwhile."""
    with ExitStack() as stack:
        robot = stack.enter_context(rect.connect("wombat-1", router=near))
        laptop = stack.enter_context(rect.connect("wombat-2", router=far))
        laptop.wait_for_peer("wombat-1", TIMEOUT_S)
        program = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-c", LOUD, str(LINES_PER_S), str(FOR_S), near],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        )
        assert program.stdin and program.stdout
        program.stdout.readline()
        numbers: list[int] = []
        if follows:
            logs = laptop.logs("wombat-1", follow=True, last=0)

            def follow() -> None:
                with suppress(rect.Closed):
                    numbers.extend(line.number for line in logs)

            threading.Thread(target=follow, daemon=True).start()
            time.sleep(1)
        program.stdin.write("\n")
        program.stdin.flush()
        ages = urgent_ages(laptop, robot, FOR_S)
        logged, longest, resident = program.stdout.readline().split()
        kept = sum(1 for _ in robot.logs("wombat-1", last=10_000))
        program.stdin.close()
        got = f"{len(numbers):,} of {int(logged):,}" if follows else "-"
        row = [f"{percentile(ages, 0.5):.0f}, {percentile(ages, 0.99):.0f} ms", got, f"{kept:,}"]
        return row, f"{float(longest) * 1000:.1f} ms; {int(resident) / 1000:.1f} MB"


def crash(near: str, far: str) -> float:
    """Returns how long after the end of a program its last line is on the laptop, in seconds."""
    with tempfile.TemporaryDirectory() as folder, rect.connect("wombat-2", router=far) as laptop:
        laptop.wait_for_peer("wombat-1", TIMEOUT_S)
        script = Path(folder) / "crash.py"
        script.write_text(CRASH)
        with laptop.logs("wombat-1", program="crash", follow=True, last=0) as logs:
            time.sleep(1)
            command = [
                os.environ["RECT_TOOL"],
                "run",
                "--as",
                "wombat-1",
                "--router",
                near,
                "--",
                sys.executable,
                str(script),
            ]
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as running:
                assert running.stderr
                for text in running.stderr:
                    if b"KeyError" in text:
                        break
                ended = time.monotonic()
                for line in logs:
                    if line.logger == "rect run" and "failed" in line.text:
                        return time.monotonic() - ended
    raise AssertionError("the log ended")


@contextmanager
def over_bluetooth() -> Iterator[tuple[str, str]]:
    with room(PDU) as air:
        yield linked_robots(air)


@contextmanager
def over_tcp() -> Iterator[tuple[str, str]]:
    with routers() as (_shaper, near, far):
        yield near, far


def run() -> Table:
    columns = ["", "urgent p50, p99", "lines on the laptop", "lines kept", "end of a crash"]
    table = Table(f"{LINES_PER_S:,} lines a second over a link of {RATE_BYTES_PER_S / 1000:.0f} kB/s", columns)
    costs = []
    for link, endpoints in {"Bluetooth": over_bluetooth, "TCP": over_tcp}.items():
        with endpoints() as (near, far):
            with rect.connect("wombat-1", router=near) as robot, rect.connect("wombat-2", router=far) as laptop:
                laptop.wait_for_peer("wombat-1", TIMEOUT_S)
                ages = urgent_ages(laptop, robot, FOR_S)
            times = [crash(near, far) for _ in range(CRASHES)]
            quiet = f"{percentile(ages, 0.5):.0f}, {percentile(ages, 0.99):.0f} ms"
            ends = f"{statistics.median(times):.2f} s, at most {max(times):.2f} s"
            table.add(f"{link}: nobody logs", quiet, "-", "-", ends)
            row, _ = loud(near, far, follows=False)
            table.add(f"{link}: a program logs, nobody reads", *row, "-")
            row, cost = loud(near, far, follows=True)
            table.add(f"{link}: a program logs, the laptop follows all lines", *row, "-")
            costs.append(cost)
    table.notes = [
        f"The longest call of `robot.log` in Python, and the program's private memory at the end: {costs[0]}.",
        f"The end of a crash: from the last line of a stack trace of 40 frames, under `rect run`, until the laptop has "
        f"the line that says how the program ended; median of {CRASHES}.",
        f"Lines of about 90 bytes for {FOR_S:.0f} s, beside {URGENT_PER_S} urgent messages a second of the robot. "
        "A follower gets 8 kB a second, and learns that lines are missing; the router keeps the last 1,000. "
        "Bluetooth is the simulated air, with packets of 27 bytes and a connection interval of 30 ms.",
    ]
    return table
