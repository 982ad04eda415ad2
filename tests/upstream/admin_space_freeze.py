"""Reproduces a fault of Zenoh 1.10.2 with stock parts only: queries of the admin space about publishers, beside
declarations of other programs, stop a router for good. usage: ZENOHD=<stock zenohd> python admin_space_freeze.py

The admin space replies while it holds the routing tables for reading, and the reply locks them for reading again
(`resources_data` in `net/runtime/adminspace.rs`). If a declaration waits to write in between, both wait forever. The
keys `subscriber`, `queryable`, `querier` and `token` are answered by the same function. RECT's routers do not query
them, and `rect-router/src/topics.rs` counts messages instead. Exit status: 0 if the fault exists, otherwise 1."""

import os
import subprocess
import sys
import threading
import time

import zenoh
from stock import free_port, open_client

SECONDS = 60
# A router that does not answer for this long, of a query that takes a millisecond, has stopped.
TIMEOUT_S = 10


def declare_until(over: threading.Event, session: zenoh.Session) -> None:
    number = 0
    while not over.is_set():
        session.declare_subscriber(f"other/{number}", lambda _: None).undeclare()
        number += 1


def answers(session: zenoh.Session, keys: str) -> bool:
    replies = list(session.get(keys, timeout=TIMEOUT_S))
    return bool(replies) and all(reply.ok for reply in replies)


def main() -> int:
    port = free_port()
    router = subprocess.Popen(
        [os.environ["ZENOHD"], "--no-multicast-scouting", "-l", f"tcp/127.0.0.1:{port}"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    over = threading.Event()
    sessions = [open_client(port) for _ in range(3)]
    publishers = [sessions[0].declare_publisher(f"data/{number}") for number in range(20)]
    other = threading.Thread(target=declare_until, args=(over, sessions[1]), daemon=True)
    other.start()
    asked, begun, has_stopped = 0, time.monotonic(), False
    while not has_stopped and time.monotonic() - begun < SECONDS:
        has_stopped = not answers(sessions[2], "@/*/router/publisher/**")
        asked += 1
    over.set()
    if has_stopped:
        print(f"the router stopped at query {asked}; it answers other queries: {answers(sessions[2], '@/*/router')}")
    else:
        print(f"the router answered all {asked} queries")
    router.kill()
    router.wait()
    other.join()
    del publishers
    for session in sessions:
        session.close()
    return 0 if has_stopped else 1


if __name__ == "__main__":
    sys.exit(main())
