"""Reproduces a fault of Zenoh 1.10.2's routers with stock parts only: a query does not end if the program that serves
its key is killed at the moment when the router forwards the query. usage: python unfinished_query.py [ROUNDS]

A stock router has two stock clients. One serves a key and is killed; the other one sends query after query meanwhile.
In some of the rounds, a query ends only with its timeout.

The reason (zenoh-1.10.2/src/net/routing/dispatcher/): when a link ends, `Face::send_close` (face.rs) first ends the
queries that the face has not answered (`finalize_pending_queries`), and then removes its queryables, under another
lock. A query that is routed in between (`route_query` in queries.rs) is added to the face, and nothing ends it."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import zenoh
from stock import free_port, open_client

TIMEOUT_S, QUERIERS = 5.0, 4
#: How long the queries run before the program is killed, and afterwards.
BEFORE_S, AFTER_S = 0.1, 0.05

SERVER = """
import sys
from stock import open_client
session = open_client(int(sys.argv[1]))
queryable = session.declare_queryable("test/served", lambda query: query.reply("test/served", b""))
print("serving", flush=True)
sys.stdin.read()
"""


def query_until(is_killed: threading.Event, session: zenoh.Session, took_s: list[float]) -> None:
    while not is_killed.is_set():
        began = time.monotonic()
        for _ in session.get("test/served", timeout=TIMEOUT_S):
            pass
        took_s.append(time.monotonic() - began)


def longest_s(session: zenoh.Session, port: int) -> float:
    """Kills a program that serves queries, and returns the time of the longest query."""
    command = [sys.executable, "-c", SERVER, str(port)]
    pipe, here = subprocess.PIPE, Path(__file__).parent
    server = subprocess.Popen(command, cwd=here, stdin=pipe, stdout=pipe)
    server.stdout.readline()
    took_s: list[float] = []
    is_killed = threading.Event()
    threads = [threading.Thread(target=query_until, args=(is_killed, session, took_s)) for _ in range(QUERIERS)]
    for thread in threads:
        thread.start()
    time.sleep(BEFORE_S)
    server.send_signal(signal.SIGKILL)
    server.wait()
    time.sleep(AFTER_S)
    is_killed.set()
    for thread in threads:
        thread.join()
    return max(took_s)


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    port, unfinished = free_port(), 0
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config), open_client(port) as session:
        for number in range(rounds):
            took_s = longest_s(session, port)
            if took_s > TIMEOUT_S / 2:
                unfinished += 1
                print(f"round {number}: a query ended after {took_s:.1f} s", flush=True)
    print(f"in {unfinished} of {rounds} rounds, a query ended only with its timeout")


if __name__ == "__main__":
    main()
