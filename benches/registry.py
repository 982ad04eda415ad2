"""Measures how quickly the registry answers, and how soon a fleet's registries agree after a change."""

import json
import statistics
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import zenoh
from robots import open_client, rect_settings, wait_until
from routers import Router
from table import Table
from traffic import percentile

CONNECTIONS = [5, 500]
ASKED = 200
ROUTERS = 20
ROUNDS = 5
TARGET_S = 2


def run() -> Table:
    table = Table(
        "The registry: time to an answer, and time until a fleet's registries agree", ["what", "p50", "p99 or max"]
    )
    for count in CONNECTIONS:
        for what in ("connections/count", "connections"):
            times = asked(count, what)
            places = (f"{percentile(times, place) * 1000:.1f} ms" for place in (0.5, 0.99))
            table.add(f"`{what}` of a robot with {count} connections", *places)
    times = agreed()
    table.add(
        f"{ROUTERS} routers: until both ends report a new or removed connection",
        f"{statistics.median(times):.2f} s",
        f"{max(times):.2f} s",
    )
    table.notes = [
        f"Time to an answer: a stock client on the robot's own router, {ASKED} times. The named connections "
        "lead to ports that nothing listens on, so the router keeps dialling.",
        f"{ROUTERS} routers of one machine, each with a named connection to the first; {ROUNDS} times the last one's "
        "connection is removed from its file and added again. The time is from the change of the file until the "
        f"registry of the first router shows it. Target: within {TARGET_S} s.",
    ]
    return table


def asked(count: int, what: str) -> list[float]:
    # The ports from 1 on, which nothing listens on.
    named = [connection(f"c{n}", n + 1) for n in range(count)]
    with tempfile.TemporaryDirectory() as folder, robot("wombat-1", Path(folder), named, count) as router:
        router.wait_for_answer("rect/wombat-1/@rect/connections/count")
        with open_client(router.endpoint) as session:
            querier = session.declare_querier(f"rect/wombat-1/@rect/{what}", timeout=5)
            times = []
            for _ in range(ASKED):
                started = time.monotonic()
                answers = [reply for reply in querier.get() if reply.ok]
                assert len(answers) == 1, "each question gets one answer"
                times.append(time.monotonic() - started)
    return times


def agreed() -> list[float]:
    times = []
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        folder = Path(temporary)
        first = stack.enter_context(robot("robot-1", folder, []))
        to_first = connection("first", int(first.endpoint.rsplit(":", 1)[1]))
        for n in range(2, ROUTERS + 1):
            stack.enter_context(robot(f"robot-{n}", folder, [to_first]))
        session = stack.enter_context(open_client(first.endpoint))
        everyone = {f"robot-{n}" for n in range(2, ROUTERS + 1)}
        wait_until("all are connected", 60, lambda: ends(session, "robot-1") == everyone)
        last = f"robot-{ROUTERS}"
        for _ in range(ROUNDS):
            for named in ([], [to_first]):
                write(folder / f"{last}.json", named)
                is_there = bool(named)
                took = wait_until(
                    "both ends agree", 20, lambda there=is_there: (last in ends(session, "robot-1")) == there
                )
                times.append(took)
    return times


def ends(session: zenoh.Session, name: str) -> set[str]:
    """Returns the robots that a robot's registry shows as connected."""
    for reply in session.get(f"rect/{name}/@rect/peers?state=connected", timeout=5):
        if reply.ok is not None:
            return {peer["robot"] for peer in json.loads(reply.ok.payload.to_bytes())} - {None}
    return set()


def robot(name: str, folder: Path, named: list[dict], limit: int = 32) -> Router:
    path = folder / f"{name}.json"
    write(path, named)
    settings = {"robot": name, "connections": str(path), "max_connections": max(limit, 1)}
    # The router retries soon, as with config/robot.json5.
    retry = "connect/retry:{period_init_ms:200,period_max_ms:1000,period_increase_factor:2}"
    return Router("rect-router", *rect_settings(settings), "--cfg", retry, "--cfg", "connect/exit_on_failure:false")


def connection(name: str, port: int) -> dict:
    return {"name": name, "method": "tcp", "address": "127.0.0.1", "port": port}


def write(path: Path, named: list[dict]) -> None:
    new = path.with_suffix(".new")
    new.write_text(json.dumps({"connections": named}))
    new.rename(path)
