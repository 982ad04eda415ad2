"""Measures how quickly the registry answers, and how soon it shows a change at another router of a fleet."""

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
QUERIES = 200
ROUTERS = 20
ROUNDS = 5
TARGET_S = 2


def run() -> Table:
    table = Table(
        "The registry: time to an answer, and time until it shows a change at another router",
        ["what", "p50", "p99 or max"],
    )
    for count in CONNECTIONS:
        for what in ("connections/count", "connections"):
            times_s = answer_times_s(count, what)
            cells = (f"{percentile(times_s, share) * 1000:.1f} ms" for share in (0.5, 0.99))
            table.add(f"`{what}` of a robot with {count} connections", *cells)
    times_s = change_times_s()
    table.add(
        f"{ROUTERS} routers: until the other end's registry shows a new or removed connection",
        f"{statistics.median(times_s):.2f} s",
        f"{max(times_s):.2f} s",
    )
    table.notes = [
        f"Time to an answer: a stock client on the robot's own router, {QUERIES} times. The named connections "
        "lead to ports that nothing listens on, so the router keeps dialling.",
        f"{ROUTERS} routers of one machine, each with a named connection to the first; {ROUNDS} times the last one's "
        "connection is removed from its file and added again. The time is from the change of the file until the "
        f"registry of the first router shows it. Target: within {TARGET_S} s.",
    ]
    return table


def answer_times_s(count: int, what: str) -> list[float]:
    """Measures the times from a query of `what` to its answer, of a robot with `count` named connections."""
    # The ports from 1 on, which nothing listens on.
    named = [connection(f"c{n}", n + 1) for n in range(count)]
    with tempfile.TemporaryDirectory() as folder, robot("wombat-1", Path(folder), named, count) as router:
        router.wait_for_answer("rect/wombat-1/@rect/connections/count")
        with open_client(router.endpoint) as session:
            querier = session.declare_querier(f"rect/wombat-1/@rect/{what}", timeout=5)
            times = []
            for _ in range(QUERIES):
                started = time.monotonic()
                answers = [reply for reply in querier.get() if reply.ok]
                assert len(answers) == 1, "each query gets one answer"
                times.append(time.monotonic() - started)
    return times


def change_times_s() -> list[float]:
    """Measures the times from a change of a connections file until the registry of the other end shows it."""
    times = []
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        folder = Path(temporary)
        first = stack.enter_context(robot("robot-1", folder, []))
        to_first = connection("first", int(first.endpoint.rsplit(":", 1)[1]))
        for n in range(2, ROUTERS + 1):
            stack.enter_context(robot(f"robot-{n}", folder, [to_first]))
        session = stack.enter_context(open_client(first.endpoint))
        everyone = {f"robot-{n}" for n in range(2, ROUTERS + 1)}
        wait_until("all are connected", 60, lambda: connected_robots(session, "robot-1") == everyone)
        last = f"robot-{ROUTERS}"
        for _ in range(ROUNDS):
            for named in ([], [to_first]):
                write(folder / f"{last}.json", named)
                is_connected = bool(named)
                took = wait_until(
                    "the registry of robot-1 shows the change",
                    20,
                    lambda expected=is_connected: (last in connected_robots(session, "robot-1")) == expected,
                )
                times.append(took)
    return times


def connected_robots(session: zenoh.Session, name: str) -> set[str]:
    """Returns the robots that a robot's registry shows as connected."""
    for reply in session.get(f"rect/{name}/@rect/peers?state=connected", timeout=5):
        if reply.ok is not None:
            return {peer["robot"] for peer in json.loads(reply.ok.payload.to_bytes())} - {None}
    return set()


def robot(name: str, folder: Path, named: list[dict], limit: int = 32) -> Router:
    """Returns the router of a robot with the connections `named`, of which it accepts at most `limit`."""
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
