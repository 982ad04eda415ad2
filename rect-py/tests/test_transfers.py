"""Tests transfers between two robots: in memory, in files, refused, failed and resumed.

pytest rect-py/tests/test_transfers.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import rect
from conftest import DEADLINE, free_port, until_peer
from rect import _rect

Pair = tuple[rect.Robot, rect.Robot]


def test_bytes_arrive_with_progress_on_both_sides(pair: Pair) -> None:
    one, two = pair
    data = os.urandom(3_000_000)
    sent: list[rect.Progress] = []
    arrived: list[float] = []
    maps = two.receive_transfers("*/maps/*", on_progress=lambda about, progress: arrived.append(progress.fraction))
    one.transfer("wombat-2", "maps/kitchen", data, name="kitchen.pcd", on_progress=sent.append)
    received = maps.next(DEADLINE)
    assert received.content == data
    assert (received.sender, received.topic, received.name) == ("wombat-1", "maps/kitchen", "kitchen.pcd")
    assert (sent[-1].fraction, arrived[-1]) == (1.0, 1.0)


@pytest.mark.parametrize("size", [0, 1, 131_072, 1_000_001])
def test_file_of_any_size_arrives_as_file(pair: Pair, tmp_path: Path, size: int) -> None:
    one, two = pair
    source = tmp_path / "map.bin"
    source.write_bytes(os.urandom(size))
    with two.receive_transfers("*/maps", folder=tmp_path / "in") as maps:
        one.transfer("wombat-2", "maps", source)
        received = maps.next(DEADLINE)
    assert received.content == tmp_path / "in" / "wombat-1" / "map.bin"
    assert received.value == source.read_bytes()


def test_other_values_keep_their_encoding(pair: Pair) -> None:
    one, two = pair
    with two.receive_transfers("*/plan") as plans:
        one.transfer("wombat-2", "plan", {"steps": [1, 2, 3]})
        received = plans.next(DEADLINE)
    assert (received.encoding, received.value) == ("application/json", {"steps": [1, 2, 3]})


def test_unmatched_or_too_large_transfer_is_refused(pair: Pair) -> None:
    one, two = pair
    with two.receive_transfers("*/maps", max_bytes=10):
        with pytest.raises(rect.TransferRefused, match="wombat-2 refused the transfer other: no program on that robot"):
            one.transfer("wombat-2", "other", b"x", timeout=DEADLINE)
        with pytest.raises(rect.TransferRefused, match="larger than the 10 bytes that the receiver accepts"):
            one.transfer("wombat-2", "maps", b"x" * 11, timeout=DEADLINE)


def test_transfer_times_out_without_receiver(pair: Pair) -> None:
    with pytest.raises(rect.TimedOut, match="no reply of wombat-2 about the transfer maps"):
        pair[0].transfer("wombat-2", "maps", b"x", timeout=0.1)


def test_transfer_times_out_if_program_takes_none(pair: Pair) -> None:
    one, two = pair
    with two.receive_transfers("*/maps", max_concurrent=1) as maps:
        one.transfer("wombat-2", "maps", b"first", timeout=0.5)
        reason = "no room for the transfer maps: the program of wombat-2 has taken none of those that have arrived"
        for content in (b"second", b"third"):
            with pytest.raises(rect.TimedOut, match=reason):
                one.transfer("wombat-2", "maps", content, timeout=0.5)
        assert [maps.next(DEADLINE).content for _ in range(2)] == [b"first", b"second"]
        one.transfer("wombat-2", "maps", b"third", timeout=DEADLINE)


def test_file_that_changes_during_transfer_fails_on_both_sides(pair: Pair, tmp_path: Path) -> None:
    one, two = pair
    source = tmp_path / "map.bin"
    source.write_bytes(os.urandom(20_000_000))

    def change(progress: rect.Progress) -> None:
        source.write_bytes(b"short")

    with two.receive_transfers("*/maps") as maps:
        with pytest.raises(rect.TransferFailed, match="the source changed while it was sent"):
            one.transfer("wombat-2", "maps", source, on_progress=change)
        received = maps.next(DEADLINE)
    assert isinstance(received.error, rect.TransferFailed)
    with pytest.raises(rect.TransferFailed):
        _ = received.content


def test_transfer_resumes_after_receiver_restart(pair: Pair, tmp_path: Path) -> None:
    one, two = pair
    # So large that it takes longer than the interval between two reports of its progress.
    source = tmp_path / "source"
    with source.open("wb") as file:
        file.truncate(200_000_000)
    began, closed = threading.Event(), threading.Event()

    def on_progress(about: rect.Received, progress: rect.Progress) -> None:
        if progress.received_bytes:
            began.set()
            # The transfer must not be complete before it is interrupted.
            closed.wait(DEADLINE)

    transfers = two.receive_transfers(
        "*/maps", folder=tmp_path / "received", max_bytes=1 << 30, on_progress=on_progress
    )
    failed: list[BaseException] = []

    def send() -> None:
        try:
            one.transfer("wombat-2", "maps", source, name="map")
        except BaseException as error:
            failed.append(error)

    sending = threading.Thread(target=send)
    sending.start()
    assert began.wait(DEADLINE)
    transfers.close()
    closed.set()
    first: list[int] = []
    again = two.receive_transfers(
        "*/maps",
        folder=tmp_path / "received",
        max_bytes=1 << 30,
        on_progress=lambda about, progress: first.append(progress.received_bytes),
    )
    received = again.next(DEADLINE)
    sending.join(DEADLINE)
    assert not failed
    assert isinstance(received.content, Path)
    assert received.content.stat().st_size == 200_000_000
    assert first[0] > 0


def test_closing_sender_stops_transfer(pair: Pair) -> None:
    one, two = pair
    until_peer(two)
    ended: list[BaseException] = []

    def send() -> None:
        try:
            one.transfer("wombat-9", "maps", b"x")
        except rect.Closed as error:
            ended.append(error)

    sending = threading.Thread(target=send)
    sending.start()
    one.close()
    sending.join(DEADLINE)
    assert not sending.is_alive()
    assert len(ended) == 1


def test_stopped_outgoing_transfer_raises_closed(pair: Pair) -> None:
    outgoing = pair[0].outgoing_transfer("wombat-9", "maps", b"x")
    outgoing.stop()
    with pytest.raises(rect.Closed, match="the transfer was stopped"):
        outgoing.run()


def _offer(sender: str, data: bytes) -> bytes:
    """Returns an offer to wombat-2 that names `sender`. Any program can make such an offer."""
    key_space = _rect.KeySpace("rect", sender)
    driver = _rect.TransferPush(key_space, "wombat-2", "maps", data, 1, name="map.bin").driver()
    steps = iter(driver.poll, None)
    _, _, _, payload, *_ = next(step for step in steps if step[0] == "get")
    offer: bytes = payload[0]
    return offer


def _send_offer(forger: rect.Robot, offer: bytes) -> None:
    """Sends an offer as soon as wombat-2 is reachable."""
    deadline = time.monotonic() + DEADLINE
    while time.monotonic() < deadline:
        replies = forger.zenoh.get("rect/wombat-2/@rect/inbox", payload=offer)
        if any(reply.ok is not None for reply in replies):
            return
    raise TimeoutError


@pytest.fixture
def trio() -> Iterator[tuple[rect.Robot, rect.Robot, rect.Robot]]:
    """Connects a forger, an honest robot and `wombat-2`; the first two have discovered the third."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        rect.connect("wombat-2", listen=[endpoint]) as two,
        rect.connect("forger", endpoints=[endpoint]) as forger,
        rect.connect("honest", endpoints=[endpoint]) as honest,
    ):
        for robot in (forger, honest):
            until_peer(robot)
        yield forger, honest, two


def test_forged_offer_changes_nothing(trio: tuple[rect.Robot, rect.Robot, rect.Robot], tmp_path: Path) -> None:
    forger, honest, two = trio
    with two.receive_transfers("*/maps", folder=tmp_path) as maps:
        honest.transfer("wombat-2", "maps", b"a map", name="map.bin")
        file = maps.next(DEADLINE).content
        assert file == tmp_path / "honest" / "map.bin"
        for sender in ("honest", "nobody"):
            for data in (b"", b"forged"):
                _send_offer(forger, _offer(sender, data))
        # If the forged offers have any effect, it occurs before these later transfers end.
        for _ in range(3):
            honest.transfer("wombat-2", "maps", b"another", name="other.bin")
            assert maps.next(DEADLINE).name == "other.bin"
    assert isinstance(file, Path)
    assert file.read_bytes() == b"a map"
    assert sorted(os.listdir(tmp_path)) == ["honest"]
    assert sorted(os.listdir(tmp_path / "honest")) == ["map.bin", "other.bin"]


def test_silent_senders_do_not_block_others(trio: tuple[rect.Robot, rect.Robot, rect.Robot], tmp_path: Path) -> None:
    forger, honest, two = trio
    kept: list[object] = []
    silent = forger.zenoh.declare_queryable("rect/forger/@rect/transfer/*", kept.append)
    with two.receive_transfers("*/maps", folder=tmp_path) as maps:
        for number in range(20):
            _send_offer(forger, _offer("forger", bytes([number]) * 100))
            _send_offer(forger, _offer("nobody", bytes([number]) * 100))
        start = time.monotonic()
        honest.transfer("wombat-2", "maps", b"a map", timeout=DEADLINE)
        assert time.monotonic() - start < 5
        assert maps.next(DEADLINE).sender == "honest"
        assert os.listdir(tmp_path) == ["honest"]
    assert kept
    silent.undeclare()


def test_sender_is_informed_before_program_of_receiver(tmp_path: Path) -> None:
    program = """
import os, sys, rect
two = rect.connect("wombat-2", endpoints=[sys.argv[1]])
maps = two.receive_transfers("*/maps", folder=sys.argv[2])
print("ready", flush=True)
maps.next()
os._exit(0)
"""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "wombat-1").write_text("a file in place of a folder")
    for folder in ("full", "empty"):
        with rect.connect("wombat-1", listen=[endpoint]) as one:
            arguments = [sys.executable, "-c", program, endpoint, str(tmp_path / folder)]
            with subprocess.Popen(arguments, stdout=subprocess.PIPE) as receiver:
                assert receiver.stdout is not None
                assert receiver.stdout.readline() == b"ready\n"
                if folder == "full":
                    with pytest.raises(rect.TransferFailed, match="the receiver cannot store it"):
                        one.transfer("wombat-2", "maps", b"a map", timeout=8)
                else:
                    one.transfer("wombat-2", "maps", b"a map", timeout=8)
