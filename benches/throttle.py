"""Subscribers that ask for fewer messages than are published, over a slow link: RECT's `max_hz` and `on_change`, and
the `downsampling` of stock Zenoh."""

import json
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import rect
from comparison import rounds
from pairs import room
from robots import rect_settings
from room import Room, wait_for_link
from table import Table

#: The payload of the link-layer packets in bytes: with 27, the air carries 34 kB/s.
PDU = 27
#: The topic: its value, of 18 bytes, and how often it is published per second.
POSE, PER_S = b"123.45 678.90 1.23", 20
FOR_S = float(rounds(10))
TIMEOUT_S = 30.0


@dataclass
class Case:
    name: str
    #: The options of each subscriber, all of them programs of the laptop.
    subscribers: list[dict[str, Any]]
    #: Settings of the robot's router.
    settings: tuple[str, ...] = ()
    changes: bool = True


def downsampling(hz: float) -> tuple[str, ...]:
    rule = {"flows": ["egress"], "messages": ["put"], "rules": [{"key_expr": "rect/*/pose", "freq": hz}]}
    return ("--cfg", f"downsampling:{json.dumps([rule])}")


CASES = [
    Case("everything", [{}]),
    Case("`max_hz=2`", [{"max_hz": 2}]),
    Case("stock `downsampling` to 2 Hz", [{}], downsampling(2)),
    Case("`max_hz` of 20, 5 and 1 by three programs", [{"max_hz": 20}, {"max_hz": 5}, {"max_hz": 1}]),
    Case("`on_change`, and the value never changes", [{"on_change": True}], changes=False),
]


def sent(air: Room) -> int:
    """Returns the bytes that the robot has sent so far, with the headers of L2CAP."""
    stats = next(adapter["stats"] for adapter in air.status()["adapters"] if adapter["name"] == "sim-wombat-1")
    return int(stats["sdu_bytes"] + 6 * stats["sdus"])


def measure(case: Case) -> list[str]:
    with room(PDU) as air, ExitStack() as stack:
        settings = [tuple(rect_settings({"robot": name})) for name in ("wombat-1", "laptop")]
        one = air.add_robot("wombat-1", arguments=(*settings[0], *case.settings))
        two = air.add_robot("laptop", arguments=settings[1])
        wait_for_link(one, two)
        robot = stack.enter_context(rect.connect("wombat-1", router=one.endpoint(), program=None))
        received: list[list[rect.Message]] = []
        for options in case.subscribers:
            laptop = stack.enter_context(rect.connect("laptop", router=two.endpoint(), program=None))
            messages: list[rect.Message] = []
            received.append(messages)
            stack.enter_context(laptop.subscribe("wombat-1/pose", callback=messages.append, **options))
        publisher = robot.publisher("pose")
        began = time.monotonic()
        while not all(received):
            publisher.publish(POSE)
            time.sleep(0.1)
            assert time.monotonic() < began + TIMEOUT_S
        # The wishes, and messages in flight, are not counted.
        time.sleep(2)
        before, counts = sent(air), [len(messages) for messages in received]
        began, pause = time.monotonic(), threading.Event()
        for number in range(int(FOR_S * PER_S)):
            publisher.publish(b"%018d" % number if case.changes else POSE)
            pause.wait(max(0.0, began + (number + 1) / PER_S - time.monotonic()))
        took = time.monotonic() - began
        per_s = (sent(air) - before) / took
        new = [messages[count:] for messages, count in zip(received, counts, strict=True)]
        rates = ", ".join(f"{len(messages) / took:.1f}" for messages in new)
        missed = sum(message.missed for messages in new for message in messages)
        skipped = sum(message.skipped for messages in new for message in messages)
        return [case.name, rates, f"{per_s:,.0f}", f"{missed}", f"{skipped}"]


def run() -> Table:
    columns = ["the laptop asks for", "messages/s that arrive", "bytes/s on the air", "counted as missed", "as skipped"]
    table = Table(f"A topic with {PER_S} messages of {len(POSE)} bytes a second over Bluetooth", columns)
    for case in CASES:
        table.add(*measure(case))
    table.notes = [
        f"{FOR_S:.0f} s each, on the simulated air, 34 kB/s, without a secret, which adds 6 bytes to each message. "
        "Bytes: what the robot sends, with L2CAP's headers; the link's acknowledgements and keep-alives are included. "
        "Zenoh's rule for `downsampling` is in the configuration of the robot's router and holds for every subscriber.",
    ]
    return table
