"""Scenarios of a link over Bluetooth and a network at once, on a real kernel's stacks. Linux's traffic control drops
the packets of the network path."""

import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from conftest import power
from robots import AnyRobot, Collector, wait_until

# Where the first robot accepts network paths.
PORT = 7460
MESSAGES = 200
ADDRESSES = ("10.77.0.1", "10.77.0.2")


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[AnyRobot, AnyRobot]]:
    """Starts two robots that are linked over both paths."""
    with linked(tmp_path, ("lo", "lo")) as robots:
        try:
            yield robots
        finally:
            loss(0)


@contextmanager
def linked(tmp_path: Path, interfaces: tuple[str, str]) -> Iterator[tuple[AnyRobot, AnyRobot]]:
    """Starts two robots that are linked over both paths, each with its own network interface and TCP port."""
    robots = [AnyRobot(f"wombat-{n + 1}", f"hci{n}", tmp_path / f"wombat-{n + 1}.log") for n in range(2)]
    one, two = robots
    try:
        one.start([], ble_options=f";interfaces={interfaces[0]};port={PORT}")
        two.start([f"any/{one.name}"], ble_options=f";interfaces={interfaces[1]};port={PORT + 1}")
        wait_until("both paths are there", 40, lambda: two.bulk_path() == "tcp" and two.has_path("ble"))
        yield one, two
    finally:
        for robot in robots:
            robot.kill()


@pytest.fixture
def interfaces() -> Iterator[tuple[str, str]]:
    """Adds two network interfaces with addresses in one network. The kernel delivers packets between them."""
    names = ("rect0", "rect1")
    for n, name in enumerate(names):
        ip(f"link add {name} type dummy")
        ip(f"address add {ADDRESSES[n]}/24 dev {name}")
        ip(f"link set {name} up")
    yield names
    for name in names:
        ip(f"link delete {name}")


def ip(arguments: str) -> None:
    subprocess.run(["ip", *arguments.split()], check=True)


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


def test_network_path_follows_the_bluetooth_path(pair):
    _, two = pair
    times = [seconds(line) for line in two.log().splitlines() if "has a path over" in line]
    assert len(times) >= 2
    print(f"the network path followed the Bluetooth path after {times[1] - times[0]:.2f} s")


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
                took = wait_until("Bluetooth carries the load", 30, lambda: two.bulk_path() == "ble")
                loss(0)
            here.put("rect/count", f"{n}", congestion_control=zenoh.CongestionControl.BLOCK)
            # The pace of the messages, so that the fault is in the middle of them.
            time.sleep(0.02)
        assert collector.take(MESSAGES) == [f"{n}".encode() for n in range(MESSAGES)]
    back = wait_until("the network carries the load again", 30, lambda: two.bulk_path() == "tcp")
    print(f"Bluetooth carried the load {took:.1f} s after the middle, and the network again after {back:.1f} s")


def test_network_that_is_left_ends_its_path_and_nothing_is_lost(tmp_path, interfaces):
    with linked(tmp_path, interfaces) as (one, two), two.session() as here, one.session() as there:
        collector = Collector(there, "rect/count", here)
        for n in range(MESSAGES):
            if n == MESSAGES // 4:
                # Like a robot that leaves its Wi-Fi. The kernel still delivers if only the interface is down.
                ip(f"link set {interfaces[0]} down")
                ip(f"address flush dev {interfaces[0]}")
            here.put("rect/count", f"{n}", congestion_control=zenoh.CongestionControl.BLOCK)
            # The pace of the messages, so that the fault is in the middle of them.
            time.sleep(0.02)
        assert collector.take(MESSAGES) == [f"{n}".encode() for n in range(MESSAGES)]
        wait_until("the network path has ended", 30, lambda: two.bulk_path() == "ble" and not two.has_path("tcp"))
        assert "has ended: this side has lost the network" in two.log()
        ip(f"link set {interfaces[0]} up")
        ip(f"address add {ADDRESSES[0]}/24 dev {interfaces[0]}")
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
