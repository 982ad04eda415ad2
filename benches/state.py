"""Compares retained topics with zenoh-ext's advanced publishers, MQTT's retained messages and NetworkTables, over a TCP
link slowed to the rate of Bluetooth: a subscriber that begins late, and values that change during a cut."""

import os
import statistics
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import ntcore
import paho.mqtt.client as mqtt
import rect
import zenoh
from comparison import rounds
from robots import free_port, is_listening, open_client, rect_settings, wait_until
from routers import Router
from shaper import Shaper
from table import Table

RATE_BYTES_PER_S = 34_000
TOPICS, CHANGED = 50, 10
VALUE = "x" * 36
CUT_S = 10.0
ROUNDS = rounds(3)
#: How long after the last value bytes are still counted.
AFTER_S = 2.5


@dataclass
class Peer:
    """Two robots, of which one keeps state."""

    shaper: Shaper
    publish: Callable[[int, str], None]
    """Publishes the value of a topic."""
    subscribe: Callable[[Callable[[int, str], None]], None]
    """Subscribes to all topics at the other robot."""


@contextmanager
def routers() -> Iterator[tuple[Shaper, str, str]]:
    """Two routers of robots that are linked by the slow link."""
    with ExitStack() as stack:

        def router(name: str, *arguments: str) -> str:
            return stack.enter_context(Router("rect-router", *rect_settings({"robot": name}), *arguments)).endpoint

        near = router("wombat-1")
        shaper = stack.enter_context(Shaper(RATE_BYTES_PER_S, int(near.rsplit(":", 1)[1])))
        retry = "connect/retry:{period_init_ms:200,period_max_ms:1000,period_increase_factor:2}"
        far = router("wombat-2", "-e", f"tcp/127.0.0.1:{shaper.port}", "--cfg", retry)
        yield shaper, near, far


@contextmanager
def retained() -> Iterator[Peer]:
    with (
        routers() as (shaper, near, far),
        rect.connect("wombat-1", router=near) as one,
        rect.connect("wombat-2", router=far) as two,
    ):
        two.wait_for_peer("wombat-1", 20)

        def subscribe(on_value: Callable[[int, str], None]) -> None:
            two.subscribe("wombat-1/state/*", callback=lambda m: on_value(int(m.topic.split("/")[1]), m.value))

        yield Peer(shaper, lambda topic, value: one.publish(f"state/{topic}", value, retained=True), subscribe)


@contextmanager
def advanced() -> Iterator[Peer]:
    with routers() as (shaper, near, far), open_client(near) as one, open_client(far) as two:
        key = "rect/wombat-1/state"
        publishers = [
            zenoh.ext.declare_advanced_publisher(
                one,
                f"{key}/{topic}",
                cache=zenoh.ext.CacheConfig(1),
                publisher_detection=True,
                # It numbers the messages; otherwise they need Zenoh's timestamps.
                sample_miss_detection=zenoh.ext.MissDetectionConfig(),
            )
            for topic in range(TOPICS)
        ]
        wait_until("the routers are linked", 20, lambda: any(r.ok for r in two.get("rect/wombat-1/@rect/clock")))
        kept = []

        def subscribe(on_value: Callable[[int, str], None]) -> None:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            kept.append(
                zenoh.ext.declare_advanced_subscriber(
                    two,
                    f"{key}/*",
                    lambda s: on_value(int(str(s.key_expr).rsplit("/", 1)[1]), s.payload.to_string()),
                    history=history,
                )
            )

        yield Peer(shaper, lambda topic, value: publishers[topic].put(value), subscribe)


@contextmanager
def broker() -> Iterator[Peer]:
    port = free_port()
    process = subprocess.Popen([os.environ["RECT_MIDDLEWARE"], "broker", f"127.0.0.1:{port}"])
    try:
        wait_until("the broker is up", 20, lambda: is_listening(port))
        with Shaper(RATE_BYTES_PER_S, port) as shaper:

            def client(name: str, to: int) -> mqtt.Client:
                made = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=name, clean_session=False)
                made.reconnect_delay_set(1, 1)
                made.connect("127.0.0.1", to)
                made.loop_start()
                return made

            one, two = client("one", port), client("two", shaper.port)
            wait_until("the clients are connected", 20, lambda: one.is_connected() and two.is_connected())

            def subscribe(on_value: Callable[[int, str], None]) -> None:
                two.on_message = lambda _c, _u, m: on_value(int(m.topic.split("/")[1]), m.payload.decode())
                two.subscribe("state/#", qos=1)

            yield Peer(
                shaper,
                lambda topic, value: one.publish(f"state/{topic}", value, qos=1, retain=True).wait_for_publish(20),
                subscribe,
            )
            one.loop_stop()
            two.loop_stop()
    finally:
        process.terminate()
        process.wait(10)


@contextmanager
def network_tables() -> Iterator[Peer]:
    port = free_port()
    server, client = ntcore.NetworkTableInstance.create(), ntcore.NetworkTableInstance.create()
    server.startServer(persist_filename="", listen_address="127.0.0.1", port3=free_port(), port4=port)
    wait_until("the server is up", 20, lambda: is_listening(port))
    with Shaper(RATE_BYTES_PER_S, port) as shaper:
        client.startClient4("two")
        client.setServer("127.0.0.1", shaper.port)
        wait_until("the client is connected", 20, client.isConnected)
        publishers = [server.getStringTopic(f"/state/{topic}").publish() for topic in range(TOPICS)]
        for publisher in publishers:
            publisher.getTopic().setRetained(True)

        def subscribe(on_value: Callable[[int, str], None]) -> None:
            subscriber = ntcore.MultiSubscriber(client, ["/state/"])
            kept.append(subscriber)

            def on_event(event: ntcore.Event) -> None:
                topic = int(event.data.topic.getName().rsplit("/", 1)[1])
                on_value(topic, event.data.value.getString())

            client.addListener(subscriber, ntcore.EventFlags.kValueAll | ntcore.EventFlags.kImmediate, on_event)

        kept: list[object] = []

        def publish(topic: int, value: str) -> None:
            publishers[topic].set(value)
            server.flush()

        yield Peer(shaper, publish, subscribe)
        client.stopClient()
        server.stopServer()


PEERS = {
    "RECT, retained topics": retained,
    "zenoh-ext, advanced publishers": advanced,
    "MQTT (rumqttd), retained messages": broker,
    "NetworkTables (pyntcore)": network_tables,
}


class Values:
    """The values that have arrived."""

    def __init__(self) -> None:
        self.last: dict[int, str] = {}
        self.count = 0
        self._changed = threading.Condition()

    def on_value(self, topic: int, value: str) -> None:
        with self._changed:
            self.last[topic] = value
            self.count += 1
            self._changed.notify_all()

    def until(self, expected: dict[int, str], timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: expected.items() <= self.last.items(), timeout)


def measured(peer: Peer) -> list[float | None]:
    """Returns time and bytes of a late subscriber, time and bytes after a cut, and the number of values too many."""
    expected = {topic: f"{VALUE}{topic}" for topic in range(TOPICS)}
    for topic, value in expected.items():
        peer.publish(topic, value)
    time.sleep(2.0)
    values = Values()
    before, began = peer.shaper.carried, time.monotonic()
    peer.subscribe(values.on_value)
    is_complete = values.until(expected, 30)
    late = time.monotonic() - began if is_complete else None
    time.sleep(AFTER_S)
    late_bytes = peer.shaper.carried - before
    peer.shaper.state = "off"
    time.sleep(1.0)
    for topic in range(CHANGED):
        expected[topic] = f"{VALUE}after{topic}"
        peer.publish(topic, expected[topic])
    time.sleep(CUT_S - 1.0)
    count = values.count
    before, began = peer.shaper.carried, time.monotonic()
    peer.shaper.state = "on"
    is_complete = values.until(expected, 30)
    after = time.monotonic() - began if is_complete else None
    time.sleep(AFTER_S)
    return [late, late_bytes, after, peer.shaper.carried - before, values.count - count - CHANGED]


def run() -> Table:
    columns = ["", "late subscriber", "bytes", "after the cut", "bytes", "values too many"]
    table = Table(f"{TOPICS} values over a link of {RATE_BYTES_PER_S / 1000:.0f} kB/s", columns)
    for name, peer in PEERS.items():
        results = []
        for _ in range(ROUNDS):
            with peer() as running:
                results.append(measured(running))
        late, late_bytes, after, after_bytes, extra = zip(*results, strict=True)
        table.add(name, seconds(late), number(late_bytes), seconds(after), number(after_bytes), number(extra))
        print(f"  {name}", flush=True)
    table.notes = [
        f"Medians of {ROUNDS} rounds. The values have 37 or 38 bytes. A late subscriber: until it has all values, and "
        f"the bytes that the link carries in both directions until {AFTER_S} s later. The cut ends the connections for "
        f"{CUT_S:.0f} s, and {CHANGED} values change meanwhile: until they have arrived, from the end of the cut. The "
        "pause before a client dials again is 1 s, and NetworkTables' own. RECT and zenoh-ext: two rect-routers; MQTT "
        "and NetworkTables: the subscriber is a client over the link, connected before it subscribes.",
    ]
    return table


def seconds(times: tuple[float | None, ...]) -> str:
    """Returns the median of times, of which some may be missing."""
    known = [one for one in times if one is not None]
    missing = len(times) - len(known)
    text = f"{statistics.median(known) * 1000:,.0f} ms" if known else "never"
    return text + (f" ({missing} of {len(times)} never)" if missing and known else "")


def number(numbers: tuple[float, ...]) -> str:
    return f"{statistics.median(numbers):,.0f}"
