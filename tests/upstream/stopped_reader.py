"""Reproduces a fault of Zenoh 1.10.2's routers with stock clients: while a router closes the session of a program that
has stopped reading, it sends nothing to any other program. usage: ROUTER=<zenohd or rect-router> python
stopped_reader.py

There are one router and four programs. One subscribes and is stopped (SIGSTOP); one publishes more to it than fits; the
other two exchange a message every 50 ms. When the lease of the stopped program expires, the two receive nothing until
the router's `wait_before_close` has passed. Exit status 1: their messages were delayed.

The reason (zenoh-transport-1.10.2/src/): a program that puts waits for room while it holds the lock of the queue
(`common/pipeline.rs`, `push_network_message`). Closing a link drains the queue, which takes that lock
(`unicast/universal/link.rs`, `write_loop`), in the only thread that the runtime `tx` has by default. `rect-router`
gives this runtime more threads (`rect-router/src/threads.rs`)."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import zenoh

BULK, TICK = "test/bulk", "test/tick"
LEASE_MS = 2_000
WAIT_BEFORE_CLOSE_S = 20
WATCHED_S = 15
HELD_UP_S = 5


def client(port: int, lease_ms: int = 10_000) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("connect/timeout_ms", "20000")
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/link/tx/lease", str(lease_ms))
    return zenoh.open(config)


def reader(port: int) -> None:
    """Runs the program that will be stopped. Prints a line when it has received a message."""
    with client(port, LEASE_MS) as session:
        subscriber = session.declare_subscriber(BULK, lambda _: print("received", flush=True))
        signal.pause()
        subscriber.undeclare()


def main() -> int:
    port = 17_447 + os.getpid() % 1_000
    settings = [
        f"transport/link/tx/queue/congestion_control/block/wait_before_close:{WAIT_BEFORE_CLOSE_S * 1_000_000}",
        "scouting/multicast/enabled:false",
    ]
    command = [os.environ["ROUTER"], "-l", f"tcp/127.0.0.1:{port}"]
    command += [part for setting in settings for part in ("--cfg", setting)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as router:
        try:
            here, there = client(port), client(port)
            stopped = subprocess.Popen(
                [sys.executable, __file__, "reader", str(port)], stdout=subprocess.PIPE, env=os.environ
            )
            receiving = threading.Thread(target=stopped.stdout.readline, daemon=True)
            receiving.start()
            while receiving.is_alive():
                here.put(BULK, b"?")
                receiving.join(0.05)
            times = [time.monotonic()]
            ticks = there.declare_subscriber(TICK, lambda _: times.append(time.monotonic()))
            stopped.send_signal(signal.SIGSTOP)
            bulk = {"congestion_control": zenoh.CongestionControl.BLOCK}
            threading.Thread(target=lambda: client(port).put(BULK, bytes(50_000_000), **bulk), daemon=True).start()
            end = time.monotonic() + WATCHED_S
            while time.monotonic() < end:
                here.put(TICK, b"")
                time.sleep(0.05)
            silence = max(later - sooner for sooner, later in zip(times, [*times[1:], time.monotonic()], strict=True))
            print(
                f"longest gap between the other two's messages: {silence:.1f} s of {WATCHED_S}, {len(times)} messages"
            )
            ticks.undeclare()
            stopped.kill()
            return int(silence > HELD_UP_S)
        finally:
            router.kill()


if __name__ == "__main__":
    if sys.argv[1:2] == ["reader"]:
        reader(int(sys.argv[2]))
    else:
        # The thread that publishes the bulk message is still waiting.
        os._exit(main())
