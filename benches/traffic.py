"""Sends the traffic of stock clients over a slow link: continuous urgent messages, and large messages or frames."""

import contextlib
import statistics
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh
from robots import RobotError, wait_until
from zenoh import CongestionControl, Priority

PERIOD_S = 0.05
URGENT = "<dd"
URGENT_BYTES = struct.calcsize(URGENT)
FRAME_BYTES = 20_000
FRAMES_PER_S = 20
# A link that carries less than this share of its rate for this time has nothing of the bulk left to carry.
STALLED_SHARE = 0.2
STALLED_S = 10
# The time after the end within which messages in flight still count.
STRAGGLERS_S = 5


@dataclass
class Load:
    """The result of the large messages or frames."""

    kb_per_s: float
    faults: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


class Urgent:
    """Publishes 16 urgent bytes every 50 ms, and records their ages on arrival."""

    def __init__(self, here: zenoh.Session, there: zenoh.Session) -> None:
        self.ages_s: list[float] = []
        self.sent = 0
        self._ended = threading.Event()
        key = "rect/wombat-1/stop"
        self._arrives = Arrival(there, key, self._on_message)
        self._publisher = here.declare_publisher(
            key, priority=Priority.REAL_TIME, congestion_control=CongestionControl.BLOCK, express=True
        )
        self._arrives.wait_for_first(self._publisher)
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> "Urgent":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        ended = time.monotonic()
        while len(self.ages_s) < self.sent and time.monotonic() - ended < STRAGGLERS_S:
            time.sleep(PERIOD_S)

    def _on_message(self, payload: bytes) -> None:
        self.ages_s.append(time.monotonic() - struct.unpack(URGENT, payload)[0])

    def _send(self) -> None:
        # The age of a message counts from the time when it was due, so that delays of a blocked put are included.
        due = time.monotonic()
        while not self._ended.is_set():
            self.sent += 1
            self._publisher.put(struct.pack(URGENT, due, 0))
            due += PERIOD_S
            self._ended.wait(max(0.0, due - time.monotonic()))


class Arrival:
    """A subscriber that passes on all payloads except single bytes, which only show that messages arrive."""

    def __init__(self, there: zenoh.Session, key: str, on_payload: Callable[[bytes], None]) -> None:
        self._is_open = threading.Event()
        self._on_payload = on_payload
        self._subscriber = there.declare_subscriber(key, self._on_sample)

    def wait_for_first(self, publisher: zenoh.Publisher) -> None:
        wait_until("a message arrives", 30, lambda: publisher.put(b"?") or self._is_open.is_set())

    def _on_sample(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if len(payload) == 1:
            self._is_open.set()
        else:
            self._on_payload(payload)


def bulk(here: zenoh.Session, there: zenoh.Session, sizes: list[int], stall: Callable[[], bool]) -> Load:
    """Sends a message of each of `sizes` at the same time, and measures from the first put to the last arrival."""
    senders = [Sender(here, there, f"rect/wombat-1/bulk/{n}") for n in range(len(sizes))]
    started = time.monotonic()
    for sender, size in zip(senders, sizes, strict=True):
        sender.put(size)
    while not all(sender.arrived for sender in senders) and not stall():
        time.sleep(PERIOD_S)
    arrived = [arrival for sender in senders for arrival in sender.arrived]
    if not arrived:
        return Load(0.0, ["bulk lost"])
    took = max(at for at, _ in arrived) - started
    lost = len(sizes) - len(arrived)
    faults = [f"{lost} of {len(sizes)} bulks lost"] if lost else []
    return Load(sum(size for _, size in arrived) / took / 1000, faults)


class Sender:
    """Publishes large messages in a thread."""

    def __init__(self, here: zenoh.Session, there: zenoh.Session, key: str, priority: Priority = Priority.DATA) -> None:
        self.arrived: list[tuple[float, int]] = []
        self._arrival = Arrival(there, key, lambda payload: self.arrived.append((time.monotonic(), len(payload))))
        self._publisher = here.declare_publisher(key, priority=priority, congestion_control=CongestionControl.BLOCK)
        self._arrival.wait_for_first(self._publisher)

    def put(self, size: int) -> None:
        threading.Thread(target=self._put, args=(bytes(size),), daemon=True).start()

    def _put(self, payload: bytes) -> None:
        # Failures show as messages that do not arrive.
        with contextlib.suppress(zenoh.ZError):
            self._publisher.put(payload)


def camera(here: zenoh.Session, there: zenoh.Session, seconds: float) -> Load:
    """Sends more droppable frames than the link carries, and measures the rate from the first arrival to the last."""
    arrived: list[float] = []
    ages_s: list[float] = []

    def on_frame(payload: bytes) -> None:
        arrived.append(time.monotonic())
        ages_s.append(arrived[-1] - struct.unpack("<d", payload[:8])[0])

    key = "rect/wombat-1/camera"
    arrives = Arrival(there, key, on_frame)
    publisher = here.declare_publisher(key, congestion_control=CongestionControl.DROP)
    arrives.wait_for_first(publisher)
    started = due = time.monotonic()
    while due - started < seconds:
        publisher.put(struct.pack("<d", time.monotonic()) + bytes(FRAME_BYTES - 8))
        due += 1 / FRAMES_PER_S
        time.sleep(max(0.0, due - time.monotonic()))
    whole = len(arrived)
    if whole < 2:
        return Load(0.0, ["no frames arrived"])
    took = arrived[whole - 1] - arrived[0]
    time.sleep(2)
    oldest = max(ages_s)
    remark = (
        f"{whole} of {seconds * FRAMES_PER_S:.0f} frames, age p50 {statistics.median(ages_s):.2f}, max {oldest:.2f} s"
    )
    return Load((whole - 1) * FRAME_BYTES / took / 1000, ["old frames"] if oldest > 1 else [], [remark])


class Stall:
    """Detects that a link has stopped carrying the bulk."""

    def __init__(self, carried: Callable[[], int], bytes_per_s: float) -> None:
        self._carried = carried
        self._expected = bytes_per_s * STALLED_SHARE * STALLED_S
        self._since = time.monotonic()
        self._before = carried()

    def __call__(self) -> bool:
        if time.monotonic() - self._since < STALLED_S:
            return False
        before, self._before, self._since = self._before, self._carried(), time.monotonic()
        return self._before - before < self._expected


def percentile(values: list[float], share: float) -> float:
    if not values:
        raise RobotError("no values were measured")
    return sorted(values)[min(len(values) - 1, int(len(values) * share))]
