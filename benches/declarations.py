"""Measures the effect of a local stock program with very many declarations on two routers and the slow link between
them."""

import multiprocessing
import os
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

import zenoh
from pairs import carried, room
from robots import Robot, wait_until
from room import Room, wait_for_link, wait_for_no_link
from routers import own_kb
from table import Table
from zenoh import CongestionControl, Priority

PDU = 27
LIMIT_S = 180
PERIOD_S = 0.5
#: How long a new link is measured.
LINK_UP_S = 10
#: The air counts as silent if it carries fewer bytes than this in PERIOD_S: keep-alives, and the measured message.
SILENCE_BYTES = 400


@dataclass
class Case:
    title: str
    count: int
    declare: Callable[[zenoh.Session, int], object]
    is_link_up: bool = False
    """Whether the declarations are made before the link is established, by four sessions."""


def queryable(session: zenoh.Session, number: int) -> object:
    return session.declare_queryable(f"rect/wombat-1/service/{number:06}", lambda _: None)


def subscriber(session: zenoh.Session, number: int) -> object:
    return session.declare_subscriber(f"rect/wombat-2/topic/{number:06}", lambda _: None)


def overlapping(session: zenoh.Session, number: int) -> object:
    return session.declare_subscriber(f"rect/**/{number:06}/**", lambda _: None)


def token(session: zenoh.Session, number: int) -> object:
    return session.liveliness().declare_token(f"rect/wombat-1/token/{number:06}")


def long_token(session: zenoh.Session, number: int) -> object:
    return session.liveliness().declare_token(f"rect/wombat-1/{'token-' * 28}{number:08}")


def of_a_robot(session: zenoh.Session, number: int) -> object:
    """Declares one of the four things that each of the four programs of each of 15 robots declares."""
    key = f"rect/wombat-{number // 16}/program-{number // 4 % 4}"
    declared: list[Callable[[], object]] = [
        lambda: session.liveliness().declare_token(f"{key}/alive"),
        lambda: session.declare_queryable(f"{key}/battery", lambda _: None),
        lambda: session.declare_subscriber(f"{key}/drive", lambda _: None),
        lambda: session.declare_subscriber(f"rect/*/program-{number // 4 % 4}/{number // 16}", lambda _: None),
    ]
    return declared[number % 4]()


CASES = [
    Case("1000 queryables", 1_000, queryable),
    Case("1000 subscribers", 1_000, subscriber),
    Case("1000 subscribers to overlapping wildcards (`rect/**/<number>/**`)", 1_000, overlapping),
    Case("2500 liveliness tokens with keys of 190 bytes", 2_500, long_token),
    Case("10,000 liveliness tokens", 10_000, token),
    Case("link-up with 15 robots of 4 programs with 4 declarations", 240, of_a_robot, is_link_up=True),
]


@dataclass
class Outcome:
    declared: int = 0
    took_s: float = 0.0
    worst_s: float = 0.0
    carried_bytes: int = 0
    grew_kb: list[int] = field(default_factory=list)


def run() -> Table:
    table = Table(
        "Effect of one program's many declarations on two routers and a slow link",
        [
            "declarations",
            "sent to the router within the limit",
            "time until the air is silent",
            "latency of another program's urgent messages, max",
            "bytes on the air",
            "memory of the two routers",
        ],
    )
    for case in CASES:
        outcome = in_a_process(case)
        table.add(
            case.title,
            outcome.declared,
            f"{outcome.took_s:.0f} s" if outcome.took_s < LIMIT_S else f"over {LIMIT_S} s",
            f"{outcome.worst_s:.1f} s",
            f"{outcome.carried_bytes / 1000:.0f} kB",
            " and ".join(f"+{kb / 1000:.1f} MB" for kb in outcome.grew_kb),
        )
        print(f"  {table.rows[-1]}", flush=True)
    table.notes = [
        f"The simulated air as in `urgent`, with link-layer packets of {PDU} bytes (34 kB/s). A stock eclipse-zenoh "
        f"client of one robot declares as fast as it can, for {LIMIT_S} s at most. Another client of the same robot "
        "publishes urgent messages (`REAL_TIME`), each when the previous one has arrived. At a link-up, it publishes "
        f"one every 20 ms for {LINK_UP_S} s. Memory: heap and stacks.",
    ]
    return table


def in_a_process(case: Case) -> Outcome:
    """Runs a case in a separate process, which exits without waiting for the routers to undeclare everything."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs, CASES.index(case)))
    process.start()
    theirs.close()
    outcome = ours.recv()
    process.join()
    return outcome


def work(pipe: Connection, number: int) -> None:
    try:
        pipe.send(outcome_of(CASES[number]))
    finally:
        os._exit(0)


def outcome_of(case: Case) -> Outcome:
    with room(PDU) as air:
        one, two = air.add_robot("wombat-1"), air.add_robot("wombat-2")
        wait_for_link(one, two)
        if case.is_link_up:
            return at_link_up(case, air, one, two)
        declaring, urgent = one.session(), Urgent(one.session(), two.session())
        outcome, is_finished, kept = Outcome(), threading.Event(), []

        def declare() -> None:
            for number in range(case.count):
                if is_finished.is_set():
                    break
                kept.append(case.declare(declaring, number))
            is_finished.set()

        memory_kb = [own_kb(robot.pid()) for robot in (one, two)]
        before, started = carried(air), time.monotonic()
        threading.Thread(target=declare, daemon=True).start()
        while (elapsed := time.monotonic() - started) < LIMIT_S:
            outcome.worst_s = max(outcome.worst_s, urgent.put(LIMIT_S))
            latest = carried(air)
            time.sleep(PERIOD_S)
            if is_finished.is_set() and carried(air) - latest < SILENCE_BYTES:
                break
        is_finished.set()
        outcome.declared, outcome.took_s = len(kept), elapsed
        outcome.carried_bytes = carried(air) - before
        outcome.grew_kb = [own_kb(robot.pid()) - kb for robot, kb in zip((one, two), memory_kb, strict=True)]
        return outcome


def at_link_up(case: Case, air: Room, one: Robot, two: Robot) -> Outcome:
    """Measures how old urgent messages are that arrive while a link is new."""
    sessions, outcome, ages_s = [one.session() for _ in range(4)], Outcome(declared=case.count), []
    kept = [case.declare(sessions[number % 4], number) for number in range(case.count)]
    here, there = one.session(), two.session()

    def on_message(sample: zenoh.Sample) -> None:
        ages_s.append(time.monotonic() - struct.unpack("<d", sample.payload.to_bytes())[0])

    kept.append(there.declare_subscriber("rect/wombat-1/stop", on_message))
    publisher = here.declare_publisher("rect/wombat-1/stop", priority=Priority.REAL_TIME, express=True)
    air.cut()
    wait_for_no_link(one, two)
    ages_s.clear()
    before, memory_kb = carried(air), [own_kb(robot.pid()) for robot in (one, two)]
    air.restore()
    started = time.monotonic()
    while not ages_s or time.monotonic() - started < LINK_UP_S:
        publisher.put(struct.pack("<d", time.monotonic()))
        time.sleep(0.02)
    outcome.took_s, outcome.worst_s = LINK_UP_S, max(ages_s)
    outcome.carried_bytes = carried(air) - before
    outcome.grew_kb = [own_kb(robot.pid()) - kb for robot, kb in zip((one, two), memory_kb, strict=True)]
    return outcome


class Urgent:
    """Publishes urgent messages of another program, one after the other."""

    def __init__(self, here: zenoh.Session, there: zenoh.Session) -> None:
        self._arrived = threading.Event()
        # The sessions would be closed if they were garbage-collected.
        self._sessions = here, there
        key = "rect/wombat-1/stop"
        self._subscriber = there.declare_subscriber(key, lambda _: self._arrived.set())
        self._publisher = here.declare_publisher(
            key, priority=Priority.REAL_TIME, congestion_control=CongestionControl.BLOCK, express=True
        )
        wait_until("a message arrives", 30, lambda: self.put(0.5) < 0.5)

    def put(self, limit_s: float) -> float:
        """Publishes a message, and returns the seconds until it arrived, at most `limit_s`."""
        self._arrived.clear()
        started = time.monotonic()
        self._publisher.put(b"stop")
        return time.monotonic() - started if self._arrived.wait(limit_s) else limit_s
