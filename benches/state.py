"""Compares retained topics with zenoh-ext's advanced publishers, MQTT's retained messages and NetworkTables, over a TCP
link slowed to the rate of Bluetooth: a subscriber that begins late, and values that change during a cut."""

import functools
import os
import statistics
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import ntcore
import paho.mqtt.client as mqtt
import rect
import zenoh
from comparison import alternate, rounds
from robots import free_port, is_listening, open_client, rect_settings, wait_until
from routers import Router
from shaper import Shaper
from table import Table

RATE_BYTES_PER_S = 34_000
TOPICS, CHANGED = 50, 10
VALUE_BYTES = 40
CUT_S = 10.0
ROUNDS = rounds(5)
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
        for instance in (client, server):
            ntcore.NetworkTableInstance.destroy(instance)


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


@dataclass
class Measured:
    """The figures of one round. A time is `None` if values have not arrived."""

    late: float | None
    late_bytes: int
    after: float | None
    """The time from the first connection after the cut."""
    after_bytes: int
    repeated: int
    """The number of values that arrived beside those that were expected."""


def measured(peer: Peer) -> Measured:
    """Measures a late subscriber, and values that change during a cut."""
    expected = {topic: value("", topic) for topic in range(TOPICS)}
    for topic, text in expected.items():
        peer.publish(topic, text)
    time.sleep(2.0)
    values = Values()
    shaper = peer.shaper
    before, began = shaper.carried, time.monotonic()
    peer.subscribe(values.on_value)
    is_complete = values.until(expected, 30)
    late = time.monotonic() - began if is_complete else None
    time.sleep(AFTER_S)
    late_bytes = shaper.carried - before
    shaper.state = "off"
    time.sleep(1.0)
    for topic in range(CHANGED):
        expected[topic] = value("after", topic)
        peer.publish(topic, expected[topic])
    time.sleep(CUT_S - 1.0)
    before = shaper.carried
    shaper.connected_at = None
    shaper.state = "on"
    is_complete = values.until(expected, 30)
    complete = time.monotonic()
    time.sleep(AFTER_S)
    after = complete - (shaper.connected_at or complete) if is_complete else None
    repeated = values.count - TOPICS - CHANGED
    return Measured(late, late_bytes, after, shaper.carried - before, repeated)


def value(text: str, topic: int) -> str:
    """Returns a value that no other topic has."""
    return f"{text}{topic:02}".rjust(VALUE_BYTES, "x")


def run() -> Table:
    columns = ["", "late subscriber", "bytes", "after a cut", "bytes", "repeated values"]
    table = Table(f"{TOPICS} values over a link of {RATE_BYTES_PER_S / 1000:.0f} kB/s", columns)

    def candidate(name: str) -> Measured:
        with PEERS[name]() as running:
            return measured(running)

    results = alternate(ROUNDS, *(functools.partial(candidate, name) for name in PEERS))
    for name, found in zip(PEERS, results, strict=True):
        late, after = seconds([one.late for one in found]), seconds([one.after for one in found])
        late_bytes, after_bytes = number([one.late_bytes for one in found]), number([one.after_bytes for one in found])
        table.add(name, late, late_bytes, after, after_bytes, number([one.repeated for one in found]))
    table.notes = [
        f"Medians of {ROUNDS} rounds. The values have {VALUE_BYTES} bytes. A late subscriber: from its call until it "
        f"has all values, and the bytes that the link carries both ways until {AFTER_S} s later. The cut ends the "
        f"connections for {CUT_S:.0f} s, and {CHANGED} values change meanwhile: from the first connection after it "
        f"until they have arrived, and the bytes until {AFTER_S} s later, with those of connecting. The pause before a "
        "program dials again is not counted. Repeated values: those that the subscriber gets twice, or again although "
        "they have not changed. RECT and zenoh-ext: two rect-routers, which are connected by the link; MQTT and "
        "NetworkTables: the subscriber is a client that is connected to the broker or server by the link.",
    ]
    return table


def seconds(times: Sequence[float | None]) -> str:
    """Returns the median of times, of which some may be missing."""
    known = [one for one in times if one is not None]
    missing = len(times) - len(known)
    text = f"{statistics.median(known) * 1000:,.0f} ms" if known else "never"
    return text + (f" ({missing} of {len(times)} never)" if missing and known else "")


def number(numbers: Sequence[int]) -> str:
    return f"{statistics.median(numbers):,.0f}"
