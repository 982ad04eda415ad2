"""A minimal reproduction of a fault of Zenoh 1.10.2's Python client, with stock parts: an encoding whose schema is
longer than 255 bytes ends the program's use of the session. usage: python long_encoding.py

Two peers in one process. One puts a message with a schema of 300 bytes, then ordinary ones. The first put raises
`PanicException`, which is no `Exception`, and each put after it fails too, because the panic has poisoned a lock that
they need. Exit status 1: nothing arrives after the long one.

Why: a schema's length is one byte on the wire. The codec refuses a longer one
(`zenoh-codec-1.10.2/src/core/encoding.rs`), and the transport takes for granted that a message can be written
(`zenoh-transport-1.10.2/src/common/pipeline.rs`, `push_network_message`), with the lock of the queue held. `Encoding`
does not check the length. RECT rejects such an encoding before Zenoh gets it."""

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
    """Whether it is accepted; a panic of Zenoh's is not even an `Exception`."""
    try:
        session.put(KEY, b"1", encoding=encoding)
    except BaseException as error:
        print(f"{encoding[:20]}...: {type(error).__name__}: {str(error)[:120]}")
        return False
    return True


def main() -> int:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    there, here = peer(listen__endpoints=[endpoint]), peer(connect__endpoints=[endpoint])
    heard = threading.Semaphore(0)
    subscriber = there.declare_subscriber(KEY, lambda _: heard.release())
    while not heard.acquire(timeout=0.05):
        put(here, "text/plain")
    # Several probes may have been on their way.
    while heard.acquire(timeout=0.5):
        pass
    accepted = put(here, "application/json;" + "x" * SCHEMA_BYTES)
    ordinary = put(here, "application/json")
    arrives = heard.acquire(timeout=WAIT_S)
    print(
        f"a schema of {SCHEMA_BYTES} bytes is accepted: {accepted}; the next message: {ordinary}; it arrives: {arrives}"
    )
    if arrives:
        subscriber.undeclare()
        return 0
    sys.stdout.flush()
    # To close the session would fail on the same lock.
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
