"""Transfers between two robots: in memory, in files, refused, failed, resumed.

pytest rect-py/tests/test_transfers.py
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
import rect
from conftest import DEADLINE, until_peer

Pair = tuple[rect.Robot, rect.Robot]


def test_bytes_arrive_whole_with_progress_on_both_sides(pair: Pair) -> None:
    one, two = pair
    data = os.urandom(3_000_000)
    sent: list[rect.Progress] = []
    came: list[float] = []
    maps = two.receive_transfers("*/maps/*", on_progress=lambda about, progress: came.append(progress.fraction))
    one.transfer("wombat-2", "maps/kitchen", data, name="kitchen.pcd", on_progress=sent.append)
    received = maps.next(DEADLINE)
    assert received.content == data
    assert (received.sender, received.topic, received.name) == ("wombat-1", "maps/kitchen", "kitchen.pcd")
    assert (sent[-1].fraction, came[-1]) == (1.0, 1.0)


@pytest.mark.parametrize("size", [0, 1, 131_072, 1_000_001])
def test_a_file_of_any_size_arrives_as_a_file(pair: Pair, tmp_path: Path, size: int) -> None:
    one, two = pair
    source = tmp_path / "map.bin"
    source.write_bytes(os.urandom(size))
    with two.receive_transfers("*/maps", folder=tmp_path / "in") as maps:
        one.transfer("wombat-2", "maps", source)
        received = maps.next(DEADLINE)
    assert received.content == tmp_path / "in" / "wombat-1" / "map.bin"
    assert received.value == source.read_bytes()


def test_other_values_are_transferred_as_what_they_are(pair: Pair) -> None:
    one, two = pair
    with two.receive_transfers("*/plan") as plans:
        one.transfer("wombat-2", "plan", {"steps": [1, 2, 3]})
        received = plans.next(DEADLINE)
    assert (received.encoding, received.value) == ("application/json", {"steps": [1, 2, 3]})


def test_what_is_not_wanted_or_too_large_is_refused(pair: Pair) -> None:
    one, two = pair
    with two.receive_transfers("*/maps", max_bytes=10):
        with pytest.raises(rect.TransferRefused, match="wombat-2 does not take the transfer other: no program there"):
            one.transfer("wombat-2", "other", b"x", timeout=DEADLINE)
        with pytest.raises(rect.TransferRefused, match="larger than the 10 bytes that are taken there"):
            one.transfer("wombat-2", "maps", b"x" * 11, timeout=DEADLINE)


def test_where_nobody_takes_it_patience_ends_it(pair: Pair) -> None:
    with pytest.raises(rect.TimedOut, match="no word of wombat-2 about the transfer maps"):
        pair[0].transfer("wombat-2", "maps", b"x", timeout=0.1)


def test_a_file_that_changes_meanwhile_fails_on_both_sides(pair: Pair, tmp_path: Path) -> None:
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


def test_what_was_there_before_a_restart_of_the_taker_is_not_sent_again(pair: Pair, tmp_path: Path) -> None:
    one, two = pair
    data = os.urandom(30_000_000)
    began = threading.Event()

    def come(about: rect.Received, progress: rect.Progress) -> None:
        if progress.held_bytes:
            began.set()

    taken = two.receive_transfers("*/maps", folder=tmp_path, on_progress=come)
    failed: list[BaseException] = []

    def send() -> None:
        try:
            one.transfer("wombat-2", "maps", data, name="map")
        except BaseException as error:
            failed.append(error)

    sending = threading.Thread(target=send)
    sending.start()
    assert began.wait(DEADLINE)
    taken.close()
    first: list[int] = []
    again = two.receive_transfers(
        "*/maps", folder=tmp_path, on_progress=lambda about, progress: first.append(progress.held_bytes)
    )
    received = again.next(DEADLINE)
    sending.join(DEADLINE)
    assert not failed
    assert received.value == data
    assert first[0] > 0


def test_the_sender_that_is_closed_stops(pair: Pair) -> None:
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


def test_a_stopped_transfer_ends_at_once(pair: Pair) -> None:
    sending = pair[0].sending("wombat-9", "maps", b"x")
    sending.stop()
    with pytest.raises(rect.Closed, match="the transfer was stopped"):
        sending.run()
