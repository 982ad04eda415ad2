"""Scenarios of a link over Bluetooth and a network at once, on a real kernel's stacks. Linux's traffic control drops
the packets of the network path."""

import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from conftest import power
from robots import AnyRobot, Collector, wait_until

# Where the first robot accepts network paths.
PORT = 7460
MESSAGES = 200


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[AnyRobot, AnyRobot]]:
    """Starts two robots that are linked over both paths. Each has its own TCP port."""
    robots = [AnyRobot(f"wombat-{n + 1}", f"hci{n}", tmp_path / f"wombat-{n + 1}.log") for n in range(2)]
    one, two = robots
    try:
        one.start([], ble_options=f";interfaces=lo;port={PORT}")
        two.start([f"any/{one.name}"], ble_options=f";interfaces=lo;port={PORT + 1}")
        wait_until("both paths are there", 40, lambda: two.bulk_path() == "tcp" and two.has_path("ble"))
        yield one, two
    finally:
        loss(0)
        for robot in robots:
            robot.kill()


def loss(percent: int) -> None:
    """Sets the share of the packets of network paths that are lost."""
    command = ["tc", "qdisc", "del", "dev", "lo", "root"]
    subprocess.run(command, stderr=subprocess.DEVNULL, check=False)
    if percent == 0:
        return
    commands = ["qdisc add dev lo root handle 1: prio priomap 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0"]
    commands += [f"qdisc add dev lo parent 1:3 handle 30: netem loss {percent}%"]
    commands += [
        f"filter add dev lo parent 1: protocol ip u32 match ip {side} {port} 0xffff flowid 1:3"
        for side in ("sport", "dport")
        for port in (PORT, PORT + 1)
    ]
    for arguments in commands:
        subprocess.run(["tc", *arguments.split()], check=True)


def test_network_path_is_open_within_a_second_of_the_bluetooth_path(pair):
    _, two = pair
    times = [seconds(line) for line in two.log().splitlines() if "has a path over" in line]
    assert len(times) >= 2
    took = times[1] - times[0]
    print(f"the network path followed the Bluetooth path after {took:.2f} s")
    assert took < 1


def seconds(line: str) -> float:
    """Returns the time of a line of the log, in seconds of its day."""
    hours, minutes, rest = re.search(r"T(\d+):(\d+):([\d.]+)Z", line).groups()
    return int(hours) * 3600 + int(minutes) * 60 + float(rest)


def test_nothing_is_lost_when_the_network_falls_silent_and_works_again(pair):
    one, two = pair
    with two.session() as here, one.session() as there:
        collector = Collector(there, "rect/count", here)
        for n in range(MESSAGES):
            if n == MESSAGES // 4:
                loss(100)
            if n == MESSAGES * 3 // 4:
                assert two.bulk_path() == "ble"
                loss(0)
            here.put("rect/count", f"{n}", congestion_control=zenoh.CongestionControl.BLOCK)
            # The pace of the messages, so that the fault is in the middle of them.
            time.sleep(0.02)
        assert collector.take(MESSAGES) == [f"{n}".encode() for n in range(MESSAGES)]
    back = wait_until("the network carries the load again", 30, lambda: two.bulk_path() == "tcp")
    print(f"the network carried the load again after {back:.1f} s")


def test_radio_that_is_switched_off_is_not_noticed(pair):
    one, two = pair
    with two.session() as here, one.session() as there:
        collector = Collector(there, "rect/count", here)
        power("hci0", "off")
        wait_until("the Bluetooth path has ended", 30, lambda: not two.has_path("ble"))
        for n in range(20):
            here.put("rect/count", f"{n}", congestion_control=zenoh.CongestionControl.BLOCK)
        assert collector.take(20) == [f"{n}".encode() for n in range(20)]
