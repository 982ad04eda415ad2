"""Runs ten robots for hours, with traffic, faults and robots that come and go, and checks that nothing is lost without
a reason and that memory and file descriptors stay the same.

usage: make soak [HOURS=2]

Each robot's program publishes for the others, sends urgent messages, requests and transfers. Every cycle begins with a
fault: the radio is cut, a router stands still, a router is killed, or a program ends. After it, everything must be as
before: what is missing then is reported as lost. The results are written to benches/results/soak.md and
docs/pictures/soak.svg."""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import random
import statistics
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib

matplotlib.use("svg")
from matplotlib import pyplot

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "examples" / "demo"), str(ROOT / "benches")]

import rect  # noqa: E402
from robots import Robot, rect_settings, wait_until  # noqa: E402
from room import Room  # noqa: E402
from routers import own_kb, status  # noqa: E402
from table import Table  # noqa: E402

ROBOTS = 10
#: The routers of the last robots are killed now and then; the others run until the end.
KILLED = 3
#: Each robot dials as many of those before it.
DIALS = 2
STATE_EVERY_S, URGENT_EVERY_S, REQUEST_EVERY_S, TRANSFER_EVERY_S = 0.2, 1.0, 5.0, 60.0
TRANSFER_BYTES = 50_000
CYCLE_S = 120.0
#: How long after a fault everything must be as before.
RECOVERY_S = 60.0
SAMPLE_EVERY_S = 10.0
#: The part of the time after which memory is compared: caches and queues have reached their sizes.
WARM_UP = 0.2
#: The name of the process of all programs in the samples.
PROGRAMS = "programs"
#: The growth of memory that is not called one, per hour.
MAX_GROWTH_KB = 200
PICTURE = ROOT / "docs" / "pictures" / "soak.svg"
RESULT = ROOT / "benches" / "results" / "soak.md"

matplotlib.rcParams["svg.fonttype"] = "none"
matplotlib.rcParams["svg.hashsalt"] = "rect"


@dataclass
class Counts:
    """The numbers of messages, requests and transfers."""

    sent: Counter[str] = field(default_factory=Counter)
    arrived: Counter[str] = field(default_factory=Counter)
    #: The ones that are missing because of a fault.
    excused: Counter[str] = field(default_factory=Counter)
    #: The ones that are missing without one.
    lost: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)


@dataclass
class Sample:
    at_s: float
    memory_kb: int
    descriptors: int
    threads: int


class Calm:
    """The faults, and whether the last one was long enough ago."""

    def __init__(self) -> None:
        self._disturbed_until = 0.0
        self.faults: Counter[str] = Counter()

    def begin(self, fault: str) -> None:
        self.faults[fault] += 1
        self._disturbed_until = float("inf")

    def end(self) -> None:
        self._disturbed_until = time.monotonic() + RECOVERY_S

    def since(self, started: float) -> bool:
        return started > self._disturbed_until

    def age(self) -> str:
        """How long nothing has been excused."""
        return f"{time.monotonic() - self._disturbed_until:.1f} s into a calm time"


class Program:
    """The program of a robot, whose threads send until it is closed."""

    def __init__(self, router: Robot, number: int, calm: Calm, counts: Counts) -> None:
        self.name = router.name
        self._next = f"wombat-{number % ROBOTS + 1}"
        self._calm = calm
        self._counts = counts
        self._ends = threading.Event()
        self.robot = rect.connect(self.name, router=router.endpoint())
        self._handles = [
            self.robot.subscribe(f"{self._next}/state", callback=self._on_message),
            self.robot.subscribe(f"{self._next}/stop", callback=self._on_message),
            self.robot.serve("sum", lambda request: sum(request.value)),
        ]
        self._transfers = self.robot.receive_transfers("*/part")
        jobs = {
            "state": (STATE_EVERY_S, self._state),
            "stop": (URGENT_EVERY_S, self._stop),
            "request": (REQUEST_EVERY_S, self._request),
            "transfer": (TRANSFER_EVERY_S, self._transfer),
        }
        self._threads = [threading.Thread(target=self._every, args=job) for job in jobs.values()]
        self._threads.append(threading.Thread(target=self._receive))
        self._publishers = {
            "state": self.robot.publisher("state"),
            "stop": self.robot.publisher("stop", urgency="urgent"),
        }
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._ends.set()
        self.robot.close()
        for thread in self._threads:
            thread.join()

    def _every(self, interval_s: float, act: Callable[[], None]) -> None:
        due = time.monotonic() + random.uniform(0, interval_s)
        while not self._ends.wait(max(0.0, due - time.monotonic())):
            due += interval_s
            # Nothing is sent while the program ends, or its router is away.
            with suppress(rect.RectError):
                act()

    def _count(self, what: str, counter: Counter[str], number: int = 1) -> None:
        with self._counts.lock:
            counter[what] += number

    def _miss(self, what: str, since: float, number: int, example: str) -> None:
        is_calm = self._calm.since(since)
        self._count(what, self._counts.lost if is_calm else self._counts.excused, number)
        if is_calm:
            example += f" ({self._calm.age()})"
            print(f"  lost: {example}", flush=True)
            self._counts.examples.append(example)

    def _state(self) -> None:
        self._publishers["state"].publish({"at": time.monotonic(), "pose": [1.25, 2.5, 0.75], "battery": 87})
        self._count("state", self._counts.sent)

    def _stop(self) -> None:
        self._publishers["stop"].publish({"at": time.monotonic()})
        self._count("stop", self._counts.sent)

    def _on_message(self, message: rect.Message) -> None:
        self._count(message.topic, self._counts.arrived)
        if message.missed:
            # The ones before this one were sent up to two intervals earlier.
            since = message.value["at"] - message.missed * URGENT_EVERY_S
            example = f"{self.name} missed {message.missed} of {message.sender}/{message.topic}"
            self._miss(message.topic, since, message.missed, example)

    def _request(self) -> None:
        started = time.monotonic()
        numbers = [random.randrange(100) for _ in range(3)]
        self._count("request", self._counts.sent)
        try:
            answer = self.robot.request(self._next, "sum", numbers, timeout=5).value
            assert answer == sum(numbers), (answer, numbers)
            self._count("request", self._counts.arrived)
        except (rect.TimedOut, rect.NoService) as error:
            self._miss("request", started, 1, f"{self.name}: {error}")

    def _transfer(self) -> None:
        data = random.randbytes(TRANSFER_BYTES)
        name = hashlib.sha256(data).hexdigest()
        self._count("transfer", self._counts.sent)
        started = time.monotonic()
        try:
            # It continues after faults, so it is missing only if one of the programs ends.
            self.robot.transfer(self._next, "part", data, name=name)
        except rect.Closed:
            self._count("transfer", self._counts.excused)
        except rect.RectError as error:
            self._miss("transfer", started, 1, f"{self.name}: {error}")

    def _receive(self) -> None:
        for received in self._transfers:
            if received.error is None and hashlib.sha256(received.content).hexdigest() == received.name:
                self._count("transfer", self._counts.arrived)


def sample(pid: int, started: float) -> Sample:
    descriptors = len(os.listdir(f"/proc/{pid}/fd"))
    return Sample(time.monotonic() - started, own_kb(pid), descriptors, status(pid, "Threads"))


class Soak:
    def __init__(self, room: Room, hours: float) -> None:
        self._room = room
        self._ends_at = time.monotonic() + hours * 3600
        self.calm, self.counts = Calm(), Counts()
        self.samples: dict[str, list[Sample]] = {}
        self.recoveries: list[float] = []
        self._routers: list[Robot] = []
        for number in range(1, ROBOTS + 1):
            name = f"wombat-{number}"
            settings = tuple(rect_settings({"robot": name}))
            self._routers.append(room.add_robot(name, arguments=settings, dials=self._routers[-DIALS:]))
        self._programs = {
            router.name: Program(router, number, self.calm, self.counts)
            for number, router in enumerate(self._routers, 1)
        }

    def run(self) -> None:
        self.calm.begin("start")
        self._wait_until_recovered()
        started = time.monotonic()
        finished = threading.Event()
        sampler = threading.Thread(target=self._sample, args=(started, finished))
        sampler.start()
        faults = itertools.cycle([self._cut, self._stand_still, self._kill, self._restart])
        try:
            while time.monotonic() < self._ends_at:
                cycle_ends = time.monotonic() + CYCLE_S
                next(faults)()
                self._wait_until_recovered()
                time.sleep(max(0.0, cycle_ends - time.monotonic()))
                minutes = (time.monotonic() - started) / 60
                print(f"  {minutes:.0f} min: {sum(self.counts.lost.values())} lost", flush=True)
        finally:
            finished.set()
            sampler.join()
            for program in self._programs.values():
                program.close()

    def _wait_until_recovered(self) -> None:
        """Waits until each program reaches all others; then nothing may be lost any more, after some time."""
        names = set(self._programs)

        def is_whole() -> bool:
            with suppress(rect.RectError):
                return all(set(program.robot.peers()) >= names - {name} for name, program in self._programs.items())
            return False

        self.recoveries.append(wait_until("all robots reach each other", RECOVERY_S, is_whole))
        self.calm.end()

    def _sample(self, started: float, finished: threading.Event) -> None:
        steady = {router.name: router.pid() for router in self._routers[: ROBOTS - KILLED]}
        steady[PROGRAMS] = os.getpid()
        while not finished.wait(SAMPLE_EVERY_S):
            for name, pid in steady.items():
                self.samples.setdefault(name, []).append(sample(pid, started))

    def _cut(self) -> None:
        self.calm.begin("the radio was cut for 3 s")
        self._room.cut()
        time.sleep(3)
        self._room.restore()

    def _stand_still(self) -> None:
        self.calm.begin("a router stood still for 5 s")
        router = random.choice(self._routers)
        router.freeze()
        time.sleep(5)
        router.thaw()

    def _kill(self) -> None:
        self.calm.begin("a router was killed")
        router = random.choice(self._routers[ROBOTS - KILLED :])
        router.kill()
        time.sleep(2)
        router.start()

    def _restart(self) -> None:
        self.calm.begin("a program ended and began again")
        router = random.choice(self._routers)
        self._programs[router.name].close()
        number = self._routers.index(router) + 1
        self._programs[router.name] = Program(router, number, self.calm, self.counts)


def growth_kb(samples: list[Sample]) -> float:
    """Returns the growth of the memory per hour, a straight line through the samples after the first part."""
    later = [one for one in samples if one.at_s > samples[-1].at_s * WARM_UP]
    line = statistics.linear_regression([one.at_s / 3600 for one in later], [one.memory_kb for one in later])
    return line.slope


def table_of(soak: Soak, hours: float) -> Table:
    counts = soak.counts
    columns = ["what", "sent", "arrived", "missing in a fault", "lost", "outcome"]
    table = Table(f"Ten robots for {hours:g} hours, with faults", columns)
    for what, text in [
        ("state", "messages, 5 per second"),
        ("stop", "urgent messages, 1 per second"),
        ("request", "requests"),
        ("transfer", f"transfers of {TRANSFER_BYTES // 1000} kB"),
    ]:
        lost = counts.lost[what]
        table.add(
            text, counts.sent[what], counts.arrived[what], counts.excused[what], lost, "ok" if lost == 0 else "lost"
        )
    faults = [f"{count} times {fault}" for fault, count in soak.calm.faults.items() if fault != "start"]
    table.notes = [
        memory_note(soak.samples),
        f"Faults, one every two minutes: {', '.join(faults)}. All robots reached each other again within "
        f"{max(soak.recoveries[1:]):.0f} s. Messages that are missing until {RECOVERY_S:.0f} s after that count as "
        "missing in a fault.",
        *(f"Lost: {example}." for example in counts.examples[:20]),
    ]
    return table


def memory_note(samples: dict[str, list[Sample]]) -> str:
    growth = {name: growth_kb(of_process) for name, of_process in samples.items()}
    descriptors = [of_process[-1].descriptors - of_process[0].descriptors for of_process in samples.values()]
    routers = [name for name in samples if name != PROGRAMS]
    most = max(routers, key=growth.__getitem__)
    memory_mb = {name: of_process[-1].memory_kb / 1000 for name, of_process in samples.items()}
    outcome = "ok" if growth[most] < MAX_GROWTH_KB else "it grows"
    return (
        f"Routers on the simulated air (desk), each of which dials {DIALS} others. Of the {len(routers)} that were not "
        f"killed, the one that grew most had {memory_mb[most]:.1f} MB of private memory at the end and grew "
        f"by {growth[most]:.0f} kB per hour after the first fifth of the time ({outcome}: {MAX_GROWTH_KB} kB are "
        f"allowed). The process of the ten programs had {memory_mb[PROGRAMS]:.1f} MB and grew by "
        f"{growth[PROGRAMS]:.0f} kB per hour. File descriptors at the end, compared with the beginning: "
        f"{min(descriptors):+d} to {max(descriptors):+d}."
    )


def draw(soak: Soak) -> None:
    figure, panels = pyplot.subplots(2, 1, sharex=True, figsize=(8, 5))
    for name, samples in soak.samples.items():
        style = {"color": "black", "linestyle": "--", "label": "the ten programs"} if name == PROGRAMS else {}
        minutes = [one.at_s / 60 for one in samples]
        panels[0].plot(minutes, [one.memory_kb / 1000 for one in samples], linewidth=1, **style)
        panels[1].plot(minutes, [one.descriptors for one in samples], linewidth=1, **style)
    panels[0].set_ylabel("private memory (MB)")
    panels[1].set_ylabel("file descriptors")
    panels[1].set_xlabel("minutes")
    for panel in panels:
        panel.set_ylim(bottom=0)
        panel.grid(alpha=0.3)
    panels[0].legend()
    figure.set_layout_engine("constrained")
    figure.savefig(PICTURE, metadata={"Date": None})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=2.0, help="how long (default: 2)")
    hours = parser.parse_args().hours
    with Room("desk") as room:
        soak = Soak(room, hours)
        soak.run()
    table = table_of(soak, hours)
    print(table.text())
    RESULT.write_text(table.markdown(f"make soak HOURS={hours:g}"))
    draw(soak)
    return 0 if sum(soak.counts.lost.values()) == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
