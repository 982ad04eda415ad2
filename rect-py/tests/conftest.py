"""Robots for the tests: two in one process, linked directly; routers on the simulated air where they are built."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest
import rect

#: How long anything may take before a test fails, in seconds.
DEADLINE = 20.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def pair() -> Iterator[tuple[rect.Robot, rect.Robot]]:
    """`wombat-1` and `wombat-2`, each of which hears the other."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-1", listen=[endpoint]) as one, rect.connect("wombat-2", endpoints=[endpoint]) as two:
        for robot in (one, two):
            with robot.on_state() as events:
                while events.next(DEADLINE).what != "peer_up":
                    pass
        yield one, two


@pytest.fixture
def heard() -> Callable[[rect.Robot, rect.Robot, str], None]:
    """Waits until what one robot says about a topic would reach a subscription of the other's that is there already."""

    def wait(speaker: rect.Robot, topic: str) -> None:
        publisher = speaker.zenoh.declare_publisher(f"rect/{speaker.name}/{topic}")
        statuses = publisher.declare_matching_listener()
        while not publisher.matching_status:
            statuses.recv()

    return wait  # type: ignore[return-value]
