"""Measures the effect of 98 other fleets behind the same stock router on two fleets: with a router without settings,
and with a region, a login and rules for each fleet (config/cloud.json5).

Two fleets are real: a robot and a base station on the simulated air. A load generator stands for the others."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import zenoh
from pairs import carried, room
from robots import Robot, free_port, open_client, rect_settings, wait_until
from room import Room
from routers import Router, own_kb
from table import Table

PDU = 27
ROBOTS_OF_A_FLEET = 15
SUBSCRIBERS, QUERYABLES, TOKENS = 5, 2, 2
#: Without regions, each session of the load generator gets all declarations of all others.
FEW, MANY = 20, 98
PHASE_S = 10.0
MESSAGE = bytes(1000)


@dataclass
class Case:
    title: str
    others: int
    is_template: bool


CASES = [
    Case(f"{FEW} other fleets, a router without settings", FEW, is_template=False),
    Case(f"{FEW} other fleets, `config/cloud.json5`", FEW, is_template=True),
    Case(f"{MANY} other fleets, `config/cloud.json5`", MANY, is_template=True),
]


def run() -> Table:
    table = Table(
        "The effect of other fleets behind the same router on two fleets",
        [
            "router",
            "bytes on the air when the others join",
            "while they publish",
            "while one floods",
            "when they leave",
            "age of a robot's messages during the flood, p99",
            "growth of a robot's router",
            "of a base station",
            "private memory of the shared router",
        ],
    )
    for case in CASES:
        outcome = outcome_of(case)
        table.add(
            case.title,
            *(f"{extra / 1000:.1f} kB" for extra in outcome.extra_bytes),
            f"{outcome.latency_s * 1000:.0f} ms",
            *(f"{kb / 1000:.1f} MB" for kb in (outcome.robot_kb, outcome.base_kb, outcome.cloud_kb)),
        )
        print(f"  {table.rows[-1]}", flush=True)
    of_a_fleet = ROBOTS_OF_A_FLEET * (SUBSCRIBERS + QUERYABLES + TOKENS)
    table.notes = [
        f"The simulated air with link-layer packets of {PDU} bytes (34 kB/s). Each of two fleets has a robot linked to "
        "its base station, whose router connects to the shared one (stock zenohd) over TCP. The bytes are those of "
        "both links, without the ones of idle links in the same time. Memory: heap and stacks; the larger of the two "
        "fleets.",
        f"A load generator joins with a router for each other fleet, which declares for {ROBOTS_OF_A_FLEET} robots: "
        f"{SUBSCRIBERS} subscribers, {QUERYABLES} services and {TOKENS} liveliness tokens each ({of_a_fleet} "
        f"declarations of a fleet). Each fleet publishes {len(MESSAGE)} bytes again and again for {PHASE_S:.0f} s; "
        "then one of them does without a pause, to a program of its own at the shared router; then all leave. In a "
        "second flood, a robot publishes every 0.1 s to a program of its fleet at the shared router.",
    ]
    return table


@dataclass
class Outcome:
    extra_bytes: list[float] = field(default_factory=list)
    latency_s: float = 0.0
    robot_kb: int = 0
    base_kb: int = 0
    cloud_kb: int = 0


class Hall:
    """The shared router, and two fleets with a robot and a base station each."""

    def __init__(self, folder: Path, air: Room, cloud: Router, logins: dict[str, str]) -> None:
        self._folder = folder
        self._air = air
        self.cloud = cloud
        self._logins = logins
        self.bases: list[Robot] = []
        self.robots: list[Robot] = []
        for fleet in ("red", "blue"):
            arguments = self._arguments(fleet)
            named = [*rect_settings({"fleet": fleet, "robot": f"{fleet}-base"}), *arguments, "-e", cloud.endpoint]
            base = air.add_robot(f"{fleet}-base", arguments=tuple(named), dials=[])
            named = [*rect_settings({"fleet": fleet, "robot": f"{fleet}-1"}), *arguments]
            self.bases.append(base)
            self.robots.append(air.add_robot(f"{fleet}-1", arguments=tuple(named), dials=[base]))

    def settings(self, fleet: str) -> dict[str, str]:
        """Returns the settings with which a session of a fleet logs in."""
        if fleet not in self._logins:
            return {}
        return {"transport/auth/usrpwd/user": fleet, "transport/auth/usrpwd/password": self._logins[fleet]}

    def program(self, fleet: str, endpoint: str) -> zenoh.Session:
        return open_client(endpoint, **{key.replace("/", "__"): value for key, value in self.settings(fleet).items()})

    def router_session(self, fleet: str) -> zenoh.Session:
        """Opens a session that is the router of a fleet."""
        config = zenoh.Config()
        settings = {
            "mode": "router",
            "listen/endpoints": [],
            "connect/endpoints": [self.cloud.endpoint],
            "scouting/multicast/enabled": False,
            **self.settings(fleet),
            **({"region_name": fleet} if self._logins else {}),
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    def carried(self) -> int:
        return carried(self._air)

    def memory_kb(self) -> tuple[list[int], list[int], int]:
        """Returns the private memory of the robots' routers, the base stations' and the shared one."""
        of_robots, of_bases = ([own_kb(router.pid()) for router in routers] for routers in (self.robots, self.bases))
        return of_robots, of_bases, self.cloud.own_kb()

    def _arguments(self, fleet: str) -> list[str]:
        if fleet not in self._logins:
            return []
        users = self._folder / f"{fleet}-users"
        users.write_text(f"{fleet}:{self._logins[fleet]}\n")
        given = {"transport/auth/usrpwd/dictionary_file": str(users), "region_name": fleet, **self.settings(fleet)}
        return [part for key, value in given.items() for part in ("--cfg", f"{key}:{json.dumps(value)}")]


@contextmanager
def hall(case: Case) -> Iterator[Hall]:
    fleets = ["red", "blue", *(f"fleet-{number}" for number in range(case.others))]
    with tempfile.TemporaryDirectory() as folder, room(PDU) as air:
        logins, arguments = {}, []
        if case.is_template:
            made = Path(folder) / "cloud"
            tool = os.environ.get("RECT_ROUTER", "rect-router")
            command = [
                tool,
                "init",
                "cloud",
                "--fleets",
                ",".join(fleets),
                "--folder",
                made,
                "--port",
                str(free_port()),
            ]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            lines = (made / "users").read_text().splitlines()
            logins = dict(line.split(":", 1) for line in lines)
            arguments = ["-c", str(made / "robot.json5")]
        with Router("stock zenohd", *arguments) as cloud:
            yield Hall(Path(folder), air, cloud, logins)


def outcome_of(case: Case) -> Outcome:
    outcome = Outcome()
    with hall(case) as made:
        arrived: list[float] = []
        near, far = made.program("red", made.robots[0].endpoint()), made.program("red", made.cloud.endpoint)
        far.declare_subscriber("red/red-1/pose", lambda sample: arrived.append(age_s(sample)))
        publisher = near.declare_publisher("red/red-1/pose", express=True)

        def publish() -> None:
            publisher.put(str(time.monotonic()))

        def is_linked() -> bool:
            publish()
            return bool(arrived)

        wait_until("a robot's message arrives at the shared router", 30, is_linked)
        time.sleep(3)
        before, (robots, bases, _) = made.carried(), made.memory_kb()
        started = time.monotonic()
        time.sleep(PHASE_S)
        idle_bytes_per_s = (made.carried() - before) / (time.monotonic() - started)

        @contextmanager
        def phase() -> Iterator[None]:
            before, started = made.carried(), time.monotonic()
            yield
            idle = idle_bytes_per_s * (time.monotonic() - started)
            outcome.extra_bytes.append(max(0.0, made.carried() - before - idle))

        with phase():
            sessions = {f"fleet-{number}": made.router_session(f"fleet-{number}") for number in range(case.others)}
            declared = [one for fleet, session in sessions.items() for one in declarations(session, fleet)]
            time.sleep(PHASE_S)
        with phase():
            end = time.monotonic() + PHASE_S
            while time.monotonic() < end:
                for fleet, session in sessions.items():
                    session.put(f"{fleet}/robot-0/topic-9", MESSAGE)
        flooding = sessions["fleet-0"]
        with made.program("fleet-0", made.cloud.endpoint) as program:
            program.declare_subscriber("fleet-0/robot-0/flood", lambda _: None)
            flood = flooding.declare_publisher("fleet-0/robot-0/flood")
            with phase():
                end = time.monotonic() + PHASE_S
                while time.monotonic() < end:
                    flood.put(MESSAGE)
            arrived.clear()
            end, due = time.monotonic() + PHASE_S, time.monotonic()
            while time.monotonic() < end:
                flood.put(MESSAGE)
                if time.monotonic() > due:
                    due += 0.1
                    publish()
            time.sleep(1)
            outcome.latency_s = sorted(arrived)[int(0.99 * len(arrived))]
        now_robots, now_bases, outcome.cloud_kb = made.memory_kb()
        outcome.robot_kb = max(now - before for now, before in zip(now_robots, robots, strict=True))
        outcome.base_kb = max(now - before for now, before in zip(now_bases, bases, strict=True))
        declared.clear()
        with phase():
            for session in sessions.values():
                session.close()
            time.sleep(PHASE_S)
        near.close()
        far.close()
    return outcome


def declarations(session: zenoh.Session, fleet: str) -> list[object]:
    """Declares what the robots of a fleet declare."""
    made: list[object] = []
    for robot in range(ROBOTS_OF_A_FLEET):
        own = f"{fleet}/robot-{robot}"
        made += [session.declare_subscriber(f"{own}/topic-{n}", lambda _: None) for n in range(SUBSCRIBERS)]
        made += [session.declare_queryable(f"{own}/service-{n}", lambda _: None) for n in range(QUERYABLES)]
        made += [session.liveliness().declare_token(f"{own}/@rect/token-{n}") for n in range(TOKENS)]
    return made


def age_s(sample: zenoh.Sample) -> float:
    return time.monotonic() - float(sample.payload.to_string())
