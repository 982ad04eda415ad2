"""Reproduces a fault of Zenoh 1.10.2's Python client with stock parts: after a message whose encoding has a schema of
more than 255 bytes, the session cannot be used any more. usage: python long_encoding.py

There are two peers in one process. One puts a message with a schema of 300 bytes, then ordinary ones. The first put
raises `PanicException`, which is not derived from `Exception`. All later puts fail, too, because the panic has poisoned
a lock that they need. Exit status 1: no message arrives after the one with the long schema.

The reason: the length of a schema is one byte on the wire. The codec refuses a longer one
(`zenoh-codec-1.10.2/src/core/encoding.rs`), but the transport assumes that every message can be written
(`zenoh-transport-1.10.2/src/common/pipeline.rs`, `push_network_message`), and holds the lock of the queue meanwhile.
`Encoding` does not check the length. RECT rejects such an encoding before it calls Zenoh."""

import json
import os
import socket
import sys
import threading

import zenoh

KEY = "test/long"
SCHEMA_BYTES = 300
WAIT_S = 5


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def peer(**settings: object) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {"mode": "peer", "scouting/multicast/enabled": False, **settings}.items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    return zenoh.open(config)


def put(session: zenoh.Session, encoding: str) -> bool:
    """Publishes one byte, and returns whether Zenoh accepted it. Zenoh's panics are not derived from `Exception`."""
    try:
        session.put(KEY, b"1", encoding=encoding)
    except BaseException as error:
        print(f"{encoding[:20]}...: {type(error).__name__}: {str(error)[:120]}")
        return False
    return True


def main() -> int:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    there, here = peer(listen__endpoints=[endpoint]), peer(connect__endpoints=[endpoint])
    received = threading.Semaphore(0)
    subscriber = there.declare_subscriber(KEY, lambda _: received.release())
    while not received.acquire(timeout=0.05):
        put(here, "text/plain")
    # Several probes may have been in flight.
    while received.acquire(timeout=0.5):
        pass
    accepted = put(here, "application/json;" + "x" * SCHEMA_BYTES)
    ordinary = put(here, "application/json")
    arrives = received.acquire(timeout=WAIT_S)
    print(
        f"a schema of {SCHEMA_BYTES} bytes is accepted: {accepted}; the next message: {ordinary}; it arrives: {arrives}"
    )
    if arrives:
        subscriber.undeclare()
        return 0
    sys.stdout.flush()
    # Closing the session would fail on the same lock.
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
