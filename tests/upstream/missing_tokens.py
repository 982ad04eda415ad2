"""Reproduces a fault of Zenoh 1.10.2's sessions with stock parts only: a liveliness query that directly follows the
declaration of a liveliness subscriber with history gets no reply. usage: ZENOHD=<stock zenohd> python missing_tokens.py

The same query is answered if it comes first, or a moment later. `PeersQuery` in
`crates/rect-core/src/session/peers.rs` therefore asks twice. Exit status: 0 if the fault exists, otherwise 1."""

import os
import subprocess
import sys

import zenoh
from stock import free_port, open_client


def count(session: zenoh.Session) -> int:
    return len(list(session.liveliness().get("alive/*", timeout=5)))


def main() -> int:
    port = free_port()
    router = subprocess.Popen(
        [os.environ["ZENOHD"], "--no-multicast-scouting", "-l", f"tcp/127.0.0.1:{port}"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with open_client(port) as alive, open_client(port) as asking:
            token = alive.liveliness().declare_token("alive/one")
            while count(asking) == 0:
                pass
            subscriber = asking.liveliness().declare_subscriber("alive/*", lambda _: None, history=True)
            first, second = count(asking), count(asking)
            subscriber.undeclare()
            token.undeclare()
    finally:
        router.kill()
        router.wait()
    print(f"tokens of the first query after the declaration: {first}; of the second one: {second}")
    return 0 if (first, second) == (0, 1) else 1


if __name__ == "__main__":
    sys.exit(main())
