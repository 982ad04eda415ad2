"""Defines fixtures and helpers: two directly linked robots in one process, two linked routers, and functions
that wait for discovery."""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rect
from programs import DEADLINE as DEADLINE
from programs import Routers, linked_routers
from programs import until as until

#: The files that take longest. They begin first, so that no worker is left with one of them at the end.
_LONGEST = ["test_foxglove", "test_state_killed", "test_recording", "test_state", "test_programs", "test_killed"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    names = [*_LONGEST, ""]
    items.sort(key=lambda item: names.index(item.path.stem if item.path.stem in names else ""))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


Pair = tuple[rect.Robot, rect.Robot]


@pytest.fixture
def pair() -> Iterator[Pair]:
    """Connects `wombat-1` and `wombat-2`, and waits until each has discovered the other."""
    with connected_pair() as robots:
        yield robots


@contextmanager
def connected_pair() -> Iterator[Pair]:
    """Does the same outside of fixtures."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-1", listen=[endpoint]) as one, rect.connect("wombat-2", endpoints=[endpoint]) as two:
        for robot in (one, two):
            until_peer(robot)
        yield one, two


@pytest.fixture(scope="module")
def routers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Routers]:
    """Starts the routers of `wombat-1` and `wombat-2`, linked on the simulated air."""
    with linked_routers(tmp_path_factory.mktemp("connections")) as routers:
        yield routers


@contextmanager
def repeating(seconds: float, action: Callable[[], object]) -> Iterator[None]:
    """Calls a function on a thread, again and again with this pause."""
    ends = threading.Event()

    def repeat() -> None:
        while not ends.wait(seconds):
            action()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


def until_peer(robot: rect.Robot) -> None:
    """Waits until the robot has discovered another one."""
    with robot.events() as events:
        while events.next(DEADLINE).kind != "peer_up":
            pass


def until_subscribed(publishing: rect.Robot, topic: str) -> None:
    """Waits until another program has subscribed to a topic of the robot."""
    publisher = publishing.zenoh.declare_publisher(f"rect/{publishing.name}/{topic}", allowed_destination=_remote())
    _until_matching(publisher)


def until_served(requester: rect.Robot, robot: str, topic: str, is_served: bool = True) -> None:
    """Waits until `requester` has discovered a service of another program, or its end."""
    querier = requester.zenoh.declare_querier(f"rect/{robot}/{topic}", allowed_destination=_remote())
    _until_matching(querier, is_served)


def _until_matching(declared: Any, expected: bool = True) -> None:
    changes: queue.SimpleQueue[bool] = queue.SimpleQueue()
    listener = declared.declare_matching_listener(lambda status: changes.put(status.matching))
    matching = declared.matching_status.matching
    while matching is not expected:
        matching = changes.get(timeout=DEADLINE)
    listener.undeclare()
    declared.undeclare()


def _remote() -> Any:
    import zenoh

    return zenoh.Locality.REMOTE
